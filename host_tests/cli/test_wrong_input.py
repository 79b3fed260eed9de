"""Test wrong input of a newcomer: each command names cause and remedy, and exits with 1.

ugrbl() runs a command in the folder of the test and returns its result. The folder has good.nc,
photo.nc and photo (both a JPEG file), an empty file `empty` and a folder `folder`. files_in()
returns all files with their content.
"""

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from as_users import as_users
from typer.testing import CliRunner, Result
from ugrbl.cli import screen
from ugrbl.cli.app import app
from ugrbl.grbl.gcode_file import NotText, check_text

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(2)

_GOOD = "G21 G90\nG1 X1 F300\n"
_JPEG = b"\xff\xd8\xff\xe0\x01\x02hello\n"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Create a newcomer's files in an empty folder, and make it the current one."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "good.nc").write_text(_GOOD)
    (tmp_path / "photo.nc").write_bytes(_JPEG)
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "photo").write_bytes(_JPEG)
    (tmp_path / "folder").mkdir()
    return tmp_path


def ugrbl(*words: str, stdin: "str | None" = None) -> Result:
    return CliRunner().invoke(app, words, input=stdin)


WRONG = [
    ("run missing.nc", "there is no such file; is it written right?"),
    ("plot folder", "folder cannot be read: it is a folder; name a file"),
    ("send missing.nc --port x", "missing.nc cannot be read: there is no such file"),
    ("run photo.nc", "photo.nc is no G-code: line 1"),
    ("plot photo.nc", "photo.nc is no G-code: line 1"),
    ("send photo.nc --port x", "photo.nc is no G-code: line 1"),
    ("run -", "stdin is empty"),
    ("run good.nc --settings missing", "missing cannot be read: there is no such file"),
    ("plot good.nc --settings folder", "folder cannot be read: it is a folder; name a file"),
    ("run good.nc --settings photo", "photo cannot be read: it is no text"),
    ("run good.nc --settings empty", "empty has no settings"),
    ("run good.nc --set 0=1", "error:6: The step pulse"),
    ("run good.nc --set 100=0", "$100=0 means 0 steps/mm for X"),
    ("plot good.nc --set $111=0.0", "$111=0.0 means a highest rate of 0 for Y"),
    (
        "new-board mine --chip pico --no-ask --pin step=2,3,4 --pin dir=5,6,7 --set 122=0",
        "$122=0 means an acceleration of 0 for Z",
    ),
    ("run good.nc --set 999=1", "refused with error:3: This machine has no setting $999"),
    ("run good.nc --set 110=1,5", "error:3: A number is written with a decimal point"),
    ("plot good.nc --set 999=1", "refused with error:3: This machine has no setting $999"),
    ("run good.nc --plot x.html --json x.html", "x.html is named twice"),
    ("plot good.nc -o - --json -", "- is named twice"),
    ("settings diff missing --port x", "missing cannot be read: there is no such file"),
    ("settings push photo --port x", "photo cannot be read: it is no text"),
    ("settings push empty --port x", "empty has no settings"),
    ("settings diff good.settings --port x --json folder", "folder is a folder"),
    ("sim --stdio --settings folder", "folder cannot be read: it is a folder; name a file"),
    ("sim --port nowhere/link", "nowhere/link cannot be made: there is no folder nowhere"),
    (
        "sim --tcp 192.0.2.1:80",
        "cannot listen at 192.0.2.1:80: this computer has no such address",
    ),
    ("sim --stdio --board good.nc", "good.nc is no board file"),
    ("run good.nc --board nowhere/mine", "nowhere/mine is no board file"),
    ("run good.nc --board mine", "no board 'mine'; there are "),
    ("new-board class --chip pico --no-ask", "class is a reserved word"),
    (
        "conformance RECORDINGS --port missing",
        "cannot open missing: no such port; is its name right",
    ),
    ("conformance RECORDINGS --port socket://", "cannot open socket://: "),
    ("build --arch nonsense", "nonsense is no processor: choose one of x86, "),
    ("build --board rpi_pico --out good.nc/x", "good.nc is no folder"),
    ("send good.nc --port socket://", "socket:// needs a host and a port: socket://HOST:PORT"),
    ("console --port x", "the console needs a terminal"),
]


@pytest.mark.parametrize(("words", "why"), WRONG, ids=[words for words, _ in WRONG])
def test_wrong_input_is_reported_in_words(words: str, why: str, folder: Path) -> None:
    """Each wrong command exits with 1 and shows the reason `why`.

    No text of Python or of the system is shown.
    """
    recordings = folder / "recordings"
    if "RECORDINGS" in words:
        recordings.mkdir()
        # A recorded session without steps.
        case = {"name": "?", "init": "defaults", "setup": [], "steps": [], "tags": []}
        (recordings / "jog.json").write_text(json.dumps([case]))
    (folder / "good.settings").write_text("$110=600\n")
    done = ugrbl(*words.replace("RECORDINGS", str(recordings)).split(), stdin="")
    assert done.exit_code == 1 and isinstance(done.exception, SystemExit), done.output
    # Compared without blanks, because the output is broken into lines.
    assert "".join(why.split()) in "".join(done.output.split())
    assert "Errno" not in done.output and "Traceback" not in done.output
    assert "compiled" not in done.output and "bytes in all" not in done.output, "before the work"


@pytest.mark.parametrize("command", ["run", "plot", "send"])
def test_no_text_of_the_system_reaches_a_user(command: str, folder: Path) -> None:
    """Each error of opening a file has its own words."""
    (folder / "loop.nc").symlink_to("loop.nc")  # a link to itself
    long_name = "n" * 300
    for name, why in (
        ("missing.nc", "there is no such file; is it written right?"),
        ("folder", "it is a folder; name a file"),
        ("good.nc/x", "a folder in its path is a file"),
        (long_name, "its name is too long; take a shorter one"),
        ("loop.nc", "its links lead round in a circle"),
    ):
        done = ugrbl(command, name, *(("--port", "x") if command == "send" else ()))
        assert done.exit_code == 1 and name in "".join(done.output.split())
        # Compared without blanks, because the output is broken into lines.
        assert "".join(why.split()) in "".join(done.output.split())


@pytest.mark.parametrize(
    "data", ["X = 'ä'\n".encode("latin-1"), "X = 1\n".encode("utf-16"), _JPEG]
)
@pytest.mark.parametrize(
    "words",
    [
        "custom check x.py",
        "run good.nc --custom x.py",
        "build --board x.py",
        "run good.nc --board x.py",
    ],
)
def test_file_that_is_not_text_is_reported_without_pythons_words(
    words: str, data: bytes, folder: Path
) -> None:
    """A file in Latin-1, in UTF-16, or with a picture is refused with the remedy."""
    (folder / "x.py").write_bytes(data)
    done = ugrbl(*words.split())
    output = " ".join(done.output.split())
    assert done.exit_code == 1
    assert "x.py cannot be read: it is no text in UTF-8; save it as UTF-8" in output
    assert not re.search("codec|null|byte 0x|Errno", output)


@pytest.mark.parametrize("data", [b"hello\n", b"", _JPEG])
def test_file_that_is_not_a_recording_is_named(data: bytes, folder: Path) -> None:
    """`conformance` reads all recordings of a folder and names the one that is no JSON."""
    (folder / "recordings").mkdir()
    (folder / "recordings" / "x.json").write_bytes(data)
    done = ugrbl("conformance", "recordings")
    assert done.exit_code == 1
    assert "x.json is no recording in JSON: remove it from the folder" in done.output


@pytest.mark.parametrize("command", ["run", "plot"])
def test_settings_file_with_a_zero_is_accepted_and_reported(command: str, folder: Path) -> None:
    """$102=0 is noted, because Z then makes no step; $13=0 is an ordinary value."""
    (folder / "zero.settings").write_text("$102=0\n$110=600\n$13=0\n")
    done = ugrbl(command, "good.nc", "--settings", "zero.settings")
    assert done.exit_code == 0
    assert done.output.count("note: $102=0 means 0 steps/mm for Z") == 1
    assert done.output.count("note: ") == 1


@pytest.mark.parametrize("command", ["run", "plot"])
def test_refused_setting_is_the_only_message(command: str) -> None:
    done = ugrbl(command, "good.nc", "--set", "0=1")
    assert done.exit_code == 1 and "$0=1 was refused with error:6" in done.output
    assert "lines" not in done.output and "│" not in done.output


def test_check_mode_is_named_when_a_setting_is_refused_because_of_it(folder: Path) -> None:
    """In check mode settings are refused with error:8.

    The same program runs without error otherwise.
    """
    (folder / "set.nc").write_text("$110=500\nG1 X1 F300\n")
    done = ugrbl("run", "set.nc", "--check")
    assert done.exit_code == 1 and "error:8: " in done.output
    assert "not in check mode ($C)" in done.output
    # The summary "0 errors" does not count.
    assert "error" not in ugrbl("run", "set.nc").output.replace("errors", "")


@pytest.mark.parametrize(
    ("program", "whose"),
    [
        ("0 BEGIN PGM PART MM\n1 TOOL CALL 5 Z S3500\n2 L Z+100 R0 FMAX M3\n", "Heidenhain"),
        ("M104 S200\nG28\nM82\nG1 X1 Y1 E0.5 F1200\nT0\n", "3D printer"),
    ],
)
@pytest.mark.parametrize("lenient", [(), ("--lenient",)])
def test_program_in_another_machines_language_is_named(
    program: str, whose: str, lenient: tuple[str, ...], folder: Path
) -> None:
    """A program for another kind of control is recognized, and the remedy is not --lenient."""
    (folder / "theirs.nc").write_text(program)
    message = ugrbl("run", "theirs.nc", *lenient).output
    assert whose in message and "choose Grbl in the program that made it" in message
    assert "LENIENT" not in message


def test_only_control_characters_of_paper_tape_count_as_text() -> None:
    check_text([b"\x12%\x14", b"G0 X1\x1a", b"\x18"], "tape.nc")
    for byte in b"\0\x01\x08\x0e\x1b\x1f":
        with pytest.raises(NotText, match=r"tape.nc is no G-code: line 2"):
            check_text([b"G21", b"G0" + bytes([byte])], "tape.nc")


def test_very_long_line_is_shown_in_part(folder: Path) -> None:
    (folder / "long.nc").write_text("G21\nG1 X" + "1" * 5000 + "\n")
    done = ugrbl("run", "long.nc")
    assert "line 2: G1 X111" in done.output and "error:11" in done.output
    assert done.output.count("1" * 100) == 1, "a part of it"


@pytest.mark.parametrize("command", ["run", "plot"])
def test_program_is_read_from_stdin_and_result_written_to_stdout(
    command: str, folder: Path
) -> None:
    """The file name `-` is stdin or stdout.

    No file of that name is written; a drawing is named stdin.html.
    """
    done = ugrbl(command, "-", "--json", "-", stdin=_GOOD)
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    if command == "run":
        assert result["bounds_mm"]["X"][1] == pytest.approx(1)
    else:
        assert result["jobs"][0]
    assert "stdin" in done.stderr  # the report for people, with the name of the input
    assert (folder / "stdin.html").exists() == (command == "plot")
    assert not (folder / "-").exists() and not (folder / "-.html").exists()


def test_page_is_written_to_stdout(folder: Path) -> None:
    done = ugrbl("plot", "good.nc", "-o", "-")
    assert done.exit_code == 0 and done.stdout.startswith("<!") and done.stdout.count("<html") == 1
    assert not (folder / "-").exists()


def test_simulator_without_motion_still_draws_and_reports(folder: Path) -> None:
    """A session without any line ends with an empty drawing and a report of 0 s."""
    command = [sys.executable, "-m", "ugrbl.cli", "sim", "--stdio", "--report", "-"]
    done = subprocess.run(
        [*command, "--plot", "p.html"],
        input="",
        capture_output=True,
        text=True,
        timeout=60,
        env=as_users(COLUMNS="200"),
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert (folder / "p.html").read_text().startswith("<!")
    assert json.loads(done.stdout[done.stdout.index("{") :])["time_s"] == 0
    assert not (folder / "-").exists()


def test_settings_file_with_a_byte_order_mark_is_read_and_updated(folder: Path) -> None:
    """A file from Windows: with a byte order mark and CR LF.

    The simulator updates $110 and keeps the comment.
    """
    file = folder / "win.settings"
    file.write_bytes(b"\xef\xbb\xbf$110=1000\r\n$120=50 ; mine\r\n")
    done = ugrbl("run", "good.nc", "--settings", "win.settings", "--json", "-")
    assert done.exit_code == 0, done.output
    output = subprocess.run(
        [sys.executable, "-m", "ugrbl.cli", "sim", "--stdio", "--settings", "win.settings"],
        input="$110=1200\n$$\n",
        capture_output=True,
        text=True,
        timeout=60,
        env=as_users(COLUMNS="200"),
        check=False,
    ).stdout
    assert "$110=1200.000" in output and "$120=50.000" in output
    kept = file.read_text(encoding="utf-8-sig")
    assert kept.count("$110=") == 1 and "$110=1200" in kept and "$120=50 ; mine" in kept


def run_with_stdout(stdout: int, words: str) -> "subprocess.CompletedProcess[str]":
    """Run a command in its own process. stdout: the file descriptor for its output."""
    return subprocess.run(
        [sys.executable, "-m", "ugrbl.cli", *words.split()],
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
        env=as_users(COLUMNS="200"),
        check=False,
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize("words", ["run good.nc", "plot good.nc", "run good.nc --json -"])
def test_full_disk_is_reported_in_words(words: str) -> None:
    """/dev/full refuses every write as a full disk does."""
    with Path("/dev/full").open("w") as full:
        done = run_with_stdout(full.fileno(), words)
    assert done.returncode == 1
    assert "the disk is full" in done.stderr
    assert "Errno" not in done.stderr and "Traceback" not in done.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
@pytest.mark.parametrize("name", ["full.html", "full.png", "full.json"])
def test_full_disk_is_reported_with_the_file(name: str, folder: Path) -> None:
    (folder / name).symlink_to("/dev/full")
    done = ugrbl("run", "good.nc", "--json" if name.endswith("json") else "--plot", name)
    assert done.exit_code == 1 and f"{name} cannot be written: the disk is full" in done.output


@pytest.mark.parametrize(
    "words",
    ["--help", "--version", "run good.nc", "run good.nc --json -", "plot good.nc -o -", "run -"],
)
def test_closed_output_pipe_is_not_reported(words: str) -> None:
    """A reader that ends early, as in `| head`, is no error to report."""
    read, write = os.pipe()
    os.close(read)  # so every write fails
    done = run_with_stdout(write, words)
    os.close(write)
    assert done.returncode in (0, 1)
    assert not re.search("Traceback|[Bb]roken|Exception|Errno", done.stderr), done.stderr
    assert ("stdin is empty" in done.stderr) == (words == "run -"), "stderr has its reader"


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Limit files to 100 bytes, as if the disk were full then.

    Python writes no bytecode, because it would keep incomplete files.
    """
    resource = pytest.importorskip("resource")
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def files_in(folder: Path) -> dict[str, bytes]:
    return {str(file): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


WRITERS = [
    ("run good.nc --plot {}", "x.html"),
    ("run good.nc --plot {}", "x.svg"),
    ("run good.nc --json {}", "x.json"),
    ("plot good.nc -o {}", "x.png"),
    ("new-board mine --chip pico --no-ask --pin step=2,3,4 --pin dir=5,6,7 -o {}", "x.py"),
]


@pytest.mark.parametrize("is_there", [False, True])
@pytest.mark.parametrize(("words", "name"), WRITERS)
@pytest.mark.usefixtures("full_disk")
def test_full_disk_leaves_no_incomplete_file(
    words: str, name: str, is_there: bool, folder: Path
) -> None:
    """An output longer than 100 bytes fails, and an old file of that name stays.

    is_there: whether there is one.
    """
    if is_there:
        (folder / name).write_text("old")
    before = files_in(folder)
    done = ugrbl(*words.format(name).split(), *(["--force"] if "new-board" in words else []))
    assert done.exit_code == 1 and "cannot be written: File too large" in done.output
    assert files_in(folder) == before


def test_replaced_file_stays_a_link_and_keeps_its_permissions(folder: Path) -> None:
    """Writing to a link replaces the content of the file that it names."""
    (folder / "x.json").write_text("old")
    (folder / "x.json").chmod(0o600)
    (folder / "link.json").symlink_to("x.json")
    assert ugrbl("run", "good.nc", "--json", "link.json").exit_code == 0
    assert (folder / "link.json").is_symlink() and json.loads((folder / "x.json").read_text())
    assert (folder / "x.json").stat().st_mode & 0o777 == 0o600


@pytest.mark.parametrize("words", ["run good.nc", "run good.nc --check", "plot good.nc"])
def test_ctrl_c_is_reported_and_writes_nothing(
    words: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C during a command ends it with code 130 and without output files."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    # As if Ctrl-C were pressed when progress is first shown.
    monkeypatch.setattr(screen.Screen, "progress", interrupted)
    before = files_in(folder)
    done = ugrbl(*words.split())
    assert done.exit_code == 130 and "stopped by Ctrl-C, before its end" in done.stderr
    assert files_in(folder) == before


# No user, not even root, can create a file in these.
NOWHERE = [place for place in ("/proc/x", "/sys/x") if Path(place).parent.is_dir()]


@pytest.mark.parametrize(
    "place", [*NOWHERE, "locked/x", "good.nc/x", pytest.param("n" * 300, id="long")]
)
@pytest.mark.parametrize(
    "words",
    [
        "run good.nc --json {}",
        "run good.nc --plot {}.html",
        "plot good.nc -o {}.png",
        "sim --stdio --report {}",
        "sim --stdio --plot {}.html",
        "sim --stdio --settings {}",
        "new-board mine --chip pico --no-ask --pin step=2,3,4 --pin dir=5,6,7 -o {}.py",
        "build --board rpi_pico --out {}",
        "build --board rpi_pico --json {}",
        "custom check good.py --json {}",
        "custom pull {}.py --port /dev/nowhere",
        "settings pull {} --port /dev/nowhere",
        "settings diff good.settings --json {} --port /dev/nowhere",
        "conformance --json {}",
        "doctor --json {} --port /dev/nowhere",
        "selftest --json {} --port /dev/nowhere",
        "deploy --json {} --port /dev/nowhere --board rpi_pico",
    ],
)
def test_impossible_output_file_is_reported_before_the_work(
    words: str, place: str, folder: Path
) -> None:
    """The output file is tried first.

    Nothing is computed, and the port /dev/nowhere is not opened.
    """
    (folder / "locked").mkdir(mode=0o500)
    (folder / "good.py").write_text("from ugrbl import mcode\n")
    (folder / "good.settings").write_text("$110=600\n")
    if place == "locked/x" and os.access("locked", os.W_OK):
        pytest.skip("root can write there")
    files_before = files_in(folder)
    done = ugrbl(*words.format(place).split())
    message = " ".join(done.output.split())
    assert done.exit_code == 1 and isinstance(done.exception, SystemExit), done.output
    why = "cannot be written: |good.nc is no folder|what should be|too long|a folder in its path"
    assert re.search(why, message), message
    assert not re.search("no such file|nowhere|Errno|errors|bytes in all|Drawing", message), (
        message
    )
    assert files_in(folder) == files_before


def test_version_is_reported() -> None:
    done = ugrbl("--version")
    assert done.exit_code == 0 and done.output.startswith("ugrbl ")
    assert "Grbl 1.1h" in done.output


def test_programs_run_without_terminal_modules_as_on_windows() -> None:
    """The modules for terminals are missing.

    `run` works without them, and `sim` names --tcp as its way to connect.
    """
    code = (
        "import sys, serial, serial.rfc2217;"  # Windows has other versions of these
        "sys.modules.update(termios=None, tty=None, pty=None, fcntl=None);"
        "from ugrbl.cli.app import app; app(sys.argv[1:])"
    )
    for words, exit_code in (["run", "good.nc"], 0), (["sim"], 1):
        done = subprocess.run(
            [sys.executable, "-c", code, *words],
            capture_output=True,
            text=True,
            timeout=60,
            env=as_users(COLUMNS="200"),
            check=False,
        )
        assert done.returncode == exit_code, done.stderr
    assert "use --tcp" in done.stderr


def test_program_on_stdin_may_begin_with_a_byte_order_mark() -> None:
    done = CliRunner().invoke(app, ["run", "-"], input=b"\xef\xbb\xbfG0 X1\r\n")
    assert done.exit_code == 0 and "errors" in done.output and "error:" not in done.output
