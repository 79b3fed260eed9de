"""Torture: random lines, real-time bytes anywhere in them, pins pushed, power cut.

Laws: one answer per line; where the machine says it is, the motors are; and whatever has happened,
Ctrl-X and $X bring it back. UGRBL_TORTURE says with how many seeds (`make torture`).
"""

import os
import random
from collections import deque
from collections.abc import Iterator
from typing import Any

import pytest
from base import state as st
from rig_bench import Machine

_SEEDS = int(os.environ.get("UGRBL_TORTURE") or 4)
_ROUNDS = 12
_WINDOW = 127
_PATIENCE_MS = 120_000
_DEAF_MS = 600  # an alarm is followed by half a second in which nothing is heard
_FAST = {110: 6000, 111: 6000, 112: 3000, 120: 800, 121: 800, 122: 400}
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


class Torture:
    """One machine and its torturer."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        settings = {**_FAST, 21: seed % 2, 32: seed // 2 % 2, 22: 0}
        self.machine = Machine(settings, watched=False)
        self._rig = self.machine.rig
        self._log: deque[str] = deque(maxlen=40)
        self._answers = 0
        self._offset: "list[int] | None" = None  # of what is reported against the motors
        self._turned = 0  # $3 at that time

    def run(self) -> None:
        self.machine.run(self._script())

    def _script(self) -> Iterator[Any]:
        yield from self.machine.start()
        for _ in range(_ROUNDS):
            act = self._random.choice((self._talk, self._talk, self._talk, self._stop, self._cut))
            self._log.append(f"-- {act.__name__}")
            yield from act()
            yield from self._compare()

    # What is done to it

    def _line(self) -> str:
        roll = self._random.random()
        if roll < 0.15:
            return self._random.choice(_COMMANDS)
        if roll < 0.18:
            return "X" * self._random.randint(78, 110)
        words = self._random.choices(_WORDS, k=self._random.randint(0, 5))
        if roll < 0.6:
            words = ["G1F2000X%.2fY%.2f" % (self._random.uniform(-3, 3), self._random.random())]
        return self._random.choice(("", " ")).join(words)

    def _talk(self) -> Iterator[Any]:
        """Every line has one answer, whatever real-time bytes stand in it."""
        lines = [self._line() for _ in range(self._random.randint(3, 20))]
        yield from self._stream(lines, "\n")
        until = self._rig.ms(_PATIENCE_MS)
        while not (self.machine.idle() and self._answers >= len(lines)):
            self._go_on()
            assert self._rig.now < until, self._tell("no answer, or no end")
            yield self._rig.ms(20)
            self._hear()
        assert self._answers == len(lines), self._tell("one answer per line")

    def _stream(self, lines: "list[str]", end: str) -> Iterator[Any]:
        """Send them by counting characters."""
        self._hear()
        self._answers = 0
        lengths: "list[int]" = []
        for text in lines:
            line = text + end
            for _ in range(self._random.choice((0, 0, 1, 3))):
                at = self._random.randint(0, len(line) - 1)
                line = line[:at] + self._random.choice(_HARMLESS) + line[at:]
            while sum(lengths[self._answers :]) + len(line) > _WINDOW:
                yield self._rig.ms(5)
                self._go_on()
                self._hear()
            lengths.append(len(line))
            self._log.append(repr(line))
            self._rig.link.send(line.encode("latin-1"))

    def _stop(self) -> Iterator[Any]:
        """Something stops it in the middle: nothing moves on, nothing stays on."""
        way = self._random.choice(("\x18", "reset", "limit_x", "limit_z"))
        hard = self._rig.controller.settings.hard_limits
        if way.startswith("limit") and not hard:
            way = "\x18"
        for line in (self._line() for _ in range(6)):
            self._rig.link.send(line.encode("latin-1") + b"\n")
        yield self._rig.ms(self._random.uniform(0, 400))
        self._log.append(f"stopped by {way!r}")
        if way == "\x18":
            self._rig.controller.realtime.post(0x18)
        else:
            self._rig.port.push({way: True})
        place = self.machine.physical()
        yield self._rig.ms(self._random.uniform(1, 50))
        port = self._rig.port
        if self._rig.controller.state.run == st.ALARM:
            assert self.machine.physical() == place, self._tell("it moved on")
            on = (port.spindle_on, port.spindle_pwm, port.flood, port.mist)
            assert not any(on), self._tell(f"outputs are on: {on}")
        port.push({"reset": False, "limit_x": False, "limit_z": False})
        yield from self._recover()

    def _cut(self) -> Iterator[Any]:
        """The power goes, in whatever it is doing."""
        yield from self._stream([self._line() for _ in range(4)], "\n")
        yield self._rig.ms(self._random.uniform(0, 200))
        self._rig.cycle_power()
        self._offset = None
        yield self._rig.ms(50)
        yield from self._recover()

    # What it has to do then

    def _recover(self) -> Iterator[Any]:
        """Ctrl-X and $X bring it back."""
        yield self._rig.ms(_DEAF_MS)
        self._hear()
        self._rig.link.send(b"\x18")
        yield from self._until("Grbl 1.1h")
        self._rig.link.send(b"$X\n")
        yield from self._until("ok")
        until = self._rig.ms(_PATIENCE_MS)
        while not self.machine.idle():  # a startup line may move
            assert self._rig.now < until, self._tell("it does not come to rest")
            yield self._rig.ms(20)

    def _until(self, text: str) -> Iterator[Any]:
        until = self._rig.ms(10_000)
        while not any(line.startswith(text) for line in self._hear()):
            assert self._rig.now < until, self._tell(f"no {text!r}")
            yield self._rig.ms(5)

    def _compare(self) -> Iterator[Any]:
        """Where it says it is, the motors are; it can be told to go on."""
        controller: Any = self._rig.controller
        if controller.state.run == st.ALARM:
            self._rig.link.send(b"$X\n")
            yield from self._until("ok")
        self._rig.link.send(b"G21G90G94G49G54\n$10=1\n")
        yield from self._until("ok")
        yield self._rig.ms(20)
        self._hear()
        self._rig.link.send(b"?")
        yield from self._until("<")
        reported = [round(mm * _STEPS_PER_MM) for mm in self.machine.reported()]
        turned = controller.settings.dir_invert
        ways = [-1 if turned >> axis & 1 else 1 for axis in range(len(reported))]
        made = [way * steps for way, steps in zip(ways, self.machine.physical(), strict=True)]
        offset = [a - b for a, b in zip(reported, made, strict=True)]
        if self._offset is not None and turned == self._turned:
            assert offset == self._offset, self._tell("it is not where it says")
        self._offset, self._turned = offset, turned
        assert controller.state.run == st.IDLE, self._tell("it is not idle")

    def _go_on(self) -> None:
        if self._rig.controller.state.run & (st.HOLD | st.DOOR):
            self._rig.link.send(b"~")

    def _hear(self) -> "list[str]":
        lines = self.machine.take()
        self._answers += sum(line == "ok" or line.startswith("error:") for line in lines)
        self._log += lines
        return lines

    def _tell(self, what: str) -> str:
        return what + "\n" + "\n".join(self._log)


@pytest.mark.parametrize("seed", range(_SEEDS))
def test_a_tortured_machine_answers_knows_its_place_and_comes_back(seed: int) -> None:
    Torture(seed).run()
