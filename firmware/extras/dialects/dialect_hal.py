"""The words of grblHAL, for senders that show axes A to C, tools and jobs only to it.

Only what is said differs, and some real-time bytes more act: the machine is the same, and no flag
is said that does not hold. A board asks for it with DIALECT = "hal", see docs/grblhal.md. Names of
settings, alarms and errors lie in flash (FILE), where `ugrbl build` puts them: they are read line
by line when a sender asks, and not kept in memory.
"""

from base import errors
from base import state as st
from base.axes import LETTERS
from base.errors import GrblError
from micropython import const
from talk.lines import READS
from talk.report import BUILD, Report

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import IO

    from control.modes import Modes
    from interfaces import Options
    from talk.controller import Controller

    from extras.api import Cnc

# A row has a command, the number of what it is about, and the line to send.
FILE = "hal.txt"
_SETTINGS = b"ES"  # begins the commands about settings

_WELCOME = b"\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n"
_GRBL = const(4)  # how long the word is that "GrblHAL" takes the place of
_ALARM = const(6)  # length of "<Alarm"
# As many as grblHAL's: gSender has 724 under way, whatever [OPT:] says.
_RX_BYTES = const(1024)

# Real-time bytes.
_HOLD = const(0x21)
_STOP = const(0x19)
_COMPLETE_REPORT = const(0x87)
_LIKE = {0x80: 0x3F, 0x81: 0x7E, 0x82: _HOLD, _COMPLETE_REPORT: 0x3F}

# Commands that only read are answered in these.
_STATES = (st.IDLE, st.ALARM, st.CHECK, st.RUN, st.JOG)


class ReportHal(Report):
    """Report, in the words of grblHAL. modal: has the tool; has_jobs: the board has programs."""

    VERSION = "1.1f"

    modal: "Modes"
    has_jobs = False
    is_complete = False  # the next status report is to say everything
    _alarm = 0

    def banner(self) -> None:
        """The machine has started."""
        self._alarm = 0
        self._link.write(_WELCOME)

    def alarm(self, code: int) -> None:
        """The machine had to stop."""
        self._alarm = code
        super().alarm(code)

    def build_info(self, info: str, options: str) -> None:
        """The answer to $I."""
        name, axes = "GrblHAL" + self.identity[_GRBL:], self._axes
        self._line("[VER:%s.%s:%s]" % (self.VERSION, BUILD, name + " " + info if info else name))
        self._line("[OPT:%s,%d,0]" % (options, axes))  # 0 tools: there is no table of them
        self._line("[AXS:%d:%s]" % (axes, LETTERS[:axes]))
        home = ",HOME" if self._settings.homing else ""
        self._line("[NEWOPT:ENUMS" + home + (",SD]" if self.has_jobs else "]"))
        self._line("[FIRMWARE:grblHAL]")

    def modes(self, text: str) -> None:
        """The answer to $G, which says whether a tool length holds."""
        length = " G43.1 M" if self._coords.tool_length else " G49 M"
        super().modes(text.replace(" M", length, 1))

    def spindle(self) -> None:
        """The answer to $SPINDLESH: the only one, which is variable, with its range."""
        settings = self._settings
        laser = "L" if settings.laser_mode else ""
        speeds = self.speed(settings.min_rpm), self.speed(settings.max_rpm)
        self._line("[SPINDLE:0|0|0|*D%sV|PWM|%s,%s]" % ((laser,) + speeds))

    def status(self) -> "memoryview":
        """The answer to ?, and to the byte that asks for all there is."""
        if not self.is_complete:
            return super().status()
        self.is_complete = False
        state = self._state
        state.wco_countdown, state.override_countdown = 1, 0  # in one, they do not fit
        text = bytes(super().status())[:-3]  # >\r\n
        state.override_countdown = 0  # gSender reads Ov: of the others only, and cannot do without
        if self._alarm and state.run == st.ALARM:
            text = b"<Alarm:%d" % self._alarm + text[_ALARM:]
        more = "|WCO:" + self.vector(self._work_offset()) + "|T:%d" % self.modal.tool
        more += "|SD:1|FW:grblHAL>\r\n" if self.has_jobs else "|FW:grblHAL>\r\n"
        return memoryview(text + more.encode())


class Bytes:
    """Real-time bytes of grblHAL. Others vanish, as unknown ones do."""

    def __init__(self, machine: "Controller", report: ReportHal) -> None:
        self._state = machine.state
        self._motor_control = machine.motor_control
        self._report = report
        self._stopping = False
        self._usual_post = machine.reader.post
        machine.reader.post = self.post
        machine.state.hooks.poll += (self._turn,)
        machine.state.hooks.reset += (self._begin,)

    def post(self, byte: int) -> None:
        """One has been received."""
        if byte == _STOP:
            self._stop()
        else:
            if byte == _COMPLETE_REPORT:
                self._report.is_complete = True
            self._usual_post(_LIKE.get(byte, byte))

    def _stop(self) -> None:
        """End motion and forget the rest, position kept: a hold, then a reset. An alarm stays.
        Homing and parking ignore a hold: they are reset at once, into an alarm."""
        state = self._state
        if self._is_under_way() and state.run != st.HOMING and not state.system_motion:
            self._usual_post(_HOLD)
            self._stopping = True
        elif state.run != st.ALARM:
            self._motor_control.reset()

    def _begin(self) -> None:
        if not self._state.pending[st.FEED_HOLD]:  # which has come since
            self._stopping = False

    def _turn(self) -> None:
        if self._stopping and not self._is_under_way():
            self._motor_control.reset()

    def _is_under_way(self) -> bool:
        """Motion is not over yet: a reset would raise an alarm."""
        return self._motor_control.moving or self._motor_control.in_idle_delay


def texts() -> "IO[bytes]":
    """The rows; OSError where they are not on the board."""
    return open(FILE, "rb")


def _enumerate(cnc: "Cnc", command: bytes) -> None:
    """Send the rows of that command; of settings, those that this machine has."""
    try:
        rows = texts()
    except OSError:
        cnc.message(FILE + " is not on the board: ugrbl deploy puts it there")
        return
    begins, is_known = command + b" ", False
    with rows:
        for row in rows:
            if row.startswith(begins):
                is_known = True
                number, _, text = row[len(begins) :].partition(b" ")
                if command[:2] != _SETTINGS or _has_setting(cnc, number):
                    cnc.machine.report.send(text)
                    cnc.service()
    if not is_known:
        raise GrblError(errors.INVALID_STATEMENT)


def _has_setting(cnc: "Cnc", number: bytes) -> bool:
    try:
        cnc.machine.settings.row(int(number))
    except (GrblError, ValueError):
        return False
    return True


_found: "dict[str, bool]" = {}


def prepare(options: "Options", board: "ModuleType") -> None:
    """Choose the report, and have the stop byte act as it arrives."""
    options.report = ReportHal
    options.rx_bytes = max(options.rx_bytes, _RX_BYTES)
    options.reads = (READS[0], _STOP, READS[2])
    _found["jobs"] = options.job_files is not None


def install(cnc: "Cnc") -> None:
    """What grblHAL answers and Grbl does not."""
    machine = cnc.machine
    report, commands = machine.report, machine.commands
    assert isinstance(report, ReportHal)
    report.modal, report.has_jobs = machine.modes, _found["jobs"]
    Bytes(machine, report)
    link = machine.protocol.link
    if hasattr(link, "welcome"):  # that of a network
        link.welcome = _WELCOME
        link.questions = b"?\x80\x87"  # type: ignore[attr-defined]
    cnc.add_command(b"E", lambda rest: _enumerate(cnc, b"E" + rest), _STATES)
    cnc.add_command(b"+", lambda _: commands.show_settings(), _STATES)
    cnc.add_command(b"SPINDLESH", lambda _: report.spindle(), _STATES)
    cnc.add_command(b"HELP", lambda _: report.help(), _STATES)
