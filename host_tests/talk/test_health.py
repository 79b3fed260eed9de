"""`$I+`, which says how the board itself is, and the C stack's watermark that it tells of."""

import sys
from array import array
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from base import faults
from base.state import ALARM, State
from boot import power_up
from pio import stack
from rig_bench import Machine

_WORDS = stack.SIZE // 4
_USED_BEFORE = 0x55


# The command


BUILD = "[MSG:Build: --------]"  # of sources


def answers(health: "Callable[[], str] | None", *lines: str, fault: str = "") -> "list[list[str]]":
    """What each line is answered with, at a board with that health, after that fault."""
    machine = Machine(watched=False)
    replies: list[list[str]] = []

    def built() -> None:
        controller: Any = machine.rig.controller
        controller.commands.health = health
        controller.commands.fault = fault

    machine.rig.on_built = built
    machine.converse(["$X", *lines], lambda line, said: replies.append(said))
    return [[line for line in said if not line.startswith("<")] for said in replies[1:]]


def test_a_board_that_can_tell_answers_as_to_i_and_tells() -> None:
    plain, told = answers(lambda: "Stack: 4704 of 8192 bytes used", "$I", "$I+")
    assert plain[-1] == "ok" and len(plain) == 3
    assert told == [*plain[:-1], BUILD, "[MSG:Stack: 4704 of 8192 bytes used]", "ok"]


def test_a_board_that_cannot_tells_its_build_and_keeps_what_it_was() -> None:
    named, before, told, after = answers(None, "$I=MILL", "$I", "$I+", "$I")
    assert named == ["ok"] and "MILL" in before[0]
    assert told == [*before[:-1], BUILD, "ok"] and after == before


def test_the_last_fault_is_reported_until_power_goes() -> None:
    told = answers(None, "$I+", "$I+", fault="ValueErr: 5 (1a2b3c4d)")
    assert [said[-2] for said in told] == ["[MSG:Last fault: ValueErr: 5 (1a2b3c4d)]"] * 2


@pytest.mark.parametrize("line", ["$I+1", "$I++", "$I-"])
def test_what_looks_like_it_is_refused_and_not_asked_for(line: str) -> None:
    asked: list[int] = []

    def health() -> str:
        asked.append(1)
        return "Stack: 1 of 8192 bytes used"

    assert answers(health, line) == [["error:3"]] and not asked


class Wire:
    """A link: what is read, a piece at a time, and what is written."""

    def __init__(self, *pieces: bytes) -> None:
        self.written = b""
        self._pieces = list(pieces)

    def write(self, data: bytes) -> None:
        self.written += data

    def read_into(self, buf: bytearray) -> int:
        piece = self._pieces.pop(0)
        buf[: len(piece)] = piece
        return len(piece)


def test_what_is_reported_a_fault_is_no_answer_and_has_a_space_for_each_odd_letter() -> None:
    told = faults.sanitize("añb error [x] ok \ud800 z\n")
    assert told == "a b Err  x  o-k   z "


def test_a_fault_is_reported_again_to_who_asks_and_kept_for_afterwards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
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
    line = b'[MSG:IndexErr:  1  File "talk.lines", line 1, in feed (--------)]\r\n'
    assert wire.written == b"ALARM:16\r\n" + line + b"<Alarm>" + line
    assert machine.commands.fault.encode() == line[5:-3]
    assert machine.state.run == ALARM


# The watermark, in memory of our own


@pytest.fixture
def memory(monkeypatch: pytest.MonkeyPatch) -> "Iterator[array[int]]":
    """The whole stack, its bottom first: all of it has been used, and 1000 bytes are in use."""
    words = array("i", [_USED_BEFORE] * _WORDS)
    monkeypatch.setattr(stack, "_bottom", lambda: words)
    monkeypatch.setattr(stack.micropython, "stack_use", lambda: 1000)
    yield words


def test_what_lies_below_the_present_depth_is_painted_and_nothing_above(
    memory: "array[int]",
) -> None:
    assert stack.used() == stack.SIZE
    stack.paint()
    in_use = memory[-1000 // 4 :]
    assert all(word == _USED_BEFORE for word in in_use)
    assert 1000 < stack.used() <= 1000 + 256 + 4


@pytest.mark.parametrize("depth", [1600, 4704, 8188, 8192])
def test_the_deepest_use_is_what_has_been_touched(memory: "array[int]", depth: int) -> None:
    tell = stack.watch()
    memory[_WORDS - depth // 4] = 7
    assert stack.used() == depth
    memory[_WORDS - 1500 // 4] = 8  # less deep than that
    assert stack.used() == depth
    assert tell() == f"Stack: {depth} of 8192 bytes used"


def test_painting_begins_anew(memory: "array[int]") -> None:
    stack.paint()
    memory[10] = 7
    stack.paint()
    assert stack.used() < 1300


@pytest.mark.parametrize(
    ("machine", "bottom"),
    [
        ("Raspberry Pi Pico with RP2040", 0x20040000),
        ("Raspberry Pi Pico 2 with RP2350", 0x20080000),
    ],
)
def test_each_chip_has_it_at_the_top_of_its_memory(
    monkeypatch: pytest.MonkeyPatch, machine: str, bottom: int
) -> None:
    implementation = SimpleNamespace(_machine=machine)
    monkeypatch.setattr(stack, "sys", SimpleNamespace(implementation=implementation))
    assert stack._bottom() == bottom
