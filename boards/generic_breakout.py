"""Raspberry Pi Pico on a breakout board with opto-couplers, and big drivers (DM542, TB6600).

Such drivers need the direction 5 to 10 us before a step, and slow opto-couplers need longer
pulses. Connect PUL+, DIR+ and ENA+ to the breakout's outputs and the minus sides to its ground.
"""

CHIP = "pico"
MPY_ARCH = "armv6m"
ENGINE = "pio"
LINK = "usb"

STEP = (2, 4, 6)
DIR = (3, 5, 7)
ENABLE = 8
LIMIT = (10, 11, 12)
PROBE = 13
# Reset, hold, start, door.
CONTROL = (18, 19, 20, 21)
SAFETY_DOOR = True
SPINDLE_PWM = 16
SPINDLE_DIR = 17
SPINDLE_ON = 14
FLOOD = 15
MIST = True
MIST_PIN = 22

DIR_HOLD_US = 10
DIR_SETUP_US = 10
# Long wires: a button's contact counts after it has been stable for this time.
CONTROL_DEBOUNCE_MS = 20
# Spindle controllers that convert PWM to 0 to 10 V need a low frequency.
PWM_HZ = 1000

# Small moves at high speed need a long look-ahead.
PLANNER_BLOCKS = 64
RX_BYTES = 255
PWM_MAX = 1000
DEFAULTS = {0: 5}
