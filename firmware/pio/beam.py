# mypy: disable-error-code=arg-type
"""BeamEngine: a PioEngine that changes the power of a beam exactly at the right step.

The beam has a lane of its own after the motors', and a machine of its own. Its words have the
format of step words; where a motor would step, its machine triggers two DMA channels, which
trigger each other in turn: the taker reads the word that the machine has pushed, the mover copies
a level from a ring to the PWM's compare register. Segments, stops and running out of words are
handled as for steps.

    changes in a row -> words -> machine -> taker -> mover: level -> PWM

While the beam is put out, the mover copies levels to an unused word: those still on their way do
not reach the pin.
"""

import sys
from array import array

import machine
import micropython
from micropython import const
from motion import beam_layout as bm

from pio import pulses
from pio.engine import PioEngine
from pio.registers import (
    COUNT_TRIGGER,
    CREDITS,
    DMA_AT,
    DMA_EACH,
    READ,
    RXF,
    WRITE,
)
from pio.state_layout import BLOCK_LOG2, IN_BLOCK, MOTORS, PIO0, RP2350, RUNNING

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    import rp2

_PWM = const(0x40050000)  # address of the first slice's registers
_PWM_2350 = const(0x400A8000)  # the same of an RP2350
_SLICE = const(0x14)  # bytes from one slice to the next; two pins each
_COMPARE = const(0x0C)  # in a slice: the compare levels of both its pins
_TOP = const(0x10)
_BOTH = const(0x10001)  # factor: a level of 16 bits becomes that of both the slice's pins

_LAST_OF_8 = const(31)  # pins above have slices from the ninth on (RP2350B)

_RX = const(4)  # DREQ of the first RX FIFO of PIO 0; PIO 1's come 8 later
_UNPACED = const(63)  # instead of a DREQ: copy at once
_BYTES = const(1024)  # size of the ring of levels, which is aligned to its size


def slice_of(pin: int) -> int:
    """Return the address of a pin's PWM slice."""
    base = _PWM_2350 if "RP2350" in sys.implementation._machine else _PWM
    # Two neighbouring pins share a slice: eight slices, or on an RP2350B 8 to 11 for pins above.
    number = pin >> 1 & 3 | 8 if RP2350 and pin > _LAST_OF_8 else pin >> 1 & 7
    return base + _SLICE * number


class BeamEngine(PioEngine):
    """A PioEngine with a beam. power: number of the PWM's pin; other arguments as of PioEngine.

    The array `beam` is described in motion/beam_layout.py; `levels` is the ring of PWM levels.
    """

    def __init__(
        self,
        step: "tuple[int, ...]",
        direction: "tuple[int, ...]",
        hold_us: int,
        setup_us: int,
        power: int,
    ) -> None:
        super().__init__(step, direction, hold_us, setup_us, more_lanes=1)
        self._slice = slice_of(power)
        # The array that motion/beam_layout.py works on.
        self.beam = array("i", (0 for _ in range(bm.LENGTH)))
        self.beam[bm.BOTH] = _BOTH  # the PWM's format of a level
        self.beam[bm.LEVEL] = bm.UNKNOWN  # power of the last level: differs from any
        self._make_channels(len(step))
        self._engine_state[MOTORS] = len(step)  # the lane after these, the beam's, has no position

    def _make_machine(self, axis: int) -> "rp2.StateMachine":
        """Return a lane's state machine: of a motor, or for the last lane of the beam."""
        if axis < len(self._step):
            return super()._make_machine(axis)
        import rp2

        from pio.beam_program import beam

        return rp2.StateMachine(axis, beam, freq=self.tick_hz)

    def _make_channels(self, lane: int) -> None:
        """Configure both DMA channels, and start the taker. lane: the beam's, after the motors'.

        The taker waits for a word in the RX FIFO of the lane's machine and drops it; then it
        triggers the mover, which copies one level at once and triggers the taker. Levels go to an
        unused word until start() sets the PWM's compare register as their destination.
        """
        import rp2

        taker, mover = rp2.DMA(), rp2.DMA()
        # Addresses of the channels' registers, of 4 bytes each.
        taker_at, mover_at = (DMA_AT + DMA_EACH * dma.channel for dma in (taker, mover))
        self._taker, self._mover, self._mover_at = taker, mover, mover_at
        # Twice the ring's size, so that an aligned ring fits in it. The addresses are read back
        # from the channel's registers.
        memory, unused = (array("i", (0 for _ in range(length))) for length in (_BYTES // 2, 1))
        mover.config(read=memory, write=unused)  # not started
        address, self._unused_at = (machine.mem32[mover_at + 4 * reg] for reg in (READ, WRITE))
        self._ring = (address + _BYTES - 1) // _BYTES * _BYTES
        first = (self._ring - address) // 4  # index of the ring's first word in memory
        self.levels = memoryview(memory)[first : first + _BYTES // 4]
        self._unused = unused  # DMA has only its address: the reference keeps it allocated
        number = lane & IN_BLOCK  # of the lane's machine in its PIO, lane >> BLOCK_LOG2
        control = taker.pack_ctrl(
            size=2,  # words of 32 bits
            inc_read=False,
            inc_write=False,
            treq_sel=_RX + lane + (lane & 4),  # DREQ of the RX FIFO: 4 to 7, PIO 1's 12 to 15
            chain_to=mover.channel,
        )
        rx_fifo = self._engine_state[PIO0 + (lane >> BLOCK_LOG2)] + 4 * (RXF + number)
        taker.config(read=rx_fifo, write=self._unused_at, count=1, ctrl=control)
        control = mover.pack_ctrl(
            size=2,  # words of 32 bits
            inc_write=False,
            ring_size=bm.LEVELS_LOG2 + 2,  # log2 of the ring's bytes: reading wraps there
            treq_sel=_UNPACED,
            chain_to=taker.channel,
        )
        mover.config(read=self._ring, write=self._unused_at, count=1, ctrl=control)
        machine.mem32[taker_at + 4 * CREDITS] = 0  # a write makes it count the FIFO's words anew
        machine.mem32[taker_at + 4 * COUNT_TRIGGER] = 1

    def configure(self, pulse_us: int, step_invert: int, dir_invert: int) -> None:
        """Apply $0, $2 and $3, as PioEngine does; pulse_us is also the beam's length of a change.
        Called only while idle."""
        super().configure(pulse_us, step_invert, dir_invert)
        self.beam[bm.GAP] = pulses.shortest_gap(self._memory.timing[pulses.PULSE])

    def scale(self, power_max: int) -> None:
        """Compute the level of full power again, after the PWM's frequency has changed. power_max:
        the highest spindle power."""
        self.beam[bm.FULL] = bm.full(machine.mem32[self._slice + _TOP] + 1, power_max)

    def arm(self) -> None:
        """Allow motion again; levels of dropped segments are dropped, too.

        The mover continues with the level that is made next: COUNT of them were made, and each has
        its place in the ring.
        """
        next_level = self.beam[bm.COUNT] & bm.LEVELS_MASK  # index in the ring
        machine.mem32[self._mover_at + 4 * READ] = self._ring + 4 * next_level
        super().arm()

    def start(self) -> None:
        """Request segments after the engine had run out of them; the beam may be switched on
        again, also after put_out()."""
        if not self._engine_state[RUNNING]:
            # The level at the pin may be another now, because put_out() sets it. UNKNOWN differs
            # from any power, so the first segment changes it. The mover writes to the PWM again,
            # and not to the unused word.
            self.beam[bm.LEVEL] = bm.UNKNOWN
            machine.mem32[self._mover_at + 4 * WRITE] = self._slice + _COMPARE
        super().start()

    @micropython.viper
    def put_out(self) -> int:
        """Let no more level reach the pin until start(): the mover writes to an unused word. The
        pin itself is switched off by the caller. Safe in an interrupt. Returns 0."""
        ptr32(self._mover_at)[WRITE] = int(self._unused_at)
        return 0
