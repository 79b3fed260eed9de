"""Test extras: modules with install(cnc), added to a machine that does not know them.

Bench(…, install).say() powers up a machine with this extra and sends texts, each with what to wait
for: "ok" (an answer), "idle" or "ms 50" (50 ms); it returns the replies to each. lines() are texts
that wait for "ok".
"""

import sys
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

import pytest
from base import errors
from base import state as st
from base.errors import GrblError
from base.settings import INT
from boot.options import Options
from extras.api import Cnc
from extras.custom.positions import ModalState
from ugrbl.boardfile.files import load_board
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig
from ugrbl.sim.sender import Sender


class Bench:
    """A machine with one extra, `install`, and a sender."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, install: "Callable[[Cnc], None]") -> None:
        """Put `install` into a module "mine", the only one of EXTRAS of the board file."""
        extra = ModuleType("mine")
        extra.install = install  # type: ignore[attr-defined]
        monkeypatch.setitem(sys.modules, "mine", extra)
        board = ModuleType("board")
        vars(board).update(vars(load_board("sim")), EXTRAS=("mine",))
        self.rig = Rig(board, factory_store(load_board("sim")))
        self.sender = Sender(self.rig)
        self.sender.allow(3_600_000)  # ms for all waits

    def say(self, *talk: "tuple[str, str]") -> "list[list[str]]":
        """Power up and send texts, each given as (text, what to wait for: see Sender.wait());
        return the replies to each."""
        replies: list[list[str]] = []

        def script() -> Iterator[Any]:
            """Wait for the welcome, then send each text and store its replies."""
            yield from self.sender.wait("banner", "")
            self.sender.take()
            for text, how in talk:
                yield from self.sender.wait(how, text)
                replies.append(self.sender.take())

        self.rig.run(script())
        return replies


def lines(*texts: str) -> "list[tuple[str, str]]":
    return [(text + "\n", "ok") for text in texts]


# Words


def test_m_word_gets_its_numbers_after_motion_has_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """P is required, q optional (None). The handler runs when planner and engine are idle."""
    calls: list[Any] = []  # p, q, planner empty, engine idle

    def install(cnc: Cnc) -> None:
        def vacuum(p: float, q: "float | None") -> None:
            calls.append((p, q, cnc.machine.planner.empty(), cnc.machine.engine.idle()))

        cnc.add_m(100, vacuum, "Pq")

    replies = Bench(monkeypatch, install).say(*lines("G0X5", "M100 P2", "N7 m100 p1.5 q3"))
    assert replies == [["ok"]] * 3
    assert calls == [(2.0, None, True, True), (1.5, 3.0, True, True)]


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("M100", errors.GCODE_VALUE_WORD_MISSING),
        ("M100 Q1", errors.GCODE_VALUE_WORD_MISSING),
        ("M100 P1 X2", errors.GCODE_UNUSED_WORDS),
        ("M100 P1 P2", errors.GCODE_WORD_REPEATED),
        ("M100 P1 G0", errors.GCODE_MODAL_GROUP_VIOLATION),
        ("M100 P", errors.BAD_NUMBER_FORMAT),
        ("M101 P1", errors.GCODE_UNSUPPORTED_COMMAND),
    ],
)
def test_refused_line_calls_no_handler(
    monkeypatch: pytest.MonkeyPatch, line: str, error: int
) -> None:
    """M100 needs P and allows Q. The line is M100 with something missing, added or wrong."""
    calls: list[Any] = []
    bench = Bench(monkeypatch, lambda cnc: cnc.add_m(100, lambda *n: calls.append(n), "Pq"))
    assert bench.say(*lines(line)) == [[f"error:{error}"]] and calls == []


def test_check_mode_checks_and_does_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[Any] = []
    bench = Bench(monkeypatch, lambda cnc: cnc.add_m(100, lambda *n: calls.append(n), "P"))
    replies = bench.say(*lines("$C", "M100P1", "M100"))
    assert replies[1:] == [["ok"], [f"error:{errors.GCODE_VALUE_WORD_MISSING}"]] and calls == []


def test_g_word_may_have_a_decimal(monkeypatch: pytest.MonkeyPatch) -> None:
    """G81 and G81.1 are different words, each with its handler."""
    calls: list[Any] = []

    def install(cnc: Cnc) -> None:
        cnc.add_g(81, lambda: calls.append("81"))
        cnc.add_g(81.1, lambda: calls.append("81.1"))

    assert Bench(monkeypatch, install).say(*lines("G81.1", "G81")) == [["ok"], ["ok"]]
    assert calls == ["81.1", "81"]


def test_words_and_bytes_of_grbl_cannot_be_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """Grbl uses M3, G0, G38.2, G80, G92, byte 0x84 and the letter A; install() has added M100 and
    G86. G28.2 is free, because Grbl does not support it."""

    def install(cnc: Cnc) -> None:
        """Add M100 and cycle G86; then adding anything in use must fail."""
        cnc.add_m(100, print)
        cnc.add_cycle(86, _bore)
        for add in (
            lambda: cnc.add_m(3, print),
            lambda: cnc.add_m(100, print),
            lambda: cnc.add_g(0, print),
            *(lambda word=word: cnc.add_g(word, print) for word in (28.1, 38.2, 43.1, 91.1, 92.1)),
            lambda: cnc.add_g(86, print),
            lambda: cnc.add_cycle(86, _bore),
            lambda: cnc.add_cycle(80, _bore),
            lambda: cnc.add_cycle(92, _bore),
            lambda: cnc.add_byte(0x84, print),
            lambda: cnc.add_byte(0x41, print),
        ):
            with pytest.raises(ValueError, match="is already in use"):
                add()
        cnc.add_g(28.2, print)

    Bench(monkeypatch, install).say()


def test_handler_may_refuse_and_is_ended_by_a_reset(monkeypatch: pytest.MonkeyPatch) -> None:
    """M100 P0 is refused with a Grbl error. M100 P1 never ends, but serves the machine: it still
    reports, and a reset ends it."""

    def install(cnc: Cnc) -> None:
        """Add M100: P0 is refused, others wait for ever."""

        def wait(p: float) -> None:
            if p == 0:
                raise GrblError(errors.NEGATIVE_VALUE)
            while True:
                cnc.service()

        cnc.add_m(100, wait, "P")

    bench = Bench(monkeypatch, install)
    replies = bench.say(
        ("M100P0\n", "ok"), ("M100P1\n", "ms 50"), ("?", "report"), ("\x18", "banner")
    )
    assert replies[0] == [f"error:{errors.NEGATIVE_VALUE}"] and replies[2][0].startswith("<Idle")
    assert replies[3][-1].startswith("Grbl 1.1h")


def _bore(here: "list[float]", target: "list[float]", r: float, p: "float | None") -> "Any":
    """Yield a canned cycle's moves, (position, whether it is rapid): to R, down, up to R + P."""
    yield target[:2] + [r], True
    yield target, False
    yield target[:2] + [r + (p or 0.0)], True


def test_cycle_keeps_its_numbers_until_another_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """Later lines have only X: Z, R and P of the first one are used, until G0 ends the cycle."""
    bench = Bench(monkeypatch, lambda cnc: cnc.add_cycle(86, _bore, "Rp"))
    cycle = ("G20G86X1Z-.2R.1P3F20", "X2", "G21X-2R-1", "G0X0", "X1")
    replies = bench.say(*((text, "idle") for line in cycle for text in (line + "\n", "?")))
    assert replies[::2] == [["ok"]] * 5
    places = [report[0].partition("MPos:")[2].partition("|")[0] for report in replies[1::2]]
    # Z ends at R + P: 0.1 in = 2.54 mm, and 3; then R-1 in mm, and 3. P has no unit.
    at = ("25.400,0.000,5.540", "50.800,0.000,5.540", "-2.000,0.000,2.000", "0.000,0.000,2.000")
    assert places == [*at, "1.000,0.000,2.000"]  # the last X1 is a rapid: Z stays
    # After another motion Z and R are required again; P is not.
    again = lines("G86X1Z-1R1P5F9", "G0X2", "G86X1R1", "G86X1Z-1", "X3", "G86X1Z-1R0", "$G")
    replies = bench.say(*again)
    assert replies[2:6] == [["error:28"], ["error:28"], ["ok"], ["ok"]]
    assert replies[6][0].startswith("[GC:G86 G54 ")


def test_cycle_numbers_are_restored_after_a_with_statement(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """M100 executes G86 with Z-9 between two lines of G86; ModalState is custom.py's m.saved().

    The line X2 after it uses Z-1 of the first line again.
    """
    deepest: list[float] = []  # Z of each cycle

    def bore(here: "list[float]", target: "list[float]", r: float) -> "Any":
        deepest.append(target[2])
        return [(target, False)]

    def install(cnc: Cnc) -> None:
        """Add cycle G86, and M100, which executes a G86 with other numbers."""

        def deeper() -> None:
            with ModalState(cnc.machine, standard=False, blocks=[]):
                cnc.machine.state.hooks.execute(bytearray(b"G86X0Z-9R1\0"), 10)  # length

        cnc.add_cycle(86, bore)
        cnc.add_m(100, deeper)

    replies = Bench(monkeypatch, install).say(*lines("G86X1Z-1R1F99", "M100", "X2"))
    assert replies == [["ok"]] * 3 and deepest == [-1, -9, -1]


def test_polling_stops_while_a_reset_is_pending(monkeypatch: pytest.MonkeyPatch) -> None:
    """Functions of extras are called in the main loop (poll), but not between a reset's byte and
    its execution: they could start something that it would not end."""
    resets: list[int] = []  # at each call, whether a reset is pending

    def install(cnc: Cnc) -> None:
        state = cnc.machine.state
        state.hooks.poll += (lambda: resets.append(state.pending[st.RESET]),)

    Bench(monkeypatch, install).say(("G1X9F99\n", "ms 500"), ("\x18", "banner"), ("?", "report"))
    assert len(resets) > 10 and not any(resets)


def test_job_cannot_be_entered_in_the_middle_of_a_cycle(monkeypatch: pytest.MonkeyPatch) -> None:
    """M100 asks if a program could be entered here: before a cycle, within one, after one."""
    whys: list[str] = []  # reasons against it; "": none

    def install(cnc: Cnc) -> None:
        cnc.add_cycle(86, _bore, "Rp")
        cnc.add_m(100, lambda: whys.extend(why() for why in cnc.entries))

    bench = Bench(monkeypatch, install)
    bench.say(*lines("M100", "G86X1Z-1R1F9", "M100", "G0X1", "M100"))
    assert whys == ["", "the line is inside a canned cycle: start before it", ""]


def test_refused_line_of_a_cycle_changes_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Refused are G18, G91, G93 (error 20), the unused word L (36), and no axis (26)."""
    bench = Bench(monkeypatch, lambda cnc: cnc.add_cycle(86, _bore, "Rp"))
    wrong = ("G18G86X1Z-1R0F9", "G91G86X1Z-1R0F9", "G93G86X1Z-1R0F9", "G86X1Z-1R0L1F9", "G86R0F9")
    replies = bench.say(*lines(*wrong, "$G"))
    assert replies[:5] == [[f"error:{n}"] for n in (20, 20, 20, 36, 26)]
    assert replies[5][0] == "[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]"


# Settings, commands, fields, bytes


def test_setting_is_stored_with_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """An extra adds $40, named "level", with the default 5. It is stored with Grbl's settings."""
    bench = Bench(monkeypatch, lambda cnc: cnc.add_settings(((40, "level", INT, 5, "percent"),)))
    assert "$40=5" in bench.say(("$$\n", "ok"))[0]
    assert bench.say(("$40=7\n", "ok"), ("$$\n", "ok"))[1].count("$40=7") == 1
    assert "$40=7" in bench.rig.store.files["settings"]
    assert bench.rig.controller.settings.level == 7  # type: ignore[attr-defined]


def test_command_is_accepted_only_while_idle(monkeypatch: pytest.MonkeyPatch) -> None:
    """$VAC=1 is accepted; during a move $VAC is refused. The handler gets the text after VAC."""
    calls: list[bytes] = []
    bench = Bench(monkeypatch, lambda cnc: cnc.add_command(b"VAC", calls.append))
    replies = bench.say(
        ("$VAC=1\n", "ok"), ("G1X50F100\n", "ok"), ("$VAC\n", "ok"), ("$G\n", "ok")
    )
    assert calls == [b"=1"]
    assert replies[0] == ["ok"] and replies[2] == [f"error:{errors.IDLE_ERROR}"]
    assert replies[3][0].startswith("[GC:G1")


def test_field_is_added_at_the_end_of_the_report(monkeypatch: pytest.MonkeyPatch) -> None:
    texts = iter(["Vac:1", ""])
    bench = Bench(monkeypatch, lambda cnc: cnc.add_field(lambda: next(texts)))
    with_field, without = bench.say(("?", "report"), ("?", "report"))
    assert with_field[0].endswith("|Vac:1>") and "Vac" not in without[0]


def test_byte_is_handled_anywhere_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    bench = Bench(monkeypatch, lambda cnc: cnc.add_byte(0xC0, lambda: calls.append(1)))
    assert bench.say(("G0\xc0X1\n", "idle")) == [["ok"]] and calls == [1]


# Events


def test_guard_prevents_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first machine's guard returns False: no motor moves. The second one's returns True."""
    may: list[bool] = [False]  # what the guard returns
    started: list[int] = []  # an item per start of motion
    stopped: list[int] = []  # at each stop, the number of starts so far

    def install(cnc: Cnc) -> None:
        cnc.before_motion(lambda: may[0])
        cnc.after_start(lambda: started.append(1))
        cnc.after_stop(lambda: stopped.append(len(started)))

    bench = Bench(monkeypatch, install)
    bench.say(("G0X1\n", "ms 500"))
    steps = bench.rig.scratch
    bench.rig.engine.physical(steps)
    assert list(steps) == [0, 0, 0] and started == []
    may[0] = True
    Bench(monkeypatch, install).say(("G0X1\n", "idle"))
    assert started and stopped[-1] == len(started)


def test_lines_of_motion_and_resets_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """after_line is called for lines with motion, not for G4; after_reset also at power-up."""
    calls: list[str] = []

    def install(cnc: Cnc) -> None:
        cnc.after_line(lambda: calls.append("line"))
        cnc.after_reset(lambda: calls.append("reset"))

    Bench(monkeypatch, install).say(*lines("G0X1", "X2", "G4P0", "G1Y1F100"), ("\x18", "banner"))
    assert calls == ["reset", "line", "line", "line", "reset"]


# The board file


def test_missing_module_is_named() -> None:
    board = ModuleType("board")
    vars(board).update(EXTRAS=("nowhere",))
    with pytest.raises(ImportError, match="nowhere"):
        Options(board)


def test_old_method_name_works_and_reports_the_new_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """behind_reset was the name of after_reset. A name that never existed is an error."""
    calls: list[str] = []

    def install(cnc: Cnc) -> None:
        old: Any = cnc
        old.behind_reset(lambda: calls.append("reset"))
        with pytest.raises(AttributeError):
            old.no_such_method()

    replies = Bench(monkeypatch, install).say(("\x18", "banner"), ("$I\n", "ok"))
    assert calls == ["reset", "reset"]  # at power-up, and by \x18
    assert "[MSG:cnc.behind_reset is now cnc.after_reset]" in replies[0] + replies[1]
