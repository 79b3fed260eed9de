"""The command `ugrbl conformance`."""

import statistics
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import serial
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from ..boardfile.files import load_board
from ..device.connection import BAUD, SendError, broke, open_port
from ..paths import CONVERSATIONS
from ..replay.conformance import Outcome, Results, run_folder, run_port
from .outputs import check_outputs, failed, save_json

_READ_S = 0.002  # how long a read of the serial port waits for bytes


def _side_by_side(outcome: Outcome) -> Iterator[tuple[str, str, str]]:
    """Yield number, expected and observed result of every step, for the table of a failing case.

    docs/conformance.md has the keys of a step. An observed one has lines, and may have moved and
    out."""
    for number, step in enumerate(outcome.expected):
        ours = outcome.got[number] if number < len(outcome.got) else {"lines": ["(not reached)"]}
        expected = [*step["expect"]]
        got = [*ours["lines"]]
        if "moved" in ours and (step.get("moved") or any(ours["moved"])):  # steps of each axis
            note = " (not required)" if step.get("moving") or step.get("moved_varies") else ""
            expected.append(f"moved {step.get('moved', [0, 0, 0])}{note}")
            got.append(f"moved {ours['moved']}")
        if step.get("out") or ours.get("out"):  # changes of outputs
            expected.append(f"out {step.get('out', {})}")
            got.append(f"out {ours.get('out', {})}")
        conditions = [key for key in ("moving", "moved_varies") if step.get(key)]
        if "compare" in step:
            conditions.append(step["compare"])
        for key in ("pins", "switches", "power"):
            if key in step:
                conditions.append(f"{key} {step[key]}")
        head = f"{number} {step['send']!r} {step['wait']} {' '.join(conditions)}"
        yield head, "\n".join(expected), "\n".join(got)


def _table() -> Table:
    names = ("step", "expected", "got")
    return Table(*(Column(name, overflow="fold") for name in names), show_lines=True)


def show(results: Results, console: Console, most: int = 20) -> None:
    """Print the failing cases, at most `most`, then n of m per category, how the durations of
    motions compare with Grbl's, and which known differences were met."""
    for outcome in results.failures()[:most]:
        title = f"{outcome.category}: {outcome.name}"
        console.print(f"\n[bold red]{escape(title)}[/]")
        for line in outcome.wrong:
            console.print(f"  {escape(line)}", highlight=False)
        if outcome.expected:
            table = _table()
            for head, expected, got in _side_by_side(outcome):
                style = "" if expected == got else "yellow"
                table.add_row(escape(head), escape(expected), escape(got), style=style)
            console.print(table)
    if len(results.failures()) > most:
        console.print(f"\n… and {len(results.failures()) - most} more (--json has them all)")
    for name, (passed, total) in results.categories().items():
        mark = "[green]" if passed == total else "[red]"
        console.print(f"{mark}{name}: {passed} of {total}[/]", highlight=False)
    required = len(results.required())
    skipped = len(results.outcomes) - required
    console.print(
        f"{required - len(results.failures())} of {required} conform, {skipped} not required"
    )
    if ratios := results.time_ratios():
        low, middle, high = ratios[0], statistics.median(ratios), ratios[-1]  # they are sorted
        console.print(
            f"{len(ratios)} motions: median duration {middle:.4f} x Grbl's, "
            f"range {low:.3f} to {high:.3f}",
            highlight=False,
        )
    used = Counter(name for outcome in results.outcomes for name in outcome.differences)
    for name, count in used.items():
        console.print(f"known difference {name}: {count} times", highlight=False)


def command(
    folder: Annotated[
        Path,
        typer.Argument(metavar="DIR", help="Folder of recordings. [default: those of ugrbl]"),
    ] = CONVERSATIONS,
    python: Annotated[
        str, typer.Option(help="Python that runs the firmware: cpython or micropython.")
    ] = "cpython",
    port: Annotated[
        str | None, typer.Option(help="Serial port of a real device. The machine will move!")
    ] = None,
    only: Annotated[
        str | None,
        typer.Option(
            metavar="CATEGORY", help="Replay only this category: a file's name, or motion."
        ),
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option(
            "--json", metavar="FILE", help="Write all results to this file; - is stdout."
        ),
    ] = None,
    board: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Simulator board. [default: as each file requires]"),
    ] = None,
) -> None:
    """Replay recordings of real Grbl; count equal answers.

    docs/conformance.md describes these recordings.
    """
    if python not in ("cpython", "micropython"):
        raise typer.BadParameter("--python must be cpython or micropython")
    if not folder.is_dir():
        raise typer.BadParameter(f"there is no folder {folder}")
    try:
        check_outputs(json_file, given=locals())
        if board is not None:
            load_board(board)
        if port:
            results = run_port(folder, open_port(port, BAUD, _READ_S), only)
        else:
            results = run_folder(folder, python, only, board)
        if json_file:
            save_json(results.as_json(), json_file)
    except serial.SerialException as error:
        raise failed(broke(port or "")) from error
    except (ValueError, OSError, SendError) as error:
        raise failed(error) from error
    show(results, Console(stderr=str(json_file) == "-"))
    if not results.ok():
        raise typer.Exit(1)
