"""MKS DLC32 V2.0 and V2.1: an ESP32 with three drivers on a shift register, and a laser.

Step, direction and enable are numbers of the shift register's outputs. Inputs are ESP32 pins
with resistors on the board. Pins are from the maker's list for V2.1; V1.x has its laser at 22 and
its probe at 2. The board's ESP32 has no PSRAM, so it has too little memory for this firmware,
which says so instead of starting (docs/esp32.md). This file is for a board with another module,
or for firmware that has been made smaller. Never ran on hardware.
"""

MPY_ARCH = "xtensawin"
ENGINE = "i2s"
LINK = "uart"

STEP = (1, 5, 3)
DIR = (2, 6, 4)
ENABLE = 0
I2S = (16, 17, 21)  # BCK, WS, DATA
# Frames per second. A step takes one high frame per 8 us of $0, and one low frame.
I2S_RATE_HZ = 125_000
# DMA buffers of 2 ms. All of them, less 4 ms, is motion made in advance; a hold waits for it.
I2S_BUFFERS = 16

LIMIT = (36, 35, 34)
PROBE = 22
SPINDLE_PWM = 32  # the laser's TTL and its MOSFET
NO_PULL_UP = (34, 35, 36)

# For pulses of up to 16 us, which take two frames: steps are then 24 us apart.
MAX_STEP_RATE_HZ = 41_666

# Small moves at high speed need a long look-ahead; this chip has the memory for it.
PLANNER_BLOCKS = 64
RX_BYTES = 128
PWM_MAX = 1000
