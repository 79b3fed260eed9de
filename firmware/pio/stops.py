# mypy: disable-error-code=arg-type
"""Stopping, and saying where the motors are: the other leaves that work on the hub (hub.py).

They may be called in any interrupt, also one that has interrupted the engine's own: what must
not be divided is done with the interrupts of pins held back, for some microseconds.
"""

import micropython
from micropython import const

from pio.pulses import places, undone

# From hub.py.
_HALF_TICKS_PER_US = const(25)
_LAST_ROW = const(15)
_RUNNING = const(0)
_HALT = const(1)  # stopped: nothing moves before start()
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
_PIN_IRQ = const(18)
_BUSY = const(19)
_STEPPER_AT = const(20)
_DMA = const(22)
_LANES = const(26)
_WORDS = const(27)
_ROW = const(31)
_CTRL = const(0)
_FLEVEL = const(3)
_RXF = const(8)
_ADDR = const(0x35)
_INSTR = const(0x36)
_SM = const(6)
_CLEAR = const(0xC00)
_COUNT = const(2)
_STATUS = const(3)
_DISABLE = const(32)
_SAVE_X = const(0xA0C1)
_PUSH = const(0x8000)
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
    waiting = (pio[_FLEVEL] >> (8 * axis)) & 15
    if dma[_STATUS] & hub[_BUSY]:
        waiting += dma[_COUNT]
    at = pio[_ADDR + _SM * axis] - hub[_STEPPER_AT]
    pio[_INSTR + _SM * axis] = _PUSH
    sent = lanes[_LANE * axis + _SENT]
    x = pio[_RXF + axis]
    return end - int(undone(hub[_WORDS], axis, sent, waiting, at, x))


@micropython.viper
def stop(hub: ptr32) -> int:
    """All machines off; positions as they are. Interrupts of pins, which may do so too, wait."""
    axes = hub[_AXES]
    lanes = ptr32(hub[_LANES])
    nvic = ptr32(hub[_NVIC])
    nvic[_DISABLE] = hub[_PIN_IRQ]
    ptr32(hub[_PIO0])[_CTRL + _CLEAR] = (1 << axes) - 1
    ptr32(hub[_PIO1])[_CTRL + _CLEAR] = 1 << _CLOCK
    hub[_HALT] = 1
    for i in range(axes):
        lane = _LANE * i
        locked = (hub[_LOCKED] >> i) & 1
        lanes[lane + _END] = lanes[lane + _FROZEN] if locked else int(_settle(hub, i))
    if hub[_RUNNING]:
        hub[_END_US] = ptr32(hub[_TIMER])[0] & _MASK
    hub[_RUNNING] = 0
    hub[_LOCKED] = 0
    drop(hub)
    nvic[0] = hub[_PIN_IRQ]
    return 0


@micropython.viper
def drop(hub: ptr32) -> int:
    """Forget the segments that no machine has been given."""
    lanes = ptr32(hub[_LANES])
    hub[_MADE] = hub[_FED]
    hub[_BEGUN] = hub[_FED] - 1
    hub[_AHEAD] = 0
    hub[_CUT] = 0
    for i in range(hub[_AXES]):
        lanes[_LANE * i + _PLACE] = lanes[_LANE * i + _END]
    return 0


@micropython.viper
def lock(hub: ptr32, which: int) -> int:
    """Machines of these lanes off."""
    axes = hub[_AXES]
    lanes = ptr32(hub[_LANES])
    nvic = ptr32(hub[_NVIC])
    nvic[_DISABLE] = hub[_PIN_IRQ]
    which &= ((1 << axes) - 1) & (-1 - hub[_LOCKED])
    hub[_LOCKED] = hub[_LOCKED] | which
    ptr32(hub[_PIO0])[_CTRL + _CLEAR] = which
    for i in range(axes):
        if (which >> i) & 1:
            lanes[_LANE * i + _FROZEN] = int(_settle(hub, i))
    nvic[0] = hub[_PIN_IRQ]
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
        now = ptr32(hub[_TIMER])[0]
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
