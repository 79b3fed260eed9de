"""Whatever a handler of custom.py does wrong, and whenever: no step is lost, all ends in words.

A session with handlers of all kinds is played; at one call of m that some handler makes, chosen by
number, something happens: an exception, a reset, a feed hold, no memory. UGRBL_TORTURE names how
many sessions there are to be.
"""

import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from types import ModuleType
from typing import Any

import pytest
from base import state as st
from extras.machine_operator import Operator
from ugrbl.boardfile.files import load_board
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import MemoryStore, Rig
from ugrbl.sim.sender import Sender, TooLong

_SESSIONS = int(os.environ.get("UGRBL_TORTURE", "24"))
_PARTS = 8
_STEPS_PER_MM = 250
_CUSTOM = """
from ugrbl import mcode, on, every

@mcode(100, "p")
def moves(m, P=1):
    with m.saved():
        m.out("vacuum", 1)
        m.g("G91 G1 X%g F3000" % P)
        m.message("half way")
        m.g("G0 X-1 Y1")
        m.keep["count"] = m.keep.get("count", 0) + 1
    m.wait(0.02)
    m.out("vacuum", 0)

@mcode(101, sync=False)
def passes(m):
    m.out("air", m.position().x > 1)

@on.tool_change
def change(m, tool):
    m.g("G91 G0 Z0.5")
    m.wait_motion()
    m.g("G0 Z-0.5 \\n G90")

@on.spindle
def spindle(m, word, rpm):
    m.wait(0.01)

@on.state_change
def state(m, old, new):
    m.message(new)

@every(15)
def tick(m):
    m.position()
    m.out("air", 0)
"""
_LINES = (
    *("G91", "G1X1F3000", "M100", "M3S300", "G1Y1", "M101", "G1X0.5", "T2M6", "M100P0.5"),
    *("G90", "G1X0Y0", "M5", "G91G0Z0.3", "M101", "G4P0.05"),
)


class Injected(Exception):
    """What a handler may do wrong."""


def _raises(_machine: Any) -> None:
    raise Injected("at that call")


def _has_no_memory(_machine: Any) -> None:
    raise MemoryError("memory allocation failed")


def _is_reset(machine: Any) -> None:
    machine.drive.reset()


def _is_held(machine: Any) -> None:
    machine.state.post(st.FEED_HOLD)


_KINDS: "tuple[Callable[[Any], None], ...]" = (_raises, _has_no_memory, _is_reset, _is_held)


class Session:
    """One of them: the call of that number is the one. call 0: none is, and all are counted."""

    def __init__(self, board: ModuleType, store: MemoryStore, call: int, kind: int) -> None:
        self.rig = Rig(board, store)
        self.sender = Sender(self.rig)
        self.sender.allow(60_000)
        self.calls = 0
        self.is_injected = False
        self._call = call
        self._inject = _KINDS[kind]
        self.said: list[str] = []

    def play(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """From power-up to a last move behind all, with all laws looked at."""
        usual = Operator.look

        def look(operator: Operator) -> None:
            if not sys._getframe(1).f_code.co_filename.endswith("runner.py"):  # a handler's own
                self.calls += 1
                if self.calls == self._call:
                    self.is_injected = True
                    self._inject(self.rig.controller)
            usual(operator)

        with monkeypatch.context() as patched:
            patched.setattr(Operator, "look", look)
            self.rig.run(self._script())

    def _script(self) -> "Iterator[Any]":
        wait = self.sender.wait
        yield from wait("banner", "")
        for line in _LINES:
            yield from self._line(line)
            if self._is_over():
                break
        if self._is_over():
            yield from wait("ms 1500", "")
        self._call = 0
        yield from wait("ms 600", "\x18")
        self.said += self.sender.take()
        port = self.rig.port
        assert (port.own_outputs, port.spindle_pwm) == (0, 0), "something is on behind a reset"
        yield from wait("ms 100", "$X\n")
        before = self._steps()
        yield from wait("idle", "G91G1X2Y-1F3000\n")
        moved = [b - a for a, b in zip(before, self._steps(), strict=True)]
        assert moved == [500, -250, 0], f"the next move is {moved}"
        self.sender.take()
        yield from wait("ms 20", "?")
        (report,) = [line for line in self.sender.take() if line.startswith("<")]
        told = [float(mm) for mm in report.partition("MPos:")[2].split("|")[0].split(",")]
        made = [step / _STEPS_PER_MM for step in self._steps()]
        assert told == pytest.approx(made, abs=0.0011), "the machine is elsewhere than it says"

    def _line(self, line: str) -> "Iterator[Any]":
        try:
            yield from self.sender.wait("ms 400", line + "\n")
            if self.rig.controller.state.run == st.HOLD:
                yield from self.sender.wait("ms 400", "~")
        except TooLong:
            raise AssertionError(f"{line} has no end: {self.said}") from None
        self.said += self.sender.take()

    def _is_over(self) -> bool:
        return any(text.startswith(("ALARM", "Grbl")) for text in self.said[3:])

    def _steps(self) -> "list[int]":
        self.rig.engine.position(self.rig.scratch)
        return list(self.rig.scratch)


@pytest.fixture
def board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    (tmp_path / "custom_injected.py").write_text(_CUSTOM)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    made = ModuleType("board")
    pins = {"OUTPUTS": {"vacuum": 20, "air": 21}}
    vars(made).update(vars(load_board("sim")), CUSTOM="custom_injected", **pins)
    return made


def _store() -> MemoryStore:
    store = factory_store(load_board("sim"))
    made = MemoryStore()
    made.files.update(store.files)
    rates = {110: 3000, 111: 3000, 112: 3000, 120: 500, 121: 500, 122: 500}
    kept = [line for line in made.files["settings"] if int(line[1:].split("=")[0]) not in rates]
    made.files["settings"] = kept + [f"${number}={value}" for number, value in rates.items()]
    return made


@pytest.mark.parametrize("part", range(_PARTS))
def test_no_step_is_lost_and_all_ends_in_words(
    board: ModuleType, monkeypatch: pytest.MonkeyPatch, part: int
) -> None:
    whole = Session(board, _store(), 0, 0)
    whole.play(monkeypatch)
    calls = whole.calls
    assert calls > 100 and not any("ALARM" in line for line in whole.said)
    for number in range(part, _SESSIONS, _PARTS):
        random = Random(number)
        kind = number % len(_KINDS)
        session = Session(board, _store(), random.randint(1, calls), kind)
        session.play(monkeypatch)
        if kind < 2 and session.is_injected:
            told = [line for line in session.said if "custom_injected.py, line " in line]
            assert told, f"session {number}: no file and line in {session.said}"
            assert not [line for line in session.said if line.startswith("error:")]
