"""Test `ugrbl new-board`: the files it writes, and the input it refuses."""

import json
import os
import pty
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result
from ugrbl.boardfile import board_check
from ugrbl.boardfile.chips import CHIPS
from ugrbl.boardfile.files import load, load_board
from ugrbl.boardfile.new_board import BoardError, read_pins
from ugrbl.cli.app import app

_PICO = ("--chip", "pico", "--pin", "step=2,3,4", "--pin", "dir=5,6,7")


def ugrbl(*words: object, answers: str = "") -> Result:
    """Run `ugrbl new-board` with these words; answers: lines of input."""
    return CliRunner().invoke(app, ["new-board", *map(str, words)], input=answers)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "router.py"


def test_board_made_of_options_is_accepted_by_the_firmware(file: Path) -> None:
    result = ugrbl(
        "router",
        *_PICO,
        "--pin",
        "limit=9 10 11",
        "--pin",
        "probe=GP12",
        "--set",
        "100=800",
        "-o",
        file,
    )
    assert result.exit_code == 0, result.output
    board: Any = load(file)
    assert (board.ENGINE, board.MPY_ARCH) == ("pio", "armv6m")
    assert (board.STEP, board.DIR, board.LIMIT) == ((2, 3, 4), (5, 6, 7), (9, 10, 11))
    assert board.PROBE == 12 and board.DEFAULTS == {100: 800}
    assert not hasattr(board, "CONTROL")
    assert "GPIO 9" in result.output and "limit switches X" in result.output


def test_firmware_reads_its_options_from_the_file(file: Path) -> None:
    """Options is the class with which a board reads its file."""
    from boot.wiring import Options

    ugrbl("router", *_PICO, "--set", "110=3000", "-o", file)
    options = Options(load(file))
    assert options.axes == 3 and options.defaults == {110: 3000}


def test_inputs_and_dependent_options_match_the_existing_boards(file: Path) -> None:
    """Options that follow from others: pins 35 and 39 of an ESP32 have no pull-up, a door pin
    means SAFETY_DOOR."""
    outputs = ("--chip", "esp32", "--pin", "step=26,25,17", "--pin", "dir=16,27,14")
    controls = ("--pin", "hold=4", "--pin", "door=35", "--pin", "probe=39", "--pin", "mist_pin=18")
    assert ugrbl("router", *outputs, *controls, "-o", file).exit_code == 0
    board: Any = load(file)
    assert board.CONTROL == (None, 4, None, 35)  # reset, hold, start, door
    assert board.NO_PULL_UP == (35, 39)
    assert board.SAFETY_DOOR and board.MIST and board.MIST_PIN == 18
    assert (board.ENGINE, board.LINK, board.MAX_STEP_RATE_HZ) == ("rmt", "uart", 5000)


def test_existing_board_can_be_made_again(file: Path) -> None:
    """hold=4 and start=35 are its CONTROL; all other pins are read from its file."""
    existing: Any = load_board("esp32_devkit")
    words = [f"step={existing.STEP}", f"dir={existing.DIR}", f"limit={existing.LIMIT}"]
    words += [f"enable={existing.ENABLE}", f"probe={existing.PROBE}", "hold=4", "start=35"]
    words += [f"spindle_pwm={existing.SPINDLE_PWM}", f"spindle_dir={existing.SPINDLE_DIR}"]
    options = [
        part for word in words for part in ("--pin", word.replace("(", "").replace(")", ""))
    ]
    assert ugrbl("router", "--chip", "esp32", *options, "-o", file).exit_code == 0
    new_board: Any = load(file)
    for name in ("ENGINE", "LINK", "MPY_ARCH", "STEP", "DIR", "LIMIT", "CONTROL", "NO_PULL_UP"):
        assert getattr(new_board, name) == getattr(existing, name), name


def test_four_axes_are_possible(file: Path) -> None:
    words = ("--chip", "rp2040", "--pin", "step=0,1,2,3", "--pin", "dir=4,5,6,7")
    assert ugrbl("router", *words, "-o", file).exit_code == 0
    assert len(load(file).STEP) == 4


def test_eight_motors_need_an_axis_for_each(file: Path) -> None:
    """Pins above 31 are only for slow outputs; the file says which chip has them."""
    pins = ("--chip", "rp2350b", "--pin", "step=0,1,2,3,4,5,6,7")
    wiring = (*pins, "--pin", "dir=8,9,10,11,12,13,14,15")
    result = ugrbl("router", *wiring, "-o", file)
    assert result.exit_code == 1
    assert "STEP has 8 pins, but there are 6 axes: name the axis" in " ".join(
        result.output.split()
    )
    result = ugrbl("router", *wiring, "--motors", "XYZABCYX", "--pin", "flood=47", "-o", file)
    assert result.exit_code == 0, result.output
    board: Any = load(file)
    assert (board.CHIP, board.MOTORS, board.FLOOD) == ("rp2350b", "XYZABCYX", 47)
    # motors: refused, accepted; axes of rotation: none; directions: refused, accepted; the rest is
    # left out
    answers = ["XYZ", "XYZABCXY", "", "8 9 10 11 12 13 14 32", "8 9 10 11 12 13 14 15"]
    answers += [""] * 13
    wiring = (*pins, "--ask", "--force", "-o", file)
    result = ugrbl("router", *wiring, answers="\n".join(answers) + "\n")
    assert result.exit_code == 0, result.output
    assert "MOTORS has 3 letters, and STEP 8 pins" in result.output
    assert "DIR: pin 32 cannot do it" in result.output


def test_rotary_axis_is_asked_for(file: Path) -> None:
    pins = ("--chip", "rp2040", "--pin", "step=0,1,2,3")
    # motors as they are; rotary axis: X is refused, a is A; directions; no other pins
    answers = ["", "X", "a", "4 5 6 7", *[""] * 13]
    result = ugrbl("router", *pins, "--ask", "-o", file, answers="\n".join(answers) + "\n")
    assert result.exit_code == 0, result.output
    assert "X is no rotary axis here" in result.output
    board: Any = load(file)
    assert board.ROTARY == "A"


def test_questions_are_repeated_until_the_answer_is_valid(file: Path) -> None:
    """The test answers on a terminal, as a user does."""
    # step pins: 99 is refused; directions: 4 is refused; enable pin 8; no other pins
    answers = ["pico", "2 3 99", "2 3 4", "4 5 6", "5 6 7", "8", *[""] * 13]
    user_end, its_end = pty.openpty()
    command = [sys.executable, "-m", "ugrbl.cli", "new-board", "router", "-o", str(file)]
    process = subprocess.Popen(
        command, stdin=its_end, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    os.write(user_end, ("\n".join(answers) + "\n").encode())
    output, _ = process.communicate(timeout=60)
    os.close(user_end)
    os.close(its_end)
    assert process.returncode == 0, output
    assert "has no pin 99" in output
    assert "pin 4 is STEP already" in output
    board = load(file)
    assert (board.STEP, board.DIR, board.ENABLE) == ((2, 3, 4), (5, 6, 7), 8)


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--chip", "pico"), "STEP is needed: --pin step=2,3,4"),
        (("--chip", "pico", "--pin", "step"), "step has no pins: write it as step=2,3,4"),
        (("--pin", "step=1"), "no chip is given"),
        ((*_PICO, "--pin", "limit=9,10"), "LIMIT needs 3 pins, not 2"),
        ((*_PICO, "--pin", "probe=2"), "PROBE: pin 2 is STEP already"),
        (
            (*_PICO, "--pin", "limit=9,9,10"),
            "LIMIT: X and Y share a pin and are homed together: write HOMING",
        ),
        ((*_PICO, "--pin", "probe=23"), "has no pin 23"),
        ((*_PICO, "--pin", "probe=D2"), "D2 is no pin"),
        ((*_PICO, "--pin", "laser=2"), "it must be one of step, dir"),
        ((*_PICO, "--set", "0=1"), "$0=1 is refused"),
        ((*_PICO, "--set", "999=1"), "$999=1 is refused: This machine has no setting $999"),
        ((*_PICO, "--set", "fast"), "fast is no setting"),
        ((*_PICO, "--title", 'my "best"'), "without quotation marks"),
        (
            ("--chip", "rp2040", "--pin", "step=0,1,2,3,4,5,6", "--pin", "dir=7,8,9"),
            "pio drives 6 motors at most",
        ),
        (
            ("--chip", "esp32", "--pin", "step=13,14,15,16,17", "--pin", "dir=25,26,27"),
            "rmt drives 4 motors at most",
        ),
        (
            ("--chip", "esp32", "--pin", "step=34,13,14", "--pin", "dir=25,26,27"),
            "pin 34 of ESP32 is an input only: choose another",
        ),
        (
            ("--chip", "esp32", "--pin", "step=6,13,14", "--pin", "dir=25,26,27"),
            "has no pin 6",
        ),
    ],
)
def test_impossible_input_is_refused_with_a_reason(
    file: Path, words: tuple[str, ...], why: str
) -> None:
    result = ugrbl("router", *words, "-o", file)
    assert result.exit_code == 1
    assert why in " ".join(result.output.split())
    assert not file.exists()


def test_existing_file_is_not_replaced_without_force(file: Path) -> None:
    file.write_text("mine")
    done = ugrbl("router", *_PICO, "-o", file)
    assert done.exit_code == 1 and "--force" in done.output
    assert file.read_text() == "mine"
    assert ugrbl("router", *_PICO, "-o", file, "--force").exit_code == 0


def test_file_that_does_not_end_in_py_is_refused_and_kept(tmp_path: Path) -> None:
    kept = tmp_path / "keep.txt"
    kept.write_text("G0 X1\n")
    done = ugrbl("router", *_PICO, "-o", kept, "--force")
    assert done.exit_code == 1 and "must end in .py" in done.output
    assert kept.read_text() == "G0 X1\n"


def test_name_without_an_ending_is_created_as_a_folder(tmp_path: Path) -> None:
    done = ugrbl("router", *_PICO, "-o", tmp_path / "new")
    assert done.exit_code == 0, done.output
    assert load(tmp_path / "new" / "router.py").STEP == (2, 3, 4)


def test_file_is_written_to_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = ugrbl("router", *_PICO)
    assert done.exit_code == 0 and "written: router.py" in done.output
    assert load(Path("router.py")).STEP == (2, 3, 4)


def test_file_in_a_folder_has_the_name_of_the_board(tmp_path: Path) -> None:
    done = ugrbl("router", *_PICO, "-o", tmp_path)
    assert done.exit_code == 0, done.output
    assert load(tmp_path / "router.py").STEP == (2, 3, 4)
    again = ugrbl("router", *_PICO, "-o", tmp_path, "--force")
    assert again.exit_code == 0, again.output


@pytest.mark.parametrize("words", [["-o", "FILE/x.py"], ["--json", "FOLDER"]])
def test_place_that_cannot_be_written_is_reported_before_any_file_is_written(
    tmp_path: Path, words: list[str]
) -> None:
    """FILE and FOLDER stand for a file, which is no folder, and a folder, which is no file."""
    (tmp_path / "file").write_text("")
    paths = {"FILE": tmp_path / "file", "FOLDER": tmp_path}
    for name, path in paths.items():
        words = [word.replace(name, str(path)) for word in words]
    done = ugrbl("router", *_PICO, "-o", tmp_path / "new.py", *words)
    assert done.exit_code == 1 and isinstance(done.exception, SystemExit)
    assert "folder" in done.output and not (tmp_path / "new.py").exists()


def test_name_that_cannot_be_imported_is_refused() -> None:
    assert "must not begin with a digit" in ugrbl("my-router", *_PICO).output


def test_pins_with_side_effects_are_reported(file: Path) -> None:
    words = ("--chip", "esp32", "--pin", "step=12,13,14", "--pin", "dir=25,26,27")
    done = ugrbl("router", *words, "--pin", "limit=34,35,36", "-o", file)
    assert done.exit_code == 0, done.output
    output = " ".join(done.output.split())
    assert "pin 12 (step pulses X) pulled up at start" in output
    assert "pin 34 (limit switches X) has no pull-up" in output


def test_pins_are_printed_as_json(file: Path) -> None:
    done = ugrbl("router", *_PICO, "-o", file, "--json", "-")
    printed = json.loads(done.stdout)
    assert printed["pins"]["STEP"] == [2, 3, 4] and printed["file"] == str(file)


def test_file_refused_by_board_check_is_removed(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The check of the written file finds a problem that the questions did not."""
    monkeypatch.setattr(board_check, "problems", lambda board: ["the engine wants more"])
    done = ugrbl("router", *_PICO, "-o", file)
    assert done.exit_code == 1 and "the engine wants more" in done.output
    assert not file.exists()


@pytest.mark.parametrize("text", ["2 3 4", "2,3,4", "GP2, GP3, GP4", "gpio2 gpio3 io4"])
def test_pins_are_read_in_common_notations(text: str) -> None:
    assert read_pins(text) == (2, 3, 4)


@pytest.mark.parametrize(
    ("chip", "words", "link", "page"),
    [
        ("pico_w", ["--network"], "wifi", False),
        ("pico2_w", ["--page"], "wifi", True),
        ("esp32s3", ["--network", "--page"], "uart_wifi", True),
        ("esp32s3", [], "uart", False),
    ],
)
def test_radio_and_page_are_used_when_asked_for(
    file: Path, chip: str, words: "list[str]", link: str, page: bool
) -> None:
    """link, page: LINK and PAGE in the new board file."""
    pins = ("--pin", "step=4,5,12", "--pin", "dir=7,15,16")
    done = ugrbl("router", "--chip", chip, *pins, *words, "-o", file)
    assert done.exit_code == 0, done.output
    board: Any = load(file)
    assert (board.LINK, getattr(board, "PAGE", False)) == (link, page)
    assert not board_check.problems(board)


@pytest.mark.parametrize(
    ("chip", "word", "why"),
    [
        ("pico", "--network", "Raspberry Pi Pico has no radio"),
        ("pico2", "--page", "Raspberry Pi Pico 2 has no radio"),
        ("pico_w", "--page", "less than 40 kB of memory left with it: take the page from `ugrbl"),
    ],
)
def test_missing_radio_or_memory_is_reported(file: Path, chip: str, word: str, why: str) -> None:
    done = ugrbl("router", "--chip", chip, *_PICO[2:], word, "-o", file)
    assert done.exit_code == 1 and why in " ".join(done.output.split())
    assert not file.exists()


def test_chip_data_names_only_pins_of_the_chip() -> None:
    for chip in CHIPS.values():
        assert chip.inputs_only <= chip.pins and set(chip.odd) <= chip.pins


def test_word_is_not_read_as_a_pin() -> None:
    with pytest.raises(BoardError):
        read_pins("two")
