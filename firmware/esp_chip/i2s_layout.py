"""Layout: what stands where in what the I2S engine remembers; frames.py works on it, too."""

from micropython import const

# State.
HALT = const(0)  # hands off: the main loop, or a stop, is at work
PULLING = const(1)  # there may be more segments
ROW = const(2)  # a row is being rendered
PLAYING = const(3)  # number of the buffer being played,
BEGAN = const(4)  # and when that began, in us
WRITTEN = const(5)  # the number that the next buffer handed over will have
MADE = const(6)  # buffers filled since power-up
SENT = const(7)  # and handed over
MOVED = const(8)  # how many there had been with the last one of motion
LAST = const(9)  # number of the last one of motion that was handed over
PAUSE = const(10)  # a buffer without steps has to come first
TOLD = const(11)  # spindle power told last
DRY = const(12)  # how often the stream has run dry while the machine moved
LATEST = const(13)  # spindle power of the newest row, which is the last one in the end
STOPPED = const(14)  # until arm()
MOVING = const(15)  # the machine is not at rest
STALE = const(16)  # flash has been written to since the stream was opened
TAKEN = const(17)  # when the stream has taken a buffer last, in us
STATE_LENGTH = const(18)

# What is remembered of a buffer; behind these, per axis, the position as it begins.
NUMBER = const(0)
START = const(1)  # its first word, without steps
POWER = const(2)  # spindle power as it is played; -1: not known
MOVES = const(3)  # it is part of a motion
NOTE = const(4)

# Slots that are none.
BEFORE = const(1000)
NOWHERE = const(-2000)
