"""Raspberry Pi Pico in a laser engraver: $33, exact power, and clusters.

SPINDLE_PWM is the power of the laser. Many lasers need 5 V.
"""

CHIP = "pico"
MPY_ARCH = "armv6m"
ENGINE = "pio"
LINK = "usb"

STEP = (2, 3, 4)
DIR = (5, 6, 7)
ENABLE = 8
LIMIT = (9, 10, 11)
PROBE = 12
# Reset, hold, start, door.
CONTROL = (13, 14, 15, None)
TOOL = "laser"
SPINDLE_PWM = 16
CLUSTERS = True
PWM_HZ = 20000
FLOOD = 18
# Grounded at power-up: MicroPython's prompt starts instead of the machine.
REPL_PIN = 22

RX_BYTES = 255
PWM_MAX = 1000
DEFAULTS = {32: 1}
