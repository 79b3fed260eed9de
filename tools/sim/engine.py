"""Pulse engine of the simulator, with exact step times.

Segments are pulled through the same interface as on a board and played in virtual time. Switches
that close at a position act at the exact step.

A segment is a row of integers: ROW_TICKS, its duration; ROW_DIRS, a mask of motors that turn
backwards; ROW_POWER, the tool's power; and for each motor, from `base` on, the number of its steps
and the ticks of the first and of the last one, from the start of the segment (motion/layout.py).
"""

from array import array

from motion.layout import ROW_AXES, ROW_DIRS, ROW_POWER, ROW_STRIDE, ROW_TICKS, row_length

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import NextSegment

_NEVER = 1 << 60  # a tick that never comes
# Places in a row after row[base], the number of the motor's steps.
_FIRST_TICK = 1  # the tick of its first step
_LAST_TICK = 2  # the tick of its last step


def leading(gaps: int, gap: int, longer: int) -> int:
    """Return how many of the longer gaps come first; the others come last. This is
    slice_kernel.leading(), in Python because it is called for each step.

    gaps: number of all gaps between a segment's steps. gap: ticks of a short one; `longer` of the
    gaps have one tick more. They are halved if, all at the beginning, they would displace a step
    by an eighth of a step or more.
    """
    return longer >> 1 if gaps > gap >> 1 else longer


def step_tick(row: "array[int]", base: int, index: int) -> int:
    """Return the tick, from the start of the segment, of a step of the motor at row[base]. index:
    of the step, from 0.

    The gaps between a segment's steps differ by one tick at most. Their order is that of
    slice_kernel.leading(), as in every engine.
    """
    gaps = row[base] - 1
    if gaps < 1:
        return row[base + _FIRST_TICK]
    gap, longer = divmod(row[base + _LAST_TICK] - row[base + _FIRST_TICK], gaps)
    longer_first = leading(gaps, gap, longer)
    longer_last = longer - longer_first
    # Of the longer gaps at either end, those before this step.
    extra_ticks = min(index, longer_first) + max(index - (gaps - longer_last), 0)
    return row[base + _FIRST_TICK] + index * gap + extra_ticks


def steps_until(row: "array[int]", base: int, tick: int) -> int:
    """Return the number of steps of the motor at row[base] in the first `tick` ticks of the
    segment, including a step at `tick`. It is the inverse of step_tick()."""
    count = row[base]
    if count == 0 or tick < row[base + _FIRST_TICK]:
        return 0
    if tick >= row[base + _LAST_TICK]:
        return count
    span = row[base + _LAST_TICK] - row[base + _FIRST_TICK]
    gap, longer = divmod(span, count - 1)
    longer_gap = gap + 1
    longer_first = leading(count - 1, gap, longer)
    since_first = tick - row[base + _FIRST_TICK]
    until_last = span - since_first
    if since_first < longer_first * longer_gap:  # among the longer gaps at the beginning
        return since_first // longer_gap + 1
    if until_last <= (longer - longer_first) * longer_gap:  # among those at the end
        still_to_come = -(-until_last // longer_gap)  # rounded up
        return count - still_to_come
    return (since_first - longer_first) // gap + 1


class Switch:
    """An input that is closed exactly while the steps of a motor are >= (above) or <= a number.

    axis: the motor, from 0. A bouncing one closes at that number, opens one step further, closes
    at the next one, and so on; it has opened again `bounces` times when it stays closed.
    """

    def __init__(self, pin: str, axis: int, above: bool, steps: int, bounces: int = 0) -> None:
        self.pin = pin
        self.axis = axis
        self.above = above
        self.steps = steps
        self.bounces = bounces

    def closed(self, steps: int) -> bool:
        """Return whether it is closed with the motor at `steps`."""
        beyond = steps - self.steps if self.above else self.steps - steps
        has_settled = beyond >= 2 * self.bounces
        return beyond >= 0 and (beyond % 2 == 0 or has_settled)  # bouncing: every second step

    def crossing(self, start: int, end: int) -> int:
        """Return after how many steps, on the way from start to end, it first changes; 0 if it
        never does."""
        sign = 1 if end > start else -1
        was_closed = self.closed(start)
        if self.bounces == 0 and was_closed == self.closed(end):
            return 0
        # It changes only between these two positions: try each step between them.
        low, high = self.steps - 2 * self.bounces - 1, self.steps + 2 * self.bounces + 1
        nearer_end = low if sign > 0 else high
        made = max(0, (nearer_end - start) * sign)  # steps from start
        most = (high - low) + abs(nearer_end - start)  # after more steps, it has been passed
        while made < abs(end - start):
            made += 1
            if self.closed(start + sign * made) != was_closed:
                return made
            if made > most:
                break
        return 0


class SimEngine:
    """A StepEngine in virtual time. The rig calls advance(); nothing else moves the clock.

    prepare: called by start(), before motion; may let time pass.
    depth: segments held by the "hardware", including the running one.
    segment_log2: ticks of a full segment, as a power of 2, for the firmware.
    pins_changed: called after each event, when a switch may have changed.
    trace: called with (start tick, row) for every segment as it ends or is cut short;
        the row then has only the steps really made.
    """

    # A full segment of 2**17 ticks lasts 10 ms, as Grbl's.
    tick_hz = 13_107_200

    def __init__(self, axes: int, depth: int = 3, segment_log2: int = 17) -> None:
        self.segment_log2 = segment_log2
        self.prepare: "Callable[[], None] | None" = None
        self.now = 0  # virtual time in ticks
        self.trace: "Callable[[int, array[int]], None] | None" = None
        self.pins_changed: "Callable[[], None] | None" = None
        self.switches: "list[Switch]" = []
        self.starts = 0  # how often motion has begun
        self._axes = axes
        # A ring of segments. The one at _head runs; _held is how many there are, with this one.
        self._queue = [array("i", [0] * row_length(axes)) for _ in range(depth)]
        self._head = 0
        self._held = 0
        self._start = 0  # tick at which the running segment began
        self._running = False
        self._stopped = True  # by stop(), or from the beginning; no motion before arm()
        self._locked = 0  # mask of motors that make no steps
        self._physical = array("i", [0] * axes)  # steps at the pins before the running segment
        self._offset = array("i", [0] * axes)  # the firmware's position minus the steps made
        self._next_segment: "NextSegment"
        self._on_power: "Callable[[int], None]"
        self.pulse_us = 10
        self.dir_invert = 0

    # The StepEngine interface

    def max_step_hz(self, pulse_us: int) -> int:
        return 1_000_000 // (pulse_us + 1)

    def attach(
        self,
        next_segment: "NextSegment",
        on_power: "Callable[[int], None]",
        on_rest: "Callable[[], None]",
    ) -> None:
        """Set what is called: for a segment, at its power, and when motion has ended."""
        self._next_segment = next_segment
        self._on_power = on_power
        self._on_rest = on_rest

    def configure(self, pulse_us: int, step_invert: int, dir_invert: int) -> None:
        """Apply settings; the firmware's position stays the same, also if dir_invert changes."""
        self.pulse_us = pulse_us
        position = self._physical[:]
        self.position(position)  # replaces the content
        self.dir_invert = dir_invert
        self.set_position(position)

    def arm(self) -> None:
        self._stopped = False

    def start(self) -> None:
        """Begin motion, if there is any and arm() allows it."""
        if not self._running and not self._stopped:
            if self.prepare:
                self.prepare()
            self._start = self.now
            self._refill()
            if self._held:
                self._running = True
                self.starts += 1
                self._set_power()
            if self._stopped:
                self.stop()  # again: a callback has called it, and segments were added since

    def stop(self) -> None:
        """End motion at once, and drop the segments held."""
        self._stopped = True
        if self._running:
            self._finish(self.now - self._start)
        self._held = 0
        self._running = False
        self._locked = 0

    def lock(self, motors: int) -> None:
        """Let these motors, a mask, make no more steps until stop()."""
        if self._running and motors & ~self._locked:
            self._split_running()
        self._locked |= motors

    def fault(self) -> str:
        return ""  # the machine's virtual time is never late

    def idle(self) -> bool:
        return not self._running

    def position(self, steps: "array[int]") -> None:
        """Store the position by the firmware's count, in steps, into the array."""
        self.physical(steps)
        for i in range(self._axes):
            steps[i] = self._firmware_steps(i, steps[i]) + self._offset[i]

    def set_position(self, steps: "array[int]") -> None:
        """Set the firmware's count to these steps; nothing moves. Called while idle."""
        for i in range(self._axes):
            self._offset[i] = steps[i] - self._firmware_steps(i, self._physical[i])

    def _firmware_steps(self, axis: int, steps: int) -> int:
        """Return a motor's steps at the pins with the firmware's sign: $3 inverts the pin, not
        the count."""
        return -steps if self.dir_invert >> axis & 1 else steps

    # Interface for the simulator

    def physical(self, steps: "array[int]") -> None:
        """Store the steps that the pins have made since power was first applied, whatever the
        firmware's position is."""
        for i in range(self._axes):
            steps[i] = self._physical[i]
        if self._running:
            row = self._queue[self._head]
            for i in range(self._axes):
                made = self._steps_made(row, i, self.now - self._start)
                steps[i] += made

    def power_off(self) -> None:
        """End motion. The motors stay where they are, and the count restarts at 0."""
        self.stop()
        self.set_position(array("i", [0] * self._axes))

    def next_event(self) -> int:
        """Return the tick up to which nothing changes by itself: the end of the running segment,
        or a switch that changes before. _NEVER when idle."""
        if not self._running:
            return _NEVER
        row = self._queue[self._head]
        earliest = row[ROW_TICKS]  # from the start of the segment
        for switch in self.switches:
            tick = self._crossing_tick(row, switch)
            if tick < earliest:
                earliest = tick
        return self._start + earliest

    def advance(self, to: int) -> None:
        """Let time pass until tick `to`: play segments, and call pins_changed at each event."""
        while True:
            event = self.next_event()
            if event > to:
                break
            self.now = event
            row = self._queue[self._head]
            if event - self._start >= row[ROW_TICKS]:
                self._end_segment(row)
            if self.switches and self.pins_changed:
                self.pins_changed()
        self.now = to

    def _steps_made(self, row: "array[int]", axis: int, tick: int) -> int:
        """Return the steps of a motor, with their sign, in the first `tick` ticks of a segment."""
        if self._locked >> axis & 1:
            return 0
        made = steps_until(row, ROW_AXES + ROW_STRIDE * axis, tick)
        return -made if row[ROW_DIRS] >> axis & 1 else made

    def _crossing_tick(self, row: "array[int]", switch: "Switch") -> int:
        """Return the tick, from the start of the running segment, at which a switch changes next;
        _NEVER if it does not in this segment."""
        axis = switch.axis
        start = self._physical[axis]
        end = start + self._steps_made(row, axis, row[ROW_TICKS])
        made = self._steps_made(row, axis, self.now - self._start)
        crossing = switch.crossing(start + made, end)
        if crossing == 0:
            return _NEVER
        base = ROW_AXES + ROW_STRIDE * axis
        index_of_step = abs(made) + crossing - 1
        return step_tick(row, base, index_of_step)

    def _refill(self) -> None:
        """Pull segments until the queue is full or there are no more."""
        size = len(self._queue)
        while self._held < size:
            row = self._queue[(self._head + self._held) % size]
            if not self._next_segment(row):  # it fills the row
                break
            row[ROW_DIRS] ^= self.dir_invert  # as at the pins
            self._held += 1

    def _set_power(self) -> None:
        """Set the power of the segment that begins."""
        self._on_power(self._queue[self._head][ROW_POWER])

    def _end_segment(self, row: "array[int]") -> None:
        """End the running segment, whose row this is, and begin the next one; or end motion."""
        self._finish(row[ROW_TICKS])
        self._start += row[ROW_TICKS]
        self._head = (self._head + 1) % len(self._queue)
        self._held -= 1
        self._refill()
        if self._held:
            self._set_power()
        else:
            self._running = False
            self._on_rest()
        if self._stopped:
            self.stop()  # again: a callback has called it, and segments were added since

    def _finish(self, ticks: int) -> None:
        """Count the steps made in the running segment, which ends after `ticks`: at its end, or
        earlier. Its row then has only these, for `trace`."""
        row = self._queue[self._head]
        if ticks == row[ROW_TICKS] and not self._locked:
            self._count_whole(row, ticks)
        else:
            self._count_cut(row, ticks)
        row[ROW_TICKS] = ticks
        if self.trace:
            self.trace(self._start, row)

    def _count_whole(self, row: "array[int]", ticks: int) -> None:
        """Count the steps of a segment that was not cut: _count_cut(), in less time.

        ticks: the length of the segment. A step that is due later is not counted.
        """
        dirs, physical = row[ROW_DIRS], self._physical
        for i in range(self._axes):
            base = ROW_AXES + ROW_STRIDE * i
            made = row[base]
            if made:
                if row[base + _LAST_TICK] > ticks:
                    made = steps_until(row, base, ticks)
                physical[i] += -made if dirs >> i & 1 else made

    def _count_cut(self, row: "array[int]", ticks: int) -> None:
        """Count the steps of a segment that ends after `ticks`, or in which a motor is locked;
        reduce its row to these."""
        for i in range(self._axes):
            base = ROW_AXES + ROW_STRIDE * i
            made = self._steps_made(row, i, ticks)
            self._physical[i] += made
            row[base + _LAST_TICK] = step_tick(row, base, abs(made) - 1) if made else 0
            row[base] = abs(made)

    def _split_running(self) -> None:
        """Cut the running segment in two at this moment, because a lock acts only on the rest of
        it. The first part is finished; the rest takes its place in the queue."""
        row = self._queue[self._head]
        done = self.now - self._start  # ticks
        rest = array("i", row)  # a copy
        for i in range(self._axes):
            base = ROW_AXES + ROW_STRIDE * i
            made = abs(self._steps_made(row, i, done))
            rest[base] = row[base] - made
            if rest[base]:
                rest[base + _FIRST_TICK] = step_tick(row, base, made) - done
                rest[base + _LAST_TICK] = row[base + _LAST_TICK] - done
        rest[ROW_TICKS] = row[ROW_TICKS] - done
        self._finish(done)
        self._start = self.now
        self._queue[self._head] = rest
