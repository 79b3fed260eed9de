"""Axis, Output, Group: axes that move together, and outputs that change with their moves."""

import math

from micropython import const

from ugrbl_motion import hardware as chip
from ugrbl_motion.line_queue import LEVEL_BITS, REACH, LineQueue, Motor

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from interfaces import GroupHardware

_POLL_MS = const(5)


class GroupError(Exception):
    """Motion is not possible as asked, or has failed; the text has cause and next step."""


class Output:
    """A pin that changes as a move begins. level: at the start, 0 or 1."""

    def __init__(self, pin: int, level: int = 0) -> None:
        self.pin = pin
        self.level = level


class Axis(Motor):
    """One motor with STEP and DIR. Units are the program's own; times are in seconds.

    step, direction: pin numbers. steps_per_unit: resolution. speed: highest, units/s.
    acceleration: units/s2. invert: DIR is low for positive moves if False, high if True. Raises
    ValueError for numbers that are not above 0.
    """

    name = ""
    index = 0
    _group: "Group | None" = None

    def join(self, group: "Group", name: str, index: int) -> None:
        """Become part of a group; called by Group. Raises ValueError if it is part of one."""
        if self._group is not None:
            raise ValueError("axis %s is in two groups: make an Axis for each" % name)
        self._group, self.name, self.index = group, name, index

    @property
    def group(self) -> "Group":
        """Return the group of this axis. Raises ValueError if it has none."""
        if self._group is None:
            raise ValueError("this axis is in no group: create one first, Group(x=axis)")
        return self._group

    @property
    def steps(self) -> int:
        """Return the steps executed, the motor's position at this moment."""
        return self.group.steps(self.index)

    @property
    def position(self) -> float:
        """Return the position at this moment, in units."""
        return self.steps / self.steps_per_unit

    @property
    def target(self) -> float:
        """Return the position at the end of the queued moves, in units."""
        return self.group.end(self.index) / self.steps_per_unit

    def move(self, to: float, speed: "float | None" = None) -> int:
        """Queue a move of this axis alone, to a position. See Group.move()."""
        return self.group.move(speed, **{self.name: to})

    def move_by(self, distance: float, speed: "float | None" = None) -> int:
        """Queue a move of this axis alone, by a distance. See Group.move_by()."""
        return self.group.move_by(speed, **{self.name: distance})

    def run(self, speed: float) -> int:
        """Queue a move without an end at a speed, negative for backwards, until Group.stop().

        Its mean rate is exact to 1e-6 of the processor's clock. Group.pace() changes it. Returns
        the number of the move.
        """
        return self.group.run(self, speed)

    def place(self, position: float) -> None:
        """Declare the present position, without motion. Raises GroupError during motion."""
        self.group.place(self, position)

    async def moved(self, move: "int | None" = None) -> None:
        """Wait for the end of a move, or of all moves. See Group.moved()."""
        await self.group.moved(move)


class Group:
    """Axes and outputs by name: Group(x=Axis(...), y=Axis(...), camera=Output(15)).

    corner: how far, in units, the path may be thought to be rounded where two moves meet; it sets
    the speed there (junction deviation). queue: one more than the moves that fit. pulse_us: length
    of a step. hardware: the simulator's, or a test's; None: this chip's. Raises ValueError
    for parts that do not go together, OSError if this chip has no step engine.

    Calls queue motion and return; they wait only for space in the queue. wait() waits in a plain
    program, `await moved()` in a task. A failure of the engine is a GroupError of the next call.
    A move's number, which calls return, is for done() and moved().
    """

    def __init__(
        self,
        *,
        corner: float = 0.01,
        queue: int = 16,
        pulse_us: int = 3,
        hardware: "GroupHardware | None" = None,
        **parts: "Axis | Output",
    ) -> None:
        self.axes: "list[Axis]" = []
        self._outputs: "dict[str, int]" = {}  # the bit of each in a mask of levels
        pins: "list[int]" = []
        levels = 0
        for name in sorted(parts):
            part = parts[name]
            if isinstance(part, Axis):
                part.join(self, name, len(self.axes))
                self.axes.append(part)
            else:
                self._outputs[name] = bit = 1 << len(pins)
                pins.append(part.pin)
                levels |= bit if part.level else 0
        if not self.axes or len(pins) > LEVEL_BITS:
            raise ValueError("a group has at least one Axis, and at most %d Outputs" % LEVEL_BITS)
        self.hardware = hardware or chip.own()
        self._lines = LineQueue(self.axes, self.hardware, corner, queue, pulse_us, levels)
        self.hardware.make_outputs(pins, levels)
        self._rounding = [0.0] * len(self.axes)  # what rounding to steps has left over, in steps

    # Moves

    def move(
        self, speed: "float | None" = None, seconds: "float | None" = None, **to: float
    ) -> int:
        """Queue a straight line to a position, x=10.0; outputs by name, 0 or 1, change with it.

        speed: along the line, units/s; or seconds: how long it takes, without its ramps; with
        neither, as fast as the axes can. Limits of axes are kept in any case. Waits if the queue
        is full. Returns the move's number for moved() and done(). Raises ValueError for unknown
        names and positions out of reach: nothing has changed then.
        """
        return self._queue(speed, seconds, to, by=False)

    def move_by(
        self, speed: "float | None" = None, seconds: "float | None" = None, **by: float
    ) -> int:
        """Queue a straight line by a distance, from where the queued moves end. See move().

        What is rounded off to whole steps is made up by the next move: distances never drift.
        """
        return self._queue(speed, seconds, by, by=True)

    def run(self, axis: "Axis", speed: float) -> int:
        """Queue a move of one axis without an end: Axis.run()."""
        if speed == 0:
            raise ValueError("speed must not be 0: stop() ends a motion")
        lines = self._lines
        self._wait_for_space()
        for i in range(len(self.axes)):  # the others stay where the queued moves end
            lines.ends[i] = lines.end(i)
        lines.ends[axis.index] = REACH if speed > 0 else -REACH
        speed = min(abs(speed), axis.speed, lines.fastest_hz / axis.steps_per_unit)
        return lines.plan(speed * axis.steps_per_unit, speed)

    def set(self, **levels: bool) -> None:
        """Set outputs by name, 0 or 1, at the end of the queued moves; at once without any."""
        wanted = self._levels_after(levels)
        self._check()
        self._lines.set_levels(wanted, now=True)

    def _queue(
        self, speed: "float | None", seconds: "float | None", wanted: "dict[str, float]", by: bool
    ) -> int:
        """Check a move completely, then plan it. Returns its number.

        wanted: positions in units, or distances if `by` is True, and levels of outputs, by name.
        speed, seconds: see move(). Raises ValueError, and nothing has changed then.
        """
        if (speed is not None and speed <= 0) or (seconds is not None and seconds <= 0):
            raise ValueError("speed and seconds must be above 0")
        names = [axis.name for axis in self.axes]
        levels = self._levels_after({name: wanted[name] for name in wanted if name not in names})
        self._wait_for_space()
        rounding = self._rounding[:]  # a copy, because the move may still be refused
        for i, axis in enumerate(self.axes):
            end = start = self._lines.end(i)  # where the queued moves end, in steps
            if axis.name in wanted:
                exact = wanted[axis.name] * axis.steps_per_unit
                if by:
                    exact += rounding[i]
                steps = math.floor(exact + 0.5)
                rounding[i] = exact - steps
                end = start + steps if by else steps
            if not -REACH <= end <= REACH:
                raise ValueError("%s is out of reach, at %d steps from 0" % (axis.name, end))
            self._lines.ends[i] = end
        self._rounding = rounding
        self._lines.set_levels(levels, now=False)  # but as the move begins
        return self._lines.plan(*self._speeds(speed, seconds))

    def _levels_after(self, wanted: "Mapping[str, float]") -> int:
        """Return the outputs' levels after all moves, a bit each, with these changes: 0 or 1 by
        name. Raises ValueError for an unknown name."""
        levels = self._lines.levels
        for name in wanted:
            if name not in self._outputs:
                raise ValueError("no axis or output in this group is named %s" % name)
            bit = self._outputs[name]
            levels = levels | bit if wanted[name] else levels & ~bit
        return levels

    def _speeds(self, speed: "float | None", seconds: "float | None") -> "tuple[float, float]":
        """Return the speed of the line to the ends, within the limits of axes: steps/s of the axis
        with the most steps, and units/s along the line. Zeros: as fast as possible."""
        most = 0  # steps of one axis
        squares = shortest_s = 0.0  # of distances; time that the axes' limits allow
        for i, axis in enumerate(self.axes):
            steps = abs(self._lines.ends[i] - self._lines.end(i))
            most = max(most, steps)
            distance = steps / axis.steps_per_unit
            squares += distance * distance
            shortest_s = max(shortest_s, distance / axis.speed, steps / self._lines.fastest_hz)
        if (speed is None and seconds is None) or most == 0:
            return 0.0, 0.0
        length = math.sqrt(squares)
        wanted_s = length / speed if speed is not None else seconds or 0.0
        line_s = max(wanted_s, shortest_s)
        return most / line_s, length / line_s

    def pace(self, factor: float) -> None:
        """Execute all moves, the present one too, at `factor` times their speed, 0.01 to 10.

        Limits of axes are kept. It stays in force until the next call.
        """
        if not 0.01 <= factor <= 10:
            raise ValueError("pace must be 0.01 to 10; to stand still, use pause()")
        self._lines.pace(factor)

    # Stops

    def stop(self) -> None:
        """Slow down, stop, and drop all moves. wait() or moved() waits for that."""
        self._lines.stop()
        self._check()

    def halt(self) -> None:
        """Stop at once, without a ramp, and drop all moves. Callable in an interrupt.

        Positions stay those of the steps executed; motors that were fast may have lost theirs.
        """
        self._lines.halt()

    def pause(self) -> None:
        """Slow down and stop. resume() continues on the same path."""
        self._lines.pause()

    def resume(self) -> None:
        """Continue after pause()."""
        self._lines.resume()

    def _check(self) -> None:
        """Let the queue do what is due after stops. Raises GroupError if the engine has failed.

        After a stop, positions are where the motors are: what rounding has left over is void.
        """
        was_stopping = self._lines.stopping
        fault = self._lines.check()
        if fault or (was_stopping and not self._lines.stopping):  # all moves were dropped
            self._rounding = [0.0] * len(self.axes)
        if fault:
            raise GroupError("motion was stopped: %s. Find the position again" % fault)

    # Positions

    def steps(self, index: int) -> int:
        """Return the steps executed by an axis: Axis.steps."""
        return self._lines.present()[index]

    def end(self, index: int) -> int:
        """Return the steps from 0 of an axis at the end of the queued moves."""
        return self._lines.end(index)

    def place(self, axis: "Axis", position: float) -> None:
        """Declare the present position of an axis: Axis.place()."""
        self._check()
        if self._lines.busy():
            raise GroupError("positions cannot be set during motion: wait() or stop() first")
        self._lines.place(axis.index, math.floor(position * axis.steps_per_unit + 0.5))
        self._rounding[axis.index] = 0.0

    # Waiting

    def space(self) -> int:
        """Return how many moves the queue takes without waiting; 0 while stopping."""
        self._check()
        return self._lines.space()

    def done(self, move: "int | None" = None) -> bool:
        """Return whether a move, or all moves, are executed or dropped."""
        self._check()
        if not self._lines.busy():
            return True
        return move is not None and not self._lines.stopping and self._lines.begun_after(move)

    def wait(self, move: "int | None" = None) -> None:
        """Wait until a move, or all moves, are executed. Raises GroupError during a pause."""
        while not self.done(move):
            self._refuse_pause()
            self.sleep()

    async def moved(self, move: "int | None" = None) -> None:
        """Wait until a move, or all moves, are executed, while other tasks run."""
        while not self.done(move):
            await self.sleep_task()

    async def ready(self) -> None:
        """Wait until the queue has space, while other tasks run. move() does not wait then."""
        while not self.space():
            await self.sleep_task()

    def until_done(self) -> "Iterator[None]":
        """Yield until all moves are executed: for code that serves plain programs and tasks."""
        while not self.done():
            yield

    def _wait_for_space(self) -> None:
        """Wait until the queue has space. Raises GroupError during a pause."""
        while not self.space():
            self._refuse_pause()
            self.sleep()

    def _refuse_pause(self) -> None:
        """Refuse to wait for the end of a pause, which only the waiting program can end."""
        if self._lines.paused and not self._lines.stopping:
            raise GroupError("motion is paused: resume() or stop() first")

    def sleep(self) -> None:
        """Wait for a moment."""
        self.hardware.sleep_ms(_POLL_MS)

    async def sleep_task(self) -> None:
        """Let other tasks run for a moment."""
        from asyncio import sleep

        await sleep(_POLL_MS / 1000)
