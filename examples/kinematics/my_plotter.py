"""Raspberry Pi Pico on a polar plotter: its joints are in polar.py, next to this file."""

CHIP = "pico"
MPY_ARCH = "armv6m"
ENGINE = "pio"
STEP = (2, 3, 4)
DIR = (5, 6, 7)
ENABLE = 8
LIMIT = (9, 10, 11)
PROBE = 15
PWM_MAX = 1000
PLANNER_BLOCKS = 64
RX_BYTES = 255
KINEMATICS = "polar"
DEFAULTS = {
    # The arm in mm, the table in degrees: 200 steps per turn, 16 microsteps, a belt of 5 : 1.
    100: 80.0,
    101: 44.444,
    102: 400.0,
    110: 6000.0,
    111: 7200.0,
    112: 1200.0,
    120: 500.0,
    121: 1500.0,
    122: 300.0,
    # Space: X and Y from -150 to 150, Z from -50 to 0.
    130: 150.0,
    131: 150.0,
    132: 50.0,
    27: 2.0,
}
