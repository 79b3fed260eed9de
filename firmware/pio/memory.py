# mypy: disable-error-code=arg-type
"""Memory: make the arrays that the PIO engine's interrupt works on, and store their addresses.

They are made once, before the heap is fragmented; engine_state.py works on them.
"""

from array import array

import machine
from base.float32 import address_of
from motion.layout import row_length

from pio import pulses
from pio import registers as reg
from pio import state_layout as s
from pio.pulses import LANE, MACHINE


def _make_array(length: int) -> "array[int]":
    """Return an array of so many integers (32 bits), all 0."""
    return array("i", (0 for _ in range(length)))


class Memory:
    """The arrays of the interrupt, and the engine state, which holds their addresses.

    axes: number of lanes, one per motor and one for a beam. rp2350: whether the chip is one. The
    constant RP2350 says whether it may be one: a build for an RP2040 has 0 there.
    """

    def __init__(self, axes: int, rp2350: bool) -> None:
        """Make all arrays, of zeros, and fill the engine state in: stopped (HALT), no segment
        begun (BEGUN). DMA channels are added later, by connect()."""
        length = row_length(axes)
        state_length = s.DMA + axes
        if s.RP2350:  # the build may be for one; rp2350: this chip is one
            state_length = s.LENGTH
        self.state = state = _make_array(state_length)
        self.lanes = _make_array(LANE * axes)
        self.timing = _make_array(pulses.TIMING_LENGTH)
        self.rows = [_make_array(length + s.ROW_EXTRA + axes) for _ in range(s.ROWS)]
        self._clocked = _make_array(s.CLOCK_FIFO)
        self._whole = _make_array(length)
        # A ring is aligned to its size, because DMA wraps around within address bits.
        ring = 4 << pulses.RING_LOG2  # bytes of a lane's ring
        self._rings = bytearray(ring * (axes + 1))  # one more, for the alignment
        self.timing[pulses.AXES] = state[s.AXES] = state[s.MOTORS] = axes
        state[s.HALT] = 1
        state[s.BEGUN] = -1
        # The arrays' addresses; WORDS is the first aligned one in _rings.
        state[s.LANES] = address_of(self.lanes)
        state[s.WORDS] = (address_of(self._rings) + ring - 1) // ring * ring
        state[s.TIMING] = address_of(self.timing)
        state[s.CLOCK_BUFFER] = address_of(self._clocked)
        state[s.LONG_ROW] = address_of(self._whole)
        for i, row in enumerate(self.rows):
            state[s.ROW + i] = address_of(row)
        self._set_registers(axes, rp2350)

    def _set_registers(self, axes: int, rp2350: bool) -> None:
        """Store the addresses and masks of the chip's registers in the engine state.

        rp2350: the chip is one. s.RP2350: this build supports one; in other builds it is 0.
        """
        state = self.state
        # Masks of the machines: lanes 0 to 3 of PIO 0, lanes 4 to 7 and the clock of PIO 1.
        machines = (1 << axes) - 1
        state[s.OURS_0] = machines & 15
        state[s.OURS_1] = machines >> 4 | 1 << s.CLOCK
        state[s.PIO0] = reg.PIO0_AT
        state[s.PIO1] = reg.PIO1_AT
        state[s.TIMER] = 0x40054028  # TIMERAWL
        # The interrupt controller's ISER, 0xE000E100: the array's integers are signed 32 bit.
        state[s.NVIC] = 0xE000E100 - (1 << 32)
        # A bit per interrupt number: pins (IO_IRQ_BANK0, 13) and the timer's four (0 to 3) may
        # stop the engine; PIO1_IRQ_0 (9) is its own.
        state[s.MASKED_IRQS] = 1 << 13 | 1 << 9 | 15
        state[s.BUSY] = 1 << 24  # bit BUSY of a DMA channel's CTRL
        if s.RP2350:
            state[s.CLOCK_PIO] = reg.PIO1_AT
            if rp2350:
                # The same registers and interrupts, at an RP2350's addresses and numbers.
                state[s.TIMER] = 0x400B0028  # TIMERAWL of TIMER0
                state[s.MASKED_IRQS] = 1 << 21 | 1 << 17 | 15
                state[s.BUSY] = 1 << 26
            if axes > s.BEFORE_CLOCK:  # the eighth lane has the clock's machine of PIO 1
                state[s.CLOCK_PIO] = reg.PIO2_AT
                state[s.OURS_2] = 1 << s.CLOCK
                state[s.MASKED_IRQS] |= 1 << 19  # PIO2_IRQ_0

    def connect(self, axis: int, channel: int) -> None:
        """Store the addresses of a lane's registers: those of its state machine among the lane's
        integers, those of its DMA channel, `channel`, in the engine state. axis: the lane's
        number."""
        pio = self.state[s.PIO0 + (axis >> s.BLOCK_LOG2)]
        number = axis & s.IN_BLOCK  # of the machine, in its PIO
        self.lanes[LANE * axis + MACHINE] = pio + 4 * (reg.MACHINES + reg.MACHINE_STRIDE * number)
        self.state[s.DMA + axis] = registers = reg.DMA_AT + reg.DMA_EACH * channel
        # A write makes the channel count its FIFO's free space anew.
        machine.mem32[registers + 4 * reg.CREDITS] = 0
