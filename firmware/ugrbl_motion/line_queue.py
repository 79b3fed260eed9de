"""Line queue: straight lines in whole steps, executed one after the other by the step engine.

The wiring of ugrbl's planner, segments and engine without a G-code machine. Group puts names and
units on it. The planner's spindle power carries the number of a move and the levels of outputs to
the moment when the move begins; its line number carries the exact rate (exact.py). For the planner
a unit of the program is _scale mm, and seconds are minutes / 60.

The planner's flow: HEAD is the row of its ring where the next block is put, TAIL that of the block
being executed; if they are equal, no move is left. ROWS is the number of rows.
"""

import math
from array import array

import micropython
from base.float32 import copy
from base.hooks import Hooks
from micropython import const
from motion import layout
from motion.layout import HEAD, LINE, ROWS, TAIL
from motion.planner import Move, Planner

from ugrbl_motion.exact import ExactSegments

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Sequence

    from interfaces import GroupHardware

REACH = const(0x1FFFFF00)  # farthest position, in steps from 0
_BIAS = const(0x20000000)  # 2**29, added to positions in the planner's table

# What the interrupt shares with the main loop: indexes in _state.
_PLAYING = const(0)  # the move being executed: its number << LEVEL_BITS, and the outputs' levels
_FINAL_LEVELS = const(1)  # levels after all queued moves
LEVEL_BITS = const(8)  # at most 8 outputs; above their levels is the move's number
_LEVELS_MASK = const(0xFF)  # mask of levels
_NUMBER_MASK = const(0xFFFFF)  # mask of a move's number, which wraps
_HALF_RANGE = const(0x80000)  # a difference of two numbers from here on is negative


class Motor:
    """A motor with STEP and DIR, and its limits; see group.Axis."""

    def __init__(
        self,
        step: int,
        direction: int,
        steps_per_unit: float,
        speed: float,
        acceleration: float,
        invert: bool = False,
    ) -> None:
        if min(steps_per_unit, speed, acceleration) <= 0:
            raise ValueError("steps_per_unit, speed and acceleration must be above 0")
        self.step = step
        self.direction = direction
        self.steps_per_unit = steps_per_unit
        self.speed = speed
        self.acceleration = acceleration
        self.invert = invert


class _Limits:
    """Limits of axes for Planner.configure(), which expects mm and minutes: scale * mm stand for
    one unit of the program. corner: junction deviation, in units."""

    def __init__(self, axes: "Sequence[Motor]", scale: float, corner: float) -> None:
        self.steps_per_mm = [axis.steps_per_unit / scale for axis in axes]
        self.max_rate = [axis.speed * scale * 60 for axis in axes]
        self.acceleration = [axis.acceleration * scale * 3600 for axis in axes]
        self.junction_deviation_mm = corner * scale


class _Overrides:
    """What the planner reads of a machine's state: overrides, in percent, and hooks."""

    def __init__(self) -> None:
        self.hooks = Hooks()
        self.feed_override: float = 100
        self.rapid_override: float = 100


class LineQueue:
    """The queue. `ends` is filled in before plan(). corner: junction deviation, in units.

    length: rows of the planner's ring. levels: of the outputs, a bit each, at the start. stopping:
    from stop() until check() has dropped all moves; paused: from pause() until resume().
    """

    def __init__(
        self,
        axes: "Sequence[Motor]",
        hardware: "GroupHardware",
        corner: float,
        length: int,
        pulse_us: int,
        levels: int,
    ) -> None:
        count = len(axes)
        self._hardware = hardware
        self._state = array("i", (levels, levels))  # _PLAYING, of move 0, and _FINAL_LEVELS
        self._engine = engine = hardware.engine(
            tuple([axis.step for axis in axes]), tuple([axis.direction for axis in axes])
        )
        # The planner's unit is about a step, so that its slowest speed is a step per minute.
        finest = max([axis.steps_per_unit for axis in axes])
        # A power of 2, so that nothing is rounded. Planner, with None: motor i moves axis i.
        self._scale = scale = 2.0 ** math.floor(math.log(finest) / math.log(2))
        self._overrides = _Overrides()
        self._planner = planner = Planner(count, length, None, self._overrides)
        self._segments = ExactSegments(planner, array("i", (0,)))  # the fraction of a tick due
        dir_invert = sum([1 << i for i in range(count) if axes[i].invert])
        engine.configure(pulse_us, step_invert=0, dir_invert=dir_invert)
        self.fastest_hz = engine.max_step_hz(pulse_us)
        planner.configure(
            _Limits(axes, scale, corner), engine.tick_hz, engine.segment_log2, self.fastest_hz
        )
        planner.override()  # sets the table's overrides, 100 %
        engine.attach(self._segments.next, self._on_row, self._on_rest)
        engine.arm()
        self.ends = array("i", (0 for _ in range(count)))  # of the move being prepared, in steps
        self.paused = self.stopping = False
        self._targets = memoryview(planner.table)[layout.LIMITS + layout.TARGET * count :]
        self._move = Move()
        # A target in mm that nobody reads: with PLACED, targets are steps in the planner's table.
        self._unused_target = array("f", (0.0 for _ in range(count)))
        self._steps = array("i", (0 for _ in range(count)))
        # Ticks per step at pace 1, per row of the ring.
        self._periods = array("f", (0.0 for _ in range(length)))
        self._cell = array("f", (0.0,))  # a float,
        self._cell_bits = array("i", (0,))  # and its bits: _period_bits()
        self._factor = 1.0  # the pace
        self._number = 0  # of the last move

    # In the engine's interrupt

    @micropython.native
    def _on_row(self, playing: int) -> None:
        """Note the move of a row that begins, and set the outputs if they change. playing: the
        move's number << LEVEL_BITS, and the outputs' levels: the row's spindle power."""
        state = self._state
        before = state[_PLAYING]
        state[_PLAYING] = playing
        if (before ^ playing) & _LEVELS_MASK:
            self._hardware.write(playing & _LEVELS_MASK)

    @micropython.native
    def _on_rest(self) -> None:
        """Set the outputs that change after the last move: the engine has run out of rows."""
        flow = self._planner.flow
        if flow[HEAD] == flow[TAIL]:  # no move is left; else a hold has stopped the engine
            state = self._state
            # As a row of the same move, with other levels.
            self._on_row(state[_PLAYING] & ~_LEVELS_MASK | state[_FINAL_LEVELS])

    @micropython.native
    def halt(self) -> None:
        """Stop at once, without a ramp, and drop all moves. Callable in an interrupt."""
        self.stopping = True
        self._engine.stop()

    # Moves

    def plan(self, rate: float, feed: float) -> int:
        """Plan a line to `ends`, which must be within REACH, and start motion. Returns the number
        of the last move: this one, or the one before if this one has no steps.

        The queue must have space. rate: steps/s of the axis with the most steps, and feed, units/s
        along the line, are the same speed; 0: as fast as possible.
        """
        planner, move = self._planner, self._move
        move.clear()
        move.flags = layout.PLACED
        if rate:
            head = planner.flow[HEAD]  # the row that the move will have
            self._periods[head] = self._engine.tick_hz / rate
            move.line_number = self._period_bits(head)  # its place carries the exact period
            move.feed = 60.0 * self._scale * feed  # the planner's mm/min
        else:
            move.flags |= layout.RAPID_MOTION
        for i, end in enumerate(self.ends):  # PLACED: the target is in the planner's table
            self._targets[i] = _BIAS + end
        number = (self._number + 1) & _NUMBER_MASK
        # The place of the spindle power carries both: _on_row() gets it as the move begins.
        power_field = number << LEVEL_BITS | self.levels
        if planner.line(self._unused_target, move, power_field):
            self._number = number
            if not self.paused:
                self._engine.start()
        elif not self.busy():  # no steps: outputs change without a move
            self._on_rest()
        return self._number

    def _period_bits(self, row: int) -> int:
        """Return the ticks per step of a row of the ring, at the present pace, as the bits of a
        float: for exact.set_time()."""
        self._cell[0] = self._periods[row] / self._factor
        copy(self._cell, self._cell_bits, 1)
        return self._cell_bits[0]

    def pace(self, factor: float) -> None:
        """Execute all moves, the present one too, at `factor` times their speed."""
        planner, flow = self._planner, self._planner.flow
        self._factor = factor
        self._overrides.feed_override = self._overrides.rapid_override = 100 * factor
        planner.override()  # plans all moves again; below, their exact rates follow
        row = flow[TAIL]
        while row != flow[HEAD]:
            # LINE: not a line number here, but the exact period as bits, 0 for none.
            period_at = row * flow[layout.ROW_SIZE] + LINE  # index in the ring
            if planner.ring[period_at]:
                planner.ring[period_at] = self._period_bits(row)
            row = (row + 1) % flow[ROWS]

    @property
    def levels(self) -> int:
        """Return the outputs' levels after all moves."""
        return self._state[_FINAL_LEVELS]

    def set_levels(self, levels: int, now: bool) -> None:
        """Set the outputs' levels, a bit each, from the end of the queued moves on. now: also set
        them at once, if nothing moves or waits."""
        self._state[_FINAL_LEVELS] = levels
        if now and not self.busy():
            self._on_rest()  # sets them

    # Stops

    def stop(self) -> None:
        """Slow down and stop. All moves are dropped then, by check()."""
        self.stopping = True
        self._segments.hold(True)

    def pause(self) -> None:
        """Slow down and stop."""
        self.paused = True
        self._segments.hold(True)

    def resume(self) -> None:
        """Continue after pause()."""
        self.paused = False
        if not self.stopping:
            self._segments.hold(False)
            self._engine.start()

    def check(self) -> str:
        """Do what is due after stops and underruns. Returns a fault of the engine, "" if there is
        none; after a fault nothing moves, and the outputs are off."""
        fault = self._engine.fault()
        if fault:
            self._state[_PLAYING] &= ~_LEVELS_MASK  # outputs off, and
            self._hardware.write(0)
            self._restart()  # they stay so
            return fault
        planner = self._planner
        planner.catch_up()
        if self._engine.idle():
            if self.stopping:
                self._restart()
            elif not self.paused and not planner.empty():
                self._engine.start()  # it has run out of rows before the next move was planned
        return ""

    def _restart(self) -> None:
        """Drop all moves after a stop, plan from where the motors are, and allow motion again. The
        outputs keep their present levels."""
        self._engine.stop()
        self._planner.clear()
        self._segments.clear()
        self._planner.sync_motors(self.present())  # POSITION in the planner's table
        state = self._state
        levels = state[_PLAYING] & _LEVELS_MASK
        state[_PLAYING] = self._number << LEVEL_BITS | levels
        state[_FINAL_LEVELS] = levels
        self.stopping = self.paused = False
        self._engine.arm()

    # Positions and progress

    def present(self) -> "array[int]":
        """Return the steps executed, per axis; valid until the next call."""
        self._engine.position(self._steps)
        return self._steps

    def end(self, index: int) -> int:
        """Return the steps from 0 of the axis number `index` at the end of the queued moves."""
        return self._planner.position[index] - _BIAS

    def place(self, index: int, steps: int) -> None:
        """Declare the present position of the axis number `index`, in steps. Only while nothing
        moves."""
        present = self.present()
        present[index] = steps
        self._engine.set_position(present)
        self._planner.sync_motors(present)

    def busy(self) -> bool:
        """Return whether a move is being executed or waits, also in a pause."""
        return not (self._planner.empty() and self._engine.idle())

    def space(self) -> int:
        """Return how many moves can be added; 0 while stopping."""
        return 0 if self.stopping else self._planner.free()

    def begun_after(self, number: int) -> bool:
        """Return whether a later move than that one has begun."""
        playing = self._state[_PLAYING] >> LEVEL_BITS
        ahead = playing - number & _NUMBER_MASK  # numbers wrap: a large difference is negative
        return 0 < ahead < _HALF_RANGE
