"""Raspberry Pi Pico on a parallel SCARA: its arms are in scara.py, next to this file."""

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
KINEMATICS = "scara"
DEFAULTS = {
    # Arms: steps and rates in degrees. 200 steps per turn, 16 microsteps, a belt of 5 : 1.
    100: 44.444,
    101: 44.444,
    102: 400.0,
    110: 7200.0,
    111: 7200.0,
    112: 1200.0,
    120: 1500.0,
    121: 1500.0,
    122: 300.0,
    # Space: X from -140 to 140, Y to 200, Z from -50 to 0.
    130: 140.0,
    131: 200.0,
    132: 50.0,
    23: 2,
    27: 5.0,
}
