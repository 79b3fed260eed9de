"""BIGTREETECH SKR Pico V1.0: an RP2040 with four TMC2209 drivers; X, Y and Z are used.

Current and microsteps of the drivers are settings ($140, $150): see docs/drivers.md, which also
describes the use of the fourth driver. Motors move only when the board's own supply is on. Limits
are the STOP connectors: remove the DIAG jumpers, or home without switches. E0-STOP is the filament
sensor's connector. A button there, to ground, is a reset, which stops tool and motors at once. It
is no emergency stop. For an emergency stop, whose contact opens, write ESTOP = 16 and no reset.
The spindle or laser is on the servo connector, 3.3 V. The bed's MOSFET is flood coolant, the hot
end's mist. Pins are from the maker's pin drawing. Never ran on hardware.
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

# Small moves at high speed need a long look-ahead.
PLANNER_BLOCKS = 64
RX_BYTES = 255
PWM_MAX = 1000

# X and Y: belts, pitch 2 mm, 20 teeth. Z: a screw, 8 mm per turn. Motors of 1.8 degrees, 16
# microsteps.
DEFAULTS = {100: 80.0, 101: 80.0, 102: 400.0}
