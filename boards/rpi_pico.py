"""Raspberry Pi Pico with three stepper drivers on separate pins, spindle or laser by PWM.

Connect switches, buttons and probe between their pin and ground; the Pico has the pull-ups. Pins
give 3.3 V. Most drivers need no more; a spindle's controller may need a level shifter.
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
SPINDLE_PWM = 16
SPINDLE_DIR = 17
FLOOD = 18
# Grounded at power-up: MicroPython's prompt starts instead of the machine.
REPL_PIN = 22

# Small moves at high speed need a long look-ahead.
PLANNER_BLOCKS = 64
RX_BYTES = 255
PWM_MAX = 1000
