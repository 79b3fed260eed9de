"""ESP32-S3 DevKitC with native USB, three stepper drivers on separate pins.

Connect the sender to the S3's own USB socket, not to the UART's. All pins are free on
the DevKitC-1, with or without octal PSRAM. Never ran on hardware.
"""

CHIP = "esp32s3"
MPY_ARCH = "xtensawin"
ENGINE = "rmt"
LINK = "uart"  # stdin and stdout are the native USB, which makes the sender wait

STEP = (4, 5, 6)
DIR = (7, 15, 16)
ENABLE = 17
LIMIT = (9, 10, 11)
PROBE = 12
# Reset, hold, start, door.
CONTROL = (13, 14, 21, None)
SPINDLE_PWM = 18
SPINDLE_DIR = 8
FLOOD = 1
NO_PULL_UP = ()

# As on the ESP32, see esp32_devkit.py. But a channel holds 47 steps here, so motion pauses briefly
# every 8 ms at this rate.
MAX_STEP_RATE_HZ = 5000

# Small moves at high speed need a long look-ahead; this chip has the memory for it.
PLANNER_BLOCKS = 64
RX_BYTES = 128
PWM_MAX = 1000
