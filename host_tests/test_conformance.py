"""The same conversations with real Grbl, recorded, and with ours (MicroPython: test_prepared)."""

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner
from ugrbl.cli.app import app
from ugrbl.replay import recordings
from ugrbl.replay.conformance import Results, run_folder

_HERE = Path(__file__).resolve().parent
_SHARED = _HERE.parents[1] / "shared"
# Our own, and those recorded from Grbl.
FOLDERS = (
    _HERE / "conversations",
    _SHARED / "conformance",
    _SHARED / "conformance-2",
    _SHARED / "conformance-options",
    _SHARED / "conformance-0.9",
)


def summary(results: Results) -> str:
    """What is wrong, in short."""
    lines = [f"{name}: {good} of {all_}" for name, (good, all_) in results.categories().items()]
    for outcome in results.failures()[:20]:
        lines.append(f"{outcome.category}: {outcome.name}: {outcome.wrong[0]}")
    return "\n".join(lines)


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_conversations_are_answered_as_recorded(folder: Path) -> None:
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    results = run_folder(folder)
    assert results.ok(), summary(results)


# Which machine a recording is replayed on


def case(*lines: str) -> dict[str, Any]:
    step = {"send": "\x18", "wait": "banner", "t_ms": 1, "expect": [*lines]}
    return {"name": "a case", "init": "defaults", "setup": [], "steps": [step]}


def boards(folder: Path, **files: dict[str, Any]) -> dict[str, str]:
    """The board of each file."""
    for name, content in files.items():
        (folder / f"{name}.json").write_text(json.dumps([content]))
    return {found.category: found.board for found in recordings.load(folder, None, None)}


_OLD = case("Grbl 0.9j ['$' for help]")


def test_the_dialect_is_that_of_the_welcome_whatever_the_name(tmp_path: Path) -> None:
    found = boards(
        tmp_path,
        mine=_OLD,
        older=case("Grbl 0.9i ['$' for help]"),
        grbl_0=case("[0.9j.20150717:]", "ok"),
        corexy=_OLD,
        safety_door_input=case("Grbl 1.1h ['$' for help]"),
        punch_09=case("Grbl 0.9i ['$' for help]"),
        plain=case("ok"),
    )
    assert found == {
        "mine": "sim_09j",
        "older": "sim_09i",
        "grbl_0": "sim_09j",
        "corexy": "sim_09j",
        "safety_door_input": "sim_door",
        "punch_09": "sim_punch_09",
        "plain": "sim",
    }


def test_a_file_that_does_not_say_is_as_the_rest_of_its_folder(tmp_path: Path) -> None:
    assert boards(tmp_path, a=_OLD, b=case("ok"))["b"] == "sim_09j"


@pytest.mark.parametrize("text", ["Grbl 0.8c ['$' for help]", "[0.9j.20150717:]\nGrbl 1.1h ["])
def test_what_nothing_speaks_as_is_refused(tmp_path: Path, text: str) -> None:
    with pytest.raises(ValueError, match=r"of Grbl 0\.8c|several Grbls: 0\.9j, 1\.1"):
        boards(tmp_path, a=case(*text.split("\n")))


def test_recordings_of_0_9_under_other_names_conform(tmp_path: Path) -> None:
    source = _SHARED / "conformance-0.9" / "grbl_0.9j_20150717.json"
    if not source.exists():
        pytest.skip(f"{source} is not there")
    (tmp_path / "my_old_mill.json").write_text(json.dumps(json.loads(source.read_text())[:20]))
    done = CliRunner().invoke(app, ["conformance", str(tmp_path)])
    assert done.exit_code == 0 and "20 of 20" in done.output, done.output


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--port", "/dev/nowhere"], "/dev/nowhere"),
        (["--port", "FOLDER/a.json"], "a.json"),
        (["--board", "toaster"], "no board 'toaster'"),
        (["--only", "toast"], "no recordings of toast"),
        (["--json", "FOLDER"], "is a folder"),
    ],
)
def test_what_cannot_be_replayed_says_why(tmp_path: Path, words: list[str], why: str) -> None:
    boards(tmp_path, a=case("ok"))
    words = [word.replace("FOLDER", str(tmp_path)) for word in words]
    done = CliRunner().invoke(app, ["conformance", str(tmp_path), *words])
    assert done.exit_code == 1 and isinstance(done.exception, SystemExit)
    assert why in done.output.replace("\n", "")


def test_a_file_that_is_no_recording_is_named(tmp_path: Path) -> None:
    (tmp_path / "half.json").write_text('[{"name": ')
    done = CliRunner().invoke(app, ["conformance", str(tmp_path)])
    assert done.exit_code == 1 and isinstance(done.exception, SystemExit)
    assert "half.json is no recording" in done.output.replace("\n", "")
