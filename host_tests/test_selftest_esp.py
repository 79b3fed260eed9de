"""`ugrbl selftest` of an ESP32: what is sent runs on its stand-ins, and finds what is wrong."""

import json
import sys
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from esp_bench import clock, esp32, esp_machine, gpio_esp, reset_stand_ins, rmt
from ugrbl import machine
from ugrbl.selftest import program
from ugrbl.selftest.judge import judge
from ugrbl.selftest.row import Row
from ugrbl.selftest.session import Hearer

_CHIPS = {
    "esp32_devkit": ("esp32", program.ESP32),
    "esp32_s3": ("esp32s3", program.ESP32_S3),
}
_AMOUNTS = replace(program.ESP_QUICK, run_ms=100, stops=12, starts=8)
_ASKING_US = 6  # what a turn of a loop takes that asks for the time


def _pass(us: int) -> None:
    """Time, with callbacks in it where they can come."""
    if clock._inside:
        clock.work(us)
    else:
        clock.advance(clock.us + us)


def _ticks_us() -> int:
    _pass(_ASKING_US)
    return clock.us & 0x3FFFFFFF


def _ticks_ms() -> int:
    _pass(_ASKING_US)
    return clock.us // 1000 & 0x3FFFFFFF


_TIME = SimpleNamespace(
    ticks_us=_ticks_us,
    ticks_ms=_ticks_ms,
    ticks_diff=clock.ticks_diff,
    sleep_us=_pass,
    sleep_ms=lambda ms: _pass(1000 * ms),
)


class Bench:
    """Runs what is sent to a board of that name."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
        self._file = folder / "sent.py"
        chip, self.chip = _CHIPS[name]
        reset_stand_ins(chip)
        self.board: Any = machine.load_board(name)
        monkeypatch.setattr(self.board, "ENABLE", self.board.ENABLE)  # the program changes them
        for changed in ("ESTOP", "CONTROL_INVERT", "LIMIT_DEBOUNCE_MS", "DEFAULTS"):
            monkeypatch.setattr(self.board, changed, None, raising=False)
            monkeypatch.delattr(self.board, changed)
        for module, stand_in in {
            "machine": esp_machine,
            "esp32": esp32,
            "time": _TIME,
            "board": self.board,
            "gpio_esp": gpio_esp,
        }.items():
            monkeypatch.setitem(sys.modules, module, stand_in)
        self.rows: dict[str, Row] = {}
        self.ended = False

    def run(self, pwm: bool = True, seed: int = 7) -> "dict[str, Row]":
        """All checks but the hang."""
        said: list[str] = []
        self._file.write_text(program.checks(self.chip, _AMOUNTS, pwm, seed))
        names: dict[str, Any] = {"print": lambda text: said.append(text)}
        exec(compile(self._file.read_text(), str(self._file), "exec"), names)
        hearer = Hearer(lambda row: self.rows.update({row.what: row}))
        for line in said:
            hearer.line(line)
        hearer.close()
        self.ended = hearer.ended
        return self.rows


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> "Callable[[str], Bench]":
    return lambda name="esp32_devkit": Bench(tmp_path, monkeypatch, name)


def failed(rows: "Iterable[Row]") -> "list[str]":
    return [row.what for row in rows if row.passed is False]


@pytest.mark.parametrize("name", list(_CHIPS))
def test_a_good_board_passes_what_can_be_shown(bench: "Callable[[str], Bench]", name: str) -> None:
    board = bench(name)
    rows = board.run()
    for row in rows.values():
        print(row.passed, row.what, row.text)
    assert board.ended and failed(rows.values()) == []
    assert 0
