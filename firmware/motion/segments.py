"""Segments: constant-rate pieces of motion, cut from the planner's blocks on demand.

The pulse engine calls next() from its interrupt; all work there is in segment_kernel.py. The main
loop controls it through a few words of the flow: hold, resume, the system's own block.
"""

import micropython
from base.float32 import f32, for_kernels
from micropython import const

from motion import layout
from motion.layout import BLOCK_AT, END_SPEED, FACTOR, HOLD, JOIN_SPEED, LOADED, ROW_SPEED
from motion.minifloat import ratio, value
from motion.planner import SPINDLE_MASK
from motion.segment_kernel import fill

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array

    from motion.planner import Planner


class Segments:
    """The source of segments for the engine.

    planner: the owner of flow, ring and table, arrays whose places layout.py names.
    """

    def __init__(self, planner: "Planner") -> None:
        self._planner = planner
        self._flow = planner.flow
        self._ring = planner.ring
        # The same arrays for next(), as addresses on a board: the planner keeps them allocated.
        self._flow_at = for_kernels(planner.flow)
        self._ring_at = for_kernels(planner.ring)
        self._table_at = for_kernels(planner.table)
        self._saved: "array[int] | None" = None  # the flow, during the system's own moves

    @micropython.viper
    def next(self, row: ptr32) -> int:
        """Fill in the next segment's row, for the engine's interrupt. Returns 1; 0 if no motion is
        due, and then the row is not valid.

        Only viper runs from there to here: a frame of bytecode takes a quarter of a kilobyte of
        the stack, which the interrupt shares with the code that it interrupts.
        """
        flow = ptr32(self._flow_at)
        ring = ptr32(self._ring_at)
        table = ptr32(self._table_at)
        return int(fill(flow, ring, table, row))

    def hold(self, on: bool) -> None:
        """Slow down and stop; or resume."""
        self._flow[HOLD] = 1 if on else 0

    def progress(self) -> int:
        """Return a number that changes as motion is executed; it has no other meaning."""
        flow = self._flow
        # Any mixture of the three will do, because two such numbers are only compared.
        return flow[layout.TAIL] ^ flow[layout.STEPS_LEFT] << 6 ^ flow[LOADED] << 5

    def begin_system(self) -> None:
        """Save the stopped block in progress, so that the system's own moves can be executed. The
        machine stands still; the next move begins at speed 0."""
        if self._saved is None:
            self._saved = type(self._flow)("i", self._flow)  # a copy, without importing array
        self._flow[LOADED] = 0
        self._flow[END_SPEED] = 0
        self._flow[JOIN_SPEED] = 0

    def end_system(self) -> None:
        """Restore the saved block in progress."""
        self._flow[layout.SYSTEM] = 0
        if self._saved is not None:
            for i in range(LOADED, len(self._flow)):  # the interrupt's part of the flow
                self._flow[i] = self._saved[i]
            self._saved = None

    def clear(self) -> None:
        """Drop the block that begin_system() has saved. Only while the engine is stopped."""
        self._saved = None

    @micropython.viper
    def rate(self) -> int:
        """Return the speed at the end of the last row: a real, in mm/s. A kernel, because its
        callers have used much of the stack."""
        flow = ptr32(self._flow)
        if flow[LOADED]:
            ring = ptr32(self._ring)
            # In a block: from its own speed units, of which FACTOR is the number per mm/s.
            return int(ratio(flow[ROW_SPEED], ring[flow[BLOCK_AT] + FACTOR]))
        return flow[JOIN_SPEED]  # between blocks

    def beam_rpm(self) -> "float | None":
        """Return S, in rpm, of the block being cut into rows; with DYNAMIC, scaled to its present
        speed. None if there is no block."""
        flow, ring = self._flow, self._ring
        # Index in the ring of the loaded block, or of the next one.
        at = flow[BLOCK_AT] if flow[LOADED] else flow[layout.TAIL] * flow[layout.ROW_SIZE]
        if not flow[LOADED] and flow[layout.TAIL] == flow[layout.HEAD]:
            return None
        flags, programmed = ring[at + layout.FLAGS], ring[at + layout.PROGRAMMED]
        # Spindle off, or a block whose power follows a rate of 0.
        if not flags & SPINDLE_MASK or (flags & layout.DYNAMIC and not programmed):
            return 0.0
        rpm = self._planner.speeds[at // flow[layout.ROW_SIZE]]
        if not flags & layout.DYNAMIC:
            return rpm
        programmed_rate = ratio(programmed, ring[at + FACTOR])  # a real, mm/s, as rate() returns
        return f32(rpm * value(self.rate()) / value(programmed_rate))
