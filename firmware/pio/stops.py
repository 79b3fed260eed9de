# mypy: disable-error-code=arg-type
"""Stop, start and position: the other kernels that work on the engine state (engine_state.py).

They may be called in any interrupt, also in one that has interrupted the engine's own. Sections
that must not be interrupted mask all these interrupts, for a few microseconds.
"""

import micropython
from base.times import MASK, NEGATIVE
from micropython import const
from motion.layout import ROW_AXES, ROW_STRIDE

from pio.hub_layout import (
    AHEAD,
    ASKED,
    AXES,
    BEGUN,
    BEHIND,
    BLOCK_LOG2,
    BUSY,
    CLOCK,
    CLOCK_PIO,
    CUT,
    DMA,
    END_US,
    FAULT,
    FED,
    HALF_TICKS_PER_US,
    HALT,
    IN_BLOCK,
    JAMMED,
    LANES,
    LAST_ROW,
    LOCKED,
    LOST,
    MADE,
    MOTORS,
    NVIC,
    OURS,
    PIO0,
    PIO1,
    RIVALS,
    ROW,
    ROW_EXTRA,
    RP2350,
    RUNNING,
    THIRD,
    TIMER,
    UNHEARD,
    WORDS,
)
from pio.pulses import END, FROZEN, LANE, MACHINE, PLACE, SENT, places, undone
from pio.registers import (
    ADDR,
    CLEAR,
    COUNT,
    CTRL,
    DISABLE,
    EXECCTRL,
    FDEBUG,
    FLEVEL,
    INSTR,
    IRQ_FORCE,
    RXF,
    STATUS,
    TXOVER,
)

# PIO instructions that are forced into a machine: mov isr, x; push noblock.
_SAVE_X = const(0xA0C1)
_PUSH = const(0x8000)
_FIFO = const(4)  # words that a FIFO holds

# The interrupt may be late by so much: writing a flash page takes less.
_PATIENCE_US = const(50_000)


@micropython.viper
def _stopped_position(state: ptr32, axis: int) -> int:
    """Return the position of a machine that has just been stopped."""
    pio = ptr32(state[PIO0 + (axis >> BLOCK_LOG2)])
    number = axis & IN_BLOCK
    dma = ptr32(state[DMA + axis])
    lanes = ptr32(state[LANES])
    player = ptr32(lanes[LANE * axis + MACHINE])
    end = lanes[LANE * axis + END]
    if state[RUNNING] == 0:
        return end
    player[INSTR] = _SAVE_X
    # A word between DMA and FIFO is counted nowhere: wait until DMA has no more words, or the FIFO
    # is full.
    busy = 1
    waiting = 0
    patience = 100
    while busy and waiting < _FIFO and patience:
        busy = dma[STATUS] & state[BUSY]
        waiting = (pio[FLEVEL] >> 8 * number) & 15
        patience -= 1
    left = dma[COUNT] if busy else 0
    if patience == 0:
        state[FAULT] = JAMMED
    at = player[ADDR] - ((player[EXECCTRL] >> 7) & 31)
    player[INSTR] = _PUSH
    sent = lanes[LANE * axis + SENT]
    x = pio[RXF + number]
    return end - int(undone(state[WORDS], axis, sent, waiting + left, at, x))


@micropython.viper
def halt(state: ptr32, which: int) -> int:
    """Stop the machines of these lanes (a mask), positions as they are; -1: all, until arm().

    Nothing may raise here. Once compiled, it is one function that calls no other.
    """
    axes = state[AXES]
    lanes = ptr32(state[LANES])
    nvic = ptr32(state[NVIC])
    if which < 0:
        state[HALT] = 1  # first: an interrupt that comes in between then starts nothing
    nvic[DISABLE] = state[RIVALS]
    ptr32(state[PIO0])[CTRL + CLEAR] = which & state[OURS]
    ptr32(state[PIO1])[CTRL + CLEAR] = (which >> 4) & state[OURS + 1]
    if RP2350 and which < 0 and state[THIRD]:
        ptr32(state[CLOCK_PIO])[CTRL + CLEAR] = state[THIRD]
    which &= -1 - state[LOCKED]
    for i in range(axes):
        if (which >> i) & 1:
            lanes[LANE * i + FROZEN] = int(_stopped_position(state, i))
    if which >= 0:
        state[LOCKED] = state[LOCKED] | which
    else:
        for i in range(axes):
            lanes[LANE * i + END] = lanes[LANE * i + FROZEN]
        if state[RUNNING]:
            state[END_US] = ptr32(state[TIMER])[0] & MASK
        state[RUNNING] = 0
        state[LOCKED] = 0
    nvic[0] = state[RIVALS]
    return 0


@micropython.viper
def request_refill(state: ptr32) -> int:
    """Trigger the engine's interrupt, unless the engine is stopped."""
    if state[HALT] == 0:
        state[ASKED] = 1
        ptr32(state[CLOCK_PIO])[IRQ_FORCE] = 1 << CLOCK
    return 0


@micropython.viper
def arm(state: ptr32) -> int:
    """Clear faults and drop the segments that were not handed over: motion is possible again."""
    axes = state[AXES]
    lanes = ptr32(state[LANES])
    if state[HALT] == 0:
        return 0
    state[MADE] = state[FED]
    state[BEGUN] = state[FED] - 1
    state[AHEAD] = 0
    state[CUT] = 0
    for i in range(axes):
        lanes[LANE * i + PLACE] = lanes[LANE * i + END]
    # Ones clear these bits.
    ptr32(state[PIO0])[FDEBUG] = state[OURS] << TXOVER
    ptr32(state[PIO1])[FDEBUG] = state[OURS + 1] << TXOVER
    if RP2350 and state[THIRD]:
        ptr32(state[CLOCK_PIO])[FDEBUG] = state[THIRD] << TXOVER
    state[FAULT] = 0
    state[ASKED] = 0
    state[HALT] = 0
    return 0


@micropython.viper
def fault_code(state: ptr32) -> int:
    """Return the fault code, 0 if there is no fault. Main loop only."""
    if state[FAULT]:
        return state[FAULT]
    over = (ptr32(state[PIO0])[FDEBUG] >> TXOVER) & state[OURS]
    if RP2350 and state[THIRD]:
        over |= (ptr32(state[CLOCK_PIO])[FDEBUG] >> TXOVER) & state[THIRD]
    if over | (ptr32(state[PIO1])[FDEBUG] >> TXOVER) & state[OURS + 1]:
        return LOST
    if state[ASKED]:
        return UNHEARD
    if state[RUNNING]:
        # END_US is read first: an interrupt in between can then only make `late` smaller.
        end = state[END_US]
        late = ((ptr32(state[TIMER])[0] & MASK) - end) & MASK
        if late >= _PATIENCE_US and late < NEGATIVE:
            return BEHIND
    return 0


@micropython.viper
def position(state: ptr32, steps: ptr32) -> int:
    """Copy the present position of each motor, in steps."""
    motors = state[MOTORS]
    lanes = ptr32(state[LANES])
    begins = ROW_AXES + ROW_STRIDE * state[AXES]
    locked = state[LOCKED]  # read now, because stop() may come in between
    if state[RUNNING] == 0:
        for i in range(motors):
            steps[i] = lanes[LANE * i + END]
    else:
        now = ptr32(state[TIMER])[0] & MASK
        fed = state[FED]
        passed = NEGATIVE
        k = 0
        while passed >= NEGATIVE and k < LAST_ROW:
            k += 1
            row = ptr32(state[ROW + ((fed - k) & LAST_ROW)])
            passed = (now - row[begins]) & MASK
        tick = -1  # the row has not begun yet
        if passed < NEGATIVE:
            if passed > 1 << 20:
                passed = 1 << 20  # or the product wraps; no row is that long (1 s)
            tick = (passed * HALF_TICKS_PER_US - row[begins + 1]) >> 1
        places(row, tick, int(row) + 4 * (begins + ROW_EXTRA), steps, motors)  # type: ignore[call-overload]
    for i in range(motors):
        if (locked >> i) & 1:
            steps[i] = lanes[LANE * i + FROZEN]
    return 0
