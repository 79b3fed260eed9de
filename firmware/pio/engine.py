# mypy: disable-error-code=arg-type
"""PioEngine: pulses made by PIO state machines, fed by DMA, refilled by one hard interrupt.

Each motor has a machine of PIO 0, from the fifth on one of PIO 1, which plays words
(programs.py, pulses.py) out of a ring in memory. A clock, the last machine of PIO 1, or of an
RP2350's PIO 2 where an eighth motor has that one, interrupts as each segment begins: spindle
power is set, the next segments are made and handed over. All machines start within a tick
(engine_state._launch) and stay together, for every lane's words fill the same time. DMA is handed
counted words and ends with them: where the interrupt comes too late, the machines wait at `pull`,
and when all have come to rest they are started together again. Nothing is lost or repeated.

A stop holds until arm(): whatever it has interrupted goes on, and starts nothing. The interrupt
lets no exception out, for MicroPython would never call it again: the machines are switched off,
whoever has a tool is told, and the main loop learns of it by fault().

    segments -> rows, a ring -> words, a ring per lane -> DMA -> FIFO -> machine

Positions while moving follow from the time and the rows; after a stop they are read out of
the machines. Nothing here allocates once the engine is made.
"""

import sys

import machine
import micropython
from micropython import const

from pio import pulses
from pio.hub_layout import (
    ASKED,
    BEFORE_CLOCK,
    CLOCK,
    CLOCK_AT,
    CLOCK_PIO,
    FAULT,
    FED,
    HALT,
    MADE,
    OURS,
    PIO0,
    PIO1,
    RAISED,
    RP2350,
    RUNNING,
    THIRD,
    WORDS,
)
from pio.memory import Memory
from pio.refill import refill
from pio.registers import CLEAR
from pio.stops import arm, fault_code, halt, position, request_refill

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable

    import rp2
    from interfaces import NextSegment

_TICK_HZ = const(12_500_000)
_SEGMENT_LOG2 = const(17)
# Motors: PIO 1 has a machine left, for a radio or a beam; and an RP2350's PIO 2 has three.
_MOST = const(6)
_MOST_2350 = const(8)
_LAST_PIN = const(31)  # of those that a PIO has, as it begins; an RP2350B has 48

# fault(): in the order of layout.RAISED and those behind it.
_FAULTS = (
    "",
    "the pulse engine's interrupt has failed",
    "pulses were lost on their way to the hardware",
    "DMA has no more pulses for the hardware",
    "the pulse engine's interrupt does not come",
    "motion is behind its own schedule",
)


def _ticks(us: int) -> int:
    """Ticks that last so long at least."""
    return -(-us * _TICK_HZ // 1_000_000)


class PioEngine:
    """The engine. step, direction: pin numbers per axis; hold, setup: of DIR around its change.

    on_fault, if set: called in the interrupt where that has failed, to kill the tool. A leaf, for
    there may be next to no stack left.
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
        self._pin_control, self._invert_shift = 0x40014004, 8
        lanes, most, rp2350 = len(step) + more_lanes, _MOST, False
        if RP2350:
            rp2350 = "RP2350" in sys.implementation._machine
            if rp2350:
                self._pin_control, self._invert_shift = 0x40028004, 12
                most = _MOST_2350 - more_lanes
                if max(step + direction) > _LAST_PIN:
                    raise ValueError("STEP, DIR: only pins 0 to 31 make pulses")
        if len(step) > most:
            raise ValueError("%d motors at most" % most)
        self._memory = Memory(lanes, rp2350)
        self._engine_state = self._memory.state
        self._rows = self._memory.rows
        self._machines = [self._make_lane(i) for i in range(lanes)]
        # A board forgets both modules once the engine is there.
        import rp2

        from pio import programs

        block = 1
        if RP2350:
            block = 2 if lanes > BEFORE_CLOCK else 1
        self._pio = rp2.PIO(block)
        self._clock = rp2.StateMachine(4 * block + CLOCK, programs.clock, freq=_TICK_HZ)
        self._engine_state[CLOCK_AT] = programs.clock[1 + block] + programs.CLOCK_PULL
        self.on_fault: "Callable[[], object]" = lambda: None

    def _make_machine(self, axis: int) -> "rp2.StateMachine":
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
        import rp2

        stepper = self._make_machine(axis)
        channel = rp2.DMA()
        control = channel.pack_ctrl(
            size=2, inc_write=False, ring_size=pulses.RING_LOG2 + 2, treq_sel=axis + (axis & 4)
        )
        ring = self._engine_state[WORDS] + (4 * axis << pulses.RING_LOG2)
        channel.config(read=ring, write=stepper, ctrl=control)
        self._memory.connect(axis, channel.channel)
        return stepper, channel

    # The StepEngine seam

    def max_step_hz(self, pulse_us: int) -> int:
        """Highest rate of one axis with step pulses of pulse_us microseconds."""
        return _TICK_HZ // pulses.shortest_gap(_ticks(pulse_us))

    def attach(
        self,
        next_segment: "NextSegment",
        on_power: "Callable[[int], None]",
        on_rest: "Callable[[], None]",
    ) -> None:
        """Say where segments come from, who is told the spindle power of each as it starts, and
        who hears that the machines stand still."""
        self._next_segment = next_segment
        self._on_power = on_power
        self._on_rest = on_rest

    def configure(self, pulse_us: int, step_invert: int, dir_invert: int) -> None:
        """Take over $0, $2 and $3. Called at rest only."""
        hold, setup = _ticks(self._hold_us), _ticks(self._setup_us)
        pulses.set_timing(self._memory.timing, _ticks(pulse_us), hold, setup)
        for i in range(len(self._step)):
            self._invert(self._step[i], step_invert >> i & 1)
            self._invert(self._direction[i], dir_invert >> i & 1)

    def _invert(self, pin: int, invert: int) -> None:
        address = self._pin_control + 8 * pin
        others = machine.mem32[address] & ~(3 << self._invert_shift)
        machine.mem32[address] = others | invert << self._invert_shift

    def arm(self) -> None:
        """Motion is possible again, after power-up or stop(). For the main loop."""
        # Anew: MicroPython may have taken the interrupt away from us.
        self._pio.irq(self._refill, trigger=self._pio.IRQ_SM3, hard=True)
        arm(self._engine_state)

    def start(self) -> None:
        """Begin to pull, where the engine had run out of segments. A stopped engine stays so."""
        request_refill(self._engine_state)

    @micropython.viper
    def stop(self) -> int:
        """At once, until arm(); safe in an interrupt; queued steps are dropped, locks released."""
        halt(self._engine_state, -1)
        return 0

    def fault(self) -> str:
        """What is wrong with the engine, in words, or nothing. For the main loop."""
        return _FAULTS[fault_code(self._engine_state)]

    def lock(self, motors: int) -> None:
        """These motors (a mask) make no more pulses until stop(); the others go on."""
        halt(self._engine_state, motors)

    def idle(self) -> bool:
        """Nothing is moving and nothing is queued in hardware."""
        state = self._engine_state
        return state[RUNNING] == 0 and (state[HALT] != 0 or state[MADE] == state[FED])

    def position(self, steps: "array[int]") -> None:
        """Copy the steps really made, per motor: the only truth. Safe in an interrupt."""
        position(self._engine_state, steps)

    def set_position(self, steps: "array[int]") -> None:
        """Name the present place, also of motors that are locked. At rest only."""
        lanes = self._memory.lanes
        for i in range(len(self._step)):
            at, here = pulses.LANE * i, steps[i]
            lanes[at + pulses.END] = lanes[at + pulses.PLACE] = lanes[at + pulses.FROZEN] = here

    @micropython.viper
    def _refill(self, _source: object) -> int:
        """Interrupt: a segment has begun, or the engine is to start. Keep the hardware busy."""
        state = ptr32(self._engine_state)
        state[ASKED] = 0
        if state[HALT]:
            return 0
        try:
            refill(state, self._next_segment, self._on_power, self._on_rest)
        except:  # noqa: E722
            state[FAULT] = RAISED
        if state[FAULT]:
            # No calls up to here: the stack may be what there is too little of.
            state[HALT] = 1
            ptr32(state[PIO0])[CLEAR] = state[OURS]
            ptr32(state[PIO1])[CLEAR] = state[OURS + 1]
            if RP2350:
                if state[THIRD]:
                    ptr32(state[CLOCK_PIO])[CLEAR] = state[THIRD]
            try:
                self.on_fault()
            except:  # noqa: E722
                state[FAULT] = RAISED  # the main loop sees to the tool
            try:
                halt(state, -1)
            except:  # noqa: E722
                state[FAULT] = RAISED
        return 0
