"""Test the judgement of `ugrbl selftest` with a board that gives scripted answers.

The program on the board prints facts: a name and figures measured there (GOOD: those of a good
board). The computer judges them in rows, one per check: passed True, False, or None if it could
not be checked. The edges of a pin are a list: its level at first, then the ticks at which it
changes. A tick is 0.08 us, so that 125 of them are 10 us."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner
from ugrbl.cli import ports
from ugrbl.cli import selftest as selftest_cli
from ugrbl.cli.app import app
from ugrbl.device.connection import SendError
from ugrbl.device.deploy import About, DeployError
from ugrbl.device.selftest.judge import duty_percent, falls, highs, judge, rises
from ugrbl.device.selftest.session import Wiring

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(4)

PICO = About(0x1F06, "1.28.0", "Raspberry Pi Pico with RP2040")
WIRED = Wiring("pio", 8, 16)
ESP32 = About(0x2B06, "1.28.0", "Generic ESP32 module with ESP32")
WIRED_ESP = Wiring("rmt", 12, 23, True)
_LIMIT = "limit: time to the last step edge"
_LIMIT_IN_COLLECTION = "limit, during a collection: time to the last step edge"


def pulse_edges(hz: int, ticks: int, count: int, begin: int = 100) -> "list[int]":
    """Return the edges of `count` pulses.

    hz: pulses per second; ticks: length of a pulse; begin: tick of the first edge."""
    period_ticks = 12_500_000 // hz
    return [0, *(begin + k * period_ticks + edge for k in range(count) for edge in (0, ticks))]


STILL = [0]  # edges of a pin that stays low
PULSES = {"hz": 50_000, "us": 10, "steps": [pulse_edges(50_000, 125, 9)] * 3, "dirs": [STILL] * 3}
# DIR changes at 100 and 400: 30 ticks after a pulse, 70 before the next.
TURNS = {
    "hold_us": 2,
    "setup_us": 5,
    "steps": [[0, 30, 70, 170, 210, 330, 370, 470, 500]] * 3,
    "dirs": [[0, 100, 400]] * 3,
}
GOOD: "list[tuple[str, dict[str, Any]]]" = [
    (
        "board",
        {"name": "Pico", "micropython": "1.28.0", "hz": 125000000, "axes": 3, "enables": 1},
    ),
    ("watchers", {"made": [20, 10], "seen": [20, 10], "levels": [1, 0]}),
    *(
        (
            "steps",
            {
                "rate": "1 kHz",
                "hz": 1000,
                "back": back,
                "asked": 20,
                "rested": True,
                "position": [0 if back else 20] * 3,
                "counted": [0 if back else 20] * 3,
                "motors": [0, 1, 2],
            },
        )
        for back in (False, True)
    ),
    ("pulses", PULSES),
    ("turns", TURNS),
    ("stops", {"count": 24, "wrong": 0, "late": 0, "first": []}),
    ("starts", {"count": 24, "wrong": 0, "stuck": 0, "first": []}),
    *(
        (
            "limits",
            {
                "collecting": collecting,
                "inputs": 3,
                "shown": True,
                "missed": 0,
                "wrong": 0,
                "ticks": [100, 250, -1],
                "window": 16000,
            },
        )
        for collecting in (False, True)
    ),
    *(("pwm", {"power": p, "full": 10, "edges": e}) for p, e in ((0, [0]), (10, [1]))),
    ("pwm", {"power": 5, "full": 10, "edges": [0, 100, 200, 300, 400, 500]}),
    ("pwm after a limit", {"shown": True, "edges": [0]}),
    ("pwm after a kill", {"edges": [0]}),
    (
        "save",
        {"count": 5, "wrong": 0, "longest_us": 48000, "beat_us": 1000, "took_ms": 300},
    ),
    ("end", {}),
]
HANG = {
    "ms": 4800,
    "steps": 900,
    "last_step_ms": 260,
    "last_high_ms": 251,
    "pwm": True,
    "used_stack": 5000,
}


def fact_lines(facts: "Iterable[tuple[str, Any]]") -> "list[str]":
    """Return the lines by which the board reports these facts."""
    return [f"= {what} {json.dumps(figures)}" for what, figures in facts]


class FakeBoard:
    """A Board that prints facts. changes: other values for its attributes.

    facts: printed by the checks; hang: figures of the hang on purpose; exception: that which
    ends the checks; comes_back: the watchdog restarts it; started: how many times the firmware was
    started afterwards."""

    def __init__(self, **changes: Any) -> None:
        self.facts = list(GOOD)
        self.hang = dict(HANG)
        self.about_it, self.wired = PICO, WIRED
        self.exception = ""
        self.comes_back = True
        self.moving = False
        self.scripts: "list[str]" = []
        self.started = 0
        self.__dict__.update(changes)

    def enter(self) -> None:
        if self.moving:
            raise DeployError("the machine is in Run, and is not disturbed", "wait")

    def about(self) -> About:
        return self.about_it

    def wiring(self) -> "Wiring | None":
        return self.wired

    def run(self, script: str, on_line: "Callable[[str], None]", seconds: float) -> str:
        """Run the checks: report each line; return the exception's text."""
        self.scripts.append(script)
        for line in ("what the prompt says", *fact_lines(self.facts)):
            on_line(line)
        return self.exception

    def until_restart(self, script: str, on_line: "Callable[[str], None]", seconds: float) -> bool:
        """Hang on purpose; return whether the board answers again."""
        self.scripts.append(script)
        for line in fact_lines([("hang", self.hang)]):
            on_line(line)
        return self.comes_back

    def start(self) -> None:
        self.started += 1


def with_fact(what: str, **changes: Any) -> "list[tuple[str, Any]]":
    """Return all facts, with this one changed."""
    return [(name, {**fact, **changes} if name == what else fact) for name, fact in GOOD]


@pytest.fixture
def selftest(monkeypatch: pytest.MonkeyPatch) -> "Callable[..., Any]":
    """Return a function that runs the command at a scripted board."""

    def run(board: FakeBoard, *words: str) -> "tuple[int, dict[str, Any], str]":
        """Run the self-test; return exit code, checks by name, and the whole output."""
        monkeypatch.setattr(selftest_cli, "_open", lambda port: board)
        command = ["selftest", "--port", "there", "--json", "-", *words]
        done = CliRunner().invoke(app, command)
        rows = json.loads(done.stdout)["checks"]
        return done.exit_code, {row["what"]: row for row in rows}, done.stderr

    return run


def test_good_board_passes_every_check(selftest: "Callable[..., Any]") -> None:
    """The figures in the texts follow from GOOD, at 0.08 us a tick."""
    board = FakeBoard()
    code, rows, output = selftest(board, "--yes")
    assert {row["passed"] for row in rows.values()} == {True}, rows
    assert code == 0 and "0 failed" in output
    assert rows["pulse width, 50 kHz"]["text"] == "10 us; 10 asked; 27 pulses"
    assert rows["step period, 50 kHz"]["text"] == "20 us; 20 asked; 24 periods"
    # 30 and 70 ticks, see TURNS
    assert rows["direction hold"]["text"] == "shortest time 2.4 us in 6 reversals; 2 us required"
    assert rows["direction set-up"]["text"] == "shortest time 5.6 us in 6 reversals; 5 us required"
    assert rows[_LIMIT]["figures"]["worst_us"] == 20  # the longest is 250 ticks
    # 48 ms less the time between two beats, 1 ms
    assert rows["settings save: interrupts off"]["text"].startswith("47.0 ms")
    assert rows["spindle PWM, 50 %"]["text"] == "50.0 % at the pin"


def with_late_axis(ticks: int) -> "dict[str, Any]":
    """Return pulses whose second axis is late; the third does not move."""
    return {
        "steps": [pulse_edges(50_000, 125, 9), pulse_edges(50_000, 125, 9, 100 + ticks), STILL]
    }


# By name: the fact that differs, its figures, and the row that must fail.
FAULTS = {
    "a step too few": ("steps", {"counted": [19, 0, 0]}, "steps at 1 kHz, all axes"),
    "no rest": ("steps", {"rested": False}, "steps at 1 kHz, all axes"),
    "short pulses": (
        "pulses",
        {"steps": [pulse_edges(50_000, 122, 9)] * 3},
        "pulse width, 50 kHz",
    ),
    "long pulses": ("pulses", {"steps": [pulse_edges(50_000, 130, 9)] * 3}, "pulse width, 50 kHz"),
    "another rate": (
        "pulses",
        {"steps": [pulse_edges(49_000, 125, 9)] * 3},
        "step period, 50 kHz",
    ),
    "no pulses": ("pulses", {"steps": [STILL] * 3}, "pulse width, 50 kHz"),
    "an axis late": ("pulses", with_late_axis(5), "skew between axes, 50 kHz"),
    "an early turn": ("turns", {"dirs": [[0, 90, 400]] * 3}, "direction hold"),
    "a late turn": ("turns", {"dirs": [[0, 120, 400]] * 3}, "direction set-up"),
    "no turn": ("turns", {"dirs": [STILL] * 3}, "direction hold"),
    "a stop that lies": ("stops", {"wrong": 1, "first": [3]}, "stops at random instants"),
    "steps after a stop": ("stops", {"late": 1}, "stops at random instants"),
    "no stop at all": ("stops", {"count": 0}, "stops at random instants"),
    "no start at all": ("starts", {"count": 0}, "starts from rest"),
    "a lost start": ("starts", {"wrong": 1}, "starts from rest"),
    "a start without end": ("starts", {"stuck": 1}, "starts from rest"),
    "a deaf limit": ("limits", {"missed": 1}, _LIMIT),
    "a slow limit": ("limits", {"ticks": [9000]}, _LIMIT_IN_COLLECTION),
    "a limit that lies": ("limits", {"wrong": 2}, _LIMIT),
    "light at nothing": ("pwm", {"edges": [0, 1, 2]}, "spindle PWM, 0 %"),
    "half is a third": ("pwm", {"edges": [0, 3, 6, 12, 15, 21]}, "spindle PWM, 50 %"),
    "light after a limit": ("pwm after a limit", {"edges": [1]}, "spindle PWM after a limit"),
    "light after a kill": ("pwm after a kill", {"edges": [0, 5, 9]}, "spindle PWM after a kill"),
    "flash forgets": ("save", {"wrong": 1}, "settings save: interrupts off"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_fails_its_check_and_the_command(selftest: "Callable[..., Any]", fault: str) -> None:
    what, changes, row = FAULTS[fault]
    code, rows, output = selftest(FakeBoard(facts=with_fact(what, **changes)), "--yes")
    assert rows[row]["passed"] is False, rows[row]
    assert code == 1 and "FAILED" in output


@pytest.mark.parametrize(
    ("changes", "row"),
    [
        ({"last_step_ms": 4790}, "hang on purpose: steps"),
        ({"steps": 0}, "hang on purpose: steps"),
        ({"last_high_ms": 4790}, "hang on purpose: spindle"),
        ({"used_stack": 7000}, "C stack: deepest use"),
    ],
)
def test_harmful_hang_fails(
    selftest: "Callable[..., Any]", changes: "dict[str, Any]", row: str
) -> None:
    """Steps or the tool's power go on after the hang began (ms), no step was made, or the stack
    is nearly full."""
    code, rows, _ = selftest(FakeBoard(hang={**HANG, **changes}), "--yes")
    assert (code, rows[row]["passed"]) == (1, False)


def test_board_that_does_not_return_fails(selftest: "Callable[..., Any]") -> None:
    code, rows, _ = selftest(FakeBoard(comes_back=False), "--yes")
    assert (code, rows["hang on purpose: watchdog"]["passed"]) == (1, False)


@pytest.mark.parametrize(
    ("what", "changes", "row"),
    [
        ("watchers", {"seen": [0, 0]}, "watchers see the pins"),
        ("limits", {"shown": False}, _LIMIT),
        ("pwm after a limit", {"shown": False}, "spindle PWM after a limit"),
        ("save", {"longest_us": 1100}, "settings save: interrupts off"),
    ],
)
def test_check_that_cannot_be_shown_has_not_passed(
    selftest: "Callable[..., Any]", what: str, changes: "dict[str, Any]", row: str
) -> None:
    """For example a pin that the counters cannot see: neither passed nor failed."""
    code, rows, output = selftest(FakeBoard(facts=with_fact(what, **changes)), "--yes")
    assert rows[row]["passed"] is None and "not shown here" in rows[row]["text"]
    assert code == 0 and "not checked" in output


def test_failing_program_is_reported_with_its_last_line(
    selftest: "Callable[..., Any]",
) -> None:
    exception = "Traceback (most recent call last):\r\n  File …\r\nMemoryError: no room\r\n"
    # it ends after three facts
    code, rows, _ = selftest(FakeBoard(facts=GOOD[:3], exception=exception), "--yes")
    assert code == 1
    assert rows["all checks were made"]["text"] == "MemoryError: no room"


def test_spindle_is_unused_without_permission(selftest: "Callable[..., Any]") -> None:
    """--yes: the spindle output may be used."""
    board = FakeBoard()
    selftest(board)
    assert all("'pwm': False" in script for script in board.scripts)
    assert not any("M3" in script for script in board.scripts)
    board = FakeBoard()
    selftest(board, "--yes")
    assert all("'pwm': True" in script for script in board.scripts)


# By reason: attributes of the board, and words of the report.
REFUSED = {
    "another chip": (
        {"about_it": PICO._replace(machine="nRF52840")},
        "is no RP2040, RP2350, ESP32",
    ),
    "an ESP32-C3": ({"about_it": PICO._replace(machine="Module with ESP32-C3")}, "is no RP2040"),
    "an ESP32-S2": ({"about_it": PICO._replace(machine="Module with ESP32S2")}, "is no RP2040"),
    "shift registers": (
        {"about_it": ESP32, "wired": WIRED_ESP._replace(engine="i2s")},
        "steps in external shift registers, where the chip cannot",
    ),
    "seven motors": (
        {"wired": WIRED._replace(motors=7)},
        "7 motors (a laser's beam counts as one) leave",
    ),
    "an engine of elsewhere": ({"about_it": ESP32, "wired": WIRED}, "count steps of ENGINE 'pio'"),
    "no PCNT": (
        {"about_it": ESP32, "wired": WIRED_ESP._replace(has_pcnt=False)},
        "has no esp32.PCNT",
    ),
    "an ESP32's is old": (
        {"about_it": ESP32._replace(version="1.25.0"), "wired": WIRED_ESP},
        "1.25.0 is older than 1.26: it has no esp32.PCNT",
    ),
    "old": ({"about_it": PICO._replace(version="1.25.0")}, "1.25.0 is older than 1.26"),
    "no firmware": ({"wired": None}, "the firmware is not on the board; ugrbl deploy"),
    "drivers on": ({"wired": WIRED._replace(enable=None)}, "names no ENABLE"),
}


@pytest.mark.parametrize("why", REFUSED)
def test_board_that_cannot_be_tested_is_reported_and_unchanged(
    selftest: "Callable[..., Any]", why: str
) -> None:
    changes, words = REFUSED[why]
    board = FakeBoard(**changes)
    code, rows, _ = selftest(board)
    assert code == 1 and words in rows["the board"]["text"]
    # nothing was run; the firmware was started again
    assert board.scripts == [] and board.started == 1


def test_moving_machine_is_not_disturbed(selftest: "Callable[..., Any]") -> None:
    board = FakeBoard(moving=True)
    code, rows, _ = selftest(board)
    assert code == 1 and "is in Run" in rows["the board"]["text"]
    assert board.scripts == [] and board.started == 0  # nothing was run or stopped


def test_ctrl_c_reports_how_to_restart_the_board(selftest: "Callable[..., Any]") -> None:
    class Stopped(FakeBoard):
        def run(self, script: str, on_line: "Callable[[str], None]", seconds: float) -> str:
            raise KeyboardInterrupt

    code, rows, _ = selftest(Stopped(), "--yes")
    assert code == 1 and "unplug the board" in rows["the board"]["text"]


def test_broken_connection_is_reported_and_the_firmware_started(
    selftest: "Callable[..., Any]",
) -> None:
    class Broken(FakeBoard):
        def run(self, script: str, on_line: "Callable[[str], None]", seconds: float) -> str:
            raise DeployError("the connection broke", "plug it in")

    board = Broken()
    code, rows, _ = selftest(board, "--yes")
    assert (code, board.started) == (1, 1)
    assert rows["the board"]["text"] == "the connection broke; plug it in"


def test_wrong_port_is_reported_in_words(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The port does not exist, and then none is chosen, because there are several."""
    done = CliRunner().invoke(app, ["selftest", "--port", str(tmp_path / "nothing")])
    assert done.exit_code == 1 and "cannot open" in done.output

    def nowhere(port: object) -> str:
        raise SendError("there are several")

    monkeypatch.setattr(ports, "choose", nowhere)
    done = CliRunner().invoke(app, ["selftest"])
    assert done.exit_code == 1 and "there are several" in done.output


# Edges


def test_edges_are_read_from_either_level() -> None:
    assert (rises([0, 3, 5, 9]), falls([0, 3, 5, 9]), highs([0, 3, 5, 9])) == ([3, 9], [5], [2])
    assert (rises([1, 3, 5, 9]), falls([1, 3, 5, 9]), highs([1, 3, 5, 9])) == ([5], [3, 9], [4])
    # Between the first and the last rise: 40 to 80 ticks, of which 10 are high.
    assert duty_percent([1, 10, 40, 50, 80, 90]) == 25


def test_facts_without_figures_do_not_pass() -> None:
    rows = list(judge([{"what": "pulses", "hz": 1000, "us": 10, "steps": [STILL], "dirs": []}]))
    assert [row.passed for row in rows] == [False]
