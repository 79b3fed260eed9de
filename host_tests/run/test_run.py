"""`ugrbl run`: programs through the firmware in virtual time."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from as_users import as_users
from typer.testing import CliRunner
from ugrbl import paths
from ugrbl.boardfile.files import boards
from ugrbl.cli.app import app
from ugrbl.grbl.gcode_file import read_lines, read_program
from ugrbl.grbl.lines import split_lines
from ugrbl.grbl.messages import alarms, errors, meaning
from ugrbl.run.program import Result, run_program

# Many cases of each: the first ring runs a sample.
pytestmark = pytest.mark.sampled(2)

_PROGRAMS = Path(__file__).resolve().parents[3] / "shared" / "gcode"
_EXPECTED = _PROGRAMS / "expected.json"
_GRBL = json.loads(_EXPECTED.read_text()) if _EXPECTED.exists() else {}
_ABSENT = pytest.mark.skip(f"{_EXPECTED} is not there")


def run(text: str, *settings: str, **options: bool) -> Result:
    """Run a program with settings; return the result."""
    return run_program(split_lines(text.encode("latin-1")), settings=settings, **options)[0]


def ugrbl(*arguments: object) -> subprocess.CompletedProcess[str]:
    """Run the command in a separate process, as a user does."""
    environment = as_users(COLUMNS="120")
    command = [sys.executable, "-m", "ugrbl.cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env=environment, check=False)


def test_check_names_bytes_with_a_realtime_meaning(tmp_path: Path) -> None:
    """A byte from 0x80 may be a real-time command: harmless in a comment, a failure elsewhere."""
    file = tmp_path / "umlauts.nc"
    file.write_text("(Größe)\nG0 X1\n", encoding="utf-8")
    result = ugrbl("run", file, "--check")
    assert result.returncode == 0 and "line 1: 'ö'" in result.stdout
    file.write_text("G0 X1\nG0 X2 Ö\n", encoding="utf-8")
    result = ugrbl("run", file, "--check")
    assert result.returncode == 1 and "line 2: 'Ö'" in result.stdout


# Real programs, compared with real Grbl


def programs(only_good: bool) -> list[object]:
    """Return names of recorded programs, or a skipped one if they are not there."""
    names = [name for name, seen in _GRBL.items() if not (only_good and seen["errors"])]
    return list(names) or [pytest.param("", marks=_ABSENT)]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", programs(only_good=False))
def test_check_finds_the_same_errors_as_real_grbl(name: str) -> None:
    """recorded: answers of real Grbl in check mode, from expected.json."""
    result, _ = run_program(read_lines(_PROGRAMS / name), check=True)
    recorded = _GRBL[name]
    assert [list(error) for error in result.errors] == recorded["errors"]
    assert [result.final_state] == recorded["final_state"]
    assert [list(output) for output in result.other_output] == recorded["other_output"]


@pytest.mark.thorough
@pytest.mark.parametrize("name", programs(only_good=True))
def test_programs_without_errors_run_to_their_last_step(name: str, tmp_path: Path) -> None:
    file = tmp_path / "result.json"
    process = ugrbl("run", _PROGRAMS / name, "--json", file)
    assert process.returncode == 0, process.stderr
    result = json.loads(file.read_text())
    assert result["errors"] == []
    assert result["lines"] == len(read_lines(_PROGRAMS / name))
    assert result["steps_made"] == result["steps_planned"]
    assert [result["final_state"]] == _GRBL[name]["final_state"]


# Results of a run


def test_time_matches_the_trapezoid() -> None:
    # 600 mm/min = 10 mm/s reached and lost in 1 s each, 10 mm/s2: 20 mm take 3 s.
    result = run("G1 X20 F600\n", "$110=1000")
    assert result.totals.time_s == pytest.approx(3.0, rel=1e-3)


def test_a_dwell_takes_its_time() -> None:
    assert run("G4 P2.5\n").totals.time_s == pytest.approx(2.5, abs=0.06)


def test_steps_are_counted_in_both_directions() -> None:
    totals = run("G0 X1 Z-2\nX0\n").totals
    assert totals.steps_planned == totals.steps_made == {"X": 500, "Y": 0, "Z": 500}


def test_bounds_include_the_extremes_of_an_arc() -> None:
    bounds = run("G17 G2 X0 Y0 I5 J0 F500\n").totals.bounds_mm
    assert bounds["X"] == pytest.approx((0, 10), abs=0.01)
    assert bounds["Y"] == pytest.approx((-5, 5), abs=0.01)


def test_distance_is_the_length_of_the_path() -> None:
    assert run("G0 X3 Y4\nG0 Z1\n").totals.distance_mm == pytest.approx(6.0, abs=1e-3)


def test_corexy_bounds_are_those_of_the_tool() -> None:
    result, _ = run_program([b"G0 X3 Y4"], board="sim_corexy")
    assert result.totals.bounds_mm["X"] == pytest.approx((0, 3), abs=0.01)
    assert result.totals.bounds_mm["Y"] == pytest.approx((0, 4), abs=0.01)
    assert result.totals.distance_mm == pytest.approx(5.0, abs=0.01)


def test_errors_have_their_line_numbers() -> None:
    result = run("G0 X1\nG64\n\nG2 X5 F100\n")
    assert result.errors == [(2, "error:20"), (4, "error:35")]
    assert result.lines == 4


def test_other_output_has_its_line_number() -> None:
    assert run("G0 X1\nM30\nG0 X0\n").other_output == [(2, "[MSG:Pgm End]")]


def test_the_final_state_is_the_parsers() -> None:
    assert run("G20 G91\nG1 F10\n").final_state.startswith("[GC:G1 G54 G17 G20 G91 ")


def test_check_mode_moves_nothing() -> None:
    totals = run("G0 X10\nG4 P5\n", check=True).totals
    assert totals.steps_planned == {"X": 0, "Y": 0, "Z": 0}
    assert totals.time_s < 0.1


def test_a_line_longer_than_the_receive_buffer_counts_as_one() -> None:
    assert run("G0 X1 (" + "a" * 300 + ")\nG0" + " X1" * 100 + "\nG0 X2\n").errors == [
        (2, "error:11")
    ]


# Programs that stop


def test_a_pause_is_resumed() -> None:
    result = run("G0 X1\nM0\nG0 X2\nM0\nG0 X3\n")
    assert (result.pauses, result.lines, result.stopped) == ([2, 4], 5, "")
    assert result.totals.steps_made["X"] == 750  # 3 mm, 250 steps/mm


def test_a_hold_character_in_the_text_is_resumed() -> None:
    result = run("G0 X1\n(wow!)\nG0 X2\n")
    assert (len(result.pauses), result.lines, result.stopped) == (1, 3, "")
    assert result.totals.steps_made["X"] == 500


def test_an_alarm_ends_the_run() -> None:
    result = run("G0 X1\nG38.2 Z-5 F100\nG0 X2\n")
    assert (result.stopped, result.lines, result.errors) == ("ALARM:5", 1, [])


def test_sleep_ends_the_run() -> None:
    assert "asleep" in run("$SLP\nG0 X1\n").stopped


def test_lines_after_a_reset_character_are_still_executed() -> None:
    result = run("G91\n\x18\nG0 X1\n")
    assert result.stopped == ""
    assert result.final_state.startswith("[GC:G0 G54 G17 G21 G90 ")


def test_a_refused_setting_ends_the_run_before_it_begins() -> None:
    result = run("G0 X1\n", "$0=1")
    assert result.stopped == "$0=1 was refused with error:6"
    assert result.totals.steps_made["X"] == 0


# Files and words


@pytest.mark.parametrize(
    ("data", "lines"),
    [
        (b"", []),
        (b"a", [b"a"]),
        (b"a\n", [b"a"]),
        (b"a\r\nb\nc\rd", [b"a", b"b", b"c", b"d"]),
        (b"a\n\nb\r\r", [b"a", b"", b"b", b""]),
        (b"a\r\r\nb", [b"a", b"b"]),
        (b"a\n\rb", [b"a", b"", b"b"]),
    ],
)
def test_a_file_is_split_at_every_kind_of_line_end(data: bytes, lines: list[bytes]) -> None:
    assert split_lines(data) == lines


def test_every_number_has_a_meaning() -> None:
    """errors() and alarms() list the numbers with their texts."""
    grbl = {*range(1, 18), *range(20, 39)}
    assert set(errors()) == grbl
    assert set(range(1, 11)) <= set(alarms())
    assert all(text.endswith(".") for text in [*errors().values(), *alarms().values()])


def test_an_unknown_number_is_reported_as_unknown() -> None:
    assert meaning("error:99") == "not a number of Grbl 1.1"


def test_a_reset_in_the_text_is_reported() -> None:
    assert run("G91\n\x18\nG0 X1\n").resets == [2]


def test_positions_are_those_that_the_firmware_reports() -> None:
    totals = run("G92 X0\nG0 X-3\n").totals
    assert totals.final_position_mm["X"] == -3
    totals = run("G0 X3\n", "$3=1").totals
    assert (totals.final_position_mm["X"], totals.bounds_mm["X"]) == (3, (0, 3))


# The command


def test_a_reset_in_the_text_is_a_failure(program: Path) -> None:
    program.write_bytes(b"G0 X1\n\x18G0 X2\n")
    done = CliRunner().invoke(app, ["run", str(program)])
    assert done.exit_code == 1 and "line 2: Ctrl-X" in done.output


@pytest.mark.parametrize("data", [b"", b"\n\n", b"GIF89a\0\0"])
def test_a_file_without_a_program_is_a_failure(program: Path, data: bytes) -> None:
    program.write_bytes(data)
    done = CliRunner().invoke(app, ["run", str(program)])
    assert done.exit_code == 1 and isinstance(done.exception, SystemExit)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--plot", "out.tiff"], ".html, .png, .svg"),
        (["--json", "PROGRAM/x.json"], "program.nc is no folder"),
        (["--json", "PROGRAM"], "it is not overwritten"),
        (["--settings", "PROGRAM"], "is no setting"),
        (["--set", "fast"], "write it as"),
    ],
)
def test_impossible_options_are_reported_before_the_run(
    program: Path, words: list[str], why: str
) -> None:
    """why: part of the message. PROGRAM stands for the path of the program."""
    program.write_text("G0 X1\n")
    words = [word.replace("PROGRAM", str(program)) for word in words]
    done = CliRunner().invoke(app, ["run", str(program), *words])
    assert done.exit_code == 1 and isinstance(done.exception, SystemExit)
    # without spaces, because the terminal wraps lines; "machining" would be in the result
    assert "".join(why.split()) in "".join(done.output.split()) and "machining" not in done.output
    assert program.read_text() == "G0 X1\n"


def test_a_program_for_another_controller_gets_a_hint_to_lenient(program: Path) -> None:
    program.write_text("%\nO1000 (PART)\nN10 T1 M6\nG21 G90\nG0 X1\nM30\n%\n")
    done = CliRunner().invoke(app, ["run", str(program), "--check"])
    assert done.exit_code == 1 and "line 1" not in done.output
    assert "lines 2, 3: written for another controller; --lenient accepts" in done.output
    done = CliRunner().invoke(app, ["run", str(program), "--check", "--lenient"])
    assert done.exit_code == 0 and "another controller" not in done.output


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "utf-8-sig"])
def test_a_program_may_be_in_utf_16(program: Path, encoding: str) -> None:
    byte_order_mark = b"\xfe\xff" if encoding == "utf-16-be" else b""
    program.write_bytes(byte_order_mark + "G0 X1 (ä)\r\nG0 X2\r\n".encode(encoding))
    assert list(read_program(program)) == ["G0 X1 (ä)".encode(), b"G0 X2"]


def test_a_dash_instead_of_a_minus_is_named(program: Path) -> None:
    program.write_text("G21\nG1 X−1 F500\n", encoding="utf-8")
    done = CliRunner().invoke(app, ["run", str(program)])
    assert "line 2: '−' is no minus sign: write -" in done.output


def test_options_override_the_settings_file(program: Path, tmp_path: Path) -> None:
    program.write_text("G0 X1 Y1\n")
    settings, file = tmp_path / "my.settings", tmp_path / "out.json"
    settings.write_text("$100=100 ; coarse\n$101=50\n")
    options = ["--settings", str(settings), "--set", "101=80", "--json", str(file)]
    assert CliRunner().invoke(app, ["run", str(program), *options]).exit_code == 0
    result = json.loads(file.read_text())
    # $100 from the file, $101 from --set
    assert result["steps_made"] == {"X": 100, "Y": 80, "Z": 0}
    assert result["final_position_mm"] == {"X": 1, "Y": 1, "Z": 0}


@pytest.mark.parametrize("suffix", [".html", ".PNG", ".svg"])
def test_run_plots_the_path_like_plot(program: Path, suffix: str) -> None:
    program.write_text("G0 X10 Y5\nG1 X0 F300\n")
    file = program.with_name("new") / f"path{suffix}"
    done = CliRunner().invoke(app, ["run", str(program), "--plot", str(file)])
    assert done.exit_code == 0, done.output
    assert file.stat().st_size > 10_000


@pytest.mark.parametrize("name", boards())
def test_every_board_simulates(name: str, program: Path) -> None:
    program.write_text("G21 G90\nG0 X1\nG1 Y1 F300\n")
    done = CliRunner().invoke(app, ["run", str(program), "--board", name])
    assert done.exit_code == 0, done.output
    # "!=" would say that commanded and made steps differ
    assert "2 commanded" not in done.output and "!=" not in done.output


def test_a_board_file_in_any_folder_simulates(program: Path, tmp_path: Path) -> None:
    program.write_text("G0 X1\n")
    board = tmp_path / "mine.py"
    board.write_text((paths.BOARDS / "rpi_pico.py").read_text() + "DEFAULTS = {100: 80.0}\n")
    done = CliRunner().invoke(app, ["run", str(program), "--board", str(board)])
    assert done.exit_code == 0, done.output
    assert "80 commanded = 80 made" in done.output


@pytest.fixture
def program(tmp_path: Path) -> Path:
    return tmp_path / "program.nc"


def test_json_contains_all_results(program: Path, tmp_path: Path) -> None:
    program.write_text("G0 X1\nG64\n")
    file = tmp_path / "out.json"
    done = CliRunner().invoke(app, ["run", str(program), "--set", "110=1000", "--json", str(file)])
    assert done.exit_code == 0, done.output
    result = json.loads(file.read_text())
    assert result["errors"] == [[2, "error:20"]]
    assert result["steps_made"] == {"X": 250, "Y": 0, "Z": 0}
    assert result["bounds_mm"]["X"] == [0, 1]
    wanted = {"lines", "time_s", "steps_planned", "final_state", "distance_mm", "other_output"}
    assert wanted <= result.keys()


def test_errors_are_shown_with_line_text_and_meaning(program: Path) -> None:
    program.write_text("G0 X1\nG64 P0.01\n")
    shown = CliRunner().invoke(app, ["run", str(program)]).output
    assert "line 2: G64 P0.01" in shown
    assert meaning("error:20") in " ".join(shown.split())


def test_only_check_makes_errors_a_failure(program: Path) -> None:
    program.write_text("G64\n")
    assert CliRunner().invoke(app, ["run", str(program)]).exit_code == 0
    assert CliRunner().invoke(app, ["run", str(program), "--check"]).exit_code == 1


def test_an_alarm_is_a_failure_with_its_meaning(program: Path) -> None:
    program.write_text("G38.2 Z-5 F100\n")
    done = CliRunner().invoke(app, ["run", str(program)])
    assert done.exit_code == 1
    assert meaning("ALARM:5") in " ".join(done.output.split())


def test_an_unknown_board_is_named(program: Path) -> None:
    program.write_text("G0 X1\n")
    done = CliRunner().invoke(app, ["run", str(program), "--board", "toaster"])
    assert done.exit_code == 1
    assert "no board 'toaster'" in done.output


def test_plot_draws_the_path(program: Path, tmp_path: Path) -> None:
    program.write_text("G0 X10 Y5\nG1 X0 F300\n")
    file = tmp_path / "path.png"
    done = CliRunner().invoke(app, ["run", str(program), "--plot", str(file)])
    assert done.exit_code == 0, done.output
    assert file.read_bytes().startswith(b"\x89PNG")
