"""A pulse engine whose beam changes power at the exact step, as a board's does."""

from array import array

from motion import beam_layout as bm
from motion.layout import ROW_AXES, ROW_DIRS, ROW_POWER, ROW_STRIDE, ROW_TICKS, row_length

from .engine import SimEngine, step_tick, steps_until

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable


class SimBeamEngine(SimEngine):
    """SimEngine that plays a segment in pieces; each begins where the power changes."""

    def __init__(self, axes: int, depth: int = 3, segment_log2: int = 17) -> None:
        super().__init__(axes, depth, segment_log2)
        self.beam = array("i", [0] * bm.LENGTH)
        self.beam[bm.BOTH] = 1  # a factor on all levels
        self.beam[bm.LEVEL] = bm.UNKNOWN
        self.levels = array("i", [0] * (bm.LEVELS_MASK + 1))
        # The segment as it was pulled. After the motors it has the beam, as one more of them: a
        # step is a change of power, to the next one in the ring `levels`.
        self._whole = array("i", [0] * row_length(axes + 1))
        self._pieces: "list[array[int]]" = []
        self._levels_taken = 0  # number of levels taken from the ring
        self._level = 0  # the power at the end of the pieces
        self.burning: "Callable[[], int]" = int  # returns the power when idle; int(): 0

    # The interface of a beam

    def scale(self, power_max: int) -> None:
        """Set the scale: a level is the power itself."""
        self.beam[bm.FULL] = bm.full(power_max, power_max)

    def put_out(self) -> None:
        """Do nothing: no level is queued that power() would not report."""

    # The StepEngine interface

    def arm(self) -> None:
        super().arm()
        # Levels queued before belong to motion that was dropped.
        self._levels_taken = self.beam[bm.COUNT]

    def start(self) -> None:
        """Begin motion with the power as it is."""
        if not self._running and not self._stopped:
            self.beam[bm.LEVEL] = bm.UNKNOWN  # so that the firmware queues the first one again
            self._level = self.burning()
        super().start()

    def stop(self) -> None:
        super().stop()
        self._pieces.clear()

    # Interface for the simulator

    def _refill(self) -> None:
        """Put pieces into the queue, of more segments if needed, until it is full."""
        size = len(self._queue)
        while self._held < size:
            if not self._pieces and self._next_segment(self._whole):  # it fills the row
                self._cut_at_changes()
            if not self._pieces:
                break
            self._queue[(self._head + self._held) % size] = self._pieces.pop(0)
            self._held += 1

    def _cut_at_changes(self) -> None:
        """Cut the segment into pieces, at each change of power."""
        row, base = self._whole, ROW_AXES + ROW_STRIDE * self._axes  # base: of the beam
        row[ROW_DIRS] ^= self.dir_invert  # as at the pins
        begin = 0
        for change in range(row[base]):
            tick = min(step_tick(row, base, change), row[ROW_TICKS])
            self._append_piece(begin, tick)
            begin = tick
            self._level = self.levels[self._levels_taken & bm.LEVELS_MASK]
            self._levels_taken += 1
        self._append_piece(begin, row[ROW_TICKS])

    def _append_piece(self, begin: int, end: int) -> None:
        """Append the piece from tick `begin` of the segment, exclusive, to `end`, inclusive. The
        first piece includes a step at tick 0."""
        if begin == end:
            return
        row = self._whole
        piece = array("i", row[: row_length(self._axes)])
        piece[ROW_TICKS], piece[ROW_POWER] = end - begin, self._level
        for i in range(self._axes):
            base = ROW_AXES + ROW_STRIDE * i
            before = steps_until(row, base, begin) if begin else 0
            steps = steps_until(row, base, end) - before
            piece[base] = steps
            if steps:  # the ticks of its first and its last step, from the start of the piece
                piece[base + 1] = step_tick(row, base, before) - begin
                piece[base + 2] = step_tick(row, base, before + steps - 1) - begin
        self._pieces.append(piece)
