"""The command `ugrbl selftest`."""

import random
import sys
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from ..device.connection import SendError
from ..device.deploy import DeployError
from ..device.selftest import program
from ..device.selftest.row import Row
from ..device.selftest.session import Board, Wiring, check, look
from . import ports
from .outputs import check_output, examples, save_json

EXAMPLES = examples(
    "ugrbl selftest",
    "ugrbl selftest --port /dev/ttyACM0 --yes",
    "ugrbl selftest --port COM3 --json -",
)
_MARKS = {True: "[green]passed[/]", False: "[red]FAILED[/]", None: "[yellow]      [/]"}
_MOTORS_TURN = "The board file names no ENABLE: motors turn if their drivers have power. Continue?"
_LASER_BURNS = (
    "Test the spindle's output, at up to full power? A laser wired to it burns. (n: run only the "
    "other checks)"
)


class Report:
    """Shows rows at once and stores them."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self.rows: list[Row] = []

    def show_row(self, row: Row) -> None:
        """Show and store the result of a check."""
        self.rows.append(row)
        text = f"{_MARKS[row.passed]} [b]{escape(row.what)}[/b]: {escape(row.text)}"
        self._console.print(text, highlight=False, soft_wrap=True)

    def verdict(self) -> str:
        """Return a summary in one sentence."""
        count = Counter(row.passed for row in self.rows)
        words = [f"{count[True]} passed", f"{count[False]} failed"]
        return ", ".join([*words, *([f"{count[None]} not checked"] if count[None] else [])])


def command(
    port: Annotated[
        str | None, typer.Option(metavar="PORT", help="Serial port. [default: the only one]")
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer repetitions, for a test of some seconds.")
    ] = False,
    yes: Annotated[
        bool,
        typer.Option("--yes", "-y", help="Do not ask; for boards without a wired laser or motor."),
    ] = False,
    seed: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Seed for the random times at which stops are injected. [default: random]",
        ),
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option(
            "--json", metavar="FILE", help="Write the results to this file; - is stdout."
        ),
    ] = None,
) -> None:
    """Test the firmware on the board: nothing wired, drivers off.

    Free machines of the chip's second PIO watch the pins that the first one drives, so no wire is
    needed: steps counted, pulses measured, stops, starts, limits, PWM, flash, a hang. On an ESP32,
    its pulse counters count. The settings stay. A machine in motion is not disturbed. The exit
    code is 1 if something failed.
    """
    check_output(json_file)
    console = Console(stderr=str(json_file) == "-")
    seed = random.randrange(1 << 30) if seed is None else seed
    report = Report(console)
    try:
        where = ports.choose(port)
        _test(_open(where), report, quick, yes, seed)
    except (SendError, DeployError) as error:
        todo = getattr(error, "todo", "")
        report.show_row(Row("the board", False, f"{error}{'; ' if todo else ''}{todo}"))
    except KeyboardInterrupt:
        report.show_row(
            Row(
                "the board",
                False,
                "stopped before the end: unplug the board, and plug it in again",
            )
        )
    console.print(f"[b]{report.verdict()}[/b]; seed {seed}", highlight=False)
    if json_file:
        rows = [row.as_json() for row in report.rows]
        save_json({"checks": rows, "verdict": report.verdict(), "seed": seed}, json_file)
    if any(row.passed is False for row in report.rows):
        raise typer.Exit(1)


def _open(port: str) -> Board:
    from ..device.selftest.device import PromptBoard  # it needs a moment to be imported

    return PromptBoard(port)


def _test(board: Board, report: Report, quick: bool, yes: bool, seed: int) -> None:
    """Run all checks. If they cannot be run, or the user declines, start the firmware again."""
    chip, wiring = look(board)
    try:
        may_use_pwm = _consent(wiring, yes)
        amounts = program.amounts(chip, quick)
        check(board, chip, amounts, may_use_pwm, seed, report.show_row)
    except (DeployError, typer.Abort):
        with suppress(DeployError):  # the first exception says more
            board.start()
        raise


def _consent(wiring: Wiring, yes: bool) -> bool:
    """Return whether the spindle's output may be used; DeployError if nothing may be tested. yes:
    everything may, without a question."""
    ask = sys.stdin.isatty() and not yes
    if wiring.enable is None and not yes and not (ask and typer.confirm(_MOTORS_TURN)):
        raise DeployError(
            "the board file names no ENABLE, so motors would turn",
            "switch off the power of their drivers and use --yes",
        )
    if wiring.spindle_pwm is None or yes:
        return True
    return ask and typer.confirm(_LASER_BURNS)
