"""Set up the board that is measured: restart it, or load other commands, as a part needs it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import prompt
from emulated import Board, firmware
from streaming import SETTINGS, idle
from wire import EmulatedWire, SerialWire, Talk


class Counts(NamedTuple):
    """Count reads of flash, and cycles of the core: those spent waiting, and all."""

    hits: int
    misses: int
    stalled_cycles: int
    cycles: int


@dataclass
class Bench:
    """Give access to the board that is measured.

    uf2: the image for an emulated Pico, or port: the serial port of a real board. cache: use the
    model of the flash cache (host_tests/emulator/xip.py).
    """

    uf2: "Path | None" = None
    port: str = ""
    cache: bool = False
    _talks: "dict[bytes, Talk]" = field(default_factory=dict)
    _wire: "SerialWire | None" = None
    _runs: bool = True  # a real board runs its firmware; False: it is at the prompt
    _settings: "list[str]" = field(default_factory=list)
    _caches: "list[Any]" = field(default_factory=list)

    @property
    def emulated(self) -> bool:
        """Return whether the board is emulated: its clock is exact and its pins can be read."""
        return self.uf2 is not None

    def board(self, changes: "Mapping[str, bytes | None] | None" = None) -> Board:
        """Create a new emulated board with our firmware and these changes; it is not started."""
        assert self.uf2
        board = Board(self.uf2, changes, self.cache)
        if self.cache:
            self._caches.append(board.pico.mcu.cache)
        return board

    def counts(self) -> "Counts":
        """Return the sums of the counters of all caches."""
        return Counts(*(sum(getattr(x, name) for x in self._caches) for name in Counts._fields))

    def talk(self, main: bytes) -> Talk:
        """Return a conversation with a board that has these commands, is set up and is idle."""
        if main not in self._talks:
            talk = self._emulated(main) if self.uf2 else self._real(main)
            self._talks = {main: talk}
            set_up(talk)
        return self._talks[main]

    def pico(self, main: bytes) -> Board:
        """Return the emulated board that has these commands, set up and idle."""
        wire = self.talk(main).wire
        assert isinstance(wire, EmulatedWire)
        return wire.board

    def bare(self) -> Talk:
        """Return a conversation at MicroPython's raw prompt; an emulated board has no firmware."""
        if self.uf2:
            board = self.board(dict.fromkeys(firmware()))
            assert board.pico.run_until(lambda: board.pico.usb.connected > 0, 3_000_000)
            talk = Talk(EmulatedWire(board))
            prompt.begin_bare(talk)
            return talk
        return self._at_prompt()

    def close(self) -> None:
        """Restore a real board: its own program and its own settings."""
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
            answer = Talk(self._wire).ask("$$").split("\r\n")
            changed = {line.partition("=")[0] for line in (*SETTINGS, "$32=")}
            self._settings = [line for line in answer if line.partition("=")[0] in changed]
        talk = Talk(self._wire)
        self._talks.clear()
        if self._runs:
            prompt.leave_firmware(talk)
            self._runs = False
        return talk


def set_up(talk: Talk) -> None:
    """Apply the settings common to all rows (a row may change them) and move to X10 Y10."""
    for line in (*SETTINGS, "G90", "G0X10Y10"):
        talk.ask(line)
    idle(talk)


def reset(talk: Talk) -> None:
    """Send a soft reset, which discards all planned moves, and unlock."""
    talk.wire.received.clear()
    talk.wire.send(b"\x18")
    talk.wait(b"Grbl")
    talk.pause_us(20_000)
    talk.ask("$X")


def inside(talk: Talk, command: str) -> "list[int]":
    """Return the numbers with which one of our own commands (on_board.py) answers."""
    talk.wire.received.clear()
    talk.wire.send(command.encode() + b"\n")
    talk.wait(b".]\r\nok\r\n")
    answer = talk.wire.received.decode("latin-1").partition("[MSG:")[2].partition(".]")[0]
    return [int(number) for number in answer.split()]
