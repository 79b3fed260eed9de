"""Joint planner: plans chords for motors that move joints instead of axes. See nonlinear.py.

A chord's row has the steps of its joints and the length of the tool's path. Its limits are
computed from the joints' travel per mm, and from the change of that between chords.
"""

import math
from array import array

from base.float32 import copy, vector
from micropython import const
from motion import layout, minifloat
from motion.arcs import PLACE_BIAS
from motion.plan_kernel import append_block, compute_profile, step_ratios
from motion.planner import Planner

from extras.kinematics.segmenter import Segmenter

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from interfaces import AxisLimits, Geometry
    from motion.planner import Move

# Positions are whole numbers of 1/1000 mm, as in reports.
_PER_MM = 1000.0
_SLOWEST_MM_S = 1e-6  # for places where motors turn and the tool hardly moves
_BEND_COSINE = 0.94  # of an angle between chords: a larger angle is a corner, and not a bend
_UNIT_DIRECTION = const(16384)  # 1 in the planner's directions
_DIRECTION = const(4)  # multiple of the number of axes, after LIMITS in the planner's table
_NO_LIMIT = 1e18  # larger than every speed squared or acceleration
_SPEED_BITS = const(30)  # the planner's scaled speeds squared are below 2**30
_JUNCTION_SCALE = 65536.0  # the planner's JUNCTION has distances in 2**-16 mm
_BEND_SHARE = 0.5  # share of a joint's acceleration available for bends


def _nearest(x: float) -> int:
    """Return the nearest whole number, also of a negative one."""
    return int((x + 0.5) // 1)


def _parts(mm: float) -> int:
    """Convert mm to the unit of reports, 1/1000 mm."""
    return _nearest(mm * _PER_MM)


def _distance(one: "array[float]", other: "array[float]") -> float:
    """Return the straight distance between two positions, in their unit."""
    return math.sqrt(sum([(other[i] - one[i]) ** 2 for i in range(len(one))]))


class NonlinearKinematics:
    """Converts between joints and the tool's position. Motor i moves joint i.

    geometry: the user's module, with inverse(place, joints) and forward(joints, place), which
    compute one from the other. Joints are in their own units, places in mm. home, travel: per
    joint.
    """

    def __init__(self, axes: int, geometry: "Geometry") -> None:
        self.geometry = geometry
        self.moves = [1 << i for i in range(axes)]
        self.resolution = array("f", (1.0 for _ in range(axes)))  # steps/unit; the planner sets it
        self.start, self.home, self.travel = geometry.START, geometry.HOME, geometry.TRAVEL
        self._axes = range(axes)
        self._joints = vector(axes)
        self._place = vector(axes)

    def joints_of(self, motors: "array[int]", joints: "array[float]") -> None:
        """Compute the joints' positions, in their units, from motor steps."""
        for i in self._axes:
            joints[i] = self.start[i] + motors[i] / self.resolution[i]

    def steps_of(self, joint: float, i: int) -> int:
        """Return the motor steps of joint i at the position `joint`, in its unit."""
        return _nearest((joint - self.start[i]) * self.resolution[i])

    def place_of(self, motors: "array[int]", place: "array[float]") -> None:
        """Compute the tool's position in mm from motor steps."""
        self.joints_of(motors, self._joints)
        self.geometry.forward(self._joints, place)

    def axis_steps(self, motors: "array[int]", axis: int) -> int:
        """Return the tool's position along an axis, in 1/1000 mm."""
        self.place_of(motors, self._place)
        return _parts(self._place[axis])

    def to_axes(self, motors: "array[int]") -> None:
        """Replace motor steps by the tool's position, in 1/1000 mm."""
        self.place_of(motors, self._place)
        for i in self._axes:
            motors[i] = _parts(self._place[i])

    def set_axis(self, motors: "array[int]", axis: int, steps: int) -> None:
        """Set the steps of a joint, because no axis can move alone."""
        motors[axis] = steps

    def stopped_by(self, switches: int) -> int:
        """Return the joints that switches stop: each has its own."""
        return switches


class NonlinearPlanner(Planner):
    """A planner of chords.

    place, joints: the tool's position (mm) and that of the joints at the end of the last chord.
    The last block may end earlier, because a chord without steps makes none: it ends at _place,
    _joints, in motor steps at _block_end_steps. homing: positions are those of joints, in their
    units, until it is False again. synced: set when the plan has been cleared. Of the last block:
    _slope, per joint its units per mm of the tool's path; _pace, the root of the sum of their
    squares, so joint units per mm of all joints together; _length of that path, mm.
    """

    kinematics: "NonlinearKinematics"

    def __init__(self, axes: int, *others: "Any") -> None:
        super().__init__(axes, *others)
        self.homing = False
        self.synced = False
        self.place = vector(axes)
        self.joints = vector(axes)
        self.course = Segmenter(axes, self.kinematics.geometry)
        self._block_end_steps = array("i", (0 for _ in range(axes)))
        self._place = vector(axes)
        self._joints = vector(axes)
        self._end = vector(axes)  # joints at the end of a system move
        self._bends = vector(axes)  # of each joint, see _limit()
        self._slope = vector(axes)
        self._pace = self._length = 1.0
        self._rates = vector(axes)  # highest of each joint, units/s
        self._accelerations = vector(axes)  # units/s2
        self._fastest = 1.0  # the tool's highest speed, mm/s
        self._deviation = 0.0  # $11, scaled as JUNCTION in the planner's table

    def configure(
        self, settings: "AxisLimits", tick_hz: int, segment_log2: int, step_hz: int
    ) -> None:
        """Apply settings, as Planner.configure(). Steps, rates, accelerations are of joints."""
        super().configure(settings, tick_hz, segment_log2, step_hz)
        self._set_joint_limits(settings, step_hz)
        self._set_tool_scale(settings)
        self._start_from(self._block_end_steps)  # the same steps are another position now

    def _set_joint_limits(self, settings: "AxisLimits", step_hz: int) -> None:
        """Store the settings per axis as those of joints: motor steps per unit of a joint (which
        Planner.configure() has put into steps_per_mm), rates in units/s, accelerations, units/s2.

        steps_per_mm, and its copy in the table, becomes 1000: the planner's positions are those of
        the tool, in 1/1000 mm.
        """
        joint_resolution, tool_resolution = self.kinematics.resolution, self.steps_per_mm
        copy(tool_resolution, joint_resolution, self.axes)  # saved before it is overwritten
        for i in range(self.axes):  # the settings are per minute
            self._rates[i] = min(settings.max_rate[i] / 60, step_hz / joint_resolution[i])
            self._accelerations[i] = settings.acceleration[i] / 3600
            tool_resolution[i] = _PER_MM
        table_index = layout.LIMITS + layout.RESOLUTION * self.axes  # of axis 0
        copy(tool_resolution, memoryview(self.table)[table_index:], self.axes)

    def _set_tool_scale(self, settings: "AxisLimits") -> None:
        """Set the scale of the planner's squared speeds, and the junction deviation in it: 2**30
        is the square of the tool's highest speed, the geometry's FASTEST (mm/min)."""
        table = self.table
        self._fastest = self.kinematics.geometry.FASTEST / 60
        scale = (1 << _SPEED_BITS) / (self._fastest * self._fastest)  # per (mm/s)2
        table[layout.ROOT_SCALE] = minifloat.real(scale**-0.5)  # mm/s per root
        table[layout.SQR_SCALE] = minifloat.real(scale)
        table[layout.SLOWEST] = minifloat.real(_SLOWEST_MM_S)
        self._deviation = _JUNCTION_SCALE * settings.junction_deviation_mm * scale

    # Positions

    def to_mm(self, motors: "array[int]", mm: "array[float]") -> None:
        """Convert motor steps to mm, as Planner.to_mm()."""
        if self.homing:
            self.kinematics.joints_of(motors, mm)
        else:
            self.kinematics.place_of(motors, mm)

    def set_axis(self, motors: "array[int]", axis: int, mm: float) -> None:
        """Set a joint's position (mm: in its own unit), as Planner.set_axis(). Used only while
        homing."""
        motors[axis] = self.kinematics.steps_of(mm, axis)

    def sync_motors(self, motors: "array[int]") -> None:
        """Synchronise with the motors, as Planner.sync_motors()."""
        self._start_from(motors)
        self.synced = True

    def _start_from(self, motors: "array[int]") -> None:
        """Take the motors' position, in steps, as the end of the last chord and block."""
        copy(motors, self._block_end_steps, self.axes)
        self.kinematics.joints_of(motors, self.joints)
        self.kinematics.geometry.forward(self.joints, self.place)
        copy(self.place, self._place, self.axes)
        copy(self.joints, self._joints, self.axes)
        for i in range(self.axes):
            self._slope[i] = 0.0  # the next block starts from standstill, without a bend
            self.position[i] = PLACE_BIAS + _parts(self.place[i])  # in the table, too

    # Blocks

    def line(self, target: "array[float]", move: "Move", power: int) -> bool:
        """Add the chord that self.course has computed last; it ends at target, mm.

        A row must be free. Return False if it has no steps: then the next block begins where this
        chord did.
        """
        copy(target, self.place, self.axes)
        copy(self.course.joints, self.joints, self.axes)
        table_index = layout.LIMITS + layout.TARGET * self.axes  # of axis 0
        for i in range(self.axes):
            self.table[table_index + i] = PLACE_BIAS + _parts(target[i])
        length = _distance(self._place, target)
        if not self._block(self._block_end_steps, self._joints, self.joints, length, move, power):
            return False
        for i in range(self.axes):
            self._block_end_steps[i] = self.kinematics.steps_of(self.joints[i], i)
        copy(target, self._place, self.axes)
        copy(self.joints, self._joints, self.axes)
        return True

    def system_line(
        self, target: "array[float]", move: "Move", power: int, start: "array[int]"
    ) -> bool:
        """Plan a system move, as Planner.system_line(). All joints move evenly.

        So the tool's path is straight only if one joint moves one axis alone, as in parking.
        target: the tool's position, mm; while homing, positions of joints, and the length of the
        path is the distance in their units. start: motor steps. Return False if nothing moves, or
        if target is out of reach.
        """
        begin, end = vector(self.axes), self._end
        self.kinematics.joints_of(start, begin)
        copy(begin, end, self.axes)
        if self.homing:
            copy(target, end, self.axes)
            length = _distance(begin, end)
        elif self.kinematics.geometry.inverse(target, end):
            place = vector(self.axes)
            self.kinematics.geometry.forward(begin, place)
            length = _distance(place, target)
        else:
            return False
        # Restored afterwards: the program's next chord follows its last one, and not this move.
        last_chord = array("f", self._slope), self._pace, self._length
        planned = self._block(start, begin, end, length, move, power)
        self._slope, self._pace, self._length = last_chord
        return planned

    def _block(
        self,
        start: "array[int]",
        begin: "array[float]",
        end: "array[float]",
        length: float,
        move: "Move",
        power: int,
    ) -> bool:
        """Fill a row of the ring: joints move from begin to end, positions in their units. start:
        the motor steps at begin.

        length: of the tool's path, mm. power: of the spindle. Return False if there are no steps.
        """
        table, ring, flow, flags = self.table, self.ring, self.flow, move.flags
        # A system move's row follows those of the ring.
        row = flow[layout.ROWS if flags & layout.SYSTEM_MOTION else layout.HEAD]
        at = row * flow[layout.ROW_SIZE]  # index of the row in the ring
        events = dirs = 0  # steps of the joint that makes the most; mask of those that go back
        squares = 0.0
        for i in range(self.axes):
            change = end[i] - begin[i]
            steps = self.kinematics.steps_of(end[i], i) - start[i]
            if steps < 0 or (steps == 0 and change < 0):  # without a step it matters to corners
                dirs |= 1 << i
                steps = -steps
            ring[at + layout.STEPS + i] = steps
            events = max(events, steps)
            squares += change * change
        if not (events and length):
            return False
        ring[at + layout.EVENTS], ring[at + layout.DIRS] = events, dirs
        ring[at + layout.LENGTH] = minifloat.real(length)
        ring[at + layout.FLAGS], ring[at + layout.LINE] = flags, move.line_number
        ring[at + layout.POWER] = power
        self._limit(at, begin, end, length, math.sqrt(squares) / length, move)
        compute_profile(table, ring, at)
        step_ratios(ring, at, self.motors)
        if flags & layout.SYSTEM_MOTION:
            flow[layout.SYSTEM] = 1  # execute it
        else:
            append_block(table, ring, flow)
        self.speeds[row] = move.spindle_rpm
        return True

    def _limit(
        self,
        at: int,
        begin: "array[float]",
        end: "array[float]",
        length: float,
        pace: float,
        move: "Move",
    ) -> None:
        """Compute a chord's speed and acceleration limits, and the limit of its first corner.

        at: its row's index in the ring. begin, end: of the joints. length: of the tool's path, mm.
        pace: joint units per mm of that path, of all joints together. With the tool's speed v, a
        joint's speed is slope * v, and its acceleration is slope * acceleration + bend * v**2,
        where slope is its units per mm, and bend is the change of slope per mm.
        """
        ring, table, slope = self.ring, self.table, self._slope
        direction = layout.LIMITS + _DIRECTION * self.axes  # table index; signs are in DIRS
        # slope is still the last chord's. The scalar product of this chord's change, a vector of
        # the length pace * length, and of the last slope, of the length _pace, is the product of
        # both lengths and the cosine of the angle between the chords.
        product = sum([(end[i] - begin[i]) * slope[i] for i in range(self.axes)])
        is_bend = product > _BEND_COSINE * pace * length * self._pace  # and not a corner
        per_distance = 2 / (length + self._length)  # from one chord's middle to the next one's
        rapid = self._fastest  # highest speed of the tool, mm/s
        bend_speed_sqr = _NO_LIMIT  # highest one at which bends are possible, squared
        for i in range(self.axes):
            per_mm = (end[i] - begin[i]) / length
            table[direction + i] = min(int(abs(per_mm) / pace * _UNIT_DIRECTION), _UNIT_DIRECTION)
            bend = abs(per_mm - slope[i]) * per_distance if is_bend else 0.0
            slope[i], self._bends[i] = per_mm, bend
            if per_mm:
                rapid = min(rapid, self._rates[i] / abs(per_mm))
            if bend:
                bend_speed_sqr = min(bend_speed_sqr, _BEND_SHARE * self._accelerations[i] / bend)
        rapid = min(rapid, math.sqrt(bend_speed_sqr))
        rate = self._rate(move, rapid)
        fastest_sqr = min(rapid, 2 * rate) ** 2  # (mm/s)2: overrides go to 200 %
        accel = _NO_LIMIT
        for i in range(self.axes):
            if slope[i]:
                # What the bend leaves of the joint's acceleration at that speed.
                available = self._accelerations[i] - self._bends[i] * fastest_sqr
                accel = min(accel, available / abs(slope[i]))
        ring[at + layout.RAPID] = minifloat.real(rapid)
        ring[at + layout.ACCEL] = minifloat.real(accel)
        ring[at + layout.RATE] = minifloat.real(rate)
        # Corners are computed in joint units: with the deviation times pace, v**2 times pace**2.
        table[layout.JUNCTION] = minifloat.real(self._deviation / max(pace, self._pace))
        self._pace, self._length = pace, length

    def _rate(self, move: "Move", rapid: float) -> float:
        """Return the programmed rate in mm/s. rapid: the highest possible one, that of G0."""
        if move.flags & layout.RAPID_MOTION:
            return rapid
        return max(move.feed, 1.0) / 60
