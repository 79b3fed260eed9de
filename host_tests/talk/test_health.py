"""`$I+`, which reports the board's health, and the C stack's watermark in it."""

import sys
from array import array
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from base import text
from base.state import ALARM, State
from boot import power_up
from pio import stack
from rig_bench import Machine

_WORDS = stack.SIZE // 4
_USED_BEFORE = 0x55


# The command


BUILD = "[MSG:Build: --------]"  # of a build from sources


def answers_to(
    health: "Callable[[], str] | None", *lines: str, fault: str = ""
) -> "list[list[str]]":
    """Return the answers to each line, on a board with that health function and that last
    fault."""
    machine = Machine(watched=False)
    replies: list[list[str]] = []

    def built() -> None:
        controller: Any = machine.rig.controller
        controller.commands.health = health
        controller.commands.fault = fault

    machine.rig.on_built = built
    machine.converse(["$X", *lines], lambda line, said: replies.append(said))
    return [[line for line in said if not line.startswith("<")] for said in replies[1:]]


def test_i_plus_adds_the_boards_health_to_i() -> None:
    of_i, of_i_plus = answers_to(lambda: "Stack: 4704 of 8192 bytes used", "$I", "$I+")
    assert of_i[-1] == "ok" and len(of_i) == 3  # version, options, ok
    assert of_i_plus == [*of_i[:-1], BUILD, "[MSG:Stack: 4704 of 8192 bytes used]", "ok"]


def test_i_plus_without_health_shows_only_the_build() -> None:
    """None: a board without a health function. $I=MILL stores a text that $I shows."""
    of_name, before, of_i_plus, after = answers_to(None, "$I=MILL", "$I", "$I+", "$I")
    assert of_name == ["ok"] and "MILL" in before[0]
    assert of_i_plus == [*before[:-1], BUILD, "ok"] and after == before


def test_the_last_fault_is_reported_until_power_off() -> None:
    replies = answers_to(None, "$I+", "$I+", fault="ValueErr: 5 (1a2b3c4d)")
    assert [lines[-2] for lines in replies] == ["[MSG:Last fault: ValueErr: 5 (1a2b3c4d)]"] * 2


@pytest.mark.parametrize("line", ["$I+1", "$I++", "$I-"])
def test_similar_commands_are_refused_without_asking_for_health(line: str) -> None:
    """Only $I+ calls the board's health function."""
    calls: list[int] = []

    def health() -> str:
        calls.append(1)
        return "Stack: 1 of 8192 bytes used"

    assert answers_to(health, line) == [["error:3"]] and not calls


class Wire:
    """A link that reads these pieces one at a time, and records its output."""

    def __init__(self, *pieces: bytes) -> None:
        self.written = b""
        self._pieces = list(pieces)

    def write(self, data: bytes) -> None:
        self.written += data

    def read_into(self, buf: bytearray) -> int:
        piece = self._pieces.pop(0)
        buf[: len(piece)] = piece
        return len(piece)


def test_a_reported_fault_contains_no_answer_and_only_plain_letters() -> None:
    sanitized = text.sanitize("añb error [x] ok \ud800 z\n")
    assert sanitized == "a b Err  x  o-k   z "


def test_a_fault_is_reported_again_on_request_and_kept_for_later(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """_alarm() answers `?` and $I until a reset (0x18). The report is one line, without brackets;
    `--------` is the build."""
    text = 'Traceback\n  File "talk.lines", line 1, in feed\nIndexError: [1]'
    monkeypatch.setattr(
        sys, "print_exception", lambda fault, file: file.write(text.encode()), raising=False
    )
    machine: Any = SimpleNamespace(
        state=State(),
        commands=SimpleNamespace(fault=""),
        report=SimpleNamespace(status=lambda: b"<Alarm>"),
    )
    wire = Wire(b"G0 X1\n", b"?", b"$I\n", b"\x18")
    power_up._alarm(machine, wire, IndexError())
    report = b'[MSG:IndexErr:  1  File "talk.lines", line 1, in feed (--------)]\r\n'
    assert wire.written == b"ALARM:16\r\n" + report + b"<Alarm>" + report
    assert machine.commands.fault.encode() == report[5:-3]
    assert machine.state.run == ALARM


# The watermark, in a fake stack


@pytest.fixture
def memory(monkeypatch: pytest.MonkeyPatch) -> "Iterator[array[int]]":
    """Return the whole stack, its bottom first: all of it was used before, and 1000 bytes are in
    use."""
    words = array("i", [_USED_BEFORE] * _WORDS)
    monkeypatch.setattr(stack, "_bottom", lambda: words)
    monkeypatch.setattr(stack.micropython, "stack_use", lambda: 1000)
    yield words


def test_paint_covers_only_the_unused_part_of_the_stack(
    memory: "array[int]",
) -> None:
    """paint() fills unused words with a mark; used() finds the deepest word without it."""
    assert stack.used() == stack.SIZE  # nothing is painted: all counts as used
    stack.paint()
    in_use = memory[-1000 // 4 :]
    assert all(word == _USED_BEFORE for word in in_use)
    # a margin of 256 bytes stays unpainted, and rounding to words
    assert 1000 < stack.used() <= 1000 + 256 + 4


@pytest.mark.parametrize("depth", [1600, 4704, 8188, 8192])
def test_the_watermark_is_the_deepest_touched_word(memory: "array[int]", depth: int) -> None:
    """The stack grows down from its end, so depth bytes are in use from there; any other value is
    a touch."""
    report = stack.watch()
    memory[_WORDS - depth // 4] = 7
    assert stack.used() == depth
    memory[_WORDS - 1500 // 4] = 8  # less deep than that
    assert stack.used() == depth
    assert report() == f"Stack: {depth} of 8192 bytes used"


def test_painting_restarts_the_measurement(memory: "array[int]") -> None:
    stack.paint()
    memory[10] = 7  # nearly the whole stack is used
    stack.paint()
    assert stack.used() < 1300  # 1000 bytes in use, and the margin of 256


@pytest.mark.parametrize(
    ("machine", "bottom"),
    [
        ("Raspberry Pi Pico with RP2040", 0x20040000),
        ("Raspberry Pi Pico 2 with RP2350", 0x20080000),
    ],
)
def test_the_stack_is_at_the_top_of_each_chips_memory(
    monkeypatch: pytest.MonkeyPatch, machine: str, bottom: int
) -> None:
    """bottom: the stack has the last 8 KB of the RAM up to 0x20042000 or 0x20082000."""
    implementation = SimpleNamespace(_machine=machine)
    monkeypatch.setattr(stack, "sys", SimpleNamespace(implementation=implementation))
    assert stack._bottom() == bottom
