"""Test `ugrbl selftest` of an ESP32: the program runs on stand-ins, and finds faults.

The stand-ins (support/esp_bench.py) replace MicroPython's modules and the chip: `clock` is the
time in us, `rmt` the firmware's pulse engine, esp32.PCNT the pulse counters. Rows are the checks'
results: passed is True, False, or None if a check could not be made."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterable
from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from esp_bench import clock, esp32, esp_machine, gpio_esp, reset_stand_ins, rmt
from micropython_runner import needs_micropython, run_micropython
from ugrbl.boardfile.files import load_board
from ugrbl.device.selftest import program
from ugrbl.device.selftest.row import Row
from ugrbl.device.selftest.session import WIRING, Hearer

# A whole board in a model: the first ring runs one check.
pytestmark = pytest.mark.thorough

_CHIPS = {
    "esp32_devkit": ("esp32", program.ESP32),
    "esp32_s3": ("esp32s3", program.ESP32_S3),
}
_AMOUNTS = replace(program.ESP_QUICK, run_ms=100, stops=12, starts=8)
_BOOT = Path(__file__).parents[1] / "support" / "esp_boot.py"
_ASKING_US = 6  # one turn of a loop that reads the time


def _let_pass_us(us: int) -> None:
    """Let time pass, with callbacks where they can run."""
    if clock._in_callback:
        clock.work(us)
    else:
        clock.advance(clock.us + us)


def _ticks_us() -> int:
    _let_pass_us(_ASKING_US)
    return clock.us & 0x3FFFFFFF


def _ticks_ms() -> int:
    _let_pass_us(_ASKING_US)
    return clock.us // 1000 & 0x3FFFFFFF


_TIME = SimpleNamespace(
    ticks_us=_ticks_us,
    ticks_ms=_ticks_ms,
    ticks_diff=clock.ticks_diff,
    sleep_us=_let_pass_us,
    sleep_ms=lambda ms: _let_pass_us(1000 * ms),
)


def rows_of(output_lines: "Iterable[str]") -> "tuple[dict[str, Row], bool]":
    """Return the rows in these lines by name, and whether the end was received."""
    rows: dict[str, Row] = {}
    hearer = Hearer(lambda row: rows.update({row.what: row}))
    for line in output_lines:
        hearer.line(line)
    hearer.close()
    return rows, hearer.ended


class Bench:
    """Runs the self-test's program on a board of that name."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        """Replace the modules that the program imports; options that it would have to work
        around are removed from the board."""
        self._file = folder / "sent.py"
        chip, self.chip = _CHIPS[name]
        reset_stand_ins(chip)
        self.board: Any = load_board(name)
        monkeypatch.setattr(self.board, "ENABLE", self.board.ENABLE)  # the program changes it
        for changed in ("ESTOP", "CONTROL_INVERT", "LIMIT_DEBOUNCE_MS", "DEFAULTS"):
            monkeypatch.setattr(self.board, changed, None, raising=False)
            monkeypatch.delattr(self.board, changed)
        for module, stand_in in {
            "machine": esp_machine,
            "esp32": esp32,
            "time": _TIME,
            "board": self.board,
            "esp_chip.pins": gpio_esp,
        }.items():
            monkeypatch.setitem(sys.modules, module, stand_in)
        monkeypatch.delitem(sys.modules, "boot.parts_esp", raising=False)  # imports one of these
        self.rows: dict[str, Row] = {}
        self.ended = False

    def run(self, pwm: bool = True, seed: int = 7) -> "dict[str, Row]":
        """Run all checks except the hang; return their rows by name. pwm: the spindle output
        may be used; seed: of the random instants."""
        self._file.write_text(program.checks(self.chip, _AMOUNTS, pwm, seed))
        with redirect_stdout(StringIO()) as output:
            exec(compile(self._file.read_text(), str(self._file), "exec"), {})
        self.rows, self.ended = rows_of(output.getvalue().splitlines())
        return self.rows


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> "Callable[[str], Bench]":
    """Return a function that makes a bench for a board."""
    return lambda name="esp32_devkit": Bench(tmp_path, monkeypatch, name)


def failed(rows: "Iterable[Row]") -> "list[str]":
    """Return the names of the rows that have failed."""
    return [row.what for row in rows if row.passed is False]


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", list(_CHIPS))
def test_good_board_passes_every_check_that_can_be_shown(
    bench: "Callable[[str], Bench]", name: str
) -> None:
    """A limit during a garbage collection cannot be shown on the stand-ins."""
    board = bench(name)
    rows = board.run()
    assert board.ended and failed(rows.values()) == []
    assert [row.what for row in rows.values() if row.passed is None] == [
        "limit, during a collection: time to the last step edge"
    ]
    highest = rows["steps at the highest, all axes"]
    assert highest.text == "1000 on each of 3 axes, there and back, all counted"
    assert rows["stops at random instants"].figures["moved"] == _AMOUNTS.stops
    assert abs(rows["spindle PWM, 50 %"].figures["edges"] - 500) <= 1  # in 100 ms at 5 kHz


def test_board_is_asked_for_its_counters(monkeypatch: pytest.MonkeyPatch) -> None:
    """WIRING is the script that asks; MicroPython may have no esp32.PCNT, or no module esp32."""
    monkeypatch.setitem(
        sys.modules, "board", SimpleNamespace(ENGINE="rmt", ENABLE=12, STEP=(1, 2, 3))
    )
    for module, has_pcnt in ((esp32, True), (SimpleNamespace(), False), (None, False)):
        monkeypatch.setitem(sys.modules, "esp32", module)
        names: dict[str, Any] = {}
        exec(WIRING, names)
        # engine, ENABLE, spindle pin, PCNT, motors
        assert names["wiring"]() == ["rmt", 12, None, has_pcnt, 3]


def test_highest_rate_is_that_of_the_board_file(
    bench: "Callable[[str], Bench]", monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 2 kHz the rates above are left out; pwm=False: the spindle is not checked."""
    board = bench()
    monkeypatch.setattr(board.board, "MAX_STEP_RATE_HZ", 2000)
    rows = board.run(pwm=False)
    assert [what for what in rows if what.startswith("steps")] == [
        "steps at 0.2 kHz, all axes",
        "steps at 1 kHz, all axes",
        "steps at the highest, all axes",
    ]
    assert rows["spindle PWM"].passed is None


@pytest.mark.thorough
@needs_micropython
def test_all_checks_pass_under_micropython(tmp_path: Path) -> None:
    program_file = tmp_path / "sent.py"
    amounts = replace(_AMOUNTS, run_ms=20, stops=4, starts=4)
    program_file.write_text(program.checks(program.ESP32, amounts, pwm=True, seed=7))
    # The boot script sends nothing and waits for the welcome, then runs the program.
    (tmp_path / "talk.json").write_text(json.dumps([["", "Grbl"]]))
    output = run_micropython(_BOOT, "esp32_devkit", str(tmp_path), f"RUN = {str(program_file)!r}")
    rows, ended = rows_of(output.splitlines())
    assert ended and failed(rows.values()) == []
    assert rows["steps at the highest, all axes"].passed


# Faults are found


def lose_pulses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drop the last step of every ninth train."""
    write_all = esp32.RMT.write_pulses
    count = [0]

    def write_pulses(self: Any, duration: "list[int]", data: object = True) -> None:
        count[0] += 1
        write_all(
            self, duration[:-2] if count[0] % 9 == 0 and len(duration) > 2 else duration, data
        )

    monkeypatch.setattr(esp32.RMT, "write_pulses", write_pulses)


def count_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lose one step in 150 at the counter."""
    monkeypatch.setattr(esp32.PCNT, "lose", 150)


def stop_late(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the pins connected to the trains after a stop."""
    monkeypatch.setattr(rmt.RmtEngine, "_cut_off", lambda self, axes: None)


def stop_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget the steps of an unfinished train."""

    def forget(lanes: Any, axis: int, playing: Any, now: int) -> int:
        return int(lanes[rmt._LANE * axis + rmt._PLACE])  # where the train began

    monkeypatch.setattr(rmt, "_place", forget)


def never_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Never report the engine as idle."""
    monkeypatch.setattr(rmt.RmtEngine, "idle", lambda self: False)


def hear_no_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Never call the limit's callback."""
    monkeypatch.setattr(gpio_esp.EspPort, "enable_limits", lambda self, on: None)


def burn_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the output work again after a kill."""
    monkeypatch.setattr(gpio_esp.EspPort, "kill", lambda self: None)


def burn_half(monkeypatch: pytest.MonkeyPatch) -> None:
    """Output half the power."""
    full_duty = esp_machine.PWM.duty_u16
    monkeypatch.setattr(esp_machine.PWM, "duty_u16", lambda self, duty: full_duty(self, duty // 2))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("fault", "rows"),
    [
        (lose_pulses, ["steps at the highest, all axes", "starts from rest"]),
        (count_wrong, ["steps at the highest, all axes"]),
        (stop_late, ["stops at random instants", "limit: time to the last step edge"]),
        (stop_wrong, ["stops at random instants"]),
        (never_rest, ["steps at the highest, all axes", "starts from rest"]),
        (hear_no_limit, ["limit: time to the last step edge"]),
        (burn_on, ["spindle PWM after a kill"]),
        (burn_half, ["spindle PWM, 50 %", "spindle PWM, 100 %"]),
    ],
)
def test_fault_is_found(
    bench: "Callable[[str], Bench]",
    monkeypatch: pytest.MonkeyPatch,
    fault: "Callable[[pytest.MonkeyPatch], None]",
    rows: "list[str]",
) -> None:
    """fault: a function that breaks the firmware or a stand-in; rows: the checks that must
    fail."""
    board = bench("esp32_devkit")
    fault(monkeypatch)
    failed_rows = failed(board.run().values())
    assert set(rows) <= set(failed_rows), failed_rows


def test_nothing_passes_when_counters_cannot_see_the_pins(
    bench: "Callable[[str], Bench]", monkeypatch: pytest.MonkeyPatch
) -> None:
    """mem32 ignores writes: a STEP pin, which its counter has made an input, cannot be made an
    output again."""
    board = bench("esp32_devkit")
    monkeypatch.setattr(esp_machine.Pads, "__setitem__", lambda self, address, word: None)
    rows = board.run()
    assert list(rows) == ["board", "watchers see the pins"]
    row = rows["watchers see the pins"]
    assert row.passed is None and row.text.startswith("not shown here: PCNT counted [0, 0]")


def test_limit_input_kept_high_by_something_else_is_reported_as_not_shown(
    bench: "Callable[[str], Bench]",
) -> None:
    board = bench("esp32_devkit")
    for pin in board.board.LIMIT:
        esp_machine.Pin(pin, esp_machine.Pin.IN).drive(1)
    row = board.run()["limit: time to the last step edge"]
    assert row.passed is None and "disconnect that, and test again" in row.text


def test_limits_without_pull_ups_are_left_out(
    bench: "Callable[[str], Bench]", monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such an input floats, if no switch is wired."""
    board = bench("esp32_devkit")
    monkeypatch.setattr(board.board, "NO_PULL_UP", (35, 39, *board.board.LIMIT))
    row = board.run()["limit: time to the last step edge"]
    assert row.passed is None and row.text.startswith("left out")


def test_same_seed_gives_the_same_stops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The seed makes a failing run repeatable."""

    def stops(seed: int) -> "list[int]":
        """Return the times of all stops, in us from the start."""
        stopped_us: list[int] = []
        stop_engine = rmt.RmtEngine.stop

        def stop(self: Any) -> None:
            stop_engine(self)
            stopped_us.append(clock.us)

        with monkeypatch.context() as patched:
            board = Bench(tmp_path, patched, "esp32_devkit")
            begun = clock.us
            patched.setattr(rmt.RmtEngine, "stop", stop)
            board.run(pwm=False, seed=seed)
        return [us - begun for us in stopped_us]

    assert stops(7) == stops(7) != stops(8)


# The counters' stand-in has the limits of MicroPython and of the chip


@pytest.fixture
def pins() -> "tuple[Any, Any]":
    """Return a STEP and a DIR pin."""
    reset_stand_ins()
    step_and_dir = [esp_machine.Pin(number, esp_machine.Pin.OUT, value=0) for number in (26, 16)]
    return step_and_dir[0], step_and_dir[1]


@pytest.mark.parametrize(
    "arguments",
    [
        {"mode_pin": True},
        {"pin": True, "rising": 1, "min": 1},
        {"pin": True, "rising": 1, "max": 40_000},
        {"pin": True, "rising": 1, "max": -1},
        {"pin": True, "rising": 1, "min": -32_769},
        {"pin": True, "rising": 1, "value": 5},
        {"pin": True, "rising": 1, "mode_high": 3},
    ],
)
def test_counter_refuses_what_micropython_refuses(
    pins: "tuple[Any, Any]", arguments: "dict[str, Any]"
) -> None:
    """An ESP32 has 8 counters, an ESP32-S3 has 4; each counts from -32768 to 32767. True stands
    for a pin."""
    named = {key: pins[0] if value is True else value for key, value in arguments.items()}
    with pytest.raises(ValueError):
        esp32.PCNT(0, **named)
    with pytest.raises(ValueError):
        esp32.PCNT(8)
    reset_stand_ins("esp32s3")
    with pytest.raises(ValueError):
        esp32.PCNT(4)


def test_counter_turns_its_pin_into_an_input_and_counts_after_start(
    pins: "tuple[Any, Any]",
) -> None:
    """mode_high=1: while the DIR pin is high, it counts down."""
    step, direction = pins
    unit = esp32.PCNT(0, pin=step, mode_pin=direction, rising=1, mode_high=1, min=-9, max=9)
    base = esp_machine.mem32.first & ~0xFFF  # of the GPIO registers

    def make_pulses(count: int) -> None:
        for level in (1, 0) * count:
            clock.work(5)
            step.value(level)
        clock.work(5)

    unit.start()
    make_pulses(3)
    assert unit.value() == 0  # the pin is an input
    # GPIO_ENABLE_W1TS: both pins, 16 and 26, are outputs again
    esp_machine.mem32[base + 0x24] = 1 << 26 | 1 << 16
    make_pulses(3)
    assert unit.value() == 3
    direction.value(1)
    make_pulses(5)
    assert unit.value(0) == -2 and unit.value() == 0  # 3 - 5; value(0) sets it to 0
    unit.stop()
    make_pulses(2)
    assert unit.value() == 0
    unit.start()
    make_pulses(8)
    with pytest.raises(OverflowError):
        make_pulses(1)
        unit.value()


# The hang


def run_python(*arguments: object) -> str:
    """Run a program under CPython; return its output."""
    command = [sys.executable, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.thorough
@pytest.mark.parametrize(
    "run", [run_python, pytest.param(run_micropython, marks=needs_micropython)]
)
def test_hang_is_ended_by_the_watchdog_long_after_the_last_step(
    run: "Callable[..., str]", tmp_path: Path
) -> None:
    """The program blocks the main loop on purpose; figures are ms after that."""
    program_file = tmp_path / "sent.py"
    program_file.write_text(program.hang(program.ESP32, pwm=True))
    # The boot script sends nothing and waits for the welcome, then runs the program.
    (tmp_path / "talk.json").write_text(json.dumps([["", "Grbl"]]))
    output = run(_BOOT, "esp32_devkit", str(tmp_path), f"RUN = {str(program_file)!r}")
    rows, _ = rows_of(output.splitlines())
    assert list(rows) == ["hang on purpose: steps", "hang on purpose: spindle"]
    assert failed(rows.values()) == []
    assert "the watchdog starts the chip anew" in output
    figures = rows["hang on purpose: steps"].figures
    assert figures["ms"] > 4000 and figures["steps"] > 0 and 0 < figures["last_step_ms"] < 500
