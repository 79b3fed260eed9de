"""Test `ugrbl job` at a simulator on a pseudo-terminal."""

import os
import re
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from sim_bench import Bench
from typer.testing import CliRunner, Result
from ugrbl.cli.app import app
from ugrbl.device import jobs
from ugrbl.paths import BOARDS

# Real processes in real time: the first ring runs one.
pytestmark = pytest.mark.thorough

_PROGRAM = "G21 G91\nG1 X1 F600\n; done? not yet!\nG1 X-1\n"


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """Start a machine that stores jobs."""
    folder = tmp_path_factory.mktemp("sim")
    board = folder / "my.py"
    board.write_text((BOARDS / "rpi_pico.py").read_text() + f'\nJOBS = "{folder / "jobs"}"\n')
    running = Bench(folder, "--speed", "max", "--board", str(board))
    yield running
    running.kill()


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """Start a machine that stores no jobs."""
    running = Bench(tmp_path_factory.mktemp("sim"), "--speed", "max")
    yield running
    running.kill()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    program_file = tmp_path / "part.nc"
    program_file.write_text(_PROGRAM)
    return program_file


def ugrbl(bench: Bench, *words: object, answer: str = "") -> Result:
    """Run `ugrbl job` at this machine; answer: what the user types."""
    command = ["job", *map(str, words), "--port", str(bench.port)]
    return CliRunner().invoke(app, command, input=answer)


@pytest.mark.sampled(1)
def test_program_is_sent_listed_shown_run_and_deleted(bench: Bench, file: Path) -> None:
    """All subcommands of `ugrbl job`; the machine stores names in capitals."""
    assert ugrbl(bench, "push", file).exit_code == 0
    assert f"PART.NC  {len(_PROGRAM)} " in ugrbl(bench, "list").output
    assert ugrbl(bench, "show", "part.nc").output == _PROGRAM
    done = ugrbl(bench, "run", "PART.NC")
    assert done.exit_code == 0 and done.output.startswith("Job PART.NC: begins\n")
    end_s = time.monotonic() + 10
    while ugrbl(bench, "list").exit_code:  # refused as long as the job runs
        assert time.monotonic() < end_s
    assert "nothing has been changed" in ugrbl(bench, "delete", "PART.NC", answer="n\n").output
    assert ugrbl(bench, "delete", "PART.NC", "--yes").exit_code == 0
    assert "PART.NC" not in ugrbl(bench, "list").output


def test_program_refused_at_once_is_reported(bench: Bench, tmp_path: Path) -> None:
    """The job ends at its second line, while the command still waits."""
    (tmp_path / "bad.nc").write_text("G21\nG5 X1\n")  # G5 is not supported
    assert ugrbl(bench, "push", tmp_path / "bad.nc").exit_code == 0
    done = ugrbl(bench, "run", "BAD.NC")
    assert done.exit_code == 1
    assert "Job BAD.NC: line 2 is refused with 20: " in done.output


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("is_0_9", "line", "sent"), [(True, "@2", ",2"), (True, "@", ","), (False, "@2", "@2")]
)
def test_job_is_resumed_with_a_comma_on_grbl_0_9_where_at_opens_the_door(
    is_0_9: bool, line: str, sent: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jobs, "_FIRST_S", 0)
    written: list[bytes] = []
    connection: Any = SimpleNamespace(
        takes_overrides=not is_0_9,
        write=written.append,
        lines=lambda: ["ok", "[MSG:Job PART.NC: begins]"],
    )
    jobs.start(connection, "PART.NC", line)
    assert written == [f"$F=PART.NC{sent}\n".encode()]


def test_file_that_is_not_a_program_is_not_sent(bench: Bench, tmp_path: Path) -> None:
    """Random bytes are refused; a program in UTF-16, as Windows writes it, is converted."""
    (tmp_path / "a.nc").write_bytes(os.urandom(5000))
    done = ugrbl(bench, "push", tmp_path / "a.nc")
    assert done.exit_code == 1 and "a.nc is no G-code" in done.output
    (tmp_path / "b.nc").write_text("G0 X1\n", encoding="utf-16")
    assert ugrbl(bench, "push", tmp_path / "b.nc").exit_code == 0
    assert ugrbl(bench, "show", "b.nc").output == "G0 X1\n"


@pytest.mark.parametrize(
    ("end", "stored_end"), [(b"\r", "\n"), (b"\r\r\n", "\n"), (b"\r\n", "\r\n")]
)
def test_program_with_any_line_ends_keeps_its_lines(
    bench: Bench, tmp_path: Path, end: bytes, stored_end: str
) -> None:
    """A CR, or CR CR LF, is stored as LF; CR LF stays."""
    (tmp_path / "mac.nc").write_bytes(end.join([b"G21", b"(one)", b"", b"G0 X0", b""]))
    assert ugrbl(bench, "push", tmp_path / "mac.nc").exit_code == 0
    text = stored_end.join(["G21", "(one)", "", "G0 X0", ""])
    assert f"MAC.NC  {len(text)} " in ugrbl(bench, "list").output
    assert ugrbl(bench, "show", "MAC.NC").stdout_bytes.decode() == text
    done = ugrbl(bench, "run", "MAC.NC")
    assert done.exit_code == 0 and "refused" not in done.output
    end_s = time.monotonic() + 10
    while ugrbl(bench, "list").exit_code:  # refused as long as the job runs
        assert time.monotonic() < end_s


def test_big_program_is_sent_completely(bench: Bench, tmp_path: Path) -> None:
    """One comment of 9000 random characters, and 1000 moves after it."""
    big = tmp_path / "big.nc"
    big.write_bytes(b"(" + os.urandom(4500).hex().encode() + b")\nG0X1\n" * 1000)
    assert ugrbl(bench, "push", big, "--name", "b-1.nc").exit_code == 0
    assert re.search(f"^B-1.NC +{big.stat().st_size}$", ugrbl(bench, "list").output, re.MULTILINE)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("run", "NONE.NC"), "There is no job NONE.NC"),
        (("show", "NONE.NC"), "There is no job NONE.NC"),
        (("resume", "NONE.NC", "--yes"), "No unfinished job of that name"),
        (("resume", "--line", "5", "--yes"), "--line needs the name of the program"),
        (("resume", "NONE.NC", "--yes", "--line", "5"), "There is no job NONE.NC"),
        (("button", "NONE.NC"), "There is no job NONE.NC"),
        (("run", "a b"), "a b is no name for a job"),
        (("push", "/nowhere/part.nc"), "there is no such file"),
        (("push", "/etc/hostname", "--name", "x" * 33), "is no name for a job"),
    ],
)
def test_impossible_request_is_answered_with_a_reason(
    bench: Bench, words: "tuple[str, ...]", why: str
) -> None:
    done = ugrbl(bench, *words)
    assert done.exit_code != 0 and why in done.output


def test_empty_file_is_refused(bench: Bench, tmp_path: Path) -> None:
    (tmp_path / "a.nc").touch()
    done = ugrbl(bench, "push", tmp_path / "a.nc")
    assert done.exit_code == 1 and "a.nc is empty" in done.output


@pytest.mark.parametrize("words", [("list",), ("run", "A.NC"), ("delete", "A.NC", "--yes")])
def test_machine_without_jobs_is_reported_with_the_option(
    plain: Bench, words: "tuple[str, ...]"
) -> None:
    done = ugrbl(plain, *words)
    assert done.exit_code == 1 and 'JOBS = "jobs"' in done.output


@pytest.mark.parametrize("words", [("delete", "A.NC"), ("resume", "A.NC"), ("resume",)])
def test_nothing_is_asked_when_the_machine_has_no_jobs(
    plain: Bench, words: "tuple[str, ...]"
) -> None:
    done = ugrbl(plain, *words, answer="y\n")
    assert done.exit_code == 1 and 'JOBS = "jobs"' in done.output and "?" not in done.output


@pytest.mark.parametrize("verb", ["delete", "resume"])
def test_nothing_is_asked_when_the_job_does_not_exist(bench: Bench, verb: str) -> None:
    done = ugrbl(bench, verb, "NONE.NC", answer="y\n")
    assert done.exit_code == 1 and "?" not in done.output
    assert "There is no job NONE.NC: `ugrbl job list` shows what there is" in done.output


def test_no_program_is_sent_to_a_machine_without_jobs(plain: Bench, file: Path) -> None:
    done = ugrbl(plain, "push", file)
    assert done.exit_code == 1 and 'JOBS = "jobs"' in done.output
