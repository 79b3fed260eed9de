"""The simulator with a TMC2209 driver for each motor, on a serial line: see docs/drivers.md."""

from boards.sim import *  # noqa: F403

TMC2209 = (0, 2, 1)
TMC_UART = (8, 9)
