"""Segments as Grbl makes them: the slices of each joined, with evenly spaced steps.

The firmware cuts each segment into slices, a row each: its time, and the number of steps of each
motor with the ticks of the first and of the last one (motion/layout.py).
Recordings of real Grbl are compared with these: of a ramp they show only the mean speed in 10 ms,
and Grbl reacts to a hold no more often. Runs under CPython and MicroPython.
"""

from array import array

from motion.layout import (
    BLOCK_AT,
    LOADED,
    MOTORS,
    PARTIAL_STEP,
    ROW_AXES,
    ROW_POWER,
    ROW_STRIDE,
    ROW_TICKS,
    SLICES,
    SPARE_TICKS,
)
from motion.slice_kernel import STEP_BIAS

TYPE_CHECKING = False
if TYPE_CHECKING:
    from talk.controller import Controller

_STEP = 1 << 18  # a step in the units of the planner's PARTIAL_STEP, and of phases
_HALF_STEP = 1 << 17


class FullSegments:
    """Joins slices between a controller's segments and its engine."""

    def __init__(self, controller: "Controller") -> None:
        self._flow = controller.planner.flow
        self._hooks = controller.state.hooks
        self._next_slice = self._hooks.next_segment
        self._motors = controller.planner.motors
        # Ticks that a segment has left to the next one of its block, by block: as SPARE_TICKS, but
        # after whole segments and not after slices.
        self._spares: "dict[int, int]" = {}

    def attach(self) -> None:
        """Install itself between them. Call it before power_up()."""
        self._hooks.next_segment = self.next

    def next(self, row: "array[int]") -> int:
        """Replace Segments.next(): fill the row with a segment. Returns 0 if there is none."""
        flow = self._flow
        is_new_block = not flow[LOADED]
        # A block begins half way between two steps.
        phases = [_HALF_STEP] * self._motors if is_new_block else self._phases()
        spare_before = 0 if is_new_block else flow[SPARE_TICKS]
        has_segment = self._next_slice(row)
        if has_segment:
            while flow[SLICES]:  # more of this segment
                self._add_slice(row)
            # Slices end with a step: make it the time of the segment, up to its own end.
            row[ROW_TICKS] += flow[SPARE_TICKS] - spare_before
            self._end_with_step(row, is_new_block)
            self._set_step_ticks(row, phases)
        elif not flow[SPARE_TICKS]:  # it ended on a step: no block goes on
            self._spares.clear()
        return has_segment

    def _phases(self) -> "list[int]":
        """Return the part of a step that each motor has moved beyond its last one, in units of
        2**-18 step."""
        return [self._flow[MOTORS + 2 * i + 1] for i in range(self._motors)]

    def _add_slice(self, row: "array[int]") -> None:
        """Add the next slice's time and steps to a segment."""
        slice = array("i", row)
        self._next_slice(slice)
        row[ROW_TICKS] += slice[ROW_TICKS]
        row[ROW_POWER] = slice[ROW_POWER]
        for base in range(ROW_AXES, len(row), ROW_STRIDE):
            row[base] += slice[base]

    def _end_with_step(self, row: "array[int]", is_new_block: bool) -> None:
        """End the segment with a step of the longest axis. The time after it follows from the mean
        speed, and is added to the block's next segment."""
        flow = self._flow
        ticks = row[ROW_TICKS] + (0 if is_new_block else self._spares.get(flow[BLOCK_AT], 0))
        steps = max(row[base] for base in range(ROW_AXES, len(row), ROW_STRIDE))
        spare = 0
        if steps and flow[PARTIAL_STEP] > STEP_BIAS:  # at most the bias: it ends on the step
            up_to_step = steps * _STEP
            spare = ticks - ticks * up_to_step // (up_to_step + flow[PARTIAL_STEP])
        self._spares[flow[BLOCK_AT]] = spare
        row[ROW_TICKS] = max(ticks - spare, 1)

    def _set_step_ticks(self, row: "array[int]", before: "list[int]") -> None:
        """Set the ticks of the first and the last step of each motor, as at a constant speed in
        the segment. before: the phases at the beginning."""
        after = self._phases()
        ticks = row[ROW_TICKS]
        for i in range(self._motors):
            base = ROW_AXES + ROW_STRIDE * i
            count = row[base]
            distance = max(count * _STEP + after[i] - before[i], 1)
            # row[base + 1] is the tick of the first step, row[base + 2] of the last one.
            for place, step in ((1, 1), (2, count)) if count else ():  # step: from 1
                row[base + place] = min((step * _STEP - before[i]) * ticks // distance, ticks)
