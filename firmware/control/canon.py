"""Canon: the canonical machining functions that the G-code interpreter calls.

Targets are absolute, in mm of machine coordinates. Everything that must wait does so here, through
`service`, which raises Abort after a reset. In check mode nothing moves and nothing waits.

line(), arc() and jog() only request a move, deep within the interpreter. finish() executes it
after the interpreter has returned, and waits for free blocks: an interrupt needs the rest of the
stack.
"""

from array import array

import micropython
from base import errors
from base import state as st
from base.float32 import copy, f32, truncate
from base.hooks import call_all
from micropython import const
from motion import arcs, layout
from motion import planner as plan
from motion.plan_kernel import FULL, OUTSIDE, full

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import Machine
    from motion.arc_geometry import Arc
    from motion.planner import Move


_DWELL_TICK_MS = const(50)
_DWELL_TICKS_PER_S = const(20)  # 1000 / 50

# Indices into the array `travel`, for check_travel().
_AXES = const(0)  # number of axes
SHUT = const(1)  # mask of axes that may not go above 0; from bit BELOW on, not below 0
# From here on per axis the bits of a float: the greatest distance from 0, mm. It is within what
# the axis's steps can count (Planner.reach_mm()); with soft limits within its travel, too.
TRAVEL = const(2)  # the first axis's
BELOW = const(8)  # a bit of SHUT


@micropython.viper
def check_travel(target: ptr32, travel: ptr32, flow: ptr32) -> int:
    """Return why a line to target is impossible now, as a mask: OUTSIDE the machine's travel, the
    planner's ring FULL; 0: it is possible.

    target: floats, mm of machine coordinates; travel: Canon.travel; flow: the planner's. Floats
    are compared by their bits, as integers: without the sign these have the same order, infinity
    and NaN above all numbers.
    """
    signs = ptr8(target)
    reasons = 0
    for i in range(travel[_AXES]):
        # The distance from 0, without the sign: a kernel's constants have 30 bits, so bit 30 comes
        # from the last byte.
        mm = (target[i] & 0x3FFFFFFF) | ((signs[4 * i + 3] & 0x40) << 24)
        if mm:  # 0 is always allowed
            # The axis's bit in SHUT; + BELOW if the target is negative.
            side = i + ((signs[4 * i + 3] >> 7) << 3)
            if mm > travel[TRAVEL + i] or (travel[SHUT] >> side) & 1:
                reasons = OUTSIDE
    return reasons | int(full(flow))  # FULL or 0


class Canon:
    """The functions. positive_origin: homing sets 0, so travel may be in either direction.

    _asked: a move is requested and not planned; it is _target and _move. course: the chords of its
    arc that are still to be planned; course[arcs.CHORDS_LEFT] is their number, 0 for a line.
    _is_jog: it is a jog. travel: see check_travel(). _flow: the planner's state, for kernels.
    """

    def __init__(self, machine: "Machine", positive_origin: bool) -> None:
        self._state = machine.state
        self._settings = machine.settings
        self.planner = machine.planner
        self._spindle = machine.spindle
        self._coolant = machine.coolant
        self._motor_control = machine.motor_control
        self._port = machine.port
        self._positive_origin = positive_origin
        # _AXES, SHUT, and TRAVEL of each axis; configure() sets these.
        self.travel = array("i", (machine.planner.axes, 0) + (0,) * machine.planner.axes)
        self._flow = machine.planner.flow
        self._asked = False
        self.course = array("i", (0 for _ in range(arcs.course_length(machine.planner.axes))))
        self._is_jog = False

    def connect(self, service: "Callable[[], None]") -> None:
        """Set the function to call while waiting; it raises Abort after a reset."""
        self.service = service

    def configure(self) -> None:
        """Apply the settings of travel ($20, $23, $130 and following) and the arc tolerance ($12):
        set the array travel for lines, and the same limits in steps for the chords of arcs."""
        settings = self._settings
        travel = self.travel
        # Axes (a mask) whose travel is above 0; that of the others is below. SHUT is the reverse:
        # "not above 0" for the others, "not below 0" for these.
        positive = settings.homing_dir_invert if self._positive_origin else 0
        travel[SHUT] = (255 - positive) | (positive << BELOW) if settings.soft_limits else 0
        for i in range(self.planner.axes):
            far = self.planner.reach_mm(i)  # greatest distance from 0, mm
            least, greatest = -arcs.FARTHEST, arcs.FARTHEST  # steps
            if settings.soft_limits:
                far = min(far, settings.max_travel[i])
                steps = settings.max_travel[i] * self.planner.steps_per_mm[i] + 0.5  # to round
                least, greatest = (0, steps) if positive >> i & 1 else (-steps, 0)
            arcs.limit(self.course, i, least, greatest)
            self.limit(i, far)
        arcs.stray(self.course, settings.arc_tolerance_mm)

    def limit(self, axis: int, far: float) -> None:
        """Set the greatest distance of an axis (index) from 0 to far (mm). It is stored as the
        bits of a float, because `travel` holds integers."""
        copy(array("f", (far,)), memoryview(self.travel)[TRAVEL + axis :], 1)

    # Moves

    def line(self, target: "array[float]", move: "Move") -> None:
        """Request a straight line to target (mm), rapid or feed by the move's flags; finish()
        executes it. Both arguments are kept, not copied."""
        if self._asked:  # one move at a time
            self.finish()
        self._target = target
        self._move = move
        self._asked = True

    def finish(self) -> None:
        """Plan the requested move, if there is one, and start it if it is a jog."""
        if self.course[arcs.CHORDS_LEFT]:
            self._plan_chords()
        if self._asked:
            self._asked = False
            self._plan_line(self._target, self._move)
        if self._is_jog:
            self._is_jog = False
            self.begin_jog()

    def begin_jog(self) -> None:
        """Start a planned jog at once, unless one is being executed."""
        if self._state.run == st.IDLE and not self.planner.empty():
            self._motor_control.start(st.JOG)

    def _plan_line(self, target: "array[float]", move: "Move") -> None:
        """Plan a line, once a block is free. A target outside the machine's travel is an alarm; a
        jog's was checked before. In check mode it is only checked."""
        state = self._state
        reasons = check_travel(target, self.travel, self._flow)
        if reasons & OUTSIDE and state.run != st.JOG:
            self.stop_with_alarm(errors.ALARM_SOFT_LIMIT)  # raises Abort
        if state.run == st.CHECK:
            return
        if state.pending[st.ANY] or state.suspend:
            self.service()
        if reasons & FULL:
            jogs = state.run == st.JOG
            self.wait_for_room()
            if jogs and state.run != st.JOG:  # cancelled while it waited: do not plan it
                return
        if not self.planner.line(target, move, self.power_of(move)):  # it has no steps
            self.apply_zero_length(move)

    def make_room(self) -> None:
        """Prepare to plan a block: handle posted events, and wait until one is free. Raises Abort
        after a reset."""
        if self._state.pending[st.ANY] or self._state.suspend:
            self.service()
        if full(self._flow):
            self.wait_for_room()

    def wait_for_room(self) -> None:
        """Wait until another block can be planned."""
        while self.planner.full():
            self.auto_start()
            self.service()

    def _plan_chords(self) -> None:
        """Plan all chords of an arc except the last, which is a line to its target. Each turn
        plans as many as the ring has blocks for."""
        state, move, course = self._state, self._move, self.course
        moves = state.run != st.CHECK
        power, known_changes = 0, -1  # State.changes[0] when power was computed; -1: not yet
        # In the first turn only if an event waits: the main loop has just called service().
        must_service = state.pending[st.ANY] or state.suspend  # not 0: yes
        while course[arcs.CHORDS_LEFT]:
            if must_service:
                self.service()
            must_service = 1
            if moves and known_changes != state.changes[0]:
                known_changes = state.changes[0]
                power = self.power_of(move)
            reason = self.planner.chords(course, move, power, moves)
            if state.hooks.planned:
                call_all(state.hooks.planned)
            if reason == OUTSIDE:
                self.stop_with_alarm(errors.ALARM_SOFT_LIMIT)  # raises Abort
            elif reason == FULL:
                self.auto_start()
            elif reason:  # NOWHERE: a chord without steps
                self.apply_zero_length(move)

    def apply_zero_length(self, move: "Move") -> None:
        """Apply a move without steps: a laser's S still takes effect, if M3 has switched it on."""
        if self._spindle.laser and move.flags & plan.SPINDLE_CW:
            self.spin(plan.SPINDLE_CW, move.spindle_rpm)

    def clear_request(self) -> None:
        """Drop the requested move."""
        self._asked = False
        self.course[arcs.CHORDS_LEFT] = 0
        self._is_jog = False

    def jog(self, target: "array[float]", move: "Move") -> None:
        """Request a line that starts at once, and that a hold cancels; finish() executes it."""
        self.line(target, move)
        self._is_jog = True

    def power_of(self, move: "Move") -> int:
        """Return the spindle power of the move's block, 0 with the spindle off. For a laser with
        M4 the flag DYNAMIC is added to the move: power then follows the speed."""
        if not move.flags & plan.SPINDLE_MASK:
            return 0
        if self._spindle.laser and move.flags & plan.SPINDLE_CCW:
            move.flags |= layout.DYNAMIC
        return self._spindle.block_power(move.flags, move.spindle_rpm)

    def arc(self, start: "array[float]", target: "array[float]", arc: "Arc", move: "Move") -> None:
        """Request an arc or helix as chords within $12 of it; finish() executes it. start, target:
        mm of machine coordinates; arc: its plane, centre and direction; move: as for line()."""
        self.line(target, move)  # the last chord
        chords = arc.lay(start, target, self.planner.steps_per_mm, self.course)
        if chords and move.flags & layout.INVERSE_TIME:
            # Its time is divided equally among the chords; the rate is per chord from here on.
            move.feed *= chords
            move.flags &= ~layout.INVERSE_TIME

    def dwell(self, seconds: float) -> None:
        """Wait without motion, in ticks of 50 ms, rounded up; hold and reset work meanwhile. As in
        Grbl the number of ticks has 16 bits."""
        if self._state.run == st.CHECK:
            return
        self.synchronise()
        exact = f32(_DWELL_TICKS_PER_S * seconds)
        ticks = truncate(exact)
        if exact > ticks:  # round up
            ticks += 1
        for _ in range(ticks & 0xFFFF):
            since = self._port.ticks_ms()
            self.service()
            # What service() has left of the tick; if nothing, it does not wait.
            self._motor_control.wait_unanswered(_DWELL_TICK_MS - self._port.elapsed_ms(since))

    def auto_start(self) -> None:
        """Finish planning what was added, and post a cycle start if planned motion waits in
        Idle."""
        self.planner.catch_up()
        if self._state.run == st.IDLE and not self.planner.empty():
            self._state.post(st.CYCLE_START)

    def synchronise(self) -> None:
        """Wait until all planned motion is executed and any hold has ended."""
        self.finish()
        self.auto_start()
        self.service()
        while not self.planner.empty() or self._state.run & st.UNDER_WAY:
            self.service()
        if self._state.hooks.waited:
            call_all(self._state.hooks.waited)

    def wait_motors_released(self) -> None:
        """Begin the idle delay ($1) and wait until it is over."""
        self._motor_control.release()
        while self._motor_control.in_idle_delay:
            self.service()

    # Accessories

    def spin(self, direction: int, rpm: float) -> None:
        """Set spindle direction (spindle.OFF, CW or CCW) and speed after all planned motion."""
        if self._state.run == st.CHECK:
            return
        self.synchronise()
        self._spin(direction, rpm)

    def _spin(self, direction: int, rpm: float) -> None:
        """Set spindle direction and speed (rpm) at once, and notify the extras."""
        self._spindle.set_speed(direction, rpm)
        for call in self._state.hooks.spun:
            call(direction, rpm)

    def cool(self, mask: int) -> None:
        """Switch coolant (mask of coolant.FLOOD and MIST) after all planned motion."""
        if self._state.run == st.CHECK:
            return
        self.synchronise()
        self._cool(mask)

    def _cool(self, mask: int) -> None:
        """Switch coolant (a mask) at once, and notify the extras."""
        self._coolant.set(mask)
        for call in self._state.hooks.cooled:
            call(mask)

    def safe(self) -> None:
        """Switch spindle and coolant off at once, and notify the extras."""
        self._spin(0, 0.0)  # 0: OFF
        self._cool(0)

    def end_program(self) -> None:
        """Execute the end of M2 and M30: set overrides to 100 %, switch spindle and coolant off,
        and notify the extras. M56 stays, as with Grbl."""
        state = self._state
        state.feed_override = state.rapid_override = 100
        state.override_spindle(100)
        self.planner.override()
        if state.run != st.CHECK:
            self.safe()
        call_all(state.hooks.ended)

    def control_overrides(self, parking: bool) -> None:
        """Execute M56, which enables parking, or M56 P0, which disables it."""
        if self._state.run != st.CHECK:
            self.synchronise()
        self._state.override_control = parking

    def pause_program(self) -> None:
        """Execute M0: hold until cycle start. An extra's hook may take over by returning True."""
        for takes_over in self._state.hooks.paused:
            if takes_over():
                return
        self.hold_program()

    def hold_program(self) -> None:
        """Hold until cycle start, as M0 does, without asking extras. Check mode does not wait."""
        if self._state.run != st.CHECK:
            self._state.post(st.FEED_HOLD)
            self.service()

    # Limits

    def outside(self, target: "array[float]") -> bool:
        """Return whether the target (mm) is outside the machine's travel."""
        return bool(check_travel(target, self.travel, self._flow) & OUTSIDE)

    def stop_with_alarm(self, alarm: int) -> None:
        """Stop by a hold, so that the position stays certain, then alarm (its number) and reset.
        Does not return: service() raises Abort."""
        state = self._state
        state.soft_limit = True  # with this, a hold ends in Idle
        if state.run & (st.RUN | st.JOG):
            state.post(st.FEED_HOLD)
            self.service()
        while state.run & (st.RUN | st.JOG | st.HOLD) and not state.suspend & st.HOLD_COMPLETE:
            self.service()
        self._motor_control.reset()
        state.alarm = alarm
        self.service()
