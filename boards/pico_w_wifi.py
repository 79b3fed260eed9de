"""Raspberry Pi Pico W with its radio in use: a sender by USB or network (docs/network.md)."""

CHIP = "pico_w"
MPY_ARCH = "armv6m"
ENGINE = "pio"
LINK = "wifi"

STEP = (2, 3, 4)
DIR = (5, 6, 7)
ENABLE = 8
LIMIT = (9, 10, 11)
PROBE = 12
# Reset, hold, start, door.
CONTROL = (13, 14, 15, None)
SPINDLE_PWM = 16
SPINDLE_DIR = 17
FLOOD = 18
# Grounded at power-up: MicroPython's prompt starts instead of the machine.
REPL_PIN = 22

RX_BYTES = 255
PWM_MAX = 1000
