"""The punch: a tool that makes a stroke after every motion, in the place of a spindle.

M3 or M4 arms it, M5 disarms it: words that every sender passes on. While it is
armed, each line of G0 to G3 ends with a stroke: when the machine has come to
rest the actuator goes down until the sensor below sees it, and up until the
sensor above does. Nothing else makes one: not a jog, G28, a probe or homing.

Whatever happens, nothing moves unless the sensor above sees the punch: motion
does not start (PunchDrive.start), motion under way is stopped, and a reset
in the middle of a stroke first brings the punch up. A sensor that does not
answer in time is an alarm.

A stroke is never held half way: a feed hold takes effect behind it. A safety
door turns it back, and it is made once the door is closed.
"""

from base import errors
from base import state as st
from base.settings import BOOL
from control import spindle as sp
from control.drive import Drive
from control.spindle import Spindle
from language import block as b
from language.interpreter import Interpreter
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from collections.abc import Callable
    from types import ModuleType
    from typing import Any

    from base.settings import Rows, Settings
    from base.state import State
    from interfaces import Port, PunchPort, StepEngine, Voice
    from talk.report import Report

# What a board file has to say besides TOOL = "punch".
_PINS = ("PUNCH_DOWN", "PUNCH_UP", "PUNCH_DOWN_SENSOR", "PUNCH_UP_SENSOR")

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
# A file of its own: $30=1000 of a spindle would turn an actuator round.
_FILE = "settings_punch"

_NOT_DOWN = "Punch not down"
_NOT_UP = "Punch not up"

# Port.punch_sensors()
_DOWN = const(1)
_UP = const(2)


class Punch(Spindle):
    """The actuators and their sensors. Armed is what a spindle calls turning."""

    def __init__(self, port: "Port", state: "State", enable_by_direction: bool) -> None:
        if not hasattr(port, "punch"):
            raise ValueError("TOOL = punch: this port has no pins for one")
        super().__init__(port, state, False)
        self._pins: "PunchPort" = port  # type: ignore[assignment]  # find() is where it is told
        self._armed = sp.OFF
        self._going_down = False
        self._lost = False
        self._sensor_invert = 0

    def connect(
        self,
        engine: "StepEngine",
        voice: "Voice",
        drive: "Drive",
        events: "Callable[[], None]",
    ) -> None:
        """Say whom to call, or to ask whether anything moves. events: realtime's."""
        self._engine = engine
        self._voice = voice
        self._machine = drive
        self._events = events
        self._pins.watch_punch(self.on_change)

    # What a spindle has

    def configure(self, settings: "Settings", machine: "array[int]") -> None:
        """Take over $30 to $33."""
        super().configure(settings, machine)
        inverts = [getattr(settings, row[1]) for row in _SETTINGS]
        self._down_invert, self._up_invert = inverts[:2]
        self._sensor_invert = inverts[2] * _DOWN | inverts[3] * _UP
        self._pins.punch_rest(self._down_invert, 1 ^ self._up_invert)
        self._drive(False)

    def power(self, rpm: float) -> int:
        """There is no speed."""
        return 0

    def block_power(self, flags: int, rpm: float) -> int:
        """Nor does a motion carry one."""
        return 0

    def turn(self, direction: int, rpm: float) -> None:
        """Arm or disarm. Disarmed, it is up, or the machine is in alarm: so after a reset, too."""
        self._armed = direction
        self._state.override_countdown = 0
        if direction == sp.OFF:
            self._drive(False)
            if not self._reach_up(self._machine.pump):
                self._fail(errors.ALARM_PUNCH_UP, _NOT_UP)
            elif self._lost:
                self._voice.message(_NOT_UP)
            self._lost = False

    def stop(self) -> None:
        """Up, at once; safe in an interrupt."""
        self._drive(False)

    def direction(self) -> int:
        """OFF, or how it was armed."""
        return self._armed

    # The actuators: one of the two is always on

    def _drive(self, down: bool) -> None:
        self._going_down = down
        self._pins.punch(down ^ self._down_invert, (not down) ^ self._up_invert)
        if down and not self._going_down:
            self._drive(False)  # an interrupt has brought it up meanwhile

    def _sees(self) -> int:
        return self._pins.punch_sensors() ^ self._sensor_invert

    def is_up(self) -> bool:
        """It is up, is to stay there, and both sensors say so."""
        return not self._going_down and self._sees() == _UP

    def _reach_up(self, turn: "Callable[[], None]") -> bool:
        since = self._pins.ticks_ms()
        while not self.is_up():
            if self._pins.elapsed_ms(since) >= self._pins.punch_timeout_ms:
                return False
            turn()
        return True

    # Strokes

    def stroke(self) -> bool:
        """Down and up, at rest. False where a door has turned it back: it is up again.

        Raises Abort where a sensor does not answer, or after a reset.
        """
        if not self._engine.idle():
            return False
        if not self.may_move():
            self._events()  # raises Abort
        try:
            self._drive(True)
            made = self._go_down()
        finally:
            self._drive(False)
        if made is None:
            self._fail(errors.ALARM_PUNCH_DOWN, _NOT_DOWN)
            self._machine.reset()
        elif not self._reach_up(self._turn):
            self._fail(errors.ALARM_PUNCH_UP, _NOT_UP)
            self._machine.reset()
        self._events()
        return bool(made)

    def _turn(self) -> None:
        self._machine.pump()
        self._events()

    def _go_down(self) -> "bool | None":
        """True when it is there, False where a door calls it back, None when time is over."""
        since = self._pins.ticks_ms()
        while self._sees() != _DOWN:
            if self._state.run & (st.DOOR | st.SLEEP):
                return False
            if self._pins.elapsed_ms(since) >= self._pins.punch_timeout_ms:
                return None
            self._turn()
        return True

    # Guards

    def may_move(self) -> bool:
        """Whether motion may start. If not, the machine is in alarm and a reset is under way."""
        if self.is_up():
            return True
        self._fail(errors.ALARM_PUNCH_UP, _NOT_UP)
        self._machine.reset()
        return False

    def _fail(self, code: int, words: str) -> None:
        self._state.enter(st.ALARM)
        self._voice.alarm(code)
        self._voice.message(words)

    def on_change(self) -> None:
        """A sensor may have changed. Interrupt."""
        if not self._engine.idle() and not self.is_up():
            self._lost = True
            if self._state.alarm == 0:
                self._state.alarm = errors.ALARM_PUNCH_UP
            self._machine.reset()


class PunchDrive(Drive):
    """The drive, which starts no motion unless the punch is up."""

    _spindle: Punch

    def start(self, run: int) -> None:
        """Set the machine in motion if nothing is in the way."""
        if self._spindle.may_move():
            super().start(run)
            self._spindle.on_change()  # it may have left in between


class PunchInterpreter(Interpreter):
    """The interpreter, which ends each line of motion with a stroke while the punch is armed."""

    _spindle: Punch

    def execute(self, line: bytearray, length: int) -> None:
        """As Interpreter does; there is no short path to a stroke."""
        super().execute(line, length)
        self._state.change()

    def _go(self, block: "b.Block", move: "Any") -> None:
        super()._go(block, move)
        if self._modes.modal.motion <= b.CCW_ARC:
            self._strike()

    def _strike(self) -> None:
        state = self._state
        if not self._modes.modal.spindle or state.run == st.CHECK:
            return
        self._canon.synchronise()
        while True:
            # A hold that began with the last segments is over later than the plan.
            self._canon.service()
            if state.run == st.ALARM or (state.run == st.IDLE and self._spindle.stroke()):
                return


def install(machine: "Any") -> None:
    """Connect the punch with the machine it is part of."""
    punch: "Any" = machine.spindle
    punch.connect(machine.engine, machine.report, machine.drive, machine.realtime.events)


def find(tool: str, board: "ModuleType", reports: "type[Report]") -> "Any":
    """What the controller makes a punch of. Raises ValueError where the board cannot have one."""
    if tool != "punch":
        raise ValueError("TOOL is spindle or punch, not " + tool)
    missing = [name for name in _PINS if getattr(board, name, None) is None]
    if missing:
        raise ValueError("TOOL = punch: the board file names no pin for " + ", ".join(missing))
    without, extra = reports.SETTINGS or ((), ())
    return Punch, PunchInterpreter, PunchDrive, (without + _WITHOUT, extra + _SETTINGS, _FILE)
