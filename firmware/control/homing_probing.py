"""Homing and probing: motion that a switch ends."""

import math
from array import array

from base import errors
from base import state as st
from base.axes import Z
from base.float32 import f32, vector
from micropython import const
from motion import layout
from motion import planner as plan

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import Machine
    from motion.planner import Move


# Search distance.
_SEARCH = 1.5  # first approach: times the axis's travel ($130)
_LOCATE = 5.0  # second approach: times the pull-off distance ($27)
# Approach fast, pull off, approach slowly, pull off.
_PHASES = const(4)  # moves of a homing cycle


class HomingProbing:
    """Both cycles.

    position copies the machine's position, in mm; resync makes planner and parser continue from
    there. zero_origin: homing sets 0; shared_switches: an input serves both ends.

    _contact: the probe has made the contact that this cycle waits for, at which Port.probe()
    returns _contact_level; probe_steps: motor positions at the last contact. homed: mask of axes
    whose switches were found, until an alarm. _steps, _target, _move: scratch.
    """

    def __init__(self, machine: "Machine", zero_origin: bool, shared_switches: bool) -> None:
        self._state = machine.state
        self._settings = machine.settings
        self._engine = machine.engine
        self._planner = machine.planner
        self._inputs = machine.inputs
        self._port = machine.port
        self._voice = machine.report
        self._canon = machine.canon
        self._motor_control = machine.motor_control
        self._position = machine.position
        self._resync = machine.resync
        self._zero_origin = zero_origin
        self._shared_switches = shared_switches
        self._kinematics = machine.planner.kinematics
        motors = machine.planner.motors
        self._steps = array("i", (0 for _ in range(motors)))
        self._target = vector(machine.planner.axes)
        self._move = plan.Move()
        self.probe_steps = array("i", (0 for _ in range(motors)))
        self.homed = 0
        self.goes_on = False  # an extra homes other axes next, as one homing

    # Probing (G38.2 to G38.5)

    def probe(self, target: "array[float]", move: "Move", away: bool, alarms: bool) -> bool:
        """Move to target (mm) until the probe touches or, if away, until it no longer touches.
        Returns whether the parser's position is the target: after a contact it is elsewhere.

        move: feed and flags, as for Canon.line(); alarms: a probe that fails is an alarm (G38.2,
        G38.4). With a wrong level at the start nothing moves, and the alarm is set in any case.
        """
        state = self._state
        if state.run == st.CHECK:
            return True
        self._canon.synchronise()
        state.probe_succeeded = False
        # probe(): it touches. It must not touch yet; with away it must.
        if self._inputs.probe() != away:
            self._canon.apply_zero_length(move)  # a beam is dark in a probing, also without motion
            self._motor_control.fail(errors.ALARM_PROBE_FAIL_INITIAL)
            return False
        self._contact = False
        self._contact_level = self._inputs.contact_level(away)
        self._motor_control.touches = self._touches  # called whenever motion starts or resumes
        self._canon.line(target, move)
        self._canon.finish()
        state.post(st.CYCLE_START)
        self._canon.service()
        while state.run != st.IDLE:
            self._canon.service()
        self._end_watch()
        state.take_event(st.CANCEL_MOTION)  # posted by a contact at the very end of motion
        self._planner.clear()
        if self._contact:
            state.probe_succeeded = True
            self._resync()  # planner and parser: the machine has stopped before the target
        else:
            # As _resync(), but without the parser, whose position is the target, as in Grbl.
            self._engine.position(self._steps)
            self._planner.sync_motors(self._steps)
            if not alarms:  # [PRB:...] reports where the move has ended
                self._engine.position(self.probe_steps)
        self._canon.service()
        if alarms and not state.probe_succeeded:  # the alarm is reported before [PRB:...]
            self._motor_control.fail(errors.ALARM_PROBE_FAIL_CONTACT, self._end_probe)
        else:
            self._end_probe()
        return not state.probe_succeeded

    def _end_probe(self) -> None:
        """Release the motors, as after any motion, and report the contact."""
        self._motor_control.release()
        self._motor_control.wait_idle_delay()
        self._report_probe()

    def forget_probe(self) -> None:
        """Clear the last probe position; end a cycle in progress."""
        self._end_watch()
        for i in range(len(self.probe_steps)):
            self.probe_steps[i] = 0

    def _touches(self) -> bool:
        """Watch the probe from now on, unless it has touched. Returns whether it has: then motion
        must not start, and the contact's request to stop it is dropped."""
        if not self._contact:
            self._port.watch_probe(self._on_contact, self._contact_level)
        if self._contact:  # perhaps just now: watch_probe() calls at once if the level is there
            self._state.take_event(st.CANCEL_MOTION)
        return self._contact

    def _end_watch(self) -> None:
        """Stop watching the probe."""
        self._port.watch_probe(None, False)
        self._motor_control.touches = None

    def _on_contact(self) -> None:
        """Interrupt: store the position, to the step, and stop. A contact while a hold has stopped
        motion counts only if it lasts until motion resumes: _touches() checks again."""
        state = self._state
        if not state.suspend & st.HOLD_COMPLETE:
            self._engine.position(self.probe_steps)
            self._contact = True
            state.post(st.CANCEL_MOTION)

    def _report_probe(self) -> None:
        """Send [PRB:...]: see probe_position()."""
        self._planner.to_mm(self.probe_steps, self._target)
        self._voice.probe(self._target)

    def probe_position(self) -> "array[float]":
        """Return the position that [PRB:...] reports, in mm of machine coordinates: of the last
        contact, or where a cycle without contact and alarm has ended. The array is scratch: use it
        before the next cycle."""
        self._planner.to_mm(self.probe_steps, self._target)
        return self._target

    # Homing ($H)

    def home(self, axes: int) -> bool:
        """Find the switches: of these axes (a mask), or with 0 of all, Z first.

        Returns False if homing cannot begin because a switch that serves both ends is hit, and
        nobody knows which end: the machine will be in alarm. Raises Abort if homing fails.
        """
        state = self._state
        if self._shared_switches and self._inputs.limits():
            self._motor_control.reset()
            state.alarm = errors.ALARM_HARD_LIMIT
            return False
        find = state.hooks.find_switches
        if axes:
            find(axes)
        else:
            find(1 << Z)
            find(((1 << self._planner.axes) - 1) & ~(1 << Z))
        if self.goes_on:
            return True  # the next axes' first move makes a reset or the door an alarm
        self._canon.service()
        state.stop_override = 0  # of a hold during homing, which has no effect
        state.update_spindle = False  # homing has stopped it: a hold must not start it
        self._resync()
        return True

    def home_in_turn(self, home: "Callable[[int], bool]", cycles: "list[int]") -> bool:
        """Call home() with each of these masks of axes, as one homing: between them a reset or
        the door is an alarm, and a hold has no effect. Returns whether all have succeeded."""
        try:
            for i in range(len(cycles)):
                self.goes_on = i + 1 < len(cycles)
                if not home(cycles[i]):
                    return False
        finally:
            self.goes_on = False
        return True

    def find_switches(self, axes: int) -> None:
        """Find the switches of these axes (a mask), all in the same moves, and set the position
        there. Approach fast, pull off, approach slowly, pull off."""
        settings = self._settings
        # The first approach: far enough for the axis of the longest travel.
        travel = 0.0  # mm
        count = 0
        for i in range(self._planner.axes):
            if axes >> i & 1:
                travel = max(travel, _SEARCH * settings.max_travel[i])
                count += 1
        # Each axis moves at the homing rate, so the diagonal is faster by this factor.
        diagonal = math.sqrt(count)
        rate = settings.homing_seek  # mm/min of each axis
        for phase in range(_PHASES):
            approach = phase % 2 == 0  # else a pull-off
            self._state.hooks.home_phase(axes, approach, travel, rate * diagonal)
            self._motor_control.wait_unanswered(settings.homing_debounce_ms)
            if approach:  # the next move is a pull-off
                travel = settings.homing_pull_off_mm
                rate = settings.homing_seek
            else:  # the second approach; set again, but not used, after the last move
                travel = settings.homing_pull_off_mm * _LOCATE
                rate = settings.homing_feed
        self._set_origin(axes)
        self.homed |= axes

    def home_phase(self, axes: int, approach: bool, travel: float, rate: float) -> None:
        """Execute one of the moves of homing, until all switches are found, or, away from them,
        until its end.

        axes: mask; approach: towards the switches, else away from them; travel: mm per axis; rate:
        mm/min along the diagonal. If it fails, a reset is posted, and the call of service() raises
        Abort.
        """
        engine = self._engine
        planner = self._planner
        engine.position(self._steps)
        self._position(self._target)
        # Each of these axes is set to 0 and moves by travel; the others stay where they are.
        for i in range(planner.axes):
            if axes >> i & 1:
                planner.set_axis(self._steps, i, 0.0)
                # Switches are at the positive end, unless $23 inverts that.
                goes_down = bool(self._settings.homing_dir_invert >> i & 1) == approach
                self._target[i] = -travel if goes_down else travel
        engine.set_position(self._steps)
        move = self._move
        move.clear()
        move.feed = rate
        move.flags = layout.SYSTEM_MOTION | layout.NO_FEED_OVERRIDE
        planner.clear()
        planner.system_line(self._target, move, 0, self._steps)
        self._motor_control.start(st.HOMING)
        self._state.spindle[st.RPM] = 0.0  # these moves have no power
        searching = axes  # mask of those that still move; on an approach, until they hit a switch
        while searching:
            if approach:
                hit = self._inputs.limits() & searching
                if hit:  # stop the motors of these axes; the others go on
                    searching &= ~hit
                    engine.lock(self._kinematics.stopped_by(hit) if self._kinematics else hit)
            self._motor_control.check_engine()  # first, because a failed engine is idle, too
            if self._failed(approach, axes):
                self._motor_control.reset()
                self._canon.service()  # raises Abort
            if engine.idle():  # the pull-off is complete
                break
            if searching:
                self._motor_control.pump()
        engine.stop()
        planner.clear()
        self._motor_control.arm()

    def _failed(self, approach: bool, axes: int) -> bool:
        """Set the alarm if the cycle cannot continue, and return whether it is set: a reset or the
        door was requested; or motion has ended without the switches, or, on the pull-off, with one
        still hit. axes: mask."""
        state = self._state
        has_ended = self._engine.idle()  # the move
        if state.pending[st.RESET]:
            state.alarm = errors.ALARM_HOMING_FAIL_RESET
        elif state.pending[st.SAFETY_DOOR]:
            state.alarm = errors.ALARM_HOMING_FAIL_DOOR
        elif has_ended and not approach and self._inputs.limits() & axes:
            state.alarm = errors.ALARM_HOMING_FAIL_PULLOFF
        elif has_ended and approach:
            state.alarm = errors.ALARM_HOMING_FAIL_APPROACH
        return state.alarm != 0

    def _set_origin(self, axes: int) -> None:
        """Set the machine position of homed axes (a mask), which are a pull-off away from their
        switch: 0 with zero_origin; else travel lies below 0, with the switch at its upper end, or
        at its lower end if $23 inverts the axis."""
        settings = self._settings
        engine = self._engine
        engine.position(self._steps)
        pull_off = settings.homing_pull_off_mm
        for i in range(self._planner.axes):
            if axes >> i & 1:
                position_mm = -pull_off
                if self._zero_origin:
                    position_mm = 0.0
                elif settings.homing_dir_invert >> i & 1:
                    position_mm = f32(pull_off - settings.max_travel[i])
                self._planner.set_axis(self._steps, i, position_mm)
        engine.set_position(self._steps)
