"""Canon, homing and probing of a machine whose paths are cut into chords. See nonlinear.py."""

from base import errors
from base import state as st
from base.axes import LETTERS
from base.errors import GrblError
from base.float32 import copy, vector
from control.canon import BELOW, SHUT, Canon
from control.homing_probing import HomingProbing
from control.modes import MOTION
from language import block_layout as b
from micropython import const
from motion import layout

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable

    from control.modes import Modes
    from language.block import Block
    from motion.arc_geometry import Arc
    from motion.planner import Move

    from extras.kinematics.joint_planner import NonlinearPlanner


class NonlinearCanon(Canon):
    """Canon of a machine whose paths are cut into chords.

    stop_planning: set in an interrupt, so that the rest of the path is not planned.
    """

    planner: "NonlinearPlanner"
    tell: "Callable[[str], None]"  # sends a message to the client
    modes: "Modes"
    block: "Block"
    stop_planning = False
    _arc: "Arc | None" = None

    def configure(self) -> None:
        """Apply settings, as Canon.configure(). CENTRED axes have travel on both sides of 0."""
        super().configure()
        for axis in self.planner.kinematics.geometry.CENTRED:
            # Bits of SHUT: axis i may not go above 0 (bit i), or not below (bit i + BELOW).
            self.travel[SHUT] &= ~(1 << axis | 1 << axis + BELOW)

    def line(self, target: "array[float]", move: "Move") -> None:
        """Request a line, as Canon.line(): finish() plans it later, by _plan_line()."""
        super().line(target, move)
        self._arc = None
        self.stop_planning = False

    def arc(self, start: "array[float]", target: "array[float]", arc: "Arc", move: "Move") -> None:
        """Request an arc, as Canon.arc(): as a line, whose path _plan_line() bends. start is where
        the last path ended, so it is not needed."""
        self.line(target, move)
        self._arc = arc

    def jog(self, target: "array[float]", move: "Move") -> None:
        """Jog, as Canon.jog(). GrblError if the target cannot be reached.

        Only some positions of the path are checked, not all chords. No bytes are read meanwhile,
        because a cancel would come before the jog.
        """
        planner, course = self.planner, self.planner.course
        # The tolerance does not matter: is_in_reach() cuts no chords.
        course.start_path(planner.place, planner.joints, target, arc=None, tolerance=0.0)
        if not course.is_in_reach():
            self._refuse(errors.TRAVEL_EXCEEDED)
        super().jog(target, move)

    def check_block(self) -> None:
        """Refuse a line whose motion leaves the reach: a G28 or G30 (by way of the axis words, to
        the stored position), or a motion of G0 to G3."""
        ints, xyz, code = self.block.ints, self.block.xyz, errors.GCODE_INVALID_TARGET
        start = self.modes.position
        if ints[b.NON_MODAL] in (b.GO_G28, b.GO_G30):
            if ints[b.AXIS_USE]:  # it has axis words: motion goes to xyz first
                self.check(start, xyz, None, code)
                start = xyz
            self.check(start, self.block.stored, None, code)  # then to the position of G28 or G30
        elif ints[b.AXIS_USE] == b.AXES_FOR_MOTION and ints[b.WORDS] & b.AXIS_WORDS:
            is_arc = ints[MOTION] in (b.CW_ARC, b.CCW_ARC)
            self.check(start, xyz, self.block.arc if is_arc else None, code)

    def check(
        self, start: "array[float]", target: "array[float]", arc: "Arc | None", code: int
    ) -> None:
        """Refuse a path from start to target (mm) that leaves the reach, by GrblError(code). arc:
        None for a straight line.

        All its chords are checked. The machine is serviced meanwhile, because that takes long.
        """
        planner, course = self.planner, self.planner.course
        joints = vector(planner.axes)
        copy(planner.joints, joints, planner.axes)  # inverse() finds the solution nearest to these
        is_in_reach = planner.kinematics.geometry.inverse(start, joints)
        course.start_path(start, joints, target, arc, self._settings.arc_tolerance_mm)
        while is_in_reach and course.has_next():
            is_in_reach = course.next_chord()
            self.service()
        if not is_in_reach:
            self._refuse(code)

    def _refuse(self, code: int) -> None:
        """Report the position that is out of reach (course.place, where its check has ended), and
        raise GrblError(code)."""
        words = zip(LETTERS, self.planner.course.place)
        self.tell("%s is out of reach" % " ".join(["%s%.3f" % word for word in words]))
        raise GrblError(code)

    def wait_for_room(self) -> None:
        """Wait for a free row, as Canon.wait_for_room(), or until the path is cut short."""
        while self.planner.full() and not self._is_path_dropped():
            self.auto_start()
            self.service()

    def _is_path_dropped(self) -> bool:
        """Return whether the rest of the path is not to be planned: after a reset (synced), or
        after the probe's contact (stop_planning)."""
        return self.planner.synced or self.stop_planning

    def _plan_line(self, target: "array[float]", move: "Move") -> None:
        """Plan a line or an arc as chords, as Canon._plan_line() plans lines. target: mm.

        stop_with_alarm() raises Abort if a chord is out of reach, or outside the soft limits; of
        a line only its target is compared with these, because they are a box. The machine is
        serviced between chords, so a reset or a contact may end it, too.
        """
        state, planner, course = self._state, self.planner, self.planner.course
        arc, self._arc = self._arc, None
        limits_apply = state.run != st.JOG and not self._is_jog  # a jog has been checked before
        if limits_apply and self.outside(target):
            self.stop_with_alarm(errors.ALARM_SOFT_LIMIT)
        if state.run == st.CHECK:
            return
        course.start_path(
            planner.place, planner.joints, target, arc, self._settings.arc_tolerance_mm
        )
        if move.flags & layout.INVERSE_TIME:
            move.feed *= course.path.length  # G93: from 1/min to mm/min
            move.flags &= ~layout.INVERSE_TIME
        planner.synced = False
        has_steps = False  # becomes True with the first chord that has steps
        while course.has_next():
            if not course.next_chord() or (arc and limits_apply and self.outside(course.place)):
                self.stop_with_alarm(errors.ALARM_SOFT_LIMIT)
            self.service()
            self.wait_for_room()
            if self._is_path_dropped():
                return
            power = self.power_of(move)
            has_steps |= planner.line(course.place, move, power)
            if self._is_jog and state.run == st.IDLE and not planner.empty():
                # The first chord starts the jog, so that it can be cancelled from now on.
                self._motor_control.start(st.JOG)
        if not has_steps:
            self.apply_zero_length(move)


class NonlinearHoming(HomingProbing):
    """Homing of joints, each to its own switch, and probing with the tool."""

    _canon: "NonlinearCanon"
    _planner: "NonlinearPlanner"

    def find_switches(self, axes: int) -> None:
        """Home these axes (a mask), as HomingProbing.find_switches(). Axis i stands for joint i:
        positions, travel and rates are those of joints, in their units."""
        settings, planner = self._settings, self._planner
        travel = settings.max_travel[:]
        planner.homing = True
        try:
            for i in range(planner.axes):
                settings.max_travel[i] = planner.kinematics.travel[i]
            super().find_switches(axes)
        finally:
            planner.homing = False
            copy(travel, settings.max_travel, planner.axes)

    def _set_origin(self, axes: int) -> None:
        """Set the positions of the joints in a mask: the geometry's HOME, less or plus the
        distance that homing has pulled off."""
        settings, planner = self._settings, self._planner
        self._engine.position(self._steps)
        for i in range(planner.axes):
            if axes >> i & 1:
                # _zero_origin: positions are counted from where the pull-off has ended.
                pull_off = 0.0 if self._zero_origin else settings.homing_pull_off_mm
                if not settings.homing_dir_invert >> i & 1:  # the switch is at the positive end
                    pull_off = -pull_off
                planner.set_axis(self._steps, i, planner.kinematics.home[i] + pull_off)
        self._engine.set_position(self._steps)

    def _on_contact(self) -> None:
        """Stop the probing move, as HomingProbing._on_contact(), and its planning. Interrupt."""
        super()._on_contact()
        self._canon.stop_planning = self._contact
