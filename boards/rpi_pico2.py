"""Raspberry Pi Pico 2 (RP2350): as rpi_pico.py. Runs emulated; never ran on hardware."""

CHIP = "pico2"
MPY_ARCH = "armv7emsp"
ENGINE = "pio"
LINK = "usb"

STEP = (2, 3, 4)
DIR = (5, 6, 7)
ENABLE = 8
LIMIT = (9, 10, 11)
PROBE = 12
# Reset, hold, start, door.
CONTROL = (13, 14, 15, None)
SPINDLE_PWM = 16
SPINDLE_DIR = 17
FLOOD = 18
# Grounded at power-up: MicroPython's prompt starts instead of the machine.
REPL_PIN = 22

# Small moves at high speed need a long look-ahead; this chip has the memory for it.
PLANNER_BLOCKS = 64
RX_BYTES = 255
PWM_MAX = 1000
