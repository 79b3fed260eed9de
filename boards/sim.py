"""The simulator as a board: an Arduino Uno's buffers, so that senders see the numbers of real Grbl."""

ENGINE = "sim"
STEP = (0, 1, 2)
PWM_MAX = 255
# Segments queued ahead of the pulses: as far as Grbl looks ahead, 45 ms, so that holds come as late as its.
SEGMENT_QUEUE = 8
PLANNER_BLOCKS = 16
RX_BYTES = 128
