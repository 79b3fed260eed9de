# mypy: disable-error-code=arg-type
"""PioEngine: pulses made by PIO state machines, fed by DMA, refilled by one hard interrupt.

Each axis has a machine of PIO 0, which plays words (programs.py, pulses.py) out of a ring in
memory. A clock, a machine of PIO 1, interrupts as each segment begins: spindle power is set,
the next segments are made and handed over. All machines start in the same tick and stay
together, for every lane's words fill the same time. DMA is handed counted words and ends with
them: where the interrupt comes too late, the machines wait at `pull`, and when all have come
to rest they are started together again. Nothing is lost or repeated.

    segments -> rows, a ring -> words, a ring per lane -> DMA -> FIFO -> machine

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
from pio.pulses import convert, places, undone

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
_WAITING_ROWS = const(10)  # rows that may wait; the others may still be looked at
_CLOCK_FIFO = const(4)
# Words handed over later than that before the last ones end might come too late, in us.
_MARGIN = const(20)

# The hub: everything the leaves work on, in one array, for arguments cost microseconds.
# First the engine's state …
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
_AXES = const(10)
# … then registers, which depend on the chip …
_PIO0 = const(11)
_PIO1 = const(12)
_TIMER = const(13)
_NVIC = const(14)
_PIN_IRQ = const(15)  # masks
_BUSY = const(16)
_STEPPER_AT = const(17)  # where steppers wait for a word
_CLOCK_AT = const(18)  # where the clock does
_DMA = const(19)  # a channel per lane
# … and memory.
_LANES = const(23)
_WORDS = const(24)
_TIMING = const(25)
_CLOCKED = const(26)  # words for the clock
_ROW = const(27)  # a row per segment
_HUB_LENGTH = const(27 + 16)

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
_COUNT = const(2)
_STATUS = const(3)
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
def _look(hub: ptr32) -> int:
    """See how far the hardware is. Returns the power to set, or KEEP_POWER."""
    pio = ptr32(hub[_PIO1])
    level = (pio[_FLEVEL] >> _CLOCK_SHIFT) & 15
    begun = hub[_FED] - 1 - level
    if level == 0 and pio[_ADDR + _SM * _CLOCK] == hub[_CLOCK_AT]:
        hub[_RUNNING] = 0  # all words have been played
    power = _KEEP_POWER
    while hub[_BEGUN] < begun:
        hub[_BEGUN] += 1
        row = ptr32(hub[_ROW + (hub[_BEGUN] & _LAST_ROW)])
        hub[_AHEAD] -= row[_ROW_TICKS]
        power = row[_ROW_POWER]
    if power == _KEEP_POWER or power == hub[_POWER]:
        return _KEEP_POWER
    hub[_POWER] = power
    return power


@micropython.viper
def _append(hub: ptr32) -> int:
    """Take over the segment just made."""
    axes = hub[_AXES]
    lanes = ptr32(hub[_LANES])
    row = ptr32(hub[_ROW + (hub[_MADE] & _LAST_ROW)])
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
def _prepare(hub: ptr32) -> int:
    """Machines that have stopped or run dry back to their beginnings, with nothing queued."""
    axes = hub[_AXES]
    pio = ptr32(hub[_PIO0])
    clock = ptr32(hub[_PIO1])
    lanes = ptr32(hub[_LANES])
    timing = ptr32(hub[_TIMING])
    timer = ptr32(hub[_TIMER])
    patience = 1000
    while (timer[0] - hub[_END_US]) & _MASK <= timing[_PULSE] // 12 + 1 and patience:
        patience -= 1  # the last pulses have their full length
    pio[_CTRL + _CLEAR] = (1 << axes) - 1
    clock[_CTRL + _CLEAR] = 1 << _CLOCK
    pio[_CTRL + _SET] = ((1 << axes) - 1) << 4  # restart
    clock[_CTRL + _SET] = 16 << _CLOCK
    while (clock[_FLEVEL] >> _CLOCK_SHIFT) & 15:
        clock[_INSTR + _SM * _CLOCK] = _PULL
    for i in range(axes):
        dma = ptr32(hub[_DMA + i])
        while dma[_STATUS] & hub[_BUSY] or (pio[_FLEVEL] >> (8 * i)) & 15:
            pio[_INSTR + _SM * i] = _PULL
        dma[_READ] = hub[_WORDS] + 4 * (_RING_MASK + 1) * i
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
        pio[_INSTR + _SM * i] = hub[_STEPPER_AT]  # jump there
    clock[_INSTR + _SM * _CLOCK] = hub[_CLOCK_AT] - 1
    hub[_END_US] = 0
    hub[_END_REST] = 0
    hub[_POWER] = -1
    return 0


@micropython.viper
def _feed(hub: ptr32) -> int:
    """Make words of waiting segments, if the hardware can take them, and hand them over."""
    axes = hub[_AXES]
    space = _CLOCK_FIFO
    if hub[_RUNNING]:
        left = (hub[_END_US] - ptr32(hub[_TIMER])[0]) & _MASK
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
        late = int(convert(row, hub[_LANES], hub[_WORDS], hub[_TIMING]))
        ticks = row[_ROW_TICKS]
        clocked[count] = late + ticks - _CLOCK_OVERHEAD if ticks > _CLOCK_OVERHEAD else 0
        rest = hub[_END_REST] + 2 * late
        row[begins] = (hub[_END_US] + rest // _HALF_TICKS_PER_US) & _MASK
        row[begins + 1] = rest % _HALF_TICKS_PER_US
        rest += 2 * ticks
        hub[_END_US] = (hub[_END_US] + rest // _HALF_TICKS_PER_US) & _MASK
        hub[_END_REST] = rest % _HALF_TICKS_PER_US
        count += 1
        fed += 1
    _hand_over(hub, fed)
    return 0


@micropython.viper
def _hand_over(hub: ptr32, fed: int) -> int:
    """Give DMA the words up to segment `fed`, and start the machines if they are at rest.

    Interrupts of pins, which may stop the engine, wait so long.
    """
    axes = hub[_AXES]
    lanes = ptr32(hub[_LANES])
    nvic = ptr32(hub[_NVIC])
    clock = ptr32(hub[_PIO1])
    following = ptr32(hub[_ROW + (fed & _LAST_ROW)])
    nvic[_DISABLE] = hub[_PIN_IRQ]
    if hub[_HALT] == 0:
        for i in range(axes):
            lane = _LANE * i
            if (hub[_LOCKED] >> i) & 1 == 0:
                count = (lanes[lane + _HEAD] - lanes[lane + _SENT]) & _RING_MASK
                if count:
                    ptr32(hub[_DMA + i])[_COUNT_TRIGGER] = count
                lanes[lane + _SENT] = lanes[lane + _HEAD]
                place = lanes[lane + _PLACE]
                if fed != hub[_MADE]:
                    place = following[_ROW_AXES + _ROW_STRIDE * axes + _ROW_EXTRA + i]
                lanes[lane + _END] = place
        clocked = ptr32(hub[_CLOCKED])
        for i in range(fed - hub[_FED]):
            clock[_TXF + _CLOCK] = clocked[i]
        if hub[_RUNNING] == 0:
            _launch(hub, fed)
        hub[_FED] = fed
    nvic[0] = hub[_PIN_IRQ]
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
    now = ptr32(hub[_TIMER])[0]
    ptr32(hub[_PIO1])[_CTRL + _SET] = 0x101 << _CLOCK
    for k in range(hub[_FED], fed):
        row = ptr32(hub[_ROW + (k & _LAST_ROW)])
        begins = _ROW_AXES + _ROW_STRIDE * axes
        row[begins] = (row[begins] + now) & _MASK
    hub[_END_US] = (hub[_END_US] + now) & _MASK
    hub[_RUNNING] = 1
    return 0


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
def _stop(hub: ptr32) -> int:
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
    _drop(hub)
    nvic[0] = hub[_PIN_IRQ]
    return 0


@micropython.viper
def _drop(hub: ptr32) -> int:
    """Forget the segments that no machine has been given."""
    lanes = ptr32(hub[_LANES])
    hub[_MADE] = hub[_FED]
    hub[_BEGUN] = hub[_FED] - 1
    hub[_AHEAD] = 0
    for i in range(hub[_AXES]):
        lanes[_LANE * i + _PLACE] = lanes[_LANE * i + _END]
    return 0


@micropython.viper
def _lock(hub: ptr32, which: int) -> int:
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
def _position(hub: ptr32, steps: ptr32) -> int:
    """Where the motors are now."""
    axes = hub[_AXES]
    lanes = ptr32(hub[_LANES])
    begins = _ROW_AXES + _ROW_STRIDE * axes
    for i in range(axes):
        steps[i] = lanes[_LANE * i + _END]
    if hub[_RUNNING]:
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
                passed = 1 << 20
            tick = (passed * _HALF_TICKS_PER_US - row[begins + 1]) >> 1
        places(row, tick, int(row) + 4 * (begins + _ROW_EXTRA), steps, axes)
    for i in range(axes):
        if (hub[_LOCKED] >> i) & 1:
            steps[i] = lanes[_LANE * i + _FROZEN]
    return 0


@micropython.viper
def _address(memory: ptr8) -> int:
    return int(memory)


@micropython.viper
def _call(hub: ptr32) -> int:
    """Make the interrupt happen now."""
    ptr32(hub[_PIO1])[_IRQ_FORCE] = 1 << _CLOCK
    return 0


def _array(length: int) -> "array[int]":
    return array("i", (0 for _ in range(length)))


def _ticks(us: int) -> int:
    """Ticks that last so long at least."""
    return -(-us * _HALF_TICKS_PER_US // 2)


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
        self._step = step
        self._direction = direction
        self._hold_us = hold_us
        self._setup_us = setup_us
        self._hub = hub = _array(_HUB_LENGTH)
        self._lanes = _array(_LANE * axes)
        self._timing = _array(pulses.TIMING_LENGTH)
        self._clocked = _array(_CLOCK_FIFO)
        self._rows = [_array(row_length(axes) + _ROW_EXTRA + axes) for _ in range(_ROWS)]
        # The rings lie at multiples of their size: DMA wraps around within address bits.
        ring = 4 << pulses.RING_LOG2
        self._memory = bytearray(ring * (axes + 1))
        self._timing[pulses.AXES] = hub[_AXES] = axes
        hub[_BEGUN] = -1
        hub[_LANES] = _address(self._lanes)
        hub[_WORDS] = (_address(self._memory) + ring - 1) // ring * ring
        hub[_TIMING] = _address(self._timing)
        hub[_CLOCKED] = _address(self._clocked)
        for i, row in enumerate(self._rows):
            hub[_ROW + i] = _address(row)
        self._find_registers()
        self._machines = [self._make_machine(i) for i in range(axes)]
        self._machines.append(rp2.StateMachine(4 + _CLOCK, programs.clock, freq=_TICK_HZ))
        hub[_STEPPER_AT] = programs.stepper[1]
        hub[_CLOCK_AT] = programs.clock[2] + programs.CLOCK_PULL

    def _find_registers(self) -> None:
        rp2350 = "RP2350" in sys.implementation._machine
        hub = self._hub
        hub[_PIO0] = 0x50200000
        hub[_PIO1] = 0x50300000
        hub[_TIMER] = 0x400B0028 if rp2350 else 0x40054028
        hub[_NVIC] = 0xE000E100 - (1 << 32)
        hub[_PIN_IRQ] = 1 << (21 if rp2350 else 13)
        hub[_BUSY] = 1 << (26 if rp2350 else 24)
        self._pin_control = 0x40028004 if rp2350 else 0x40014004
        self._invert_shift = 12 if rp2350 else 8

    def _make_machine(self, axis: int) -> "tuple[rp2.StateMachine, rp2.DMA]":
        stepper = rp2.StateMachine(
            axis,
            programs.stepper,
            freq=_TICK_HZ,
            set_base=machine.Pin(self._step[axis]),
            out_base=machine.Pin(self._direction[axis]),
        )
        channel = rp2.DMA()
        log2 = pulses.RING_LOG2 + 2
        control = channel.pack_ctrl(size=2, inc_write=False, ring_size=log2, treq_sel=axis)
        channel.config(read=self._hub[_WORDS] + (axis << log2), write=stepper, ctrl=control)
        self._hub[_DMA + axis] = 0x50000000 + 0x40 * channel.channel
        return stepper, channel

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
        hold, setup = _ticks(self._hold_us), _ticks(self._setup_us)
        pulses.set_timing(self._timing, _ticks(pulse_us), hold, setup)
        for i in range(len(self._step)):
            self._invert(self._step[i], step_invert >> i & 1)
            self._invert(self._direction[i], dir_invert >> i & 1)

    def _invert(self, pin: int, invert: int) -> None:
        address = self._pin_control + 8 * pin
        others = machine.mem32[address] & ~(3 << self._invert_shift)
        machine.mem32[address] = others | invert << self._invert_shift

    def start(self) -> None:
        """Begin to pull, where the engine had run out of segments."""
        self._hub[_HALT] = 0
        _call(self._hub)

    def stop(self) -> None:
        """At once; safe in an interrupt; queued steps are dropped, locks released."""
        _stop(self._hub)

    def lock(self, axes: int) -> None:
        """These axes (a mask) make no more pulses until stop(); the others go on."""
        _lock(self._hub, axes)

    def idle(self) -> bool:
        """Nothing is moving and nothing is queued in hardware."""
        hub = self._hub
        return hub[_RUNNING] == 0 and hub[_MADE] == hub[_FED]

    def position(self, steps: "array[int]") -> None:
        """Copy the steps really made, per motor: the only truth. Safe in an interrupt."""
        _position(self._hub, steps)

    def set_position(self, steps: "array[int]") -> None:
        """Name the present place. At rest only."""
        for i in range(len(self._step)):
            self._lanes[_LANE * i + _END] = steps[i]
            self._lanes[_LANE * i + _PLACE] = steps[i]

    @micropython.viper
    def _turn(self, _source: object) -> int:
        """Interrupt: a segment has begun, or the engine is to start. Keep the hardware supplied."""
        hub = ptr32(self._hub)
        if hub[_HALT]:
            return 0
        if hub[_RUNNING]:
            power = int(_look(hub))
            if power != _KEEP_POWER:
                self._on_power(power)
        if hub[_MADE] != hub[_FED]:
            _feed(hub)
        made = 0
        while made < _MOST and hub[_AHEAD] < _LEAD and hub[_MADE] - hub[_FED] < _WAITING_ROWS:
            if int(self._next_segment(self._rows[hub[_MADE] & _LAST_ROW])) == 0:
                break
            _append(hub)
            made += 1
        if made:
            _feed(hub)
        if hub[_HALT]:
            _drop(hub)  # stopped meanwhile by an interrupt that came before this one
        return 0
