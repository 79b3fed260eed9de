"""State: what the machine is doing, in one record that all other modules read.

enter() changes the run state and checks that the new one may follow the old one. The numbers are
Grbl's, so that a set of states is a mask.
"""

from array import array

from micropython import const

from base.float32 import f32
from base.hooks import Hooks

# Run states.
IDLE = const(0)
ALARM = const(0x01)
CHECK = const(0x02)
HOMING = const(0x04)
RUN = const(0x08)
HOLD = const(0x10)
JOG = const(0x20)
DOOR = const(0x40)
SLEEP = const(0x80)
# States in which motion has not ended.
UNDER_WAY = const(RUN | HOLD | JOG | DOOR | SLEEP)

# Per state, the states that it may follow (mask). Idle is 0, so it has a bit of its own here.
# Alarm ends with $X, with homing, or in the state that a reset determines. Sleep ends with a reset
# only, and in Alarm.
_IDLE_BIT = const(0x100)  # Idle, in these masks
_FOLLOWS = {
    IDLE: _IDLE_BIT | ALARM | CHECK | HOMING | RUN | HOLD | JOG | DOOR,
    ALARM: _IDLE_BIT | ALARM | CHECK | HOMING | RUN | HOLD | JOG | DOOR | SLEEP,
    CHECK: _IDLE_BIT,
    HOMING: _IDLE_BIT | ALARM | HOMING,
    RUN: _IDLE_BIT | RUN,
    HOLD: _IDLE_BIT | HOMING | RUN | HOLD,
    JOG: _IDLE_BIT | JOG,
    DOOR: _IDLE_BIT | HOMING | RUN | HOLD | JOG | DOOR,
    SLEEP: _IDLE_BIT | ALARM | HOMING | RUN | HOLD | JOG | DOOR | SLEEP,
}

# Why motion is suspended, and how far that has progressed (mask); 0: it is not suspended.
HOLD_COMPLETE = const(0x01)
RESTART_RETRACT = const(0x02)
RETRACT_COMPLETE = const(0x04)
INITIATE_RESTORE = const(0x08)
RESTORE_COMPLETE = const(0x10)
DOOR_AJAR = const(0x20)
MOTION_CANCEL = const(0x40)
JOG_CANCEL = const(0x80)

# Spindle stop override: its progress through a hold (mask).
STOP_ENABLED = const(0x01)
STOP_INITIATE = const(0x02)
STOP_RESTORE = const(0x04)
STOP_RESTORE_CYCLE = const(0x08)

# Events that wait for realtime.run(): indices into `pending`. One byte each, so that an interrupt
# can set one without losing another.
STATUS_REPORT = const(0)
CYCLE_START = const(1)
CYCLE_STOP = const(2)
FEED_HOLD = const(3)
RESET = const(4)
SAFETY_DOOR = const(5)
CANCEL_MOTION = const(6)
SLEEP_REQUEST = const(7)
OVERRIDE = const(8)  # at least one of the following:
# Real-time bytes 0x90 to 0xA1, in their order.
OVERRIDES = const(9)
ANY = const(27)  # an event was posted that realtime.py has not handled

# Places in State.spindle, from which control/spindle.py computes power: the speed after override
# and limits; the override as a fraction, 1 for 100 %.
RPM = const(1)  # place in State.spindle of the speed after override and limits
OVERRIDE_PART = const(2)
SPINDLE_LENGTH = const(10)  # of that array

FIRST_OVERRIDE_BYTE = const(0x90)
LAST_OVERRIDE_BYTE = const(0xA1)
# The other real-time bytes and their events; soft reset, 0x18, is handled apart.
EVENTS = {
    0x3F: STATUS_REPORT,  # ?
    0x7E: CYCLE_START,  # ~
    0x21: FEED_HOLD,  # !
    0x40: SAFETY_DOOR,  # @, which only Grbl 0.9 removes from a line
    0x84: SAFETY_DOOR,
    0x85: CANCEL_MOTION,  # jog cancel: only while jogging
}


class State:
    """The record. A soft reset calls clear(); the run state survives it."""

    def __init__(self) -> None:
        self.pending = bytearray(ANY + 1)  # by event: posted, or how often; ANY is the last
        self.alarm = 0  # an alarm not yet reported
        self.run = IDLE  # only enter() writes it
        self.running = array("i", (IDLE,))  # the same, for kernels
        # Incremented at every change that affects the chords of an arc.
        self.changes = array("i", (0,))
        self.spindle = array("f", (0.0 for _ in range(SPINDLE_LENGTH)))  # see RPM
        self.hooks = Hooks()
        self.clear()

    def enter(self, run: int) -> None:
        """Change the run state to `run`. Raises RuntimeError, an internal fault, if that may not
        follow the present one."""
        # _FOLLOWS has per state a mask of the states that it may follow.
        if not _FOLLOWS[run] & (self.run or _IDLE_BIT):
            raise RuntimeError("firmware bug: state %d cannot follow state %d" % (run, self.run))
        if (self.run | run) & CHECK:  # check mode begins or ends: it changes what lines do
            self.invalidate_lines()
        self.run = self.running[0] = run

    def invalidate_lines(self) -> None:
        """Invalidate what lines derive from settings, overrides and modes: a counter is changed,
        which an arc compares between its chords."""
        self.changes[0] = (self.changes[0] + 1) & 0xFFFF

    def post(self, event: int) -> None:
        """Request an event, an index of `pending`, at the next realtime.run(). Safe in an
        interrupt."""
        self.pending[event] = 1
        self.pending[ANY] = 1

    def count(self, event: int) -> None:
        """Request an event one more time than before, up to 255 times: for overrides, each byte of
        which changes a value by a step."""
        self.pending[event] = min(self.pending[event] + 1, 255)

    def take_event(self, event: int) -> int:
        """Return how often the event was requested (1 if posted), and clear it."""
        times = self.pending[event]
        if times:
            self.pending[event] = 0
        return times

    def override_spindle(self, percent: int) -> None:
        """Set the spindle override, in percent of the programmed speed."""
        self.spindle_override = percent
        self.spindle[OVERRIDE_PART] = f32(f32(0.01) * percent)

    def clear(self) -> None:
        """Reset everything except the run state and the pending events and alarm."""
        self.invalidate_lines()
        self.suspend = 0  # mask of HOLD_COMPLETE to JOG_CANCEL
        self.suspension_has_begun = False  # Suspension.start() was called for it
        self.soft_limit = False  # the alarm of a soft limit follows, once motion has stopped
        self.holding = False  # motion is slowing down, or has stopped, for a hold
        self.system_motion = False  # a parking move is being executed
        self.update_spindle = False  # power must be set again: see Overrides.override_spindle()
        self.stop_override = 0  # mask of STOP_…
        self.feed_override = 100
        self.rapid_override = 100
        self.override_spindle(100)
        self.override_control = True  # M56: parking is enabled
        self.spindle[RPM] = 0.0
        self.probe_succeeded = False
        self.wco_countdown = 0  # status reports until WCO: is shown again
        self.override_countdown = 0  # and Ov:
