# mypy: disable-error-code=arg-type
"""PioEngine: pulses made by PIO state machines, fed by DMA, refilled by one hard interrupt.

Each axis has a machine of PIO 0, which plays words (programs.py, pulses.py) out of a ring in
memory. A clock, a machine of PIO 1, interrupts as each segment begins: spindle power is set,
and the next segments are made and handed over. All machines start in the same tick and stay
together, for every lane's words fill the same time. DMA is handed counted words and ends with
them: where the interrupt comes too late, the machines wait at `pull`, and when all have come
to rest they are started together again. Nothing is lost or repeated.

    made -> rows (a ring of segments) -> words (a ring per lane) -> DMA -> FIFO -> machine

Positions while moving follow from the time and the rows; after a stop they are read out of
the machines. Nothing here allocates once the engine is made.
"""

import sys
from array import array

import machine
import micropython
import rp2
from kernels import row_length
from micropython import const

from pio import programs, pulses
from pio.pulses import convert, late, places, undone

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import NextSegment

_TICK_HZ = const(12_500_000)
_HALF_TICKS_PER_US = const(25)
_SEGMENT_LOG2 = const(16)

# So much is made ahead of the segment that runs, in ticks: what a hold has to wait for.
_LEAD = const(40_000)
_MOST = const(2)  # segments made in one interrupt
_ROWS = const(16)
_LAST_ROW = const(15)
_CLOCK_FIFO = const(4)
# Words handed over later than that before the last ones end might come too late, in us.
_MARGIN = const(20)

# State.
_RUNNING = const(0)  # machines are enabled
_HALT = const(1)  # stopped: nothing moves before start()
_MADE = const(2)  # segments made, since power-up
_FED = const(3)  # segments handed to the hardware
_BEGUN = const(4)  # the segment that runs
_AHEAD = const(5)  # ticks made behind it
_POWER = const(6)  # spindle power told last
_LOCKED = const(7)  # mask of lanes that stand still
_END_US = const(8)  # when the words end, in us and half ticks
_END_REST = const(9)
_STATE_LENGTH = const(10)

# Registers: addresses and masks, here because they depend on the chip and are too long for
# small integers.
_PIO0 = const(0)
_PIO1 = const(1)
_TIMER = const(2)
_NVIC = const(3)
_PIN_IRQ = const(4)
_BUSY = const(5)
_CLOCK_AT = const(6)  # where the clock waits for a word
_STEPPER_AT = const(7)  # where steppers do
_DMA = const(8)  # a channel per lane

# A PIO's registers, in words.
_CTRL = const(0)
_FLEVEL = const(3)
_TXF = const(4)
_RXF = const(8)
_IRQ_FORCE = const(13)
_ADDR = const(0x35)
_INSTR = const(0x36)
_SM = const(6)  # from one machine to the next
_SET = const(0x800)  # the same register, where ones set bits,
_CLEAR = const(0xC00)  # and where they clear them

# A DMA channel's, and the interrupt controller's.
_READ = const(0)
_STATUS = const(3)
_COUNT = const(2)
_COUNT_TRIGGER = const(7)
_DISABLE = const(32)

# Instructions that are forced into a machine.
_PULL = const(0x8080)
_LOAD_ISR = const(0xA0C7)  # from OSR
_SAVE_X = const(0xA0C1)  # to ISR
_PUSH = const(0x8000)
_STEP_LOW = const(0xE000)

_CLOCK = const(3)  # the clock's machine
_CLOCK_SHIFT = const(24)
_CLOCK_OVERHEAD = const(4)  # ticks of its loop besides the count

# From pulses.py, kernels.py.
_LANE = const(7)
_CARRY = const(0)
_HEAD = const(2)
_SENT = const(3)
_PLACE = const(4)
_END = const(5)
_FROZEN = const(6)
_RING_MASK = const(31)
_AXES = const(0)
_PULSE = const(1)
_KEEP = const(4)
_ROW_TICKS = const(0)
_ROW_DIRS = const(1)
_ROW_POWER = const(2)
_ROW_AXES = const(3)
_ROW_STRIDE = const(3)
_KEEP_POWER = const(0x3FFFFFFF)
# Behind a kernel's row: when it begins, us and half ticks, and where.
_ROW_EXTRA = const(2)

# Times are in us modulo 2**30; a difference from there on is a negative one.
_MASK = const(0x3FFFFFFF)
_NEGATIVE = const(0x20000000)


@micropython.viper
def _append(state: ptr32, rows: ptr32, lanes: ptr32, row: ptr32, axes: int) -> int:
    """Take over a segment just made."""
    length = _ROW_AXES + _ROW_STRIDE * axes
    at = (state[_MADE] & _LAST_ROW) * (length + _ROW_EXTRA + axes)
    for i in range(length):
        rows[at + i] = row[i]
    at += length + _ROW_EXTRA
    for i in range(axes):
        place = lanes[_LANE * i + _PLACE]
        rows[at + i] = place
        steps = row[_ROW_AXES + _ROW_STRIDE * i]
        place = place - steps if (row[_ROW_DIRS] >> i) & 1 else place + steps
        lanes[_LANE * i + _PLACE] = place
    state[_AHEAD] += row[_ROW_TICKS]
    state[_MADE] += 1
    return 0


@micropython.viper
def _look(state: ptr32, regs: ptr32, rows: ptr32, size: int) -> int:
    """See how far the hardware is. Returns the power to set, or KEEP_POWER."""
    pio = ptr32(regs[_PIO1])
    level = (pio[_FLEVEL] >> _CLOCK_SHIFT) & 15
    if level == 0 and pio[_ADDR + _SM * _CLOCK] == regs[_CLOCK_AT]:
        state[_RUNNING] = 0  # all words have been played
        level = -1
    power = _KEEP_POWER
    while state[_BEGUN] < state[_FED] - level - 1 and state[_BEGUN] < state[_FED] - 1:
        state[_BEGUN] += 1
        at = (state[_BEGUN] & _LAST_ROW) * size
        state[_AHEAD] -= rows[at]
        power = rows[at + _ROW_POWER]
    if power == _KEEP_POWER or power == state[_POWER]:
        return _KEEP_POWER
    state[_POWER] = power
    return power


@micropython.viper
def _prepare(state: ptr32, regs: ptr32, lanes: ptr32, words: ptr32, timing: ptr32) -> int:
    """Machines that have stopped or run dry back to their beginnings, with nothing queued."""
    axes = timing[_AXES]
    pio = ptr32(regs[_PIO0])
    clock = ptr32(regs[_PIO1])
    timer = ptr32(regs[_TIMER])
    pulse_us = 2 * timing[_PULSE] // _HALF_TICKS_PER_US + 2
    patience = 1000
    while (timer[0] - state[_END_US]) & _MASK < pulse_us and patience:
        patience -= 1  # the last pulses have their full length
    pio[_CTRL + _CLEAR] = (1 << axes) - 1
    clock[_CTRL + _CLEAR] = 1 << _CLOCK
    clock[_CTRL + _SET] = 16 << _CLOCK
    pio[_CTRL + _SET] = ((1 << axes) - 1) << 4  # restart
    while (clock[_FLEVEL] >> _CLOCK_SHIFT) & 15:
        clock[_INSTR + _SM * _CLOCK] = _PULL
    for i in range(axes):
        dma = ptr32(regs[_DMA + i])
        while dma[_STATUS] & regs[_BUSY] or (pio[_FLEVEL] >> (8 * i)) & 15:
            pio[_INSTR + _SM * i] = _PULL
        dma[_READ] = int(words) + 4 * (_RING_MASK + 1) * i
        lanes[_LANE * i + _HEAD] = 0
        lanes[_LANE * i + _SENT] = 0
        lanes[_LANE * i + _CARRY] = 0
        pio[_TXF + i] = timing[_PULSE] - 3
    for i in range(axes):
        pio[_INSTR + _SM * i] = _PULL
    for i in range(axes):
        pio[_INSTR + _SM * i] = _LOAD_ISR
    for i in range(axes):
        pio[_INSTR + _SM * i] = _STEP_LOW
    for i in range(axes):
        pio[_INSTR + _SM * i] = regs[_STEPPER_AT]  # jump there
    clock[_INSTR + _SM * _CLOCK] = regs[_CLOCK_AT] - 1
    state[_END_US] = 0
    state[_END_REST] = 0
    state[_POWER] = -1
    return 0


@micropython.viper
def _may_feed(state: ptr32, regs: ptr32, timing: ptr32) -> int:
    """How many segments the hardware can be handed now."""
    if state[_RUNNING] == 0:
        return _CLOCK_FIFO
    left = (state[_END_US] - ptr32(regs[_TIMER])[0]) & _MASK
    if left >= _NEGATIVE or left < _MARGIN + timing[_KEEP] // (_HALF_TICKS_PER_US // 2):
        return 0  # too late: go on when all has come to rest
    for i in range(timing[_AXES]):
        if ptr32(regs[_DMA + i])[_STATUS] & regs[_BUSY] and (state[_LOCKED] >> i) & 1 == 0:
            return 0
    return _CLOCK_FIFO - ((ptr32(regs[_PIO1])[_FLEVEL] >> _CLOCK_SHIFT) & 15)


@micropython.viper
def _time_row(state: ptr32, rows: ptr32, at: int, axes: int, late: int) -> int:
    """Note when a segment begins; the words' end moves on to its end."""
    rest = state[_END_REST] + 2 * late
    us = state[_END_US] + rest // _HALF_TICKS_PER_US
    rest = rest % _HALF_TICKS_PER_US
    end = at + _ROW_AXES + _ROW_STRIDE * axes
    rows[end] = us & _MASK
    rows[end + 1] = rest
    rest += 2 * rows[at]
    state[_END_US] = (us + rest // _HALF_TICKS_PER_US) & _MASK
    state[_END_REST] = rest % _HALF_TICKS_PER_US
    return 0


@micropython.viper
def _hand_over(
    state: ptr32, regs: ptr32, rows: ptr32, lanes: ptr32, fed: int, clocked: ptr32, axes: int
) -> int:
    """Give the words made to DMA, up to segment `fed`, and start the machines if they rest.

    Interrupts of pins, which may stop the engine, wait so long.
    """
    pio = ptr32(regs[_PIO0])
    clock = ptr32(regs[_PIO1])
    nvic = ptr32(regs[_NVIC])
    size = _ROW_AXES + (_ROW_STRIDE + 1) * axes + _ROW_EXTRA
    begin = (fed & _LAST_ROW) * size + size - axes
    nvic[_DISABLE] = regs[_PIN_IRQ]
    if state[_HALT] == 0:
        for i in range(axes):
            lane = _LANE * i
            if (state[_LOCKED] >> i) & 1 == 0:
                count = (lanes[lane + _HEAD] - lanes[lane + _SENT]) & _RING_MASK
                if count:
                    ptr32(regs[_DMA + i])[_COUNT_TRIGGER] = count
                lanes[lane + _SENT] = lanes[lane + _HEAD]
                lanes[lane + _END] = (
                    lanes[lane + _PLACE] if fed == state[_MADE] else rows[begin + i]
                )
        for i in range(fed - state[_FED]):
            clock[_TXF + _CLOCK] = clocked[i]
        if state[_RUNNING] == 0:
            for i in range(axes):
                patience = 100
                while (pio[_FLEVEL] >> (8 * i)) & 15 == 0 and patience:
                    patience -= 1  # DMA puts the first word there
            pio[_CTRL + _SET] = ((1 << axes) - 1) * 0x101
            now = ptr32(regs[_TIMER])[0]
            clock[_CTRL + _SET] = 0x101 << _CLOCK
            for k in range(state[_FED], fed):
                at = (k & _LAST_ROW) * size + size - axes - _ROW_EXTRA
                rows[at] = (rows[at] + now) & _MASK
            state[_END_US] = (state[_END_US] + now) & _MASK
            state[_RUNNING] = 1
        state[_FED] = fed
    nvic[0] = regs[_PIN_IRQ]
    return 0


@micropython.viper
def _settle(regs: ptr32, lanes: ptr32, words: ptr32, axis: int) -> int:
    """Steps that a machine just stopped has not made of what it was sent. See pulses.undone()."""
    pio = ptr32(regs[_PIO0])
    dma = ptr32(regs[_DMA + axis])
    pio[_INSTR + _SM * axis] = _SAVE_X
    waiting = (pio[_FLEVEL] >> (8 * axis)) & 15
    if dma[_STATUS] & regs[_BUSY]:
        waiting += dma[_COUNT]
    at = pio[_ADDR + _SM * axis] - regs[_STEPPER_AT]
    pio[_INSTR + _SM * axis] = _PUSH
    sent = lanes[_LANE * axis + _SENT]
    x = pio[_RXF + axis]
    return int(undone(words, axis, sent, waiting, at, x))


@micropython.viper
def _stop(state: ptr32, regs: ptr32, lanes: ptr32, words: ptr32, axes: int) -> int:
    """All machines off; positions as they are. Interrupts of pins, which may do so too, wait."""
    nvic = ptr32(regs[_NVIC])
    nvic[_DISABLE] = regs[_PIN_IRQ]
    ptr32(regs[_PIO0])[_CTRL + _CLEAR] = (1 << axes) - 1
    ptr32(regs[_PIO1])[_CTRL + _CLEAR] = 1 << _CLOCK
    state[_HALT] = 1
    if state[_RUNNING]:
        for i in range(axes):
            lane = _LANE * i
            if (state[_LOCKED] >> i) & 1:
                lanes[lane + _END] = lanes[lane + _FROZEN]
            else:
                lanes[lane + _END] = lanes[lane + _END] - int(_settle(regs, lanes, words, i))
        state[_END_US] = ptr32(regs[_TIMER])[0] & _MASK
    elif state[_LOCKED]:
        for i in range(axes):
            if (state[_LOCKED] >> i) & 1:
                lanes[_LANE * i + _END] = lanes[_LANE * i + _FROZEN]
    state[_RUNNING] = 0
    state[_LOCKED] = 0
    nvic[0] = regs[_PIN_IRQ]
    return 0


@micropython.viper
def _drop(state: ptr32, lanes: ptr32, axes: int) -> int:
    """Forget the segments that no machine has been given."""
    state[_MADE] = state[_FED]
    state[_BEGUN] = state[_FED] - 1
    state[_AHEAD] = 0
    for i in range(axes):
        lanes[_LANE * i + _PLACE] = lanes[_LANE * i + _END]
    return 0


@micropython.viper
def _lock(state: ptr32, regs: ptr32, lanes: ptr32, words: ptr32, which: int, axes: int) -> int:
    """Machines of these lanes off."""
    nvic = ptr32(regs[_NVIC])
    nvic[_DISABLE] = regs[_PIN_IRQ]
    which &= ((1 << axes) - 1) & (-1 - state[_LOCKED])
    state[_LOCKED] = state[_LOCKED] | which
    ptr32(regs[_PIO0])[_CTRL + _CLEAR] = which
    for i in range(axes):
        if (which >> i) & 1:
            lane = _LANE * i
            undone = int(_settle(regs, lanes, words, i)) if state[_RUNNING] else 0
            lanes[lane + _FROZEN] = lanes[lane + _END] - undone
    nvic[0] = regs[_PIN_IRQ]
    return 0


@micropython.viper
def _position(
    state: ptr32, regs: ptr32, rows: ptr32, lanes: ptr32, steps: ptr32, axes: int
) -> int:
    """Where the motors are now."""
    for i in range(axes):
        steps[i] = lanes[_LANE * i + _END]
    if state[_RUNNING]:
        size = _ROW_AXES + (_ROW_STRIDE + 1) * axes + _ROW_EXTRA
        now = ptr32(regs[_TIMER])[0]
        fed = state[_FED]
        at = 0
        passed = 0
        for k in range(1, _LAST_ROW):
            at = ((fed - k) & _LAST_ROW) * size
            passed = (now - rows[at + size - axes - _ROW_EXTRA]) & _MASK
            if passed < _NEGATIVE:
                break
        tick = -1
        if passed < _NEGATIVE:
            if passed > 1 << 20:
                passed = 1 << 20
            tick = (passed * _HALF_TICKS_PER_US - rows[at + size - axes - 1]) >> 1
        here = int(rows) + 4 * at
        places(here, tick, here + 4 * (size - axes), steps, axes)
    for i in range(axes):
        if (state[_LOCKED] >> i) & 1:
            steps[i] = lanes[_LANE * i + _FROZEN]
    return 0


@micropython.viper
def _address(memory: ptr8) -> int:
    return int(memory)


def _signed(word: int) -> int:
    """The same bits as an array("i") takes them."""
    return word - (1 << 32) if word >> 31 else word


class PioEngine:
    """The engine. step, direction: pin numbers per axis; hold, setup: of DIR around its change."""

    tick_hz = _TICK_HZ
    segment_log2 = _SEGMENT_LOG2

    def __init__(
        self,
        step: "tuple[int, ...]",
        direction: "tuple[int, ...]",
        hold_us: int = 2,
        setup_us: int = 5,
    ) -> None:
        if machine.freq() % _TICK_HZ:
            raise ValueError("the processor's clock is no multiple of 12.5 MHz")
        axes = len(step)
        self._axes = axes
        self._step = step
        self._direction = direction
        self._hold_us = hold_us
        self._setup_us = setup_us
        self._state = array("i", (0 for _ in range(_STATE_LENGTH)))
        self._state[_BEGUN] = -1
        self._lanes = array("i", (0 for _ in range(_LANE * axes)))
        self._timing = array("i", (0 for _ in range(pulses.TIMING_LENGTH)))
        self._timing[_AXES] = axes
        self._clocked = array("i", (0 for _ in range(_CLOCK_FIFO)))
        self._row = array("i", (0 for _ in range(row_length(axes))))
        self._size = row_length(axes) + _ROW_EXTRA + axes
        self._rows = array("i", (0 for _ in range(_ROWS * self._size)))
        # The rings lie at multiples of their size: DMA wraps around within address bits.
        ring = 4 << pulses.RING_LOG2
        self._memory = bytearray(ring * (axes + 1))
        self._words = (_address(self._memory) + ring - 1) // ring * ring
        self._regs = array("i", (0 for _ in range(_DMA + axes)))
        self._make_machines()

    def _make_machines(self) -> None:
        rp2350 = "RP2350" in sys.implementation._machine
        regs = self._regs
        regs[_PIO0] = 0x50200000
        regs[_PIO1] = 0x50300000
        regs[_TIMER] = 0x400B0028 if rp2350 else 0x40054028
        regs[_NVIC] = _signed(0xE000E100)
        regs[_PIN_IRQ] = 1 << (21 if rp2350 else 13)
        regs[_BUSY] = 1 << (26 if rp2350 else 24)
        self._pin_control = 0x40028004 if rp2350 else 0x40014004
        self._invert_shift = 12 if rp2350 else 8
        self._machines = []
        self._channels = []
        for i in range(self._axes):
            stepper = rp2.StateMachine(
                i,
                programs.stepper,
                freq=_TICK_HZ,
                set_base=machine.Pin(self._step[i]),
                out_base=machine.Pin(self._direction[i]),
            )
            channel = rp2.DMA()
            # Words of 32 bits out of a ring of 2**7 bytes, paced by the machine's FIFO.
            control = channel.pack_ctrl(
                size=2, inc_write=False, ring_size=pulses.RING_LOG2 + 2, treq_sel=i
            )
            channel.config(
                read=self._words + i * (4 << pulses.RING_LOG2), write=stepper, ctrl=control
            )
            regs[_DMA + i] = 0x50000000 + 0x40 * channel.channel
            self._machines.append(stepper)
            self._channels.append(channel)
        self._machines.append(rp2.StateMachine(4 + _CLOCK, programs.clock, freq=_TICK_HZ))
        regs[_STEPPER_AT] = programs.stepper[1]
        regs[_CLOCK_AT] = programs.clock[2] + programs.CLOCK_PULL

    # The StepEngine seam

    def max_step_hz(self, pulse_us: int) -> int:
        """Highest rate of one axis with step pulses of pulse_us microseconds."""
        return _TICK_HZ // pulses.shortest_gap(_ticks(pulse_us))

    def attach(self, next_segment: "NextSegment", on_power: "Callable[[int], None]") -> None:
        """Say where segments come from and who is told the spindle power of each as it starts."""
        self._next_segment = next_segment
        self._on_power = on_power
        rp2.PIO(1).irq(self._turn, trigger=rp2.PIO.IRQ_SM3, hard=True)

    def configure(self, pulse_us: int, step_invert: int, dir_invert: int) -> None:
        """Take over $0, $2 and $3. Called at rest only."""
        pulses.set_timing(
            self._timing, _ticks(pulse_us), _ticks(self._hold_us), _ticks(self._setup_us)
        )
        for i in range(self._axes):
            self._invert(self._step[i], step_invert >> i & 1)
            self._invert(self._direction[i], dir_invert >> i & 1)

    def _invert(self, pin: int, invert: int) -> None:
        address = self._pin_control + 8 * pin
        others = machine.mem32[address] & ~(3 << self._invert_shift)
        machine.mem32[address] = others | invert << self._invert_shift

    def start(self) -> None:
        """Begin to pull, where the engine had run out of segments."""
        self._state[_HALT] = 0
        _call(self._regs)

    def stop(self) -> None:
        """At once; safe in an interrupt; queued steps are dropped, locks released."""
        _stop(self._state, self._regs, self._lanes, self._words, self._axes)
        _drop(self._state, self._lanes, self._axes)

    def lock(self, axes: int) -> None:
        """These axes (a mask) make no more pulses until stop(); the others go on."""
        _lock(self._state, self._regs, self._lanes, self._words, axes, self._axes)

    def idle(self) -> bool:
        """Nothing is moving and nothing is queued in hardware."""
        state = self._state
        return state[_RUNNING] == 0 and state[_MADE] == state[_FED]

    def position(self, steps: "array[int]") -> None:
        """Copy the steps really made, per motor: the only truth. Safe in an interrupt."""
        _position(self._state, self._regs, self._rows, self._lanes, steps, self._axes)

    def set_position(self, steps: "array[int]") -> None:
        """Name the present place. At rest only."""
        for i in range(self._axes):
            self._lanes[_LANE * i + _END] = steps[i]
            self._lanes[_LANE * i + _PLACE] = steps[i]

    # The interrupt

    @micropython.viper
    def _turn(self, _source: object) -> int:
        """A segment has begun, or the engine is to start: keep the hardware supplied."""
        state = ptr32(self._state)
        if state[_HALT]:
            return 0
        if state[_RUNNING]:
            power = int(_look(self._state, self._regs, self._rows, self._size))
            if power != _KEEP_POWER:
                self._on_power(power)
        if state[_MADE] != state[_FED]:
            self._feed()
        made = 0
        while (
            made < _MOST and state[_AHEAD] < _LEAD and state[_MADE] - state[_FED] < _LAST_ROW - 6
        ):
            if int(self._next_segment(self._row)) == 0:
                break
            _append(self._state, self._rows, self._lanes, self._row, self._axes)
            made += 1
        if made:
            self._feed()
        if state[_HALT]:
            _drop(self._state, self._lanes, self._axes)  # stopped by an interrupt of this one
        return 0

    @micropython.viper
    def _feed(self) -> int:
        """Make words of waiting segments, if the hardware can take them, and hand them over."""
        state = ptr32(self._state)
        clocked = ptr32(self._clocked)
        rows = ptr32(self._rows)
        size = int(self._size)
        space = int(_may_feed(self._state, self._regs, self._timing))
        if space == 0:
            return 0
        if state[_RUNNING] == 0:
            _prepare(self._state, self._regs, self._lanes, self._words, self._timing)
        fed = state[_FED]
        count = 0
        while fed != state[_MADE] and count < space:
            at = (fed & _LAST_ROW) * size
            row = int(rows) + 4 * at
            delay = int(late(row, self._lanes, self._timing))
            convert(row, self._lanes, self._words, self._timing, delay)
            _time_row(self._state, self._rows, at, self._axes, delay)
            ticks = rows[at] + delay - _CLOCK_OVERHEAD
            clocked[count] = ticks if ticks > 0 else 0
            count += 1
            fed += 1
        _hand_over(
            self._state, self._regs, self._rows, self._lanes, fed, self._clocked, self._axes
        )
        return 0


@micropython.viper
def _call(regs: ptr32) -> int:
    """Make the interrupt happen now."""
    ptr32(regs[_PIO1])[_IRQ_FORCE] = 1 << _CLOCK
    return 0


def _ticks(us: int) -> int:
    """Ticks that last so long at least."""
    return -(-us * _HALF_TICKS_PER_US // 2)
