"""Test the entry into the middle of real programs: it continues like a whole run.

UGRBL_ENTRIES=1000 tries this number of lines, instead of a few.

$F=NAME@LINE starts a job in its middle: the lines before are only read, for their modes and
offsets. Bench.run() returns the output, Bench.moves_from(line) the recorded moves from a line on.
FAST and HOMED are settings, and $H; with_switches() adds the limit switches that $H needs.
"""

import json
import os
import random
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from control.modes import MODAL_LENGTH
from language.block_layout import MOVE
from motion.arc_geometry import TOLERANCE
from test_jobs import FAST, HOMED, Bench, say, until_job_ends, with_switches
from ugrbl.grbl.gcode_file import read_lines

_PROGRAMS = Path(__file__).resolve().parents[3] / "shared" / "gcode"
_EXPECTED = _PROGRAMS / "expected.json"
_ENTRIES = int(os.environ.get("UGRBL_ENTRIES", "24"))
LASER = ("$32=0", "$32=1")
_COMPARED = 30  # lines after the entry that are compared
_LONGEST = 3000  # lines of a program
# Reasons for which entry is refused.
_REFUSALS = (
    "is inside a drilling cycle",
    " probes: ",
    " ends the program",
    "is refused with ",
    " is too long",
)


class RecordingBench(Bench):
    """Records the moves of the interpreter with the modal state, by lines of the job."""

    def _listen(self) -> None:
        """Record in `log` each planned move: its line in the job, its arguments and the modes."""
        machine = self.rig.controller
        machine.interpreter.watch(MOVE)  # otherwise the kernel would handle some moves
        canon, modes, coords = machine.canon, machine.modes, machine.coords
        call_line, call_arc = canon.line, canon.arc
        link: Any = machine.protocol.link

        def note(target: Any, move: Any, *arc_arguments: Any) -> None:
            """Append the line in the job, and the arguments with modes and offsets, to the log."""
            number = link.line() + 1 if link.is_on else 0  # 0: not from a job
            arguments = tuple(target), move.flags, move.feed, move.spindle_rpm, arc_arguments
            modal = (
                tuple(modes.modal[:MODAL_LENGTH]),
                tuple(modes.rates),
                modes.tool,
                tuple(modes.position),
            )
            offsets = coords.active, tuple(coords.g92), coords.tool_length
            self.log.append((number, (arguments, modal, offsets)))

        def line(target: Any, move: Any) -> None:
            note(target, move)
            call_line(target, move)

        def arc(start: Any, target: Any, arc: Any, move: Any) -> None:
            note(target, move, tuple(start), tuple(arc.plane), tuple(arc.numbers[:TOLERANCE]))
            call_arc(start, target, arc, move)

        canon.line = line  # type: ignore[method-assign]
        canon.arc = arc  # type: ignore[method-assign]


def programs() -> list[str]:
    """Return the names of the real programs that have a suitable number of lines."""
    expected = json.loads(_EXPECTED.read_text()) if _EXPECTED.exists() else {}
    return sorted(name for name, figures in expected.items() if 50 < figures["lines"] <= _LONGEST)


def lines_of(name: str) -> list[str]:
    """Return the lines of a program without its settings, which check mode refuses."""
    lines = [line.decode("latin-1") for line in read_lines(_PROGRAMS / name)]
    return ["" if line.startswith("$") else line for line in lines]


@cache
def log_of_whole_run(name: str, laser: bool, folder: Path) -> list[tuple[int, Any]]:
    """Return the log of a whole run in check mode."""
    bench = RecordingBench(folder, LENIENT=True)
    with_switches(bench).put("ALL.NC", *lines_of(name))
    bench.run(until_job_ends(*FAST, *HOMED, LASER[laser], "$C", "$F=ALL.NC"))
    return bench.log


@pytest.mark.sampled(1, 8)
@pytest.mark.skipif(not programs(), reason=f"{_EXPECTED} is not there")
@pytest.mark.parametrize("number", range(_ENTRIES))
def test_program_entered_at_a_line_continues_like_a_whole_run(
    tmp_path_factory: pytest.TempPathFactory, number: int
) -> None:
    """A random program is entered at a random line.

    Its next moves have the arguments, modes and offsets of a whole run in check mode, or the entry
    is refused for a known reason.
    """
    rng = random.Random(number)
    name = rng.choice(programs())
    lines = lines_of(name)
    line = rng.randrange(2, len(lines) + 1)
    folder = tmp_path_factory.getbasetemp() / name
    folder.mkdir(exist_ok=True)
    laser = rng.random() < 0.5
    whole_log = log_of_whole_run(name, laser, folder)
    bench = RecordingBench(folder, LENIENT=True)
    with_switches(bench).put("PART.NC", *lines[: line + _COMPARED])
    output = bench.run(until_job_ends(*FAST, *HOMED, LASER[laser], f"$F=PART.NC@{line}"))
    if f"[MSG:Job PART.NC: continues at line {line}]" not in output:
        assert any(reason in output[-1] for reason in _REFUSALS), output
        assert not bench.moves_from(line)
        return
    # Entries of the log are (line in the job, move).
    expected = [entry for entry in whole_log if line <= entry[0] <= line + _COMPARED]
    entered = [entry for entry in bench.moves_from(line) if entry[0] <= line + _COMPARED]
    assert entered == expected, (name, line)


@pytest.mark.parametrize("line", (5, 6))
def test_refused_entry_leaves_no_drilling_cycle(tmp_path: Path, line: int) -> None:
    """Entry is refused in the cycle, or after a wrong line in it. The next line only moves."""
    bench = Bench(tmp_path, LENIENT=True)
    with_switches(bench).put(
        "A.NC", "G90", "G0X-9Y-9Z-5", "G81X-8Z-9R-6F300", "X-7", "X-6K1", "X-5"
    )
    output = bench.run(say(*FAST, *HOMED, f"$F=A.NC@{line}", "X-3Y-3"))
    assert any(reason in text for text in output for reason in _REFUSALS), output
    assert bench.moves == [(-3, -3, -5)]
