"""BIGTREETECH SKR Pico V1.0: an RP2040 with four TMC2209 drivers; X, Y and Z are used.

Current and microsteps of the drivers are settings ($140, $150): see docs/drivers.md, also for the
fourth driver. Nothing moves before the board's own supply is on. Limits are the STOP connectors;
take the DIAG jumpers off, or home without switches. E0-STOP is the filament sensor's connector,
and no emergency stop: a button there, to ground, is a reset, which stops tool and motors at once.
For an emergency stop, whose contact opens, write ESTOP = 16 and no reset. The spindle or laser is
the servo connector, 3.3 V; the bed's MOSFET is flood coolant, the hot end's mist. From the maker's
pin drawing. Never ran on hardware.
"""

CHIP = "rp2040"
MPY_ARCH = "armv6m"
ENGINE = "pio"
LINK = "usb"

STEP = (11, 6, 19)
DIR = (10, 5, 28)
ENABLE = (12, 7, 2)
TMC2209 = (0, 2, 1)
TMC_UART = (8, 9)
LIMIT = (4, 3, 25)
PROBE = 22
# Reset, hold, start, door.
CONTROL = (16, None, None, None)
SPINDLE_PWM = 29
FLOOD = 21
MIST = True
MIST_PIN = 23

# Small moves at high speed want a long look ahead.
PLANNER_BLOCKS = 64
RX_BYTES = 255
PWM_MAX = 1000

# Belts of 2 mm and 20 teeth on X and Y, a screw of 8 mm on Z; 16 microsteps of 1.8 degrees.
DEFAULTS = {100: 80.0, 101: 80.0, 102: 400.0}
