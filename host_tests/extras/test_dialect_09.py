"""Dialects: Grbl 0.9 in the words of the same machine, behind one seam.

The recordings of ../shared/conformance-0.9 are replayed by test_conformance.py.
"""

import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from base import errors
from base.settings import _TABLE
from boot.options import Options
from extras.dialects.dialect_09 import _ALARMS, _WITHOUT, _WORDS, Report09, Report09i
from extras.tools.punch import ALARM_PUNCH_DOWN, ALARM_PUNCH_UP
from hypothesis import given
from hypothesis import strategies as some
from talk.report import Report
from ugrbl.boardfile.files import load_board
from ugrbl.grbl.messages import alarms, meaning
from ugrbl.grbl.messages import errors as error_words
from ugrbl.paths import STANDINS
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig
from ugrbl.sim.sender import Sender

_FIRMWARE = Path(__file__).parents[2] / "firmware"
_BANNER = ["", "Grbl 0.9j ['$' for help]"]


class Paper:
    """A Link that keeps what is written."""

    def __init__(self) -> None:
        self.text = b""

    def write(self, data: bytes) -> None:
        self.text += bytes(data)

    def line(self) -> str:
        """What was written since the last call."""
        text, self.text = self.text.decode(), b""
        return text


def converse(*talk: "tuple[str, str]", board: str = "sim_09j") -> "list[list[str]]":
    """Send each text, wait as said; returns the replies to each."""
    module = load_board(board)
    rig = Rig(module, factory_store(module))
    sender = Sender(rig)
    replies = []

    def script() -> Iterator[Any]:
        sender.allow(600_000)
        yield from sender.wait("banner", "")
        sender.take()
        for text, how in talk:
            yield from sender.wait(how, text)
            replies.append(sender.take())

    rig.run(script())
    return replies


# Choosing one


@pytest.mark.parametrize(
    ("name", "class_"),
    [("1.1", Report), ("0.9", Report09), ("0.9i", Report09i), ("0.9j", Report09)],
)
def test_the_board_file_chooses_it(name: str, class_: "type[Report]") -> None:
    assert Options(SimpleNamespace(DIALECT=name)).report is class_


def test_the_default_is_1_1() -> None:
    assert Options(SimpleNamespace()).report is Report


def test_another_is_refused_in_words() -> None:
    with pytest.raises(ValueError, match=r"DIALECT is 1.1, 0.9, 0.9i, 0.9j or hal, not 0.8"):
        Options(SimpleNamespace(DIALECT="0.8"))


def test_the_default_board_loads_neither_dialects_nor_tools() -> None:
    program = (
        f"import sys; sys.path[:0] = [{str(STANDINS)!r}, {str(_FIRMWARE)!r}]\n"
        "from types import SimpleNamespace\n"
        "from boot.options import Options; Options(SimpleNamespace())\n"
        "assert not [name for name in sys.modules if name.startswith('extras.')]\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_nobody_else_knows_of_it() -> None:
    knowing = [
        path.relative_to(_FIRMWARE).as_posix()
        for path in sorted(_FIRMWARE.rglob("*.py"))
        if re.search(r"dialect(?!s\.)|0\.9[ij]?\b", path.read_text(), re.IGNORECASE)
    ]
    extras = {"extras/api.py", "extras/custom_codes.py", "extras/tools/punch.py"}
    extras |= {f"extras/dialects/{name}.py" for name in ("dialect_09", "dialect_hal")}
    # Its name, @, and a comment.
    others = {"boot/select_extras.py", "base/state.py", "talk/report.py"}
    assert set(knowing) <= extras | others


def test_a_dialect_says_everything_that_1_1_says() -> None:
    public = {name for name in vars(Report) if name[0] != "_"}
    assert {name for name in vars(Report09) if name[0] != "_"} <= public | {
        "VERSION",
        "words",
        "alarms",
    }


# Words


@pytest.fixture
def paper() -> Paper:
    return Paper()


@pytest.fixture
def report(paper: Paper) -> Report09:
    return Report09(paper, None, None, None, 3, False)  # type: ignore[arg-type]


@pytest.mark.parametrize("code", error_words())
def test_every_error_has_words_or_its_number(code: int, report: Report09, paper: Paper) -> None:
    report.error(code)
    line = paper.line()
    assert line.startswith("error: ") and line.endswith("\r\n")
    assert line[7:-2] == meaning(line[:-2])
    if code >= errors.GCODE_COMMAND_VALUE_NOT_INTEGER:
        assert line == f"error: Invalid gcode ID:{code}\r\n"


@pytest.mark.parametrize("code", alarms())
def test_every_alarm_has_words(code: int, report: Report09, paper: Paper) -> None:
    report.alarm(code)
    assert paper.line() == f"ALARM: {_ALARMS.get(code, f'ID:{code}')}\r\n"
    ours = (errors.ALARM_INTERNAL, errors.ALARM_EMERGENCY_STOP)
    added = (errors.ALARM_HANDLER, errors.ALARM_DRIVER)
    brought = (ALARM_PUNCH_DOWN, ALARM_PUNCH_UP)  # the punch has its words with it
    assert code in _ALARMS or code in ours + added + brought


def test_every_setting_has_words() -> None:
    there = [number for number, *_ in _TABLE if number < 100]
    assert set(there) - set(_WITHOUT) | {10} <= set(_WORDS)


# What 1.1 has and 0.9 has not


def test_commands_of_1_1_are_numbers_that_are_none() -> None:
    replies = converse(("$J=X1F100\n", "ok"), ("$SLP\n", "ok"), ("$S\n", "ok"), ("$32=1\n", "ok"))
    assert replies == [
        ["error: Bad number format"],
        ["error: Bad number format"],
        ["error: Bad number format"],
        ["error: Invalid statement"],
    ]


@given(some.integers(0x80, 0xFF))
def test_upper_bytes_are_characters_like_others(byte: int) -> None:
    replies = converse((chr(byte) + "\n", "ok"), ("?", "report"), (f"G0X0{chr(byte)}1\n", "ok"))
    assert replies[0] == ["error: Expected command letter"]
    assert replies[1] == ["<Idle,MPos:0.000,0.000,0.000,WPos:0.000,0.000,0.000>"]
    assert replies[2][0].startswith("error: ")


def test_the_door_is_at_in_0_9_and_a_character_in_1_1() -> None:
    assert converse(("@", "ms 60"), ("?", "report"), ("~", "ms 60"))[:2] == [
        ["[Check Door]"],
        ["<Hold,MPos:0.000,0.000,0.000,WPos:0.000,0.000,0.000>"],
    ]
    assert converse(("@\n", "ok"), board="sim") == [["error:1"]]


@pytest.mark.parametrize(
    ("length", "reply"),
    [(79, ["error: Invalid gcode ID:25"]), (80, ["error: Line overflow", "ok"])],
)
def test_what_is_after_the_end_of_a_line_is_a_line(length: int, reply: "list[str]") -> None:
    line = ("G0" + "X0" * 40)[:length]
    if length == 79:
        line = line[:-1] + "0"
    assert converse((line + "\n", "ms 60")) == [reply]


def test_a_tool_is_read_and_forgotten() -> None:
    assert converse(("T999\n", "ok"), ("T5\n", "ok"), ("$G\n", "ok")) == [
        ["ok"],
        ["ok"],
        ["[G0 G54 G17 G21 G90 G94 M0 M5 M9 T0 F0. S0.]", "ok"],
    ]


# $10: the Czech guide's mask is this without its highest bit


@pytest.mark.parametrize("mask", range(32))
def test_each_bit_of_the_mask_shows_one_thing(mask: int) -> None:
    shown = converse((f"$10={mask}\n", "ok"), ("?", "report"))[1]
    place = "0.000,0.000,0.000"
    fields = [f"MPos:{place}", f"WPos:{place}", "Buf:0", "RX:0", "Lim:000"]
    parts = ["<Idle", *(field for bit, field in enumerate(fields) if mask >> bit & 1)]
    assert shown == [",".join(parts) + ">"]


def test_buffers_are_counted_by_what_is_in_them() -> None:
    lines = "".join(f"G1X{x / 10}F100\n" for x in range(1, 5))
    replies = converse(("$10=12\n", "ok"), (lines, "ok"), ("G1X?", "report"))
    assert replies[2] == ["<Run,Buf:4,RX:0>"] or replies[2] == ["<Run,Buf:4,RX:3>"]


def test_line_numbers_are_reported_where_the_board_has_them() -> None:
    board = load_board("sim_09j")
    board.LINE_NUMBERS = True
    try:
        replies = converse(
            ("?", "report"), ("N7G1X1F100\n", "ok"), ("$10=0\n", "ms 20"), ("?", "report")
        )
    finally:
        del board.LINE_NUMBERS
    assert replies[0] == ["<Idle,MPos:0.000,0.000,0.000,WPos:0.000,0.000,0.000,Ln:0>"]
    assert replies[3][0].endswith(",Ln:7>")
