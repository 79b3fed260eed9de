"""Use MicroPython's raw prompt over a Wire: load our commands on a real board, run code."""

from wire import Talk

_RAW = b"raw REPL; CTRL-B to exit\r\n>"
_CODE_US = 20_000_000


def leave_firmware(talk: Talk) -> None:
    """Go from the idle machine to the raw prompt; the firmware's objects stay in memory."""
    talk.wire.received.clear()
    talk.wire.send(b"\x03\x03\x03")
    talk.wait(b"Here is the REPL")
    _raw(talk)


def begin_bare(talk: Talk) -> None:
    """Go to the raw prompt of a board that has no program."""
    talk.pause_us(50_000)
    talk.wire.send(b"\r\x03")
    talk.wait(b">>> ")
    _raw(talk)


def _raw(talk: Talk) -> None:
    talk.pause_us(5_000)
    talk.wire.send(b"\x01")
    talk.wait(_RAW)


def run(talk: Talk, code: str) -> str:
    """Run code at the raw prompt and return its output; raise RuntimeError if it raises."""
    talk.wire.received.clear()
    talk.wire.send(code.encode() + b"\x04")
    talk.wait(b"\x04>", _CODE_US)
    output, exception, _ = talk.wire.received.decode("latin-1").removeprefix("OK").split("\x04", 2)
    if exception:
        raise RuntimeError(exception)
    return output


def start_firmware(talk: Talk, main: bytes) -> None:
    """Reset, then run the firmware with this program instead of main.py; store nothing."""
    talk.wire.received.clear()
    talk.wire.send(b"\x04")
    talk.wait(_RAW)
    talk.wire.received.clear()
    talk.wire.send(main + b"\x04")
    talk.wait(b"Grbl 1.1h")
    talk.pause_us(300_000)


def restart(talk: Talk) -> None:
    """Go from the raw prompt back to the firmware stored on the board."""
    talk.wire.received.clear()
    talk.wire.send(b"\x02\x04")
    talk.wait(b"Grbl 1.1h")
