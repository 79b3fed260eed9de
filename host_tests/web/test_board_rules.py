"""Test that the page's rules for board files are those of Python, with random boards.

`page` is the page in a browser without a machine: boardText() is the board file that it writes,
boardProblems() and boardNotes() are its faults and remarks about a board. Values that are repeated
in a list to choose from are chosen more often.
"""

import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from bridge import PAGE
from browser import browser
from ugrbl.boardfile import board_check, new_board, page_data
from ugrbl.boardfile.chips import CHIPS
from ugrbl.boardfile.files import boards, load, load_board
from ugrbl.boardfile.modules import module
from ugrbl.boardfile.new_board import ITEMS, Board
from ugrbl.boardfile.options import BY_NAME, COUNT, NAMES, SWITCH, WORD

pytestmark = [pytest.mark.xdist_group("page"), pytest.mark.thorough]

_COUNT = 1000
_MOTORS = (*("", "XYZ", "XYZY", "XYZA", "XYZXY", "XYZAB") * 3, "XYY", "XYZYY", "XZY")
_ROTARY = (*("",) * 20, "A", "B", "AA", "X", "AC")
_HOMING = (*((), ("Z", "XY"), ("Z", "X", "Y")) * 3, ("Z", "Z"), ("Q",), tuple("XYZABCX"))
_FORMS = [name for names in page_data.FORMS.values() for name in names]


@pytest.fixture(scope="module")
def page() -> Iterator[Any]:
    with browser() as opened:
        made = opened.new_page()
        made.goto(PAGE.as_uri())
        yield made


def _pins(chip: str, rng: random.Random, count: int, free_pins: list[int]) -> list[Any]:
    """Return `count` pins, mostly free ones.

    About 1 % are pins that the chip may lack or that are in use.
    """
    bad_pins = [rng.choice((0, 23, 25, 29, 34, 40, 50)), rng.choice(sorted(CHIPS[chip].pins))]
    return [
        rng.choice(bad_pins) if rng.random() < 0.01 or not free_pins else free_pins.pop()
        for _ in range(count)
    ]


def _option(name: str, rng: random.Random) -> Any:
    """Return a random value of a board option.

    Most are valid; a few are just beyond the limits.
    """
    option = BY_NAME[name]
    if option.kind is SWITCH:
        return rng.random() < 0.7
    if option.kind is COUNT:
        highest = option.high or 20_000
        limits_and_beyond = (option.low, option.low - 1, highest, highest + 1)
        return rng.choice(
            (*limits_and_beyond, *(rng.randint(option.low, highest) for _ in range(16)))
        )
    if option.kind is WORD and option.words:  # no form of the page offers "punch"
        return rng.choice([*[word for word in option.words() if word != "punch"] * 4, "steam"])
    if option.kind is NAMES:
        return (
            rng.choice(_HOMING)
            if name == "HOMING"
            else rng.choice((*((), ("FLOOD",)) * 4, ("ENABLE",)))
        )
    # Text, as of JOBS, the folder of stored jobs.
    return rng.choice(("", "jobs"))


def draft(rng: random.Random) -> dict[str, Any]:
    """Return a board as the page stores it: correct, or with one or two faults."""
    chip = rng.choice(list(CHIPS))
    free_pins = sorted(CHIPS[chip].pins)
    rng.shuffle(free_pins)
    letters = rng.choice(_MOTORS)
    motors = len(letters) or rng.choice((*(3,) * 12, 4, 4, 6, 7, 9, 2))
    # The number of motors that the lists of pins are made for; about 1 in 20 times a wrong one.
    motors += rng.choice((*(0,) * 40, 1, -1))
    pins: dict[str, list[Any]] = {}
    for item in ITEMS:
        # An optional pin is left out half of the time, a needed one rarely (which is a fault).
        if (not item.needed and rng.random() < 0.5) or rng.random() < 0.002:
            continue
        count = motors if item.per_axis else 1
        count += rng.choice((*(0,) * 60, 1, -1)) if count > 1 else 0
        pins[item.name] = _pins(chip, rng, count, free_pins)
    limits = pins.get("LIMIT", [])
    if limits and rng.random() < 0.3:
        # An axis without a switch, or two axes at the same pin.
        limits[rng.randrange(len(limits))] = rng.choice((None, limits[0]))
    if "ENABLE" in pins and rng.random() < 0.1:
        pins["ENABLE"] = _pins(chip, rng, 3, free_pins)
    chosen = rng.sample(_FORMS, rng.choice((0, 0, 1, 2, 3, 6)))
    return {
        "chip": chip,
        "title": "Random",
        "motors": letters,
        "rotary": rng.choice(_ROTARY),
        "pins": pins,
        "repl": rng.choice((None, *_pins(chip, rng, 1, free_pins))),
        "outputs": dict(
            zip("ab", _pins(chip, rng, rng.choice((0, 0, 1, 2)), free_pins), strict=False)
        ),
        "inputs": dict(
            zip("cd", _pins(chip, rng, rng.choice((0, 0, 1)), free_pins), strict=False)
        ),
        "options": {name: _option(name, rng) for name in chosen},
        # Options of an edited board file that no form shows, written back unchanged; none here.
        "kept": {},
    }


def test_page_and_python_find_same_problems_in_1000_boards(
    page: Any, tmp_path: Path, pytestconfig: pytest.Config
) -> None:
    """Page and Python find the same faults.

    The file that the page writes is read by Python's check, whose messages must be those of the
    page, word for word.
    """
    rng = random.Random(pytestconfig.getoption("seed"))
    drafts = [draft(rng) for _ in range(_COUNT)]
    answers = page.evaluate(
        "drafts => drafts.map((one) => [boardText(one), boardProblems(one), boardNotes(one)])",
        drafts,
    )
    valid_count = 0
    for number, (text, problems, notes) in enumerate(answers):
        file = tmp_path / f"random_{number}.py"
        file.write_text(text)
        board = load(file)
        assert problems == board_check.problems(board), text
        if not problems:
            valid_count += 1
            assert notes == board_check.notes(board), text
    assert _COUNT / 10 < valid_count < _COUNT * 9 / 10, (
        "a test of both needs good ones and bad ones"
    )


def test_simple_board_is_written_as_by_new_board(page: Any, pytestconfig: pytest.Config) -> None:
    """The page writes 30 valid random boards as `ugrbl new-board` does."""
    rng = random.Random(pytestconfig.getoption("seed"))
    compared = 0
    while compared < 30:
        board_draft = draft(rng)
        # new-board asks for no such parts, so a board that is compared has none.
        board_draft.update(repl=None, outputs={}, inputs={}, options={})
        # Boards with faults, or with one ENABLE pin per motor, are not compared.
        if (
            page.evaluate("boardProblems", board_draft)
            or len(board_draft["pins"].get("ENABLE", ())) > 1
        ):
            continue
        pins = {name: tuple(held) for name, held in board_draft["pins"].items()}
        board = Board(
            "Random",
            CHIPS[board_draft["chip"]],
            board_draft["motors"],
            board_draft["rotary"],
            pins,
        )
        assert page.evaluate("boardText", board_draft) == board.text()
        compared += 1


def test_every_board_stays_same_when_edited(page: Any, tmp_path: Path) -> None:
    """A board file that the page opens and writes back has the same options as before."""
    changeable = 0
    for name in (name for name in boards() if not name.startswith("sim")):
        text, problems = page.evaluate(
            """name => {
              const one = draftOf(name);
              return one ? [boardText(one), boardProblems(one)] : [null, []];
            }""",
            name,
        )
        assert problems == [], name
        # The page cannot edit this board: its pins are those of a shift register (I2S).
        if text is None:
            continue
        changeable += 1
        file = tmp_path / f"again_{name}.py"
        file.write_text(text)
        again, before = _stated_options(load(file)), _stated_options(load_board(name))
        # The page writes CHIP and PWM_MAX even where the original file leaves them out.
        before.setdefault("CHIP", again["CHIP"])
        before.setdefault("PWM_MAX", again["PWM_MAX"])
        assert again == before
    assert changeable > 10  # at least this many boards were compared


def _stated_options(board: Any) -> dict[str, Any]:
    """Return the options in a board's module, without those that have their default."""
    defaults = {"MIST": False, "CONTROL": (None,) * 4, "NO_PULL_UP": ()}
    found = {name: value for name, value in vars(board).items() if name.isupper()}
    return {name: value for name, value in found.items() if defaults.get(name) != value}


def test_drawing_has_every_pin_of_chip_once() -> None:
    """`left`, `right` and `on_board` list the pins at each place of the drawn module."""
    for name, chip in CHIPS.items():
        drawing = module(name)
        words = f"{drawing.left} {drawing.right} {drawing.on_board}".split()
        pins = [int(word) for word in words if word.isdigit()]
        assert sorted(pins) == sorted(chip.pins), name


def test_every_option_is_in_form_or_pin_or_excluded() -> None:
    """Every board option can be set in the page, or is listed here as set only in the file.

    Whoever adds an option decides: add it to FORMS or to one of these lists.
    """
    pins = {item.name for item in ITEMS} | {
        "REPL_PIN",
        "OUTPUTS",
        "INPUTS",
        "CONTROL",
        "NO_PULL_UP",
    }
    # Set through the choice of the chip, the axes, and pins, not by a field of a form.
    by_chip = {"CHIP", "MPY_ARCH", "ENGINE", "MOTORS", "ROTARY", "SAFETY_DOOR", "MIST"}
    in_a_file_only = {
        *("I2S", "I2S_RATE_HZ", "I2S_BUFFERS", "MOVES", "TMC2209", "TMC_UART", "TMC_SENSE_MOHM"),
        *("CONTROL_INVERT", "DEFAULTS", "SD_CARD", "KINEMATICS", "EXTRAS", "CUSTOM"),
        *("POWER_FAIL", "POWER_FAIL_MS", "POWER_FAIL_UP_MM", "XYUV"),
        *("PUNCH_DOWN", "PUNCH_UP", "PUNCH_DOWN_SENSOR", "PUNCH_UP_SENSOR", "PUNCH_TIMEOUT_MS"),
        *("SEGMENT_QUEUE", "ANSWER_US", "LOOP_US", "START_US", "PUNCH_STROKE_MS"),
    }
    assert pins | by_chip | in_a_file_only | set(_FORMS) == {*BY_NAME, *new_board.BY_NAME}
