# mypy: disable-error-code=arg-type
"""Stops, starts, and where the motors are: the other leaves that work on the hub (hub.py).

They may be called in any interrupt, also one that has interrupted the engine's own: what must
not be divided is done with all these interrupts held back, for some microseconds.
"""

import micropython
from micropython import const

from pio.pulses import places, undone

# From pio/hub.py, pio/pulses.py.
_HALF_TICKS_PER_US = const(25)
_LAST_ROW = const(15)
_RUNNING = const(0)
_HALT = const(1)  # stopped: nothing moves before arm()
_MADE = const(2)
_FED = const(3)
_BEGUN = const(4)
_AHEAD = const(5)
_LOCKED = const(7)
_END_US = const(8)
_CUT = const(10)
_AXES = const(13)
_PIO0 = const(14)
_PIO1 = const(15)
_TIMER = const(16)
_NVIC = const(17)
_RIVALS = const(18)
_BUSY = const(19)
_STEPPER_AT = const(20)
_DMA = const(22)
_LANES = const(26)
_WORDS = const(27)
_ROW = const(31)
_FAULT = const(31 + 16)
_ASKED = const(31 + 17)
_CTRL = const(0)
_FDEBUG = const(2)
_FLEVEL = const(3)
_ADDR = const(0x35)
_INSTR = const(0x36)
_SM = const(6)
_CLEAR = const(0xC00)
_STATUS = const(3)
_DISABLE = const(32)
_TXOVER = const(16)
_CLOCK = const(3)
_LANE = const(7)
_SENT = const(3)
_PLACE = const(4)
_END = const(5)
_FROZEN = const(6)
_ROW_AXES = const(3)
_ROW_STRIDE = const(3)
_ROW_EXTRA = const(3)
_MASK = const(0x3FFFFFFF)
_NEGATIVE = const(0x20000000)

# Registers of a PIO and of DMA, in words; instructions that are forced into a machine.
_IRQ_FORCE = const(13)
_RXF = const(8)
_COUNT = const(2)
_SAVE_X = const(0xA0C1)
_PUSH = const(0x8000)
_FIFO = const(4)  # words it holds

# What may be wrong: trouble().
RAISED = const(1)  # the interrupt has met an exception
LOST = const(2)  # a word has come to a FIFO that was full
JAMMED = const(3)  # DMA does not move on
UNHEARD = const(4)  # the interrupt does not come
BEHIND = const(5)  # words should have been played long since

# The interrupt may be late for so long: a flash page is written in less.
_PATIENCE_US = const(50_000)


@micropython.viper
def _settle(hub: ptr32, axis: int) -> int:
    """Where a machine just stopped has come to."""
    pio = ptr32(hub[_PIO0])
    dma = ptr32(hub[_DMA + axis])
    lanes = ptr32(hub[_LANES])
    end = lanes[_LANE * axis + _END]
    if hub[_RUNNING] == 0:
        return end
    pio[_INSTR + _SM * axis] = _SAVE_X
    # A word on its way is counted nowhere: wait until DMA has no more of them, or no room.
    busy = 1
    waiting = 0
    patience = 100
    while busy and waiting < _FIFO and patience:
        busy = dma[_STATUS] & hub[_BUSY]
        waiting = (pio[_FLEVEL] >> (8 * axis)) & 15
        patience -= 1
    left = dma[_COUNT] if busy else 0
    if patience == 0:
        hub[_FAULT] = JAMMED
    at = pio[_ADDR + _SM * axis] - hub[_STEPPER_AT]
    pio[_INSTR + _SM * axis] = _PUSH
    sent = lanes[_LANE * axis + _SENT]
    x = pio[_RXF + axis]
    return end - int(undone(hub[_WORDS], axis, sent, waiting + left, at, x))


@micropython.viper
def halt(hub: ptr32, which: int) -> int:
    """Machines of these lanes (a mask) off, positions as they are; -1: all, until arm().

    Nothing may raise here: one function, which calls no other as soon as it is compiled.
    """
    axes = hub[_AXES]
    lanes = ptr32(hub[_LANES])
    nvic = ptr32(hub[_NVIC])
    if which < 0:
        hub[_HALT] = 1  # first of all: whoever comes in between starts nothing any more
        ptr32(hub[_PIO1])[_CTRL + _CLEAR] = 1 << _CLOCK
    nvic[_DISABLE] = hub[_RIVALS]
    ptr32(hub[_PIO0])[_CTRL + _CLEAR] = which & ((1 << axes) - 1)
    which &= -1 - hub[_LOCKED]
    for i in range(axes):
        if (which >> i) & 1:
            lanes[_LANE * i + _FROZEN] = int(_settle(hub, i))
    if which >= 0:
        hub[_LOCKED] = hub[_LOCKED] | which
    else:
        for i in range(axes):
            lanes[_LANE * i + _END] = lanes[_LANE * i + _FROZEN]
        if hub[_RUNNING]:
            hub[_END_US] = ptr32(hub[_TIMER])[0] & _MASK
        hub[_RUNNING] = 0
        hub[_LOCKED] = 0
    nvic[0] = hub[_RIVALS]
    return 0


@micropython.viper
def call(hub: ptr32) -> int:
    """Make the engine's interrupt happen now, unless it is stopped."""
    if hub[_HALT] == 0:
        hub[_ASKED] = 1
        ptr32(hub[_PIO1])[_IRQ_FORCE] = 1 << _CLOCK
    return 0


@micropython.viper
def arm(hub: ptr32) -> int:
    """Forget faults and the segments that no machine has been given: motion is possible again."""
    axes = hub[_AXES]
    lanes = ptr32(hub[_LANES])
    if hub[_HALT] == 0:
        return 0
    hub[_MADE] = hub[_FED]
    hub[_BEGUN] = hub[_FED] - 1
    hub[_AHEAD] = 0
    hub[_CUT] = 0
    for i in range(axes):
        lanes[_LANE * i + _PLACE] = lanes[_LANE * i + _END]
    # Ones clear.
    ptr32(hub[_PIO0])[_FDEBUG] = ((1 << axes) - 1) << _TXOVER
    ptr32(hub[_PIO1])[_FDEBUG] = 1 << (_TXOVER + _CLOCK)
    hub[_FAULT] = 0
    hub[_ASKED] = 0
    hub[_HALT] = 0
    return 0


@micropython.viper
def trouble(hub: ptr32) -> int:
    """What is wrong, 0 if nothing is. For the main loop."""
    if hub[_FAULT]:
        return hub[_FAULT]
    over = ptr32(hub[_PIO0])[_FDEBUG] & ((1 << hub[_AXES]) - 1) << _TXOVER
    if over or (ptr32(hub[_PIO1])[_FDEBUG] >> (_TXOVER + _CLOCK)) & 1:
        return LOST
    if hub[_ASKED]:
        return UNHEARD
    if hub[_RUNNING]:
        # In this order: an interrupt in between makes it less, if anything.
        end = hub[_END_US]
        late = ((ptr32(hub[_TIMER])[0] & _MASK) - end) & _MASK
        if late >= _PATIENCE_US and late < _NEGATIVE:
            return BEHIND
    return 0


@micropython.viper
def position(hub: ptr32, steps: ptr32) -> int:
    """Where the motors are now."""
    axes = hub[_AXES]
    lanes = ptr32(hub[_LANES])
    begins = _ROW_AXES + _ROW_STRIDE * axes
    locked = hub[_LOCKED]  # now, for stop() may come in between
    if hub[_RUNNING] == 0:
        for i in range(axes):
            steps[i] = lanes[_LANE * i + _END]
    else:
        now = ptr32(hub[_TIMER])[0] & _MASK
        fed = hub[_FED]
        passed = _NEGATIVE
        k = 0
        while passed >= _NEGATIVE and k < _LAST_ROW:
            k += 1
            row = ptr32(hub[_ROW + ((fed - k) & _LAST_ROW)])
            passed = (now - row[begins]) & _MASK
        tick = -1  # not begun yet
        if passed < _NEGATIVE:
            if passed > 1 << 20:
                passed = 1 << 20  # or the product wraps; no row is that long
            tick = (passed * _HALF_TICKS_PER_US - row[begins + 1]) >> 1
        places(row, tick, int(row) + 4 * (begins + _ROW_EXTRA), steps, axes)  # type: ignore[call-overload]
    for i in range(axes):
        if (locked >> i) & 1:
            steps[i] = lanes[_LANE * i + _FROZEN]
    return 0
