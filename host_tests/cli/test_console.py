"""Test `ugrbl console`: lines and keys at the simulator, and the terminal itself.

A `Person` is a user at the console with a simulator: session.enter() types a line, press() presses
a jog key, poll() processes what has come. `shown` are the lines shown, and wait() polls until a
condition holds. bench.wire(">") are the bytes sent to the machine so far.
"""

import fcntl
import os
import pty
import select
import struct
import sys
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from as_users import as_users
from sim_bench import Bench
from ugrbl.cli import terminal
from ugrbl.cli.session import JOG_CANCEL, Session, explained
from ugrbl.device.connection import Connection

# Real processes in real time: the first ring runs one.
pytestmark = pytest.mark.thorough

_PATIENCE_S = 60.0
SETTINGS = {1: 255, 110: 2000, 111: 2000, 112: 2000, 120: 200, 121: 200, 122: 200}


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    running = Bench(tmp_path, settings=SETTINGS)
    yield running
    running.kill()


class Person:
    """A user at the console, with all output so far."""

    def __init__(self, bench: Bench) -> None:
        """Connect and unlock: the first "ok" in `shown` is the answer to $X."""
        self.connection = Connection(str(bench.port))
        assert self.connection.answers()
        self.shown: list[str] = []
        self.session = Session(self.connection, self.shown.append)
        self.session.enter("$X")
        self.wait(lambda: "ok" in self.shown)

    def wait(self, done: Callable[[], bool]) -> None:
        end_s = time.monotonic() + _PATIENCE_S
        while not done():
            assert time.monotonic() < end_s, self.shown
            self.session.poll()

    def hold_key(self, key: str, seconds: float) -> None:
        """Press a key as often as a keyboard repeats it."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.session.press(key)
            self.session.poll()
            time.sleep(0.03)

    def wait_idle(self) -> list[float]:
        """Wait for two reports of Idle, both requested from now on; return the position in mm."""
        self.connection.status = ""
        self.wait(lambda: self.connection.state() == "Idle")
        self.connection.status = ""
        self.wait(lambda: self.connection.state() == "Idle")
        return self.connection.place()


@pytest.fixture
def person(bench: Bench) -> Iterator[Person]:
    somebody = Person(bench)
    yield somebody
    somebody.connection.close()


@pytest.mark.sampled(1)
def test_settings_and_errors_are_shown_with_their_meaning(person: Person) -> None:
    """The console adds the meaning to settings and errors."""
    person.session.enter("$$")
    person.wait(lambda: any(line.startswith("$132=") for line in person.shown))
    (x_rate_line,) = [line for line in person.shown if line.startswith("$110=")]
    assert "Maximum rate X, mm/min" in x_rate_line
    person.session.enter("G64")
    person.wait(lambda: any(line.startswith("error:20: ") for line in person.shown))


def test_many_lines_at_once_do_not_overfill_the_buffer(bench: Bench, person: Person) -> None:
    for _ in range(60):
        person.session.enter("G4 P0.001 (some words that make it longer)")
    person.wait(lambda: person.shown.count("ok") == 61)
    assert not any(line.startswith("error") for line in person.shown)


def test_realtime_bytes_are_not_sent_within_lines(bench: Bench, person: Person) -> None:
    """Ö has two bytes above 0x7F, which Grbl would take as realtime commands.

    The line is not sent, or without Ö where it stands in a comment.
    """
    person.session.enter("G0 X1 Ö")
    assert "not sent" in person.shown[-1]
    person.session.enter("G4 P0 (Ö)")
    person.wait(lambda: person.shown.count("ok") == 2)  # of $X at the start, and of G4
    assert bench.wire(">").isascii()


def test_key_press_jogs_one_step_and_keeps_the_modes(person: Person) -> None:
    """Arrows jog X and Y, Page Up Z. The modes of the program, here G90, stay as they were."""
    # ] makes the step ten times as large: 10 mm for Z.
    for key in ("right", "up", "]", "pageup"):
        person.session.press(key)
        person.wait_idle()
    assert person.wait_idle() == [1.0, 1.0, 10.0]
    person.session.enter("$G")
    person.wait(lambda: any("G90" in line for line in person.shown))


def test_held_key_jogs_until_it_is_released(bench: Bench, person: Person) -> None:
    """A key that repeats for 1 s jogs as long; then a jog cancel is sent."""
    person.hold_key("right", 1.0)
    # The console sees that the key repeats no more.
    person.wait(lambda: JOG_CANCEL in bench.wire(">"))
    x_mm = person.wait_idle()[0]
    assert 3 < x_mm < 12  # a step, and then 500 mm/min while the key was down
    assert person.wait_idle()[0] == x_mm
    assert person.shown.count("ok") == 1  # to $X: parts of a jog are not shown


def test_leaving_the_console_ends_a_jog(bench: Bench, person: Person) -> None:
    person.hold_key("left", 0.5)
    person.session.leave()
    person.connection.wait_for(lambda line: line.startswith("<Idle"), 5)
    assert bench.wire(">").rstrip(b"?").endswith(JOG_CANCEL)


def test_keys_set_zero_hold_resume_and_change_the_feed(bench: Bench, person: Person) -> None:
    """Each key acts at once, and the console shows what the machine reports."""
    person.session.press("right")
    person.wait_idle()
    person.session.press("x")  # sets X to zero here, at 1 mm
    # Of $X at the start, and of the line that "x" sends.
    person.wait(lambda: person.shown.count("ok") == 2)
    person.wait(lambda: "|WCO:1.000" in person.connection.status)
    assert "X0.000 Y0.000" in person.session.status()
    person.session.enter("G1 X3 F200")
    person.wait(lambda: person.connection.state() == "Run")
    person.session.press("+")  # feed +10 %
    person.wait(lambda: "overrides 110,100,100" in person.session.status())
    person.session.press(" ")  # feed hold
    person.wait(lambda: person.connection.state() == "Hold:0")
    assert "Hold:0: resume (~) or reset (Ctrl-X) it" in person.shown
    person.session.press("~")
    assert person.wait_idle()[0] == 4.0  # machine position: 1 mm by the jog, 3 mm by G1


def test_reset_discards_waiting_lines(person: Person) -> None:
    """The first line waits 5 s, so the 40 moves after it are not executed before the reset."""
    person.session.enter("G4 P5")
    for _ in range(40):
        person.session.enter("G0 X1")
    person.session.poll()
    person.session.reset()
    person.wait(lambda: any(line.startswith("Grbl 1.1h") for line in person.shown))
    assert person.wait_idle()[0] == 0.0


def test_console_can_reset_after_a_limit_switch(bench: Bench, person: Person) -> None:
    """After ALARM:1 the machine obeys only a reset, so $X has no effect before it."""
    person.session.enter("$21=1")  # hard limits on
    person.session.enter("G1 X30 F2000")  # the bench's switch is at 20 mm
    person.wait(lambda: any(line.startswith("ALARM:1: ") for line in person.shown))
    person.session.enter("$X")
    time.sleep(1.0)
    person.session.poll()
    assert "[MSG:Caution: Unlocked]" not in person.shown
    person.session.reset()
    person.wait(lambda: any(line.startswith("Grbl 1.1h") for line in person.shown))
    person.session.enter("$21=0")
    person.session.enter("$X")
    person.wait(lambda: "[MSG:Caution: Unlocked]" in person.shown)


def test_grbl_0_9_has_no_jogging_and_no_overrides(tmp_path: Path) -> None:
    """At a Grbl 0.9 these keys send nothing; the console says why."""
    bench_09 = Bench(tmp_path, "--speed", "max", "--board", "sim_09j")
    person = Person(bench_09)
    for key in ("right", "+"):
        person.session.press(key)
    person.wait_idle()
    person.connection.close()
    assert person.shown[-2:] == [
        "Grbl 0.9 has no jogging: move it with G-code",
        "Grbl 0.9 has no overrides",
    ]
    assert bench_09.wire(">").isascii() and b"$J" not in bench_09.wire(">")
    bench_09.kill()


@pytest.mark.sampled(1)
@pytest.mark.parametrize("columns", [80, 40, 200])
def test_all_keys_are_listed_within_the_terminals_width(columns: int) -> None:
    lines = terminal.wrapped(terminal._KEY_HELP, columns)
    assert max(map(len, lines)) <= columns
    assert "   ".join(lines) == terminal._KEY_HELP


@pytest.mark.sampled(1)
def test_unwritable_history_is_ignored(tmp_path: Path) -> None:
    terminal._History(str(tmp_path / "nowhere" / "history")).store_string("$X")


def test_meanings_are_shown() -> None:
    assert explained("$110=500.000").startswith("$110=500.000 ")
    assert explained("[GC:G0 G54]") == "[GC:G0 G54]"
    assert explained("ALARM:1").startswith("ALARM:1: ")
    assert "custom.py" in explained("error:3", "T2 M6") and "$" in explained("error:3", "$Y")


def test_terminal_shows_state_lines_and_jogs(bench: Bench, tmp_path: Path) -> None:
    """The command `ugrbl console` itself runs in a pseudo-terminal of 24 by 80 characters."""
    command = [sys.executable, "-m", "ugrbl.cli", "console", "--port", str(bench.port)]
    environment = as_users(HOME=str(tmp_path), TERM="xterm")
    pid, master = pty.fork()
    if pid == 0:
        fcntl.ioctl(0, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
        os.execve(sys.executable, command, environment)
    text = b""

    def wait_until(holds: "Callable[[], bool]") -> None:
        """Read the screen's bytes into `text` until the condition holds."""
        nonlocal text
        end_s = time.monotonic() + _PATIENCE_S
        while not holds():
            assert time.monotonic() < end_s, text
            if select.select([master], [], [], 0.1)[0]:
                text += os.read(master, 4096)
                if b"\x1b[6n" in text:  # the terminal is asked for the cursor's position
                    text = text.replace(b"\x1b[6n", b"")
                    os.write(master, b"\x1b[1;1R")

    def wait(what: bytes) -> None:
        nonlocal text
        wait_until(lambda: what in text)
        text = text[text.index(what) + len(what) :]

    wait(b"Tab: jog with keys")
    # Two lines; then Tab for the keys, the right arrow, Tab and Ctrl-D to leave.
    os.write(master, b"$X\r$G\r")
    wait(b"[GC:G0 G54")
    os.write(master, b"\t")
    wait(b"step 1 mm, 500 mm/min")
    wait(b"* / = spindle")
    os.write(master, b"\x1b[C")
    # When a position changes on the screen, only the changed digits are sent.
    wait_until(lambda: b"$J=G91 G21 X1.000 F500" in bench.wire(">"))
    os.write(master, b"\t\x04")
    end_s = time.monotonic() + _PATIENCE_S
    ended_pid = 0
    # Its last output must be read, else it cannot end.
    while not ended_pid and time.monotonic() < end_s:
        if select.select([master], [], [], 0.1)[0]:
            try:
                os.read(master, 4096)
            except OSError:  # the other end is closed
                time.sleep(0.05)
        ended_pid, status = os.waitpid(pid, os.WNOHANG)
    os.close(master)
    assert ended_pid and os.waitstatus_to_exitcode(status) == 0
    assert b"$J=G91 G21 X1.000 F500" in bench.wire(">")
    assert "$G" in (tmp_path / ".ugrbl_history").read_text()  # lines typed are stored
