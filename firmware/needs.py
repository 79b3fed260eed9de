"""Which MicroPython each engine needs: older ones are refused in words, at start and by tools.

Imported at start and forgotten again.
"""

import sys

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Iterator

# Engine, chip as MicroPython names it, oldest version, and what comes with that.
_NEEDS = (
    ("pio", "RP2040", (1, 26), "timers that interrupt at once"),
    ("pio", "RP2350", (1, 27), "DMA channels that can be given back"),
    ("rmt", "ESP32", (1, 27), "pulses of a resolution that is asked for"),
    ("i2s", "ESP32", (1, 23), "compiled modules of today's kind"),
)


def missing(engine: str, machine: str, version: "tuple[int, ...]") -> str:
    """Why this version is too old for that engine on that machine; "" where it is not."""
    for needing, chip, oldest, why in _NEEDS:
        if needing == engine and chip in machine and version < oldest:
            old, new = "%d.%d" % version[:2], "%d.%d" % oldest
            text = "MicroPython %s is too old: ENGINE %s on %s wants %s or newer, for %s"
            return text % (old, engine, chip, new, why)
    return ""


def engines(machine: str) -> "Iterator[str]":
    """The engines that there are for a machine."""
    for engine, chip, _, _ in _NEEDS:
        if chip in machine:
            yield engine


def check(engine: str) -> None:
    """Raises ValueError where the MicroPython that runs this is too old."""
    machine = getattr(sys.implementation, "_machine", "")
    why = missing(engine, machine, sys.implementation.version[:2])
    if why:
        raise ValueError(why)
