"""ESP32 as esp32_devkit.py, with the shield's fourth driver in use, as axis A.

The notes of esp32_devkit.py hold here too. The shield's jumpers for A connect step to D12 and
direction to D13, which were Z's limit and the spindle's direction. So wire Z's switch to A3 (the
shield's coolant), with a pull-up resistor of 10 kOhm to 3.3 V. For an axis that turns add
ROTARY = "A". For a second motor on Y add MOTORS = "XYZY". Never ran on hardware.
"""

MPY_ARCH = "xtensawin"
ENGINE = "rmt"
LINK = "uart"

STEP = (26, 25, 22, 19)
DIR = (21, 27, 14, 18)
ENABLE = 12
LIMIT = (13, 5, 34, None)
HOMING = ("Z", "XY")  # A has no switch
PROBE = 39
# Reset, hold, start, door.
CONTROL = (None, 4, 35, None)
SPINDLE_PWM = 23
NO_PULL_UP = (34, 35, 39)

MAX_STEP_RATE_HZ = 5000

PLANNER_BLOCKS = 64
RX_BYTES = 128
PWM_MAX = 1000
