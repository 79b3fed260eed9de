"""Drive the page in a real browser: what a person does, and what the person reads.

A `person` uses the page in a browser that is connected to a simulated machine. A `homer` is one at
a machine with limit switches and 30 mm of travel, locked until it is homed; it then stands at -1
mm on each axis. reads(selector, text) and sees(state) wait until the page shows it; waits(script)
waits until the JavaScript holds in the page. There `grbl` is the page's model of the machine
(grbl.machine and grbl.work: position in mm) and `job` is the program being sent. rests_at() waits
until the machine is idle at that work position in mm; shown_place() waits until it is idle and
returns the displayed position, place() returns it at once; pauses() takes seconds; loads() opens a
program; types() sends a line in the console; evaluate() runs JavaScript and returns its value.
`person.machine` is the machine's end of the wire: lines() and `sent` are what the page has sent,
say() sends bytes to the page, `hears = False` lets the machine receive nothing, report() asks the
machine itself for (state, position, feed), and unplug() cuts the wire. sent_at_once() returns the
realtime bytes sent except `?` (! hold, ~ resume, 0x18 reset, 0x85 jog cancel). `said` are the
bytes that the machine has sent. FAR is a program that runs round a rectangle of 40 by 20 mm for
some seconds.
"""

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from bridge import PAGE, Bridge, Machine

SETTINGS = {
    **dict.fromkeys((110, 111, 112), "3000.000"),
    **dict.fromkeys((120, 121, 122), "500.000"),
}
# Settings of a machine with switches, and a program that runs for some seconds.
HOMING = {22: "1", 25: "2000.000", 24: "500.000", 130: "30.000", 131: "30.000", 132: "30.000"}
FAR = "G21 G90\nG1 X40 F600\nG1 Y20\nG1 X0\nG1 Y0\n"
# Controls that reach beyond the right edge of the window.
CUT_OFF = """[...document.querySelectorAll("button, input, .file")]
    .filter((element) => element.offsetParent && !element.closest("[style*=overflow-x], #tabs"))
    .filter((element) => element.getBoundingClientRect().right > innerWidth + 0.5)
    .map((element) => element.outerHTML)"""
_STAND_IN = Path(__file__).with_name("serial_stand_in.js")
_LONG_MS = 30_000


def chromium() -> str:
    """Return the path of Chromium; skip the test where it is not installed."""
    named = os.environ.get("UGRBL_CHROMIUM")
    found = named or shutil.which("chromium") or shutil.which("chromium-browser")
    if not found:
        pytest.skip("there is no Chromium; UGRBL_CHROMIUM names one")
    return found


@contextmanager
def browser() -> Iterator[Any]:
    """Open a headless browser."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as started:
        opened = started.chromium.launch(
            executable_path=chromium(), headless=True, args=["--no-sandbox"]
        )
        yield opened
        opened.close()


class Visitor:
    """A person at the page."""

    def __init__(self, page: Any, folder: Path) -> None:
        self.page = page
        self.folder = folder
        self.faults: list[str] = []
        page.on("pageerror", lambda error: self.faults.append(str(error)))

    # Actions

    def click(self, selector: str) -> None:
        self.page.click(selector, timeout=_LONG_MS)

    def click_at_once(self, selector: str) -> None:
        """Click an element as soon as it is shown and enabled, in one step: click() may come too
        late where the page is changing."""
        script = """(where) => {
            const element = document.querySelector(where);
            return element?.offsetParent && !element.disabled && (element.click(), true);
        }"""
        self.page.wait_for_function(script, arg=selector, timeout=_LONG_MS)

    def press(self, selector: str) -> None:
        """Press the mouse button on the element and hold it."""
        self.page.hover(selector)
        self.page.mouse.down()

    def types(self, line: str) -> None:
        """Send a line in the console."""
        self.click("#tabs [data-tab=console]")
        self.page.fill("#line", line)
        self.page.press("#line", "Enter")

    def loads(self, program: str, name: str = "job.nc") -> None:
        path = self.folder / name
        path.write_text(program)
        self.page.set_input_files("#job-file", str(path))
        self.reads("#job-name", name)

    def crash(self) -> None:
        """Crash the tab."""
        with self.page.expect_event("crash"), suppress(Exception):  # goto() fails
            self.page.goto("chrome://crash", timeout=_LONG_MS)

    def hang(self) -> None:
        """Block the tab's script for a while."""
        busy = "const end = Date.now() + 2000; while (Date.now() < end);"
        self.page.evaluate(f"void setTimeout(() => {{ {busy} }})")

    def homes(self) -> None:
        """Home and wait for the end.

        The state cannot be used, because Grbl reports Home only once, near the end.
        """
        self.click("#home")
        self.waits("!grbl.linesUnderWay && grbl.state === 'Idle'")
        self.waits("String(grbl.machine) === '-1,-1,-1'")

    def pauses(self, seconds: float) -> None:
        self.page.wait_for_timeout(1000 * seconds)

    # What the page shows

    def waits(self, condition: str) -> None:
        self.page.wait_for_function(f"() => {condition}", timeout=_LONG_MS)

    def knows_all(self) -> None:
        """Wait until the machine has answered the page's first requests."""
        self.waits("grbl.settled && grbl.modes.length && grbl.offsets.size && !grbl.linesUnderWay")

    def reads(self, selector: str, text: str) -> None:
        """Wait until the element contains the words."""
        self.page.wait_for_function(
            "([where, text]) => document.querySelector(where)?.textContent.includes(text)",
            arg=[selector, text],
            timeout=_LONG_MS,
        )

    def sees(self, state: str) -> None:
        self.reads("#state-name", state)

    def text(self, selector: str) -> str:
        return str(self.page.text_content(selector))

    def place(self) -> list[float]:
        """Return the position in the large display."""
        return [float(text) for text in self.page.locator("#axes .value").all_text_contents()]

    def rests_at(self, *place: float) -> None:
        """Wait until the machine is idle at that position."""
        self.waits(f"grbl.state === 'Idle' && String(grbl.work.map(Number)) === '{_js(place)}'")

    def shown_place(self) -> list[float]:
        """Return the position displayed once the machine is idle."""
        self.sees("Idle")
        self.pauses(0.5)
        return self.place()

    def log(self) -> str:
        return self.text("#log")


class Person(Visitor):
    """A visitor with a simulated machine, on a wire that a test can read and cut."""

    def __init__(self, page: Any, machine: Machine, bridge: Bridge, folder: Path) -> None:
        super().__init__(page, folder)
        self.machine = machine
        self.bridge = bridge

    def open_from_disk(self) -> None:
        address = f'const ADDRESS = "{self.bridge.address}";\n'
        self.page.add_init_script(address + _STAND_IN.read_text())
        self.page.goto(PAGE.as_uri())

    def connect(self, state: str = "Idle") -> None:
        """Connect by USB and wait until all displayed values are known."""
        self.page.click("#connect")
        self.sees(state)
        self.knows_all()

    def open_served(self, query: str = "") -> None:
        self.page.goto(f"http://{self.bridge.address}/{query}")


def _js(place: tuple[float, ...]) -> str:
    return ",".join(f"{value:g}" for value in place)


def settings_file(folder: Path, changes: dict[int, str]) -> Path:
    """Write the settings of a fast machine, changed by those given."""
    path = folder / "machine.settings"
    values = {**SETTINGS, **changes}
    path.write_text("".join(f"${number}={value}\n" for number, value in values.items()))
    return path


def sent_at_once(machine: Machine) -> bytes:
    """Return the realtime bytes sent, without status requests."""
    return bytes(re.sub(rb"[^\x18!~\x80-\xff]", b"", machine.sent))
