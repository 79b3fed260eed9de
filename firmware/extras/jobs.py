"""Jobs: programs that live on the board, and run without a computer.

$F lists them, $F=NAME runs one, $F<=NAME shows it, $FD=NAME deletes it, as grblHAL has it; and
$SD/List, $SD/Run=, $LocalFS/… as FluidNC. $FU=NAME,SIZE,CRC takes one (job_upload.py), $FB=NAME
gives it to the start button, and $F=NAME@LINE goes on in its middle (job_entry.py). Which job
runs, and where it was held or stopped, is noted in flash at rest: $F=@ goes on there. A board asks
for it with JOBS = "jobs", the name of the folder.
"""

import io
import json

import micropython
from base import errors
from base import state as st
from base.controls import START
from base.errors import GrblError
from base.faults import harmless
from control.modes import COOLANT, SPINDLE
from micropython import const
from talk.lines import LineReader

from extras.job_entry import Entry, NoWay, in_force
from extras.job_feed import Feed
from extras.job_upload import Upload

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import IO, Any

    from interfaces import JobFiles, Options

    from extras.api import Cnc

# Under which is kept: the job that runs, a line of it, its size and what was in force before it;
# the start button's.
_JOURNAL = "job"
_JOURNAL_LINES = const(3)
_BUTTON = "button"
# FluidNC's words behind $SD/ and $LocalFS/, and ours behind $F.
_FLUIDNC = {b"LIST": b"", b"RUN": b"=", b"SHOW": b"<=", b"DELETE": b"D="}
_STATES = (st.IDLE, st.ALARM, st.CHECK)
_SHOWN_BYTES = const(128)
_PRESSED_MS = const(50)  # later, something else has been going on
# A reader for what is neither the sender's line nor the job's.
_READ_AHEAD = const(512)
_LONGEST = const(344)  # 256 bytes in base64

_found: "dict[str, JobFiles | None]" = {}


def prepare(options: "Options", board: "ModuleType") -> None:
    """Where they are."""
    _found["files"] = options.job_files


def install(cnc: "Cnc") -> None:
    """Put jobs beside the sender."""
    files = _found["files"]
    assert files
    jobs = Jobs(cnc, files)
    cnc.add_command(b"F", jobs.command, _STATES)
    cnc.add_command(b"SD", jobs.fluidnc, _STATES)
    cnc.add_command(b"LOCALFS", jobs.fluidnc, _STATES)
    cnc.add_field(jobs.field)
    cnc.before_lines(jobs.turn)
    cnc.behind_reset(jobs.begin_anew)
    cnc.behind_alarm(jobs.alarm)
    cnc.behind_command(b"H\0", jobs.home)  # of all axes: a line ends with a 0
    cnc.behind_program(jobs.program_ends)
    cnc.behind_controls(jobs.press)


class Jobs:
    """The job that runs, or is to, and the commands."""

    def __init__(self, cnc: "Cnc", files: "JobFiles") -> None:
        self._cnc = cnc
        self._machine = cnc.machine
        self._files = files
        reader = LineReader(_READ_AHEAD, _LONGEST, cnc.machine.reader.post)
        self._feed = Feed(cnc.machine, self._refuse, self._note_line)
        self._at_rest = cnc.machine.at_rest
        cnc.machine.at_rest = self._is_quiet  # type: ignore[method-assign]
        self._entry = Entry(cnc, reader)
        self._upload = Upload(cnc, files, reader)
        self._name = ""  # what runs
        self._start: "list[Any]" = []  # its size, and what was in force before it
        self._pressed_ms = 0
        self._due = ""  # what is to, once the loop has no line of the sender left,
        self._due_line = 0  # and from which line on; 0: all of it
        self._rest: "IO[bytes] | None" = None  # of the file, while the tool is on its way there
        self._is_homed = False
        self._refused = 0  # Grbl's number for the line that has ended it
        self._pressed = bytearray(1)  # the start button has been
        self._has_started = False  # the firmware

    # Commands

    def fluidnc(self, words: bytes) -> None:
        """What stands behind $SD/ or $LocalFS/, whose slash no line keeps."""
        word, equals, name = words.partition(b"=")
        if word not in _FLUIDNC or bool(equals) != bool(_FLUIDNC[word]):
            raise GrblError(errors.INVALID_STATEMENT)
        self.command(_FLUIDNC[word] + name)

    def command(self, words: bytes) -> None:
        """What stands behind $F."""
        if self._feed.is_on:  # a line of the job's own
            raise GrblError(errors.IDLE_ERROR)
        if words[:1] in (b"D", b"U", b"B"):
            self._machine.canon.synchronise()  # flash is written at rest
        verb, equals, rest = words.partition(b"=")
        name = rest.decode()
        if not words:
            self._list()
        elif words == b"B":
            self._tell_button()
        elif not equals:
            raise GrblError(errors.INVALID_STATEMENT)
        elif verb == b"":
            self._run(name)
        elif verb == b"<":
            self._show(self._known(name))
        elif verb == b"D":
            self._files.delete(self._known(name))
        elif verb == b"U":
            self._upload.take(name)
        elif verb == b"B":
            self._give_button(name)
        else:
            raise GrblError(errors.INVALID_STATEMENT)

    def _known(self, name: str) -> str:
        """A name; GrblError where there is no such job."""
        if self._files.size(name) < 0:
            self._cnc.message("There is no job %s: $F lists them" % harmless(name))
            raise GrblError(errors.INVALID_STATEMENT)
        return name

    def _list(self) -> None:
        for name, size in self._files.files():
            self._cnc.tell(b"[FILE:/%s|SIZE:%d]" % (name.encode(), size))
        self._cnc.message("Room for %d kB" % self._files.room_kb())

    def _show(self, name: str) -> None:
        with self._files.open(name) as file:
            while True:
                piece = file.read(_SHOWN_BYTES)
                if not piece:
                    break
                self._machine.report.send(piece)
                self._cnc.service()
        self._machine.report.send(b"\r\n")

    def _tell_button(self) -> None:
        name = self._kept(_BUTTON)
        self._cnc.message("Start button: " + (harmless(name[0]) if name else "no job"))

    def _give_button(self, name: str) -> None:
        self._machine.saves.save(_BUTTON, [self._known(name)] if name else [])

    def _kept(self, what: str) -> "list[str]":
        return self._machine.saves.load(what) or []

    def _journal(self) -> "list[str]":
        """What is kept of the job that has not come to its end; empty where there is none."""
        kept = self._kept(_JOURNAL)
        return kept if len(kept) == _JOURNAL_LINES else []

    def _run(self, name: str) -> None:
        if self._machine.state.run == st.ALARM:
            raise GrblError(errors.SYSTEM_GC_LOCK)
        name, at, number = name.partition("@")
        if at and not number:
            name, number = self._noted(name)
        try:
            line = int(number) if at else 0
        except ValueError:
            line = -1
        if line < 0 or (at and line == 0):
            raise GrblError(errors.BAD_NUMBER_FORMAT)
        name = self._known(name)
        if at and not self._is_homed:
            self._tell(name, "to go on in its middle, home first ($H)")
            raise GrblError(errors.INVALID_STATEMENT)
        self._due, self._due_line = name, line

    def _noted(self, name: str) -> "tuple[str, str]":
        """The job that has not come to its end, and a line of it."""
        kept = self._journal()
        if not kept or name not in ("", kept[0]):
            self._cnc.message("No job is noted" + (" of that name" if name else ""))
            raise GrblError(errors.INVALID_STATEMENT)
        return kept[0], kept[1]

    # What runs

    @micropython.native
    def turn(self) -> None:
        """A turn of the loop, between two lines."""
        if self._pressed[0]:
            self._pressed[0] = 0
            if self._machine.port.elapsed_ms(self._pressed_ms) < _PRESSED_MS:
                self._start_by_button()
        if self._feed.is_on:
            self._go_on()
        elif self._due and self._is_free():
            self._begin()

    def _is_free(self) -> bool:
        """Nothing moves or is going to, and the sender has said nothing that is not done."""
        machine = self._machine
        at_rest = self._at_rest() or machine.state.run == st.CHECK
        return at_rest and not machine.reader.has_line()

    def _is_quiet(self) -> bool:
        """Stand in for Controller.at_rest(): a job that waits, in a dwell say, is none."""
        return self._at_rest() and not self._feed.is_on

    def _begin(self) -> None:
        name, self._due = self._due, ""
        try:
            file = self._files.open(name)
        except OSError:
            self._tell(name, "cannot be read")
            return
        self._name, self._refused = name, 0
        size = self._files.size(name)
        if self._due_line:
            self._enter(file, size, self._due_line)
            return
        self._start = [size, in_force(self._machine)]
        self._note(1)
        self._tell(name, "begins")
        self._feed.start(file, size)

    def _enter(self, file: "IO[bytes]", size: int, line: int) -> None:
        """Have the tool led to that line."""
        kept = self._journal()
        self._start = [size, in_force(self._machine)]
        try:
            if self._machine.state.run != st.IDLE or not self._is_homed:
                raise NoWay("the machine is not homed, or not idle")
            if kept and kept[0] == self._name:
                self._start = json.loads(kept[2])
                if self._start[0] != size:
                    raise NoWay("it is another file than the one that was noted")
            self._tool_off()
            self._entry.find(file, line, self._start[1])
        except NoWay as why:
            file.close()
            self._tell(self._name, str(why))
            return
        except BaseException:
            file.close()
            raise
        self._rest = file
        way = [text for text in self._entry.way() if text]
        self._tell(self._name, "goes on at line %d" % line)
        lines = io.BytesIO(("\n".join(way) + "\n").encode())
        self._feed.start(lines, size, line - 1 - len(way))

    def _arrive(self, file: "IO[bytes]") -> None:
        """The tool is there: the file's lines come."""
        self._rest = None
        line = self._feed.line()
        self._feed.stop()
        try:
            self._entry.arrive()
        except NoWay as why:
            file.close()
            self._tell(self._name, str(why))
            return
        self._note(line + 1)
        self._feed.start(file, self._start[0], line)

    def _start_by_button(self) -> None:
        name = self._kept(_BUTTON)
        is_idle = self._machine.state.run == st.IDLE and not (self._feed.is_on or self._due)
        if name and is_idle and self._is_free() and self._files.size(name[0]) >= 0:
            self._due, self._due_line = name[0], 0

    def _go_on(self) -> None:
        feed = self._feed
        feed.answer()
        if feed.has_ended() and self._is_free():
            if self._rest and not self._refused:
                self._arrive(self._rest)
                return
            line = feed.line()
            feed.stop()
            if self._refused or feed.fault:
                self._tell_refusal(line + 1)
            else:
                self._note(0)
                self._tell(self._name, "done, %d lines" % line)

    def _refuse(self, code: int) -> None:
        """A line of the file is refused: nothing behind it is done."""
        self._refused = code
        self._feed.cut()

    def _tell_refusal(self, line: int) -> None:
        """What was planned before has been made: tool off, and say where the program stands."""
        self._tool_off()
        why = "is refused with %d" % self._refused if self._refused else "cannot be read"
        if self._rest:
            self._close_rest()
            self._tell(self._name, "the way there " + why)
            return
        self._note(line)
        self._tell(self._name, "line %d %s" % (line, why))

    def _tool_off(self) -> None:
        """Whatever the state is. Nothing moves."""
        machine = self._machine
        machine.spindle.turn(0, 0.0)
        machine.coolant.set(0)
        machine.modes.modal[SPINDLE] = machine.modes.modal[COOLANT] = 0
        machine.interpreter.fast.forget()

    def _close_rest(self) -> None:
        if self._rest:
            self._rest.close()
            self._rest = None

    def program_ends(self) -> None:
        """M2 or M30: what is behind it is not done."""
        self._entry.has_ended = True
        if self._feed.is_on:
            self._feed.cut()

    def home(self, _was: int) -> None:
        """$H has been done, or has failed."""
        state = self._machine.state
        self._is_homed = state.run == st.IDLE and not state.alarm

    def alarm(self, _code: int) -> None:
        """The place may not be what it is held for; and who sees to that may switch off."""
        self._is_homed = False
        self._due = ""
        if self._feed.is_on:
            self._note_line()

    def begin_anew(self) -> None:
        """Behind power-up or a reset: what ran has come to its end."""
        self._due = ""
        self._pressed[0] = 0
        if self._feed.is_on:
            line = self._feed.made()
            self._feed.drop()
            if self._rest:
                self._close_rest()
                self._tell(self._name, "stopped on the way")
            else:
                self._note(line)
                self._tell(self._name, "stopped at line %d" % line)
        else:
            self._close_rest()
        if not self._has_started:
            kept = self._journal()
            if kept:
                self._tell(kept[0], "did not come to its end; last noted: line " + kept[1])
        self._has_started = True

    @micropython.native
    def press(self, active: int) -> None:
        """A control input has changed. Interrupt. Who ends something else starts no job."""
        state = self._machine.state
        if active & START and state.run == st.IDLE and not state.suspend:
            self._pressed_ms = self._machine.port.ticks_ms()
            self._pressed[0] = 1

    # What is told and kept

    def field(self) -> str:
        """A status report's."""
        if not self._feed.is_on:
            return ""
        return "SD:%.1f,/%s" % (self._feed.percent(), self._name)

    def _tell(self, name: str, what: str) -> None:
        self._cnc.message("Job %s: %s" % (harmless(name), what))

    def _note_line(self) -> None:
        """Motion is held."""
        if not self._rest:
            self._note(self._feed.made())

    def _note(self, line: int) -> None:
        """Keep where the job is; 0: it is done."""
        if self._machine.state.run == st.CHECK:
            return  # which has made nothing
        kept = [self._name, str(line), json.dumps(self._start)] if line else []
        self._machine.saves.save(_JOURNAL, kept)
        self._machine.keep()
