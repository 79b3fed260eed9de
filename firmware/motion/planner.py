"""Planner: a ring of blocks, each joined to the next as fast as both allow.

In: absolute targets in mm (single precision), rates in mm/min. Out: rows of integers for
segments.py. A row holds a *promise*: a speed at which it may be entered, so that the machine can
still brake for all blocks after it. The interrupt accelerates towards the promises as far as it
can, so no forward pass is needed. Only canon, homing_probing and suspension add lines. Nothing is
allocated per block, except the caller's floats.
"""

from array import array

import micropython
from base.float32 import copy, f32, truncate, vector
from base.hooks import call_all
from micropython import const

from motion import arcs, layout, minifloat
from motion.layout import FLAGS, HEAD, LINE, LOADED, ROWS, SYSTEM, TAIL, UNPLANNED
from motion.plan_kernel import compute_profile, limit_entry, plan_block, reverse_pass

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import AxisLimits, Kinematics, PlannerState

    _Plan = Callable[[array[float], int, int, int, int], int]

# Flags of a block that the kernels do not test.
SPINDLE_CW = const(0x10)
SPINDLE_CCW = const(0x20)
COOLANT_SHIFT = const(8)  # flood 0x100, mist 0x200
SPINDLE_MASK = const(0x30)
ACCESSORY_MASK = const(0x330)

_BIAS = const(0x20000000)  # 2**29, added to positions in the table
_SPEED_UNITS = const(262144)  # a block's speeds are in 2**-18 step per full segment
_FULL_TIME = const(131072)  # a block's times are in 2**-17 of a full segment
_NO_DIRECTION = const(0x4000)  # 0, with its bias: see plan_kernel.junction_speed_sqr()
_MOST_SLICES = const(8)  # of a segment, where the speed changes; each is 1 ms or longer
# Most steps in a full segment, so that speeds in 2**-18 step per segment have 30 bits. With 10 ms
# that is 390 to 410 kHz; where an axis is faster, full segments are half as long.
_MOST_STEPS = const(4095)  # in a full segment
_SLOWEST_MM_S = 1 / 60  # no block is slower
_JUNCTION_SCALE = 65536.0  # see JUNCTION in layout.py
_LEAST_LIMIT = 1e-8  # mm/s and mm/s2: kernels would compute negative reals from 0
# Kernels count steps from -2**29 to 2**29; the rest is for rounding in single precision.
_REACH_STEPS = const(0x1FFFFF00)  # greatest distance of a motor from 0
_MOST_STEPS_PER_MM = 1e8  # highest steps/mm, so that nothing is divided by 0, whatever $100 is


class Move:
    """How to move: one reusable record, which the caller fills in.

    feed: mm/min, or 1/min with INVERSE_TIME; flags: those of a block (layout.py and
    below); spindle_rpm: programmed speed; line_number: the N word, or 0.
    """

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Reset all fields."""
        self.feed = 0.0
        self.flags = 0
        self.spindle_rpm = 0.0
        self.line_number = 0


class Planner:
    """The ring of blocks. layout.py describes the arrays: `ring`, `flow`, which is shared with the
    interrupt, and `table`, the machine's numbers for the kernels.

    blocks: how many rows the ring has. kinematics: None if each motor moves the axis of its own
    number. ring: its memory, all 0, if allocated in advance.
    """

    # An extra's replacement for plan().
    move_hook: "_Plan | None" = None

    def __init__(
        self,
        axes: int,
        blocks: int,
        kinematics: "Kinematics | None",
        state: "PlannerState",
        ring: "array[int] | None" = None,
    ) -> None:
        moves = kinematics.moves if kinematics else [1 << i for i in range(axes)]
        motors = len(moves)
        size = layout.block_length(motors)
        self.axes = axes
        self.motors = motors
        self.kinematics = kinematics
        self._state = state
        if ring is None or len(ring) != size * (blocks + 1):  # too short if there are more motors
            ring = layout.ring(motors, blocks)
        self.ring = ring
        self.flow = array("i", (0 for _ in range(layout.FLOW_LENGTH + 2 * motors)))
        self.table = array("i", (0 for _ in range(layout.table_length(axes, motors))))
        self.flow[layout.ROW_SIZE] = size
        self.flow[ROWS] = blocks
        self.table[layout.AXES] = axes
        self.table[layout.MOTOR_COUNT] = motors
        for i in range(motors):
            self.table[layout.LIMITS + layout.MOVES * axes + i] = moves[i]
        # Programmed spindle speed of each block, rpm, then of the system's own block and of an
        # arc's chords. The interrupt does not use it.
        self.speeds = vector(blocks + 2)
        # End of the last block, in steps + _BIAS; part of the table.
        at = layout.LIMITS + layout.POSITION * axes
        self.position = memoryview(self.table)[at : at + axes]
        self.steps_per_mm = vector(axes)
        self._feed = vector(1)
        for i in range(axes):
            self.position[i] = _BIAS
            self.table[layout.LIMITS + 3 * axes + i] = _NO_DIRECTION  # the last block's

    def configure(
        self, settings: "AxisLimits", tick_hz: int, segment_log2: int, step_hz: int
    ) -> None:
        """Apply rates, accelerations and resolution: compute the table for the kernels.

        settings: rates in mm/min, accelerations in mm/min2, as Grbl has them. tick_hz: ticks per
        second; a full segment has 2**segment_log2 of them, or less where an axis is fast.
        step_hz: the engine's highest rate, in steps/s.
        """
        table = self.table
        fastest_sqr = fastest_hz = 0.0
        for i in range(self.axes):
            resolution = min(settings.steps_per_mm[i] or 1.0, _MOST_STEPS_PER_MM)
            rate = min(settings.max_rate[i] / 60, step_hz / resolution)
            acceleration = settings.acceleration[i] / 3600
            fastest_sqr += max(rate, _SLOWEST_MM_S) ** 2
            fastest_hz = max(fastest_hz, rate * resolution)
            at = layout.LIMITS + 3 * i  # an axis's mm per step, mm/s, mm/s2
            table[at] = minifloat.real(1 / resolution)
            table[at + 1] = minifloat.real(max(rate, _LEAST_LIMIT))
            table[at + 2] = minifloat.real(max(acceleration, _LEAST_LIMIT))
            self.steps_per_mm[i] = resolution
        at = layout.LIMITS + layout.RESOLUTION * self.axes
        copy(self.steps_per_mm, memoryview(table)[at:], self.axes)
        scale = (1 << 30) / fastest_sqr  # 2**30 is the square of the highest speed
        table[layout.ROOT_SCALE] = minifloat.real(scale**-0.5)
        # Full segments must have few enough steps, also on the fastest axis.
        while fastest_hz * (1 << segment_log2) > tick_hz * _MOST_STEPS:
            segment_log2 -= 1
        seconds = (1 << segment_log2) / tick_hz
        table[layout.SQR_SCALE] = minifloat.real(scale)
        table[layout.JUNCTION] = minifloat.real(
            _JUNCTION_SCALE * settings.junction_deviation_mm * scale
        )
        table[layout.SEGMENT_RATE] = minifloat.real(seconds * _SPEED_UNITS)
        table[layout.SEGMENT_ACCEL] = minifloat.real(seconds * seconds * _SPEED_UNITS)
        table[layout.SEGMENT_LOG2] = segment_log2
        table[layout.SLICE] = _FULL_TIME // max(min(int(seconds * 1000), _MOST_SLICES), 1)
        table[layout.SLOWEST] = minifloat.real(_SLOWEST_MM_S)

    def reach_mm(self, axis: int) -> float:
        """Return how far from 0 an axis may be, in mm. A motor that several axes move counts the
        steps of all, so each may go less far."""
        moves = self.kinematics.moves if self.kinematics else (1,)
        # The most axes that one motor moves: the bits that are set in its number (layout.MOVES).
        most_axes = max(
            [sum([move >> i & 1 for i in range(2 * layout.REVERSE)]) for move in moves]
        )
        return _REACH_STEPS / most_axes / self.steps_per_mm[axis]

    def free(self) -> int:
        """Return how many blocks can still be added."""
        flow = self.flow
        return (flow[TAIL] - flow[HEAD] - 1) % flow[ROWS]

    def full(self) -> bool:
        """Return whether no block can be added. It does not call free(), because loops that wait
        call it often."""
        flow = self.flow
        return (flow[HEAD] + 1 - flow[TAIL]) % flow[ROWS] == 0

    def empty(self) -> bool:
        """Return whether no block waits or is executed; its last segments may still be playing."""
        return self.flow[HEAD] == self.flow[TAIL]

    def row(self) -> "memoryview | None":
        """Return the block being executed, or the next one; None if there is none."""
        if self.empty():
            return None
        size = self.flow[layout.ROW_SIZE]
        at = self.flow[TAIL] * size
        return memoryview(self.ring)[at : at + size]

    def line_number(self) -> int:
        """Return N of the block being executed; 0 if there is none."""
        if self.empty():
            return 0
        return self.ring[self.flow[TAIL] * self.flow[layout.ROW_SIZE] + LINE]

    def line(self, target: "array[float]", move: "Move", power: int) -> bool:
        """Add a straight line to target (mm per axis). A row of the ring must be free. Returns
        False if the line has no steps.

        power: the power for the move's spindle speed (Spindle.block_power).
        """
        flags, flow = move.flags, self.flow
        head = flow[HEAD]  # the row that plan() fills, unless it is the system's
        # move_hook: an extra's function in the place of plan().
        plan = self.move_hook or self.plan
        if not plan(target, flags, move.line_number, power, self.rate(move.feed)):
            return False
        self.speeds[flow[ROWS] if flags & layout.SYSTEM_MOTION else head] = move.spindle_rpm
        return True

    @micropython.native  # a replacement must be, too: the stack has no space for bytecode's frame
    def plan(self, target: "array[float]", flags: int, line: int, power: int, rate: int) -> int:
        """Plan a line to target (mm per axis) in the ring. Returns 0 if it has no steps, else 1.

        flags: the block's; line: the N word; power: of the spindle; rate: see rate(), or a real in
        1/s with INVERSE_TIME.
        """
        return plan_block(target, self.table, self.ring, self.flow, flags, line, power, rate)

    def rate(self, feed: float) -> int:
        """Return a feed in mm/min as a real in mm/s (minifloat.py)."""
        self._feed[0] = feed
        return minifloat.per_second(self._feed, 0)

    def chords(self, course: "array[int]", move: "Move", power: int, moves: bool) -> int:
        """Add some chords of an arc, or skip them if moves is False (check mode). Returns the
        reason to pause, arcs.NOWHERE, plan_kernel.OUTSIDE or FULL, or 0: see arcs.follow().

        course: the arc's (arcs.py), which holds how many chords are left; power: of the spindle.
        """
        self.speeds[self.flow[ROWS] + 1] = move.spindle_rpm  # the place of an arc's chords
        return arcs.follow(
            course,
            self.table,
            self.ring,
            self.flow,
            self.speeds,
            move.flags | layout.PLACED if moves else 0,
            move.line_number,
            power,
            self.rate(move.feed),
        )

    def system_line(
        self, target: "array[float]", move: "Move", power: int, start: "array[int]"
    ) -> bool:
        """Add a move of the system's own (homing, parking), outside the ring, from standstill to
        standstill. move.flags must have SYSTEM_MOTION.

        target: mm per axis; start: motor positions, in steps; power: of the spindle. Returns False
        if the move has no steps.
        """
        # The target of the next block may already be set: TARGET, with POSITION after it. Both are
        # restored at the end.
        targets = memoryview(self.table)[layout.LIMITS + layout.TARGET * self.axes :]
        saved = array("i", targets[: 2 * self.axes])
        self.sync_motors(start)  # sets POSITION
        planned = self.line(target, move, power)
        copy(saved, targets, 2 * self.axes)
        return planned

    def catch_up(self) -> None:
        """Run the backward pass for blocks that were added since the last one: see
        plan_kernel.append_block(). Then call the extras' hooks."""
        if self.flow[UNPLANNED]:
            reverse_pass(self.ring, self.flow, 0)
        if self._state.hooks.caught_up:
            call_all(self._state.hooks.caught_up)

    def override(self) -> None:
        """Plan every block again after a changed override. An extra that plans in another way
        (hooks.replan) does it itself, and returns True."""
        flow = self.flow
        self.table[layout.FEED_OVERRIDE] = minifloat.real(self._state.feed_override / 100)
        self.table[layout.RAPID_OVERRIDE] = minifloat.real(self._state.rapid_override / 100)
        for replan in self._state.hooks.replan:
            if replan():
                return
        row = flow[TAIL]
        while row != flow[HEAD]:
            compute_profile(self.table, self.ring, row * flow[layout.ROW_SIZE])
            if row != flow[TAIL]:  # the block being executed has been entered
                limit_entry(self.ring, flow, row)
            row = (row + 1) % flow[ROWS]
        reverse_pass(self.ring, flow, 1)  # 1: over all blocks

    def each_power(self, power: "Callable[[int, float], int]") -> None:
        """Set the spindle power of every block again. power(flags, rpm) returns it, from a block's
        flags and programmed speed."""
        flow = self.flow
        row = flow[TAIL]
        while row != flow[HEAD]:
            at = row * flow[layout.ROW_SIZE]  # its index in the ring
            self.ring[at + layout.POWER] = power(self.ring[at + FLAGS], self.speeds[row])
            row = (row + 1) % flow[ROWS]
        for call in self._state.hooks.powered:
            call(power)

    def clear(self) -> None:
        """Drop all blocks, a hold, and what the interrupt has of a block. Only while the engine is
        stopped."""
        flow = self.flow
        flow[TAIL] = flow[HEAD]
        for i in (
            layout.HOLD,
            SYSTEM,
            LOADED,
            layout.END_SPEED,
            layout.JOIN_SPEED,
            layout.SLICES,
            UNPLANNED,
        ):
            flow[i] = 0
        if self._state.hooks.cleared:
            call_all(self._state.hooks.cleared)

    # Conversion between steps of motors and mm

    def axis_steps(self, motors: "array[int]", axis: int) -> int:
        """Return the steps of an axis, from those of the motors."""
        return self.kinematics.axis_steps(motors, axis) if self.kinematics else motors[axis]

    def to_mm(self, motors: "array[int]", mm: "array[float]") -> None:
        """Convert the motors' steps to mm per axis, into mm."""
        for i in range(self.axes):
            mm[i] = f32(self.axis_steps(motors, i)) / self.steps_per_mm[i]

    def set_axis(self, motors: "array[int]", axis: int, mm: float) -> None:
        """Change the motors' steps so that the axis is at mm, limited to its reach."""
        reach = self.reach_mm(axis)
        mm = max(min(mm, reach), -reach)
        product = f32(mm * self.steps_per_mm[axis])
        # Rounded, halves away from zero.
        steps = truncate(product + 0.5) if product >= 0 else -truncate(0.5 - product)
        if self.kinematics:
            self.kinematics.set_axis(motors, axis, steps)
        else:
            motors[axis] = steps

    def sync_motors(self, motors: "array[int]") -> None:
        """Set the position from which the next block is planned, by the motors' steps."""
        for i in range(self.axes):
            self.position[i] = _BIAS + self.axis_steps(motors, i)
