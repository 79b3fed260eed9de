"""Raspberry Pi Pico on a gantry: four stepper drivers, two of them on Y, which squares itself.

Pins are those of rpi_pico.py, and three more for the second motor of Y: 19, 20, and 21 for its
limit switch. If there is no such switch write None for 21: then both motors home as one.
"""

CHIP = "pico"
MPY_ARCH = "armv6m"
ENGINE = "pio"
LINK = "usb"

MOTORS = "XYZY"
STEP = (2, 3, 4, 19)
DIR = (5, 6, 7, 20)
ENABLE = 8
LIMIT = (9, 10, 11, 21)
PROBE = 12
# Reset, hold, start, door.
CONTROL = (13, 14, 15, None)
SPINDLE_PWM = 16
SPINDLE_DIR = 17
FLOOD = 18
# Grounded at power-up: MicroPython's prompt starts instead of the machine.
REPL_PIN = 22

# Small moves at high speed need a long look-ahead.
PLANNER_BLOCKS = 64
RX_BYTES = 255
PWM_MAX = 1000
