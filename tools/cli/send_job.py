"""The work of `ugrbl send`: examine the machine, rehearse the program, send it, show the
result."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import typer
from rich.console import Console
from rich.markup import escape

from ..device import checkup, machine_snapshot
from ..device.connection import Connection, way_out
from ..device.from_line import Approach, approach
from ..device.machine_snapshot import MachineSnapshot
from ..device.send import REFUSED, Line, Ready, Report, Stream
from ..device.stop_signals import stopping_signals
from ..grbl import gcode_file
from ..grbl.custom_codes import CustomCodes
from ..grbl.lines import Changed
from ..grbl.messages import meaning
from ..grbl.settings_file import Firmware
from ..run import own_python, rehearsal
from ..run.machine import DEFAULT_AXES, DEFAULT_BOARD
from ..run.rehearsal import Forecast, Rehearsal
from . import keys
from .screen import Screen, show_errors, show_foreign, show_wide_arcs

# Time limit for finding the line that was executed at a stop.
_PATIENCE_S = 20.0
# Grbl's answer to an unknown word.
_UNKNOWN = "error:20"
# Alarms after which Grbl accepts only a reset.
_RESET_ONLY = ("ALARM:1:", "ALARM:2:")


@dataclass
class Options:
    """The options of the command line."""

    name: str
    board: str | None = None
    check: bool = True
    by_line: bool = False
    keep_going: bool = False
    from_line: int = 1
    yes: bool = False
    custom: Path | None = None
    inputs: tuple[str, ...] = ()


class Stopped(Exception):
    """Nothing is sent; the text says why."""


class Job:
    """One program for one machine."""

    def __init__(
        self, lines: Sequence[bytes], options: Options, connection: Connection, console: Console
    ) -> None:
        self._lines = lines
        self._options = options
        self._connection = connection
        self._console = console
        self._machine = MachineSnapshot()  # its state before the program
        self._letters = ""  # of the machine's options in $I
        self._custom_codes = CustomCodes()  # the machine's, from $I
        self._rehearsal: Rehearsal | None = None
        self._approach_lines = 0  # how many lines are sent before the program's first one

    def run(self) -> Report:
        """Check the program, send it, show the result. Stopped if nothing is sent."""
        self._connection.start()
        try:
            report = self._send(self._prepare())
            if report.stopped:
                self._show_end(report)
            return report
        finally:
            if self._rehearsal:
                self._rehearsal.close()

    def _prepare(self) -> Sequence[Line]:
        """Return the lines to send: the program, or with --from-line an approach and the rest."""
        options = self._options
        to_send = Ready(self._lines)
        if not options.check and options.from_line == 1:
            return to_send
        if why := self._cannot_rehearse():
            if options.from_line > 1:
                raise Stopped(f"--from-line cannot be simulated: {why}")
            self._print(f"the program is not checked: {why}")
            return to_send
        job = self._rehearsal_job()
        if options.check:
            self._check(job)
        self._rehearsal = Rehearsal(job)
        if options.from_line == 1:
            return to_send
        lines_before = self._approach(self._rehearsal)
        self._approach_lines = len(lines_before)
        return Ready(self._lines, options.from_line, lines_before)

    def _cannot_rehearse(self) -> str:
        """Read the machine's state, settings and own words. Return why the simulator would differ
        from the machine; "" if it would not."""
        state = self._connection.state()
        if state != "Idle":
            return f"the machine is in {state}"
        found = Firmware.read(self._connection.info)
        self._custom_codes = CustomCodes.read(self._connection.info)
        if checkup.is_relative(found):
            return (
                f"{found.name} is a variant of Grbl, and accepts words that the simulator refuses"
            )
        self._machine = machine_snapshot.read_machine(self._connection)
        if not self._machine.place:
            return "the machine does not report its position: set $10=1"
        if self._machine.axes() > DEFAULT_AXES and self._options.from_line > 1:
            return "only X, Y and Z can be restored, and the machine has more axes"
        if self._options.board is None:
            self._letters = found.options.partition(",")[0]
        return ""

    def _rehearsal_job(self) -> rehearsal.Job:
        """Return what the simulator is to run: the program, from the machine's own state."""
        options = self._options
        report_state_before_line = options.from_line if options.from_line > 1 else 0  # 0: never
        return rehearsal.Job(
            Changed(self._lines, gcode_file.sanitize),
            self._machine.commands(),
            options.board or DEFAULT_BOARD,
            report_state_before_line,
            letters=self._letters,
            axes=DEFAULT_AXES if options.board else max(self._machine.axes(), DEFAULT_AXES),
            custom=str(options.custom or ""),
            inputs=list(options.inputs),
        )

    def _check(self, job: rehearsal.Job) -> None:
        """Let the simulator run the program, and show what it refuses.

        Raises Stopped if it is not to be sent.
        """
        total = len(self._lines)
        with self._console.status("checking …") as status:
            result, line = rehearsal.check(
                job, lambda done: status.update(f"checking: line {done} of {total} …")
            )
        self._check_same_custom(result.own)
        # (line, reply), without refused words that the machine itself knows
        errors = [error for error in result.errors if not self._is_custom(*error)]
        self._show_unknown([error[0] for error in result.errors if error not in errors])
        show_errors(self._console, errors, self._lines)
        show_foreign(self._console, errors, self._lines)
        show_wide_arcs(self._console, result.wide_arcs)
        wrong = len(errors)
        if result.stopped:  # an alarm, or the reply to the line after which it cannot go on
            wrong += 1
            why = meaning(result.stopped) if result.stopped.startswith("ALARM:") else ""
            self._print(": ".join(filter(None, [f"line {line}", result.stopped, why])))
        if not wrong or self._options.keep_going:
            return
        words = "1 line would be refused" if wrong == 1 else f"{wrong} lines would be refused"
        if not self._confirm(f"{words}. Send the program anyway?"):
            raise Stopped(f"{words}; nothing was sent (--no-check sends it)")

    def _is_custom(self, number: int, reply: str) -> bool:
        """Return whether the simulator refuses a line only for a word that the machine has, or may
        have, because its list in $I is cut."""
        line = self._lines[number - 1]
        return reply == _UNKNOWN and (
            self._custom_codes.is_cut or bool(self._custom_codes.word_in(line))
        )

    def _show_unknown(self, numbers: Sequence[int]) -> None:
        """Show the first of the lines with words of the machine's own, and how many more there
        are. They are not counted as errors."""
        if not numbers:
            return
        line = self._lines[numbers[0] - 1]
        what = f"line {numbers[0]}, {self._custom_codes.word_in(line) or gcode_file.shown(line)}"
        more = len(numbers) - 1
        what += f", and {more} more line{'s' * (more > 1)}" if more else ""
        self._print(f"unknown to the simulator: {what}; {self._todo('them' if more else 'it')}")

    def _todo(self, what: str = "it") -> str:
        """Return the next step if the simulator does not know words of the machine's own."""
        if self._options.custom:
            return f"{self._options.custom} does not have {what}"
        return f"--custom FILE simulates {what}"

    def _check_position(self, forecast: Forecast) -> None:
        """Raise Stopped if lines before the first one may have moved the machine in an unknown
        way."""
        for number in range(1, self._options.from_line):
            line = self._lines[number - 1]
            handler = self._custom_codes.handler_of(line)
            if number in forecast.refused:
                may_be_known = handler or self._custom_codes.is_cut  # to the machine
                todo = self._todo() if may_be_known else "remove it if the machine refuses it, too"
                why = f"the simulator refuses line {number}: {gcode_file.shown(line)}"
            elif handler and not self._options.custom:  # the simulator ran no handler
                why, todo = f"line {number} has the machine run {handler}", self._todo()
            else:
                continue
            raise Stopped(f"{why}; the tool's position after it is not known: {todo}")
        self._check_same_custom(forecast.own)

    def _check_same_custom(self, rehearsed: str) -> None:
        """Raise Stopped if the machine has other Python than was rehearsed. rehearsed: the names
        of the handlers in the file, as $I lists them."""
        on_machine = self._custom_codes.text
        if self._options.custom and rehearsed != on_machine:
            raise Stopped(
                f"{self._options.custom} differs from the Python on the machine: "
                f"{on_machine or 'nothing'} there, {rehearsed} in the file; nothing was sent"
            )

    def _cautions(self, approach: Approach) -> list[str]:
        """Return cautions about the approach, including those about the machine's own Python."""
        cautions = list(approach.cautions)
        for line in approach.lines:
            if handler := self._custom_codes.handler_of(line.data):
                cautions.append(
                    f"before line {self._options.from_line}, {line.text} runs {handler}"
                )
        custom = self._options.custom
        if custom and own_python.read(custom).has_attribute("keep"):
            cautions.append(
                f"{custom} reads stored values (m.keep): the simulator had none, so the machine "
                "may act differently"
            )
        return cautions

    def _approach(self, running: Rehearsal) -> list[Line]:
        """Return the lines that bring the machine to where the first line begins, after the user
        has agreed; else Stopped."""
        number = self._options.from_line
        with self._console.status(f"simulating up to line {number} …"):
            forecast = running.wait()
        if forecast is None:
            raise Stopped("the simulator has failed")
        way = approach(self._lines, number, forecast, self._machine)
        self._check_position(forecast)
        self._print(f"before line {number}, the machine goes")
        for words in way.words:
            self._print(f"  {words}")
        for words in self._cautions(way):
            self._print(f"  note: {words}")
        if not self._options.yes and not self._confirm(
            "Is the way free, and is all of this correct?"
        ):
            raise Stopped("nothing was sent (--yes skips this question)")
        return way.lines

    def _confirm(self, question: str) -> bool:
        """Return whether the user agrees; False without a terminal."""
        return sys.stdin.isatty() and typer.confirm(question)

    def _send(self, to_send: Sequence[Line]) -> Report:
        """Send the lines, with a progress bar and keys, and show how many were done."""
        options = self._options
        if sys.stdin.isatty():
            self._print(keys.HELP)
        seconds_left = self._seconds_left
        with Screen(
            self._console, options.name, len(to_send), seconds_left, listen=True
        ) as screen:
            stream = Stream(self._connection, to_send, screen, options.by_line, options.keep_going)
            with stopping_signals(stream):
                report = stream.run()
            screen.progress(report.answered, f"<{report.state}>")
        done = max(0, report.answered - self._approach_lines)
        errors = len(report.errors)
        self._print(f"{done} lines, {errors} error{'' if errors == 1 else 's'}")
        if report.drains > 0:
            self._print(
                f"{checkup.held_up(report.drains, 'during the program')}: {checkup.WHY_DRAINED}"
            )
        return report

    def _seconds_left(self, done: int) -> float | None:
        """Return the time left after `done` sent lines; None while the rehearsal has none."""
        forecast = self._rehearsal.forecast if self._rehearsal else None
        if forecast is None:
            return None
        of_program = max(0, done - self._approach_lines)
        return forecast.seconds_left(of_program + self._options.from_line - 1)

    def _show_end(self, report: Report) -> None:
        """Show why it ended early, what was executed, and what the machine does now."""
        Console(stderr=True).print(f"[red]stopped: {escape(report.stopped)}", highlight=False)
        by_refusal = report.stopped.endswith(REFUSED)
        if number := self._executed_line(report):
            line = gcode_file.shown(self._lines[number - 1])
            self._print(f"line {number} was being executed: {line}")
            self._print(f"line {report.line} was answered last; to continue: --from-line {number}")
        elif by_refusal and report.stopped != f"line {report.line}{REFUSED}":  # an earlier line
            self._print(
                f"lines up to {report.line} had already been sent by then; some of their moves "
                "may have been executed"
            )
        else:
            most = self._connection.blocks if report.blocks_left is None else report.blocks_left
            self._print(
                f"line {report.line} was answered last; up to {most} moves before it were not "
                "executed"
            )
        state = report.state or "an unknown state"
        if report.lost:
            self._print(f"the machine was in {state}, and goes on with the lines it has received")
        else:
            todo = "" if state == "Idle" else f": {way_out(state)}"
            if report.stopped.startswith(_RESET_ONLY):
                todo = f": reset it (Ctrl-X), then {way_out(state)}"
            self._print(f"the machine is in {state}{todo}")

    def _executed_line(self, report: Report) -> int | None:
        """Return the line that was executed at the stop, if the rehearsal knows it; else None."""
        forecast: Forecast | None = None
        if self._rehearsal and report.place and report.place_line:
            forecast = self._rehearsal.wait(_PATIENCE_S)
        if forecast is None or self._may_have_moved_unknown(report.place_line or 0):
            return None
        place_mm = [coordinate * self._machine.unit_mm() for coordinate in report.place]
        answered = report.place_line  # the last line answered when the position was reported
        return forecast.line_at(answered, place_mm, self._connection.blocks, report.blocks_left)

    def _may_have_moved_unknown(self, last: int) -> bool:
        """Return whether up to that line, or the next one, the machine may have moved in an
        unknown way."""
        lines = self._lines[: last + 1]
        return not self._options.custom and any(map(self._custom_codes.handler_of, lines))

    def _print(self, words: str) -> None:
        """Show a text to the user, on stderr if stdout fails."""
        try:
            self._console.print(words, highlight=False, markup=False, soft_wrap=True)
        except OSError:  # a full disk: stderr may still be a terminal
            Console(stderr=True).print(words, highlight=False, markup=False, soft_wrap=True)
