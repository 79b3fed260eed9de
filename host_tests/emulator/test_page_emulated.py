"""Test the set-up of a board in the page, with real MicroPython: a Pico with frozen firmware."""

import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial
from test_deploy_emulated import pico
from test_pico_frozen import frozen_uf2

sys.path.append(str(Path(__file__).parents[1] / "web"))
from bridge import _BINARY, Bridge, Socket
from browser import Person, browser

pytestmark = pytest.mark.xdist_group("frozen")
__all__ = ["frozen_uf2"]

# The emulated chip is 20 to 50 times slower than silicon, so the page's timeouts are made longer.
_MOST_MS = 20 * 60 * 1000
_SLOWER = """
const soon = window.setTimeout;
window.setTimeout = (act, ms, ...more) => soon(act, ms >= 1000 ? 40 * ms : ms, ...more);
"""


class Port:
    """A serial port with the interface of bridge.py's Machine."""

    def __init__(self, path: Path) -> None:
        self._port = serial.Serial(str(path), timeout=0.05)
        self._sinks: "list[Socket]" = []
        self._open = True
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def attach(self, sink: Socket) -> None:
        self._sinks.append(sink)

    def detach(self, sink: Socket) -> None:
        self._sinks.remove(sink)

    def write(self, data: bytes) -> None:
        self._port.write(data)

    def close(self) -> None:
        self._open = False
        self._reader.join()
        self._port.close()

    def _read(self) -> None:
        while self._open:
            if data := self._port.read(512):
                for sink in list(self._sinks):
                    sink.send(_BINARY, data)


@pytest.fixture
def person(frozen_uf2: Path, tmp_path: Path) -> Iterator[Person]:
    """Yield a person at the page in a browser, whose serial port is an emulated Pico's.

    The Pico has frozen firmware, and no file. _SLOWER makes the page's own timeouts longer.
    """
    with pico(frozen_uf2, tmp_path) as path, browser() as opened:
        port: Any = Port(path)
        context = opened.new_context(bypass_csp=True)
        context.set_default_timeout(_MOST_MS)
        page = context.new_page()
        page.add_init_script(_SLOWER)
        yield Person(page, port, Bridge(port), tmp_path)
        port.close()


def wait_until(person: Person, condition: str) -> None:
    """Wait up to 20 minutes until this condition of JavaScript holds in the page."""
    person.page.wait_for_function(f"() => {condition}", timeout=_MOST_MS)


@pytest.mark.timeout(3600)
def test_empty_board_becomes_a_machine_and_its_file_is_read_back(person: Person) -> None:
    """In the end a file with a syntax error is sent: the page shows the line."""
    person.open_from_disk()
    person.click("#connect")
    wait_until(
        person, "$('setup-found').textContent.includes('with ugrbl and without a board file')"
    )
    person.click("#setup-actions button")
    assert person.page.input_value("#board-chip") == "pico"
    person.click("#board-cards b:text-is('rpi_pico')")
    person.page.select_option("#pin-18", label="–")  # no flood
    person.click("#setup-steps [data-step=file]")
    text = person.page.input_value("#board-text")
    assert "FLOOD" not in text
    person.click("#send-board")
    wait_until(person, "$('file-says').textContent.includes('the machine runs')")
    wait_until(person, "grbl.state === 'Idle' && grbl.settled && grbl.offsets.size")
    assert person.page.evaluate("grbl.options") == "V"

    person.click("#setup-steps [data-step=connect]")
    person.click("text=Read its board file")
    wait_until(person, "setupStep === 'file'")
    assert person.page.input_value("#board-text") == text

    # A parenthesis is missing.
    person.page.fill("#board-text", text.replace("STEP = (2, 3, 4)", "STEP = (2, 3, 4"))
    person.click("#send-board")
    wait_until(person, "$('file-says').textContent.includes('SyntaxError')")
    assert "Line " in person.text("#file-says")
