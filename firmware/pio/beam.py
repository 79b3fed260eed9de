# mypy: disable-error-code=arg-type
"""BeamEngine: a PioEngine that changes the power of a beam at the step where it belongs.

The beam has a lane of its own behind the motors', and a machine as they have. Its words are those
of steps; where a motor would step, its machine wakes two DMA channels, which wake each other in
turn: one takes what the machine has said, the other moves a level from a ring to where the PWM
compares. What becomes of a segment, a stop, or a machine that has run out of words is what becomes
of steps.

    changes in a row -> words -> machine -> taker -> mover: level -> PWM

A beam that is put out has a mover that moves levels nowhere: whatever is still on its way does not
come to the pin.
"""

import sys
from array import array

import machine
import micropython
from micropython import const
from motion import beam_layout as bm

from pio import pulses
from pio.engine import PioEngine
from pio.hub_layout import BLOCK_LOG2, IN_BLOCK, MOTORS, PIO0, RP2350, RUNNING
from pio.registers import (
    COUNT_TRIGGER,
    CREDITS,
    DMA_AT,
    DMA_EACH,
    READ,
    RXF,
    WRITE,
)

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    import rp2

_PWM = const(0x40050000)
_PWM_2350 = const(0x400A8000)
_SLICE = const(0x14)  # from one to the next: two pins each
_COMPARE = const(0x0C)  # of both its pins
_TOP = const(0x10)
_BOTH = const(0x10001)

_LAST_OF_8 = const(31)  # pins above, which an RP2350B has, have slices from the ninth on

_RX = const(4)  # requests of PIO 0's machines that have said something begin here, PIO 1's 8 on
_UNPACED = const(63)
_BYTES = const(1024)  # of the ring of levels, which lies at a multiple of it


def slice_of(pin: int) -> int:
    """Where a pin's slice of the PWM is."""
    base = _PWM_2350 if "RP2350" in sys.implementation._machine else _PWM
    which = pin >> 1 & 3 | 8 if RP2350 and pin > _LAST_OF_8 else pin >> 1 & 7
    return base + _SLICE * which


class BeamEngine(PioEngine):
    """The engine. power: the pin of the PWM."""

    def __init__(
        self,
        step: "tuple[int, ...]",
        direction: "tuple[int, ...]",
        hold_us: int,
        setup_us: int,
        power: int,
    ) -> None:
        super().__init__(step, direction, hold_us, setup_us, 1)
        self._slice = slice_of(power)
        # What motion/beam_layout.py works on, and its ring of levels.
        self.beam = array("i", (0 for _ in range(bm.LENGTH)))
        self.beam[bm.BOTH] = _BOTH
        self.beam[bm.LEVEL] = bm.UNKNOWN
        self._make_channels(len(step))
        self._engine_state[MOTORS] = len(step)

    def _make_machine(self, axis: int) -> "rp2.StateMachine":
        if axis < len(self._step):
            return super()._make_machine(axis)
        import rp2

        from pio.beam_program import beam

        return rp2.StateMachine(axis, beam, freq=self.tick_hz)

    def _make_channels(self, lane: int) -> None:
        import rp2

        taker, mover = rp2.DMA(), rp2.DMA()
        taker_at, mover_at = (DMA_AT + DMA_EACH * one.channel for one in (taker, mover))
        self._taker, self._mover, self._mover_at = taker, mover, mover_at
        # Two rings, for one of them lies as it has to; where is asked of the channels.
        room, nothing = (array("i", (0 for _ in range(n))) for n in (_BYTES // 2, 1))
        mover.config(read=room, write=nothing)
        at, self._nowhere = (machine.mem32[mover_at + 4 * n] for n in (READ, WRITE))
        self._ring = (at + _BYTES - 1) // _BYTES * _BYTES
        first = (self._ring - at) // 4
        self.levels = memoryview(room)[first : first + _BYTES // 4]
        self._nothing = nothing
        own = lane & IN_BLOCK
        control = taker.pack_ctrl(
            size=2,
            inc_read=False,
            inc_write=False,
            treq_sel=_RX + lane + (lane & 4),
            chain_to=mover.channel,
        )
        said = self._engine_state[PIO0 + (lane >> BLOCK_LOG2)] + 4 * (RXF + own)
        taker.config(read=said, write=self._nowhere, count=1, ctrl=control)
        control = mover.pack_ctrl(
            size=2,
            inc_write=False,
            ring_size=bm.LEVELS_LOG2 + 2,
            treq_sel=_UNPACED,
            chain_to=taker.channel,
        )
        mover.config(read=self._ring, write=self._nowhere, count=1, ctrl=control)
        machine.mem32[taker_at + 4 * CREDITS] = 0
        machine.mem32[taker_at + 4 * COUNT_TRIGGER] = 1

    def configure(self, pulse_us: int, step_invert: int, dir_invert: int) -> None:
        """Take over $0, $2 and $3. Called at rest only."""
        super().configure(pulse_us, step_invert, dir_invert)
        self.beam[bm.GAP] = pulses.shortest_gap(self._memory.timing[pulses.PULSE])

    def scale(self, power_max: int) -> None:
        """The PWM has another frequency: see which level is full power now."""
        self.beam[bm.FULL] = bm.full(machine.mem32[self._slice + _TOP] + 1, power_max)

    def arm(self) -> None:
        """Motion is possible again; levels of segments that have been dropped are too."""
        channel = self._mover_at
        machine.mem32[channel + 4 * READ] = self._ring + 4 * (self.beam[bm.COUNT] & bm.LEVELS_MASK)
        super().arm()

    def start(self) -> None:
        """Begin to pull, where the engine had run out of segments: a beam that is out may burn."""
        if not self._engine_state[RUNNING]:
            self.beam[bm.LEVEL] = bm.UNKNOWN
            machine.mem32[self._mover_at + 4 * WRITE] = self._slice + _COMPARE
        super().start()

    @micropython.viper
    def put_out(self) -> int:
        """No level comes to the pin any more, until motion begins anew. Safe in an interrupt."""
        ptr32(self._mover_at)[WRITE] = int(self._nowhere)
        return 0
