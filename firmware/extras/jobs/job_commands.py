"""Commands for jobs: programs stored on the board, which run without a computer.

As in grblHAL, $F lists them, $F=NAME runs one, $F<=NAME shows it, $FD=NAME deletes it. As in
FluidNC, there are $SD/List, $SD/Run=, $LocalFS/… too. $FU=NAME,SIZE,CRC receives one
(job_upload.py). $FB=NAME assigns one to the start button. $F=NAME@LINE starts at a line in its
middle (job_entry.py), $F=@ where the last one was held or stopped (job_run.py). JOBS = "jobs" in
the board file, the name of the folder, selects this. SD_CARD, its pins, stores the jobs on a card.
"""

from base import errors
from base import state as st
from base.errors import GrblError
from base.text import sanitize, text_of
from micropython import const
from talk.lines import LineReader

from extras.jobs.job_run import BUTTON, JobRun
from extras.jobs.job_upload import Upload

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType

    from interfaces import JobFiles, Options

    from extras.api import Cnc

PINS = ("SD_CARD",)

# FluidNC's words after $SD/ and $LocalFS/, and ours after $F.
_FLUIDNC = {b"LIST": b"", b"RUN": b"=", b"SHOW": b"<=", b"DELETE": b"D="}
_WITHOUT_FILES = (b"B", b"B=")  # report or clear the button's job: in flash, not on a card
_STATES = (st.IDLE, st.ALARM, st.CHECK)
_SHOWN_BYTES = const(128)  # of a job, sent at once
# A reader for text that is neither the sender's line nor the job's.
_READ_AHEAD = const(512)  # bytes of its ring
_LONGEST_LINE = const(344)  # 256 bytes in base64

_found: "dict[str, JobFiles | None]" = {}


def prepare(options: "Options", board: "ModuleType") -> None:
    """Note the job files of the board."""
    _found["files"] = options.job_files


def install(cnc: "Cnc") -> None:
    """Add the commands and hooks of jobs."""
    files = _found["files"]
    assert files
    files.on_progress = cnc.service
    link = cnc.machine.protocol.link  # before JobRun puts its own around it
    reader = LineReader(_READ_AHEAD, _LONGEST_LINE, cnc.machine.reader.post)
    cnc.job = run = JobRun(cnc, files, reader)
    jobs = Jobs(cnc, files, run, Upload(cnc, files, reader))
    # A network link sends some output to all clients, by how it begins; a file may begin so, too.
    jobs.send_text = getattr(link, "answer", link.write)
    cnc.add_command(b"F", jobs.command, _STATES)
    cnc.add_command(b"SD", jobs.fluidnc, _STATES)
    cnc.add_command(b"LOCALFS", jobs.fluidnc, _STATES)
    cnc.add_field(run.field)
    cnc.before_lines(run.poll_job)
    cnc.after_reset(run.on_reset)
    cnc.after_alarm(run.alarm)
    cnc.after_program(run.on_program_end)
    cnc.after_controls(run.on_controls)


class Jobs:
    """The commands of jobs. send_text: sends a part of a file to the sender that asked."""

    send_text: "Callable[[bytes], object]"

    def __init__(self, cnc: "Cnc", files: "JobFiles", run: JobRun, upload: Upload) -> None:
        self._cnc = cnc
        self._machine = cnc.machine
        self._files = files
        self._run = run
        self._upload = upload

    def fluidnc(self, words: bytes) -> None:
        """Execute the text after $SD/ or $LocalFS/. The reader drops the slash."""
        word, equals, name = words.partition(b"=")
        verb = _FLUIDNC.get(word)
        # LIST, whose verb is empty, has no = and name; the others need both.
        if verb is None or bool(equals) != bool(verb):
            raise GrblError(errors.INVALID_STATEMENT)
        self.command(verb + name)

    def command(self, words: bytes) -> None:
        """Execute the text after $F (words). GrblError if it is refused or a card cannot be read,
        OSError if flash cannot."""
        if self._run.is_on():  # a line of the job itself
            raise GrblError(errors.IDLE_ERROR)
        self._machine.canon.synchronise()  # files are written only while idle
        try:
            if words not in _WITHOUT_FILES:
                self._files.mount()
            self._execute(words)
        except OSError:
            if not self._files.lose():  # it is no card
                raise
            self._cnc.message("SD card is missing, or it cannot be read or written")
            raise GrblError(errors.INVALID_STATEMENT)

    def _execute(self, words: bytes) -> None:
        """Execute the text after $F: nothing or + (list), M (mount), B (report the button), or a
        verb (none: run), = and a name. GrblError refuses it."""
        verb, equals, rest = words.partition(b"=")
        name = text_of(rest)
        if words in (b"", b"+"):
            self._list()
        elif words == b"M":
            return  # command() has mounted the files
        elif words == b"B":
            self._report_button()
        elif not equals:
            raise GrblError(errors.INVALID_STATEMENT)
        elif verb == b"":
            self._request_job(name)
        elif verb == b"<":
            self._show(self._existing_name(name))
        elif verb == b"D":
            self._files.delete(self._existing_name(name))
        elif verb == b"U":
            self._upload.receive_file(name)
        elif verb == b"B":
            self._assign_button(name)
        else:
            raise GrblError(errors.INVALID_STATEMENT)

    def _existing_name(self, name: str) -> str:
        """Return the name. GrblError if there is no such job."""
        if self._files.size(name) < 0:
            self._cnc.message("There is no job %s: $F lists them" % sanitize(name))
            raise GrblError(errors.INVALID_STATEMENT)
        return name

    def _list(self) -> None:
        """Send the names and sizes of all jobs, and the free space."""
        for name, size in self._files.files():
            self._cnc.write_line(b"[FILE:/%s|SIZE:%d]" % (name.encode(), size))
        self._cnc.message("Free space: %d kB" % self._files.free_kb())

    def _show(self, name: str) -> None:
        """Send the text of a job."""
        with self._files.open(name) as file:
            while True:
                piece = file.read(_SHOWN_BYTES)
                if not piece:
                    break
                self.send_text(piece)
                self._cnc.service()
        self.send_text(b"\r\n")

    def _report_button(self) -> None:
        """Report the start button's job."""
        names = self._run.stored(BUTTON)  # one, or none
        self._cnc.message("Start button: " + (sanitize(names[0]) if names else "no job"))

    def _assign_button(self, name: str) -> None:
        """Assign a job to the start button; "" for none."""
        self._machine.saves.save(BUTTON, [self._existing_name(name)] if name else [])

    def _request_job(self, name: str) -> None:
        """Request a job: NAME, NAME@LINE, or NAME@ and @ for the noted line of the unfinished job;
        or a comma for the @. GrblError if it cannot start."""
        if self._machine.state.run == st.ALARM:
            raise GrblError(errors.SYSTEM_GC_LOCK)
        name = name.replace(",", "@")  # where @ is a real-time byte
        starts_in_middle = "@" in name
        name, _, number = name.partition("@")
        if starts_in_middle and not number:
            name, number = self._unfinished_job(name)
        try:
            line = int(number) if starts_in_middle else 1
        except ValueError:
            line = 0  # refused, as numbers below 1
        if line < 1:
            raise GrblError(errors.BAD_NUMBER_FORMAT)
        name = self._existing_name(name)
        if starts_in_middle and not self._machine.homing_probing.homed:
            self._run.report(name, "to start at a line within the job, home first ($H)")
            raise GrblError(errors.INVALID_STATEMENT)
        self._run.request(name, line if starts_in_middle else 0)  # 0: from the beginning

    def _unfinished_job(self, name: str) -> "tuple[str, str]":
        """Return the unfinished job and its last noted line, as text. name: of that job, or "".
        GrblError if none is noted, or another one."""
        journal = self._run.journal()  # its name, line and state; empty without one
        if journal:
            unfinished_name, line, _ = journal
            if name in ("", unfinished_name):
                return unfinished_name, line
        self._cnc.message("No unfinished job" + (" of that name" if name else ""))
        raise GrblError(errors.INVALID_STATEMENT)
