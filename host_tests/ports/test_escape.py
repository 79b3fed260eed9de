"""The escape to the MicroPython prompt, among the bytes of a sender.

Three times Ctrl-C (\\x03) in a row, or Ctrl-C and then Ctrl-A (\\x01) as mpremote sends them, lead
to the prompt. A CR between them does not matter."""

from types import SimpleNamespace
from typing import Any

import pytest
from ports import escape
from ports.escape import Escape


class Dupterm:
    """MicroPython's second terminal: it reads its stream after the bytes that have arrived."""

    def __init__(self) -> None:
        self.arrived = b""
        self._stream: Any = None

    def dupterm(self, stream: Any) -> Any:
        """Set the stream; return the one before, as os.dupterm() does."""
        before, self._stream = self._stream, stream
        return before

    def dupterm_notify(self, _: object) -> None:
        """Read all bytes that the stream has."""
        byte = bytearray(1)
        while self._stream.readinto(byte):
            self.arrived += byte


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Dupterm:
    """Replace the os module that the escape uses; return what the prompt receives."""
    second_terminal = Dupterm()
    replacement_os = SimpleNamespace(
        dupterm=second_terminal.dupterm, dupterm_notify=second_terminal.dupterm_notify
    )
    monkeypatch.setattr(escape, "os", replacement_os)
    return second_terminal


def leads_to_prompt(*pieces: bytes, at_rest: bool = True) -> bool:
    """Return whether these bytes, read in these pieces, lead to the prompt."""
    closed: list[bool] = []
    escape = Escape(lambda: closed.append(True))
    escape.at_rest = lambda: at_rest
    try:
        for piece in pieces:
            # the buffer is longer than the bytes received
            escape.listen(bytearray(piece) + bytearray(9), len(piece))
    except KeyboardInterrupt:
        assert closed == [True]
        return True
    assert closed == []
    return False


@pytest.mark.parametrize(
    "pieces",
    [
        (b"\x03\x03\x03",),
        (b"\x03", b"\x03", b"\x03"),
        (b"\r\x03", b"\r\x01"),  # mpremote
        (b"\r\x03\x03\r\x01",),
        (b"G0X1\n\x03\x01",),
        (b"\r\x03", b"\r", b"\x03", b"\r", b"\x03\r"),
    ],
)
def test_escape_sequences_lead_to_the_prompt(
    pieces: "tuple[bytes, ...]", terminal: Dupterm
) -> None:
    assert leads_to_prompt(*pieces)


@pytest.mark.parametrize(
    "pieces",
    [
        (b"\x03\x03",),
        (b"\x01\x01\x01",),
        (b"\x03G0\n\x03?\x03",),
        (b"\x03", b"G0X1\n", b"\x03", b"?", b"\x03"),
        (b"\x03", b"$$\n", b"\x01"),
        (b"", b"G1X10F100\n"),
    ],
)
def test_other_bytes_do_not_lead_to_the_prompt(
    pieces: "tuple[bytes, ...]", terminal: Dupterm
) -> None:
    assert not leads_to_prompt(*pieces)
    assert terminal.arrived == b""


def test_escape_is_ignored_while_the_machine_moves(terminal: Dupterm) -> None:
    assert not leads_to_prompt(b"\x03\x03\x03", at_rest=False)


def test_the_prompt_reads_the_bytes_after_the_escape(terminal: Dupterm) -> None:
    """The Ctrl-A itself is passed on: it switches the prompt to the raw REPL."""
    assert leads_to_prompt(b"\r\x03\r\x01print(1)\r\x04")
    assert terminal.arrived == b"\x01print(1)\r\x04"
