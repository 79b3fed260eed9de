"""The simulator as a board: an Arduino Uno's buffers, so that senders see Grbl's numbers."""

ENGINE = "sim"
STEP = (0, 1, 2)
PWM_MAX = 255
# Segments of 10 ms queued for the pulses: Grbl's number, so that holds take effect as late.
SEGMENT_QUEUE = 5
# An Uno's time for a line, and for a turn of its main loop during motion.
ANSWER_US = 900
LOOP_US = 200
# Its time for the segments that it prepares before a start.
START_US = 1050
PLANNER_BLOCKS = 16
RX_BYTES = 128
