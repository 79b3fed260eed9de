"""Raspberry Pi Pico on a plain breakout, with six stepper drivers: axes X, Y, Z, A, B and C.

The pins are of our own choice, in the order in which a Pico has them, and take all that there are.
For two motors on an axis write MOTORS = "XYZAYZ" say: see docs/motors.md; for axes that turn
ROTARY = "AC". For five motors leave the last pin of STEP, DIR and LIMIT out.
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
# Held to ground at power-up: MicroPython's prompt in place of the machine.
REPL_PIN = 22

# Small moves at high speed want a long look ahead.
PLANNER_BLOCKS = 64
RX_BYTES = 255
PWM_MAX = 1000
