"""ESP32 with PSRAM in the shape of an Uno (ESPDUINO-32 with a WROVER) under a CNC shield V3.

The shield's pins by their Arduino names: step D2-D4, direction D5-D7, enable D8, limits D9, D10
and D12, spindle D11 and D13, hold A1, start A2, probe A5. An ESP32 DevKit can be wired in the same
way.

Pins 17 and 16, at D4 and D5, belong to the PSRAM of a WROVER. Without PSRAM there is too little
memory (docs/esp32.md). Bend these two pins aside; wire the shield's D4 to SCL and its D5 to SDA.
A2 and A5 need pull-up resistors of 10 kOhm to 3.3 V. A3, the shield's coolant, cannot be an
output. Pin 12 (enable) sets the flash's voltage at reset. The shield's pull-up there (10 kOhm
from EN to its supply) keeps an ESP32 from starting: remove the resistor, or wire enable to another
pin. Runs emulated; never ran on hardware.
"""

MPY_ARCH = "xtensawin"
ENGINE = "rmt"
LINK = "uart"

STEP = (26, 25, 22)
DIR = (21, 27, 14)
ENABLE = 12
LIMIT = (13, 5, 19)
PROBE = 39
# Reset, hold, start, door. A0, the shield's reset, is pin 2, with an LED on it: not used.
CONTROL = (None, 4, 35, None)
SPINDLE_PWM = 23
SPINDLE_DIR = 18
NO_PULL_UP = (35, 39)

# Between two trains of pulses there is a gap: about 0.2 ms if one axis moves, 0.5 ms if three do
# [estimated]. Up to 2000 steps/s (one axis: 4000) it fits between two steps. Above that, motion
# pauses briefly every 16 ms; at 5000 steps/s for less than two steps.
MAX_STEP_RATE_HZ = 5000

# Small moves at high speed need a long look-ahead; this chip has the memory for it.
PLANNER_BLOCKS = 64
RX_BYTES = 128
PWM_MAX = 1000
