"""The board that is measured: started anew, or given other commands, where a part wants that."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import prompt
from emulated import Board, firmware
from streaming import SETTINGS, idle
from wire import EmulatedWire, SerialWire, Talk


class Counts(NamedTuple):
    """Reads of flash, and cycles of the core: waiting, and all together."""

    hits: int
    misses: int
    stalled_cycles: int
    cycles: int


@dataclass
class Bench:
    """uf2: the image for an emulated Pico, or port: where a real board is. cache: with the model
    of the flash cache (host_tests/emulator/xip.py)."""

    uf2: "Path | None" = None
    port: str = ""
    cache: bool = False
    _talks: "dict[bytes, Talk]" = field(default_factory=dict)
    _wire: "SerialWire | None" = None
    _runs: bool = True  # a real board's firmware; else it is at the prompt
    _settings: "list[str]" = field(default_factory=list)
    _caches: "list[Any]" = field(default_factory=list)

    @property
    def emulated(self) -> bool:
        """Whether time is the chip's, and pins can be looked at."""
        return self.uf2 is not None

    def board(self, changes: "Mapping[str, bytes | None] | None" = None) -> Board:
        """A new emulated board with the firmware as it is, but for the changes; not started."""
        assert self.uf2
        board = Board(self.uf2, changes, self.cache)
        if self.cache:
            self._caches.append(board.pico.mcu.cache)
        return board

    def counts(self) -> "Counts":
        """What all caches have counted."""
        return Counts(*(sum(getattr(x, name) for x in self._caches) for name in Counts._fields))

    def talk(self, main: bytes) -> Talk:
        """A board with these commands, set up and at rest."""
        if main not in self._talks:
            talk = self._emulated(main) if self.uf2 else self._real(main)
            self._talks = {main: talk}
            set_up(talk)
        return self._talks[main]

    def pico(self, main: bytes) -> Board:
        """The same, where it is emulated."""
        wire = self.talk(main).wire
        assert isinstance(wire, EmulatedWire)
        return wire.board

    def bare(self) -> Talk:
        """At MicroPython's raw prompt, emulated: without our firmware."""
        if self.uf2:
            board = self.board(dict.fromkeys(firmware()))
            assert board.pico.run_until(lambda: board.pico.usb.connected > 0, 3_000_000)
            talk = Talk(EmulatedWire(board))
            prompt.begin_bare(talk)
            return talk
        return self._at_prompt()

    def close(self) -> None:
        """Leave a real board as it was: its own program, its own settings."""
        if self._wire:
            talk = self._at_prompt()
            prompt.restart(talk)
            talk.pause_us(300_000)
            for line in self._settings:
                talk.ask(line)

    def _emulated(self, main: bytes) -> Talk:
        return Talk(EmulatedWire(self.board({"main.py": main}).boot().settled()))

    def _real(self, main: bytes) -> Talk:
        talk = self._at_prompt()
        prompt.start_firmware(talk, main)
        self._runs = True
        return talk

    def _at_prompt(self) -> Talk:
        if self._wire is None:
            self._wire = SerialWire(self.port)
            reset(Talk(self._wire))
            said = Talk(self._wire).ask("$$").split("\r\n")
            changed = {line.partition("=")[0] for line in (*SETTINGS, "$32=")}
            self._settings = [line for line in said if line.partition("=")[0] in changed]
        talk = Talk(self._wire)
        self._talks.clear()
        if self._runs:
            prompt.leave_firmware(talk)
            self._runs = False
        return talk


def set_up(talk: Talk) -> None:
    """The settings of all rows, but for those that say otherwise; at X10 Y10."""
    for line in (*SETTINGS, "G90", "G0X10Y10"):
        talk.ask(line)
    idle(talk)


def reset(talk: Talk) -> None:
    """A soft reset; whatever was planned is forgotten."""
    talk.wire.received.clear()
    talk.wire.send(b"\x18")
    talk.wait(b"Grbl")
    talk.pause_us(20_000)
    talk.ask("$X")


def inside(talk: Talk, command: str) -> "list[int]":
    """The numbers that a command of our own (on_board.py) answers with."""
    talk.wire.received.clear()
    talk.wire.send(command.encode() + b"\n")
    talk.wait(b".]\r\nok\r\n")
    said = talk.wire.received.decode("latin-1").partition("[MSG:")[2].partition(".]")[0]
    return [int(number) for number in said.split()]
