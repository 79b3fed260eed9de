"""Conversations recorded from real Grbl, replayed on ugrbl (MicroPython: test_prepared)."""

import json
import os
import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import rings
from typer.testing import CliRunner
from ugrbl.cli.app import app
from ugrbl.replay import recordings
from ugrbl.replay.compare_motors import judge_motors
from ugrbl.replay.conformance import Results, run_folder

_HERE = Path(__file__).resolve().parents[1]
_SHARED = _HERE.parents[1] / "shared"
# Our own conversations, and those recorded from Grbl.
FOLDERS = (
    _HERE / "conversations",
    _SHARED / "conformance",
    _SHARED / "conformance-2",
    _SHARED / "conformance-options",
    _SHARED / "conformance-0.9",
)
_PARTS = {
    "conformance": 8,
    "conformance-2": 40,
    "conformance-3": 20,
    "conformance-options": 3,
    "conformance-0.9": 2,
}
# Recordings of whole days. _DRIFT names those in which a poll falls on another block, the AVR's
# planner starves, or motion is too slow for it: see docs/conformance.md.
_DAYS = _SHARED / "conformance-3"
_DRIFT = {
    "connect_jog_zero": {"6"},
    "days": {"1", "5", "9", "12", "15", "17", "19", "28"},
    "dollar_texts": {"17"},
    "hard_limits": {"3 p_arcs"},
    "hold_resume_door": {"p_laser 5", "p_93 7", "p_flatcam 9", "p_93 11", "p_93 17"},
    "laser_jobs": {"1", "2", "4", "5", "9", "19"},
    "odd_numbers": {"M{}", "$J=G91X.1F{}"},
    "overrides_midway": {"p_raster 7"},
    "probe_sequences": {"4", "15", "17 $6=1"},
    "program_polled": {"p_inkscape 1"},
    "soft_limits": {"1", "2", "4", "6", "10"},
    "stop_resume": {"p_93 3", "p_93 6", "p_inch 13", "p_arcs 17"},
}
# Processes per worker.
PROCESSES = max(1, (os.cpu_count() or 1) // int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1")))
# Minimal cases of faults found, one file each; _DIFFER names those that differ from Grbl, by file:
# all are explained in docs/conformance.md.
_CLUSTERS = _SHARED / "conformance-3" / "clusters"
_DIFFER = {
    "coolant_byte_while_a_line_waits": {"S line waits"},
    "homing_failed_place": {"one switch never closes"},
    "numbers": {"N-0 and beyond 32 bits", "$110=0", "rapid with $110=0"},
}


def summary(results: Results) -> str:
    """Return the share of passed cases by category, and the first error of 20 failed cases."""
    lines = [
        f"{name}: {passed} of {total}" for name, (passed, total) in results.categories().items()
    ]
    for outcome in results.failures()[:20]:
        lines.append(f"{outcome.category}: {outcome.name}: {outcome.wrong[0]}")
    return "\n".join(lines)


def parts(folder: Path) -> "list[Any]":
    """Split a folder's cases into parts of some seconds each; the first ring runs a sample of
    each."""
    count = _PARTS.get(folder.name, 1)
    return [
        pytest.param(folder, part, count, id=f"{folder.name} {part + 1}/{count}")
        for part in range(count)
    ]


@pytest.mark.parametrize(
    ("folder", "part", "count"),
    [row for folder in (*FOLDERS, _DAYS) for row in rings.sample(parts(folder), 1)],
)
def test_conversations_are_answered_as_recorded(folder: Path, part: int, count: int) -> None:
    """Replay every count-th case of a folder, from case `part` on; samples in the first ring.

    Known differences of the recorded days (_DRIFT: category to names of cases) are no failures.
    """
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    results = run_folder(
        folder, choose=lambda cases: rings.sample(cases[part::count], 30), processes=PROCESSES
    )
    known = _DRIFT if folder == _DAYS else {}
    failed = [out for out in results.failures() if out.name not in known.get(out.category, ())]
    assert results.required() and not failed, summary(results)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("file", sorted(path.stem for path in _CLUSTERS.glob("*.json")))
def test_clusters_of_faults_are_answered_as_recorded(file: str) -> None:
    results = run_folder(_CLUSTERS, only=file)
    failed = {outcome.name for outcome in results.failures()}
    assert failed == _DIFFER.get(file, set()), summary(results)


# The judge detects machines with a fault


def _has(of_step: "Callable[[Any], object]") -> "Callable[[Any], bool]":
    """Return a test of cases: whether a step in which the machine stands fits of_step().

    Steps whose output is only informative ("info") do not count.
    """
    return lambda case: any(
        of_step(step)
        for step in case.get("steps", ())
        if not step.get("moving") and step.get("compare") != "info"
    )


def _is_held_in_motion(case: Any) -> bool:
    return any(
        before.get("moving") and step["send"] == "!"
        for before, step in pairwise(case.get("steps", ()))
    ) and _has(lambda step: any(line.startswith("<Hold:0|M") for line in step["expect"]))(case)


_FAULTS: "dict[str, Callable[[Any], bool]]" = {
    "never_enables": _has(lambda step: any(step.get("moved", ()))),
    "turns_no_spindle": _has(lambda step: step.get("out", {}).get("spindle_pwm")),
    "says_nothing": _has(lambda step: any(line.startswith("<") for line in step["expect"])),
    "is_off_after_a_hold": _is_held_in_motion,
    # Homing and probes have no feed override; moves may be too short to reach their feed.
    "takes_three_times": lambda case: not re.search("prob|homing|triangle", case["name"]),
}


@pytest.mark.sampled(1)
@pytest.mark.parametrize("fault", _FAULTS)
def test_a_machine_with_a_fault_fails(fault: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Replay on a machine that has the fault: every case that can show it must fail.

    So no tolerance of the judge hides it. _FAULTS: which cases show a fault.
    """
    folder = _SHARED / "conformance-2"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    monkeypatch.setenv("UGRBL_FAULT", fault)

    def choose(rows: list[Any]) -> list[Any]:
        # row[1] is the case; 4 of those that can show the fault are enough.
        showing = rings.sample([row for row in rows if _FAULTS[fault](row[1])], first=4, second=4)
        return showing[:: max(1, len(showing) // 20)]  # without answers each case waits long

    folder = folder / "motion" if fault == "takes_three_times" else folder
    program = _HERE / "support" / "wrong_machine.py"
    results = run_folder(folder, program=program, choose=choose, processes=PROCESSES)
    assert len(results.required()) >= 4
    passed = [outcome.name for outcome in results.required() if not outcome.wrong]
    assert not passed


# The judge checks the motors' enable pin

_STOPS = {"send": "G1X1F500\n", "wait": "idle", "t_ms": 1, "expect": ["ok"], "moved": [250, 0, 0]}
_WAITS = {"send": "", "wait": "ms 100", "t_ms": 100, "expect": []}
_ON, _OFF = {"enable_pin": 0}, {"enable_pin": 1}


@pytest.mark.parametrize(
    ("sent", "recorded", "observed", "wrong", "used"),
    [
        # "": the default $1=25: motors are off 25 ms after motion, at the latest in step 1.
        # recorded, observed: changes of the enable pin in each of three steps; {}: none.
        ("", [_ON, _OFF, {}], [_ON, _OFF, {}], [], []),
        ("", [{}, {}, {}], [_ON, _OFF, {}], [], ["idle delay"]),
        ("", [{}, {}, {}], [_ON, {}, {}], [f"step {n}: motors" for n in range(3)], []),
        ("", [_ON, {}, _OFF], [_ON, {}, {}], [], ["idle delay"]),
        ("", [_ON, _OFF, {}], [_ON, {}, _OFF], [], ["idle delay"]),
        ("", [_ON, _OFF, {}], [_ON, {}, {}], ["step 1: motors", "step 2: motors"], []),
        ("$1=255\n", [_ON, {}, {}], [_ON, {}, {}], [], []),
        ("$1=255\n", [_ON, {}, {}], [_ON, _OFF, _ON], ["step 1: motors"], []),
        ("$1=255\n", [_ON, _OFF, _ON], [_ON, {}, {}], ["step 1: motors"], []),
        ("$1=255\n$RST=$\n", [_ON, _OFF, {}], [_ON, {}, _OFF], [], ["idle delay"]),
        ("$1=255\n$21=1\n", [_ON, _OFF, _ON], [_ON, {}, {}], [], ["held in an alarm"]),
        ("unpowered", [{}, {}, {}], [{}, {}, {}], ["step 0: moved without power"], []),
    ],
)
def test_motors_are_on_as_recorded(
    sent: str,
    recorded: list[dict[str, int]],
    observed: list[dict[str, int]],
    wrong: list[str],
    used: list[str],
) -> None:
    """Judge a recorded enable pin against an observed one, in a move and two waits of 100 ms.

    sent: lines sent before; wrong: the expected errors; used: the known differences that excuse
    others, as "idle delay" does a change one step later than Grbl's. "unpowered" is no line: the
    motors had no power in the move.
    """
    alarm = ["ALARM:1"] if "$21" in sent else []
    steps: list[Any] = [_STOPS, {**_WAITS, "expect": alarm}, _WAITS]
    recording = {
        "name": "a case",
        "setup": [[line, ["ok"]] for line in sent.split()],
        "steps": [{**step, "out": out} for step, out in zip(steps, recorded, strict=True)],
    }
    powered = [sent != "unpowered", True, True]
    replayed = {
        "steps": [
            {"out": out, "unpowered": not on, "moving": False}
            for out, on in zip(observed, powered, strict=True)
        ],
        "setup": [{"out": {}} for _ in recording["setup"]],
    }
    differences: list[str] = []
    assert judge_motors(recording, replayed, differences) == wrong
    assert differences == used


@pytest.mark.parametrize(
    ("line", "moving", "motors_off", "wrong"),
    [
        # The pin is switched on in step 0; the recording has no change at all.
        ("G1X0.01F7\n", (True, True, True), None, []),
        ("G93G1X0.1F60\n", (True, True, False), 2, []),
        ("G1X0.01F8\n", (True, True, True), None, [0, 1, 2]),  # fast enough for Grbl
        ("G1X0.01F7\n", (True, False, False), None, [1, 2]),  # still on after the motion
        ("$H\n", (True, True, True), None, [0, 1, 2]),  # not a slow line
    ],
)
def test_motors_stay_on_during_motion_slower_than_grbls(
    line: str, moving: "tuple[bool, ...]", motors_off: "int | None", wrong: list[int]
) -> None:
    """Grbl cannot move this slowly and ends early: here, motors that stay on longer are excused.

    moving: whether the machine moves at the end of each of three steps; motors_off: the step in
    which they are switched off; wrong: the steps with an expected error.
    """
    recording = {"setup": [], "steps": [{**_WAITS, "send": line}, _WAITS, _WAITS]}
    replayed: list[Any] = [{"out": {}, "unpowered": False, "moving": moves} for moves in moving]
    replayed[0]["out"] = _ON
    if motors_off:
        replayed[motors_off]["out"] = _OFF
    differences: list[str] = []
    assert judge_motors(recording, {"steps": replayed}, differences) == [
        f"step {n}: motors" for n in wrong
    ]
    assert ("slow motion" in differences) == ("F7" in line or "G93" in line)


def test_motors_on_before_the_slow_line_are_a_failure() -> None:
    recording = {"setup": [], "steps": [_WAITS, {**_WAITS, "send": "G1X0.01F7\n"}, _WAITS]}
    replayed_steps = [{"out": out, "unpowered": False, "moving": True} for out in (_ON, {}, {})]
    assert judge_motors(recording, {"steps": replayed_steps}, []) == ["step 0: motors"]


# The machine of a recording


def recording_with(*lines: str) -> dict[str, Any]:
    step = {"send": "\x18", "wait": "banner", "t_ms": 1, "expect": [*lines]}
    return {"name": "a case", "init": "defaults", "setup": [], "steps": [step]}


def boards_of(folder: Path, **files: dict[str, Any]) -> dict[str, str]:
    """Return the board of each file."""
    for name, content in files.items():
        (folder / f"{name}.json").write_text(json.dumps([content]))
    return {found.category: found.board for found in recordings.load(folder, None, None)}


_RECORDING_09 = recording_with("Grbl 0.9j ['$' for help]")


def test_the_dialect_follows_the_welcome_not_the_file_name(tmp_path: Path) -> None:
    """The board of a recording is chosen by its welcome: older= and the others are file names."""
    board_of_file = boards_of(
        tmp_path,
        mine=_RECORDING_09,
        older=recording_with("Grbl 0.9i ['$' for help]"),
        grbl_0=recording_with("[0.9j.20150717:]", "ok"),
        corexy=_RECORDING_09,
        safety_door_input=recording_with("Grbl 1.1h ['$' for help]"),
        punch_09=recording_with("Grbl 0.9i ['$' for help]"),
        plain=recording_with("ok"),
    )
    assert board_of_file == {
        "mine": "sim_09j",
        "older": "sim_09i",
        "grbl_0": "sim_09j",
        "corexy": "sim_09j",
        "safety_door_input": "sim_door",
        "punch_09": "sim_punch_09",
        "plain": "sim",
    }


def test_a_file_without_a_welcome_uses_the_dialect_of_its_folder(tmp_path: Path) -> None:
    assert boards_of(tmp_path, a=_RECORDING_09, b=recording_with("ok"))["b"] == "sim_09j"


@pytest.mark.parametrize("text", ["Grbl 0.8c ['$' for help]", "[0.9j.20150717:]\nGrbl 1.1h ["])
def test_an_unknown_or_mixed_dialect_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ValueError, match=r"of Grbl 0\.8c|several Grbl versions: 0\.9j, 1\.1"):
        boards_of(tmp_path, a=recording_with(*text.split("\n")))


def test_recordings_of_0_9_under_other_names_conform(tmp_path: Path) -> None:
    """A file without 0.9 in its name is replayed on the 0.9 dialect: all of its 20 cases pass."""
    source = _SHARED / "conformance-0.9" / "grbl_0.9j_20150717.json"
    if not source.exists():
        pytest.skip(f"{source} is not there")
    (tmp_path / "my_old_mill.json").write_text(json.dumps(json.loads(source.read_text())[:20]))
    done = CliRunner().invoke(app, ["conformance", str(tmp_path)])
    assert done.exit_code == 0 and "20 of 20" in done.output, done.output


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--port", "/dev/nowhere"], "/dev/nowhere"),
        (["--port", "FOLDER/a.json"], "a.json"),
        (["--board", "toaster"], "no board 'toaster'"),
        (["--only", "toast"], "no recordings of toast"),
        (["--json", "FOLDER"], "is a folder"),
    ],
)
def test_an_impossible_replay_is_explained(tmp_path: Path, options: list[str], why: str) -> None:
    """`ugrbl conformance` ends with an error message that names the cause, without a traceback."""
    boards_of(tmp_path, a=recording_with("ok"))
    options = [word.replace("FOLDER", str(tmp_path)) for word in options]
    done = CliRunner().invoke(app, ["conformance", str(tmp_path), *options])
    assert done.exit_code == 1 and isinstance(done.exception, SystemExit)
    assert why in done.output.replace("\n", "")


def test_without_a_folder_our_own_conversations_are_replayed() -> None:
    done = CliRunner().invoke(app, ["conformance", "--only", "basics"])
    assert done.exit_code == 0 and "7 of 7 conform" in done.output


def test_a_file_that_is_not_a_recording_is_named(tmp_path: Path) -> None:
    (tmp_path / "half.json").write_text('[{"name": ')
    done = CliRunner().invoke(app, ["conformance", str(tmp_path)])
    assert done.exit_code == 1 and isinstance(done.exception, SystemExit)
    assert "half.json is no recording" in done.output.replace("\n", "")
