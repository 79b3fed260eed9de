"""Drawings of modules: the pins on both sides, from the USB connector down.

Sources are the makers' pin drawings: Raspberry Pi Pico data sheet, figure 2; ESP32-DevKitC V4;
ESP32-S3-DevKitC-1. A number is a GPIO; any other word is a label. A chip without a module is drawn
with its pins in order.
"""

from typing import NamedTuple

from .chips import CHIPS


class Module(NamedTuple):
    """The data of a drawing: a title, and words for each side."""

    title: str
    left: str
    right: str
    on_board: str = ""  # GPIOs that are not on an edge


_PICO = (
    "0 1 GND 2 3 4 5 GND 6 7 8 9 GND 10 11 12 13 GND 14 15",
    "VBUS VSYS GND EN 3V3 VREF 28 AGND 27 26 RUN 22 GND 21 20 19 18 GND 17 16",
)
_MODULES = {
    "pico": Module("Pico", *_PICO, on_board="25"),
    "pico_w": Module("Pico W", *_PICO),
    "pico2": Module("Pico 2", *_PICO, on_board="25"),
    "pico2_w": Module("Pico 2 W", *_PICO),
    "esp32": Module(
        "ESP32-DevKitC",
        "3V3 EN 36 39 34 35 32 33 25 26 27 14 12 GND 13 D2 D3 CMD 5V",
        "GND 23 22 1 3 21 GND 19 18 5 17 16 4 0 2 15 D1 D0 CLK",
    ),
    "esp32s3": Module(
        "ESP32-S3-DevKitC-1",
        "3V3 3V3 RST 4 5 6 7 15 16 17 18 8 3 46 9 10 11 12 13 14 5V GND",
        "GND 43 44 1 2 42 41 40 39 38 37 36 35 0 45 48 47 21 20 19 GND GND",
        on_board="33 34",
    ),
}


def module(chip: str) -> Module:
    """Return the drawing of a chip of CHIPS, by its name."""
    if chip in _MODULES:
        return _MODULES[chip]
    pins = [str(pin) for pin in sorted(CHIPS[chip].pins)]
    half = len(pins) // 2
    return Module(CHIPS[chip].processor, " ".join(pins[:half]), " ".join(pins[half:]))
