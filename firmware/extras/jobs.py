"""Jobs: programs that live on the board, and run without a computer.

$F lists them, $F=NAME runs one, $F<=NAME shows it, $FD=NAME deletes it, as grblHAL has it; and
$SD/List, $SD/Run=, $LocalFS/… as FluidNC. $FU=NAME,SIZE,CRC takes one (job_upload.py), $FB=NAME
gives it to the start button. Which job runs, and where it was held or stopped, is noted in flash
at rest. A board asks for it with JOBS = "jobs", the name of the folder.
"""

import micropython
from base import errors
from base import state as st
from base.controls import START
from base.errors import GrblError
from micropython import const

from extras import job_upload
from extras.job_feed import Feed
from extras.job_shelf import Shelf, is_name, shown

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType

    from interfaces import Options

    from extras.api import Cnc

# Under which is kept: the job that runs and a line of it; the start button's.
_JOURNAL = "job"
_BUTTON = "button"
# FluidNC's words behind $SD/ and $LocalFS/, and ours behind $F.
_FLUIDNC = {b"LIST": b"", b"RUN": b"=", b"SHOW": b"<=", b"DELETE": b"D="}
_STATES = (st.IDLE, st.ALARM, st.CHECK)
_SHOWN_BYTES = const(128)

_found = {"folder": ""}


def prepare(options: "Options", board: "ModuleType") -> None:
    """Where they are."""
    _found["folder"] = board.__dict__["JOBS"]


def install(cnc: "Cnc") -> None:
    """Put jobs beside the sender."""
    jobs = Jobs(cnc, Shelf(_found["folder"], cnc.machine.saves))
    cnc.add_command(b"F", jobs.command, _STATES)
    cnc.add_command(b"SD", jobs.fluidnc, _STATES)
    cnc.add_command(b"LOCALFS", jobs.fluidnc, _STATES)
    cnc.add_field(jobs.field)
    cnc.before_lines(jobs.turn)
    cnc.behind_reset(jobs.begin_anew)
    cnc.behind_program(jobs.program_ends)
    cnc.behind_controls(jobs.press)


class Jobs:
    """The job that runs, or is to, and the commands."""

    def __init__(self, cnc: "Cnc", shelf: Shelf) -> None:
        self._cnc = cnc
        self._machine = cnc.machine
        self._shelf = shelf
        self._feed = Feed(cnc.machine, self._refuse, self._note_line)
        self._name = ""  # what runs
        self._due = ""  # what is to, once the loop has no line of the sender left
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
            self._shelf.delete(self._known(name))
        elif verb == b"U":
            self._take(name)
        elif verb == b"B":
            self._give_button(name)
        else:
            raise GrblError(errors.INVALID_STATEMENT)

    def _known(self, name: str) -> str:
        """A name; GrblError where there is no such job."""
        if self._shelf.size(name) < 0:
            self._cnc.message("There is no job %s: $F lists them" % shown(name))
            raise GrblError(errors.INVALID_STATEMENT)
        return name

    def _list(self) -> None:
        for name, size in self._shelf.files():
            self._cnc.tell(b"[FILE:/%s|SIZE:%d]" % (name.encode(), size))
        self._cnc.message("Room for %d kB" % self._shelf.room_kb())

    def _show(self, name: str) -> None:
        with self._shelf.open(name) as file:
            while True:
                piece = file.read(_SHOWN_BYTES)
                if not piece:
                    break
                self._machine.report.send(piece)
                self._cnc.service()
        self._machine.report.send(b"\r\n")

    def _take(self, text: str) -> None:
        name, size, checksum = job_upload.order(text)
        if not is_name(name):
            self._cnc.message("A job is called so: letters, digits, . _ -, at most 32")
            raise GrblError(errors.INVALID_STATEMENT)
        job_upload.check(self._cnc, self._shelf, name, size)
        job_upload.receive(self._cnc, self._shelf, name, size, checksum)

    def _tell_button(self) -> None:
        name = self._kept(_BUTTON)
        self._cnc.message("Start button: " + (shown(name[0]) if name else "no job"))

    def _give_button(self, name: str) -> None:
        self._machine.saves.save(_BUTTON, [self._known(name)] if name else [])

    def _kept(self, what: str) -> "list[str]":
        return self._machine.saves.load(what) or []

    def _run(self, name: str) -> None:
        if self._machine.state.run == st.ALARM:
            raise GrblError(errors.SYSTEM_GC_LOCK)
        self._due = self._known(name)

    # What runs

    @micropython.native
    def turn(self) -> None:
        """A turn of the loop, between two lines."""
        if self._pressed[0]:
            self._pressed[0] = 0
            self._start_by_button()
        if self._feed.is_on:
            self._go_on()
        elif self._due and self._is_free():
            self._begin()

    def _is_free(self) -> bool:
        """Nothing moves or is going to, and the sender has said nothing that is not done."""
        machine = self._machine
        at_rest = machine.at_rest() or machine.state.run == st.CHECK
        return at_rest and not machine.reader.has_line()

    def _begin(self) -> None:
        name, self._due = self._due, ""
        try:
            file = self._shelf.open(name)
        except OSError:
            self._tell(name, "cannot be read")
            return
        self._name, self._refused = name, 0
        self._note(1)
        self._tell(name, "begins")
        self._feed.start(file, self._shelf.size(name))

    def _start_by_button(self) -> None:
        name = self._kept(_BUTTON)
        is_idle = self._machine.state.run == st.IDLE and not (self._feed.is_on or self._due)
        if name and is_idle and self._is_free() and self._shelf.size(name[0]) >= 0:
            self._due = name[0]

    def _go_on(self) -> None:
        feed = self._feed
        feed.answer()
        if feed.has_ended() and self._is_free():
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
        machine = self._machine
        if machine.state.run == st.IDLE:
            machine.interpreter.execute(bytearray(b"M5M9\0"), 4)
        self._note(line)
        why = "is refused with %d" % self._refused if self._refused else "cannot be read"
        self._tell(self._name, "line %d %s" % (line, why))

    def program_ends(self) -> None:
        """M2 or M30: what is behind it is not done."""
        if self._feed.is_on:
            self._feed.cut()

    def begin_anew(self) -> None:
        """Behind power-up or a reset: what ran has come to its end."""
        self._due = ""
        self._pressed[0] = 0
        if self._feed.is_on:
            line = self._feed.made()
            self._feed.drop()
            self._note(line)
            self._tell(self._name, "stopped at line %d" % line)
        elif not self._has_started:
            kept = self._kept(_JOURNAL)
            if len(kept) > 1:
                self._tell(kept[0], "did not come to its end; last noted: line " + kept[1])
        self._has_started = True

    @micropython.native
    def press(self, active: int) -> None:
        """A control input has changed. Interrupt."""
        if active & START:
            self._pressed[0] = 1

    # What is told and kept

    def field(self) -> str:
        """A status report's."""
        if not self._feed.is_on:
            return ""
        return "SD:%.1f,/%s" % (self._feed.percent(), self._name)

    def _tell(self, name: str, what: str) -> None:
        self._cnc.message("Job %s: %s" % (shown(name), what))

    def _note_line(self) -> None:
        """Motion is held."""
        self._note(self._feed.made())

    def _note(self, line: int) -> None:
        """Keep where the job is; 0: it is done."""
        self._machine.saves.save(_JOURNAL, [self._name, str(line)] if line else [])
        self._machine.keep()
