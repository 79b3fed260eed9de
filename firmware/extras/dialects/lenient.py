"""Lenient: words of other controllers, accepted where dropping them does no harm.

A line that Grbl refuses is examined once more. Words without a meaning on this machine are
dropped, M6 becomes a pause, G73 to G89 become drilling (drilling.py). Each such word is reported
once in a [MSG:]. OpenPnP's M114, M115 and M400 are answered in Marlin's form, which it reads.
Every other line is executed as it is. LENIENT = True in the board file selects this.
"""

from base import state as st
from base.axes import LETTERS
from base.errors import (
    GCODE_G53_INVALID_MOTION_MODE,
    GCODE_MODAL_GROUP_VIOLATION,
    GrblError,
)
from base.float32 import vector
from base.text import text_of
from control.modes import SPINDLE
from language.block_layout import SET_TOOL
from micropython import const
from talk.report import VERSION

from extras.custom_codes import key_of
from extras.dialects.drilling import CYCLES, MOTIONS, Drilling, has, joined
from extras.gcode_text import letters_and_texts

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType

    from interfaces import Options

    from extras.api import Cnc
    from extras.dialects.drilling import Word

# The message for each word that is dropped or changed, by its key.
_MESSAGES = {
    "%": "the tape mark is ignored",
    "O": "the program number is ignored",
    "G43": "tool lengths are not stored: set Z zero for each tool",
    "G49": "ignored, because no tool length is set",
    "G4 S": "taken as a dwell in seconds",
    "G61.1": "ignored",
    "G64": "ignored: $11 sets the speed in corners",
    "G80": "ignored, because the line has a motion",
    "G98": "cycles return to the Z that was before the first cycle",
    "G99": "cycles return to R",
    "M6": "pauses with the spindle off; ~ resumes",
    "M204": "ignored: $120, $121, $122 set the acceleration",
}
_CYCLE_MESSAGE = "executed as a drilling cycle"
# Words in tenths.
_G4 = const(40)
_G43 = const(430)
_G43_1 = const(431)
_G49 = const(490)
_G53 = const(530)
_G61_1 = const(611)
_G64 = const(640)
_G80 = const(800)
_G98 = const(980)
_G99 = const(990)
_M6 = const(60)
_M114 = const(1140)
_M115 = const(1150)
_M204 = const(2040)
_M400 = const(4000)
_WITH_P_AND_Q = (_G4, 100) + tuple(CYCLES)  # with these on the line, P and Q are not those of G64
_SPINDLE_ON = (30, 40)  # M3, M4: with these on the line S is a speed
_PROGRAM_ENDS = (20, 300)  # M2, M30
_NO_TENTHS = const(-1)  # of a word that is neither G nor M
_NUMBER_CHARACTERS = "0123456789.+-"


class Lenient:
    """Wraps the execution of lines. _previous_execute: what executes a line otherwise. _tool: the
    number of the last T, as it is written. _reported: keys of _MESSAGES and cycles reported since
    the last reset. _is_within: a line is being executed; others may be within it."""

    def __init__(self, cnc: "Cnc") -> None:
        machine = cnc.machine
        self._cnc = cnc
        self._machine = machine
        hooks = machine.state.hooks
        self._previous_execute = hooks.execute
        self._drilling = Drilling(machine, self._run_text, self._check_text)
        self._reported: "list[str]" = []
        self._tool = "0"
        self._is_within = False
        hooks.execute = self.execute
        machine.interpreter.watch(SET_TOOL)
        cnc.after_reset(self._forget)
        cnc.entries.append(self._why_no_entry)
        cnc.cycles.append(self._drilling)

    def _forget(self) -> None:
        """Forget words reported, tool and cycle, after a reset."""
        self._reported.clear()
        self._tool = "0"
        self._drilling.forget()

    def _why_no_entry(self) -> str:
        """Return why a program cannot be entered here, "" if it can. See Cnc.entries."""
        if self._drilling.cycle:
            return "the line is inside a drilling cycle: start before it"
        return ""

    def execute(self, line: bytearray, length: int) -> None:
        """Execute a line, as Interpreter.execute().

        A line that a handler of another extra executes within this one is passed on: it neither
        repeats a cycle nor ends it.
        """
        if self._is_within:
            self._previous_execute(line, length)
            return
        self._is_within = True
        try:
            self._execute(line, length)
        finally:
            self._is_within = False

    def _execute(self, line: bytearray, length: int) -> None:
        """Execute a line as the sender has sent it, and note what it means for cycle and tool.

        Its words are read only if they may matter: in a cycle, in G99, with a T, or if Grbl
        refuses the line. A repetition of a cycle is tried before Grbl, because Grbl would execute
        its axis words as a motion.
        """
        drilling = self._drilling
        words: "list[Word]" = []  # stays empty if they do not matter, or it is not words only
        if drilling.cycle or drilling.ends_at_r or line.find(b"T", 0, length) >= 0:
            words = _words_of_line(line, length) or []
        is_executed = drilling.repeats(words) and self._execute_changed(line, length, words)
        if not is_executed:
            if drilling.cycle and has(words, "G", _G53) and not has(words, "G", *MOTIONS):
                raise GrblError(GCODE_G53_INVALID_MOTION_MODE)
            try:
                self._previous_execute(line, length)
            except GrblError:  # try once more without the words that have no effect
                if not self._execute_changed(line, length, words or _words_of_line(line, length)):
                    raise
        self._note_tool(words)
        if has(words, "M", *_PROGRAM_ENDS):
            drilling.forget()
        elif has(words, "G", *MOTIONS):
            drilling.stop(False)  # with the motion mode of this line
        elif has(words, "G", _G80):
            drilling.stop(True)  # with the motion mode from before the cycle

    def _note_tool(self, words: "list[Word]") -> None:
        """Note the number of a T, for the message of M6."""
        for letter, number, _ in words:
            if letter == "T":
                self._tool = number

    def _check_text(self, text: str) -> None:
        """Check a line. GrblError refuses it; otherwise it is in the interpreter's block."""
        machine = self._machine
        line = bytearray(text.encode() + b"\0")
        span = len(line) - 1 << 8  # the line's end, with its start, 0, in the lower byte
        machine.interpreter.check_line(line, span, machine.modes.modal, 0)  # 0: not $J=

    def _run_text(self, text: str) -> None:
        """Execute a line as Grbl does. GrblError refuses it."""
        line = bytearray(text.encode() + b"\0")
        self._previous_execute(line, len(line) - 1)

    # A line that has been refused

    def _execute_changed(self, line: bytearray, length: int, words: "list[Word] | None") -> bool:
        """Execute a line that Grbl refuses, or that repeats a cycle: as M114, M115 or M400, as a
        drilling cycle, or without the words that have no effect here.

        words: those of the line, None if it is not words only. Return False, and do nothing, if
        no word can be dropped, or if the line is another extra's.
        """
        if words is None or self._cnc.has_word(line, length):
            return False
        if self._execute_marlin_m(words):
            return True
        if has(words, "G", _G98) and has(words, "G", _G99):
            raise GrblError(GCODE_MODAL_GROUP_VIOLATION)
        rest, keys = self._split_words(words)
        if line.find(b"%", 0, length) >= 0:
            keys.insert(0, "%")
        drilling = self._drilling
        ends_at_r = has(words, "G", _G99) or (drilling.ends_at_r and not has(words, "G", _G98))
        # As written, for the message. plan() refuses a second one.
        cycles = [
            "G" + text for letter, text, tenths in rest if letter == "G" and tenths in CYCLES
        ]
        if cycles or drilling.repeats(rest):
            if "M6" in keys:
                return False  # a tool change is not executed with a cycle
            holes = drilling.plan(rest, ends_at_r)  # checks all: GrblError changes nothing
            self._report_words(keys + cycles)
            drilling.execute(holes)
            return True
        if keys:
            self._check_text(joined(rest))  # before the message and the pause
            self._report_words(keys)
            if "M6" in keys:
                self._pause_for_tool(words)
            self._run_text(joined(rest))
            drilling.ends_at_r = ends_at_r
        return bool(keys)

    def _execute_marlin_m(self, words: "list[Word]") -> bool:
        """Execute M114 (position), M115 (name) or M400 (wait), which has only N with it on its
        line. Return whether it is one of these."""
        others = [word for word in words if word[0] != "N"]
        if len(others) != 1 or not has(others, "M", _M114, _M115, _M400):
            return False
        machine = self._machine
        axes = machine.planner.axes
        if machine.state.run == st.CHECK:
            return True  # without an answer
        if has(others, "M", _M400):
            machine.canon.synchronise()
        elif has(others, "M", _M115):
            about = "FIRMWARE_NAME:Grbl FIRMWARE_VERSION:%s MACHINE_TYPE:ugrbl AXIS_COUNT:%d"
            self._cnc.write_line((about % (VERSION, axes)).encode())
        else:
            here = vector(axes)
            machine.position(here)
            coords = machine.coords
            for i in range(axes):
                here[i] -= coords.work_zero(coords.active, i)
            positions = ["%s:%.3f" % (LETTERS[i], here[i]) for i in range(axes)]
            self._cnc.write_line(" ".join(positions).encode())
        return True

    def _split_words(self, words: "list[Word]") -> "tuple[list[Word], list[str]]":
        """Return the words of a line that stay, and the keys in _MESSAGES of the dropped ones. The
        S of G4 becomes P: it stays, and has a key."""
        rest, keys = [], []
        for word in words:
            _, text, tenths = word
            key = self._message_key(word, words)
            if key:
                keys.append(key)
            if key == "G4 S":
                rest.append(("P", text, tenths))  # Grbl's word for the seconds of a dwell
            elif not key:
                rest.append(word)
        return rest, keys

    def _message_key(self, word: "Word", words: "list[Word]") -> str:
        """Return the key in _MESSAGES of a word that may be dropped, or of the S of G4, which is
        changed; "" for all others. words: its line."""
        letter, _, tenths = word
        if letter == "O":  # alone or with N; with other words it is a subroutine of LinuxCNC
            return "O" if all(other[0] in "NO" for other in words) else ""
        if letter == "H":  # the tool number of G43, which is dropped or kept with it
            return self._message_key_of_g(_G43, words) if has(words, "G", _G43) else ""
        if letter in "PQS":
            return _message_key_of_value(letter, words)
        if letter == "M":
            if tenths == _M204 and _sets_acceleration(words):
                return "M204"
            return "M6" if tenths == _M6 else ""
        return self._message_key_of_g(tenths, words) if letter == "G" else ""

    def _message_key_of_g(self, tenths: int, words: "list[Word]") -> str:
        """Return the key in _MESSAGES of a G word that may be dropped, or "". tenths: its number;
        words: its line. G43 and G49 only without a tool length."""
        key = "G61.1" if tenths == _G61_1 else "G%d" % (tenths // 10)
        if tenths in (_G43, _G49):
            has_length = self._machine.coords.tool_length or has(words, "G", _G43_1)
            return "" if has_length else key
        if tenths == _G80:  # without a motion Grbl accepts it
            return key if has(words, "G", *MOTIONS) else ""
        return key if tenths in (_G61_1, _G64, _G98, _G99) else ""

    def _report_words(self, keys: "list[str]") -> None:
        """Report words that are dropped or changed, each once until a reset. keys: of _MESSAGES,
        or cycles as written (G81)."""
        for key in keys:
            if key not in self._reported:
                self._reported.append(key)
                self._cnc.message("%s: %s" % (key, _MESSAGES.get(key, _CYCLE_MESSAGE)))

    def _pause_for_tool(self, words: "list[Word]") -> None:
        """Pause for the tool that this line names, or the last one named before."""
        self._note_tool(words)
        if self._machine.modes.modal[SPINDLE]:
            self._run_text("M5")
        if self._machine.state.run != st.CHECK:
            self._machine.canon.synchronise()
            self._cnc.message("Insert tool %s, then send ~" % self._tool)
        self._run_text("M0")


def _message_key_of_value(letter: str, words: "list[Word]") -> str:
    """Return the key in _MESSAGES of a P, Q or S that another word of its line explains, or "".

    M204 has acceleration in P and S, G64 its tolerances in P and Q, and G4 its seconds in S. But P
    and Q may be those of G4, G10 or a cycle; S is a speed with M3 or M4; and if G4 has a P, that
    is its time.
    """
    if letter != "Q" and _sets_acceleration(words):
        return "M204"
    if letter != "S":
        return "G64" if has(words, "G", _G64) and not has(words, "G", *_WITH_P_AND_Q) else ""
    is_speed = has(words, "P") or has(words, "M", *_SPINDLE_ON)
    return "G4 S" if has(words, "G", _G4) and not is_speed else ""


def _sets_acceleration(words: "list[Word]") -> bool:
    """Return whether M204 is on the line, and S is no speed of a spindle, T no tool."""
    return has(words, "M", _M204) and not (has(words, "M", *_SPINDLE_ON) or has(words, "T"))


def _words_of_line(line: bytearray, length: int) -> "list[Word] | None":
    """Return the words of a line without tape marks (%), or None if it is not words only.

    Each has its letter, the text of its number, and of a G or M word the number in tenths, else
    _NO_TENTHS.
    """
    words = []
    for letter, text in letters_and_texts(text_of(line[:length]).strip("%")):
        if not "A" <= letter <= "Z" or any(c not in _NUMBER_CHARACTERS for c in text):
            return None
        try:
            value = float(text)
        except ValueError:
            return None
        tenths = key_of(letter, value)[1] if letter in "GM" else _NO_TENTHS
        words.append((letter, text, tenths))
    return words


def prepare(options: "Options", board: "ModuleType") -> None:
    """Before the machine is created, allow tool numbers of any size."""
    options.highest_tool = 1 << 31


def install(cnc: "Cnc") -> None:
    """Install after all other extras, because their words have priority."""
    if cnc.machine.interpreter.motions:
        raise ValueError("LENIENT has its own canned cycles: no other extra can add one")
    Lenient(cnc)
