"""Test LENIENT: words of other controllers are ignored, replaced or refused."""

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
        board = ModuleType("board")
        vars(board).update(vars(load_board("sim")), LENIENT=lenient, EXTRAS=extras)
        self.rig = Rig(board, factory_store(load_board("sim")))
        self.rig.on_built = self._listen
        self.sender = Sender(self.rig)
        self.sender.allow(36_000_000)
        self.moves: list[Move] = []

    def _listen(self) -> None:
        machine = self.rig.controller
        machine.interpreter.watch(MOVE)  # otherwise the kernel would handle some moves
        planner = machine.planner
        usual = planner.line

        def line(target: Any, move: Any, power: int) -> bool:
            kind = "rapid" if move.flags & 1 else f"F{move.feed:g}"
            self.moves.append((kind, *(round(mm, 4) for mm in target)))
            return usual(target, move, power)

        planner.line = line  # type: ignore[method-assign]

    def say(self, *lines: str) -> "list[list[str]]":
        """Return the replies to each line; pauses are ended with ~."""
        said: list[list[str]] = []

        def script() -> Iterator[Any]:
            yield from self.sender.wait("banner", "")
            self.sender.take()
            for line in lines:
                self.rig.link.send((line + "\n").encode("latin-1"))
                while not self.sender.answers:
                    yield self.rig.ms(300)
                    self.sender.poll()
                    if self.rig.controller.state.suspend:
                        self.rig.link.send(b"~")
                said.append(self.sender.take())

        self.rig.run(script())
        return said


def answers(*lines: str, lenient: bool = True) -> "list[str]":
    """Return the answer to each line, without messages."""
    said = Bench(lenient=lenient).say(*lines)
    return [[text for text in each if not text.startswith("[")][-1] for each in said]


def moves(*lines: str, lenient: bool = True) -> "list[Move]":
    """Return the planned moves; all lines must be accepted."""
    bench = Bench(lenient=lenient)
    said = bench.say(*lines)
    assert all(each[-1] == "ok" for each in said), said
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
    said = Bench().say(line, line, "G4 P0", "\x18", line)
    told = [[text for text in each if text.startswith(f"[MSG:{name}: ")] for each in said]
    del told[2]
    assert [len(each) for each in told] == [1, 0, 0, 1], said


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
    said = bench.say("G0 X1 F100", "$G", line, "$G")
    assert [text.partition(":")[0] for text in said[2]] == ["error"], said[2]
    assert said[1] == said[3] and len(bench.moves) == 1


def test_board_that_is_not_lenient_refuses_them_all() -> None:
    lines = ("%", "O1", "G64", "G43 H1", "M6", "G98", "G81 X1 Z-1 R1 F100", "G4 S1")
    assert answers(*lines, lenient=False) == [
        "error:1",
        *["error:20"] * 6,
        "error:28",
    ]
    said = answers("M114", "M115", "M204 S9", "M400", lenient=False)
    assert said == [*["error:20"] * 3, "error:23"]


# What OpenPnP makes of an answer: FIRMWARE_NAME must contain "Grbl", and a position is X:, Y: and
# so on, with a space between (its GcodeDriverSolutions.java; facts only).
_PROPERTY = re.compile(r"([A-Za-z0-9_\-]+):([^:]*)(?= [A-Za-z0-9_\-]+:|$)")
_PLACES = re.compile(r"^.*X:(?P<X>-?\d+\.\d+) Y:(?P<Y>-?\d+\.\d+) Z:(?P<Z>-?\d+\.\d+).*")


def test_firmware_and_work_position_are_reported_as_openpnp_reads_them() -> None:
    bench = Bench()
    said = bench.say("G0 X1.5", "G92 X0.25 Y7", "G91 G1 Y-2 F500", "M400", "N8 M114", "M115 ; who")
    here, ended = said[4]
    assert ended == "ok"
    found = _PLACES.match(here)
    assert found and [float(number) for number in found.groups()] == [0.25, 5, 0]
    about, ended = said[5]
    assert ended == "ok"
    assert dict(_PROPERTY.findall(about)) == {
        "FIRMWARE_NAME": "Grbl",
        "FIRMWARE_VERSION": "1.1h",
        "MACHINE_TYPE": "ugrbl",
        "AXIS_COUNT": "3",
    }
    assert not re.search("ok|error", here + about, re.IGNORECASE)


def test_m400_is_answered_when_motion_has_ended() -> None:
    """And M114 at once, with the place of that moment."""
    bench = Bench()
    seen: list[str] = []

    def script() -> Iterator[Any]:
        sender, link = bench.sender, bench.rig.link
        yield from sender.wait("banner", "")
        link.send(b"G1 X5 F500\n")
        yield bench.rig.ms(200)
        link.send(b"M114\n")
        yield bench.rig.ms(10)
        sender.poll()
        seen.extend(sender.take())
        assert bench.rig.moving()
        yield from sender.wait("ok", "M400\n")
        assert not bench.rig.moving()
        yield from sender.wait("ok", "M114\n")
        seen.extend(sender.take())

    bench.rig.run(script())
    early, late = (float(line[2:7]) for line in seen if line.startswith("X:"))
    assert 0 < early < 2 and late == 5


def test_check_mode_executes_none_of_them() -> None:
    said = Bench().say("$C", "M114", "M115", "M400", "M204 S9 G1 X1 F100")
    assert [each[-1] for each in said] == ["ok"] * 5
    assert said[1:4] == [["ok"]] * 3


def test_active_tool_length_is_not_ended_by_an_ignored_word() -> None:
    said = Bench().say("G43.1 Z2", "G0 G49", "G49", "G0 G49 X1")
    assert [each[-1] for each in said] == ["ok", "error:24", "ok", "ok"]


def test_m6_waits_for_the_user_with_the_spindle_off() -> None:
    bench = Bench()
    seen: list[tuple[bool, str]] = []

    def script() -> Iterator[Any]:
        yield from bench.sender.wait("ok", "M3 S100\n")
        yield from bench.sender.wait("ms 1000", "N7 T12 M6\n")
        yield from bench.sender.wait("report", "?")
        seen.append((bench.rig.port.spindle_on, "".join(bench.sender.take())))
        yield from bench.sender.wait("ok", "~\n")

    bench.rig.run(script())
    ((spindle_on, said),) = seen
    assert not spindle_on and "[MSG:Insert tool 12, then send ~]" in said and "<Hold:0|" in said
    assert not said.endswith("ok"), "the line is answered before the tool is changed"


# Drilling

AT = ("G0 Z10", "G0 X1 Y1")


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
    assert moves(*AT, *cycle) == moves(*AT, *by_hand, lenient=False)


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
    bench = Bench()
    said = bench.say("$G", line, "$G", "G0 X1", "X2")
    assert said[1] == [f"error:{error}"]
    assert said[0] == said[2]
    assert [move[0] for move in bench.moves] == ["rapid"] * 2


HOLE = "G81 X5 Y5 Z-2 R2 F600"


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("G20 X1", 28),  # R and Z were mm
        ("G91 X1", 28),  # and places
        ("G18 X6 Y-3", 28),
        ("G53 Z-1", 30),
        ("X6 Q1", 36),
        ("X6 P", 2),
        ("G98 G99 X6", 21),
        ("M6 X6", 20),
    ],
)
def test_modal_numbers_with_another_meaning_are_not_reused(line: str, error: int) -> None:
    bench = Bench()
    said = bench.say(*AT, HOLE, "$G", line, "$G", "X6")
    assert said[4] == [f"error:{error}"] and said[3] == said[5]
    assert [move[1:] for move in bench.moves[-4:]] == [(6, 5, z) for z in (10, 2, -2, 10)]


@pytest.mark.parametrize("word", ["G98", "G99", "G43 H1", "G64", "N5", "%"])
def test_ignored_words_may_be_in_a_line_of_places(word: str) -> None:
    bench = Bench()
    line = f"X6{word}" if word == "%" else f"{word} X6"
    said = bench.say(*AT, HOLE, line)
    assert said[-1][-1] == "ok"
    end = 2 if word == "G99" else 10
    assert [move[1:] for move in bench.moves[-4:]] == [(6, 5, z) for z in (10, 2, -2, end)]


def test_new_plane_starts_the_cycle_anew() -> None:
    bench = Bench()
    bench.say(*AT, HOLE, "G18 X6 Y-3 R4")
    assert [move[1:] for move in bench.moves[-3:]] == [(6, 4, 10), (6, -3, 10), (6, 5, 10)]


def test_pecks_smaller_than_a_step_are_refused() -> None:
    assert answers(*AT, "G83 X5 Z-10 R2 Q0.0000001 F100")[-1] == "error:4"


def test_reset_in_check_mode_acts_during_any_number_of_holes() -> None:
    bench = Bench()
    said: list[str] = []

    def script() -> Iterator[Any]:
        yield from bench.sender.wait("banner", "")
        yield from bench.sender.wait("ok", "$C\n")
        yield from bench.sender.wait("ms 500", "G81 X5 Z-10 R2 F100 L9999999\n")
        yield from bench.sender.wait("report", "?")
        said.extend(bench.sender.take())
        yield from bench.sender.wait("banner", "\x18")

    bench.rig.run(script())
    assert said[-1].startswith("<Check")


def test_m6_names_the_last_tool_word_and_none_after_a_reset() -> None:
    said = Bench().say(*AT, HOLE, "X6 T3", "M6", "T7", "G4 P0", "\x18", "M6")
    told = [text for each in said for text in each if text.startswith("[MSG:Insert tool")]
    assert told == ["[MSG:Insert tool 3, then send ~]", "[MSG:Insert tool 0, then send ~]"]


@pytest.mark.parametrize("line", ["G43 H2", "G43 G43.1 Z5", "M3 G4 S3"])
def test_word_with_a_meaning_is_not_ignored(line: str) -> None:
    said = Bench().say("G43.1 Z3", "$G", line, "$G")
    assert said[2][-1].startswith("error:") and said[1] == said[3]


def test_end_of_a_program_ends_g99_with_the_cycle() -> None:
    hole = "G81 X5 Z-2 R2 F1000"
    bench = Bench()
    bench.say(*AT, "G99 " + hole, "M2", "G0 Z10", hole)
    assert [move[3] for move in bench.moves[-7:]] == [-2, 2, 10, 10, 2, -2, 10]


def test_reset_ends_a_cycle() -> None:
    bench = Bench()
    bench.say(*AT, "G81 X5 Z-2 R2 F1000", "G4 P0", "\x18", "X7")
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
    bench = Bench()
    asked = [text for line in lines for text in ("$G", line, "$G")]
    said = bench.say(*asked, "$G")
    for line, before, answer, behind in zip(lines, said[::3], said[1::3], said[2::3]):
        assert answer[-1] == "ok" or re.fullmatch(r"error:\d+", answer[-1]), (line, answer)
        if answer[-1] != "ok":
            assert answer[:-1] == [], (line, answer)
            assert before == behind, line


# Extras that define such words


def beside(install: "Callable[[Cnc], None]", monkeypatch: pytest.MonkeyPatch) -> Bench:
    """Return a lenient machine with an extra."""
    extra = ModuleType("mine")
    extra.install = install  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "mine", extra)
    return Bench(extras=("mine",))


def test_words_of_extras_have_precedence(monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[Any] = []

    def install(cnc: Cnc) -> None:
        cnc.add_m(6, heard.append, "t")
        cnc.add_g(81, lambda x: heard.append(("hole", x)), "X")
        cnc.add_m(100, heard.append, "X")

    bench = beside(install, monkeypatch)
    said = bench.say(
        "T3 M6", "G81 X2", "G81 X2 Y1", "T3 M6 G64", "G82 X1 Z-1 R1 P0 F900", "X2", "M100 X7"
    )
    assert heard == [3.0, ("hole", 2.0), 7.0]
    assert [each[-1] for each in said] == ["ok", "ok", "error:36", "error:21", "ok", "ok", "ok"]
    assert len(bench.moves) == 7 and not any("[MSG:M6" in text for each in said for text in each)


def test_lines_of_handlers_are_not_part_of_a_cycle(monkeypatch: pytest.MonkeyPatch) -> None:
    def install(cnc: Cnc) -> None:
        hooks = cnc.machine.state.hooks

        def lower() -> None:
            for text in (b"G53G0Z-1\0", b"G53G0Z20\0"):
                hooks.execute(bytearray(text), len(text) - 1)

        def refuse(_tool: float) -> None:
            raise GrblError(errors.NEGATIVE_VALUE)

        cnc.add_m(100, lower)
        cnc.add_g(43, refuse, "H")

    bench = beside(install, monkeypatch)
    said = bench.say(*AT, HOLE, "M100", "X7", "G43 H1", "G0 G43 H1 Z5")
    assert [move[1:] for move in bench.moves[-4:]] == [(7, 5, z) for z in (20, 2, -2, 10)]
    assert [each[-1] for each in said[-2:]] == ["error:4", "error:36"]


def test_extra_with_a_cycle_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def install(cnc: Cnc) -> None:
        cnc.add_cycle(86, lambda *_: ())

    with pytest.raises(ValueError, match="LENIENT has its own canned cycles"):
        beside(install, monkeypatch).say("G0X1")


def test_holes_begin_at_the_position_left_by_a_handler(monkeypatch: pytest.MonkeyPatch) -> None:
    def install(cnc: Cnc) -> None:
        hooks = cnc.machine.state.hooks
        usual = hooks.execute

        def execute(line: bytearray, length: int) -> None:
            usual(line, length)
            if line[:2] == b"T4":
                usual(bytearray(b"G53G0Z-2\0"), 8)

        hooks.execute = execute

    bench = beside(install, monkeypatch)
    bench.say("G0 Z10", "T4 G81 X8 Z-5 R3 F600")
    assert [move[3] for move in bench.moves] == [10, -2, 3, 3, -5, 3]


# Programs


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the path of a lenient board's file."""
    file = tmp_path_factory.mktemp("boards") / "lenient_pico.py"
    file.write_text((BOARDS / "rpi_pico.py").read_text() + "LENIENT = True\n")
    return str(file)


def motion(lines: "Sequence[str]", board: str) -> "dict[str, Any]":
    """Return the motion of a program, which must be accepted."""
    result, _ = run_program([line.encode("latin-1") for line in lines], board=board)
    assert not result.errors and not result.stopped, result
    totals = vars(result.totals)
    return {name: totals[name] for name in ("steps_made", "bounds_mm", "final_position_mm")}


@pytest.mark.thorough
def test_lines_of_places_drill_on_the_fast_path(board: str) -> None:
    """Lines with only places take the fastest path, and must not become moves there."""
    places = [f"X{k} Y{k % 7}" for k in range(6, 40)]
    program = ["G0 Z10", "G81 X5 Y5 Z-2 R2 F600", *places, "G80", "G0 X1", "X2", "M2"]
    by_hand = ["G0 Z10", "F600"]
    for place in ["X5 Y5", *places]:
        by_hand += [f"G0 {place}", "G0 Z2", "G1 Z-2", "G0 Z10"]
    by_hand += ["G0 X1", "X2", "M2"]
    assert motion(program, board) == motion(by_hand, "rpi_pico")


@pytest.mark.thorough
@needs_programs
def test_most_real_programs_run_without_errors(board: str) -> None:
    refused = [name for name, seen in _GRBL.items() if seen["errors"]]
    clean = []
    for name in refused:
        result, _ = run_program(read_lines(_PROGRAMS / name), board=board, check=True)
        if not result.errors:
            clean.append(name)
    assert len(_GRBL) - len(refused) + len(clean) >= 30
    assert set(_SMALL) <= set(clean)


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
_FIRST = 100  # of each; only moves follow
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
        if words.get("G") in ("73", "81") or (drill and words):
            drill = {**drill, **words}
            cleaned += _drilled(drill, words)
        else:
            cleaned += text.split("\n")
    return cleaned


def _drilled(drill: "dict[str, str]", words: "dict[str, str]") -> "Iterator[str]":
    """Return a hole in Grbl's words; in these programs the tool is at R before and after it."""
    yield "G0 " + " ".join(letter + words[letter] for letter in "XY" if letter in words)
    top, bottom = float(drill["R"]), float(drill["Z"])
    if "Q" in drill:
        deep = top - float(drill["Q"])
        while deep > bottom + 1e-6:
            yield f"G1 Z{round(deep, 4)} F{drill['F']}"
            yield f"G0 Z{round(min(top, deep + 0.254), 4)}"
            deep -= float(drill["Q"])
    yield f"G1 Z{drill['Z']} F{drill['F']}"
    yield f"G0 Z{drill['R']}"


@pytest.mark.sampled(1, 3)
@needs_programs
@pytest.mark.parametrize("name", _SMALL)
def test_programs_move_like_a_copy_corrected_by_hand(name: str, board: str) -> None:
    lines = read_lines(_PROGRAMS / name)[:_FIRST]
    as_it_is = [line.decode("latin-1") for line in lines]
    assert motion(as_it_is, board) == motion(by_hand(lines), "rpi_pico")
