"""Reports in the format of Grbl 0.9i and 0.9j, for senders older than Grbl 1.1.

Errors, alarms and settings are reported with their meaning as text. A status report has both
positions, and no fields that come only now and then. Only reports differ; the machine is the same.
DIALECT = "0.9" in the board file selects this.
"""

from base import state as st
from base.errors import ALARM_PROBE_FAIL_CONTACT, ALARM_PROBE_FAIL_INITIAL
from base.float32_math import MINUS, add
from base.settings import INT
from micropython import const
from talk.digits import VALUES, number, write
from talk.lines import free_space
from talk.report import BUILD, Report

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from types import ModuleType

    from base.settings import Rows
    from interfaces import Machine, Options

    from extras.api import Cnc


_SPINDLE_INDEX = const(6)  # of the spindle's word in $G: six groups of G words come first

# Bits of $10 in this dialect: what a status report shows.
_SHOW_MPOS = const(1)
_SHOW_WPOS = const(2)
_SHOW_BLOCKS = const(4)
_SHOW_RX_BYTES = const(8)
_SHOW_LIMITS = const(16)

_HELP = b"""\
$$ (view Grbl settings)\r
$# (view # parameters)\r
$G (view parser state)\r
$I (view build info)\r
$N (view startup blocks)\r
$x=value (save Grbl setting)\r
$Nx=line (save startup block)\r
$C (check gcode mode)\r
$X (kill alarm lock)\r
$H (run homing cycle)\r
~ (cycle start)\r
! (feed hold)\r
? (current status)\r
ctrl-x (reset Grbl)\r
"""

# Errors that are not listed are reported by their number.
_ERRORS = {
    1: "Expected command letter",
    2: "Bad number format",
    3: "Invalid statement",
    4: "Value < 0",
    5: "Setting disabled",
    6: "Value < 3 usec",
    7: "EEPROM read fail. Using defaults",
    8: "Not idle",
    9: "Alarm lock",
    10: "Homing not enabled",
    11: "Line overflow",
    12: "Step rate > 30kHz",
    20: "Unsupported command",
    21: "Modal group violation",
    22: "Undefined feed rate",
}

_ALARMS = {
    1: "Hard limit",
    2: "Soft limit",
    3: "Abort during cycle",
    ALARM_PROBE_FAIL_INITIAL: "Probe fail",
    ALARM_PROBE_FAIL_CONTACT: "Probe fail",
    6: "Homing fail",
    7: "Homing fail",
    8: "Homing fail",
    9: "Homing fail",
    10: "Homing fail",
}

# The text in parentheses after a setting. A mask's bits follow the colon.
_WORDS = {
    0: "step pulse, usec",
    1: "step idle delay, msec",
    2: "step port invert mask:",
    3: "dir port invert mask:",
    4: "step enable invert, bool",
    5: "limit pins invert, bool",
    6: "probe pin invert, bool",
    10: "status report mask:",
    11: "junction deviation, mm",
    12: "arc tolerance, mm",
    13: "report inches, bool",
    20: "soft limits, bool",
    21: "hard limits, bool",
    22: "homing cycle, bool",
    23: "homing dir invert mask:",
    24: "homing feed, mm/min",
    25: "homing seek, mm/min",
    26: "homing debounce, msec",
    27: "homing pull-off, mm",
}
# The same for a group with one setting per axis; the axis's letter comes before it.
_AXIS_WORDS = {
    10: ", step/mm",
    11: " max rate, mm/min",
    12: " accel, mm/sec^2",
    13: " max travel, mm",
}


class Report09(Report):
    """Reports as 0.9j formats them. words: descriptions of settings by number; alarms: texts of
    alarms by number. _all_blocks, _all_rx_bytes: free blocks of the planner and bytes of the
    reader while nothing is used."""

    VERSION = "0.9j"

    words = _WORDS
    alarms = _ALARMS

    def connect(self, machine: "Machine") -> None:
        """Connect the machine as Report.connect() does, and note the free space of the buffers,
        which are still empty: 0.9 reports used entries."""
        super().connect(machine)
        self.words = _WORDS.copy()  # other extras may add to these
        self.alarms = _ALARMS.copy()
        self._all_blocks = machine.planner.free()
        self._all_rx_bytes = free_space(self._reader)

    def configure(self) -> None:
        """Apply $10 and $13."""
        super().configure()
        self._is_common = False  # no fast path, because that writes Grbl 1.1's format

    # Answers

    def error(self, code: int) -> None:
        """Report that a line was refused."""
        self._line("error: " + _ERRORS.get(code, "Invalid gcode ID:%d" % code))

    def alarm(self, code: int) -> None:
        """Report an alarm."""
        self._line("ALARM: " + self.alarms.get(code, "ID:%d" % code))

    def message(self, text: str) -> None:
        """Send a message for the user."""
        self._line("[" + text + "]")

    def banner(self) -> None:
        """Send the welcome."""
        self._line("\r\nGrbl " + self.VERSION + " ['$' for help]")

    def help(self) -> None:
        """Answer $."""
        self._link.write(_HELP)

    def setting(self, key: int, value: float, decimals: int) -> None:
        """Send one line of $$: key is the setting's number; after a mask its bits are
        shown, too."""
        _, _, _, _, unit = self._settings.row(key)[0]  # [1]: its axis
        words = self.words.get(key) or unit
        if words[-1] == ":":  # only descriptions of masks end so
            words += "{:08b}".format(int(value))
        elif key // 10 in _AXIS_WORDS:  # the last digit is the axis
            words = "xyzabc"[key % 10] + _AXIS_WORDS[key // 10]
        self._line("$%d=%s (%s)" % (key, number(value, decimals), words))

    def startup_run(self, text: str) -> bytes:
        """Send the text of a startup line before it is executed; return nothing to put in front of
        its answer, as 1.1 does."""
        self._link.write(text.encode())
        return b""

    def startup_lost(self) -> None:
        """Do nothing: 0.9 takes a damaged startup line as empty."""

    def build_info(self, info: str, options: str) -> None:
        """Answer $I."""
        self._line("[%s.%s:%s]" % (self.VERSION, BUILD, info))

    def modes(self, text: str) -> None:
        """Answer $G. text: 1.1's words. M0 is always listed, before the spindle's M word, and the
        tool is always T0, as in 0.9."""
        words = ["T0" if word[0] == "T" else word for word in text.split(" ")]
        words.insert(_SPINDLE_INDEX, "M0")
        self._line("[" + " ".join(words) + "]")

    # Parts

    def rate(self, mm_min: float) -> str:
        """Return a feed rate in report units, always with a decimal point."""
        text = super().rate(mm_min)
        return text if "." in text else text + "."

    def speed(self, rpm: float) -> str:
        """Return a spindle speed, which 0.9 formats as a feed rate."""
        return self.rate(rpm)

    # The status report

    def _write_fields(
        self, text: bytearray, ints: "array[int]", mm: "array[float]", _active_inputs: int
    ) -> None:
        """Write all fields after the state. mm: machine position, which becomes work position.

        text: the report, to which write() appends a form, a text that a 0 follows; ints: the
        numbers for a form's %.
        """
        mask = self._settings.report_mask
        if mask & _SHOW_MPOS:
            self._write_lengths(b",MPos:\0", mm)
        if mask & _SHOW_WPOS:
            add(self._work_offset(), MINUS, mm, self._axes)  # mm -= work offset
            self._write_lengths(b",WPos:\0", mm)
        if mask & _SHOW_BLOCKS:
            self._write_number(b",Buf:%\0", self._all_blocks - self._planner.free())
        if mask & _SHOW_RX_BYTES:
            self._write_number(b",RX:%\0", self._all_rx_bytes - free_space(self._reader))
        if self._line_numbers:
            self._write_number(b",Ln:%\0", self._planner.line_number())
        if mask & _SHOW_LIMITS:
            limits = self._inputs.limits()
            write(b",Lim:\0", text, ints, mm)
            for i in range(self._axes):  # a digit per axis, X last
                self._write_number(b"%\0", limits >> (self._axes - 1 - i) & 1)

    def _write_number(self, form: bytes, value: int) -> None:
        """Write a field. form: its text, which a 0 follows; value replaces its %."""
        self._ints[VALUES] = value
        write(form, self._text, self._ints, self._mm)

    def _suspended(self) -> bytes:
        """Return the first text of a report in a hold or with the door: Door while it is open or
        the tool is being retracted, else Hold."""
        state = self._state
        suspend = state.suspend
        if state.run == st.DOOR and (suspend & st.DOOR_AJAR or not suspend & st.RETRACT_COMPLETE):
            return b"<Door\0"
        return b"<Hold\0"  # also when the door is closed again


class Report09i(Report09):
    """Reports as 0.9i formats them: only the version differs."""

    VERSION = "0.9i"


_SETTINGS: "Rows" = (
    # Status report options. 1: machine position; 2: work position; 4: planner blocks in use; 8:
    # received bytes not yet read; 16: limit switches.
    (10, "report_mask", INT, _SHOW_MPOS | _SHOW_WPOS, "mask"),
)
_WITHOUT = (10, 30, 31, 32)  # settings of 1.1 that 0.9 lacks or, as $10, has otherwise
# As LineReader's `reads`: no upper real-time bytes; @ is one (the safety door); the rest of a line
# that is too long is a line of its own.
_READS = (0x100, 0x40, 0)


def prepare(options: "Options", board: "ModuleType") -> None:
    """Before the machine is created, select the report class and the real-time bytes."""
    options.report = Report09i if board.__dict__["DIALECT"] == "0.9i" else Report09
    options.reads = _READS
    options.highest_tool = 1 << 31  # 0.9 accepts any number


def install(cnc: "Cnc") -> None:
    """Replace the settings and remove the commands that 0.9 does not have."""
    cnc.add_settings(_SETTINGS, without=_WITHOUT)
    cnc.remove_commands(b"JS")
