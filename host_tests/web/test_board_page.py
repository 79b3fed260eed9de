"""Test the page served by the board itself in a real browser: `ugrbl sim --page`.

A `Visitor` is a person at the page in one browser tab.

browser.py says what a person, a homer and the page's `grbl` and `job` are.
"""

import re
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from as_users import as_users
from browser import SETTINGS, Visitor, settings_file

pytestmark = [pytest.mark.xdist_group("board's page"), pytest.mark.thorough]

_PATIENCE_S = 200.0  # the first machine compiles the kernels


class Board:
    """Run a simulated board with its network; stdin and stdout stand for its USB cable."""

    def __init__(self, settings: Path) -> None:
        """Start the simulator; wait for its page's address and its network key."""
        command = [sys.executable, "-m", "ugrbl.cli", "sim", "--board", "sim_page", "--stdio"]
        # 0: any free port.
        command += ["--settings", str(settings), "--network", "0", "--page", "0"]
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=as_users(PYTHONUNBUFFERED="1"),
        )
        self.received = b""
        threading.Thread(target=self._read, daemon=True).start()
        self.address = self.wait_for(rb"its page is at (http\S+)")
        self.key = self.wait_for(rb"\[MSG:Network key: (\w+)\]")

    def _read(self) -> None:
        out: Any = self.process.stdout
        while data := out.read1(4096):
            self.received += data

    def wait_for(self, pattern: bytes) -> str:
        """Wait until the pattern is received over USB; return its group."""
        until = time.monotonic() + _PATIENCE_S
        while not (found := re.search(pattern, self.received)):
            assert time.monotonic() < until, self.received
            time.sleep(0.05)
        return found[1].decode()

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Board]:
    """The board of all tests here; each test finds the state that the one before left."""
    simulated_board = Board(settings_file(tmp_path_factory.mktemp("board"), SETTINGS))
    yield simulated_board
    simulated_board.close()


@pytest.fixture
def visit(opened: Any, board: Board, tmp_path: Path) -> Iterator[Callable[..., Visitor]]:
    """Return a function that opens the board's page in a new tab, with the key not yet entered."""
    contexts: list[Any] = []
    visitors: list[Visitor] = []

    def open_page() -> Visitor:
        """Open the page in a new browser context; wait until it is drawn."""
        contexts.append(opened.new_context(viewport={"width": 1200, "height": 800}))
        visitors.append(Visitor(contexts[-1].new_page(), tmp_path))
        visitors[-1].page.goto(board.address)
        visitors[-1].page.wait_for_selector("#state-name", timeout=30_000)
        return visitors[-1]

    yield open_page
    for context in contexts:
        context.close()
    assert not [fault for visitor in visitors for fault in visitor.faults], "the script failed"


def test_page_served_by_board_reads_at_once_and_controls_with_key(
    board: Board, visit: Callable[..., Visitor]
) -> None:
    """Without the key the page only reads; a wrong key is refused; the right one gives control."""
    person = visit()
    person.sees("Idle")
    person.reads("#link-name", "ugrbl")
    person.reads("#link-words", "This page watches")
    person.reads("#notice-key", "Only reading is open here")
    assert not person.page.is_enabled("#stop")
    person.page.fill("#notice-key input", "22222222")  # a wrong key
    person.page.keyboard.press("Enter")
    person.reads("#log", "[MSG:Wrong network key]")
    person.page.fill("#notice-key input", board.key)
    person.page.keyboard.press("Enter")
    person.waits("!document.getElementById('notice-key')")
    person.waits("grbl.settings.size > 30 && grbl.modes.length")  # the answers to $$ and $G
    person.reads("#link-words", "This page drives")
    person.click("[data-jog='X+']")
    person.waits("grbl.state === 'Idle' && grbl.work[0] > 0")
    assert board.key not in person.page.content()  # the page shows the key nowhere
    assert board.key not in person.page.url


def enter_key(board: Board, person: Visitor) -> Visitor:
    """Enter the key, wait for the machine's answers, and return the same person."""
    person.page.fill("#notice-key input", board.key)
    person.page.keyboard.press("Enter")
    person.knows_all()
    return person


def test_key_typed_in_console_is_not_shown(board: Board, visit: Callable[..., Visitor]) -> None:
    """The log masks the key, and the console's history does not keep the line."""
    person = enter_key(board, visit())
    person.types(f"$NET/KEY={board.key}")
    person.reads("#log", "> $NET/KEY=…")
    assert board.key not in person.page.content()
    person.page.press("#line", "ArrowUp")  # would recall the last line from the history
    assert person.page.input_value("#line") == ""


def test_job_is_run_held_and_ended_from_page(board: Board, visit: Callable[..., Visitor]) -> None:
    """The page sends a program to the board over the network; Hold and Resume work meanwhile."""
    person = enter_key(board, visit())
    person.types("G92 X0 Y0")
    # 8 lines, 15 s; the last one goes to X10 Y1.
    person.loads("G21 G90 F1200\n" + "".join(f"G1 X{i % 2 * 10} Y{i % 3}\n" for i in range(8)))
    person.click("#tabs [data-tab=job]")
    # The board itself estimates no times.
    person.reads("#job-words", "How long it takes is not known")
    person.click("#run")
    person.sees("Run")
    person.click("#hold")
    person.sees("Hold")
    person.click("#resume")
    person.reads("#job-words", "Job done: nothing refused")
    person.rests_at(10, 1, 0)


def test_second_page_watches_and_takes_over_after_first_was_silent(
    board: Board, visit: Callable[..., Visitor]
) -> None:
    """A page takes control only after the other one has sent no line for 5 s.

    STOP works in both.
    """
    one = enter_key(board, visit())
    two = visit()
    two.page.fill("#notice-key input", board.key)
    two.page.keyboard.press("Enter")
    two.reads("#notice-watch", "Somebody else drives this machine")
    two.reads("#notice-watch", "STOP works here, too.")
    assert two.page.is_enabled("#stop") and one.page.is_enabled("#stop")
    one.types("G4 P0.1")  # `one` is active now, so `two` may take over only after 5 s
    two.click("#take")
    two.reads("#notice-trouble", "no line was sent for 5 seconds")
    two.waits("grbl.state === 'Idle'")  # it reads the machine's state all the same
    two.pauses(5.5)  # seconds in which `one` sends no line
    two.click("#take")
    two.waits("grbl.drives && grbl.settled")
    one.reads("#notice-watch", "Somebody else drives this machine")


def test_page_reloaded_while_machine_moves_changes_nothing(
    board: Board, visit: Callable[..., Visitor]
) -> None:
    """A move of 20 mm goes on to its end although the page is reloaded twice."""
    person = enter_key(board, visit())
    person.waits("grbl.work.length")
    start_x_mm = person.place()[0]
    person.types("G91 G1 X20 F300")  # 20 mm at 300 mm/min: four seconds
    person.sees("Run")
    for _ in range(2):
        person.page.reload()
        person.page.wait_for_selector("#state-name", timeout=30_000)
    person.sees("Idle")
    enter_key(board, person)
    person.waits("grbl.work.length")
    assert person.place()[0] == pytest.approx(start_x_mm + 20, abs=0.01)
    person.types("G90")  # the board serves later tests, too


def test_lost_board_is_reported(board: Board, visit: Callable[..., Visitor]) -> None:
    person = enter_key(board, visit())
    board.close()
    person.reads("#notice-lost", "The machine ends the lines it has been given")
