"""The punch: a tool that makes a stroke after every motion, in the place of a spindle.

M3 or M4 arms it, M5 disarms it: words that every sender passes on. While it is
armed, each line of G0 to G3 ends with a stroke: when the machine has come to
rest the actuator goes down until the sensor below sees it, and up until the
sensor above does. Nothing else makes one: not a jog, G28, a probe or homing.

Whatever happens, nothing moves unless the sensor above sees the punch: motion
does not start (may_move), motion under way is stopped, and a reset
in the middle of a stroke first brings the punch up. A sensor that does not
answer in time is an alarm.

A stroke is never held half way: a feed hold takes effect behind it. A safety
door turns it back, and it is made once the door is closed.
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

# What a board file has to name besides TOOL = "punch": two outputs, two inputs.
PINS = ("PUNCH_DOWN", "PUNCH_UP", "PUNCH_DOWN_SENSOR", "PUNCH_UP_SENSOR")

# The punch went down and the sensor of $32 did not see it come there. Not one of Grbl's.
ALARM_PUNCH_DOWN = const(32)
# The punch is not up, or the sensor of $33 does not see it: nothing may move. Not one of Grbl's.
ALARM_PUNCH_UP = const(33)

_SETTINGS: "Rows" = (
    # Punch actuator down invert. Off: 5 V move it down.
    (30, "punch_down_invert", BOOL, 0, "boolean"),
    # Punch actuator up invert. Off: 5 V move it up.
    (31, "punch_up_invert", BOOL, 0, "boolean"),
    # Punch sensor down invert. Off: 5 V say that it is down.
    (32, "punch_down_sensor_invert", BOOL, 0, "boolean"),
    # Punch sensor up invert. Off: 5 V say that it is up.
    (33, "punch_up_sensor_invert", BOOL, 0, "boolean"),
)
# Settings of a spindle, which are not there.
_WITHOUT = (30, 31, 32)
# What Grbl 0.9 says of them.
_WORDS = {
    30: "punch actuator down invert, bool",
    31: "punch actuator up invert, bool",
    32: "punch sensor down invert, bool",
    33: "punch sensor up invert, bool",
}
# A file of its own: $30=1000 of a spindle would turn an actuator round.
_FILE = "settings_punch"

_NOT_DOWN = "Punch not down"
_NOT_UP = "Punch not up"

# Bits of what drives it, and of what sees it.
_DOWN = const(1)
_UP = const(2)


class Punch(Spindle):
    """The actuators and their sensors. Armed is what a spindle calls turning."""

    pins: "tuple[int, ...]" = ()
    timeout_ms = 0

    def __init__(self, port: "Port", state: "State", enable_by_direction: bool) -> None:
        super().__init__(port, state, False)
        self._armed = sp.OFF
        self._going_down = False
        self._lost = False
        self._sensor_invert = 0
        port.add_pins(self.pins[:2], self.pins[2:])

    def connect(self, machine: "Controller") -> None:
        """Say what it is part of, and hear of the sensors from now on."""
        self._machine = machine
        self._port.watch_pins(self.on_change)

    # What a spindle has

    def configure(self, settings: "Settings", table: "array[int]") -> None:
        """Take over $30 to $33."""
        super().configure(settings, table)
        for i in range(sp.HIGHEST, st.SPINDLE_LENGTH):  # there is no speed, and no power of any
            self._state.spindle[i] = 0.0
        inverts = [getattr(settings, row[1]) for row in _SETTINGS]
        self._down_invert, self._up_invert = inverts[:2]
        self._sensor_invert = inverts[2] * _DOWN | inverts[3] * _UP
        self._port.rest(self._down_invert | (1 ^ self._up_invert) << 1)
        self._motor_control(False)

    def set_speed(self, direction: int, rpm: float) -> None:
        """Arm or disarm. Disarmed, it is up, or the machine is in alarm: so after a reset, too."""
        self._armed = direction
        self._state.override_countdown = 0
        if direction == sp.OFF:
            self._motor_control(False)
            if not self._reach_up(self._machine.motor_control.pump):
                self._fail(ALARM_PUNCH_UP, _NOT_UP)
            elif self._lost:
                self._machine.report.message(_NOT_UP)
            self._lost = False

    def stop(self) -> None:
        """Up, at once; safe in an interrupt."""
        self._motor_control(False)

    def direction(self) -> int:
        """OFF, or how it was armed."""
        return self._armed

    # The actuators: one of the two is always on

    def _motor_control(self, down: bool) -> None:
        self._going_down = down
        self._port.drive(down ^ self._down_invert | ((not down) ^ self._up_invert) << 1)
        if down and not self._going_down:
            self._motor_control(False)  # an interrupt has brought it up meanwhile

    def _sees(self) -> int:
        return self._port.sense() ^ self._sensor_invert

    def is_up(self) -> bool:
        """It is up, is to stay there, and both sensors say so."""
        return not self._going_down and self._sees() == _UP

    def _reach_up(self, turn: "Callable[[], None]") -> bool:
        since = self._port.ticks_ms()
        while not self.is_up():
            if self._port.elapsed_ms(since) >= self.timeout_ms:
                return False
            turn()
        return True

    # Strokes

    def stroke(self) -> bool:
        """Down and up, at rest. False where a door has turned it back: it is up again.

        Raises Abort where a sensor does not answer, or after a reset.
        """
        if not self._machine.engine.idle():
            return False
        if not self.may_move():
            self._machine.realtime.handle_events()  # raises Abort
        try:
            self._motor_control(True)
            made = self._go_down()
        finally:
            self._motor_control(False)
        if made is None:
            self._fail(ALARM_PUNCH_DOWN, _NOT_DOWN)
            self._machine.motor_control.reset()
        elif not self._reach_up(self._turn):
            self._fail(ALARM_PUNCH_UP, _NOT_UP)
            self._machine.motor_control.reset()
        self._machine.realtime.handle_events()
        return bool(made)

    def _turn(self) -> None:
        self._machine.motor_control.pump()
        self._machine.realtime.handle_events()

    def _go_down(self) -> "bool | None":
        """True when it is there, False where a door calls it back, None when time is over."""
        since = self._port.ticks_ms()
        while self._sees() != _DOWN:
            if self._state.run & (st.DOOR | st.SLEEP):
                return False
            if self._port.elapsed_ms(since) >= self.timeout_ms:
                return None
            self._turn()
        return True

    # Guards

    def may_move(self) -> bool:
        """Whether motion may start. If not, the machine is in alarm and a reset is under way."""
        if self.is_up():
            return True
        self._fail(ALARM_PUNCH_UP, _NOT_UP)
        self._machine.motor_control.reset()
        return False

    def _fail(self, code: int, words: str) -> None:
        self._state.enter(st.ALARM)
        self._state.hooks.alarm(code)
        self._machine.report.message(words)

    def on_change(self) -> None:
        """A sensor may have changed. Interrupt."""
        if not self._machine.engine.idle() and not self.is_up():
            self._lost = True
            if self._state.alarm == 0:
                self._state.alarm = ALARM_PUNCH_UP
            self._machine.motor_control.reset()

    # As an extra

    def strike(self) -> None:
        """A line of motion has been planned: a stroke behind it, if the punch is armed."""
        state, machine = self._state, self._machine
        if not machine.modes.modal[SPINDLE] or state.run == st.CHECK:
            return
        machine.canon.synchronise()
        while state.run != st.ALARM and not self.stroke():
            machine.canon.service()


def prepare(options: "Options", board: "ModuleType") -> None:
    """Before the machine is made. Raises ValueError where the board file lacks a pin."""
    option = board.__dict__.get
    pins = [option(name) for name in PINS]
    missing = [PINS[i] for i in range(len(pins)) if pins[i] is None]
    if missing:
        raise ValueError("TOOL = punch: the board file names no pin for " + ", ".join(missing))
    Punch.pins = tuple([pin for pin in pins if pin is not None])
    Punch.timeout_ms = option("PUNCH_TIMEOUT_MS", 1000)
    options.spindle = Punch


def install(cnc: "Cnc") -> None:
    """Its settings, its guard over every start, and a stroke behind each line of motion."""
    punch: "Any" = cnc.machine.spindle
    cnc.add_settings(_SETTINGS, _WITHOUT, _FILE, _WORDS)
    cnc.add_alarms({ALARM_PUNCH_DOWN: _NOT_DOWN, ALARM_PUNCH_UP: _NOT_UP})
    cnc.before_motion(punch.may_move)
    cnc.after_start(punch.on_change)  # it may have left in between
    cnc.after_line(punch.strike)
    punch.connect(cnc.machine)
