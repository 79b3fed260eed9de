"""Drains: stops in the middle of a program that nobody has asked for, and how they are told."""

from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest
from ugrbl.boardfile.files import load_board
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig
from ugrbl.sim.sender import Sender

_FAST = [f"${n}={v}" for n, v in ((110, 6000), (111, 6000), (120, 2000), (121, 2000))]


def drains(lines: "list[str]", pause_ms: float, *, counts: bool = True) -> "list[str]":
    """A sender that waits so long behind each answer: what the machine says of it to $I+ and ?.

    A line `~` is sent as that byte alone, once the machine stands.
    """
    board = ModuleType("board")
    vars(board).update(vars(load_board("sim")), COUNT_DRAINS=counts)
    rig = Rig(board, factory_store(load_board("sim")))
    sender = Sender(rig)
    sender.allow(3_600_000)
    said: list[str] = []

    def script() -> Iterator[Any]:
        yield from sender.wait("banner", "")
        for line in _FAST:
            yield from sender.wait("ok", line + "\n")
        for line in lines:
            if line == "~":
                yield rig.ms(500)
                rig.link.send(b"~")
            elif line == "M0":
                rig.link.send(b"M0\n")
            else:
                yield from sender.wait("ok", line + "\n", 0)
                yield rig.ms(pause_ms)
        yield from sender.wait("idle", "\n")
        yield rig.ms(2000)
        sender.take()
        yield from sender.wait("report", "?")
        yield from sender.wait("ok", "$I+\n")
        said.extend(sender.take())

    rig.run(script())
    return said


def count(said: "list[str]") -> int:
    """The number in the answer to $I+, which the report tells as well."""
    (told,) = [line for line in said if line.startswith("[MSG:Drains: ")]
    number = int(told[13:-1])
    assert (f"|Dr:{number}" in said[0]) == (number > 0)
    return number


def moves(number: int) -> "list[str]":
    return ["G91F1200", *["G1X1"] * number]  # of 60 ms each


def test_lines_that_come_in_time_are_no_drain() -> None:
    assert count(drains(moves(10), 20)) == 0


@pytest.mark.parametrize("pause_ms", [300, 900])
def test_each_line_that_comes_late_is_one(pause_ms: float) -> None:
    assert count(drains(moves(6), pause_ms)) == 5


def test_a_stop_of_a_second_is_somebody_with_something_else_to_do() -> None:
    assert count(drains(moves(6), 1300)) == 0


def test_motors_that_are_never_released_make_no_difference() -> None:
    assert count(drains(["$1=255", *moves(6)], 300)) == 5


@pytest.mark.parametrize(
    "word", ["G4P0.05", "M3S100", "M8", "M5", "G10L20P1X0", "M0", "G38.3Y-1F600"]
)
def test_what_waits_for_motion_to_end_is_none(word: str) -> None:
    program = ["G91F1200"]
    for _ in range(4):
        program += ["G1X1", word, *(["~"] if word == "M0" else [])]
    assert count(drains(program, 0)) == 0


def test_a_jog_is_no_program() -> None:
    assert count(drains(["$J=G91X1F1200"] * 4, 300)) == 0


def test_a_reset_forgets_the_stop_and_not_the_count() -> None:
    assert count(drains([*moves(3), "\x18G91F1200", "G1X1"], 300)) == 2


def test_a_board_that_does_not_ask_says_what_grbl_says() -> None:
    said = drains(moves(6), 300, counts=False)
    assert not any("Dr" in line for line in said)
