"""Real-time commands: the run-state machine.

post() accepts a real-time byte from any source. run() is called in every turn of every loop that
waits, and handles posted events in Grbl's order: alarm, reset, report, holds, cycle start, cycle
stop, overrides. While motion is suspended run() does not return, and calls suspension.py.
"""

from base import errors
from base import state as st
from base.errors import Abort
from base.hooks import call_all
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import Machine


_SOFT_RESET = const(0x18)  # real-time bytes
_JOG_CANCEL = const(0x85)
_END = const(-3)  # index of the end of a report: >\r\n
_HOLDS = const(st.HOLD | st.DOOR | st.SLEEP)  # states in which motion is held


class Realtime:
    """The state machine. resync copies the machine's position to planner and parser. _voice makes
    and sends reports. _estop() returns whether the emergency stop is pressed; None without one.

    state.pending has a byte per event, and ANY, which is set with each of them. state.suspend: a
    mask, why motion is suspended and how far that has progressed; 0: it is not.
    """

    def __init__(self, machine: "Machine") -> None:
        self._state = machine.state
        self._planner = machine.planner
        self._segments = machine.segments
        self._estop = machine.port.estop
        self._motor_control = machine.motor_control
        self._overrides = machine.overrides
        self._suspension = machine.suspension
        self._voice = machine.report
        self._resync = machine.resync

    # Requests, from anywhere

    def post(self, byte: int) -> None:
        """Post the event of a real-time byte; each of the same overrides counts. Unknown bytes,
        and a jog cancel except in a jog, are ignored."""
        state = self._state
        if byte in st.EVENTS:
            if byte != _JOG_CANCEL or state.run & st.JOG:
                # State.post() inline, because the answer to ? would wait for its frame.
                state.pending[st.EVENTS[byte]] = state.pending[st.ANY] = 1
        elif byte == _SOFT_RESET:
            self._motor_control.reset()
        elif st.FIRST_OVERRIDE_BYTE <= byte <= st.LAST_OVERRIDE_BYTE:
            state.count(st.OVERRIDES + byte - st.FIRST_OVERRIDE_BYTE)
            state.post(st.OVERRIDE)

    # Handling, in the main loop

    def run(self) -> None:
        """Handle events, wait while motion is suspended, then run the hooks of extras that belong
        between lines. Raises Abort after a reset."""
        self.handle_events()
        if self._state.suspend:
            self.wait_suspended()
        if self._state.hooks.between_lines:
            call_all(self._state.hooks.between_lines)

    def wait_suspended(self) -> None:
        """Wait until motion is no longer suspended; meanwhile run the suspension. Raises Abort
        after a reset."""
        self._suspension.start()
        while self._state.suspend:
            self._suspension.run_step()
            self._motor_control.pump()
            self.handle_events()

    def advance_suspension(self) -> None:
        """Run one turn of the suspension, if there is one: for a loop that reads the link itself.
        wait_suspended() goes on with it."""
        if self._state.suspend:
            self._suspension.start()
            self._suspension.run_step()

    def handle_events(self) -> None:
        """Handle everything that is posted, in the order that the module states; poll the motors
        and the extras. It does not wait for a suspension to end. Raises Abort after a reset."""
        state, motor_control = self._state, self._motor_control
        pending = state.pending
        if self._estop and self._estop():
            motor_control.emergency()
        # Rarely true, and every turn of a loop comes here.
        if pending[st.ANY] or motor_control.in_idle_delay or motor_control.moving:
            if pending[st.RESET]:
                raise Abort  # the loop then reports an alarm
            if pending[st.STATUS_REPORT]:
                report = self._voice.status()
                if state.hooks.fields:
                    report = _with_fields(report, state.hooks.fields)
                motor_control.pump()
                pending[st.STATUS_REPORT] = 0  # also answers requests received meanwhile
                self._voice.send(report)
            motor_control.poll_motors()
            if pending[st.ANY]:
                pending[st.ANY] = 0  # before the events: an interrupt may post another
                if pending[st.RESET]:
                    raise Abort  # posted meanwhile
                if any(pending):
                    hold_was_posted = self._holds()
                    if state.take_event(st.CYCLE_START):
                        if hold_was_posted:  # the start is ignored
                            self._overrides.hold()
                        else:
                            self._cycle_start()
                    if state.take_event(st.CYCLE_STOP):
                        self._cycle_stop()
                    if state.take_event(st.OVERRIDE):
                        self._overrides.apply_requests()
        if state.hooks.poll:
            call_all(state.hooks.poll)

    def _holds(self) -> bool:
        """Handle feed hold, door, sleep and motion cancel. Returns whether one of them, except
        sleep, was posted: a cycle start posted with it is ignored. In Alarm and check mode only
        sleep has an effect."""
        state = self._state
        cancel = state.take_event(st.CANCEL_MOTION)
        hold = state.take_event(st.FEED_HOLD)
        door = state.take_event(st.SAFETY_DOOR)
        sleep = state.take_event(st.SLEEP_REQUEST)
        if not (cancel or hold or door or sleep):
            return False
        if not state.run & (st.ALARM | st.CHECK):
            if state.run & (st.RUN | st.JOG):
                self._slow_down(sleep)
            elif state.run == st.IDLE or (door and state.run == st.HOMING):  # homing is ending
                state.suspend = st.HOLD_COMPLETE  # there is nothing to slow down
            if cancel and not state.run & st.JOG:
                state.suspend |= st.MOTION_CANCEL
            if hold and not state.run & (st.DOOR | st.JOG | st.SLEEP):
                state.enter(st.HOLD)
            if door:
                self._open_door()
        elif door and self._motor_control.is_on():  # left on by a failed probing or check mode
            self._motor_control.reset()
        if sleep:
            if state.run == st.ALARM:  # there is nothing to stop or retract
                state.suspend |= st.RETRACT_COMPLETE | st.HOLD_COMPLETE
            state.enter(st.SLEEP)
        return bool(cancel or hold or door)

    def _slow_down(self, sleep: int) -> None:
        """Slow down and stop, unless motion is being cancelled already. sleep: not 0 for a request
        to sleep; anything else cancels a jog."""
        state = self._state
        if state.suspend & (st.MOTION_CANCEL | st.JOG_CANCEL):
            return
        state.holding = True
        self._segments.hold(True)
        if state.run == st.JOG and not sleep:  # _cycle_stop() drops the rest of the jog
            state.suspend |= st.JOG_CANCEL

    def _open_door(self) -> None:
        """Handle an open door. If the tool is being restored after an earlier opening, that stops
        and the tool is retracted again. A jog is cancelled first: then _cycle_stop() enters
        Door. Asleep, the machine stays asleep."""
        state = self._state
        self._voice.message(errors.MSG_DOOR_AJAR)
        if not state.suspend & st.JOG_CANCEL:
            if state.run == st.DOOR and state.suspend & st.INITIATE_RESTORE:
                if state.system_motion:  # parking
                    self._segments.hold(True)
                    state.holding = True
                    state.suspend &= ~st.HOLD_COMPLETE
                # Suspension ends its routine, and begins again with the retract.
                state.suspend &= ~(st.RETRACT_COMPLETE | st.INITIATE_RESTORE | st.RESTORE_COMPLETE)
                state.suspend |= st.RESTART_RETRACT
            if state.run != st.SLEEP:
                state.enter(st.DOOR)
        state.suspend |= st.DOOR_AJAR

    def _cycle_start(self) -> None:
        """Handle a cycle start: resume after a hold or a closed door, or start planned motion;
        ignored in other states and while motion still slows down. After a door the tool is
        restored first, which posts another cycle start."""
        state = self._state
        if state.run == st.DOOR and not state.suspend & st.DOOR_AJAR:
            if state.suspend & st.RESTORE_COMPLETE:
                state.enter(st.IDLE)
            elif state.suspend & st.RETRACT_COMPLETE:
                state.suspend |= st.INITIATE_RESTORE
        held = state.run == st.HOLD
        if state.run != st.IDLE and not (held and state.suspend & st.HOLD_COMPLETE):
            return
        # The spindle, stopped by its override, starts first; that posts another cycle start.
        if held and state.stop_override:
            state.stop_override |= st.STOP_RESTORE_CYCLE
            return
        state.holding = False
        self._segments.hold(False)
        has_motion = not self._planner.empty() and not state.suspend & st.MOTION_CANCEL
        state.suspend = 0
        state.suspension_has_begun = False
        state.enter(st.IDLE)
        touches = self._motor_control.touches  # set while probing; a contact: do not move on
        if has_motion and not (touches and touches()):
            self._motor_control.start(st.RUN)
        if state.update_spindle:
            self._overrides.override_spindle()

    def _cycle_stop(self) -> None:
        """Handle the end of motion: a hold is complete, a jog is cancelled, or the machine is
        idle. soft_limit: a hold before that alarm ends in Idle."""
        state = self._state
        cancelled = state.suspend & st.JOG_CANCEL
        if state.run & _HOLDS and not state.soft_limit and not cancelled:
            if state.holding:
                state.suspend |= st.HOLD_COMPLETE
            state.holding = False
            state.system_motion = False  # a parking move, too, ends here
            return
        if cancelled:
            self._planner.clear()
            self._resync()
            state.holding = False
            self._overrides.darken()  # the blocks dropped were to set its power
        # As in Grbl, `holding` stays after a contact: until motion starts, a reset is an alarm.
        if state.suspend & st.DOOR_AJAR:  # it was opened during a jog, which has ended now
            state.suspend = state.suspend & ~st.JOG_CANCEL | st.HOLD_COMPLETE
            state.enter(st.DOOR)
        else:
            state.suspend = 0
            state.suspension_has_begun = False
            state.enter(st.IDLE)
            if state.update_spindle:  # the override came after the last block was read
                self._overrides.override_spindle()


def _with_fields(report: "memoryview", fields: "tuple[Callable[[], str], ...]") -> "memoryview":
    """Return a status report with the fields of extras before its end; each returns its text, or
    "" for none."""
    texts = [field() for field in fields]
    added = b"".join([b"|" + text.encode() for text in texts if text])
    whole = bytes(report)
    return memoryview(whole[:_END] + added + whole[_END:]) if added else report
