"""Which MicroPython each engine needs: older ones are refused in words, at start and by tools.

Imported at start and forgotten again.
"""

import sys

# Engine, chip as MicroPython names it, oldest version, and what comes with that.
NEEDS = (
    ("pio", "RP2040", (1, 26), "timers that interrupt at once"),
    ("pio", "RP2350", (1, 27), "DMA channels that can be given back"),
    ("rmt", "ESP32", (1, 27), "pulses of a resolution that is asked for"),
    ("i2s", "ESP32", (1, 23), "compiled modules of today's kind"),
)


def missing(engine: str, machine: str, version: "tuple[int, ...]") -> str:
    """Why this version is too old for that engine on that machine; "" where it is not."""
    for needing, chip, oldest, why in NEEDS:
        if needing == engine and chip in machine and version < oldest:
            old = "MicroPython %d.%d is too old: " % version[:2]
            return old + "ENGINE %s on %s wants 1.%d or newer, for %s" % (
                engine,
                chip,
                oldest[1],
                why,
            )
    return ""


def check(engine: str) -> None:
    """Raises ValueError where the MicroPython that runs this is too old."""
    machine = getattr(sys.implementation, "_machine", "")
    why = missing(engine, machine, sys.implementation.version[:2])
    if why:
        raise ValueError(why)
