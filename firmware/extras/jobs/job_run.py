"""Job run: the running or requested job, from its first line to its last, or to what ends it.

The job's name, and the line at which it was held or stopped, are stored in flash while idle.
"""

import binascii
import io
import json
from array import array

import micropython
from base import state as st
from base.controls import START
from base.text import sanitize
from control.coords import NAMES
from control.modes import COOLANT, SPINDLE
from micropython import const

from extras.jobs.job_entry import CannotEnter, Entry, differs, program_state
from extras.jobs.job_feed import Feed

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import IO, Any

    from interfaces import JobFiles
    from talk.lines import LineReader

    from extras.api import Cnc

# Names in flash. The journal has three lines: the unfinished job, its line number, and _origin as
# JSON. It is empty if the last job is done. BUTTON has the start button's job.
_JOURNAL = "job"
_JOURNAL_LINES = const(3)
BUTTON = "button"
_STALE_PRESS_MS = const(50)  # an older press is ignored: something else ran meanwhile
# Indices of _origin, what a later start in the middle needs.
_CRC = const(0)  # CRC-32 of the job's file
_STATE_BEFORE = const(1)  # program_state() before its first line
_WRITTEN_OFFSETS = const(2)  # stored offsets it wrote: [index, values before, values now] each
_CRC_UNKNOWN = const(-1)
_PIECE_BYTES = const(512)


class JobRun:
    """The job. No other part uses `reader` while it runs.

    _name, _size: the running job, and the bytes of its file; _origin: list, see _CRC and so on.
    _requested: the requested job, "" for none; _requested_line: its first line, 0 for all of it;
    _requested_crc: CRC-32 of its file, or _CRC_UNKNOWN. _file_to_enter: the file, while the tool
    approaches its line, else None. _refused: Grbl's error number of the line that has ended the
    job, 0 for none. _pressed[0]: the start button was pressed, at _pressed_ms.
    """

    def __init__(self, cnc: "Cnc", files: "JobFiles", reader: "LineReader") -> None:
        self._cnc = cnc
        self._machine = cnc.machine
        self._files = files
        self._feed = feed = Feed(cnc.machine, self._refuse, self._store_held_line)
        self.has_partial_line = feed.has_partial_line  # for net_access.py
        self.drop_partial_line = feed.drop_partial_line
        hooks = cnc.machine.state.hooks
        hooks.is_busy += (self.is_on,)  # a job that waits, in a dwell for example, is not idle
        self._previous_write, hooks.write_offsets = hooks.write_offsets, self._write_offsets
        self._entry = Entry(cnc, reader)
        self._name = self._requested = ""
        self._origin: "list[Any]" = []
        self._pressed_ms = self._requested_line = self._size = self._refused = 0
        self._requested_crc = _CRC_UNKNOWN
        self._file_to_enter: "IO[bytes] | None" = None
        self._pressed = bytearray(1)
        self._has_started = False  # on_reset() has run once
        self._is_check = False  # the job was started in check mode

    def is_on(self) -> bool:
        """Return whether a job runs."""
        return self._feed.is_on

    def request(self, name: str, line: int) -> None:
        """Request a job. It starts when the sender's lines are done. line: its first, or 0."""
        self._requested, self._requested_line, self._requested_crc = name, line, _CRC_UNKNOWN

    @micropython.native
    def poll_job(self) -> None:
        """Run the job's part of the main loop, between two lines: handle the start button, go on
        with the running job, or start the requested one."""
        if self._pressed[0]:
            self._pressed[0] = 0
            if self._machine.port.elapsed_ms(self._pressed_ms) < _STALE_PRESS_MS:
                self._start_by_button()
        if self._feed.is_on:
            self._advance_job()
        elif self._requested and self._is_free():
            self._start_requested()

    def _is_free(self) -> bool:
        """Return whether the machine is idle and all lines of the sender are done."""
        machine = self._machine
        at_rest = machine.stands() or machine.state.run == st.CHECK
        return at_rest and not machine.reader.has_line()

    def _start_requested(self) -> None:
        """Start the requested job, or the approach to its first line; report why if that is
        impossible. It waits again if the sender has sent a line meanwhile."""
        name, line, self._requested = self._requested, self._requested_line, ""
        try:
            self._files.mount()
            file = self._files.open(name)
        except OSError:
            self._files.lose()  # so that the next mount() starts anew
            self.report(name, "cannot be read")
            return
        self._name, self._refused = name, 0
        self._is_check = self._machine.state.run == st.CHECK  # the job itself may contain $C
        try:
            self._read_size_and_crc(file)
            if self._machine.reader.has_line():
                self._requested = name  # the sender's line goes first
                file.close()
                return
            self._origin = [self._requested_crc, program_state(self._machine), []]  # see _CRC
            if line:
                self._prepare_approach(file, line)
        except CannotEnter as why:
            self._give_up(file, str(why))
            return
        except OSError:
            self._give_up(file, "cannot be read")
            self._files.lose()
            return
        except BaseException:
            file.close()
            raise
        if line:
            self._start_approach(file, line)
            return
        self._store_line(1)  # its first line is in progress
        self.report(name, "begins")
        self._feed.start(file, self._size)

    def _read_size_and_crc(self, file: "IO[bytes]") -> None:
        """Set _size, and _requested_crc unless it is known. Leave the file at its beginning.
        CannotEnter if the machine is held meanwhile."""
        if self._requested_crc == _CRC_UNKNOWN:
            crc, piece = 0, file.read(_PIECE_BYTES)
            while piece:
                crc = binascii.crc32(piece, crc)
                if len(piece) == _PIECE_BYTES:  # a shorter one is the last
                    self._entry.poll_realtime()
                piece = file.read(_PIECE_BYTES)
            self._requested_crc = crc
        self._size = file.seek(0, 2)  # the end of the file
        file.seek(0)

    def _prepare_approach(self, file: "IO[bytes]", line: int) -> None:
        """Prepare the approach to a line.

        Entry.rehearse() runs the lines before it in check mode. They start from the modes and
        offsets of the journal if it is of this job. Spindle and coolant are switched off; the
        lines of Entry.approach_lines() start them again. CannotEnter if the state at the line is
        not certain.
        """
        journal = self.journal()  # name, line, and _origin as JSON
        if self._machine.state.run != st.IDLE or not self._machine.homing_probing.homed:
            raise CannotEnter("the machine is not homed, or not idle")
        if journal and journal[0] == self._name:  # this job was interrupted
            self._origin = json.loads(journal[2])
            if self._origin[_CRC] != self._requested_crc:
                raise CannotEnter("the file has changed since that job stopped")
        offsets_before = self._offsets_at_start()
        self._tool_off()
        self._entry.rehearse(file, line, self._origin[_STATE_BEFORE], offsets_before)

    def _start_approach(self, file: "IO[bytes]", line: int) -> None:
        """Start the approach to a line."""
        self._file_to_enter = file
        approach = [text for text in self._entry.approach_lines() if text]
        self.report(self._name, "continues at line %d" % line)
        lines = io.BytesIO(("\n".join(approach) + "\n").encode())
        # The lines of the approach count as the last ones before `line`.
        self._feed.start(lines, self._size, line - 1 - len(approach))

    def _offsets_at_start(self) -> "list[array[float]]":
        """Return a copy of the stored offsets, as they were before the job has written some.

        CannotEnter if some of these have been written by others since.
        """
        systems = [array("f", values) for values in self._machine.coords.systems]
        for index, values_before, written in self._origin[_WRITTEN_OFFSETS]:
            for axis in range(len(written)):
                if differs(written[axis], systems[index][axis]):
                    text = "%s was changed since the job set it: its value is uncertain"
                    raise CannotEnter(text % NAMES[index])
            systems[index] = array("f", values_before)
        return systems

    def _write_offsets(self, index: int, values: "array[float]") -> None:
        """Set and store a system of offsets (index, mm per axis), as Coords.write(). A job's are
        noted before and now, with its line, so that a later start can take them back."""
        if self._feed.is_on and self._machine.state.run != st.CHECK:
            written = self._origin[_WRITTEN_OFFSETS]  # rows of index, values before, values now
            rows = [row for row in written if row[0] == index]  # one, or none yet
            if not rows:
                rows = [[index, list(self._machine.coords.systems[index]), []]]
                written.extend(rows)
            rows[0][2] = list(values)
            self._save_journal(self._feed.line() + 1)  # the line that writes has no answer yet
        self._previous_write(index, values)

    def _start_file(self, file: "IO[bytes]") -> None:
        """Start the file's lines, after the approach: apply the modes that hold there first."""
        self._file_to_enter = None
        line = self._feed.line()  # the one before the first: see _start_approach()
        try:
            self._entry.apply_modes()
        except CannotEnter as why:
            self._feed.stop()
            self._give_up(file, str(why))
            return
        self._feed.stop()
        self._store_line(line + 1)
        self._feed.start(file, self._size, line)

    def _give_up(self, file: "IO[bytes]", why: str) -> None:
        """Close the file of a job that cannot start, and report why."""
        file.close()
        self.report(self._name, why)

    def _start_by_button(self) -> None:
        """Request the start button's job, if the machine is idle and the file exists."""
        name = (self.stored(BUTTON) or [""])[0]  # "" if none is assigned
        is_idle = self._machine.state.run == st.IDLE and not (self._feed.is_on or self._requested)
        if name and is_idle and self._is_free():
            try:
                self._files.mount()
                if self._files.size(name) >= 0:
                    self.request(name, 0)
            except OSError:
                self._files.lose()
                self.report(name, "the SD card is missing")

    def _advance_job(self) -> None:
        """Answer the sender; once all lines are executed, go on from the approach to the file, or
        end the job and report how."""
        feed = self._feed
        feed.answer()
        if feed.has_ended() and self._is_free():
            if self._file_to_enter and not self._refused:
                self._start_file(self._file_to_enter)
                return
            line = feed.line()
            feed.stop()
            if self._refused or feed.fault:
                self._report_refusal(line + 1)
            else:
                if not self._is_check:
                    self._tool_off()  # perhaps nobody is there
                self._store_line(0)
                self.report(self._name, "done, %d lines" % line)

    def _refuse(self, code: int) -> None:
        """Note that a line of the file was refused, and drop the lines after it."""
        self._refused = code
        self._feed.stop_reading()

    def _report_refusal(self, line: int) -> None:
        """Switch the tool off, and report the line refused or not read, when motion has ended."""
        self._tool_off()
        if self._refused:
            why = "is refused with %d" % self._refused
        else:
            why = "cannot be read"
            self._files.lose()
        if self._file_to_enter:
            self._close_file_to_enter()
            self.report(self._name, "the move to its start " + why)
            return
        self._store_line(line)
        self.report(self._name, "line %d %s" % (line, why))

    def _tool_off(self) -> None:
        """Switch spindle and coolant off, in any state, without a move."""
        machine = self._machine
        machine.canon.safe()
        machine.modes.modal[SPINDLE] = machine.modes.modal[COOLANT] = 0

    def _close_file_to_enter(self) -> None:
        """Close the file of a job that is still approaching its line."""
        if self._file_to_enter:
            self._file_to_enter.close()
            self._file_to_enter = None

    def line_at_stop(self, is_certain: bool) -> "tuple[int, int]":
        """Return the line at which the running job has stopped, and the CRC-32 of its file; zeros
        without a job, during its approach and in check mode.

        is_certain: motion has ended by itself. Else it was stopped at once, and the line is that
        of 40 to 80 ms before.
        """
        if not self._feed.is_on or self._file_to_enter or self._machine.state.run == st.CHECK:
            return 0, 0
        line = self._feed.line_in_motion() if is_certain else self._feed.executed_line()
        return line, self._origin[_CRC]

    def correct(self, line: int, crc: int) -> str:
        """Store another line in the journal if the file of the unfinished job has this CRC-32.
        Return the job's name, or "" otherwise."""
        journal = self.journal()
        if not journal:
            return ""
        name, _, origin = journal
        if json.loads(origin)[_CRC] != crc:
            return ""
        self._machine.saves.save(_JOURNAL, [name, str(line), origin])
        self._machine.save_due()
        return name

    def on_program_end(self) -> None:
        """Drop the lines after M2 or M30."""
        self._entry.has_ended = True  # matters if the lines before the entry are run
        if self._feed.is_on:
            self._feed.stop_reading()

    def alarm(self, _code: int) -> None:
        """Note the line of a job after an alarm. Homing is needed, because position may be lost.

        The line is stored at once, because the user may switch the board off.
        """
        self._machine.homing_probing.homed = 0
        self._requested = ""
        if self._feed.is_on:
            self._store_held_line()

    def on_reset(self) -> None:
        """End the job, after power-up or a reset."""
        self._requested = ""
        self._pressed[0] = 0
        if self._feed.is_on:
            line = self._feed.executed_line()
            self._feed.drop()
            if self._file_to_enter:
                self._close_file_to_enter()
                self.report(self._name, "stopped while moving to the start line")
            else:
                self._store_line(line)
                self.report(self._name, "stopped at line %d" % line)
        else:
            self._close_file_to_enter()
        if not self._has_started:
            self.stored(BUTTON)  # reports a damaged file at power-up
            journal = self.journal()
            if journal:
                self.report(journal[0], "did not finish; last recorded line: " + journal[1])
        self._has_started = True

    @micropython.native
    def on_controls(self, active: int) -> None:
        """Note a press of the start button. Interrupt. A press that ends a hold starts no job."""
        state = self._machine.state
        if active & START and state.run == st.IDLE and not state.suspend:
            self._pressed_ms = self._machine.port.ticks_ms()
            self._pressed[0] = 1

    # Reports and stored data

    def field(self) -> str:
        """Return the field of the status report, as grblHAL's; "" without a job."""
        if not self._feed.is_on:
            return ""
        return "SD:%.1f,/%s" % (self._feed.percent(), self._name)

    def report(self, name: str, what: str) -> None:
        """Send a message about a job."""
        self._cnc.message("Job %s: %s" % (sanitize(name), what))

    def stored(self, what: str) -> "list[str]":
        """Return the lines stored in flash under that name."""
        return self._machine.saves.load(what) or []

    def journal(self) -> "list[str]":
        """Return the stored lines of the unfinished job; empty without one."""
        lines = self.stored(_JOURNAL)
        return lines if len(lines) == _JOURNAL_LINES else []

    def _store_held_line(self) -> None:
        """Store the line at which motion is held, or was stopped by an alarm."""
        if not self._file_to_enter:
            self._store_line(self._feed.executed_line())

    def _store_line(self, line: int) -> None:
        """Store the job's line in the journal; 0: the job is done."""
        if self._machine.state.run == st.CHECK:
            return  # nothing was executed
        self._save_journal(line)
        self._machine.save_due()

    def _save_journal(self, line: int) -> None:
        """Save the journal with the job's line, or an empty one for 0; it is written later."""
        journal = [self._name, str(line), json.dumps(self._origin)] if line else []
        self._machine.saves.save(_JOURNAL, journal)
