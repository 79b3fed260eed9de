"""Motor control: starts and stops motion, and powers the motors while they need it ($1).

What stops comes first: a reset, a switch, a button. Those are the interrupts of pins, too: the
object that listens to the port (InputListener). The main loop does the rest with poll_motors().
"""

import micropython
from base import errors
from base import state as st
from base.controls import DOOR, EMERGENCY_STOP, HOLD, RESET, START
from base.hooks import all_agree, call_all
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import Machine


_FOR_EVER = const(255)
# The engine may be running on its own.
_MOTION = const(st.RUN | st.HOLD | st.JOG)
_PATIENCE = const(3)  # times that motion may be set going in vain


class MotorControl:
    """Motion, tool and motors as a whole."""

    pump: "Callable[[], None]"  # reads the link

    def __init__(self, machine: "Machine") -> None:
        self._state = machine.state
        self._settings = machine.settings
        self._engine = machine.engine
        self._planner = machine.planner
        self._segments = machine.segments
        self._spindle = machine.spindle
        self._coolant = machine.coolant
        self._port = machine.port
        self._voice = machine.report
        self.moving = False  # the engine was started and has not been seen idle since
        self.by_pin = False  # a switch or a button has asked for the reset that is due
        self.in_idle_delay = False  # it stands still, and the motors are still powered ($1)
        # While probing: whether the probe touches, asked before motion begins or goes on.
        self.touches: "Callable[[], bool] | None" = None
        self._since = 0
        self._level = -1  # of the motors' enable output: none has been set
        self._is_new = True  # power is on, and nothing can have moved
        # Where motion stood when it was set going again, and how often that was in vain.
        self._progress = -1
        self._stalls = 0
        self._after_alarm: "Callable[[], None] | None" = None

    def connect(self, pump: "Callable[[], None]") -> None:
        """Say how the link is read."""
        self.pump = pump

    # Stops, from anywhere

    def reset(self) -> None:
        """Soft reset: tool off and motors stopped at once, the rest in the next run(). Both stay
        so, whatever this has interrupted goes on to do, until arm()."""
        try:
            self._port.kill()
        finally:
            self._engine.stop()
        self.note_reset(0)

    # Interrupts of pins come through these: as native code, and without reset() in between, they
    # need half the stack. Where one of them raises, the port's callback sees to the rest.

    @micropython.native
    def note_reset(self, alarm: int) -> None:
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
            self.note_reset(errors.ALARM_HARD_LIMIT)
            self.by_pin = True

    @micropython.native
    def on_controls(self, active: int) -> None:
        """A control input has changed, or the emergency stop. active: mask. Interrupt."""
        state = self._state
        emergency = active & EMERGENCY_STOP and state.run != st.ALARM
        if active & RESET or emergency:
            self._port.kill()
            self._engine.stop()
            self.note_reset(errors.ALARM_EMERGENCY_STOP if emergency else 0)
            self.by_pin = True
        if active & HOLD:
            state.post(st.FEED_HOLD)
        if active & START:
            state.post(st.CYCLE_START)
        if active & DOOR:
            state.post(st.SAFETY_DOOR)

    def emergency(self) -> None:
        """The emergency stop is pressed. Where the machine is in alarm it is stopped already."""
        state = self._state
        if state.run != st.ALARM and state.alarm != errors.ALARM_EMERGENCY_STOP:
            self.reset()
            state.alarm = errors.ALARM_EMERGENCY_STOP

    def on_fault(self) -> None:
        """A callback of the port has raised. Interrupt."""
        self._state.alarm = errors.ALARM_INTERNAL
        self.reset()

    # Alarms

    def fail(self, alarm: int, after: "Callable[[], None] | None" = None) -> None:
        """What a line asks for has failed: an alarm at its end. after: called with the alarm
        reported, to say more."""
        self._state.alarm = alarm
        self._after_alarm = after

    def enter_alarm(self) -> "Callable[[], None] | None":
        """There is an alarm: nothing is to turn. Returns what to call after it is reported."""
        state = self._state
        if state.pending[st.RESET]:  # which has killed what these switch off for good
            self._spindle.stop()
            self._coolant.stop()
            if self.moving:
                self.release()
            if state.run == st.HOMING:
                self.in_idle_delay = False  # motors stay powered up to the reset
        state.enter(st.ALARM)
        after, self._after_alarm = self._after_alarm, None
        return self._report_fault if state.alarm == errors.ALARM_INTERNAL else after

    def _report_fault(self) -> None:
        self._voice.message(self._port.fault)

    # Motors: they stay powered a little longer than they move ($1)

    def arm(self) -> None:
        """Motors and tool obey again after a stop, if nothing has come that stops them anew."""
        self._engine.arm()
        self._port.revive()
        if self._state.pending[st.RESET] or self._state.alarm:
            self._port.kill()
            self._engine.stop()

    def poll_motors(self) -> None:
        """One turn of the main loop, as long as it moves or settles."""
        if self.moving:
            self.check_engine()  # first: an engine that has failed stands still, too
            if self._engine.idle():
                self.release()
        if self.in_idle_delay:
            self._end_idle_delay()

    def check_engine(self) -> None:
        """Motion that is behind its own schedule is a fault of ours."""
        fault = self._engine.fault()
        if fault:
            raise RuntimeError(fault)

    def start(self, run: int) -> None:
        """Set the machine in motion, in that run state."""
        if self._state.hooks.may_start and not all_agree(self._state.hooks.may_start):
            return
        self._state.enter(run)
        self._state.holding = False
        self._segments.hold(False)
        self.in_idle_delay = self._is_new = False
        self.power(True)
        self.moving = True
        self._engine.start()
        if self._state.hooks.started:
            call_all(self._state.hooks.started)

    def release(self) -> None:
        """The machine stands still: power the motors off in a while, and call it a stop then."""
        if self._state.hooks.stops:
            call_all(self._state.hooks.stops)
        self.moving = False
        self.in_idle_delay = True
        self._since = self._port.ticks_ms()

    def wait_unanswered(self, milliseconds: int) -> None:
        """Wait: bytes are taken in, and nothing is answered."""
        since = self._port.ticks_ms()
        while self._port.elapsed_ms(since) < milliseconds:
            self.pump()
            if self.in_idle_delay:
                self._end_idle_delay()

    def wait_idle_delay(self) -> None:
        """Wait for the delay to pass; lines and real-time commands wait too."""
        while self.in_idle_delay:
            self.pump()
            self._end_idle_delay()

    def _end_idle_delay(self) -> None:
        state = self._state
        if state.run & (st.RUN | st.JOG) and not state.holding and not self._planner.empty():
            self._restart()  # more has come in the meantime: nothing is lost
            return
        delay = self._settings.idle_lock_ms
        stay = delay == _FOR_EVER and state.run != st.SLEEP
        if not (stay or self._is_new) and self._port.elapsed_ms(self._since) < delay:
            return
        self.in_idle_delay = self._is_new = False
        self.power(stay or state.run == st.HOMING)
        if state.run & _MOTION or state.system_motion or state.holding:
            state.post(st.CYCLE_STOP)

    def _restart(self) -> None:
        """Go on with what is planned. Raises RuntimeError where that has led nowhere before."""
        progress = self._segments.progress()
        self._stalls = self._stalls + 1 if progress == self._progress else 0
        if self._stalls > _PATIENCE:
            raise RuntimeError("motion is planned and none is made")
        self._progress = progress
        self.start(self._state.run)

    def power(self, on: bool) -> None:
        """Motors on or off ($4)."""
        level = (0 if on else 1) ^ self._settings.enable_invert
        if level != self._level:
            self._level = level
            self._port.enable(level)
