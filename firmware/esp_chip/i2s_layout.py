"""Layout: places (indexes) in the arrays of the I2S engine; frames.py uses them, too.

Buffers are counted twice: those of our own ring since power-up (MADE, SENT), and all of a stream,
also those in which zeros were played, since it was opened (PLAYING, WRITTEN, LAST, NUMBER).
"""

from micropython import const

# State. Flags are 0 or 1.
HALT = const(0)  # flag: the timer's turn must do nothing: the main loop, or a stop, is at work
PULLING = const(1)  # flag: there may be more segments
ROW = const(2)  # flag: a row is being rendered
PLAYING = const(3)  # number of the buffer being played,
BEGAN = const(4)  # and its start, in us
WRITTEN = const(5)  # number of the next buffer to be handed over
MADE = const(6)  # how many buffers were filled since power-up
SENT = const(7)  # and how many of them were handed over
MOVED = const(8)  # value of MADE after the last buffer of motion
LAST = const(9)  # number of the last buffer of motion that was handed over
PAUSE = const(10)  # flag: a buffer without steps must be sent first
REPORTED = const(11)  # last spindle power reported
DRY = const(12)  # how often the stream had no data during motion
LATEST = const(13)  # spindle power of the newest row; at the end of motion of the last one
STOPPED = const(14)  # flag: stopped, until arm()
MOVING = const(15)  # flag: the machine is not idle
STALE = const(16)  # flag: flash was written since the stream was opened
TAKEN = const(17)  # when the stream accepted its last buffer, in us
STATE_LENGTH = const(18)

# Notes of a buffer; after these, per axis, the position at its start.
NUMBER = const(0)
START = const(1)  # its first word, without steps
POWER = const(2)  # spindle power while it is played; -1: unknown
MOVES = const(3)  # 1: it is part of a motion
NOTE = const(4)

# Results of frames.playing_slot() that are no slot: zeros are played before that slot's buffer;
# and before a buffer that is not filled yet.
BEFORE = const(1000)
NOWHERE = const(-2000)
