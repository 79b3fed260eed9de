"""The board under test: which firmware answers on a port, its inputs, a small move."""

import re
import time
from collections.abc import Callable
from typing import NamedTuple

import serial

from ..grbl.gcode_file import is_answer
from ..grbl.messages import meaning
from . import checkup
from .checkup import BAD, NOTE, OK, PINS, Finding
from .connection import BAUD, Connection, SendError, broke, way_out

_ANSWER_S = 5.0
_FAULT_S = 2.0
_REPL_S = 1.0  # a read waits so long for the prompt
_POLL_S = 0.05  # between two reports
_MOVE_S = 20.0  # time limit for a move
_MM = 1.0  # length of the move
_NEAR_MM = 0.006  # deviation allowed for rounding in reports
_BEYOND_TRAVEL = "error:15"
_PINS = re.compile(r"\|Pn:([A-Z]+)")
_STRANGERS = (
    (
        re.compile(r"rst:0x|ets [A-Z][a-z]{2} |Guru Meditation"),
        "an ESP32 that starts over and over",
    ),
    (re.compile(r"echo:|Marlin|FIRMWARE_NAME"), "Marlin, for 3D printers"),
    (re.compile(r"Traceback \(most recent"), "a Python program that has failed"),
)
_ASK_REPL = (
    b"import gc,os,sys;gc.collect();"
    b"print('|'.join(('',sys.platform,os.uname()[4],os.uname()[2],str(gc.mem_free()),"
    b"str('main.py' in os.listdir()),'')))\r"
)
# What _ASK_REPL prints: |platform|name|version|free bytes|has main.py|
_REPL = re.compile(r"^\|([^|']*)\|([^|']*)\|([^|']*)\|(\d+)\|(True|False)\|", re.MULTILINE)


class Board(NamedTuple):
    """A MicroPython at its prompt."""

    platform: str
    name: str
    version: str
    free_bytes: int
    has_program: bool


def stranger(port: str, baud: int = BAUD) -> list[Finding]:
    """Find out what is on a port where no Grbl answers. A program may be stopped (Ctrl-C), because
    it is not a Grbl."""
    try:
        with serial.Serial(port, baud, timeout=_REPL_S) as wire:
            wire.write(b"\r\x03\x03\r")  # Ctrl-C, twice: MicroPython shows its prompt
            heard = wire.read(4096).decode("latin-1")
            if ">>>" in heard:
                wire.write(_ASK_REPL)
                heard += wire.read(4096).decode("latin-1")
    except serial.SerialException:
        return [Finding("port", BAD, broke(port), "then run this again")]
    board = _REPL.search(heard.replace("\r", ""))
    if ">>>" in heard:
        return _idle_board(board)
    for line in heard.splitlines():
        if line.startswith("[MSG:") and checkup.is_fault(line):
            return [checkup.fault(line)]
    for pattern, who in _STRANGERS:
        if pattern.search(heard):
            todo = "install the firmware on the board again"
            return [Finding("firmware", BAD, f"no Grbl: this looks like {who}", todo)]
    # Many bytes beyond ASCII: another baud rate.
    if heard and not heard.isprintable() and sum(c > "\x7f" for c in heard) > len(heard) / 4:
        text = "the board sends bytes that are no text"
        return [Finding("firmware", BAD, text, f"try another baud rate than {baud} (--baud)")]
    text = "no answer" if not heard.strip() else f"no Grbl, but: {heard.strip()[:80]!r}"
    todo = (
        "is it powered, is the firmware on it, is this its port? If so, unplug it and try again; "
    )
    todo += "after ALARM:1 or 2, Grbl accepts only a reset (Ctrl-X)"
    return [Finding("firmware", BAD, text, todo)]


def _idle_board(found: re.Match[str] | None) -> list[Finding]:
    """Report a MicroPython without a running program. found: the match of _REPL, if any."""
    findings = []
    todo = "put the firmware on it (README, quick start)"
    if found:
        board = Board(found[1], found[2], found[3], int(found[4]), found[5] == "True")
        findings.append(Finding("board", OK, f"{board.name}, MicroPython {board.version}"))
        findings += checkup.micropython(board.name, board.version)
        findings.append(Finding("memory", OK, f"{board.free_bytes // 1024} kB are free"))
        if board.has_program:
            todo = "its main.py has ended or failed: press its reset button, then run this again"
    findings.append(Finding("firmware", BAD, "MicroPython shows its prompt; no Grbl runs", todo))
    return findings


def fault(connection: Connection) -> str:
    """Return the message of our firmware in the fault state, in which it accepts only `?`, `$` and
    a reset; else ""."""
    messages: list[str] = []

    def is_over(line: str) -> bool:
        """Collect the message; return whether it or the answer has come."""
        if checkup.is_fault(line):
            messages.append(line)
        return bool(messages) or is_answer(line)

    connection.write(b"$\n")
    connection.wait_for(is_over, _FAULT_S)
    return "".join(messages[:1])


def pins(connection: Connection) -> str:
    """Return the letters of active inputs, as last reported."""
    found = _PINS.search(connection.status)
    return found[1] if found else ""


def report(connection: Connection) -> None:
    """Wait for a new status report."""
    if not connection.wait_for(lambda line: line.startswith("<"), _ANSWER_S):
        raise SendError("the machine has stopped answering")


def watch_pins(
    connection: Connection, seconds: float, on_change: Callable[[str, bool], None]
) -> dict[str, int]:
    """Call on_change(name, is_active) for every input that changes. Returns how often each became
    active, by its letter in reports."""
    seen: dict[str, int] = {}
    report(connection)
    before = set(pins(connection))
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        report(connection)
        now = set(pins(connection))
        for letter in sorted(now ^ before):  # those that changed
            on_change(PINS.get(letter, letter), letter in now)
            if letter in now:
                seen[letter] = seen.get(letter, 0) + 1
        before = now
        time.sleep(_POLL_S)
    return seen


def move(connection: Connection, axis: int, letter: str, rate: float) -> Finding:
    """Move an axis by 1 mm forth and back, and compare with the position that the firmware
    reports. axis: its index; letter: its name. rate: in mm/min."""
    what = f"move {letter}"
    report(connection)
    if connection.state() != "Idle":
        text = f"not tried: the machine is in {connection.state()}"
        return Finding(what, NOTE, text, way_out(connection.state()))
    if not connection.takes_overrides:
        text = "not tried: Grbl 0.9 has no jogging ($J=)"
        return Finding(what, NOTE, text, "move it with G-code")
    start = connection.place()
    if len(start) <= axis:
        return Finding(what, NOTE, "not tried: status reports have no MPos", "set $10=1")
    for distance, expected in ((_MM, _MM), (-_MM, 0.0)):  # expected: from the start
        answer = connection.ask(f"$J=G91 G21 {letter}{distance:g} F{rate:g}")[-1]
        if answer != "ok":
            return Finding(
                what, BAD, f"refused: {answer}: {meaning(answer)}", _why_refused(answer)
            )
        trouble = _wait_until_idle(connection)
        if trouble:
            return Finding(what, BAD, trouble, "reset it (Ctrl-X), see why, unlock it ($X)")
        moved = connection.place()[axis] - start[axis]
        if abs(moved - expected) > _NEAR_MM:
            text = f"it should have moved {expected:g} mm and reports {moved:.3f}"
            return Finding(what, BAD, text, "report this: steps were lost within the firmware")
    todo = (
        f"did {letter} really move? If not: check enable pin and driver power; if it went the "
        f"other way first: change $3; if not by a millimetre: set ${100 + axis}"
    )
    return Finding(what, OK, "1 mm there and back, by the firmware's step count", todo)


def _wait_until_idle(connection: Connection) -> str:
    """Return the cause of a failure, or "" at the end of the move."""
    alarm = ""
    connection.status = ""  # it is from before the move

    def is_over(line: str) -> bool:
        """Return whether the motion has ended: by an alarm, which is noted, or in Idle."""
        nonlocal alarm
        if line.startswith("ALARM:"):  # after some, Grbl reports no state until it is reset
            alarm = f"{line}: {meaning(line)}"
        return alarm != "" or (line.startswith("<") and connection.state() == "Idle")

    return alarm if connection.wait_for(is_over, _MOVE_S) else "the move did not end"


def _why_refused(answer: str) -> str:
    """Return the next step for a refused jog."""
    if answer == _BEYOND_TRAVEL:
        return "the move is beyond the soft limits: first move away from the end of travel"
    return "see the meaning above; reset it (Ctrl-X), then run this again"
