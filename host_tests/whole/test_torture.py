"""Torture: random lines, real-time bytes anywhere in them, pins set, power cut.

The laws: one answer per line; the reported position is the motors'; and after anything, Ctrl-X and
$X make the machine work again. UGRBL_TORTURE sets the number of seeds (`make torture`).

Every method that is an Iterator is a part of the script; `yield self._rig.ms(20)` waits 20 ms of
the machine's time. _read_answers() also counts them, _wait_for(text) waits for a line that begins
so, _resume() ends a hold, and _with_log(text) adds the last lines to a message of a failure.
"""

import os
import random
from collections import deque
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest
from base import state as st
from rig_bench import Machine
from ugrbl.boardfile.files import load_board
from ugrbl.sim import motor_names
from ugrbl.sim import rig as sim_rig

_ASKED = int(os.environ.get("UGRBL_TORTURE") or 0)
_SEEDS = _ASKED or 4
# The axis of each motor, and the engine. An ESP32's RMT has four motors. The PIO's sessions run on
# an emulated Pico (host_tests/emulator): tick by tick they would last for hours.
_MACHINES = [
    ("XYZ", "sim"),
    *((motors, "sim") for motors in ("XYZA", "XYZY", "XYZAB", "XYZAY", "XYZABC", "XYZXYZ")),
    *((motors, "i2s") for motors in ("XYZ", "XYZY", "XYZAB", "XYZABC", "XYZAYZ")),
    *((motors, "rmt") for motors in ("XYZ", "XYZA", "XYZY")),
]
# All seeds for all machines if requested; otherwise one seed for each except the first.
_SESSIONS = [
    (seed, motors, engine)
    for k, (motors, engine) in enumerate(_MACHINES)
    for seed in (range(_SEEDS) if _ASKED or k == 0 else (k % 2,))
]
# An ESP32's engine may finish a step that has begun when it is stopped, and be one off.
_ESP_TOLERANCE = 1  # step
_ROUNDS = 12  # of talking, stopping or cutting the power
_WINDOW = 127  # bytes without an answer
_PATIENCE_MS = 120_000  # for all answers, and the end of motion
_DEAF_MS = 600  # an alarm is followed by half a second in which input is ignored
_FAST = {
    **dict.fromkeys(range(110, 116), 6000),
    **dict.fromkeys(range(120, 126), 800),
    112: 3000,
    122: 400,
}
_STEPS_PER_MM = 250
_HARMLESS = "?!~\x84\x85\x90\x91\x92\x93\x94\x95\x96\x97\x99\x9a\x9b\x9e\xa0\x81\xff"
_WORDS = (
    "G0 G1 G2 G3 G4P.02 G10L2P1X1 G17 G18 G20 G21 G28 G28.1 G38.3Z-.1 G43.1Z1 G49 G53 G54 G55 "
    "G61 G80 G90 G91 G92X1 G92.1 G93 G94 M0 M1 M3 M4 M5 M8 M9 M30 S0 S500 S1000 F100 F900 F3000 "
    "X1 X-1.5 Y.7 Y-2 Z.2 Z-.3 I.5 J-.4 R1 P1 T3 N7 L20 Q1 X1e3 G0.5 ( ; / % = [ ] \x7f"
).split()
_COMMANDS = (
    "$$ $# $G $I $N $ $X $10=2 $10=1 $1=25 $1=255 $12=0.003 $30=900 $32=1 $32=0 $4=0 "
    "$130=150 $3=2 $3=0 $N0=G54 $N0= $J=G91X1F900 $J=G91X-1Y1F3000 "
    "$J=X1 $H $999=1 $x=1 $10=abc $120="
).split()
_OF_MORE_AXES = "A.5 A-1 B.3 B-.7 C1 C-.2 A1e3".split()


class Torture:
    """One machine under torture."""

    def __init__(self, seed: int, motors: str, tolerance_steps: int) -> None:
        """Make the machine. motors: a letter each, "XYZY" has two on Y; tolerance_steps: after a
        stop."""
        self._tolerance_steps = tolerance_steps
        self._stopped = False  # since positions were compared
        self._random = random.Random(seed)
        self._axes = motor_names.count_axes(motors)
        self._axis_of = [motor_names.AXIS_LETTERS.index(letter) for letter in motors]
        # Settings 110 to 125 of its axes; hard limits and laser mode, depending on the seed.
        fast = {number: of for number, of in _FAST.items() if number % 10 < self._axes}
        settings = {**fast, 21: seed % 2, 32: seed // 2 % 2, 22: 0}
        self.machine = Machine(settings, _board(motors), watched=False)
        self._words = _WORDS + (_OF_MORE_AXES if self._axes > 3 else [])
        self._rig = self.machine.rig
        self._log: deque[str] = deque(maxlen=40)
        self._answers = 0  # counted by _read_answers()
        self._offset: "list[int] | None" = None  # of the reported position against the motors
        self._inverted_axes = 0  # $3 at that time

    def run(self) -> None:
        self.machine.run(self._script())

    def _script(self) -> Iterator[Any]:
        """Do something at random, then compare positions; 12 times."""
        yield from self.machine.start()
        for _ in range(_ROUNDS):
            act = self._random.choice((self._talk, self._talk, self._talk, self._stop, self._cut))
            self._log.append(f"-- {act.__name__}")
            yield from act()
            yield from self._compare()

    # Random actions

    def _line(self) -> str:
        """Return a random line: a $ command, one that is too long, a move, or up to five words."""
        roll = self._random.random()
        if roll < 0.15:
            return self._random.choice(_COMMANDS)
        if roll < 0.18:
            return "X" * self._random.randint(78, 110)
        words = self._random.choices(self._words, k=self._random.randint(0, 5))
        if roll < 0.6:
            words = ["G1F2000X%.2fY%.2f" % (self._random.uniform(-3, 3), self._random.random())]
            for letter in motor_names.AXIS_LETTERS[3 : self._axes]:
                words.append("%s%.2f" % (letter, self._random.uniform(-2, 2)))
        return self._random.choice(("", " ")).join(words)

    def _talk(self) -> Iterator[Any]:
        """Check that every line has one answer, whatever real-time bytes it contains."""
        lines = [self._line() for _ in range(self._random.randint(3, 20))]
        yield from self._stream(lines, "\n")
        until = self._rig.ms(_PATIENCE_MS)
        while not (self.machine.idle() and self._answers >= len(lines)):
            self._resume()
            assert self._rig.now < until, self._with_log("no answer, or no end")
            yield self._rig.ms(20)
            self._read_answers()
        assert self._answers == len(lines), self._with_log("one answer per line")

    def _stream(self, lines: "list[str]", end: str) -> Iterator[Any]:
        """Send lines with character counting, each with up to three real-time bytes inside.

        A line waits until it fits into _WINDOW with those that are not answered yet.
        """
        self._read_answers()
        self._answers = 0
        lengths: "list[int]" = []  # of all lines sent
        for text in lines:
            line = text + end
            for _ in range(self._random.choice((0, 0, 1, 3))):
                at = self._random.randint(0, len(line) - 1)
                line = line[:at] + self._random.choice(_HARMLESS) + line[at:]
            while sum(lengths[self._answers :]) + len(line) > _WINDOW:
                yield self._rig.ms(5)
                self._resume()
                self._read_answers()
            lengths.append(len(line))
            self._log.append(repr(line))
            self._rig.link.send(line.encode("latin-1"))

    def _stop(self) -> Iterator[Any]:
        """Stop at any moment: check that nothing moves and no output stays on.

        The cause is a reset (Ctrl-X or the button), or a limit switch if $21 (hard limits) is on.
        """
        cause = self._random.choice(("\x18", "reset", "limit_x", "limit_z"))
        hard = self._rig.controller.settings.hard_limits
        if cause.startswith("limit") and not hard:
            cause = "\x18"
        for line in (self._line() for _ in range(6)):
            self._rig.link.send(line.encode("latin-1") + b"\n")
        yield self._rig.ms(self._random.uniform(0, 400))
        self._log.append(f"stopped by {cause!r}")
        if cause == "\x18":
            self._rig.controller.realtime.post(0x18)
        else:
            self._rig.port.push({cause: True})
        place = self.machine.physical()
        yield self._rig.ms(self._random.uniform(1, 50))
        port = self._rig.port
        if self._rig.controller.state.run == st.ALARM:  # motion had to be stopped
            moved = _largest_difference(self.machine.physical(), place)
            assert moved <= self._tolerance_steps, self._with_log("it moved on")
            outputs = (port.spindle_on, port.spindle_pwm, port.flood, port.mist)
            assert not any(outputs), self._with_log(f"outputs are on: {outputs}")
        self._stopped = True
        port.push({"reset": False, "limit_x": False, "limit_z": False})
        yield from self._recover()

    def _cut(self) -> Iterator[Any]:
        """Cut the power at any moment."""
        yield from self._stream([self._line() for _ in range(4)], "\n")
        yield self._rig.ms(self._random.uniform(0, 200))
        self._rig.cycle_power()
        self._offset = None  # the position after power-up is a new one
        yield self._rig.ms(50)
        yield from self._recover()

    # Recovery and checks

    def _recover(self) -> Iterator[Any]:
        """Recover with Ctrl-X and $X."""
        yield self._rig.ms(_DEAF_MS)
        self._read_answers()
        self._rig.link.send(b"\x18")
        yield from self._wait_for("Grbl 1.1h")
        self._rig.link.send(b"$X\n")
        yield from self._wait_for("ok")
        until = self._rig.ms(_PATIENCE_MS)
        while not self.machine.idle():  # a startup line may move
            assert self._rig.now < until, self._with_log("it does not come to rest")
            yield self._rig.ms(20)

    def _wait_for(self, text: str) -> Iterator[Any]:
        until = self._rig.ms(10_000)
        while not any(line.startswith(text) for line in self._read_answers()):
            assert self._rig.now < until, self._with_log(f"no {text!r}")
            yield self._rig.ms(5)

    def _compare(self) -> Iterator[Any]:
        """Check that the reported position is the motors', and that the machine accepts lines.

        The two differ by an offset of each motor. It must be the same as in the last comparison,
        unless the power was cut or $3 (directions) was changed.
        """
        controller: Any = self._rig.controller
        if controller.state.run == st.ALARM:
            self._rig.link.send(b"$X\n")
            yield from self._wait_for("ok")
        # Modes as at first; $10=1: reports have MPos.
        self._rig.link.send(b"G21G90G94G49G54\n$10=1\n")
        yield from self._wait_for("ok")
        yield self._rig.ms(20)
        self._read_answers()
        self._rig.link.send(b"?")
        yield from self._wait_for("<")
        reported = [round(mm * _STEPS_PER_MM) for mm in self.machine.reported()]
        inverted_axes = controller.settings.dir_invert
        motors = zip(self._axis_of, self.machine.physical(), strict=True)
        # Motors turn the other way on axes in $3.
        made = [(axis, -steps if inverted_axes >> axis & 1 else steps) for axis, steps in motors]
        offset = [reported[axis] - steps for axis, steps in made]
        if self._offset is not None and inverted_axes == self._inverted_axes:
            error = _largest_difference(offset, self._offset)
            # Only a stop since then may have made a difference.
            assert error <= self._tolerance_steps * self._stopped, self._with_log(
                "the reported position is wrong"
            )
        self._offset, self._inverted_axes, self._stopped = offset, inverted_axes, False
        assert controller.state.run == st.IDLE, self._with_log("it is not idle")

    def _resume(self) -> None:
        if self._rig.controller.state.run & (st.HOLD | st.DOOR):
            self._rig.link.send(b"~")

    def _read_answers(self) -> "list[str]":
        lines = self.machine.take()
        self._answers += sum(line == "ok" or line.startswith("error:") for line in lines)
        self._log += lines
        return lines

    def _with_log(self, what: str) -> str:
        return what + "\n" + "\n".join(self._log)


def _board(motors: str) -> ModuleType:
    """Return the simulator's board with these motors: a letter, the axis, for each."""
    board = ModuleType("torture")
    vars(board).update(vars(load_board("sim")))
    # Numbers of pins are enough for the simulator.
    vars(board).update(STEP=tuple(range(len(motors))), LIMIT=tuple(range(len(motors))))
    if motor_names.count_axes(motors) < len(motors):  # some axis has two
        vars(board).update(MOTORS=motors)
    return board


def _largest_difference(one: "list[int]", other: "list[int]") -> int:
    return max(abs(a - b) for a, b in zip(one, other, strict=True))


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("seed", "motors", "engine"), _SESSIONS)
def test_a_tortured_machine_answers_keeps_its_position_and_recovers(
    seed: int, motors: str, engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Torture checks all this itself. motors: a letter, the axis, for each.

    engine: the simulator's, or one of the ESP32, whose position may be off by a step after a stop.
    """
    if engine != "sim":
        _have_engine(engine, monkeypatch)
    Torture(seed, motors, 0 if engine == "sim" else _ESP_TOLERANCE).run()


def _have_engine(name: str, patch: pytest.MonkeyPatch) -> None:
    """Make Rigs use this engine instead of the simulator's."""
    EspEngine = pytest.importorskip("esp_bench").EspEngine  # absent where test_prepared runs this

    class Engine:  # with the constructor of SimEngine
        tick_hz = EspEngine(name).tick_hz

        def __new__(cls, motors: int, _depth: int) -> Any:
            return EspEngine(name, motors)

    patch.setattr(sim_rig, "SimEngine", Engine)
