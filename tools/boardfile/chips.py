"""Chips: what a board file must observe about a processor and its module."""

from collections.abc import Mapping
from typing import NamedTuple

# Modules of MicroPython that the firmware imports; a file of the same name would replace one.
BUILT_IN = (
    *("array", "binascii", "deflate", "errno", "esp32", "gc", "hashlib", "io", "json", "machine"),
    *("math", "micropython", "network", "os", "rp2", "select", "socket", "struct", "sys", "time"),
    "uctypes",
)


class Chip(NamedTuple):
    """A row of CHIPS. processor: MicroPython's name. engine, link: defaults of a new board."""

    title: str
    processor: str
    mpy_arch: str
    engine: str
    link: str
    pins: frozenset[int]  # pins that are accessible
    inputs_only: frozenset[int] = frozenset()
    odd: Mapping[int, str] = {}  # pins that work, but with a special function
    most_motors: int = 4
    radio: bool = True  # it has a radio, or may have one
    # Pins above this one cannot make steps, nor be inputs that are all read at once.
    last_quick: int = 63


_ESP32_ODD = {
    0: "pressed to ground at start it asks for new firmware",
    2: "has to be low or open while new firmware is loaded",
    5: "has a say at start; gives pulses then",
    12: "pulled up at start selects the wrong flash voltage, and the board does not start: a CNC"
    " shield pulls its enable up",
    15: "has a say at start; gives pulses then",
    **dict.fromkeys((16, 17), "belongs to the PSRAM of a WROVER, which the firmware wants"),
    1: "is the serial line to the computer (TX)",
    3: "is the serial line to the computer (RX)",
    **dict.fromkeys((34, 35, 36, 39), "has no pull-up: the switch needs a resistor to 3.3 V"),
}
_ESP32_S3_ODD = {
    0: "pressed to ground at start it asks for new firmware",
    3: "has a say at start",
    19: "is native USB (D-)",
    20: "is native USB (D+)",
    45: "has a say at start",
    46: "has a say at start",
}
_PICO_PINS = frozenset(range(23)) | {26, 27, 28}
_RP2_PINS = frozenset(range(30))
_RP2350B_PINS = frozenset(range(48))
# Four machines of PIO 0, and two of PIO 1, which also has the clock and one for a radio. In an
# RP2350 all of PIO 1, because clock and radio have their machines in PIO 2.
_RP2_MOTORS = 6
_RP2350_MOTORS = 8
_LED = {25: "is the LED"}
_ESP32_PINS = frozenset(range(40)) - frozenset(range(6, 12)) - {20, 24, 28, 29, 30, 31, 37, 38}
_ESP32_S3_PINS = frozenset(range(49)) - frozenset(range(22, 33))

# The values of CHIP in a board file. One with its processor's name is that chip without a module;
# it is the default for a board file without CHIP.
CHIPS = {
    "pico": Chip(
        "Raspberry Pi Pico",
        *("RP2040", "armv6m", "pio", "usb"),
        pins=_PICO_PINS | {25},
        odd=_LED,
        most_motors=_RP2_MOTORS,
        radio=False,
    ),
    "pico_w": Chip(
        "Raspberry Pi Pico W",
        *("RP2040", "armv6m", "pio", "usb"),
        pins=_PICO_PINS,
        most_motors=_RP2_MOTORS,
    ),
    "pico2": Chip(
        "Raspberry Pi Pico 2",
        *("RP2350", "armv7emsp", "pio", "usb"),
        pins=_PICO_PINS | {25},
        odd=_LED,
        most_motors=_RP2350_MOTORS,
        radio=False,
    ),
    "pico2_w": Chip(
        "Raspberry Pi Pico 2 W",
        *("RP2350", "armv7emsp", "pio", "usb"),
        pins=_PICO_PINS,
        most_motors=_RP2350_MOTORS,
    ),
    "rp2040": Chip(
        "RP2040 on a board of its own",
        *("RP2040", "armv6m", "pio", "usb"),
        pins=_RP2_PINS,
        most_motors=_RP2_MOTORS,
    ),
    "rp2350": Chip(
        "RP2350 on a board of its own",
        *("RP2350", "armv7emsp", "pio", "usb"),
        pins=_RP2_PINS,
        most_motors=_RP2350_MOTORS,
    ),
    "rp2350b": Chip(
        "RP2350B, with 48 pins, on a board of its own",
        *("RP2350", "armv7emsp", "pio", "usb"),
        pins=_RP2350B_PINS,
        most_motors=_RP2350_MOTORS,
        last_quick=31,
    ),
    "esp32": Chip(
        "ESP32",
        *("ESP32", "xtensawin", "rmt", "uart"),
        pins=_ESP32_PINS,
        inputs_only=frozenset({34, 35, 36, 39}),
        odd=_ESP32_ODD,
    ),
    "esp32s3": Chip(
        "ESP32-S3",
        *("ESP32S3", "xtensawin", "rmt", "uart"),
        pins=_ESP32_S3_PINS,
        odd=_ESP32_S3_ODD,
    ),
}

# MicroPython's names of the architectures.
ARCHS = tuple(dict.fromkeys(chip.mpy_arch for chip in CHIPS.values()))


def processors(arch: str) -> list[str]:
    """Return the names of the processors that run code compiled for an architecture."""
    return list(dict.fromkeys(chip.processor for chip in CHIPS.values() if chip.mpy_arch == arch))


def on_their_own(arch: str) -> list[Chip]:
    """Return the chips of an architecture that are not on a module: their key in CHIPS is their
    processor's name."""
    return [
        chip
        for name, chip in CHIPS.items()
        if chip.mpy_arch == arch and name == chip.processor.lower()
    ]
