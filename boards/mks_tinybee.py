"""MKS TinyBee: an ESP32 with five drivers on shift registers, made for 3D printers.

Driver E0 is a second motor on Y, E1 one on Z; unconnected drivers do no harm. For a machine
with five axes remove MOTORS. Step, direction and enable are numbers of the registers' outputs,
of which heaters and fans stay off. Inputs are ESP32 pins; the probe's (MT_DET) has its resistor on
the board. The spindle or laser is at the servo output of the 3D-touch connector. Pins are from
Marlin's pin list for the board, and grblHAL's agrees. Its ESP32 has no PSRAM: see mks_dlc32.py.
Never ran on hardware.
"""

MPY_ARCH = "xtensawin"
ENGINE = "i2s"
LINK = "uart"

MOTORS = "XYZYZ"
STEP = (1, 4, 7, 10, 13)
DIR = (2, 5, 8, 11, 14)
ENABLE = (0, 3, 6, 9, 12)
I2S = (25, 26, 27)  # BCK, WS, DATA
# See mks_dlc32.py.
I2S_RATE_HZ = 125_000
I2S_BUFFERS = 16

LIMIT = (33, 32, 22)
PROBE = 35
SPINDLE_PWM = 2
NO_PULL_UP = (35,)

MAX_STEP_RATE_HZ = 41_666

PLANNER_BLOCKS = 64
RX_BYTES = 128
PWM_MAX = 1000
