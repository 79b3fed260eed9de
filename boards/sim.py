"""The simulator as a board: an Arduino Uno's buffers, so that senders see Grbl's numbers."""

ENGINE = "sim"
STEP = (0, 1, 2)
PWM_MAX = 255
# Segments of 10 ms queued for the pulses: as many as Grbl's, so that holds come as late as its.
SEGMENT_QUEUE = 5
# How long an Uno works on a line, and on a turn of its main loop while it moves.
ANSWER_US = 900
LOOP_US = 200
# And on the segments that it prepares before it starts.
START_US = 1050
PLANNER_BLOCKS = 16
RX_BYTES = 128
