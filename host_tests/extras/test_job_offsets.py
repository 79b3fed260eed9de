"""Test entry in the middle of a job: offsets, settings, content and homing are right.

$F=NAME@LINE starts a job at this line, and $F=@ at the stored line of a stopped job. Bench.run()
returns the machine's output; Bench.moves_from(line) has the moves from a line of the job on, and
Bench.moves their targets in mm. FAST and HOMED are settings, and $H, which ends at -5 mm of each
axis.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from test_jobs import FAST, HOMED, ROUTER, Bench, say, until_job_ends, with_switches
from ugrbl.sim.rig import MemoryStore

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(1)

# Programs by the command that writes offsets. Lines 3, 5 and 7 are entered.
OFFSETS = {
    "G10L2": (
        "G21 G90 G54",
        "G10 L2 P1 X-5 Y-5",
        "G0 X0 Y0 Z-10",
        "G1 X-10 F1200",
        "G10 L2 P1 X-15",
        "G1 X0",
        "G1 Y-5",
    ),
    "G10L20": (
        "G21 G90 G54",
        "G53 G0 X-10 Y-10 Z-10",
        "G10 L20 P1 X0 Y0",
        "G1 X-5 F1200",
        "G10 L20 P1 X0",
        "G1 Y-2",
        "G1 X-3",
    ),
    "G28.1": (
        "G21 G90 G53 G0 X-10 Y-10 Z-10",
        "G28.1",
        "G53 G0 X-20",
        "G30.1",
        "G28",
        "G53 G0 Y-20",
        "G28.1",
        "G30",
        "G30.1",
        "G28",
    ),
}


def stored_offsets(bench: Bench) -> str:
    """Return G54 to G59, G28 and G30, as $# shows them."""
    return "\n".join(bench.store.files["coords"])


@pytest.mark.parametrize("program", OFFSETS.values(), ids=OFFSETS)
def test_entry_starts_with_the_offsets_written_by_the_lines_before_it(
    tmp_path: Path, program: Sequence[str]
) -> None:
    """An entry ends with the same moves and stored offsets as a whole run of the program."""
    whole = with_switches(Bench(tmp_path))
    whole.put("A.NC", *program)
    whole.run(until_job_ends(*FAST, *HOMED, "$F=A.NC"))
    for line in (3, 5, 7):
        store = MemoryStore()
        store.files.update(whole.store.files)
        # Its store has the last values of the program.
        part = with_switches(Bench(tmp_path, store))
        output = part.run(until_job_ends(*HOMED, f"$F=A.NC@{line}"))
        assert output[-1] == f"[MSG:Job A.NC: done, {len(program)} lines]"
        assert part.moves_from(line) == whole.moves_from(line), line
        assert stored_offsets(part) == stored_offsets(whole), line


def run_and_stop(bench: Bench, *lines: str) -> None:
    """Run a job of these lines, and stop it in the last one by a reset, which stores the line.

    The caller's last line is so slow that it still moves after 5 s, when all others have ended.
    """
    with_switches(bench).put("A.NC", *lines)

    def script(bench: Bench) -> Iterator[Any]:
        yield from say(*FAST, *HOMED, "$F=A.NC", wait_s=5)(bench)
        bench.rig.link.send(b"!")
        yield bench.rig.ms(500)  # until it has stopped
        yield from bench.sender.wait("banner", "\x18")

    bench.run(script)
    assert bench.job_record()[1] == str(len(lines))  # name, line, and more


SLOW = "G1 X-30 F60"  # 1 mm/s: in motion for more than 5 s


@pytest.mark.thorough
def test_entry_before_offsets_written_by_a_job_restores_the_old_ones(tmp_path: Path) -> None:
    """A job that was stopped is entered before its own G10 lines.

    These have changed G54, but the entry restores G54 as it was at the start of the job.
    """
    first = Bench(tmp_path)
    run_and_stop(first, "G90", "G1 X-8 F1200", "G1 Y-8", "G10 L2 P1 X-5", "G10 L2 P1 X-6", SLOW)
    restarted = with_switches(Bench(tmp_path, first.store))
    output = restarted.run(say(*HOMED, "$F=A.NC@3", wait_s=8))
    assert "[MSG:Job A.NC: continues at line 3]" in output
    assert (-8, -5, -5) in restarted.moves  # across to X-8 with G54 as at the start of the job


@pytest.mark.thorough
def test_entry_after_a_power_cut_uses_the_offsets_written_by_the_job(tmp_path: Path) -> None:
    """The end of run() cuts the power in the slow line, after G10.

    The entry is before G10 (see the assertion).
    """
    first = with_switches(Bench(tmp_path))
    first.put("A.NC", "G90", "G1 X-8 F1200", "G1 Y-8", "G10 L2 P1 X-5", SLOW)
    first.run(say(*FAST, *HOMED, "$F=A.NC", wait_s=5))
    restarted = with_switches(Bench(tmp_path, first.store))
    restarted.run(say(*HOMED, "$F=A.NC@3", wait_s=8))
    # Across to X-8 with G54 as at the start of the job.
    assert (-8, -5, -5) in restarted.moves


def test_entry_keeps_an_offset_changed_by_the_user(tmp_path: Path) -> None:
    """The job writes G55 only.

    The user changes G54 after the stop, and its X-4 applies to the entry.
    """
    first = Bench(tmp_path)
    run_and_stop(first, "G90", "G10 L2 P2 X-1", "G1 X-8 F1200", SLOW)
    restarted = with_switches(Bench(tmp_path, first.store))
    restarted.run(say(*HOMED, "G10L2P1X-4", "$F=A.NC@4", wait_s=8))
    assert (-12, -5, -5) in restarted.moves  # X-8 in G54 with X-4


def test_entry_is_refused_if_an_offset_of_the_job_was_changed_by_the_user(tmp_path: Path) -> None:
    """The job has set G54, and the user sets it again after the stop."""
    first = Bench(tmp_path)
    run_and_stop(first, "G90", "G10 L2 P1 X-1", "G1 X-8 F1200", SLOW)
    restarted = with_switches(Bench(tmp_path, first.store))
    output = restarted.run(say(*HOMED, "G10L2P1X-4", "$F=@", wait_s=5))  # at the stored line
    words = "G54 was changed since the job set it: its value is uncertain"
    assert output[-1] == f"[MSG:Job A.NC: {words}]"


def test_entry_is_refused_after_a_setting_whose_value_has_changed(tmp_path: Path) -> None:
    bench = with_switches(Bench(tmp_path))
    bench.put("A.NC", "$32=1", "G90", "G1 X-5 F1200", "$32=0", "G1 X-3")
    said = bench.run(until_job_ends(*FAST, *HOMED, "$F=A.NC@3"))
    assert said[-1] == "[MSG:Job A.NC: line 1 sets $32, which differs now: set it first]"


def test_entry_is_refused_if_the_file_has_other_content_of_the_same_size(
    tmp_path: Path,
) -> None:
    """X-9 instead of X-8: only a checksum shows it."""
    first = Bench(tmp_path)
    run_and_stop(first, "G90", "G1 X-8 F1200", SLOW)
    first.put("A.NC", "G90", "G1 X-9 F1200", SLOW)
    restarted = with_switches(Bench(tmp_path, first.store))
    output = restarted.run(say(*HOMED, "$F=@", wait_s=5))  # at the stored line
    assert output[-1] == "[MSG:Job A.NC: the file has changed since that job stopped]"


@pytest.mark.parametrize("z_line", ["G0 Z-1", ""])
def test_entry_moves_no_axis_that_was_not_homed(tmp_path: Path, z_line: str) -> None:
    """Only X and Y are homed. A job that has moved Z before the entry cannot be entered."""
    bench = with_switches(Bench(tmp_path, HOMING=("XY",)))
    bench.put("A.NC", "G90", "G0 X-8", z_line, "G1 X-9 F1200")
    output = bench.run(until_job_ends(*FAST, "$44=3", *HOMED, "$F=A.NC@4"))
    not_homed = "Z would have to move, but is not homed: home it first"
    assert output[-1] == f"[MSG:Job A.NC: {not_homed if z_line else 'done, 4 lines'}]"


@pytest.mark.thorough
def test_axes_homed_one_by_one_count_as_homed(tmp_path: Path) -> None:
    """$HZ, $HX and $HY home single axes, instead of $H. ROUTER is a job of 11 lines."""
    bench = with_switches(Bench(tmp_path, SINGLE_AXIS_HOMING=True))
    bench.put("A.NC", *ROUTER)
    one_by_one = (*HOMED[:-1], "$HZ", "$HX", "$HY")  # without $H
    output = bench.run(until_job_ends(*FAST, *one_by_one, "$F=A.NC@4"))
    assert output[-1] == "[MSG:Job A.NC: done, 11 lines]"
