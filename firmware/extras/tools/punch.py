"""The punch: a tool that makes a stroke after every motion. It replaces the spindle.

M3 or M4 arms it and M5 disarms it, because every sender passes these words on. While it is armed,
each line of G0 to G3 ends with a stroke: when the machine has stopped, the actuator goes down
until the lower sensor detects it, and up until the upper sensor does. Nothing else causes a
stroke: no jog, G28, probe or homing.

Nothing moves unless the upper sensor detects the punch. Motion does not start (may_move), motion
in progress is stopped, and a reset during a stroke first raises the punch. A sensor that does not
answer in time causes an alarm.

A stroke is never held half way: a feed hold takes effect after it. A safety door reverses a
stroke, and it is repeated when the door is closed.
"""

from base import state as st
from base.settings import BOOL
from control import spindle as sp
from control.modes import SPINDLE
from control.spindle import Spindle
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable
    from types import ModuleType
    from typing import Any

    from base.settings import Rows, Settings
    from base.state import State
    from interfaces import Options, Port
    from talk.controller import Controller

    from extras.api import Cnc

# The board file names these for TOOL = "punch": two outputs, two inputs.
PINS = ("PUNCH_DOWN", "PUNCH_UP", "PUNCH_DOWN_SENSOR", "PUNCH_UP_SENSOR")

# The punch went down, and the sensor of $32 did not detect it there. Not one of Grbl's.
ALARM_PUNCH_DOWN = const(32)
# The punch is not up, or the sensor of $33 does not detect it: nothing may move. Not one of
# Grbl's.
ALARM_PUNCH_UP = const(33)

_SETTINGS: "Rows" = (
    # Punch actuator down invert. Off: 5 V moves it down.
    (30, "punch_down_invert", BOOL, 0, "boolean"),
    # Punch actuator up invert. Off: 5 V moves it up.
    (31, "punch_up_invert", BOOL, 0, "boolean"),
    # Punch sensor down invert. Off: 5 V means that it is down.
    (32, "punch_down_sensor_invert", BOOL, 0, "boolean"),
    # Punch sensor up invert. Off: 5 V means that it is up.
    (33, "punch_up_sensor_invert", BOOL, 0, "boolean"),
)
_SPINDLE_SETTINGS = (30, 31, 32)  # which a punch does not have
# Their descriptions in Grbl 0.9's $$.
_WORDS = {
    30: "punch actuator down invert, bool",
    31: "punch actuator up invert, bool",
    32: "punch sensor down invert, bool",
    33: "punch sensor up invert, bool",
}
_FILE = "settings_punch"  # its own, because a spindle's $30=1000 would invert an actuator

_NOT_DOWN = "Punch not down"
_NOT_UP = "Punch not up"

# Bits of actuators and sensors.
_DOWN = const(1)
_UP = const(2)

# How the way down has ended.
_IS_DOWN = const(0)
_DOOR_OPENED = const(1)
_TIMED_OUT = const(2)


class Punch(Spindle):
    """The actuators and their sensors. Armed corresponds to a turning spindle.

    pins: numbers, by PINS. timeout_ms: how long a sensor may take to answer. _armed: sp.OFF, CW or
    CCW. _going_down: the actuator down is on. _lost: the upper sensor has lost the punch during
    motion. _down_invert, _up_invert: of the actuators, 0 or 1; _sensor_invert: mask of _DOWN and
    _UP.
    """

    pins: "tuple[int, ...]" = ()
    timeout_ms = 0

    def __init__(self, port: "Port", state: "State", enable_by_direction: bool) -> None:
        super().__init__(port, state, enable_by_direction=False)  # whatever is requested
        self._armed = sp.OFF
        self._going_down = False
        self._lost = False
        self._sensor_invert = 0
        port.add_pins(self.pins[:2], self.pins[2:])  # two outputs, two inputs

    def connect(self, machine: "Controller") -> None:
        """Connect the machine, and watch the sensors from now on."""
        self._machine = machine
        self._port.watch_pins(self.on_change)

    # As a spindle

    def configure(self, settings: "Settings", table: "array[int]") -> None:
        """Apply $30 to $33, which invert actuators and sensors in the order of _SETTINGS, and
        raise the punch. table: the planner's."""
        super().configure(settings, table)
        for i in range(sp.HIGHEST, st.SPINDLE_LENGTH):  # there is neither speed nor power
            self._state.spindle[i] = 0.0
        inverts = [getattr(settings, attribute) for _, attribute, _, _, _ in _SETTINGS]
        self._down_invert, self._up_invert = inverts[:2]
        self._sensor_invert = inverts[2] * _DOWN | inverts[3] * _UP
        # Levels of the outputs after a reset: down (bit 0) is off, and up (bit 1) is on.
        self._port.rest(self._down_invert | (1 ^ self._up_invert) << 1)
        self._drive_down(False)

    def set_speed(self, direction: int, rpm: float) -> None:
        """Arm with CW or CCW; disarm with OFF, and raise the punch: if it is not up in time, the
        machine is in alarm. A reset disarms, too. rpm is ignored."""
        self._armed = direction
        self._state.override_countdown = 0  # the next report has the accessories, as A:S
        if direction == sp.OFF:
            self._drive_down(False)
            if not self._reach_up(self._machine.motor_control.pump):
                self._fail(ALARM_PUNCH_UP, _NOT_UP)
            elif self._lost:  # on_change() could not send a message
                self._machine.report.message(_NOT_UP)
            self._lost = False

    def stop(self) -> None:
        """Raise the punch at once. Safe in an interrupt."""
        self._drive_down(False)

    def direction(self) -> int:
        """Return OFF, or the direction with which it was armed."""
        return self._armed

    # The actuators: one of the two is always on.

    def _drive_down(self, down: bool) -> None:
        """Switch one actuator on and the other off: the punch goes down if `down`, else up. Safe
        in an interrupt."""
        self._going_down = down
        output_down = down ^ self._down_invert  # levels of the pins, 0 or 1
        output_up = (not down) ^ self._up_invert
        self._port.drive(output_down | output_up << 1)
        if down and not self._going_down:
            self._drive_down(False)  # an interrupt has raised it meanwhile

    def _sensors(self) -> int:
        """Return which sensors detect the punch, a mask of _DOWN and _UP."""
        return self._port.sense() ^ self._sensor_invert

    def is_up(self) -> bool:
        """Return whether only the upper sensor detects the punch, and it is not about to go
        down."""
        return not self._going_down and self._sensors() == _UP

    def _reach_up(self, service: "Callable[[], None]") -> bool:
        """Wait until the punch is up. Return False after the timeout. service: called while it
        waits."""
        since = self._port.ticks_ms()
        while not self.is_up():
            if self._port.elapsed_ms(since) >= self.timeout_ms:
                return False
            service()
        return True

    # Strokes

    def stroke(self) -> bool:
        """Go down and up. Return False if it has to be repeated: a door has reversed it, or the
        engine was not idle, so it did not begin.

        Raises Abort if a sensor does not answer, or after a reset.
        """
        if not self._machine.engine.idle():
            return False
        if not self.may_move():
            self._machine.realtime.handle_events()  # raises Abort
        try:
            self._drive_down(True)
            outcome = self._wait_for_down()
        finally:
            self._drive_down(False)
        if outcome == _TIMED_OUT:
            self._fail(ALARM_PUNCH_DOWN, _NOT_DOWN)
            self._machine.motor_control.reset()
        elif not self._reach_up(self._service):
            self._fail(ALARM_PUNCH_UP, _NOT_UP)
            self._machine.motor_control.reset()
        self._machine.realtime.handle_events()  # raises Abort after the resets above
        return outcome == _IS_DOWN

    def _service(self) -> None:
        """Run what must go on while a stroke waits. Raises Abort after a reset."""
        self._machine.motor_control.pump()
        self._machine.realtime.handle_events()

    def _wait_for_down(self) -> int:
        """Wait until the lower sensor detects the punch. Return _IS_DOWN, _DOOR_OPENED (it must
        go up again) or _TIMED_OUT."""
        since = self._port.ticks_ms()
        while self._sensors() != _DOWN:
            if self._state.run & (st.DOOR | st.SLEEP):
                return _DOOR_OPENED
            if self._port.elapsed_ms(since) >= self.timeout_ms:
                return _TIMED_OUT
            self._service()
        return _IS_DOWN

    # Guards

    def may_move(self) -> bool:
        """Return whether the punch is up, so that motion may start. If not, set the alarm and
        request a reset."""
        if self.is_up():
            return True
        self._fail(ALARM_PUNCH_UP, _NOT_UP)
        self._machine.motor_control.reset()
        return False

    def _fail(self, code: int, words: str) -> None:
        """Enter alarm `code`, and report it with a message."""
        self._state.enter(st.ALARM)
        self._state.hooks.alarm(code)
        self._machine.report.message(words)

    def on_change(self) -> None:
        """Stop motion if a sensor has lost the punch. Interrupt."""
        if not self._machine.engine.idle() and not self.is_up():
            self._lost = True
            if self._state.alarm == 0:
                self._state.alarm = ALARM_PUNCH_UP
            self._machine.motor_control.reset()

    # As an extra

    def strike(self) -> None:
        """Make a stroke after a planned line of motion, if the punch is armed."""
        state, machine = self._state, self._machine
        if not machine.modes.modal[SPINDLE] or state.run == st.CHECK:  # M5, not armed
            return
        machine.canon.synchronise()  # waits for the end of motion
        while state.run != st.ALARM and not self.stroke():
            machine.canon.service()  # a door or a hold may have come in between: try again


def prepare(options: "Options", board: "ModuleType") -> None:
    """Check the board file before the machine is created. ValueError if it lacks a pin, or has
    pins for custom.py, because a port has the pins of one extra only."""
    option = board.__dict__.get
    pins = [option(name) for name in PINS]
    missing = [PINS[i] for i in range(len(pins)) if pins[i] is None]
    if missing:
        raise ValueError("TOOL = punch: the board file names no pin for " + ", ".join(missing))
    others = [name for name in ("OUTPUTS", "INPUTS") if option(name)]
    if others:
        raise ValueError(" and ".join(others) + ": not possible with TOOL = punch")
    Punch.pins = tuple([pin for pin in pins if pin is not None])
    Punch.timeout_ms = option("PUNCH_TIMEOUT_MS", 1000)
    options.spindle = Punch


def install(cnc: "Cnc") -> None:
    """Add the settings, a check before each start, and a stroke after each line of motion."""
    punch: "Any" = cnc.machine.spindle
    cnc.add_settings(_SETTINGS, _SPINDLE_SETTINGS, _FILE, _WORDS)
    cnc.add_alarms({ALARM_PUNCH_DOWN: _NOT_DOWN, ALARM_PUNCH_UP: _NOT_UP})
    cnc.before_motion(punch.may_move)
    cnc.after_start(punch.on_change)  # it may have left the sensor since may_move()
    cnc.after_line(punch.strike)
    punch.connect(cnc.machine)
