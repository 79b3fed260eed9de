"""Layout: what stands where in the engine state, the one array that the PIO engine's leaves work
on.

Lanes and timing, which the engine state has the addresses of, are told in pulses.py; what chips
call their registers, in registers.py.
"""

from micropython import const

# Whether the chip may be an RP2350, which has a third PIO: a build for an RP2040 has 0 here
# (tools/compiling/for_chip.py), and nothing of what that takes.
RP2350 = const(1)

HALF_TICKS_PER_US = const(25)
ROWS = const(16)  # segments made, and not yet played
LAST_ROW = const(15)
CLOCK = const(3)  # the clock's machine, of PIO 1, or PIO 2 where an eighth lane has that one
CLOCK_FIFO = const(4)  # words that it may be given ahead
BEFORE_CLOCK = const(7)  # lanes that leave it to the clock
# Lane 4 has the first machine of PIO 1, as MicroPython counts them.
BLOCK_LOG2 = const(2)
IN_BLOCK = const(3)

# First the engine's state …
RUNNING = const(0)  # machines are enabled
HALT = const(1)  # stopped: nothing moves before arm()
MADE = const(2)  # segments made, since power-up
FED = const(3)  # segments handed to the hardware
BEGUN = const(4)  # the segment that runs
AHEAD = const(5)  # ticks made behind it
POWER = const(6)  # spindle power told last
LOCKED = const(7)  # mask of lanes that stand still
END_US = const(8)  # when the words end, in us and half ticks
END_REST = const(9)
CUT = const(10)  # where in a long segment the next piece begins; 0: there is none
BEATS = const(11)  # words handed to the clock, since power-up
EARLY = const(12)  # the clock will call again before the running segment ends
AXES = const(13)
# … then registers, which depend on the chip …
PIO0 = const(14)
PIO1 = const(15)
TIMER = const(16)
NVIC = const(17)
RIVALS = const(18)  # masks: interrupts in which the engine is stopped, and its own;
BUSY = const(19)  # a channel has words to move
MOTORS = const(20)  # lanes whose steps are those of motors
CLOCK_AT = const(21)  # where the clock waits for a word
OURS = const(22)  # masks: the machines of PIO 0 and of PIO 1 that play our words
# (of PIO 2: THIRD)
# … and memory.
LANES = const(24)
WORDS = const(25)
TIMING = const(26)
CLOCKED = const(27)  # words for the clock
WHOLE = const(28)  # a long segment, made in pieces
ROW = const(29)  # a row per segment
FAULT = const(ROW + ROWS)  # what has gone wrong (stops.py), until arm()
ASKED = const(ROW + ROWS + 1)  # start() waits for the interrupt
DMA = const(ROW + ROWS + 2)  # a channel per lane, which end the engine state of an RP2040
# An RP2350's goes on: the machines of PIO 2 that are ours, none but the clock; and where the
# clock's PIO is.
THIRD = const(DMA + 8)
CLOCK_PIO = const(THIRD + 1 if RP2350 else PIO1)
LENGTH = const(THIRD + 2)

# Behind a segment's row: when it begins, us and half ticks; the clock's word with which it
# ends; and where it begins, per axis.
ROW_EXTRA = const(3)

# What may be wrong: trouble().
RAISED = const(1)  # the interrupt has met an exception
LOST = const(2)  # a word has come to a FIFO that was full
JAMMED = const(3)  # DMA does not move on
UNHEARD = const(4)  # the interrupt does not come
BEHIND = const(5)  # words should have been played long since
