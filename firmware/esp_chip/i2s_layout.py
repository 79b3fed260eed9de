"""Layout: places (indexes) in the arrays of the I2S engine; frames.py uses them, too.

Buffers are counted twice: those of our own ring since power-up (MADE, SENT), and all of a stream,
also those in which zeros were played, since it was opened (PLAYING, NEXT_NUMBER,
LAST_MOTION_NUMBER, NUMBER).
"""

from micropython import const

# State. Flags are 0 or 1.
KEEP_TIMER_OUT = const(0)  # flag: the timer's turn must do nothing, because other code is at work
PULLING = const(1)  # flag: there may be more segments
ROW_BEGUN = const(2)  # flag: a row is being rendered
PLAYING = const(3)  # number of the buffer being played
PLAYING_SINCE = const(4)  # start of that buffer, in us
NEXT_NUMBER = const(5)  # number of the next buffer to be handed over
MADE = const(6)  # how many buffers were filled since power-up
SENT = const(7)  # how many buffers were handed over
MOTION_END = const(8)  # value of MADE after the last buffer of motion
LAST_MOTION_NUMBER = const(9)  # number of the last buffer of motion handed over; -1: none
QUIET_DUE = const(10)  # flag: a quiet buffer, without steps, must be sent first
REPORTED_POWER = const(11)  # last spindle power reported; -1: none
UNDERRUNS = const(12)  # how often the stream had no data during motion
NEWEST_POWER = const(13)  # spindle power of the newest row; at the end of motion of the last one
STOPPED = const(14)  # flag: stopped, until arm()
MOVING = const(15)  # flag: the machine is not idle
FLASH_WRITTEN = const(16)  # flag: flash was written since the stream was opened
LAST_WRITE_US = const(17)  # when the stream accepted its last buffer, in us
STATE_LENGTH = const(18)

# Notes of a buffer; after these, per axis, the position at its start.
NUMBER = const(0)
FIRST_WORD = const(1)  # first word of the buffer, without steps
POWER = const(2)  # spindle power while it is played; -1: unknown
HAS_MOTION = const(3)  # 1: it is part of a motion
START_PLACES = const(4)  # from here on, the positions at its start

# Results of frames.playing_slot() that are no slot: zeros are played before that slot's buffer;
# and before a buffer that is not filled yet.
ZEROS_BEFORE = const(1000)  # the result is less than the slot by this
NOT_FILLED = const(-2000)
