"""The page in a real browser, for tests: what a person does at it, and what they read."""

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
# A machine with switches, and a program that takes its time.
HOMING = {22: "1", 25: "2000.000", 24: "500.000", 130: "30.000", 131: "30.000", 132: "30.000"}
FAR = "G21 G90\nG1 X40 F600\nG1 Y20\nG1 X0\nG1 Y0\n"
_STAND_IN = Path(__file__).with_name("serial_stand_in.js")
_LONG_MS = 30_000


def chromium() -> str:
    """Where Chromium is; skips where there is none."""
    named = os.environ.get("UGRBL_CHROMIUM")
    found = named or shutil.which("chromium") or shutil.which("chromium-browser")
    if not found:
        pytest.skip("there is no Chromium; UGRBL_CHROMIUM names one")
    return found


@contextmanager
def browser() -> Iterator[Any]:
    """A browser without a window."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as started:
        opened = started.chromium.launch(
            executable_path=chromium(), headless=True, args=["--no-sandbox"]
        )
        yield opened
        opened.close()


class Visitor:
    """Somebody with the page before them."""

    def __init__(self, page: Any, folder: Path) -> None:
        self.page = page
        self.folder = folder
        self.faults: list[str] = []
        page.on("pageerror", lambda error: self.faults.append(str(error)))

    # What they do

    def click(self, selector: str) -> None:
        self.page.click(selector, timeout=_LONG_MS)

    def press(self, selector: str) -> None:
        """Put a finger down and leave it there."""
        self.page.hover(selector)
        self.page.mouse.down()

    def types(self, line: str) -> None:
        """A line, in the console."""
        self.click("#tabs [data-tab=console]")
        self.page.fill("#line", line)
        self.page.press("#line", "Enter")

    def loads(self, program: str, name: str = "job.nc") -> None:
        path = self.folder / name
        path.write_text(program)
        self.page.set_input_files("#job-file", str(path))
        self.reads("#job-name", name)

    def crash(self) -> None:
        """The tab is gone, in the middle of whatever it did."""
        with self.page.expect_event("crash"), suppress(Exception):  # the crash is one for goto()
            self.page.goto("chrome://crash", timeout=_LONG_MS)

    def hang(self) -> None:
        """The tab does nothing any more for a while."""
        busy = "const end = Date.now() + 2000; while (Date.now() < end);"
        self.page.evaluate(f"void setTimeout(() => {{ {busy} }})")

    def homes(self) -> None:
        """To the end. Its state is no help: Grbl says Home once, when it is nearly over."""
        self.click("#home")
        self.waits("!grbl.linesUnderWay && grbl.state === 'Idle'")
        self.waits("String(grbl.machine) === '-1,-1,-1'")

    def pauses(self, seconds: float) -> None:
        self.page.wait_for_timeout(1000 * seconds)

    # What they see

    def waits(self, condition: str) -> None:
        self.page.wait_for_function(f"() => {condition}", timeout=_LONG_MS)

    def knows_all(self) -> None:
        """Waits until the machine has answered what the page asks at first."""
        self.waits("grbl.settled && grbl.modes.length && grbl.offsets.size && !grbl.linesUnderWay")

    def reads(self, selector: str, text: str) -> None:
        """Waits until it says so."""
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
        """As shown large."""
        return [float(text) for text in self.page.locator("#axes .value").all_text_contents()]

    def rests_at(self, *place: float) -> None:
        """Waits for the machine to be there, at rest."""
        self.waits(f"grbl.state === 'Idle' && String(grbl.work.map(Number)) === '{_js(place)}'")

    def shown_place(self) -> list[float]:
        """Where it stands, when it has come to rest."""
        self.sees("Idle")
        self.pauses(0.5)
        return self.place()

    def log(self) -> str:
        return self.text("#log")


class Person(Visitor):
    """With a simulated machine behind it, on a wire that a test can see and cut."""

    def __init__(self, page: Any, machine: Machine, bridge: Bridge, folder: Path) -> None:
        super().__init__(page, folder)
        self.machine = machine
        self.bridge = bridge

    def open_from_disk(self) -> None:
        address = f'const ADDRESS = "{self.bridge.address}";\n'
        self.page.add_init_script(address + _STAND_IN.read_text())
        self.page.goto(PAGE.as_uri())

    def connect(self, state: str = "Idle") -> None:
        """By USB; until all is known that is shown."""
        self.page.click("#connect")
        self.sees(state)
        self.knows_all()

    def open_served(self, query: str = "") -> None:
        self.page.goto(f"http://{self.bridge.address}/{query}")


def _js(place: tuple[float, ...]) -> str:
    return ",".join(f"{value:g}" for value in place)


def settings_file(folder: Path, changes: dict[int, str]) -> Path:
    """Settings of a quick machine, and what is different."""
    path = folder / "machine.settings"
    values = {**SETTINGS, **changes}
    path.write_text("".join(f"${number}={value}\n" for number, value in values.items()))
    return path


def sent_at_once(machine: Machine) -> bytes:
    """The bytes that act at once, without the questions for the status."""
    return bytes(re.sub(rb"[^\x18!~\x80-\xff]", b"", machine.sent))
