"""Brookwood Design RP23U5XBB ("RP23CNC") V1.0: an RP2350B with plugs for five stepper drivers.

Axes are X, Y, Z, A and B. For two motors on Y write MOTORS = "XYZAY". For fewer motors remove the
last pins of STEP, DIR, ENABLE and LIMIT. Inputs are opto-couplers that a contact to GND closes.
The stop input is a reset, which stops tool and motors at once. For an emergency stop, whose
contact opens, write ESTOP = 11 and no reset. The door is 8. The card slot is
SD_CARD = (46, 43, 44, 45) (docs/jobs.md). MicroPython has no image for 48 pins and 2 MB of flash:
see docs/boards.md. Pins are from the maker's schematic V1.0, github.com/phil-barrett/RP23CNC.
Never ran on hardware.
"""

CHIP = "rp2350b"
MPY_ARCH = "armv7emsp"
ENGINE = "pio"
LINK = "usb"

STEP = (17, 18, 19, 20, 21)
DIR = (12, 13, 14, 15, 16)
ENABLE = (22, 23, 24, 25, 26)
LIMIT = (6, 5, 4, 3, 2)
PROBE = 7
# Reset, hold, start, door.
CONTROL = (11, 10, 9, None)
SPINDLE_PWM = 35  # and also 0 to 10 V
SPINDLE_DIR = 34
SPINDLE_ON = 33
FLOOD = 39
MIST = True
MIST_PIN = 40

# Opto-couplers on long wires: a contact counts after it has been stable for this time. Big drivers
# need their direction early.
CONTROL_DEBOUNCE_MS = 20
DIR_HOLD_US = 10
DIR_SETUP_US = 10
# A circuit that converts PWM to 0 to 10 V needs a low frequency.
PWM_HZ = 1000

# Small moves at high speed need a long look-ahead; this chip has the memory for it.
PLANNER_BLOCKS = 64
RX_BYTES = 255
PWM_MAX = 1000
