"""Layout of the engine state: the one array that the kernels of the PIO engine work on.

RUNNING to CLOCK_PIO are indexes in that array; a comment says what the element there holds.
Lanes and timing, whose addresses the engine state holds, are described in pulses.py, the chips'
registers in registers.py.
"""

from micropython import const

# Whether the chip may be an RP2350, which has a third PIO. A build for an RP2040 sets 0 here
# (tools/compiling/build.py), and the code for a third PIO is left out.
RP2350 = const(1)

HALF_TICKS_PER_US = const(25)  # a tick is 80 ns
ROWS = const(16)  # segments that may wait to be played
LAST_ROW = const(15)
CLOCK = const(3)  # the clock's machine: of PIO 1, or of PIO 2 if an eighth lane has that one
CLOCK_FIFO = const(4)  # words that its FIFO holds
BEFORE_CLOCK = const(7)  # with up to so many lanes the clock is on PIO 1
# A lane's PIO is lane >> 2, its machine lane & 3: lane 4 has the first machine of PIO 1, as
# MicroPython counts them.
BLOCK_LOG2 = const(2)
IN_BLOCK = const(3)

# First the engine's state ...
RUNNING = const(0)  # the machines are enabled
HALT = const(1)  # stopped: nothing moves before arm()
MADE = const(2)  # how many segments were made, since power-up
FED = const(3)  # how many of them were handed to the hardware
BEGUN = const(4)  # number of the segment that is played; the first one made is 0
TICKS_AHEAD = const(5)  # ticks of motion made after the begin of segment BEGUN
POWER = const(6)  # the last spindle power reported
LOCKED = const(7)  # mask of lanes that are locked: stopped, while others may go on
END_US = const(8)  # when the words handed over end: in us of the timer
END_REST = const(9)  # half ticks, in addition to END_US
NEXT_PIECE = const(10)  # tick in a long segment where the next piece begins; 0: no long segment
CLOCK_WORDS = const(11)  # words handed to the clock, since power-up
WORDS_TO_END = const(12)  # clock words left of BEGUN: > 0: it interrupts again before its end
AXES = const(13)  # number of lanes
# ... then registers, which depend on the chip ...
PIO0 = const(14)
PIO1 = const(15)
TIMER = const(16)
NVIC = const(17)
MASKED_IRQS = const(18)  # mask for NVIC: interrupts that may stop the engine, and its own
BUSY = const(19)  # mask of STATUS: a channel has words to move
MOTORS = const(20)  # number of lanes that are motors'
CLOCK_PULL_AT = const(21)  # program address at which the clock waits for a word
OURS_0 = const(22)  # mask of our state machines of PIO 0
OURS_1 = const(23)  # mask of our state machines of PIO 1
LANES = const(24)  # addresses of arrays in pulses.py: lanes, the lanes' rings of words, timing
WORDS = const(25)
TIMING = const(26)
# Addresses of: words for the clock; a copy of a long segment's row, which is made in pieces; and,
# from ROW on, a row per segment, ROWS of them: segment n has the row at ROW + n % ROWS.
CLOCK_BUFFER = const(27)
LONG_ROW = const(28)
ROW = const(29)
FAULT = const(ROW + ROWS)  # fault code (below), until arm()
REQUESTED = const(ROW + ROWS + 1)  # 1: start() has requested the interrupt, not yet come
DMA = const(ROW + ROWS + 2)  # address of a DMA channel, per lane
# An RP2040's engine state ends here. An RP2350's goes on: the mask of our machines of PIO 2, which
# is the clock's or 0; and the address of the clock's PIO.
OURS_2 = const(DMA + 8)
CLOCK_PIO = const(OURS_2 + 1 if RP2350 else PIO1)
LENGTH = const(OURS_2 + 2)

# After a segment's row: when it begins, in us and half ticks; the value of CLOCK_WORDS when it
# ends; and its start position per axis.
ROW_EXTRA = const(3)

# Fault codes: fault_code().
RAISED = const(1)  # the interrupt raised an exception
LOST = const(2)  # a word was written to a full FIFO
JAMMED = const(3)  # DMA makes no progress
UNHEARD = const(4)  # the interrupt did not come
TOO_LATE = const(5)  # the words should have ended long ago
