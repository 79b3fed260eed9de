# mypy: disable-error-code=arg-type
"""PioEngine: PIO state machines make the pulses, DMA feeds them, one hard interrupt refills.

Each motor has a machine of PIO 0, from the fifth motor on one of PIO 1. It plays words
(programs.py, pulses.py) out of a ring in memory. The clock, the last machine of PIO 1 (of an
RP2350's PIO 2 if an eighth motor has that one), interrupts as each segment begins; the handler
sets spindle power, makes the next segments and hands them over. All machines start within a tick
(engine_state._launch) and stay together, because every lane's words fill the same time. DMA is
given a count of words and ends with them. If the interrupt comes too late, the machines wait at
`pull`; once all have stopped they are started together again. Nothing is lost or repeated.

A stop holds until arm(). The code that it has interrupted continues, but starts nothing. The
interrupt catches all exceptions, because MicroPython would never call it again after one: it
switches the machines off and calls on_fault; the main loop reads the cause from fault().

    segments -> rows, a ring -> words, a ring per lane -> DMA -> FIFO -> machine

During motion, positions follow from the time and the rows; after a stop they are read from the
machines. Nothing here allocates once the engine is made.

`state` is the engine state, indexed by the constants of state_layout.py. HALT: 1 from a stop until
arm(). REQUESTED: 1 until the interrupt that start() has requested has come. FAULT: a fault code.
MADE, FED: segments made, and handed to the hardware. OURS_0, OURS_1, OURS_2: masks of this
engine's machines in PIO 0, 1 and 2. BEFORE_CLOCK: so many lanes at most leave the clock on PIO 1.
"""

import sys

import machine
import micropython
from base.float32 import address_of
from micropython import const

from pio import pulses
from pio import registers as reg
from pio import state_layout as s
from pio.memory import Memory
from pio.refill import refill
from pio.stops import arm, fault_code, halt, position, request_refill

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable

    import rp2
    from interfaces import NextSegment

_TICK_HZ = const(12_500_000)  # a tick is 80 ns
_SEGMENT_LOG2 = const(17)
# Most motors: one machine of PIO 1 stays free, for a radio or a beam; an RP2350's PIO 2 has three.
_MOST_MOTORS = const(6)  # of an RP2040
_MOST_2350 = const(8)  # of an RP2350, with the beam's lane
_LAST_PIN = const(31)  # highest pin of a PIO after reset; an RP2350B has 48 pins

# Texts of fault(), by fault code (state_layout.RAISED and the following ones).
_FAULTS = (
    "",
    "the pulse engine's interrupt has failed",
    "step pulses were lost before they reached the pins",
    "DMA ran out of step pulses during motion",
    "the pulse engine's interrupt did not occur",
    "step pulses came later than scheduled",
)


def _ticks(us: int) -> int:
    """Return microseconds in ticks, rounded up."""
    return -(-us * _TICK_HZ // 1_000_000)


class PioEngine:
    """A StepEngine on PIO. step, direction: pin numbers per motor.

    hold_us, setup_us: how long DIR keeps its level after a step pulse, and before the next one.
    more_lanes: lanes in addition to the motors' (a beam's). on_fault: called in the interrupt if
    that has failed, to switch the tool off. It must call nothing, because next to no stack may be
    left.
    """

    tick_hz = _TICK_HZ
    segment_log2 = _SEGMENT_LOG2

    def __init__(
        self,
        step: "tuple[int, ...]",
        direction: "tuple[int, ...]",
        hold_us: int = 2,
        setup_us: int = 5,
        more_lanes: int = 0,
    ) -> None:
        if machine.freq() % _TICK_HZ:
            raise ValueError("the processor's clock is no multiple of 12.5 MHz")
        self._step = step
        self._direction = direction
        self._hold_us = hold_us
        self._setup_us = setup_us
        # The address of pin 0's control register, and the first bit of OUTOVER in it.
        self._pin_control, self._invert_shift = 0x40014004, 8
        lanes, most_motors, rp2350 = len(step) + more_lanes, _MOST_MOTORS, False
        if s.RP2350:
            rp2350 = "RP2350" in sys.implementation._machine
            if rp2350:
                self._pin_control, self._invert_shift = 0x40028004, 12
                most_motors = _MOST_2350 - more_lanes  # the 6 of an RP2040 leave one for it
                if max(step + direction) > _LAST_PIN:
                    raise ValueError("STEP, DIR: only pins 0 to 31 make pulses")
        if len(step) > most_motors:
            raise ValueError("STEP: %d motors at most" % most_motors)
        self._memory = Memory(lanes, rp2350)
        self._engine_state = self._memory.state
        self._state_at = address_of(self._memory.state)
        self._rows = self._memory.rows
        self._machines = [self._make_lane(i) for i in range(lanes)]
        # A board unloads both modules once the engine is made.
        import rp2

        from pio import programs

        clock_pio = 1
        if s.RP2350:
            clock_pio = 2 if lanes > s.BEFORE_CLOCK else 1
        self._pio = rp2.PIO(clock_pio)
        self._clock = rp2.StateMachine(4 * clock_pio + s.CLOCK, programs.clock, freq=_TICK_HZ)
        # A program is a list, in which MicroPython notes its address in each PIO, from index 1 on.
        program_address = programs.clock[1 + clock_pio]
        self._engine_state[s.CLOCK_PULL_AT] = program_address + programs.CLOCK_PULL
        self.on_fault: "Callable[[], object]" = lambda: None

    def _make_machine(self, axis: int) -> "rp2.StateMachine":
        """Return the state machine of a motor (its number, from 0), on its pins. It is started
        later."""
        import rp2

        from pio import programs

        return rp2.StateMachine(
            axis,
            programs.stepper,
            freq=_TICK_HZ,
            set_base=machine.Pin(self._step[axis]),
            out_base=machine.Pin(self._direction[axis]),
        )

    def _make_lane(self, axis: int) -> "tuple[rp2.StateMachine, rp2.DMA]":
        """Return a lane's state machine, and the DMA channel that copies words from the lane's
        ring to the machine's FIFO. axis: the lane's number, from 0; from 4 on it is on PIO 1."""
        import rp2

        stepper = self._make_machine(axis)
        channel = rp2.DMA()
        control = channel.pack_ctrl(
            size=2,  # words of 32 bits
            inc_write=False,
            ring_size=pulses.RING_LOG2 + 2,  # log2 of its bytes
            treq_sel=axis + (axis & 4),  # DREQ of the TX FIFO: 0 to 3, PIO 1's are 8 to 11
        )
        ring = self._engine_state[s.WORDS] + (4 * axis << pulses.RING_LOG2)
        channel.config(read=ring, write=stepper, ctrl=control)
        # Store the addresses of the machine's and the channel's registers in the engine state.
        self._memory.connect(axis, channel.channel)
        return stepper, channel

    # The StepEngine interface

    def max_step_hz(self, pulse_us: int) -> int:
        """Return the highest step rate of one axis, in steps/s, with pulses of pulse_us
        microseconds."""
        return _TICK_HZ // pulses.shortest_gap(_ticks(pulse_us))

    def attach(
        self,
        next_segment: "NextSegment",
        on_power: "Callable[[int], None]",
        on_rest: "Callable[[], None]",
    ) -> None:
        """Set the source of segments: next_segment(row) fills a row, and returns 0 if there is
        none. on_power is called with the spindle power of each segment as it starts, on_rest when
        the machines have stopped."""
        self._next_segment = next_segment
        self._on_power = on_power
        self._on_rest = on_rest

    def configure(self, pulse_us: int, step_invert: int, dir_invert: int) -> None:
        """Apply $0, $2 and $3: the length of step pulses, and masks of motors whose STEP or DIR
        output is inverted. Called only while idle."""
        hold, setup = _ticks(self._hold_us), _ticks(self._setup_us)
        pulses.set_timing(self._memory.timing, _ticks(pulse_us), hold, setup)
        for i in range(len(self._step)):
            self._invert(self._step[i], step_invert >> i & 1)
            self._invert(self._direction[i], dir_invert >> i & 1)

    def _invert(self, pin: int, invert: int) -> None:
        """Invert a pin's output (1) or not (0), by OUTOVER of its control register. pin: its
        number."""
        address = self._pin_control + 8 * pin  # each pin has two registers of 4 bytes
        others = machine.mem32[address] & ~(3 << self._invert_shift)  # OUTOVER has two bits
        machine.mem32[address] = others | invert << self._invert_shift

    def arm(self) -> None:
        """Allow motion again, after power-up or stop(). Main loop only."""
        # Attached again, because MicroPython may have removed the interrupt.
        self._pio.irq(self._refill, trigger=self._pio.IRQ_SM3, hard=True)
        arm(self._engine_state)

    def start(self) -> None:
        """Request segments by the engine's interrupt, after the engine had run out of them. A
        stopped engine stays stopped."""
        request_refill(self._engine_state)

    @micropython.viper
    def stop(self) -> int:
        """Stop at once, until arm(). Queued steps are dropped, locks released. Safe in an
        interrupt."""
        halt(self._engine_state, -1)
        return 0

    def fault(self) -> str:
        """Return the engine's fault as text, "" if there is none. Main loop only."""
        return _FAULTS[fault_code(self._engine_state)]

    def lock(self, motors: int) -> None:
        """Stop the pulses of these motors (a mask) until stop(); the others continue."""
        halt(self._engine_state, motors)

    def idle(self) -> bool:
        """Return whether nothing moves and nothing is queued in hardware."""
        state = self._engine_state
        return state[s.RUNNING] == 0 and (state[s.HALT] != 0 or state[s.MADE] == state[s.FED])

    def position(self, steps: "array[int]") -> None:
        """Copy each motor's present position, in steps, into `steps`: the only source of
        position. Safe in an interrupt."""
        position(self._engine_state, steps)

    def set_position(self, steps: "array[int]") -> None:
        """Set the present position, in steps per motor, also of locked motors. Only while
        idle."""
        lanes = self._memory.lanes
        for i in range(len(self._step)):
            lane, place = pulses.LANE * i, steps[i]
            # Of the segments made, of the words sent, and of a locked motor: equal while idle.
            lanes[lane + pulses.SENT_PLACE] = lanes[lane + pulses.MADE_PLACE] = place
            lanes[lane + pulses.STOPPED_PLACE] = place

    @micropython.viper
    def _refill(self, _source: object) -> int:
        """Refill the hardware. Interrupt: a segment has begun, or start() has requested it."""
        state = ptr32(self._state_at)
        state[s.REQUESTED] = 0
        if state[s.HALT]:
            return 0
        try:
            refill(state, self._next_segment, self._on_power, self._on_rest)
        except:  # noqa: E722
            state[s.FAULT] = s.RAISED  # MicroPython must see no exception
        if state[s.FAULT]:  # also one that refill() has found
            # No calls up to here: a full stack may be the cause. This disables the machines: CTRL
            # is a PIO's first register, and reg.CLEAR its alias in which ones clear bits.
            state[s.HALT] = 1
            ptr32(state[s.PIO0])[reg.CLEAR] = state[s.OURS_0]
            ptr32(state[s.PIO1])[reg.CLEAR] = state[s.OURS_1]
            if s.RP2350:
                if state[s.OURS_2]:
                    ptr32(state[s.CLOCK_PIO])[reg.CLEAR] = state[s.OURS_2]
            try:
                self.on_fault()
            except:  # noqa: E722
                state[s.FAULT] = s.RAISED  # the main loop switches the tool off
            try:  # stop completely: positions too
                halt(state, -1)
            except:  # noqa: E722
                state[s.FAULT] = s.RAISED
        return 0
