"""Test the dialect of Grbl 0.9: other texts of the same machine, through one interface.

The recordings of ../shared/conformance-0.9 are replayed by test_conformance.py.

converse() sends texts, each with what to wait for ("ms 60": 60 ms), and returns the replies to
each.
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
from extras.power_fail import ALARM_POWER_FAIL
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
    """A Link that stores its output."""

    def __init__(self) -> None:
        self.text = b""

    def write(self, data: bytes) -> None:
        self.text += bytes(data)

    def line(self) -> str:
        """Return the output since the last call."""
        text, self.text = self.text.decode(), b""
        return text


def converse(*talk: "tuple[str, str]", board: str = "sim_09j") -> "list[list[str]]":
    """Send each text and wait as given; return the replies to each.

    talk: (text, how): "ok", "report", "banner", or "ms 60" for 60 ms; see Sender.wait().
    """
    module = load_board(board)
    rig = Rig(module, factory_store(module))
    sender = Sender(rig)
    replies = []

    def script() -> Iterator[Any]:
        """Wait for the welcome, then send each text and store its replies."""
        sender.allow(600_000)  # ms for all waits
        yield from sender.wait("banner", "")
        sender.take()
        for text, how in talk:
            yield from sender.wait(how, text)
            replies.append(sender.take())

    rig.run(script())
    return replies


# Choice


@pytest.mark.parametrize(
    ("name", "class_"),
    [("1.1", Report), ("0.9", Report09), ("0.9i", Report09i), ("0.9j", Report09)],
)
def test_board_file_chooses_the_dialect(name: str, class_: "type[Report]") -> None:
    assert Options(SimpleNamespace(DIALECT=name)).report is class_


def test_default_dialect_is_1_1() -> None:
    assert Options(SimpleNamespace()).report is Report


def test_unknown_dialect_is_refused_with_the_reason() -> None:
    with pytest.raises(ValueError, match=r"DIALECT must be 0.9, 0.9i, 0.9j, 1.1 or hal, not 0.8"):
        Options(SimpleNamespace(DIALECT="0.8"))


def test_default_board_loads_neither_dialects_nor_tools() -> None:
    """A fresh interpreter reads the options of a board without any, and lists its modules."""
    program = (
        f"import sys; sys.path[:0] = [{str(STANDINS)!r}, {str(_FIRMWARE)!r}]\n"
        "from types import SimpleNamespace\n"
        "from boot.options import Options; Options(SimpleNamespace())\n"
        "assert not [name for name in sys.modules if name.startswith('extras.')]\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def test_only_known_modules_mention_dialects() -> None:
    """No other file of the firmware names a dialect (only its package, "dialects.") or 0.9."""
    naming = [
        path.relative_to(_FIRMWARE).as_posix()
        for path in sorted(_FIRMWARE.rglob("*.py"))
        if re.search(r"dialect(?!s\.)|0\.9[ij]?\b", path.read_text(), re.IGNORECASE)
    ]
    extras = {"extras/api.py", "extras/custom_codes.py", "extras/tools/punch.py"}
    extras |= {f"extras/dialects/{name}.py" for name in ("dialect_09", "dialect_hal")}
    # These have the option's name, the byte @ of 0.9, and a comment.
    others = {"boot/select_extras.py", "base/state.py", "talk/report.py"}
    assert set(naming) <= extras | others


def test_dialect_has_every_method_of_1_1() -> None:
    """Report09 overrides methods of Report, and adds no public ones. VERSION and the tables of
    texts are its own."""
    public = {name for name in vars(Report) if name[0] != "_"}
    assert {name for name in vars(Report09) if name[0] != "_"} <= public | {
        "VERSION",
        "words",
        "alarms",
    }


# Texts


@pytest.fixture
def paper() -> Paper:
    return Paper()


@pytest.fixture
def report(paper: Paper) -> Report09:
    return Report09(paper, None, None, None, 3, False)  # type: ignore[arg-type]


@pytest.mark.parametrize("code", error_words())
def test_every_error_has_its_text_or_number(code: int, report: Report09, paper: Paper) -> None:
    """0.9 has texts for old errors; from GCODE_COMMAND_VALUE_NOT_INTEGER on, numbers.

    error_words() are all codes that our tools know, meaning() is their text for such a line.
    """
    report.error(code)
    line = paper.line()
    assert line.startswith("error: ") and line.endswith("\r\n")
    assert line[7:-2] == meaning(line[:-2])  # without "error: " and the line end
    if code >= errors.GCODE_COMMAND_VALUE_NOT_INTEGER:
        assert line == f"error: Invalid gcode ID:{code}\r\n"


@pytest.mark.parametrize("code", alarms())
def test_every_alarm_has_a_text(code: int, report: Report09, paper: Paper) -> None:
    """The alarms of 0.9 have a text in the dialect. Newer ones, listed here, are sent as ID:n."""
    report.alarm(code)
    assert paper.line() == f"ALARM: {_ALARMS.get(code, f'ID:{code}')}\r\n"
    ours = (errors.ALARM_INTERNAL, errors.ALARM_EMERGENCY_STOP)
    added = (errors.ALARM_HANDLER, errors.ALARM_DRIVER)
    # These have their text in the extra that raises them.
    of_extras = (ALARM_PUNCH_DOWN, ALARM_PUNCH_UP, ALARM_POWER_FAIL)
    assert code in _ALARMS or code in ours + added + of_extras


def test_every_setting_has_a_text() -> None:
    there = [number for number, *_ in _TABLE if number < 100]
    assert set(there) - set(_WITHOUT) | {10} <= set(_WORDS)


# Features of 1.1 that 0.9 lacks


def test_commands_of_1_1_are_bad_numbers_or_statements() -> None:
    """0.9 takes $ and a letter for $number=value; $32 (laser mode) is no setting of it."""
    replies = converse(("$J=X1F100\n", "ok"), ("$SLP\n", "ok"), ("$S\n", "ok"), ("$32=1\n", "ok"))
    assert replies == [
        ["error: Bad number format"],
        ["error: Bad number format"],
        ["error: Bad number format"],
        ["error: Invalid statement"],
    ]


@given(some.integers(0x80, 0xFF))
def test_upper_bytes_are_ordinary_characters(byte: int) -> None:
    """Bytes from 0x80 on are real-time commands in 1.1, such as overrides, but not in 0.9."""
    replies = converse((chr(byte) + "\n", "ok"), ("?", "report"), (f"G0X0{chr(byte)}1\n", "ok"))
    assert replies[0] == ["error: Expected command letter"]
    assert replies[1] == ["<Idle,MPos:0.000,0.000,0.000,WPos:0.000,0.000,0.000>"]
    assert replies[2][0].startswith("error: ")


def test_door_is_at_in_0_9_and_a_character_in_1_1() -> None:
    """The real-time byte @ opens the safety door in 0.9. Its state is reported as Hold."""
    said, report, _ = converse(("@", "ms 60"), ("?", "report"), ("~", "ms 60"))
    assert said == ["[Check Door]"]
    assert report == ["<Hold,MPos:0.000,0.000,0.000,WPos:0.000,0.000,0.000>"]
    assert converse(("@\n", "ok"), board="sim") == [["error:1"]]  # Grbl 1.1


@pytest.mark.parametrize(
    ("length", "reply"),
    [(79, ["error: Invalid gcode ID:25"]), (80, ["error: Line overflow", "ok"])],
)
def test_line_longer_than_the_buffer_is_split(length: int, reply: "list[str]") -> None:
    """79 characters fit: X is repeated, error 25. With 80, the rest is a line of its own."""
    line = ("G0" + "X0" * 40)[:length]
    if length == 79:
        line = line[:-1] + "0"  # in place of an X without a number
    assert converse((line + "\n", "ms 60")) == [reply]


def test_tool_word_is_read_and_ignored() -> None:
    """$G reports T0 after T999 and T5, as Grbl 0.9 does, which has no tool change."""
    assert converse(("T999\n", "ok"), ("T5\n", "ok"), ("$G\n", "ok")) == [
        ["ok"],
        ["ok"],
        ["[G0 G54 G17 G21 G90 G94 M0 M5 M9 T0 F0. S0.]", "ok"],
    ]


# $10: the mask of the Czech guide is this one without its highest bit


@pytest.mark.parametrize("mask", range(32))
def test_each_bit_of_the_mask_shows_one_field(mask: int) -> None:
    """The bits of $10 are, from the lowest: MPos, WPos, Buf, RX, Lim."""
    shown = converse((f"$10={mask}\n", "ok"), ("?", "report"))[1]
    place = "0.000,0.000,0.000"
    fields = [f"MPos:{place}", f"WPos:{place}", "Buf:0", "RX:0", "Lim:000"]
    parts = ["<Idle", *(field for bit, field in enumerate(fields) if mask >> bit & 1)]
    assert shown == [",".join(parts) + ">"]


def test_buffers_report_the_used_space() -> None:
    """Four moves are in the planner (Buf). RX are bytes of an unfinished line, as Grbl counts."""
    lines = "".join(f"G1X{x / 10}F100\n" for x in range(1, 5))
    # $10=12: only Buf and RX. The ? comes within the line "G1X", which has 3 bytes.
    replies = converse(("$10=12\n", "ok"), (lines, "ok"), ("G1X?", "report"))
    # The 3 bytes may have been read already.
    assert replies[2] == ["<Run,Buf:4,RX:0>"] or replies[2] == ["<Run,Buf:4,RX:3>"]


def test_line_numbers_are_reported_if_the_board_has_them() -> None:
    """The field Ln is the last one, even with all others switched off ($10=0)."""
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
