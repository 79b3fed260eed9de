"""Real-time commands: the run-state machine.

post() takes a real-time byte wherever it comes from; run() is called at every
turn of every loop that waits, and does what has been asked, in Grbl's order:
alarm, reset, report, holds, cycle start, cycle stop, overrides. While motion
is suspended run() does not return: suspension.py has its turn there.
"""

import micropython
from base import errors
from base import state as st
from base.errors import Abort
from control.inputs import DOOR, EMERGENCY_STOP, HOLD, RESET, START
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from base.settings import Settings
    from base.state import State
    from control.coolant import Coolant
    from control.overrides import Overrides
    from control.spindle import Spindle
    from control.suspension import Suspension
    from interfaces import Port, StepEngine
    from motion.planner import Planner
    from motion.segments import Segments
    from talk.report import Report

_SOFT_RESET = const(0x18)
_JOG_CANCEL = const(0x85)
_FOR_EVER = const(255)
# The engine may be running on its own.
_MOTION = const(0x38)  # RUN | HOLD | JOG
_HOLDS = const(0xD0)  # HOLD | DOOR | SLEEP
_PATIENCE = const(3)  # times that motion may be set going in vain


class Realtime:
    """The state machine."""

    def __init__(
        self,
        state: "State",
        settings: "Settings",
        engine: "StepEngine",
        planner: "Planner",
        segments: "Segments",
        spindle: "Spindle",
        coolant: "Coolant",
        report: "Report",
        overrides: "Overrides",
    ) -> None:
        self._state = state
        self._settings = settings
        self._engine = engine
        self._planner = planner
        self._segments = segments
        self._spindle = spindle
        self._coolant = coolant
        self._report = report
        self._overrides = overrides
        self._moving = False  # the engine was started and has not been seen idle since
        self.settling = False  # it stands still, and the motors are still powered ($1)
        self._since = 0
        # Where motion stood when it was set going again, and how often that was in vain.
        self._progress = -1
        self._futile = 0
        self._behind: "Callable[[], None] | None" = None

    def connect(
        self,
        port: "Port",
        pump: "Callable[[], None]",
        resync: "Callable[[], None]",
        suspension: "Suspension",
    ) -> None:
        """Say whom to call: pump reads the link, resync copies the machine's position to all."""
        self._port = port
        self._estop = port.estop
        self._pump = pump
        self._resync = resync
        self._suspension = suspension

    # What asks, from anywhere

    def post(self, byte: int) -> None:
        """A real-time byte has been received. Unknown ones vanish."""
        if byte == _SOFT_RESET:
            self.reset()
        elif byte == _JOG_CANCEL:
            if self._state.run & st.JOG:
                self._state.post(st.CANCEL_MOTION)
        elif byte in st.EVENTS:
            self._state.post(st.EVENTS[byte])
        elif st.FIRST_OVERRIDE_BYTE <= byte <= st.LAST_OVERRIDE_BYTE:
            self._state.count(st.OVERRIDES + byte - st.FIRST_OVERRIDE_BYTE)
            self._state.post(st.OVERRIDE)

    def reset(self) -> None:
        """Soft reset: tool off and motors stopped at once, the rest in the next run(). Both stay
        so, whatever this has interrupted goes on to do, until arm()."""
        try:
            self._port.kill()
        finally:
            self._engine.stop()
        self._note_reset(0)

    # Interrupts of pins come through these: as native code, and without reset() in between, they
    # need half the stack. Where one of them raises, the port's callback sees to the rest.

    @micropython.native
    def _note_reset(self, alarm: int) -> None:
        """All has been stopped: what for, where that is an alarm, and that a reset is due."""
        state = self._state
        if not state.pending[st.RESET]:
            moving = state.run & (st.RUN | st.HOMING | st.JOG)
            if (moving or state.holding or state.system_motion) and state.alarm == 0:
                state.alarm = errors.ALARM_ABORT_CYCLE
                if state.run == st.HOMING:
                    state.alarm = errors.ALARM_HOMING_FAIL_RESET
            state.pending[st.RESET] = state.pending[st.ANY] = 1
        if alarm:
            state.alarm = alarm

    @micropython.native
    def on_limits(self) -> None:
        """A limit switch has changed. Interrupt."""
        state = self._state
        heard = self._settings.hard_limits and not state.run & (st.ALARM | st.HOMING)
        if heard and state.alarm == 0:
            self._port.kill()
            self._engine.stop()
            self._note_reset(errors.ALARM_HARD_LIMIT)

    @micropython.native
    def on_controls(self, active: int) -> None:
        """A control input has changed, or the emergency stop. active: mask. Interrupt."""
        state = self._state
        emergency = active & EMERGENCY_STOP and state.run != st.ALARM
        if active & RESET or emergency:
            self._port.kill()
            self._engine.stop()
            self._note_reset(errors.ALARM_EMERGENCY_STOP if emergency else 0)
        if active & HOLD:
            state.post(st.FEED_HOLD)
        if active & START:
            state.post(st.CYCLE_START)
        if active & DOOR:
            state.post(st.SAFETY_DOOR)

    def _emergency(self) -> None:
        """The emergency stop is pressed. Where the machine is in alarm it is stopped already."""
        state = self._state
        if state.run != st.ALARM and state.alarm != errors.ALARM_EMERGENCY_STOP:
            self.reset()
            state.alarm = errors.ALARM_EMERGENCY_STOP

    def on_fault(self) -> None:
        """A callback of the port has raised. Interrupt."""
        self._state.alarm = errors.ALARM_INTERNAL
        self.reset()

    # What answers, in the main loop

    def _tell_fault(self) -> None:
        self._report.message(self._port.fault)

    def run(self) -> None:
        """Do what has been asked; wait while motion is suspended. Raises Abort after a reset."""
        self.events()
        if self._state.suspend:
            self.suspended()

    def suspended(self) -> None:
        """Wait until motion is not suspended any more."""
        self._suspension.begin()
        while self._state.suspend:
            self._suspension.turn()
            self._pump()
            self.events()

    def events(self) -> None:
        """As run(), but does not wait for a suspension to end."""
        state = self._state
        if self._estop and self._estop():
            self._emergency()
        if not (state.pending[st.ANY] or self.settling or self._moving):
            return  # as nearly always
        if state.pending[st.RESET]:
            raise Abort  # behind which the loop tells of an alarm
        if self._moving:
            self.watch()  # first: an engine that has failed stands still, too
            if self._engine.idle():
                self.release()
        if self.settling:
            self._settle()
        if not state.posted():
            return
        if state.pending[st.RESET]:
            raise Abort  # it has come since
        if state.pending[st.STATUS_REPORT]:
            self._report.send(self._report.status())
            self._pump()
            state.pending[st.STATUS_REPORT] = 0  # what was asked meanwhile has been answered too
        held = self._holds()
        if state.take(st.CYCLE_START) and not held:
            self._cycle_start()
        if state.take(st.CYCLE_STOP):
            self._cycle_stop()
        if state.take(st.OVERRIDE):
            self._overrides.take()

    def fail(self, alarm: int, behind: "Callable[[], None] | None" = None) -> None:
        """What a line asks for has failed: an alarm at its end. behind: says more."""
        self._state.alarm = alarm
        self._behind = behind

    def stand_down(self) -> "Callable[[], None] | None":
        """There is an alarm: nothing is to turn. Returns who says more behind it."""
        state = self._state
        if state.pending[st.RESET]:  # which has killed what these switch off for good
            self._spindle.stop()
            self._coolant.stop()
            if self._moving:
                self.release()
            if state.run == st.HOMING:
                self.settling = False  # motors stay powered up to the reset
        state.run = st.ALARM
        behind, self._behind = self._behind, None
        return self._tell_fault if state.alarm == errors.ALARM_INTERNAL else behind

    def pause(self, milliseconds: int) -> None:
        """Wait: bytes are taken in, and nothing is answered."""
        since = self._port.ticks_ms()
        while self._port.elapsed_ms(since) < milliseconds:
            self._pump()
            if self.settling:
                self._settle()

    def _holds(self) -> bool:
        """Feed hold, door, sleep, motion cancel. Returns whether cycle start is to be ignored."""
        state = self._state
        cancel = state.take(st.CANCEL_MOTION)
        hold = state.take(st.FEED_HOLD)
        door = state.take(st.SAFETY_DOOR)
        sleep = state.take(st.SLEEP_REQUEST)
        if not (cancel or hold or door or sleep):
            return False
        if not state.run & (st.ALARM | st.CHECK):
            if state.run & (st.RUN | st.JOG):
                self._slow_down(sleep)
            elif state.run == st.IDLE:
                state.suspend = st.HOLD_COMPLETE
            if cancel and not state.run & st.JOG:
                state.suspend |= st.MOTION_CANCEL
            if hold and not state.run & (st.DOOR | st.JOG | st.SLEEP):
                state.run = st.HOLD
            if door:
                self._open_door()
        if sleep:
            if state.run == st.ALARM:
                state.suspend |= st.RETRACT_COMPLETE | st.HOLD_COMPLETE
            state.run = st.SLEEP
        return bool(cancel or hold or door)

    def _slow_down(self, sleep: int) -> None:
        state = self._state
        if state.suspend & (st.MOTION_CANCEL | st.JOG_CANCEL):
            return
        state.holding = True
        self._segments.hold(True)
        if state.run == st.JOG and not sleep:
            state.suspend |= st.JOG_CANCEL

    def _open_door(self) -> None:
        state = self._state
        self._report.message(errors.MSG_DOOR_AJAR)
        if not state.suspend & st.JOG_CANCEL:
            if state.run == st.DOOR and state.suspend & st.INITIATE_RESTORE:
                if state.system_motion:
                    self._segments.hold(True)
                    state.holding = True
                    state.suspend &= ~st.HOLD_COMPLETE
                state.suspend &= ~(st.RETRACT_COMPLETE | st.INITIATE_RESTORE | st.RESTORE_COMPLETE)
                state.suspend |= st.RESTART_RETRACT
            if state.run != st.SLEEP:
                state.run = st.DOOR
        state.suspend |= st.DOOR_AJAR

    def _cycle_start(self) -> None:
        state = self._state
        if state.run == st.DOOR and not state.suspend & st.DOOR_AJAR:
            if state.suspend & st.RESTORE_COMPLETE:
                state.run = st.IDLE
            elif state.suspend & st.RETRACT_COMPLETE:
                state.suspend |= st.INITIATE_RESTORE
        held = state.run == st.HOLD
        if state.run != st.IDLE and not (held and state.suspend & st.HOLD_COMPLETE):
            return
        if held and state.stop_override:
            state.stop_override |= st.STOP_RESTORE_CYCLE
            return
        state.holding = False
        self._segments.hold(False)
        go = not self._planner.empty() and not state.suspend & st.MOTION_CANCEL
        state.suspend = 0
        state.run = st.IDLE
        if go:
            self.start(st.RUN)

    def _cycle_stop(self) -> None:
        state = self._state
        cancelled = state.suspend & st.JOG_CANCEL
        if state.run & _HOLDS and not state.soft_limit and not cancelled:
            if state.holding:
                state.suspend |= st.HOLD_COMPLETE
            state.holding = False
            state.system_motion = False
            return
        if cancelled:
            self._planner.clear()
            self._resync()
            state.holding = False
        # As in Grbl `holding` stays after a probe's contact: a reset before motion is an alarm.
        if state.suspend & st.DOOR_AJAR:
            state.suspend = state.suspend & ~st.JOG_CANCEL | st.HOLD_COMPLETE
            state.run = st.DOOR
        else:
            state.suspend = 0
            state.run = st.IDLE

    # Motors: they stay powered a little longer than they move ($1)

    def arm(self) -> None:
        """Motors and tool obey again after a stop, if nothing has come that stops them anew."""
        self._engine.arm()
        self._port.revive()
        if self._state.pending[st.RESET] or self._state.alarm:
            self._port.kill()
            self._engine.stop()

    def watch(self) -> None:
        """Motion that is behind its own schedule is a fault of ours."""
        fault = self._engine.fault()
        if fault:
            raise RuntimeError(fault)

    def start(self, run: int) -> None:
        """Set the machine in motion, in that run state."""
        self._state.run = run
        self._state.holding = False
        self._segments.hold(False)
        self.settling = False
        self.power(True)
        self._moving = True
        self._engine.start()

    def release(self) -> None:
        """The machine stands still: power the motors off in a while, and call it a stop then."""
        self._moving = False
        self.settling = True
        self._since = self._port.ticks_ms()

    def settle(self) -> None:
        """Wait for the delay to pass; lines and real-time commands wait too."""
        while self.settling:
            self._pump()
            self._settle()

    def _settle(self) -> None:
        state = self._state
        if state.run & (st.RUN | st.JOG) and not state.holding and not self._planner.empty():
            self._restart()  # more has come in the meantime: nothing is lost
            return
        delay = self._settings.idle_lock_ms
        stay = delay == _FOR_EVER and state.run not in (st.SLEEP, st.ALARM)
        if not stay and self._port.elapsed_ms(self._since) < delay:
            return
        self.settling = False
        self.power(stay or state.run == st.HOMING)
        if state.run & _MOTION or state.system_motion or state.holding:
            state.post(st.CYCLE_STOP)

    def _restart(self) -> None:
        """Go on with what is planned. Raises RuntimeError where that has led nowhere before."""
        progress = self._segments.progress()
        self._futile = self._futile + 1 if progress == self._progress else 0
        if self._futile > _PATIENCE:
            raise RuntimeError("motion is planned and none is made")
        self._progress = progress
        self.start(self._state.run)

    def power(self, on: bool) -> None:
        """Motors on or off ($4)."""
        self._port.enable((0 if on else 1) ^ self._settings.enable_invert)
