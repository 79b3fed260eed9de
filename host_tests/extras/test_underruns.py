"""Test the count of drains: unwanted stops in the middle of a program.

They are reported in $I+ and in status reports.

A drain is a stop because the next line came too late. Moves of 1 mm at 20 mm/s last about 60 ms.

drains() sends lines with a pause in ms after each answer; count() reads the count from its output.
"""

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
    """Run a sender that waits after each answer; return the answers to ? and $I+.

    A line `~` is sent as that byte alone, after the machine has stopped.
    """
    board = ModuleType("board")
    vars(board).update(vars(load_board("sim")), COUNT_DRAINS=counts)
    rig = Rig(board, factory_store(load_board("sim")))
    sender = Sender(rig)
    sender.allow(3_600_000)  # ms
    output: list[str] = []

    def script() -> Iterator[Any]:
        """Send settings and lines with their pauses; then ask for the counts."""
        yield from sender.wait("banner", "")
        for line in _FAST:
            yield from sender.wait("ok", line + "\n")
        for line in lines:
            if line == "~":
                yield rig.ms(500)  # until the motion has ended
                rig.link.send(b"~")
            # M0 is answered after the ~ that follows.
            elif line == "M0":
                rig.link.send(b"M0\n")
            else:
                yield from sender.wait("ok", line + "\n", settle=0)  # at once after the answer
                yield rig.ms(pause_ms)
        yield from sender.wait("idle", "\n")
        yield rig.ms(2000)  # longer than any counted pause
        sender.take()
        yield from sender.wait("report", "?")
        yield from sender.wait("ok", "$I+\n")
        output.extend(sender.take())

    rig.run(script())
    return output


def count(output: "list[str]") -> int:
    """Return the number in the answer to $I+, which the report must have, too."""
    (message,) = [line for line in output if line.startswith("[MSG:Drains: ")]
    number = int(message[13:-1])  # after "[MSG:Drains: "
    assert (f"|Dr:{number}" in output[0]) == (number > 0)
    return number


def moves(number: int) -> "list[str]":
    """Return lines of relative moves: this number of 1 mm at 20 mm/s."""
    return ["G91F1200", *["G1X1"] * number]  # of 60 ms each


def test_lines_in_time_are_no_drain() -> None:
    assert count(drains(moves(10), 20)) == 0


@pytest.mark.parametrize("pause_ms", [300, 900])
def test_each_late_line_is_a_drain(pause_ms: float) -> None:
    assert count(drains(moves(6), pause_ms)) == 5


def test_stop_longer_than_a_second_is_no_drain() -> None:
    assert count(drains(moves(6), 1300)) == 0


def test_drains_are_counted_when_motors_are_never_released() -> None:
    assert count(drains(["$1=255", *moves(6)], 300)) == 5


@pytest.mark.parametrize(
    "word", ["G4P0.05", "M3S100", "M8", "M5", "G10L20P1X0", "M0", "G38.3Y-1F600"]
)
def test_word_that_waits_for_motion_to_end_is_no_drain(word: str) -> None:
    """The planner is empty because of the word, not because lines were late."""
    program = ["G91F1200"]
    for _ in range(4):
        program += ["G1X1", word, *(["~"] if word == "M0" else [])]
    assert count(drains(program, 0)) == 0


def test_jog_is_no_drain() -> None:
    assert count(drains(["$J=G91X1F1200"] * 4, 300)) == 0


def test_reset_keeps_the_count_but_does_not_add_its_stop() -> None:
    assert count(drains([*moves(3), "\x18G91F1200", "G1X1"], 300)) == 2


def test_board_without_the_option_reports_no_drains() -> None:
    output = drains(moves(6), 300, counts=False)
    assert not any("Dr" in line for line in output)
