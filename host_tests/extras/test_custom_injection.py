"""Test faults of handlers in custom.py at any time: no step is lost, all are reported.

A session with handlers of all kinds is played. At one call of m by a handler, chosen by number, a
fault is injected: an exception, no memory, a reset, a reset that the handler swallows, a feed
hold, an endless loop, a time without any call, or a truncated file as in an interrupted push. Or
power fails while values are written to flash, at any byte. UGRBL_TORTURE is the number of
sessions.
"""

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from random import Random
from types import ModuleType
from typing import Any

import pytest
from base import state as st
from extras.custom.machine_api import MachineApi
from test_flash_store import Flash, attach, cut
from ugrbl.boardfile.files import load_board
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import PowerOff, Rig
from ugrbl.sim.sender import Sender, TooLong

_SESSIONS = int(os.environ.get("UGRBL_TORTURE", "27"))
_PARTS = 8  # in which pytest runs them
_STEPS_PER_MM = 250  # of the board sim
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

@mcode(102)
def tells(m):
    m.message("kept %d" % m.keep.get("count", 0))

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


_CHECK_STOPPED = MachineApi.check_stopped  # each call of m begins or ends with this


class Injected(Exception):
    """An exception of a handler."""


def _raises(_session: "Session", _operator: MachineApi) -> None:
    raise Injected("at that call")


def _has_no_memory(_session: "Session", _operator: MachineApi) -> None:
    raise MemoryError("memory allocation failed")


def _is_reset(session: "Session", operator: MachineApi) -> None:
    session.rig.controller.motor_control.reset()
    _CHECK_STOPPED(operator)


def _swallows_the_reset(session: "Session", operator: MachineApi) -> None:
    with suppress(Exception):
        _is_reset(session, operator)


def _is_held(session: "Session", operator: MachineApi) -> None:
    session.rig.controller.state.post(st.FEED_HOLD)
    _CHECK_STOPPED(operator)


def _loops(_session: "Session", operator: MachineApi) -> None:
    while True:
        operator.wait(0.01)


def _is_slow(session: "Session", operator: MachineApi) -> None:
    session.rig.pass_time(session.rig.ms(60))
    _CHECK_STOPPED(operator)


def _is_cut_short(session: "Session", operator: MachineApi) -> None:
    session.file.write_text(_CUSTOM[: session.random.randrange(len(_CUSTOM))])
    _CHECK_STOPPED(operator)


# None: power fails.
_KINDS: "tuple[Callable[[Session, MachineApi], None] | None, ...]" = (
    *(_raises, _has_no_memory, _is_reset, _swallows_the_reset, _is_held, _loops, _is_slow),
    *(_is_cut_short, None),
)
_FAILS = (_raises, _has_no_memory)


class FaultyStore:
    """A Store on a flash chip. Power fails in the save of persistent values number `fault_at`.

    saves: number of saves of persistent values so far. They have one value, "count".
    """

    def __init__(
        self, rig: Rig, monkeypatch: pytest.MonkeyPatch, fault_at: int, random: Random
    ) -> None:
        """Start with the chip of _initial_flash(). fault_at 0: power never fails."""
        self.saves = 0
        self.possible_counts = {0}  # M102 may report: after a power failure, the old or the new
        self.has_failed = False  # power
        self._rig = rig
        self._monkeypatch = monkeypatch
        self._fault_at = fault_at
        self._random = random
        self._use_chip(_initial_flash())

    def _use_chip(self, image: bytes) -> None:
        """Replace the chip by one with these bytes, and read its files."""
        self._flash = Flash(image)
        self._store = attach(self._monkeypatch, self._flash)
        self.damaged = self._store.damaged

    def load(self, name: str) -> "list[str] | None":
        return self._store.load(name)

    def save(self, name: str, lines: "Iterable[str]") -> None:
        """Save a file. At save `fault_at` of "keep", power fails after a random byte: PowerOff."""
        kept = list(lines)
        before = bytes(self._flash.buffer)
        self._flash.log.clear()
        self._store.save(name, kept)
        if name != "keep":
            return
        counts = {value for _, value in map(json.loads, kept)}  # a set with the one value
        self.saves += 1
        if self.saves != self._fault_at:
            self.possible_counts = counts
            return
        self.possible_counts |= counts
        log = self._flash.log  # operations of this save: (address, bytes)
        complete = self._random.randrange(len(log))
        bytes_of_next = self._random.randrange(len(log[complete][1]) + 1)
        self._use_chip(cut(before, log, complete, bytes_of_next))
        self.has_failed = True
        self._rig.cycle_power()
        raise PowerOff


@lru_cache
def _initial_flash() -> bytes:
    """Return a chip with the simulator's settings and higher rates and accelerations."""
    kept = {name: list(lines) for name, lines in factory_store(load_board("sim")).files.items()}
    rates = {110: 3000, 111: 3000, 112: 3000, 120: 500, 121: 500, 122: 500}
    others = [line for line in kept["settings"] if int(line[1:].split("=")[0]) not in rates]
    kept["settings"] = others + [f"${number}={value}" for number, value in rates.items()]
    flash = Flash()
    with pytest.MonkeyPatch.context() as patched:
        store = attach(patched, flash, fresh=True)
        for name, lines in kept.items():
            store.save(name, lines)
    return bytes(flash.buffer)


class Session:
    """A session with a fault at the call, or the save, number `fault_at`.

    fault_at 0: no fault; calls and saves are counted.
    """

    def __init__(
        self,
        board: ModuleType,
        monkeypatch: pytest.MonkeyPatch,
        file: Path,
        seed: int,
        fault_at: int,
    ) -> None:
        """Power up with _CUSTOM in this file. seed: chooses the kind of fault and its details."""
        self.random = Random(seed)
        self.inject = _KINDS[seed % len(_KINDS)]
        self.file = file
        file.write_text(_CUSTOM)
        self.rig = Rig(board)
        self.rig.store = self.store_with_fault = FaultyStore(
            self.rig, monkeypatch, 0 if self.inject else fault_at, self.random
        )
        self.sender = Sender(self.rig)
        self.sender.allow(60_000)  # ms for all waits
        self.calls = 0  # of methods of m by handlers
        self.is_injected = False
        self._all_sent = False  # all lines are played: nothing is injected any more
        self._call = fault_at if self.inject else 0  # number of the call with the fault; 0: none
        self.output: list[str] = []  # lines received

    def play(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Run _script() with check_and_inject() in place of MachineApi.check_stopped()."""

        def check_and_inject(operator: MachineApi) -> None:
            """Count this call, and inject the fault if it is the chosen one."""
            # Calls by handlers count, not the one that runner.py makes after each handler.
            is_by_runner = sys._getframe(1).f_code.co_filename.endswith("runner.py")
            if not self._all_sent and not is_by_runner:
                self.calls += 1
                if self.calls == self._call and self.inject:
                    self.is_injected = True
                    self.inject(self, operator)
                    return
            _CHECK_STOPPED(operator)

        with monkeypatch.context() as patched:
            patched.setattr(MachineApi, "check_stopped", check_and_inject)
            self.rig.run(self._script())

    def _script(self) -> "Iterator[Any]":
        """Send _LINES until the machine stops, reset, and check outputs, motion and the count."""
        wait = self.sender.wait
        yield from wait("banner", "")
        for line in _LINES:
            yield from self._send_line(line)
            if self._has_stopped():
                break
        if self._has_stopped():
            yield from wait("ms 1500", "")
        self._all_sent = True
        yield from wait("ms 600", "\x18")
        self.output += self.sender.take()
        port = self.rig.port
        assert (port.own_outputs, port.spindle_pwm) == (0, 0), "an output is on after a reset"
        yield from self._check_next_move()
        yield from wait("ms 100", "M102\n")  # reports the stored count
        assert self.sender.take() in [
            [f"[MSG:kept {n}]", "ok"] for n in self.store_with_fault.possible_counts
        ]
        if self.inject is _is_cut_short:
            self.rig.cycle_power()
            yield from wait("banner", "")
            yield from wait("ms 500", "$X\nG91G1X0.2F3000\n")  # the truncated file may stop this
            yield from wait("ms 600", "\x18")
            self.output += self.sender.take()
            yield from self._check_next_move()

    def _check_next_move(self) -> "Iterator[Any]":
        """Check that a move is complete, and that its end is reported."""
        wait = self.sender.wait
        yield from wait("ms 100", "$X\n")
        before = self._steps()
        yield from wait("idle", "G91G1X2Y-1F3000\n")
        moved = [b - a for a, b in zip(before, self._steps(), strict=True)]
        assert moved == [500, -250, 0], f"the next move is {moved}"  # steps: 2 mm, -1 mm
        self.sender.take()
        yield from wait("ms 20", "?")
        (report,) = [line for line in self.sender.take() if line.startswith("<")]
        reported_mm = [float(mm) for mm in report.partition("MPos:")[2].split("|")[0].split(",")]
        made_mm = [step / _STEPS_PER_MM for step in self._steps()]
        assert reported_mm == pytest.approx(made_mm, abs=0.0011), "the reported position is wrong"

    def _send_line(self, line: str) -> "Iterator[Any]":
        """Send a line, give it 400 ms, and end a hold; collect the replies."""
        try:
            yield from self.sender.wait("ms 400", line + "\n")
            if self.rig.controller.state.run == st.HOLD:
                yield from self.sender.wait("ms 400", "~")
        except TooLong:
            raise AssertionError(f"{line} does not end: {self.output}") from None
        self.output += self.sender.take()

    def check_messages(self) -> None:
        """Check that a failure was reported with file and line, and a slow handler by name."""
        messages = [line for line in self.output if self.file.name in line]
        if self.inject in _FAILS:
            assert any(f"{self.file.name}, line " in line for line in messages), "no file and line"
            assert not [line for line in self.output if line.startswith("error:")]
        if self.inject is _is_slow:
            assert any("ms without calling" in line for line in self.output)
        if self.inject is _is_cut_short and not _is_python(self.file.read_text()):
            assert messages, "a file that cannot be read"

    def _has_stopped(self) -> bool:
        """Return whether an alarm or a reset has come; the first lines are the power-up's."""
        return any(text.startswith(("ALARM", "Grbl")) for text in self.output[3:])

    def _steps(self) -> "list[int]":
        self.rig.engine.position(self.rig.scratch)
        return list(self.rig.scratch)


def _is_python(text: str) -> bool:
    """Return whether the text compiles."""
    try:
        compile(text, "", "exec")
    except SyntaxError:
        return False
    return True


@pytest.fixture
def board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """Return a board on the simulator whose custom.py is custom_injected.py in tmp_path."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    made = ModuleType("board")
    pins = {"OUTPUTS": {"vacuum": 20, "air": 21}}
    vars(made).update(vars(load_board("sim")), CUSTOM="custom_injected", **pins)
    return made


@pytest.mark.sampled(1)  # the first ring runs one of the parts
@pytest.mark.parametrize("part", range(_PARTS))
def test_no_step_is_lost_and_every_fault_is_reported(
    board: ModuleType, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, part: int
) -> None:
    """Play a session without a fault, to count calls and saves, then this part of all sessions.

    Each injects one fault at a random call of m, or power fails in a random save.
    """
    file = tmp_path / f"{board.CUSTOM}.py"
    faultless = Session(board, monkeypatch, file, seed=0, fault_at=0)
    faultless.play(monkeypatch)
    assert faultless.calls > 100 and not any("ALARM" in line for line in faultless.output)
    assert faultless.store_with_fault.saves == 2  # one for each M100
    for number in range(part, _SESSIONS, _PARTS):
        is_call = _KINDS[number % len(_KINDS)] is not None  # else power fails in a save
        fault_at = Random(number).randint(
            1, faultless.calls if is_call else faultless.store_with_fault.saves
        )
        session = Session(board, monkeypatch, file, seed=number, fault_at=fault_at)
        try:
            session.play(monkeypatch)
            assert session.is_injected or session.store_with_fault.has_failed
            session.check_messages()
        except (AssertionError, TooLong) as failed:
            raise AssertionError(f"session {number}: {failed!r} {session.output}") from failed
