"""Raspberry Pi Pico on a simple breakout, with six stepper drivers: axes X, Y, Z, A, B and C.

The pins are our own choice, in the order of the Pico's pins, and use all of them. For two motors
on an axis write, for example, MOTORS = "XYZAYZ": see docs/motors.md. For axes that turn write
ROTARY = "AC". For five motors remove the last pin of STEP, DIR and LIMIT.
"""

CHIP = "pico"
MPY_ARCH = "armv6m"
ENGINE = "pio"
LINK = "usb"

STEP = (2, 3, 4, 5, 6, 7)
DIR = (8, 9, 10, 11, 12, 13)
ENABLE = 14
LIMIT = (15, 16, 17, 18, 19, 20)
PROBE = 21
# Reset, hold, start, door.
CONTROL = (0, 1, 28, None)
SPINDLE_PWM = 26
FLOOD = 27
# Grounded at power-up: MicroPython's prompt starts instead of the machine.
REPL_PIN = 22

# Small moves at high speed need a long look-ahead.
PLANNER_BLOCKS = 64
RX_BYTES = 255
PWM_MAX = 1000
