# mypy: disable-error-code=arg-type
"""The hub: all that the PIO engine's interrupt works on, in one array, and the leaves that do.

One array, for every argument of a viper call costs a microsecond. It holds the engine's state,
the addresses of registers and the addresses of what else the engine keeps. What all of it does
together is told in engine.py; nothing here allocates.
"""

from array import array

import machine
import micropython
from micropython import const
from motion.kernels import row_length

from pio import pulses
from pio.pulses import convert, cut

_HALF_TICKS_PER_US = const(25)
# The clock calls so long before the end of a long segment, in ticks: time to make the next.
_LEAD = const(40_000)
_ROWS = const(16)
_LAST_ROW = const(15)
_CLOCK_FIFO = const(4)
# Words handed over later than that before the last ones end might come too late, in us.
_MARGIN = const(20)

# The hub: everything the leaves work on, in one array, for arguments cost microseconds.
# First the engine's state …
_RUNNING = const(0)  # machines are enabled
_HALT = const(1)  # stopped: nothing moves before arm()
_MADE = const(2)  # segments made, since power-up
_FED = const(3)  # segments handed to the hardware
_BEGUN = const(4)  # the segment that runs
_AHEAD = const(5)  # ticks made behind it
_POWER = const(6)  # spindle power told last
_LOCKED = const(7)  # mask of lanes that stand still
_END_US = const(8)  # when the words end, in us and half ticks
_END_REST = const(9)
_CUT = const(10)  # where in a long segment the next piece begins; 0: there is none
_BEATS = const(11)  # words handed to the clock, since power-up
_EARLY = const(12)  # the clock will call again before the running segment ends
_AXES = const(13)
# … then registers, which depend on the chip …
_PIO0 = const(14)
_PIO1 = const(15)
_TIMER = const(16)
_NVIC = const(17)
_RIVALS = const(18)  # masks: interrupts in which the engine is stopped, and its own;
_BUSY = const(19)  # a channel has words to move
_STEPPER_AT = const(20)  # where steppers wait for a word
_CLOCK_AT = const(21)  # where the clock does
_DMA = const(22)  # a channel per lane
# … and memory.
_LANES = const(26)
_WORDS = const(27)
_TIMING = const(28)
_CLOCKED = const(29)  # words for the clock
_WHOLE = const(30)  # a long segment, made in pieces
_ROW = const(31)  # a row per segment
_FAULT = const(31 + 16)  # what has gone wrong (stops.py), until arm()
_ASKED = const(31 + 17)  # start() waits for the interrupt
_LENGTH = const(31 + 16 + 2)

# A PIO's registers, in words.
_CTRL = const(0)
_FDEBUG = const(2)
_FLEVEL = const(3)
_TXF = const(4)
_PADOUT = const(15)  # levels of all pins
_ADDR = const(0x35)
_INSTR = const(0x36)
_PINCTRL = const(0x37)  # the direction pin in its lowest bits
_SM = const(6)  # from one machine to the next
_SET = const(0x800)  # the same register, where ones set bits,
_CLEAR = const(0xC00)  # and where they clear them

# A DMA channel's, and the interrupt controller's.
_READ = const(0)
_STATUS = const(3)
_COUNT_TRIGGER = const(7)
_DISABLE = const(32)
_DMA_AT = const(0x50000000)
_CREDITS = const(0x800)  # how many words a channel believes that its FIFO has room for

# Instructions that are forced into a machine.
_PULL = const(0x8080)
_CLEAR_ISR = const(0xA0C3)
_SET_X = const(0xE020)  # to five bits,
_SHIFT_IN = const(0x4025)  # which go into ISR from below
_STEP_LOW = const(0xE000)

# In FDEBUG, from the bit of the first machine on: a word has come to a FIFO that was full.
_TXOVER = const(16)

_CLOCK = const(3)  # the clock's machine
_CLOCK_SHIFT = const(24)
_CLOCK_OVERHEAD = const(4)  # ticks of its loop besides the count

# From pio/pulses.py, pio/stops.py, motion/kernels.py.
_LOST = const(2)
_JAMMED = const(3)
_LANE = const(7)
_CARRY = const(0)
_DIR = const(1)
_HEAD = const(2)
_SENT = const(3)
_PLACE = const(4)
_END = const(5)
_RING_MASK = const(31)
_LONGEST = const(0x40000)
_PULSE = const(1)
_KEEP = const(4)
_ROW_TICKS = const(0)
_ROW_DIRS = const(1)
_ROW_POWER = const(2)
_ROW_AXES = const(3)
_ROW_STRIDE = const(3)
_KEEP_POWER = const(0x3FFFFFFF)
# Behind a kernel's row: when it begins, us and half ticks; the clock's word with which it
# ends; and where it begins, per axis.
_ROW_EXTRA = const(3)

# Times are in us modulo 2**30; a difference from there on is a negative one.
_MASK = const(0x3FFFFFFF)
_NEGATIVE = const(0x20000000)


@micropython.viper
def look(hub: ptr32) -> int:
    """See how far the hardware is. Returns the power to set, or KEEP_POWER."""
    pio = ptr32(hub[_PIO1])
    level = (pio[_FLEVEL] >> _CLOCK_SHIFT) & 15
    beat = hub[_BEATS] - level
    ends = _ROW_AXES + _ROW_STRIDE * hub[_AXES] + 2
    row = ptr32(hub[_ROW + (hub[_BEGUN] & _LAST_ROW)])
    power = _KEEP_POWER
    while hub[_BEGUN] < hub[_FED] - 1 and row[ends] < beat:
        hub[_BEGUN] += 1
        row = ptr32(hub[_ROW + (hub[_BEGUN] & _LAST_ROW)])
        hub[_AHEAD] -= row[_ROW_TICKS]
        power = row[_ROW_POWER]
    hub[_EARLY] = row[ends] - beat
    if level == 0 and pio[_ADDR + _SM * _CLOCK] == hub[_CLOCK_AT]:
        hub[_RUNNING] = 0  # all words have been played
    if power == _KEEP_POWER or power == hub[_POWER]:
        return _KEEP_POWER
    hub[_POWER] = power
    return power


@micropython.viper
def append(hub: ptr32) -> int:
    """Take over the segment just made, or the next piece of it."""
    axes = hub[_AXES]
    lanes = ptr32(hub[_LANES])
    row = ptr32(hub[_ROW + (hub[_MADE] & _LAST_ROW)])
    if hub[_CUT] or row[_ROW_TICKS] > _LONGEST:
        whole = ptr32(hub[_WHOLE])
        if hub[_CUT] == 0:
            for i in range(_ROW_AXES + _ROW_STRIDE * axes):
                whole[i] = row[i]
        hub[_CUT] = int(cut(row, whole, hub[_CUT], axes))
    start = _ROW_AXES + _ROW_STRIDE * axes + _ROW_EXTRA
    for i in range(axes):
        place = lanes[_LANE * i + _PLACE]
        row[start + i] = place
        steps = row[_ROW_AXES + _ROW_STRIDE * i]
        lanes[_LANE * i + _PLACE] = place - steps if (row[_ROW_DIRS] >> i) & 1 else place + steps
    hub[_AHEAD] += row[_ROW_TICKS]
    hub[_MADE] += 1
    return 0


@micropython.viper
def _load(pio: ptr32, axes: int, pulse: int) -> int:
    """The length of a pulse into the machines' ISR, five bits at a time."""
    for i in range(axes):
        pio[_INSTR + _SM * i] = _CLEAR_ISR
    shift = 15
    while shift:
        shift -= 5
        for i in range(axes):
            pio[_INSTR + _SM * i] = _SET_X | ((pulse >> shift) & 31)
        for i in range(axes):
            pio[_INSTR + _SM * i] = _SHIFT_IN
    return 0


@micropython.viper
def _prepare(hub: ptr32) -> int:
    """Machines that have stopped or run dry back to their beginnings, with nothing queued.

    DMA counts how much room there is in a machine's FIFO: what it has put there may be taken
    out by hand, for that is what a machine does too, but nothing may be put there.
    """
    axes = hub[_AXES]
    pio = ptr32(hub[_PIO0])
    clock = ptr32(hub[_PIO1])
    lanes = ptr32(hub[_LANES])
    timing = ptr32(hub[_TIMING])
    timer = ptr32(hub[_TIMER])
    patience = 1000
    while ((timer[0] & _MASK) - hub[_END_US]) & _MASK <= timing[_PULSE] // 12 + 1 and patience:
        patience -= 1  # the last pulses have their full length
    pio[_CTRL + _CLEAR] = (1 << axes) - 1
    clock[_CTRL + _CLEAR] = 1 << _CLOCK
    pio[_CTRL + _SET] = ((1 << axes) - 1) << 4  # restart
    clock[_CTRL + _SET] = 16 << _CLOCK
    while (clock[_FLEVEL] >> _CLOCK_SHIFT) & 15:
        clock[_INSTR + _SM * _CLOCK] = _PULL
    patience = 1000
    for i in range(axes):
        dma = ptr32(hub[_DMA + i])
        while (dma[_STATUS] & hub[_BUSY] or (pio[_FLEVEL] >> (8 * i)) & 15) and patience:
            pio[_INSTR + _SM * i] = _PULL
            patience -= 1
    if patience == 0:
        hub[_FAULT] = _JAMMED
        return 0
    for i in range(axes):
        ptr32(hub[_DMA + i])[_READ] = hub[_WORDS] + 4 * (_RING_MASK + 1) * i
        lanes[_LANE * i + _HEAD] = 0
        lanes[_LANE * i + _SENT] = 0
        lanes[_LANE * i + _CARRY] = 0
        # Words that have turned it may never have been played.
        pin = pio[_PINCTRL + _SM * i] & 31
        lanes[_LANE * i + _DIR] = (pio[_PADOUT] >> pin) & 1
    _load(pio, axes, timing[_PULSE] - 3)
    for i in range(axes):
        pio[_INSTR + _SM * i] = _STEP_LOW
    for i in range(axes):
        pio[_INSTR + _SM * i] = hub[_STEPPER_AT]  # jump there
    clock[_INSTR + _SM * _CLOCK] = hub[_CLOCK_AT] - 1
    hub[_END_US] = 0
    hub[_END_REST] = 0
    hub[_POWER] = -1
    return 0


@micropython.viper
def feed(hub: ptr32) -> int:
    """Make words of waiting segments, if the hardware can take them, and hand them over."""
    axes = hub[_AXES]
    space = _CLOCK_FIFO
    if hub[_RUNNING]:
        left = (hub[_END_US] - (ptr32(hub[_TIMER])[0] & _MASK)) & _MASK
        if left >= _NEGATIVE or left < _MARGIN + ptr32(hub[_TIMING])[_KEEP] // 12:
            return 0  # too late: all go on together when the last has come to rest
        for i in range(axes):
            if ptr32(hub[_DMA + i])[_STATUS] & hub[_BUSY] and (hub[_LOCKED] >> i) & 1 == 0:
                return 0
        space -= (ptr32(hub[_PIO1])[_FLEVEL] >> _CLOCK_SHIFT) & 15
        if space == 0:
            return 0
    else:
        _prepare(hub)
    clocked = ptr32(hub[_CLOCKED])
    begins = _ROW_AXES + _ROW_STRIDE * axes
    fed = hub[_FED]
    count = 0
    while fed != hub[_MADE] and count < space:
        row = ptr32(hub[_ROW + (fed & _LAST_ROW)])
        ticks = row[_ROW_TICKS]
        long = ticks >= 2 * _LEAD
        if long and count + 1 == space:
            break
        late = int(convert(row, hub[_LANES], hub[_WORDS], hub[_TIMING]))
        lasts = late + ticks
        clocked[count] = lasts - _CLOCK_OVERHEAD if lasts > _CLOCK_OVERHEAD else 0
        if long:
            clocked[count] -= _LEAD
            count += 1
            clocked[count] = _LEAD - _CLOCK_OVERHEAD
        rest = hub[_END_REST] + 2 * late
        row[begins] = (hub[_END_US] + rest // _HALF_TICKS_PER_US) & _MASK
        row[begins + 1] = rest % _HALF_TICKS_PER_US
        rest += 2 * ticks
        hub[_END_US] = (hub[_END_US] + rest // _HALF_TICKS_PER_US) & _MASK
        hub[_END_REST] = rest % _HALF_TICKS_PER_US
        count += 1
        row[begins + 2] = hub[_BEATS] + count
        fed += 1
    _hand_over(hub, fed, count)
    return 0


@micropython.viper
def _hand_over(hub: ptr32, fed: int, count: int) -> int:
    """Give DMA the words up to segment `fed`, the clock `count` words; start what is at rest.

    Interrupts that may stop the engine wait so long. Where a word has been lost nothing goes on.
    """
    axes = hub[_AXES]
    lanes = ptr32(hub[_LANES])
    nvic = ptr32(hub[_NVIC])
    clock = ptr32(hub[_PIO1])
    following = ptr32(hub[_ROW + (fed & _LAST_ROW)])
    nvic[_DISABLE] = hub[_RIVALS]
    over = ptr32(hub[_PIO0])[_FDEBUG] & ((1 << axes) - 1) << _TXOVER
    if over or (clock[_FDEBUG] >> (_TXOVER + _CLOCK)) & 1:
        hub[_FAULT] = _LOST
    if hub[_HALT] == 0 and hub[_FAULT] == 0:
        for i in range(axes):
            lane = _LANE * i
            if (hub[_LOCKED] >> i) & 1 == 0:
                new = (lanes[lane + _HEAD] - lanes[lane + _SENT]) & _RING_MASK
                if new:
                    ptr32(hub[_DMA + i])[_COUNT_TRIGGER] = new
                lanes[lane + _SENT] = lanes[lane + _HEAD]
                place = lanes[lane + _PLACE]
                if fed != hub[_MADE]:
                    place = following[_ROW_AXES + _ROW_STRIDE * axes + _ROW_EXTRA + i]
                lanes[lane + _END] = place
        clocked = ptr32(hub[_CLOCKED])
        for i in range(count):
            clock[_TXF + _CLOCK] = clocked[i]
        hub[_BEATS] += count
        if hub[_RUNNING] == 0:
            _launch(hub, fed)
        hub[_FED] = fed
    nvic[0] = hub[_RIVALS]
    return 0


@micropython.viper
def _launch(hub: ptr32, fed: int) -> int:
    """All machines begin, in the same tick. Rows were timed from 0: tell them the time."""
    axes = hub[_AXES]
    pio = ptr32(hub[_PIO0])
    for i in range(axes):
        patience = 100
        while (pio[_FLEVEL] >> (8 * i)) & 15 == 0 and patience:
            patience -= 1  # DMA puts the first word there
    pio[_CTRL + _SET] = ((1 << axes) - 1) * 0x101  # enable, restart the divider
    now = ptr32(hub[_TIMER])[0] & _MASK
    ptr32(hub[_PIO1])[_CTRL + _SET] = 0x101 << _CLOCK
    for k in range(hub[_FED], fed):
        row = ptr32(hub[_ROW + (k & _LAST_ROW)])
        begins = _ROW_AXES + _ROW_STRIDE * axes
        row[begins] = (row[begins] + now) & _MASK
    hub[_END_US] = (hub[_END_US] + now) & _MASK
    hub[_RUNNING] = 1
    return 0


@micropython.viper
def _address(memory: ptr8) -> int:
    return int(memory)  # type: ignore[call-overload, no-any-return]


def _array(length: int) -> "array[int]":
    return array("i", (0 for _ in range(length)))


class Memory:
    """What the interrupt works on, with the hub that leads to it. rp2350: which chip this is."""

    def __init__(self, axes: int, rp2350: bool) -> None:
        length = row_length(axes)
        self.hub = hub = _array(_LENGTH)
        self.lanes = _array(_LANE * axes)
        self.timing = _array(pulses.TIMING_LENGTH)
        self.rows = [_array(length + _ROW_EXTRA + axes) for _ in range(_ROWS)]
        self._clocked = _array(_CLOCK_FIFO)
        self._whole = _array(length)
        # The rings lie at multiples of their size: DMA wraps around within address bits.
        ring = 4 << pulses.RING_LOG2
        self._rings = bytearray(ring * (axes + 1))
        self.timing[pulses.AXES] = hub[_AXES] = axes
        hub[_HALT] = 1
        hub[_BEGUN] = -1
        hub[_LANES] = _address(self.lanes)
        hub[_WORDS] = (_address(self._rings) + ring - 1) // ring * ring
        hub[_TIMING] = _address(self.timing)
        hub[_CLOCKED] = _address(self._clocked)
        hub[_WHOLE] = _address(self._whole)
        for i, row in enumerate(self.rows):
            hub[_ROW + i] = _address(row)
        hub[_PIO0] = 0x50200000
        hub[_PIO1] = 0x50300000
        hub[_TIMER] = 0x400B0028 if rp2350 else 0x40054028
        hub[_NVIC] = 0xE000E100 - (1 << 32)
        # IO_IRQ_BANK0, PIO1_IRQ_0, and the timer's four.
        hub[_RIVALS] = 1 << 21 | 1 << 17 | 15 if rp2350 else 1 << 13 | 1 << 9 | 15
        hub[_BUSY] = 1 << (26 if rp2350 else 24)

    def ring(self, axis: int) -> int:
        """Address of a lane's ring."""
        return self.hub[_WORDS] + (4 * axis << pulses.RING_LOG2)

    def connect(self, axis: int, channel: int) -> None:
        """A lane's words go through this DMA channel."""
        self.hub[_DMA + axis] = at = _DMA_AT + 0x40 * channel
        machine.mem32[at + _CREDITS] = 0  # counted anew: the FIFO is empty

    def programs_at(self, stepper: int, clock: int) -> None:
        """Where in the PIOs their machines pull new words."""
        self.hub[_STEPPER_AT] = stepper
        self.hub[_CLOCK_AT] = clock
