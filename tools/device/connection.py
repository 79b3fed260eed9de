"""A Grbl on a serial port: its lines, bytes to it, and the state it reports.

Every failure of the port is a SendError that says in words what may be wrong. Grbl 1.1 writes
`<Idle|MPos:…|…>`, Grbl 0.9 `<Idle,MPos:…,…>`; both are read.
"""

import errno
import os
import re
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import serial

from ..grbl.gcode_file import STATUS, is_answer
from ..grbl.wire_bytes import permitted

BAUD = 115200
WINDOW = 127  # bytes in Grbl's receive buffer, minus one
# Blocks in Grbl's planner if it does not report them.
BLOCKS = 15
POLL_S = 0.2  # between two requests of the status
_READ_S = 0.02  # a read waits so long for a byte
_WRITE_S = 5.0  # a write waits so long for space
# An Arduino that resets when its port is opened is silent for a second or two.
_START_S = 5.0
_OPTIONS = re.compile(r"\[OPT:[^,]*,(\d+),(\d+)(?:,.*)?\]")
_DRAINS = re.compile(r"\|Dr:(\d+)")
_BUFFER = re.compile(r"\|Bf:(\d+),(\d+)")
_PLACE = re.compile(r"[|,]([MW])Pos:(-?[\d.]+(?:,-?[\d.]+)*)")
_WORK = re.compile(r"[|,]WPos:(-?[\d.]+(?:,-?[\d.]+)*)")
_OFFSET = re.compile(r"\|WCO:(-?[\d.]+(?:,-?[\d.]+)*)")
_OF_A_NETWORK = ("socket", "rfc2217")
_HOST_AND_PORT = re.compile(r"://[^/?]+:(\d+)")
_MOST_PORTS = 0xFFFF
_MOST_AXES = 6
# Folders of pseudo-terminals on Linux and on macOS.
_PSEUDO_TERMINALS = ("/dev/pts/", "/dev/ttys")
ONLY_RESET = "after ALARM:1 or ALARM:2 it accepts only a reset (Ctrl-X)"
# States in which Grbl reads no lines, and states in which it stays still.
_DEAF = ("Hold", "Door", "Sleep")
_AT_REST = ("Idle", "Check", "Alarm", "Sleep")


class SendError(Exception):
    """A request cannot be carried out, or not completely; the text says why."""


def open_port(port: str, baud: int, read_s: float) -> Any:
    """Open a serial port, or the one that a URL names, exclusively. read_s: time limit for a
    read."""
    try:
        return serial.serial_for_url(
            port, baud, timeout=read_s, write_timeout=_WRITE_S, exclusive=True
        )
    except (OSError, ValueError) as error:
        raise SendError(f"cannot open {port}: {_why_not(port, baud, error)}") from error


class Connection:
    """Reads lines from a Grbl and writes bytes to it."""

    def __init__(self, port: str, baud: int = BAUD) -> None:
        self._serial = open_port(port, baud, _READ_S)
        self._port = port
        self._text = ""  # bytes of a line that is not complete
        self.window = WINDOW  # bytes that may be unanswered
        self.blocks = BLOCKS  # capacity of the planner
        self.status = ""  # the last status report
        # For Grbl 0.9, whose reports have no bars, bytes from 0x80 on are parts of lines.
        self.takes_overrides = False
        self.info: list[str] = []  # replies to $I in start()
        self.heard = time.monotonic()  # time of the last byte received
        self._offset: list[float] | None = None  # WCO: machine minus work position; None: unknown
        self._held_status = ""  # the last report of a held Grbl 0.9

    def close(self) -> None:
        """Close the port."""
        self._serial.close()

    def write(self, data: bytes) -> None:
        """Send those of the bytes that Grbl understands."""
        try:
            self._serial.write(permitted(data))
        except serial.SerialTimeoutException as error:
            text = "the machine accepts no more bytes; check its power, and connect again"
            raise SendError(text) from error
        except OSError as error:
            raise SendError(broke(self._port)) from error

    def lines(self) -> Iterator[str]:
        """Yield the lines received; waits up to the read limit for the first. The status is that
        of the last report yielded."""
        try:
            data = self._serial.read(max(1, self._serial.in_waiting))
        except (
            OSError,
            TypeError,
        ) as error:  # TypeError: pyserial, if the port is closed meanwhile
            raise SendError(broke(self._port)) from error
        if data:
            self.heard = time.monotonic()
        self._text += data.decode("latin-1")
        *lines, self._text = self._text.split("\r\n")
        for line in lines:
            if line.startswith("<"):
                self._note_status(line)
            yield line

    def state(self) -> str:
        """Return the machine's state as last reported: `Idle`, `Hold:0` …"""
        return state_of(self.status)

    def place(self) -> list[float]:
        """Return the machine position as last reported, in its own unit; empty if not known."""
        found = _PLACE.search(self.status)
        if not found:
            return []
        numbers = [float(number) for number in found[2].split(",")]
        if found[1] == "M":  # MPos
            return numbers
        offset = self._offset or []  # WPos without a known offset says nothing
        return [work + shift for work, shift in zip(numbers, offset, strict=False)]

    def work_place(self) -> list[float]:
        """Return the work position as last reported, in its own unit; with an offset that is not
        yet known taken as 0."""
        found = _WORK.search(self.status)
        if found:
            return [float(number) for number in found[1].split(",")]
        offset = self._offset or [0.0] * _MOST_AXES
        return [machine - shift for machine, shift in zip(self.place(), offset, strict=False)]

    def blocks_left(self) -> int | None:
        """Return how many blocks of the planner are not yet executed; None if reports do not have
        it."""
        found = _BUFFER.search(self.status)
        return self.blocks - int(found[1]) if found else None

    def drains(self) -> int:
        """Return the number of underruns in the last status report; 0 if the board does not count
        them."""
        found = _DRAINS.search(self.status)
        return int(found[1]) if found else 0

    def at_rest(self) -> bool:
        """Return whether the machine stands still, by its last report.

        Grbl 0.9 reports `Hold` as soon as it begins to slow down, so two reports must have the
        same position.
        """
        state = self.state()
        if state in ("Hold:0", "Door:0", "Door:1") or state in _AT_REST:
            return True
        before, self._held_status = self._held_status, self.status
        return state in ("Hold", "Door") and self.status == before

    def wait_for(self, done: Callable[[str], bool], seconds: float) -> bool:
        """Poll the status until done(line) is true for a line received. Returns False after
        `seconds`."""
        until = time.monotonic() + seconds
        polled_at = 0.0
        while time.monotonic() < until:
            if time.monotonic() - polled_at >= POLL_S:
                self.write(STATUS)
                polled_at = time.monotonic()
            # A list, so that done() gets every line: it may collect them.
            if any([done(line) for line in self.lines()]):  # noqa: C419
                return True
        return False

    def answers(self) -> bool:
        """Return whether a Grbl reports its status."""
        return self.wait_for(lambda line: line.startswith("<"), _START_S)

    def start(self) -> None:
        """Wait until Grbl answers, and ask for its buffer sizes. SendError if it is not ready for
        work."""
        if not self.answers():
            raise SendError(f"no Grbl answers on this port; {ONLY_RESET}")
        state = self.state()
        if state == "Alarm":
            text = "the machine is locked in Alarm: home it ($H) or unlock it ($X) first"
            raise SendError(f"{text}, with `ugrbl console`")
        if state not in ("Idle", "Check"):
            raise SendError(f"the machine is in {state}: {way_out(state)} first")
        self.info = self.ask("$I")  # ask() reads the sizes in it

    def ask(self, line: str) -> list[str]:
        """Send a line and return its replies; the answer (ok, error) is the last one. SendError
        without an answer."""
        self.write(line.encode("latin-1") + b"\n")
        replies: list[str] = []

        def is_answered(reply: str) -> bool:
            """Collect a reply, and read the options of $I. Returns whether it is the answer.

            Lines after the answer, such as the greeting of an opened port, are not collected.
            """
            if replies and is_answer(replies[-1]):
                return True
            options = _OPTIONS.fullmatch(reply)
            if options:  # blocks in the planner, bytes in the receive buffer
                self.blocks = int(options[1])
                self._raise_window(int(options[2]))
            if not reply.startswith("<"):
                replies.append(reply)
            return is_answer(reply)

        if not self.wait_for(is_answered, _START_S):
            raise SendError(self._why_no_answer(line))
        return replies

    def _why_no_answer(self, line: str) -> str:
        """Return that there is no answer to a line, and what the state has to do with it."""
        state = self.state()
        if is_deaf(state):
            return f"no answer to {line}: in {state} Grbl reads no lines; {way_out(state)} first"
        return f"no answer to {line}"

    def _note_status(self, line: str) -> None:
        """Store a status report, and what only some reports have: offset and buffer size."""
        self.status = line
        self.takes_overrides = "|" in line
        offset = _OFFSET.search(line)
        if offset:
            self._offset = [float(number) for number in offset[1].split(",")]
        free = _BUFFER.search(line)
        if free:  # at times all bytes of the buffer are free
            self._raise_window(int(free[2]))

    def _raise_window(self, buffer: int) -> None:
        """Note that Grbl's receive buffer has at least so many bytes."""
        self.window = max(self.window, buffer - 1)


def state_of(status: str) -> str:
    """Return the state in a report."""
    return re.split("[|,>]", status[1:])[0]


def is_deaf(state: str) -> bool:
    """Return whether Grbl reads no lines in a state, only real-time commands."""
    return state.partition(":")[0] in _DEAF


def way_out(state: str) -> str:
    """Return the next step for a state."""
    return {
        "Alarm": "home it ($H) or unlock it ($X)",
        "Hold": "resume (~) or reset (Ctrl-X) it",
        "Door": "close the safety door and resume (~)",
        "Sleep": "reset it (Ctrl-X)",
        "Check": "end check mode ($C)",
        "Run": "wait until the job has ended",
        "Jog": "wait until the jog has ended",
        "Home": "wait until homing has ended",
    }.get(state.partition(":")[0], "reset it (Ctrl-X)")


def is_simulator(port: str) -> bool:
    """Return whether a port is no device, but a pseudo-terminal, such as the simulator's, or was
    one: a name outside /dev is a link to one that is gone."""
    path = os.path.realpath(port)
    return path.startswith(_PSEUDO_TERMINALS) or (
        os.name == "posix" and "://" not in port and not path.startswith("/dev/")
    )


def broke(port: str) -> str:
    """Return a message for a connection that broke, with what to check."""
    question = "is the cable still plugged in, and does no other program use the port?"
    if port.partition("://")[0] in _OF_A_NETWORK:
        question = "is the machine still on, and in this network?"
    elif is_simulator(port):
        question = "has the simulator ended?"
    return f"the connection broke: {question}"


def _why_not(port: str, baud: int, error: Exception) -> str:
    """Return why a port cannot be opened, and the next step."""
    kind, is_url, _ = port.partition("://")  # is_url: "" for the name of a device
    number = _errno(error)
    if kind in _OF_A_NETWORK and is_url:
        return _why_no_connection(kind, port, number)
    if is_url:
        return "a port is a device, or socket://HOST:PORT; `ugrbl ports` lists devices"
    if "baud" in str(error):
        return f"it does not support {baud} baud; Grbl 1.1 uses {BAUD}"
    if number == errno.ENOENT or "FileNotFound" in str(error):
        if is_simulator(port):
            return "no such port; is its name right, and does the simulator run?"
        return (
            "no such port; is the cable one that carries data? `ugrbl ports` lists what is there"
        )
    if number in (errno.EBUSY, errno.EAGAIN) or "Access is denied" in str(error):
        return "another program has it; close that"  # Windows reports this as a denied access
    if number == errno.EACCES:
        return "permission denied; add yourself to its group (`ls -l` shows which) and log in anew"
    if number in (errno.EISDIR, errno.ENOTTY) or "configure port" in str(error):
        return "it is no serial port; `ugrbl ports` lists the serial ports"
    name = errno.errorcode.get(number, "unknown reason")
    return f"the system refuses it ({name}); unplug it, plug it in, and try again"


def _why_no_connection(kind: str, port: str, number: int) -> str:
    """Return why a port on the network cannot be opened. kind: socket or rfc2217. number: errno,
    or the number of a failed search for the host."""
    found = _HOST_AND_PORT.search(port)
    if not found or not 0 < int(found[1]) <= _MOST_PORTS:
        return f"{kind}:// needs a host and a port: {kind}://HOST:PORT"
    if number == errno.ECONNREFUSED:
        return "no program listens there; does the firmware or simulator run, and is it this port?"
    if number in (socket.EAI_NONAME, socket.EAI_AGAIN):
        return "no host of that name is known; is it written right, and in this network?"
    return "no answer; is the machine on, and in this network?"


def _errno(error: BaseException | None) -> int:
    """Return the system's error number; 0 if there is none. pyserial's exception has it, or the
    one that it was raised from."""
    while error:
        if isinstance(error, OSError) and error.errno:
            return error.errno
        error = error.__context__
    return 0
