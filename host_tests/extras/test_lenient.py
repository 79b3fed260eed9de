"""Test LENIENT: words of other controllers are ignored, replaced or refused.

Bench.say() sends lines and returns the replies to each of them. Bench.moves are the planned moves:
"rapid" or the feed, then X, Y and Z in mm. Errors have the numbers of Grbl. A line of places has
only coordinates: while a drilling cycle is active, it drills there.
"""

import json
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from base import errors
from base.errors import GrblError
from extras.api import Cnc
from hypothesis import given
from hypothesis import strategies as st
from language.block_layout import MOVE
from laws import some
from ugrbl.boardfile.files import load_board
from ugrbl.grbl.gcode_file import read_lines
from ugrbl.paths import BOARDS
from ugrbl.run.program import run_program
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig
from ugrbl.sim.sender import Sender

Move = tuple[str, float, float, float]

_PROGRAMS = Path(__file__).resolve().parents[3] / "shared" / "gcode"
_EXPECTED = _PROGRAMS / "expected.json"
_GRBL = json.loads(_EXPECTED.read_text()) if _EXPECTED.exists() else {}
needs_programs = pytest.mark.skipif(not _GRBL, reason=f"{_EXPECTED} is not there")


class Bench:
    """A machine, lenient or not, with its output and its planned moves."""

    def __init__(self, *, lenient: bool = True, extras: "tuple[str, ...]" = ()) -> None:
        """extras: names of modules that the board installs."""
        board = ModuleType("board")
        vars(board).update(vars(load_board("sim")), LENIENT=lenient, EXTRAS=extras)
        self.rig = Rig(board, factory_store(load_board("sim")))
        self.rig.on_built = self._listen
        self.sender = Sender(self.rig)
        self.sender.allow(36_000_000)  # ms; then waits fail
        self.moves: list[Move] = []

    def _listen(self) -> None:
        """Record all planned moves: "rapid" or the feed, and the target in mm."""
        machine = self.rig.controller
        machine.interpreter.watch(MOVE)  # otherwise the kernel would handle some moves
        planner = machine.planner
        call_line = planner.line

        def line(target: Any, move: Any, power: int) -> bool:
            kind = "rapid" if move.flags & 1 else f"F{move.feed:g}"  # RAPID_MOTION
            self.moves.append((kind, *(round(mm, 4) for mm in target)))
            return call_line(target, move, power)

        planner.line = line  # type: ignore[method-assign]

    def say(self, *lines: str) -> "list[list[str]]":
        """Return the replies to each line; pauses are ended with ~."""
        replies: list[list[str]] = []

        def script() -> Iterator[Any]:
            """Send each line after the answer to the one before; resume pauses."""
            yield from self.sender.wait("banner", "")
            self.sender.take()
            for line in lines:
                self.rig.link.send((line + "\n").encode("latin-1"))
                while not self.sender.answers:
                    yield self.rig.ms(300)
                    self.sender.poll()
                    if self.rig.controller.state.suspend:  # M0, or M6
                        self.rig.link.send(b"~")
                replies.append(self.sender.take())

        self.rig.run(script())
        return replies


def answers(*lines: str, lenient: bool = True) -> "list[str]":
    """Return the last reply to each line that is no [message]: ok or an error."""
    all_replies = Bench(lenient=lenient).say(*lines)
    return [[text for text in replies if not text.startswith("[")][-1] for replies in all_replies]


def moves(*lines: str, lenient: bool = True) -> "list[Move]":
    """Return the planned moves; all lines must be accepted."""
    bench = Bench(lenient=lenient)
    all_replies = bench.say(*lines)
    assert all(replies[-1] == "ok" for replies in all_replies), all_replies
    return bench.moves


# Ignored words


@pytest.mark.parametrize(
    ("lines", "by_hand"),
    [
        (("%", "G0 X1"), ("G0 X1",)),
        (("N890 %", "G0 X1"), ("G0 X1",)),
        (("O0001", "N5 o12", "G0 X1"), ("G0 X1",)),
        (("G21 G64 P0.01 Q0.02 G0 X1",), ("G21 G0 X1",)),
        (("G61.1", "G0 X1"), ("G0 X1",)),
        (("G0", "G43 Z2.5 H01"), ("G0 Z2.5",)),
        (("G43 H2", "G0 X1"), ("G0 X1",)),
        (("N100G00G20G17G90G40G49G80", "X1"), ("G0 G20 G17 G90 G40", "X1")),
        (("G1 X1 F100 G49",), ("G1 X1 F100",)),
        (("T328", "M6", "G0 X1"), ("M5", "M0", "G0 X1")),
        (("M3 S100", "T2 M6", "G0 X1"), ("M3 S100", "M5", "M0", "G0 X1")),
        (("M06 T102 G0 X1",), ("M5", "M0", "G0 X1")),
        (("G4 S0.5", "G0 X1"), ("G4 P0.5", "G0 X1")),
        (("G98", "G99", "G0 X1"), ("G0 X1",)),
        (("M204 S500.00 G1 X1 F100", "M204 P500 S9"), ("G1 X1 F100",)),
    ],
)
def test_word_without_meaning_here_is_ignored(
    lines: "Sequence[str]", by_hand: "Sequence[str]"
) -> None:
    """A lenient machine moves as one that is not does for the same program, corrected by hand."""
    assert moves(*lines) == moves(*by_hand, lenient=False)


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("%", "%"),
        ("O1", "O"),
        ("G64", "G64"),
        ("G43 H1", "G43"),
        ("T1 M6", "M6"),
        ("G98", "G98"),
        ("G4 S.1", "G4 S"),
        ("M204 S9", "M204"),
        ("G81 X1 Z-1 R1 F1000", "G81"),
    ],
)
def test_each_word_is_named_once_until_a_reset(line: str, name: str) -> None:
    """An ignored or replaced word is named in a message once, and again after a reset."""
    all_replies = Bench().say(line, line, "G4 P0", "\x18", line)
    messages = [
        [text for text in replies if text.startswith(f"[MSG:{name}: ")] for replies in all_replies
    ]
    del messages[2]  # those of G4, which waits for motion before the reset
    assert [len(replies) for replies in messages] == [1, 0, 0, 1], all_replies


@pytest.mark.parametrize(
    "line",
    [
        "G41 D1",
        "G42",
        "G5 X1",
        "O100 REPEAT [5]",
        "O100 G0 X1",
        "# 10%",
        "G0 X%1",
        "G1 @1",
        "M6 P1",
        "G0 X1 H1",
        "G64 G0 X1 Q",
        "G43 H1 X",
        "G4",
        "G4 S-1",
        "M98 P1",
        "G2 X1 G64",
        "T-1 M6",
        "M204 S9 M3",
        "M204 T9",
        "M114 X1",
        "M400 G0 X1",
        "M115 M114",
    ],
)
def test_wrong_line_is_still_refused_and_changes_nothing(line: str) -> None:
    bench = Bench()
    replies = bench.say("G0 X1 F100", "$G", line, "$G")
    assert [text.partition(":")[0] for text in replies[2]] == ["error"], replies[2]
    assert replies[1] == replies[3] and len(bench.moves) == 1  # $G before and after the line


def test_board_that_is_not_lenient_refuses_them_all() -> None:
    """These are Grbl's own answers to words that a lenient board accepts."""
    lines = ("%", "O1", "G64", "G43 H1", "M6", "G98", "G81 X1 Z-1 R1 F100", "G4 S1")
    assert answers(*lines, lenient=False) == [
        "error:1",
        *["error:20"] * 6,
        "error:28",
    ]
    more_answers = answers("M114", "M115", "M204 S9", "M400", lenient=False)
    assert more_answers == [*["error:20"] * 3, "error:23"]


# What OpenPnP makes of an answer: FIRMWARE_NAME must contain "Grbl", and a position is X:, Y: and
# so on, with a space between (its GcodeDriverSolutions.java; facts only).
_PROPERTY = re.compile(r"([A-Za-z0-9_\-]+):([^:]*)(?= [A-Za-z0-9_\-]+:|$)")
_PLACES = re.compile(r"^.*X:(?P<X>-?\d+\.\d+) Y:(?P<Y>-?\d+\.\d+) Z:(?P<Z>-?\d+\.\d+).*")


def test_firmware_and_work_position_are_reported_as_openpnp_reads_them() -> None:
    """M114 reports the work position, M115 the firmware. No part may look like an answer."""
    bench = Bench()
    replies = bench.say(
        "G0 X1.5", "G92 X0.25 Y7", "G91 G1 Y-2 F500", "M400", "N8 M114", "M115 ; who"
    )
    position_line, last = replies[4]
    assert last == "ok"
    match = _PLACES.match(position_line)
    # G92 set 0.25 and 7; Y then moved by -2.
    assert match and [float(number) for number in match.groups()] == [0.25, 5, 0]
    firmware_line, last = replies[5]
    assert last == "ok"
    assert dict(_PROPERTY.findall(firmware_line)) == {
        "FIRMWARE_NAME": "Grbl",
        "FIRMWARE_VERSION": "1.1h",
        "MACHINE_TYPE": "ugrbl",
        "AXIS_COUNT": "3",
    }
    assert not re.search("ok|error", position_line + firmware_line, re.IGNORECASE)


def test_m400_is_answered_when_motion_has_ended() -> None:
    """M114 is answered at once, with the position of that moment."""
    bench = Bench()
    replies: list[str] = []

    def script() -> Iterator[Any]:
        """Send M114 in motion, then M400, and M114 again after its answer."""
        sender, link = bench.sender, bench.rig.link
        yield from sender.wait("banner", "")
        link.send(b"G1 X5 F500\n")
        yield bench.rig.ms(200)  # in motion
        link.send(b"M114\n")
        yield bench.rig.ms(10)  # the answer arrives
        sender.poll()
        replies.extend(sender.take())
        assert bench.rig.moving()
        yield from sender.wait("ok", "M400\n")
        assert not bench.rig.moving()
        yield from sender.wait("ok", "M114\n")
        replies.extend(sender.take())

    bench.rig.run(script())
    # The number after "X:".
    early, late = (float(line[2:7]) for line in replies if line.startswith("X:"))
    assert 0 < early < 2 and late == 5


def test_check_mode_executes_none_of_them() -> None:
    all_replies = Bench().say("$C", "M114", "M115", "M400", "M204 S9 G1 X1 F100")
    assert [replies[-1] for replies in all_replies] == ["ok"] * 5
    assert all_replies[1:4] == [["ok"]] * 3  # no reports


def test_active_tool_length_is_not_ended_by_an_ignored_word() -> None:
    """With a tool length active, G49 is not ignored: it is executed or refused as by Grbl."""
    all_replies = Bench().say("G43.1 Z2", "G0 G49", "G49", "G0 G49 X1")
    assert [replies[-1] for replies in all_replies] == ["ok", "error:24", "ok", "ok"]


def test_m6_waits_for_the_user_with_the_spindle_off() -> None:
    """M6 stops the spindle, names the tool, and holds (Hold:0) until ~; only then comes its ok."""
    bench = Bench()
    observed: list[tuple[bool, str]] = []

    def script() -> Iterator[Any]:
        """Start the spindle, change the tool, look at spindle and report, and resume."""
        yield from bench.sender.wait("ok", "M3 S100\n")
        yield from bench.sender.wait("ms 1000", "N7 T12 M6\n")  # send, and wait for 1000 ms
        yield from bench.sender.wait("report", "?")
        observed.append((bench.rig.port.spindle_on, "".join(bench.sender.take())))
        yield from bench.sender.wait("ok", "~\n")

    bench.rig.run(script())
    ((spindle_on, output),) = observed
    assert (
        not spindle_on and "[MSG:Insert tool 12, then send ~]" in output and "<Hold:0|" in output
    )
    assert not output.endswith("ok"), "the line is answered before the tool is changed"


# Drilling

TO_START = ("G0 Z10", "G0 X1 Y1")  # where the tool is before a cycle


@pytest.mark.parametrize(
    ("cycle", "by_hand"),
    [
        (
            ("G81 X5 Y6 Z-2 R2 F100",),
            ("G0 X5 Y6", "G0 Z2", "G1 Z-2 F100", "G0 Z10"),
        ),
        (
            ("G99 G82 X5 Z-2 R2 P.5 F100", "Y7", "G80"),
            ("G0 X5", "G0 Z2", "G1 Z-2 F100", "G4 P.5", "G0 Z2")
            + ("G0 Y7", "G1 Z-2", "G4 P.5", "G0 Z2"),
        ),
        (
            ("G83 X5 Z-2 R1 Q1.25 F100",),
            ("G0 X5", "G0 Z1", "G1 Z-.25 F100", "G0 Z1", "G0 Z.004", "G1 Z-1.5", "G0 Z1")
            + ("G0 Z-1.246", "G1 Z-2", "G0 Z10"),
        ),
        (
            ("G73 X5 Z-2 R1 Q1.25 F100",),
            ("G0 X5", "G0 Z1", "G1 Z-.25 F100", "G0 Z.004", "G1 Z-1.5", "G0 Z-1.246")
            + ("G1 Z-2", "G0 Z10"),
        ),
        (
            ("G85 X5 Z-2 R2 F100",),
            ("G0 X5", "G0 Z2", "G1 Z-2 F100", "G1 Z10"),
        ),
        (
            ("G89 X5 Z-2 R2 P.1 F100",),
            ("G0 X5", "G0 Z2", "G1 Z-2 F100", "G4 P.1", "G1 Z10"),
        ),
        (  # R above the tool: up first, and back to R
            ("G81 X5 Z-2 R12 F100", "X6"),
            ("G0 Z12", "G0 X5", "G1 Z-2 F100", "G0 Z12", "G0 X6", "G1 Z-2", "G0 Z12"),
        ),
        (  # increments: R from the tool, Z from R, places from one to the next
            ("G91 G81 X2 Y3 Z-4 R-8 L2 F100", "G90"),
            ("G0 X3 Y4", "G0 Z2", "G1 Z-2 F100", "G0 Z10")
            + ("G0 X5 Y7", "G0 Z2", "G1 Z-2", "G0 Z10"),
        ),
        (
            ("G20 G81 X.2 Z-.1 R.1 F10", "G21"),
            ("G20 G0 X.2", "G0 Z.1", "G1 Z-.1 F10", "G21 G0 Z10"),
        ),
        (
            ("G18 G81 X5 Z6 Y-2 R3 F100", "G17"),
            ("G0 Y3", "G0 Z6 X5", "G1 Y-2 F100", "G0 Y3"),
        ),
        (
            ("G10 L2 P1 Z1", "G81 X5 Z-2 R2 F100", "G54"),
            ("G10 L2 P1 Z1", "G0 X5", "G0 Z2", "G1 Z-2 F100", "G0 Z9"),
        ),
        (  # the motion mode before G81 is active again after G80
            ("G1 F50", "G81 X5 Z-2 R2 F100", "G80", "X7"),
            ("G0 X5", "G0 Z2", "G1 Z-2 F100", "G0 Z10", "G1 X7"),
        ),
        (
            ("G81 X5 Z-2 R2 F100", "G0 X7", "X8"),
            ("G0 X5", "G0 Z2", "G1 Z-2 F100", "G0 Z10", "G0 X7", "X8"),
        ),
        (
            ("M3 S50 G81 X5 Z-2 R2 F100 M8", "G54 X6", "M9"),
            ("M3 S50 M8 F100", "G0 X5", "G0 Z2", "G1 Z-2", "G0 Z10")
            + ("G0 X6", "G0 Z2", "G1 Z-2", "G0 Z10"),
        ),
    ],
)
def test_cycle_drills_as_in_the_standard(cycle: "Sequence[str]", by_hand: "Sequence[str]") -> None:
    """A cycle makes the same moves as its lines written by hand for a board without cycles."""
    assert moves(*TO_START, *cycle) == moves(*TO_START, *by_hand, lenient=False)


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("G81 X1 Z-1 R1", 22),
        ("G81 X1 Z-1 F100", 28),
        ("G81 X1 R1 F100", 28),
        ("G81 Z-1 R1 F100 G1", 21),
        ("G81 G82 X1 Z-1 R1 P1 F100", 21),
        ("G81 R1 F100", 26),
        ("G81 X1 X2 Z-1 R1 F100", 25),
        ("G81 X1 Z2 R1 F100", 33),
        ("G81 X1 Z-1 R1 Q1 F100", 36),
        ("G81 X1 Z-1 R1 L0 F100", 4),
        ("G81 X1 Z-1 R1 L1.5 F100", 23),
        ("G81 X1 Z-1 R1 L65536 F100", 38),
        ("G81 X1 Z-1 R1 L99999999999 F100", 38),
        ("G82 X1 Z-1 R1 F100", 28),
        ("G82 X1 Z-1 R1 P-1 F100", 4),
        ("G83 X1 Z-1 R1 F100", 28),
        ("G83 X1 Z-1 R1 Q0 F100", 4),
        ("G93 G81 X1 Z-1 R1 F100", 22),
        ("G81 X1 Z-1 R1 F100 M30", 21),
        ("G81 X1 Z-1 R1 F100 G4 P1", 28),
        ("G84 X1 Z-1 R1 F100", 20),
        ("G81 X Z-1 R1 F100", 20),
        ("G81 X1_0 Z-1 R1 F100", 20),
        ("T1 M6 G81 X1 Z-1 R1 F100", 20),
    ],
)
def test_impossible_cycle_is_refused_and_changes_nothing(line: str, error: int) -> None:
    """Words are missing, contradict each other, or have impossible values."""
    bench = Bench()
    replies = bench.say("$G", line, "$G", "G0 X1", "X2")
    assert replies[1] == [f"error:{error}"]
    assert replies[0] == replies[2]  # $G
    # Only the last two lines moved; G81 is not active.
    assert [move[0] for move in bench.moves] == ["rapid"] * 2


HOLE = "G81 X5 Y5 Z-2 R2 F600"


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("G20 X1", 28),  # R and Z were mm
        ("G91 X1", 28),  # and absolute
        ("G18 X6 Y-3", 28),
        ("G53 Z-1", 30),
        ("X6 Q1", 36),
        ("X6 P", 2),
        ("G98 G99 X6", 21),
        ("M6 X6", 20),
    ],
)
def test_modal_numbers_with_another_meaning_are_not_reused(line: str, error: int) -> None:
    """A cycle's R and Z stay in force for lines of places.

    A line that changes units, mode or plane cannot reuse them; the next line still can.
    """
    bench = Bench()
    replies = bench.say(*TO_START, HOLE, "$G", line, "$G", "X6")
    assert replies[4] == [f"error:{error}"] and replies[3] == replies[5]
    # The hole of the last line, X6: over it, to R, to Z, and back.
    assert [move[1:] for move in bench.moves[-4:]] == [(6, 5, z) for z in (10, 2, -2, 10)]


@pytest.mark.parametrize("word", ["G98", "G99", "G43 H1", "G64", "N5", "%"])
def test_ignored_words_may_be_in_a_line_of_places(word: str) -> None:
    """A line of places (X6) repeats the hole of an active cycle."""
    bench = Bench()
    line = f"X6{word}" if word == "%" else f"{word} X6"
    replies = bench.say(*TO_START, HOLE, line)
    assert replies[-1][-1] == "ok"
    last_z = 2 if word == "G99" else 10  # G99: up to R only
    assert [move[1:] for move in bench.moves[-4:]] == [(6, 5, z) for z in (10, 2, -2, last_z)]


def test_new_plane_starts_the_cycle_anew() -> None:
    """In G18 the drilling axis is Y: Y-3 is the bottom, R4 the height above it."""
    bench = Bench()
    bench.say(*TO_START, HOLE, "G18 X6 Y-3 R4")
    # Y to R 4, down to -3, and back to the Y before the cycle, 5.
    assert [move[1:] for move in bench.moves[-3:]] == [(6, 4, 10), (6, -3, 10), (6, 5, 10)]


def test_pecks_smaller_than_a_step_are_refused() -> None:
    assert answers(*TO_START, "G83 X5 Z-10 R2 Q0.0000001 F100")[-1] == "error:4"


def test_reset_in_check_mode_acts_during_any_number_of_holes() -> None:
    """L repeats a cycle in one line. Reports and a reset must not wait for its end."""
    bench = Bench()
    output: list[str] = []

    def script() -> Iterator[Any]:
        """In check mode ($C), send a line of 65,535 holes; ask for a report, and reset."""
        yield from bench.sender.wait("banner", "")
        yield from bench.sender.wait("ok", "$C\n")
        yield from bench.sender.wait("ms 500", "G81 X5 Z-10 R2 F100 L65535\n")
        yield from bench.sender.wait("report", "?")
        output.extend(bench.sender.take())
        yield from bench.sender.wait("banner", "\x18")

    bench.rig.run(script())
    assert output.count("ok") == 1  # the answer to $C
    assert output[-1].startswith("<Check")


def test_m6_names_the_last_tool_word_and_none_after_a_reset() -> None:
    """T3 is in force at the first M6. The reset clears T7, so the second M6 names tool 0."""
    all_replies = Bench().say(*TO_START, HOLE, "X6 T3", "M6", "T7", "G4 P0", "\x18", "M6")
    messages = [
        text for replies in all_replies for text in replies if text.startswith("[MSG:Insert tool")
    ]
    assert messages == ["[MSG:Insert tool 3, then send ~]", "[MSG:Insert tool 0, then send ~]"]


@pytest.mark.parametrize("line", ["G43 H2", "G43 G43.1 Z5", "M3 G4 S3"])
def test_word_with_a_meaning_is_not_ignored(line: str) -> None:
    """G43 during a tool length, or G4 S with M3 (whose S is a speed), is refused as by Grbl."""
    replies = Bench().say("G43.1 Z3", "$G", line, "$G")
    assert replies[2][-1].startswith("error:") and replies[1] == replies[3]


def test_end_of_a_program_ends_g99_with_the_cycle() -> None:
    """After M2 the retract is to the Z before the cycle again (G98)."""
    hole = "G81 X5 Z-2 R2 F1000"
    bench = Bench()
    bench.say(*TO_START, "G99 " + hole, "M2", "G0 Z10", hole)
    # Z of the moves: bottom, R (G99); 10; over the hole, R, bottom, and back to 10 (G98).
    assert [move[3] for move in bench.moves[-7:]] == [-2, 2, 10, 10, 2, -2, 10]


def test_reset_ends_a_cycle() -> None:
    bench = Bench()
    bench.say(*TO_START, "G81 X5 Z-2 R2 F1000", "G4 P0", "\x18", "X7")
    assert bench.moves[-1][0] == "rapid" and bench.moves[-1][1] == 7


_WORDS = st.sampled_from(
    "G0 G1 G4 G17 G18 G20 G21 G28 G43 G43.1 G49 G53 G61.1 G64 G73 G80 G81 G83 G90 G91 G92 G98 G99 "
    "M0 M3 M5 M6 M30 T2 T300 N5 O7 H1 F300 S.2 P.1 Q.5 L2 X1 X-2 Y3 Z-1 Z.5 R2 R-3 I1 % G".split()
)
_LINES = st.lists(st.lists(_WORDS, min_size=1, max_size=6).map(" ".join), max_size=12)


@pytest.mark.thorough
@given(_LINES)
@some(60)
def test_every_line_is_executed_or_refused_without_effect(lines: "list[str]") -> None:
    """Lines are random words, many of them those that LENIENT handles."""
    bench = Bench()
    # $G before and after each line shows whether it had an effect.
    sent = [text for line in lines for text in ("$G", line, "$G")]
    all_replies = bench.say(*sent, "$G")
    for line, before, answer, after in zip(
        lines, all_replies[::3], all_replies[1::3], all_replies[2::3]
    ):
        assert answer[-1] == "ok" or re.fullmatch(r"error:\d+", answer[-1]), (line, answer)
        if answer[-1] != "ok":
            assert answer[:-1] == [], (line, answer)
            assert before == after, line


# Extras that define such words


def with_extra(install: "Callable[[Cnc], None]", monkeypatch: pytest.MonkeyPatch) -> Bench:
    """Return a lenient machine with an extra whose install() is this function."""
    extra = ModuleType("mine")
    extra.install = install  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "mine", extra)
    return Bench(extras=("mine",))


def test_words_of_extras_have_precedence(monkeypatch: pytest.MonkeyPatch) -> None:
    """An extra defines M6, G81 and M100: these are not ignored or replaced.

    Grbl's rules apply to them; other words and cycles are still those of LENIENT.
    """
    calls: list[Any] = []

    def install(cnc: Cnc) -> None:
        cnc.add_m(6, calls.append, "t")  # lower case: T may be missing
        cnc.add_g(81, lambda x: calls.append(("hole", x)), "X")
        cnc.add_m(100, calls.append, "X")

    bench = with_extra(install, monkeypatch)
    all_replies = bench.say(
        "T3 M6", "G81 X2", "G81 X2 Y1", "T3 M6 G64", "G82 X1 Z-1 R1 P0 F900", "X2", "M100 X7"
    )
    assert calls == [3.0, ("hole", 2.0), 7.0]
    assert [replies[-1] for replies in all_replies] == [
        "ok",
        "ok",
        "error:36",  # the extra's G81 does not use Y
        "error:21",  # an extra's word has no other G or M word on its line
        "ok",
        "ok",
        "ok",
    ]
    # 7 moves: those of the two holes of G82.
    assert len(bench.moves) == 7 and not any(
        "[MSG:M6" in text for replies in all_replies for text in replies
    )


def test_lines_of_handlers_are_not_part_of_a_cycle(monkeypatch: pytest.MonkeyPatch) -> None:
    """A handler of M100 moves Z by lines of its own while a cycle is active.

    These are no holes, and the next line of places drills.
    """

    def install(cnc: Cnc) -> None:
        """Define M100, which moves Z down and up, and a G43 that is always refused."""
        hooks = cnc.machine.state.hooks

        def lower() -> None:
            for text in (b"G53G0Z-1\0", b"G53G0Z20\0"):
                hooks.execute(bytearray(text), len(text) - 1)  # the length without the 0

        def refuse(_tool: float) -> None:
            raise GrblError(errors.NEGATIVE_VALUE)

        cnc.add_m(100, lower)
        cnc.add_g(43, refuse, "H")

    bench = with_extra(install, monkeypatch)
    all_replies = bench.say(*TO_START, HOLE, "M100", "X7", "G43 H1", "G0 G43 H1 Z5")
    assert [move[1:] for move in bench.moves[-4:]] == [(7, 5, z) for z in (20, 2, -2, 10)]
    # The G43 of the extra does not use Z.
    assert [replies[-1] for replies in all_replies[-2:]] == ["error:4", "error:36"]


def test_extra_with_a_cycle_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """add_cycle() would define a cycle, here G86, of the extra's own."""

    def install(cnc: Cnc) -> None:
        cnc.add_cycle(86, lambda *_: ())

    with pytest.raises(ValueError, match="LENIENT has its own canned cycles"):
        with_extra(install, monkeypatch).say("G0X1")


def test_holes_begin_at_the_position_left_by_a_handler(monkeypatch: pytest.MonkeyPatch) -> None:
    """A handler moves Z to -2 in the line of a cycle.

    The cycle starts there, below R: first it moves up to R, and at the end back to R.
    """

    def install(cnc: Cnc) -> None:
        """Let each line with T4 be followed by a move to Z-2."""
        hooks = cnc.machine.state.hooks
        call_execute = hooks.execute

        def execute(line: bytearray, length: int) -> None:
            call_execute(line, length)
            if line[:2] == b"T4":
                call_execute(bytearray(b"G53G0Z-2\0"), len("G53G0Z-2"))

        hooks.execute = execute

    bench = with_extra(install, monkeypatch)
    bench.say("G0 Z10", "T4 G81 X8 Z-5 R3 F600")
    assert [move[3] for move in bench.moves] == [10, -2, 3, 3, -5, 3]


# Programs


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the path of a lenient board's file."""
    file = tmp_path_factory.mktemp("boards") / "lenient_pico.py"
    file.write_text((BOARDS / "rpi_pico.py").read_text() + "LENIENT = True\n")
    return str(file)


def run_totals(lines: "Sequence[str]", board: str) -> "dict[str, Any]":
    """Return steps, bounds and final position of a program, which must be accepted."""
    result, _ = run_program([line.encode("latin-1") for line in lines], board=board)
    assert not result.errors and not result.stopped, result
    totals = vars(result.totals)
    return {name: totals[name] for name in ("steps_made", "bounds_mm", "final_position_mm")}


@pytest.mark.thorough
def test_lines_of_places_drill_on_the_fast_path(board: str) -> None:
    """Lines with only places (X… Y…) are moves for the firmware's fastest code.

    While a cycle is active they must be holes: the same as moves on a board that is not lenient.
    """
    places = [f"X{k} Y{k % 7}" for k in range(6, 40)]
    program = ["G0 Z10", "G81 X5 Y5 Z-2 R2 F600", *places, "G80", "G0 X1", "X2", "M2"]
    by_hand = ["G0 Z10", "F600"]
    for place in ["X5 Y5", *places]:
        by_hand += [f"G0 {place}", "G0 Z2", "G1 Z-2", "G0 Z10"]
    by_hand += ["G0 X1", "X2", "M2"]
    assert run_totals(program, board) == run_totals(by_hand, "rpi_pico")


@pytest.mark.thorough
@needs_programs
def test_most_real_programs_run_without_errors(board: str) -> None:
    """At least 30 of the real programs run without errors.

    Those of _SMALL, which Grbl refuses, are among them.
    """
    refused_by_grbl = [name for name, figures in _GRBL.items() if figures["errors"]]
    accepted_now = []
    for name in refused_by_grbl:
        result, _ = run_program(read_lines(_PROGRAMS / name), board=board, check=True)
        if not result.errors:
            accepted_now.append(name)
    assert len(_GRBL) - len(refused_by_grbl) + len(accepted_now) >= 30
    assert set(_SMALL) <= set(accepted_now)


# Short programs that Grbl refuses.
_SMALL = (
    "asis_post_o0001.tap",
    "cambam_panel.nc",
    "carbide_create_vcarve.nc",
    "fusion_mach_drill.tap",
    "inkscape_gcodetools_sun.ngc",
    "linuxcnc_arcspiral.ngc",
    "mach3_clamp.nc",
    "pcb2gcode_drill.ngc",
    "vcarve_fengrave.tap",
    "vectric_deer.tap",
)
_MAX_LINES = 100  # lines of each that are used; only moves follow
# The changes that a user of Grbl makes by hand, except drilling.
_BY_HAND = (
    (r"^(N\d+)? *%|^O\d+.*", ""),
    (r"\(.*?\)|;.*", ""),
    (r"G64( *P[\d.]+)?|G43|H\d+|G49", ""),
    (r"(G0?0.*)G80", r"\1"),
    (r".*M0?6\b.*", "M5\nM0"),
    (r"G98|^G80$", ""),
)


def by_hand(lines: "Sequence[bytes]") -> "list[str]":
    """Return a program as its user would correct it."""
    cleaned = []
    drill: dict[str, str] = {}
    for line in lines:
        text = line.decode("latin-1").upper().strip()
        if text.startswith("G80"):
            drill = {}
            cleaned.append("G0")
            continue
        for pattern, new in _BY_HAND:
            text = re.sub(pattern, new, text).strip()
        words = dict(re.findall(r"([A-Z]) *(-?[\d.]+)", text))
        # A drilling cycle, or a line of places while one is active: written as moves.
        if words.get("G") in ("73", "81") or (drill and words):
            drill = {**drill, **words}
            cleaned += _drilled(drill, words)
        else:
            cleaned += text.split("\n")
    return cleaned


def _drilled(drill: "dict[str, str]", words: "dict[str, str]") -> "Iterator[str]":
    """Yield a hole as Grbl's moves. In these programs the tool is at R before and after it."""
    yield "G0 " + " ".join(letter + words[letter] for letter in "XY" if letter in words)
    top, bottom = float(drill["R"]), float(drill["Z"])
    if "Q" in drill:
        depth = top - float(drill["Q"])
        while depth > bottom + 1e-6:
            yield f"G1 Z{round(depth, 4)} F{drill['F']}"
            # Each peck begins 0.254 mm above the last bottom, as in G73.
            yield f"G0 Z{round(min(top, depth + 0.254), 4)}"
            depth -= float(drill["Q"])
    yield f"G1 Z{drill['Z']} F{drill['F']}"
    yield f"G0 Z{drill['R']}"


@pytest.mark.sampled(1, 3)
@needs_programs
@pytest.mark.parametrize("name", _SMALL)
def test_programs_move_like_a_copy_corrected_by_hand(name: str, board: str) -> None:
    lines = read_lines(_PROGRAMS / name)[:_MAX_LINES]
    as_it_is = [line.decode("latin-1") for line in lines]
    assert run_totals(as_it_is, board) == run_totals(by_hand(lines), "rpi_pico")
