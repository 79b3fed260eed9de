"""The $ commands: one method each, found by a table."""

import sys

from base import errors
from base import state as st
from base.errors import GrblError
from base.float32 import truncate
from base.hooks import call_all
from base.text import text_of
from control.modes import (
    COOLANT,
    FEED,
    INCHES,
    INVERSE_TIME,
    MOTION,
    PLANE,
    RELATIVE,
    RPM,
    SPINDLE,
    SYSTEM,
)
from language.block_layout import PROBE_TOWARD
from language.words import bare
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import Machine

_STARTUP = "startup"
_BUILD_INFO = "build"
STARTUP_LINES = const(2)
_HIGHEST_SETTING = const(999)  # Grbl's end at 255; extras have higher ones
_MOVES = const(st.RUN | st.JOG)  # states of motion
_JOG = const(74)  # the character J
_EQUALS = const(61)  # the character =
_PLUS = const(43)  # the character +
_HASH = const(35)  # the character #
_DOLLAR = const(36)  # the character $
_STAR = const(42)  # the character *
_COOLANT = (" M9", " M8", " M7", " M7 M8")  # words of $G, by mask of coolant.FLOOD and MIST
_AT_ANY_TIME = b"\0$GCX"  # letters of commands that any state allows; \0 is the help of a lone $
READ_ONLY = b"G$#IN"  # such a command, with nothing after it, changes nothing


class Commands:
    """Execute lines that begin with $.

    options: the letters and numbers of [OPT:...]. single_axis_homing: $HX is allowed;
    override_control: $G shows M56. A command's method is passed the line, which a 0 ends, and its
    length without that; it raises GrblError to answer with an error. An "ok" is sent by the
    caller. _answer: executes a line of G-code and answers it; in_startup: startup lines are being
    executed; health: returns a text on the chip, if the chip can measure it; fault: text of the
    last one, "" for none.
    """

    def __init__(
        self, machine: "Machine", options: str, single_axis_homing: bool, override_control: bool
    ) -> None:
        self._state = machine.state
        self._settings = machine.settings
        self._coords = machine.coords
        self._store = machine.saves
        self._report = machine.report
        self._modes = machine.modes
        self._interpreter = machine.interpreter
        self._canon = machine.canon
        self._motor_control = machine.motor_control
        self._inputs = machine.inputs
        self._options = options
        self._single_axis_homing = single_axis_homing
        self._override_control = override_control
        self._startup = [""] * STARTUP_LINES
        self._letters = self._make_letters()
        self.in_startup = False
        self.health: "Callable[[], str] | None" = None
        self.fault = ""

    def connect(self, answer: "Callable[[bytearray, int, bytes], None]") -> None:
        """Set the function that executes a line of G-code and prints its answer. It is passed the
        line, its length, and the text in front of the answer."""
        self._answer = answer

    # Startup lines

    def load(self) -> None:
        """Load the startup lines. If the stored ones are invalid, empty lines replace them in the
        store, and the next run_startup() reports each of them with error 7 (_startup_valid)."""
        self._store.load(_BUILD_INFO)  # so that damage to it is reported at power-up, too
        lines = self._store.load(_STARTUP)
        self._startup = ((lines or []) + [""] * STARTUP_LINES)[:STARTUP_LINES]
        self._startup_valid = lines is not None  # None: the stored ones are invalid
        if lines is None:
            self._keep_startup()

    def _keep_startup(self) -> None:
        """Store the startup lines."""
        self._store.save(_STARTUP, self._startup)

    def run_startup(self) -> None:
        """Execute the startup lines that are not empty, and print an answer to each. If load() has
        found them invalid, the first call reports each as lost instead."""
        self.in_startup = True
        try:
            for text in self._startup:
                if not self._startup_valid:
                    self._report.startup_lost()
                elif text:
                    line = bytearray(text.encode() + b"\0")
                    self._answer(line, len(line) - 1, self._report.startup_run(text))
        finally:
            self.in_startup = False
        self._startup_valid = True

    # Dispatch

    def _make_letters(self) -> "dict[int, Callable[[bytearray, int], None]]":
        """Return the commands by the character after $; 0 ends a line that is only a $. Each is
        passed the line and its length."""
        return {
            0: self._help,
            36: self._show_settings,  # $$
            71: self._show_modes,  # $G
            67: self._check_mode,  # $C
            88: self._unlock,  # $X
            _JOG: self._jog,
            35: self._show_offsets,  # $#
            72: self._home,  # $H
            83: self._sleep,  # $SLP
            73: self._build_info,  # $I
            82: self._restore,  # $RST=
            78: self._startup_lines,  # $N
        }

    def find_command(self, line: bytearray, length: int) -> "Callable[[bytearray, int], None]":
        """Return the function that executes a line beginning with $; its arguments are line and
        length. Raises GrblError if the state does not allow the command. The main loop calls the
        function, because the stack is short."""
        execute = self._letters.get(line[1])
        if execute and line[1] == _JOG:
            return execute  # it checks the state itself, and time is short
        if execute and line[1] in _AT_ANY_TIME:
            if length > 2:
                raise GrblError(errors.INVALID_STATEMENT)
        elif self._state.run not in (st.IDLE, st.ALARM):
            # A sender that connects during motion sends lines of READ_ONLY. In Grbl, connecting
            # resets the machine.
            if not (self._state.run & _MOVES and length == 2 and line[1] in READ_ONLY):
                raise GrblError(errors.IDLE_ERROR)
        return execute or self._set  # anything else is the number of a setting

    def remove_commands(self, letters: bytes) -> None:
        """Remove the commands with these letters."""
        for letter in letters:
            self._letters.pop(letter, None)

    def _jog(self, line: bytearray, length: int) -> None:
        """Execute $J=…, only while idle or jogging."""
        if self._state.run not in (st.IDLE, st.JOG):
            raise GrblError(errors.IDLE_ERROR)
        if line[2] != _EQUALS:
            raise GrblError(errors.INVALID_STATEMENT)
        self._interpreter.jog(line, length)

    # Commands that are answered at any time

    def _help(self, _line: bytearray, _length: int) -> None:
        """Execute $."""
        self._report.help()

    def _show_settings(self, _line: bytearray, _length: int) -> None:
        """Execute $$."""
        self.show_settings()

    def show_settings(self) -> None:
        """Print every setting."""
        for number, value, decimals in self._settings.each():
            self._report.setting(number, value, decimals)

    def _show_modes(self, _line: bytearray, _length: int) -> None:
        """Execute $G."""
        self._report.modes(self.modes())

    def modes(self) -> str:
        """Return the modal state as text, as $G prints it."""
        modes, modal, report = self._modes, self._modes.modal, self._report
        motion = modal[MOTION]  # the number of G, or 138 + 10 n for a probe, G38.n
        text = "G%d" % motion if motion < PROBE_TOWARD else "G38.%d" % ((motion - 138) // 10)
        text += " G%d G%d G%d G%d G%d M%d" % (
            54 + modal[SYSTEM],
            17 + modal[PLANE],
            20 if modal[INCHES] else 21,
            91 if modal[RELATIVE] else 90,
            93 if modal[INVERSE_TIME] else 94,
            (5, 3, 4)[modal[SPINDLE] >> 4],  # SPINDLE is 0, 0x10 or 0x20
        )
        text += _COOLANT[modal[COOLANT]]
        if self._override_control and self._state.override_control:
            text += " M56"
        rate, speed = report.rate(modes.rates[FEED]), report.speed(modes.rates[RPM])
        return text + " T%d F%s S%s" % (modes.tool, rate, speed)

    def _check_mode(self, _line: bytearray, _length: int) -> None:
        """Execute $C: begin check mode, or end it by a reset, as Grbl does."""
        state = self._state
        if state.run == st.CHECK:
            self._motor_control.reset()
            self._report.message(errors.MSG_DISABLED)
        else:
            if state.run != st.IDLE:
                raise GrblError(errors.IDLE_ERROR)
            self._canon.synchronise()  # check mode moves nothing: finish the planned motion first
            state.enter(st.CHECK)
            self._report.message(errors.MSG_ENABLED)

    def _unlock(self, _line: bytearray, _length: int) -> None:
        """Execute $X: end an alarm, unless the emergency stop is pressed or the door is open
        (GrblError). Without an alarm it does nothing."""
        if self._state.run == st.ALARM:
            self._check_stop()
            if self._inputs.door_open():
                raise GrblError(errors.CHECK_DOOR)
            self._report.message(errors.MSG_ALARM_UNLOCK)
            self._state.enter(st.IDLE)

    def _check_stop(self) -> None:
        """Raise GrblError while the emergency stop is pressed."""
        if self._inputs.estop():
            self._report.message(errors.MSG_EMERGENCY_STOP)
            raise GrblError(errors.SYSTEM_GC_LOCK)

    # Commands that need an idle machine

    def _show_offsets(self, line: bytearray, length: int) -> None:
        """Execute $#: print all offsets and the last probe position."""
        if length != 2:
            raise GrblError(errors.INVALID_STATEMENT)
        self._report.offsets(self._state.hooks.probed_at())

    def _home(self, line: bytearray, length: int) -> None:
        """Execute $H, or $HX with single-axis homing; after $H the startup lines run, as in Grbl.
        Raises GrblError before anything moves."""
        if not self._settings.homing:
            raise GrblError(errors.SETTING_DISABLED)
        self._canon.synchronise()  # homing drops planned blocks
        self._check_stop()
        if self._inputs.door_open():
            raise GrblError(errors.CHECK_DOOR)
        axes = 0  # mask of the axes to home; 0: all
        if length > 2:
            axis = b"XYZABC".find(line[2:3], 0, len(self._modes.position))  # that this machine has
            if axis < 0 or length > 3 or not self._single_axis_homing:
                raise GrblError(errors.INVALID_STATEMENT)
            axes = 1 << axis
        self._state.enter(st.HOMING)
        homed = self._state.hooks.home(axes)
        self._state.enter(st.IDLE)
        if not homed:  # it did not begin: a reset and an alarm are pending
            return
        # As in Grbl, the delay of $1 passes before the startup lines and the answer.
        self._canon.wait_motors_released()
        if axes == 0:
            self.run_startup()

    def _sleep(self, line: bytearray, length: int) -> None:
        """Execute $SLP: request sleep, which a reset ends."""
        if bytes(line[2:length]) != b"LP":
            raise GrblError(errors.INVALID_STATEMENT)
        self._state.post(st.SLEEP_REQUEST)

    def _build_info(self, line: bytearray, length: int) -> None:
        """Execute $I, which prints version and options, $I+, which prints more, or $I=…, which
        stores a text for them."""
        is_long = length == 3 and line[2] == _PLUS
        if length == 2 or is_long:
            stored = self._store.load(_BUILD_INFO)
            self._report.build_info(stored[0] if stored else "", self._options)
            call_all(self._state.hooks.build_info)
            if is_long:
                message = self._report.message
                # Only a firmware that is frozen into the board's image imports this module.
                where = ", frozen" if "base.frozen" in sys.modules else ""
                message("Build: " + errors.BUILD_ID + where)
                if self.health:
                    message(self.health())
                if self.fault:
                    message("Last fault: " + self.fault)
        elif line[2] != _EQUALS:
            raise GrblError(errors.INVALID_STATEMENT)
        else:
            self._canon.synchronise()
            self._store.save(_BUILD_INFO, [text_of(line[3:length])])

    def _restore(self, line: bytearray, length: int) -> None:
        """Execute $RST=$, # or *: restore settings, offsets, or everything stored; then reset."""
        which = line[5] if length == 6 else 0  # 0 is none of the three
        if bytes(line[2:5]) != b"ST=" or which not in b"$#*":
            raise GrblError(errors.INVALID_STATEMENT)
        if which != _HASH:
            self._settings.restore()
        if which != _DOLLAR:
            self._coords.restore()
        if which == _STAR:
            self.forget()
        self._report.message(errors.MSG_RESTORE_DEFAULTS)
        self._motor_control.reset()

    def forget(self) -> None:
        """Clear startup lines and build info."""
        self._startup = [""] * STARTUP_LINES
        self._keep_startup()
        self._store.save(_BUILD_INFO, [""])

    def _startup_lines(self, line: bytearray, length: int) -> None:
        """Execute $N, which prints the startup lines, or $N0=… and $N1=…, which execute a line
        and, if it is not refused, store it. Other numbers only execute it."""
        if length == 2:
            for i in range(STARTUP_LINES):
                self._report.startup_line(i, self._startup[i])
            return
        if self._state.run != st.IDLE:
            raise GrblError(errors.IDLE_ERROR)
        end, number = bare(line, 2)  # index of the character after the number; -1 without one
        if end < 0:
            raise GrblError(errors.BAD_NUMBER_FORMAT)
        if line[end] != _EQUALS:
            raise GrblError(errors.INVALID_STATEMENT)
        startup = line[end + 1 : length + 1]  # with the 0 that ends it
        self._state.hooks.execute(startup, length - end - 1)
        self._canon.synchronise()  # flash is written while idle
        index = truncate(number)
        if 0 <= index < STARTUP_LINES:
            self._startup[index] = text_of(startup[: length - end - 1])
            self._keep_startup()

    def _set(self, line: bytearray, _length: int) -> None:
        """Execute $number=value, after all planned motion. The number is rounded down to an
        integer; settings refuses unknown numbers and invalid values with GrblError."""
        end, number = bare(line, 1)  # index of the character after the number; -1 without one
        if end < 0:
            raise GrblError(errors.BAD_NUMBER_FORMAT)
        if line[end] != _EQUALS:
            raise GrblError(errors.INVALID_STATEMENT)
        end, value = bare(line, end + 1)
        if end < 0:
            raise GrblError(errors.BAD_NUMBER_FORMAT)
        if line[end] != 0 or number > _HIGHEST_SETTING:
            raise GrblError(errors.INVALID_STATEMENT)
        self._canon.synchronise()  # blocks were planned with the old settings
        self._settings.set(int(number), value)
