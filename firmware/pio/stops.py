# mypy: disable-error-code=arg-type
"""Stop, start and position: the other kernels that work on the engine state (engine_state.py).

They may be called in any interrupt, also in one that has interrupted the engine's own. Sections
that must not be interrupted mask all these interrupts, for a few microseconds.

`state` is the engine state, indexed by the constants of state_layout.py. Segments are numbered
from power-up: MADE of them have been made, FED handed to the hardware, and BEGUN is the number of
the one being played. HALT is 1 from a stop until arm(). RUNNING is 1 while the machines are
enabled. LOCKED is a mask of lanes that were stopped while the others go on. OURS_0, OURS_1 and
OURS_2 are masks of this engine's machines in PIO 0, 1 and 2. MASKED_IRQS is a mask of interrupts.
END_US is the time (us of the timer) at which all words handed over end. A register at + CLEAR is
an alias in which ones clear bits. FAULT is a fault code, until arm().

A lane, one per motor, has LANE integers in `lanes` (pulses.py). Three are positions, in steps:
MADE_PLACE at the end of all segments made, SENT_PLACE at the end of all words handed to its
machine, STOPPED_PLACE where it was stopped. SENT is the index after the last word handed over, in
the lane's ring.
"""

import micropython
from base.times import MASK, NEGATIVE
from micropython import const
from motion.layout import ROW_AXES, ROW_STRIDE

from pio import registers as reg
from pio import state_layout as s
from pio.pulses import LANE, MACHINE, MADE_PLACE, SENT, SENT_PLACE, STOPPED_PLACE, places, undone

# PIO instructions that are forced into a machine.
_SAVE_X = const(0xA0C1)  # mov isr, x
_PUSH = const(0x8000)  # push noblock
_FIFO_WORDS = const(4)  # words that a FIFO holds
_TX_LEVEL = const(15)  # FLEVEL has 8 bits per machine: the lower four are its TX FIFO's words
_ADDRESS = const(31)  # a program's address has five bits
_LONGEST_US = const(1 << 20)  # no row is that long

_PATIENCE_US = const(50_000)  # the interrupt may be so late: writing a flash page takes less


@micropython.viper
def _stopped_position(state: ptr32, axis: int) -> int:
    """Return the position of a lane's motor, whose machine has just been stopped, in steps.

    It is the position at the end of all words sent, less the steps not made: those of words in
    DMA and in the FIFO, and those left of the word in the machine. X, which counts them, is read
    by pushing it into the machine's RX FIFO.

    state: the engine state; axis: the lane's number. If DMA makes no progress, FAULT is JAMMED.
    """
    pio = ptr32(state[s.PIO0 + (axis >> s.BLOCK_LOG2)])
    number = axis & s.IN_BLOCK
    dma = ptr32(state[s.DMA + axis])
    lanes = ptr32(state[s.LANES])
    player = ptr32(lanes[LANE * axis + MACHINE])  # registers of the lane's machine
    position_at_end = lanes[LANE * axis + SENT_PLACE]
    if state[s.RUNNING] == 0:
        return position_at_end
    player[reg.INSTR] = _SAVE_X
    # A word between DMA and FIFO is counted nowhere: wait until DMA has no more words, or the FIFO
    # is full.
    busy = 1
    waiting = 0
    patience = 100  # readings: the loop ends also if DMA is stuck
    while busy and waiting < _FIFO_WORDS and patience:
        busy = dma[reg.STATUS] & state[s.BUSY]
        waiting = (pio[reg.FLEVEL] >> 8 * number) & _TX_LEVEL
        patience -= 1
    unmoved = dma[reg.COUNT] if busy else 0  # words still in memory
    if patience == 0:
        state[s.FAULT] = s.JAMMED
    address = player[reg.ADDR] - ((player[reg.EXECCTRL] >> 7) & _ADDRESS)  # in the program
    player[reg.INSTR] = _PUSH
    sent = lanes[LANE * axis + SENT]
    x = pio[reg.RXF + number]
    left = int(undone(state[s.WORDS], axis, sent, waiting + unmoved, address, x))  # steps
    return position_at_end - left


@micropython.viper
def halt(state: ptr32, which: int) -> int:
    """Stop the machines of the lanes in the mask `which`; store where they are in STOPPED_PLACE.

    These lanes stay locked until all are stopped. -1 stops all until arm(), and ends the locks.
    Nothing may raise here. Once compiled, it is one function that calls no other. Returns 0.
    """
    axes = state[s.AXES]
    lanes = ptr32(state[s.LANES])
    nvic = ptr32(state[s.NVIC])
    if which < 0:
        state[s.HALT] = 1  # first: an interrupt that comes in between then starts nothing
    nvic[reg.DISABLE] = state[s.MASKED_IRQS]
    ptr32(state[s.PIO0])[reg.CTRL + reg.CLEAR] = which & state[s.OURS_0]
    ptr32(state[s.PIO1])[reg.CTRL + reg.CLEAR] = (which >> 4) & state[s.OURS_1]
    if s.RP2350 and which < 0 and state[s.OURS_2]:  # only the clock is there
        ptr32(state[s.CLOCK_PIO])[reg.CTRL + reg.CLEAR] = state[s.OURS_2]
    which &= -1 - state[s.LOCKED]  # the positions of locked lanes are in STOPPED_PLACE already
    for i in range(axes):
        if (which >> i) & 1:
            lanes[LANE * i + STOPPED_PLACE] = int(_stopped_position(state, i))
    if which >= 0:
        state[s.LOCKED] = state[s.LOCKED] | which
    else:  # what was sent and not played will not be played
        for i in range(axes):
            lanes[LANE * i + SENT_PLACE] = lanes[LANE * i + STOPPED_PLACE]
        if state[s.RUNNING]:
            state[s.END_US] = ptr32(state[s.TIMER])[0] & MASK
        state[s.RUNNING] = 0
        state[s.LOCKED] = 0
    nvic[0] = state[s.MASKED_IRQS]  # enables these interrupts again
    return 0


@micropython.viper
def request_refill(state: ptr32) -> int:
    """Trigger the engine's interrupt, unless the engine is stopped. Returns 0.

    REQUESTED stays 1 until the interrupt has come; fault_code() reports one that does not.
    """
    if state[s.HALT] == 0:
        state[s.REQUESTED] = 1
        ptr32(state[s.CLOCK_PIO])[reg.IRQ_FORCE] = 1 << s.CLOCK  # the flag that the clock sets
    return 0


@micropython.viper
def arm(state: ptr32) -> int:
    """End a stop: clear faults and drop the segments that were not handed over. Returns 0.

    Motion is possible again, from the positions where the motors have stopped. Without a stop
    nothing changes.
    """
    axes = state[s.AXES]
    lanes = ptr32(state[s.LANES])
    if state[s.HALT] == 0:
        return 0
    state[s.MADE] = state[s.FED]  # counts of segments: none waits to be handed over,
    state[s.BEGUN] = state[s.FED] - 1  # and the last one handed over has begun
    state[s.TICKS_AHEAD] = 0  # ticks of motion made after that one
    state[s.NEXT_PIECE] = 0  # no long segment is half made
    for i in range(axes):
        # Positions in steps: where the motor has stopped, which halt() has put into SENT_PLACE.
        lanes[LANE * i + MADE_PLACE] = lanes[LANE * i + SENT_PLACE]
    # FDEBUG's flags of words that were lost: writing ones clears them.
    ptr32(state[s.PIO0])[reg.FDEBUG] = state[s.OURS_0] << reg.TXOVER
    ptr32(state[s.PIO1])[reg.FDEBUG] = state[s.OURS_1] << reg.TXOVER
    if s.RP2350 and state[s.OURS_2]:
        ptr32(state[s.CLOCK_PIO])[reg.FDEBUG] = state[s.OURS_2] << reg.TXOVER
    state[s.FAULT] = 0
    state[s.REQUESTED] = 0
    state[s.HALT] = 0
    return 0


@micropython.viper
def fault_code(state: ptr32) -> int:
    """Return the fault code of state_layout.py, 0 if there is no fault. Main loop only: a
    requested interrupt comes before the main loop continues.

    FAULT holds a fault that the interrupt has found. Further ones are looked for here: a word
    written to a full FIFO, an interrupt that was requested and has not come, and machines that
    should have run out of words long ago.
    """
    if state[s.FAULT]:
        return state[s.FAULT]
    # Masks of machines that have lost a word.
    lost = (ptr32(state[s.PIO0])[reg.FDEBUG] >> reg.TXOVER) & state[s.OURS_0]
    if s.RP2350 and state[s.OURS_2]:
        lost |= (ptr32(state[s.CLOCK_PIO])[reg.FDEBUG] >> reg.TXOVER) & state[s.OURS_2]
    if lost | (ptr32(state[s.PIO1])[reg.FDEBUG] >> reg.TXOVER) & state[s.OURS_1]:
        return s.LOST
    if state[s.REQUESTED]:
        return s.UNHEARD
    if state[s.RUNNING]:
        # END_US is read first: an interrupt in between can then only make `late` smaller.
        end = state[s.END_US]
        late = ((ptr32(state[s.TIMER])[0] & MASK) - end) & MASK
        if late >= _PATIENCE_US and late < NEGATIVE:
            return s.TOO_LATE
    return 0


@micropython.viper
def position(state: ptr32, steps: ptr32) -> int:
    """Copy the present position of each motor, in steps, into `steps`. Returns 0.

    During motion it follows from the row of the segment that has begun last, and the time since
    then; a locked motor is where it has stopped.
    """
    motors = state[s.MOTORS]
    lanes = ptr32(state[s.LANES])
    # Index in a row of its begin: us, then half ticks; its start positions follow (ROW_EXTRA).
    begins = ROW_AXES + ROW_STRIDE * state[s.AXES]
    locked = state[s.LOCKED]  # read now, because stop() may come in between
    if state[s.RUNNING] == 0:
        for i in range(motors):
            steps[i] = lanes[LANE * i + SENT_PLACE]
    else:
        now = ptr32(state[s.TIMER])[0] & MASK
        fed = state[s.FED]
        # Find the newest row that has begun, from the last one handed over on.
        passed = NEGATIVE  # us since the row began; from NEGATIVE on it has not begun
        rows_back = 0
        while passed >= NEGATIVE and rows_back < s.LAST_ROW:
            rows_back += 1
            row = ptr32(state[s.ROW + ((fed - rows_back) & s.LAST_ROW)])
            passed = (now - row[begins]) & MASK
        tick = -1  # ticks since the row began; -1: it has not begun yet
        if passed < NEGATIVE:
            if passed > _LONGEST_US:
                passed = _LONGEST_US  # or the product wraps
            tick = (passed * s.HALF_TICKS_PER_US - row[begins + 1]) >> 1
        start = int(row) + 4 * (begins + s.ROW_EXTRA)  # type: ignore[call-overload]
        places(row, tick, start, steps, motors)  # start: address of the row's start positions
    for i in range(motors):
        if (locked >> i) & 1:
            steps[i] = lanes[LANE * i + STOPPED_PLACE]
    return 0
