"""A board to measure: the emulated Pico with its exact clock, or a real one on a serial port."""

import time
from typing import Protocol

import serial
from emulated import Board


class Wire(Protocol):
    """A connection to a board, and a clock."""

    kind: str  # "emulated" or "on hardware"
    received: bytearray

    def now_us(self) -> float:
        """Return the time, in us."""

    def send(self, data: bytes) -> None:
        """Send bytes to the board."""

    def turn(self) -> None:
        """Let a short time pass and store the received bytes."""


class EmulatedWire:
    """A Wire to an emulated Pico."""

    kind = "emulated"

    def __init__(self, board: Board) -> None:
        self.board = board
        self.received = board.pico.usb.received
        self.send = board.pico.usb.send

    def now_us(self) -> float:
        return self.board.pico.us

    def turn(self) -> None:
        self.board.pico.run_us(50)


class SerialWire:
    """A Wire to a board on a serial port; times are those of this computer."""

    kind = "on hardware"

    def __init__(self, port: str) -> None:
        self.received = bytearray()
        self._serial = serial.Serial(port, 115200, timeout=0)

    def now_us(self) -> float:
        return time.perf_counter_ns() / 1000

    def send(self, data: bytes) -> None:
        self._serial.write(data)

    def turn(self) -> None:
        self.received += self._serial.read(4096)


class Talk:
    """A conversation over a Wire."""

    def __init__(self, wire: Wire) -> None:
        self.wire = wire

    def wait(self, text: bytes, limit_us: float = 5_000_000) -> float:
        """Wait until the text is received; return the time, in us. Raise TimeoutError."""
        end = self.wire.now_us() + limit_us
        while text not in self.wire.received:
            if self.wire.now_us() > end:
                raise TimeoutError(f"no {text!r} in {bytes(self.wire.received[-200:])!r}")
            self.wire.turn()
        return self.wire.now_us()

    def ask(self, line: str) -> str:
        """Send a line and return its answer; raise RuntimeError if the line is refused."""
        self.wire.received.clear()
        self.wire.send(line.encode() + b"\n")
        self.wait(b"\r\n")
        if b"error:" in self.wire.received:
            raise RuntimeError(f"{line}: {bytes(self.wire.received)!r}")
        self.wait(b"ok\r\n")
        return self.wire.received.decode("latin-1")

    def pause_us(self, us: float) -> None:
        """Let time pass."""
        end = self.wire.now_us() + us
        while self.wire.now_us() < end:
            self.wire.turn()
