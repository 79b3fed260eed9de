"""Checks and previews of a program change no file, whatever the program contains."""

import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner
from ugrbl.cli.app import app
from ugrbl.device.jobs import _lines
from ugrbl.paths import BOARDS
from ugrbl.run import rehearsal
from ugrbl.web.preview import preview

# Many cases of each: the first ring runs a sample.
pytestmark = pytest.mark.sampled(2)

_JOB = b"G21\nG0X1\n"
_NEW = b"G0X2\n"
# Every command that writes, deletes or sets something, and everything that G-code stores.
_PROGRAM = (
    *("$FD=A.NC", "$SD/Delete=A.NC", "$LocalFS/Delete=A.NC", "$F", "$F=A.NC", "$F<=A.NC"),
    *("$FB=A.NC", "$FB=", "$F=A.NC@2", "$F=@"),
    *(f"$FU=A.NC,{len(_NEW)},{zlib.crc32(_NEW):x}", *map(bytes.decode, _lines(_NEW)), ""),
    *(f"$FU=B.NC,{len(_NEW)},{zlib.crc32(_NEW):x}", *map(bytes.decode, _lines(_NEW)), ""),
    *("$FD=B.NC", "$F=A.NC"),
    *("$N0=G21", "$N1=", "$I=mine", "$1=25", "$100=80", "$10=3"),
    *("$NET/SSID=41", "$NET/PASS=4142434445464748", "$NET/MODE=AP", "$NET/HOST=X", "$NET/PORT=99"),
    *("$NET/ALLOW=192.168.1.20", "$NET/KEY", "$NET/KEY=NEW", "$NET/OFF"),
    *("G10L2P1X1", "G10L20P2X0", "G28.1", "G30.1", "G92X1", "G43.1Z1", "G0X1", "M100"),
    *("$RST=#", "$RST=$", "$RST=*", "$J=G91X1F100", "$C", "$C", "$X", "$H", "$SLP"),
)
_TEXT = "\n".join(_PROGRAM) + "\n"
_CUSTOM = """\
from ugrbl import mcode

@mcode(100)
def note(m):
    m.keep["z1"] = 3.5
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder, with a folder of jobs that ../my.py names; ../ has the files of
    the test."""
    (tmp_path / "my.py").write_text((BOARDS / "pico_w_wifi.py").read_text() + '\nJOBS = "jobs"\n')
    (tmp_path / "mine.py").write_text(_CUSTOM)
    (tmp_path / "part.nc").write_text(_TEXT)
    working_folder = tmp_path / "here"
    (working_folder / "jobs").mkdir(parents=True)
    (working_folder / "jobs" / "A.NC").write_bytes(_JOB)
    monkeypatch.chdir(working_folder)
    return working_folder


def files(folder: Path) -> Iterator[tuple[str, int, bytes]]:
    """Yield all files with their modification time and content."""
    for path in sorted(folder.rglob("*")):
        yield str(path), path.stat().st_mtime_ns, path.read_bytes() if path.is_file() else b""


def ugrbl(*words: str) -> None:
    """Run the command with the board ../my.py, and check that it came to its end."""
    result = CliRunner().invoke(app, [*words, "--board", "../my.py"])
    assert "lines" in result.output or "all is well" in result.output, result.output


def job() -> rehearsal.Job:
    return rehearsal.Job([line.encode() for line in _PROGRAM], ["$10=1"], "../my.py")


def rehearse_here() -> None:
    result, _ = rehearsal.rehearse(job())
    assert result.lines > 20, result


def rehearse_in_process() -> None:
    running = rehearsal.Rehearsal(job())
    assert running.wait()
    running.close()


COMMANDS: dict[str, Callable[[], object]] = {
    "run": lambda: ugrbl("run", "../part.nc"),
    "run --check": lambda: ugrbl("run", "../part.nc", "--check"),
    "run --plot": lambda: ugrbl("run", "../part.nc", "--plot", "../out.html"),
    "run --custom": lambda: ugrbl("run", "../part.nc", "--custom", "../mine.py"),
    "plot": lambda: ugrbl("plot", "../part.nc", "-o", "../out.svg"),
    "custom check": lambda: ugrbl("custom", "check", "../mine.py"),
    "send's check": lambda: rehearsal.check(job()),
    "send's rehearsal": rehearse_here,
    "send's rehearsal in a process of its own": rehearse_in_process,
    "the page's preview": lambda: preview({"name": "a.nc", "program": _TEXT}, "../my.py"),
}


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_a_check_or_preview_changes_no_file(folder: Path, command: Callable[[], object]) -> None:
    before = list(files(folder))
    command()
    assert list(files(folder)) == before


def test_a_run_uses_the_jobs_of_its_program_only(folder: Path) -> None:
    """The simulated board does not see the folder of jobs: $F= of a job that the program did not
    upload is an error."""
    result = CliRunner().invoke(app, ["run", "../part.nc", "--board", "../my.py"])
    assert "There is no job A.NC" in result.output, "jobs of this computer must not be listed"
    assert "[FILE:/A.NC|SIZE" not in result.output  # the answer to $F
