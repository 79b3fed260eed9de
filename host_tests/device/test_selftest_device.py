"""Test the self-test's access to a board, with a scripted stand-in for mpremote.

until_restart() runs a script that hangs the board on purpose, and returns whether it came back.
"""

from collections.abc import Callable
from typing import Any

import pytest
from mpremote.transport import TransportError
from ugrbl.device.connection import SendError
from ugrbl.device.deploy import DeployError
from ugrbl.device.selftest import device
from ugrbl.device.selftest.device import PromptBoard
from ugrbl.device.selftest.session import Wiring


class FakeSerial:
    """A serial port that delivers these pieces one at a time, then breaks."""

    def __init__(self, *pieces: bytes) -> None:
        self._pieces = list(pieces)
        self.written = b""

    @property
    def in_waiting(self) -> int:
        if not self._pieces:
            raise OSError("device disconnected")
        return len(self._pieces[0])

    def read(self, count: int) -> bytes:
        return self._pieces.pop(0)

    def write(self, data: bytes) -> None:
        self.written += data


class Transport:
    """The part of mpremote's transport that is used. output: what a script prints; exception:
    its text; wire: the serial port."""

    def __init__(
        self, output: bytes = b"", exception: bytes = b"", wire: "FakeSerial | None" = None
    ) -> None:
        self.serial = wire or FakeSerial()
        self.scripts: "list[str]" = []
        self.is_closed = False
        self._output, self._exception = output, exception

    def exec_raw_no_follow(self, script: str) -> None:
        self.scripts.append(script)

    def follow(self, seconds: float, consumer: "Callable[[bytes], None]") -> "tuple[bytes, bytes]":
        """Pass on the output byte by byte; return it and the exception."""
        for k in range(len(self._output)):
            consumer(self._output[k : k + 1])
        return self._output, self._exception

    def exec(self, script: str) -> bytes:
        self.scripts.append(script)
        return b""

    def eval(self, expression: str) -> Any:
        """Return engine, ENABLE pin and spindle pin, as the script WIRING does."""
        return ["pio", 8, None]

    def close(self) -> None:
        self.is_closed = True


def board_at(transport: Transport) -> PromptBoard:
    """Return a board at that transport."""
    prompt_board = PromptBoard.__new__(PromptBoard)
    prompt_board._transport, prompt_board._port_name = transport, "there"
    return prompt_board


def test_lines_are_reported_as_they_arrive_and_the_exception_after_them() -> None:
    """\\x04 ends the output in the raw REPL; it is not part of a line."""
    reported: "list[str]" = []
    transport = Transport(b"= board {}\r\nand more\r\n\x04", b"Traceback\r\nMemoryError: \r\n")
    exception = board_at(transport).run("script", reported.append, 1)
    assert exception == "Traceback\r\nMemoryError: \r\n"
    assert reported == ["= board {}", "and more"] and transport.scripts == ["script"]


@pytest.mark.parametrize(
    ("error", "words"),
    [(TransportError("no EOF"), "no EOF"), (OSError(5, "unplugged"), "the connection broke: ")],
)
def test_lost_board_is_reported_in_words(error: Exception, words: str) -> None:
    class Broken(Transport):
        def follow(self, *_: Any) -> "tuple[bytes, bytes]":
            raise error

    with pytest.raises(DeployError) as raised:
        board_at(Broken()).run("script", print, 1)
    assert words in str(raised.value) and "plug it in" in raised.value.todo
    assert "Errno" not in str(raised.value)


class AnsweringFirmware:
    """A connection to firmware that answers again."""

    def answers(self) -> bool:
        """Return True."""
        return True

    def close(self) -> None:
        """Close nothing: nothing is open."""


def test_firmware_answers_after_the_watchdog_has_disconnected_usb(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The board prints a fact twice, in any pieces, and hangs; its port breaks, and can be
    opened again at the third attempt."""
    opened_ports: "list[str]" = []

    def open_port(port: str) -> AnsweringFirmware:
        opened_ports.append(port)
        if len(opened_ports) < 3:
            raise SendError("not there yet")
        return AnsweringFirmware()

    monkeypatch.setattr(device, "Connection", open_port)
    reported: "list[str]" = []
    transport = Transport(wire=FakeSerial(b"= hang {", b"}\r\n= hang", b" {}\r\n"))
    assert board_at(transport).until_restart("hang", reported.append, 5)
    assert reported == ["= hang {}", "= hang {}"] and opened_ports == ["there"] * 3
    assert transport.is_closed


def test_board_that_never_hung_was_not_restarted_by_the_watchdog() -> None:
    transport = Transport(wire=FakeSerial(b"Traceback\r\n"))
    assert not board_at(transport).until_restart("hang", print, 5)


def test_board_that_does_not_return_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its port cannot be opened again in _BACK_S."""

    def open_port(port: str) -> AnsweringFirmware:
        raise SendError("not there")

    monkeypatch.setattr(device, "Connection", open_port)
    monkeypatch.setattr(device, "_BACK_S", 0.2)
    transport = Transport(wire=FakeSerial(b"= hang {}\r\n"))
    assert not board_at(transport).until_restart("hang", print, 5)


def test_board_file_is_read_on_the_board() -> None:
    assert board_at(Transport()).wiring() == Wiring("pio", 8, None)
