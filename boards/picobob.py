"""Expatria PicoBOB: an RP2040 for a five-axis parallel-port breakout ("Mach3 board").

Comments at the pins give the breakout's numbers. P10 is a reset, which stops tool and motors at
once. For an emergency stop, whose contact opens, write ESTOP = 3 and no reset.

For a fourth motor write MOTORS = "XYZA" or "XYZY", STEP = (17, 18, 19, 20), DIR = (9, 10, 11, 12)
and None as a fourth LIMIT. For a fifth write, for example, "XYZAB", add 21 to STEP, 13 to DIR and
None to LIMIT, and remove SPINDLE_ON: P17 is then the direction of motor B, and it also drives the
relay while its jumper is on. Pins are from the maker's README and pictures,
github.com/Expatria-Technologies/PicoBOB; 21 is from its map in grblHAL. Never ran on hardware.
"""

CHIP = "rp2040"
MPY_ARCH = "armv6m"
ENGINE = "pio"
LINK = "usb"

STEP = (17, 18, 19)  # P2, P4, P6
DIR = (9, 10, 11)  # P3, P5, P7
ENABLE = 16  # P14
LIMIT = (2, 1, 5)  # P12, P13, P15
PROBE = 4  # P11
# Reset, hold, start, door.
CONTROL = (3, None, None, None)  # P10
SPINDLE_PWM = 14  # P1, and also 0 to 10 V
SPINDLE_ON = 13  # P17, the relay

# The breakout's inputs are opto-couplers on long wires: a contact counts after it has been stable
# for this time. Big drivers need their direction early, and long pulses.
CONTROL_DEBOUNCE_MS = 20
DIR_HOLD_US = 10
DIR_SETUP_US = 10
# Controllers that convert PWM to 0 to 10 V need a low frequency.
PWM_HZ = 1000

# Small moves at high speed need a long look-ahead.
PLANNER_BLOCKS = 64
RX_BYTES = 255
PWM_MAX = 1000
DEFAULTS = {0: 5}
