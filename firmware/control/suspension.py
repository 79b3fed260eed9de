"""Suspension: what happens during a hold, an open door, or sleep.

realtime.wait_suspended() calls run_step() until the suspension ends. Work that takes time is a
generator, which yields where it waits, so that no wait is nested in another. Parking, an option of
the board, moves the tool away from the work and back.
"""

from array import array

from base import errors
from base import state as st
from base.axes import Z
from base.float32 import vector
from micropython import const
from motion import layout
from motion import planner as plan

from control.modes import COOLANT, RPM, SPINDLE

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Iterator

    from interfaces import Machine


# Time for spindle and coolant to start after the door is closed, before cutting resumes.
_SPINDLE_DELAY_MS = const(4000)  # until the spindle turns at its speed
_COOLANT_DELAY_MS = const(1000)  # until coolant arrives

_PARK_AXIS = Z
_PARK_TARGET_MM = -5.0  # machine coordinates, where a parked tool is
_PARK_RATE = 500.0  # mm/min
_PULL_OUT_RATE = 100.0  # mm/min, out of the material with the spindle on
_PULL_OUT_MM = 5.0  # upwards


class Suspension:
    """Holds, door and sleep.

    position copies the machine's position, in mm. parks: the board has the parking option. _voice
    sends messages. _flags, _rpm: spindle, coolant and speed of the block that was held; _lit: the
    laser was on before. _routine: the work in progress, None for none. While parking, in mm of
    machine coordinates, _target is a move's end; _resume_at the position to come back to;
    _waypoint where the slow part of the way ends, on the parking axis.
    """

    def __init__(self, machine: "Machine", parks: bool) -> None:
        self._state = machine.state
        self._settings = machine.settings
        self._engine = machine.engine
        self._steps = array("i", (0 for _ in range(machine.planner.motors)))
        self._planner = machine.planner
        self._segments = machine.segments
        self._spindle = machine.spindle
        self._coolant = machine.coolant
        self._inputs = machine.inputs
        self._port = machine.port
        self._modes = machine.modes
        self._overrides = machine.overrides
        self._motor_control = machine.motor_control
        self._voice = machine.report
        self._position = machine.position
        self._parks = parks
        self._move = plan.Move()
        self._target = vector(machine.planner.axes)
        self._resume_at = vector(machine.planner.axes)
        self._waypoint = 0.0
        self._lit = False
        self._routine: "Iterator[None] | None" = None

    def run_step(self) -> None:
        """Do one turn of a suspension: advance the routine in progress to its next yield; without
        one choose what to do."""
        if not self._routine:
            self._choose()
        if self._routine:
            try:
                next(self._routine)
            except StopIteration:
                self._routine = None

    def _choose(self) -> None:
        """Do what the run state asks for once motion has stopped: at once, or set the routine that
        does it."""
        state = self._state
        if not state.suspend & st.HOLD_COMPLETE:
            return
        if state.run not in (st.DOOR, st.SLEEP):
            self._hold()
        elif not state.suspend & st.RETRACT_COMPLETE:
            self._routine = self._retract()
        elif state.run == st.SLEEP:
            self._routine = self._sleep()
        else:
            self._door()

    def _pause(self, milliseconds: int) -> "Iterator[None]":
        """Routine: wait so many ms; it ends early if the door opens again."""
        since = self._port.ticks_ms()
        while self._port.elapsed_ms(since) < milliseconds and not self._interrupted():
            yield

    # Feed hold

    def start(self) -> None:
        """Begin a suspension, unless it has begun: store what spindle and coolant do in the block
        being executed, or the next one; without a block, as programmed. A laser is switched off by
        a spindle stop override."""
        if self._state.suspension_has_begun:
            return
        self._state.suspension_has_begun = True
        self._routine = None
        self._lit = False
        row = self._planner.row()  # the block's integers; None: no block is planned
        if row is None:
            self._flags = self._modes.accessory_flags()
            self._rpm = self._modes.rates[RPM]
        else:
            self._flags = row[layout.FLAGS]
            self._rpm = self._planner.speeds[self._planner.flow[layout.TAIL]]  # the same block's
        if self._spindle.laser:
            self._overrides.stop_spindle()

    def _hold(self) -> None:
        """Do one turn of a complete hold: stop or restore the spindle if its stop override asks
        for that, else apply a changed spindle override.

        STOP_RESTORE comes from another toggle of the override, STOP_RESTORE_CYCLE from a cycle
        start, which is posted again once the spindle turns.
        """
        state = self._state
        stop_override = state.stop_override  # mask of its requests and its state
        if stop_override & st.STOP_INITIATE:
            state.stop_override = 0
            if self._modes.modal[SPINDLE]:
                self._stop_spindle()
                state.stop_override = st.STOP_ENABLED
        elif stop_override & (st.STOP_RESTORE | st.STOP_RESTORE_CYCLE):
            if self._modes.modal[SPINDLE]:
                self._voice.message(errors.MSG_SPINDLE_RESTORE)
                self._restore_spindle()
            if stop_override & st.STOP_RESTORE_CYCLE:
                state.post(st.CYCLE_START)
            else:
                state.override_countdown = 0  # the next status report shows the spindle
            state.stop_override = 0
        elif not stop_override and state.update_spindle:
            if self._spindle.laser or self._spindle.is_on():  # a hold starts no spindle
                self._spindle.set_speed(self._flags & plan.SPINDLE_MASK, self._rpm)
            state.update_spindle = False

    def _stop_spindle(self) -> None:
        """Stop the spindle, and note whether a laser was on. If motion has ended since start(), no
        block is left: the programmed speed is then stored for a laser that was on."""
        self._lit = self._lit or self._spindle.is_on()
        if self._spindle.laser and self._planner.empty():
            self._rpm = self._modes.rates[RPM] if self._lit else 0.0
        self._spindle.set_speed(0, 0.0)  # 0: OFF

    def _restore_spindle(self) -> None:
        """Start the spindle as it was before the hold. With planned motion a laser's power is
        computed again per block and set when motion resumes."""
        spindle, direction = self._spindle, self._flags & plan.SPINDLE_MASK
        if not spindle.laser:
            spindle.set_speed(direction, self._rpm)
        elif self._planner.empty():
            spindle.restore(direction, self._rpm)
        else:
            self._state.update_spindle = True  # power is set when motion resumes
            spindle.enable(direction)
            self._planner.each_power(spindle.block_power)  # also updates the reported speed

    # Sleep

    def _sleep(self) -> "Iterator[None]":
        """Routine: switch everything off, and wait for a reset."""
        self._voice.message(errors.MSG_SLEEP)
        self._stop_accessories()
        self._motor_control.release()
        while True:  # until a reset raises Abort
            yield

    def _stop_accessories(self) -> None:
        """Switch spindle and coolant off."""
        self._stop_spindle()
        self._coolant.set(0)

    # Door

    def _interrupted(self) -> bool:
        """Return whether the door was opened again, which ends a routine early."""
        return bool(self._state.suspend & st.RESTART_RETRACT)

    def _retract(self) -> "Iterator[None]":
        """Routine: after a hold by door or sleep, park if the board does, and switch spindle and
        coolant off. A request to start this routine again (RESTART_RETRACT) is done by it."""
        state = self._state
        state.stop_override = 0  # ends a spindle stop (0x9E)
        if self._parks:
            yield from self._park()  # stops spindle and coolant on its way up
        else:
            self._stop_accessories()
        state.suspend &= ~st.RESTART_RETRACT
        state.suspend |= st.RETRACT_COMPLETE

    def _door(self) -> None:
        """Do one turn after the door was opened and the tool retracted: note when the door is
        closed; restore after a cycle start."""
        state = self._state
        if not self._inputs.door_open():
            state.suspend &= ~st.DOOR_AJAR
        if state.suspend & st.RESTORE_COMPLETE:  # a hold, else ignored, has cancelled the start
            state.post(st.CYCLE_START)
        elif state.suspend & st.INITIATE_RESTORE:
            self._routine = self._restore()

    def _restore(self) -> "Iterator[None]":
        """Routine: undo _retract(), in the reverse order, then post a cycle start. If the door
        opens, the rest is left out."""
        state = self._state
        # Down to where the slow part begins, unless the held tool was higher than a parked one.
        if self._parks and self._may_park() and self._target[_PARK_AXIS] <= _PARK_TARGET_MM:
            self._target[_PARK_AXIS] = self._waypoint
            yield from self._park_move(self._target, _PARK_RATE, with_accessories=False)
        if self._modes.modal[SPINDLE] and not self._interrupted():
            self._restore_spindle()
            if not self._spindle.laser:
                yield from self._pause(_SPINDLE_DELAY_MS)
        if self._modes.modal[COOLANT] and not self._interrupted():
            self._coolant.set(self._modes.modal[COOLANT])
            yield from self._pause(_COOLANT_DELAY_MS)
        if self._parks and self._may_park() and not self._interrupted():
            yield from self._park_move(self._resume_at, _PULL_OUT_RATE, with_accessories=True)
        if not self._interrupted():
            state.suspend |= st.RESTORE_COMPLETE
            state.post(st.CYCLE_START)

    # Parking

    def _may_park(self) -> bool:
        """Return whether parking is possible now: homing is enabled (it makes machine coordinates
        valid), the tool is no laser, M56 allows it, and no probing is in progress."""
        return (
            bool(self._settings.homing)
            and not self._spindle.laser
            and self._state.override_control
            and self._motor_control.touches is None
        )

    def _park(self) -> "Iterator[None]":
        """Routine: pull out slowly with the spindle on, then retract fast with it off. If parking
        is not possible or the tool is high enough, only spindle and coolant are switched off."""
        target = self._target
        self._position(target)
        # If a restore was interrupted, this retract keeps the values of the first one.
        if not self._interrupted():
            self._resume_at[:] = target
            self._waypoint = min(target[_PARK_AXIS] + _PULL_OUT_MM, _PARK_TARGET_MM)
        if not self._may_park() or target[_PARK_AXIS] >= _PARK_TARGET_MM:
            self._stop_accessories()
            return
        if target[_PARK_AXIS] < self._waypoint:
            target[_PARK_AXIS] = self._waypoint
            yield from self._park_move(target, _PULL_OUT_RATE, with_accessories=True)
        self._stop_accessories()
        if target[_PARK_AXIS] < _PARK_TARGET_MM:
            target[_PARK_AXIS] = _PARK_TARGET_MM
            yield from self._park_move(target, _PARK_RATE, with_accessories=False)

    def _park_move(
        self, target: "array[float]", rate: float, with_accessories: bool
    ) -> "Iterator[None]":
        """Routine: move to target (mm) at a rate (mm/min), outside the planner's ring, whose
        blocks stay; with spindle and coolant as in the held block, or without. It ends when motion
        ends, and leaves the machine held."""
        state = self._state
        move = self._move
        move.clear()
        move.feed = rate
        move.flags = layout.SYSTEM_MOTION | layout.NO_FEED_OVERRIDE
        power = 0
        if with_accessories:
            move.flags |= self._flags & plan.ACCESSORY_MASK
            move.spindle_rpm = self._rpm
            if self._flags & plan.SPINDLE_MASK:
                power = self._spindle.power(self._rpm)
        self._segments.begin_system()
        self._engine.position(self._steps)
        planned = self._planner.system_line(target, move, power, self._steps)
        if planned:  # else it has no steps
            state.system_motion = True
            state.holding = False
            self._segments.hold(False)
            self._motor_control.start(state.run)
            while state.system_motion:  # until Realtime's cycle stop
                yield
        self._segments.end_system()
        self._segments.hold(True)
        if not planned:  # one turn of the loop, as after a move
            yield
