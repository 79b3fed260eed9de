"""Motor control: starts and stops motion, and powers the motors while they need it ($1).

Stops come first: a reset, a switch, a button. They are also called from interrupts of pins, as the
port's listener (InputListener). The main loop does the rest with poll_motors().
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


_FOR_EVER = const(255)  # $1: the motors stay powered
# States in which the engine may be running.
_MOTION = const(st.RUN | st.HOLD | st.JOG)  # run states with motion
_PATIENCE = const(3)  # restarts without progress; one more is a fault


class MotorControl:
    """Motion, tool and motors as a whole.

    pump reads the link. moving: the engine was started, and has not been found idle since.
    in_idle_delay: motion has stopped, and motors are still powered ($1), since _since (ms).
    _is_new: nothing has moved since power-up. by_pin: a switch or a button has requested the
    pending reset. _progress, _stalls: progress at the last restart of motion, and the number of
    restarts without progress. _after_alarm: called once the alarm is reported, to add messages.
    """

    pump: "Callable[[], None]"

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
        self.moving = False
        self.by_pin = False
        self.in_idle_delay = False
        # While probing: returns whether the probe touches; called before motion starts or resumes.
        self.touches: "Callable[[], bool] | None" = None
        self._since = 0  # Port.ticks_ms(), when the idle delay began
        self._level = -1  # of the motors' enable output; -1: not set yet
        self._is_new = True
        self._progress = -1  # -1: motion was never restarted
        self._stalls = 0
        self._after_alarm: "Callable[[], None] | None" = None

    def connect(self, pump: "Callable[[], None]") -> None:
        """Set the function that reads the link."""
        self.pump = pump

    # Stops, callable from anywhere

    def reset(self) -> None:
        """Soft reset: tool off and motors stopped at once, the rest in the next Realtime.run().
        Until arm() both stay off, whatever the interrupted code does."""
        try:
            self._port.kill()
        finally:
            self._engine.stop()
        self.note_reset(0)

    # Interrupts of pins call these. As native code, and without reset() in between, they need half
    # the stack. If one of them raises, the port's callback handles it (on_fault).

    @micropython.native
    def note_reset(self, alarm: int) -> None:
        """Note that everything was stopped: set the alarm (its number) and post a reset. With 0
        it is an alarm only if motion was cut short."""
        state = self._state
        if not state.pending[st.RESET]:
            # A reset during motion is an alarm: steps may be lost.
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
        """Handle a change of a limit input: with hard limits ($21) stop and alarm, unless the
        machine is in alarm already or homing, which needs the switches. Interrupt."""
        state = self._state
        matters = self._settings.hard_limits and not state.run & (st.ALARM | st.HOMING)
        if matters and state.alarm == 0:
            self._port.kill()
            self._engine.stop()
            self.note_reset(errors.ALARM_HARD_LIMIT)
            self.by_pin = True

    @micropython.native
    def on_controls(self, active: int) -> None:
        """Handle a change of a control input or the emergency stop. active: mask of those in
        effect now. Interrupt."""
        state = self._state
        # In an alarm motion is stopped: it is an emergency only if spindle or coolant is on.
        emergency = active & EMERGENCY_STOP and (state.run != st.ALARM or self.is_on())
        if active & RESET or emergency:
            self._port.kill()
            self._engine.stop()
            self.note_reset(errors.ALARM_EMERGENCY_STOP if emergency else 0)
            self.by_pin = True
        elif active & EMERGENCY_STOP:
            self._port.safe()  # also what an extra has switched on in the alarm
        if active & HOLD:
            state.post(st.FEED_HOLD)
        if active & START:
            state.post(st.CYCLE_START)
        if active & DOOR:
            state.post(st.SAFETY_DOOR)

    def emergency(self) -> None:
        """Handle a pressed emergency stop: in each turn of the main loop. See on_controls()."""
        state = self._state
        if state.alarm == errors.ALARM_EMERGENCY_STOP:  # handled, but not yet reported
            return
        if state.run != st.ALARM or self.is_on():
            self.reset()
            state.alarm = errors.ALARM_EMERGENCY_STOP
        else:
            self._port.safe()  # as in on_controls()

    @micropython.native
    def is_on(self) -> bool:
        """Return whether spindle or coolant is on: also in an alarm, after a failed probing, as
        with Grbl. Called in an interrupt."""
        return bool(self._spindle.direction() or self._coolant.mask)

    def on_fault(self) -> None:
        """Stop everything with an internal alarm, because a callback of the port has raised an
        exception. Interrupt."""
        self._state.alarm = errors.ALARM_INTERNAL
        self.reset()

    # Alarms

    def fail(self, alarm: int, after: "Callable[[], None] | None" = None) -> None:
        """Set an alarm that is reported at the end of the line. after: called once the alarm is
        reported, to add messages."""
        self._state.alarm = alarm
        self._after_alarm = after

    def enter_alarm(self) -> "Callable[[], None] | None":
        """Enter the state Alarm. After a reset, switch spindle and coolant off and begin the idle
        delay. Returns the function to call after the alarm is reported, or None."""
        state = self._state
        # At a reset the port's kill() has switched these off, but only until arm(). This lasts
        # until a command switches them on.
        if state.pending[st.RESET]:
            self._spindle.stop()
            self._coolant.stop()
            if self.moving:
                self.release()
            if state.run == st.HOMING:
                self.in_idle_delay = False  # motors stay powered until Controller.restart()
        state.enter(st.ALARM)
        after, self._after_alarm = self._after_alarm, None  # it is called once only
        return self._report_fault if state.alarm == errors.ALARM_INTERNAL else after

    def _report_fault(self) -> None:
        """Send the text of an exception that a callback of the port has caught."""
        self._voice.message(self._port.fault)

    # Motors: they stay powered a little longer than they move ($1)

    def arm(self) -> None:
        """Enable motors and tool again after a stop, unless another stop is pending."""
        self._engine.arm()
        self._port.revive()
        if self._state.pending[st.RESET] or self._state.alarm:
            self._port.kill()
            self._engine.stop()

    def poll_motors(self) -> None:
        """Do one turn of the main loop while motion or the idle delay lasts."""
        if self.moving:
            self.check_engine()  # first, because a failed engine is idle, too
            if self._engine.idle():
                self.release()
        if self.in_idle_delay:
            self._end_idle_delay()

    def check_engine(self) -> None:
        """Raise RuntimeError with the engine's text if it has failed, for example because
        motion is late for its own schedule."""
        fault = self._engine.fault()
        if fault:
            raise RuntimeError(fault)

    def start(self, run: int) -> None:
        """Enter a run state (run), power the motors and start planned motion; that ends a hold.
        Nothing changes if a hook of an extra objects."""
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
        """Start the idle delay ($1), because motion has stopped. At its end the motors are powered
        off and a cycle stop is posted."""
        if self._state.hooks.stops:
            call_all(self._state.hooks.stops)
        self.moving = False
        self.in_idle_delay = True
        self._since = self._port.ticks_ms()

    def wait_unanswered(self, milliseconds: int) -> None:
        """Wait so many ms. Bytes are read meanwhile, and not answered."""
        since = self._port.ticks_ms()
        while self._port.elapsed_ms(since) < milliseconds:
            self.pump()
            if self.in_idle_delay:
                self._end_idle_delay()

    def wait_idle_delay(self) -> None:
        """Wait until the idle delay is over; lines and real-time commands wait too."""
        while self.in_idle_delay:
            self.pump()
            self._end_idle_delay()

    def _end_idle_delay(self) -> None:
        """End the idle delay once its time ($1) is over: power the motors off, unless $1 is 255 or
        a homing cycle is between two moves; post a cycle stop if motion preceded. If more was
        planned meanwhile, resume motion instead of ending it."""
        state = self._state
        if state.run & (st.RUN | st.JOG) and not state.holding and not self._planner.empty():
            self._restart()
            return
        delay = self._settings.idle_lock_ms
        stay = delay == _FOR_EVER and state.run != st.SLEEP  # all motors stay powered
        # With no motion before (_is_new), or if they stay powered, there is nothing to wait for.
        if not (stay or self._is_new) and self._port.elapsed_ms(self._since) < delay:
            return
        self.in_idle_delay = self._is_new = False
        self.power(stay or state.run == st.HOMING)
        if state.run & _MOTION or state.system_motion or state.holding:
            state.post(st.CYCLE_STOP)

    def _restart(self) -> None:
        """Resume planned motion, which ended because the engine had run out of segments. Raises
        RuntimeError if it still made no progress after _PATIENCE restarts."""
        progress = self._segments.progress()
        self._stalls = self._stalls + 1 if progress == self._progress else 0
        if self._stalls > _PATIENCE:
            raise RuntimeError("motion is planned, but the engine makes no steps")
        self._progress = progress
        self.start(self._state.run)

    def power(self, on: bool) -> None:
        """Switch the motors on or off ($4)."""
        level = (0 if on else 1) ^ self._settings.enable_invert  # low enables, unless $4
        if level != self._level:
            self._level = level
            self._port.enable(level)
