"""The simulator as a board: an Arduino Uno's buffers, so that senders see the numbers of real Grbl."""

ENGINE = "sim"
STEP = (0, 1, 2)
PWM_MAX = 255
# Segments of 10 ms queued for the pulses: as many as Grbl's, so that holds come as late as its.
SEGMENT_QUEUE = 5
# Steps in a segment at the least, as Grbl's: slow segments are lengthened.
SEGMENT_STEPS = 1.25
PLANNER_BLOCKS = 16
RX_BYTES = 128
