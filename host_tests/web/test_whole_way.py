"""Test the whole way in the page: from an empty board with own pins to a job that is finished
after a tool change and a power cut, on a simulated machine that differs from its settings.

UGRBL_PICTURES saves pictures of its steps for docs/web.md.

A `Mechanic` is a person with a ruler at the machine: really_at() is the real position in mm,
sets_up_motor() and the like do tasks of the setup guide.

browser.py says what a person, a homer and the page's `grbl` and `job` are.
"""

import json
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import body_machine
import pytest
from bridge import Machine
from browser import Person, settings_file
from mechanic import PER_MM, TRAVEL, Mechanic
from prompt_stand_in import PromptBoard
from ugrbl.docs import pictures

pytestmark = [pytest.mark.xdist_group("whole way"), pytest.mark.thorough, pytest.mark.timeout(600)]

_PINS = {
    "step_X": 2,
    "step_Y": 3,
    "step_Z": 4,
    "dir_X": 5,
    "dir_Y": 6,
    "dir_Z": 7,
    "limit_X": 9,
    "limit_Y": 10,
    "limit_Z": 11,
    "probe": 12,
    "tool_PWM": 16,
}
# The work is in the middle of the table, and tilted; its top is 4 mm below mid-travel.
_SURFACE = [-4.0, 0.02, -0.03]
_JOB = """G21 G90
G0 Z4
M3 S1000
G0 X-6 Y-5
G1 Z-0.2 F600
G1 X6
G1 Y5
G0 Z4
T2 M6
M3 S800
G0 X-6
G1 Z-0.4 F600
G1 X6 F240
G1 Y0
G0 Z4
M2
"""
_END = (6, 0)
_MIDDLE = {"x": 368, "y": 80, "width": 584, "height": 600}  # of the page, in pixels


@pytest.fixture
def mechanic(person_at: Callable[..., Person], tmp_path: Path) -> Iterator[Mechanic]:
    """A person at an empty board.

    Its machine has other steps per mm than its settings (PER_MM instead of 250), a motor Y that
    turns the wrong way, and a tilted work.
    """
    flash, ruler = tmp_path / "flash", tmp_path / "ruler.json"
    flash.mkdir()
    body: "dict[str, Any]" = {
        "board": str(flash / "board.py"),
        "settings": str(settings_file(tmp_path, {100: "250", 101: "250", 102: "250"})),
        "steps_per_mm": PER_MM,
        "travel_mm": TRAVEL,
        "swapped": "Y",
        "ruler": str(ruler),
        "surface": _SURFACE,
    }
    command = [sys.executable, body_machine.__file__, json.dumps(body)]
    person = person_at()
    person.machine.close()
    board = PromptBoard(flash, lambda: Machine(Path(), command=command))
    person.bridge.machine = board  # type: ignore[assignment]
    made = Mechanic(person.page, person.machine, person.bridge, tmp_path)
    made.ruler = ruler
    yield made
    assert not made.faults
    board.close()


def board_of(mechanic: Mechanic) -> PromptBoard:
    return mechanic.bridge.machine  # type: ignore[return-value]


def real_steps(mechanic: Mechanic) -> "list[int]":
    """Return the steps that the motors have really made from mid-travel."""
    return [round(mm * per) for mm, per in zip(mechanic.really_at(), PER_MM, strict=True)]


def reported_steps(mechanic: Mechanic) -> "list[int]":
    """Return the reported machine position in steps of the settings that the guide has found."""
    mm = mechanic.page.evaluate("grbl.machine.map(Number)")
    per = mechanic.page.evaluate("[100, 101, 102].map((number) => grbl.setting(number))")
    return [round(a * b) for a, b in zip(mm, per, strict=True)]


def take_picture(mechanic: Mechanic, name: str, clip: "dict[str, int] | None" = None) -> None:
    """Save a picture of the page, or of the part clip, for docs/, if asked."""
    if os.environ.get("UGRBL_PICTURES"):
        screenshot, small = mechanic.folder / name, mechanic.folder / f"small-{name}"
        mechanic.page.screenshot(path=screenshot, clip=clip)
        pictures.shrink(screenshot, small, greys=True)
        pictures.renew(small, pictures.FOLDER / name)


def set_up_board(mechanic: Mechanic) -> None:
    """Make a board file with the pins of _PINS, send it, and wait until the machine runs."""
    mechanic.click("#connect")
    mechanic.reads("#setup-found", "without a board file")
    mechanic.click("#setup-steps [data-step=board]")
    mechanic.click("text=My own")
    for words, pin in _PINS.items():
        mechanic.page.select_option(f"#pin-{pin}", label=words.replace("_", " "))
    mechanic.reads("#pins-says", "No rule is broken")
    mechanic.click("#setup-steps [data-step=file]")
    mechanic.click("#send-board")
    mechanic.reads("#file-says", "the machine runs")
    mechanic.sees("Idle")
    mechanic.knows_all()


def set_up_machine(mechanic: Mechanic) -> None:
    """Do the tasks of the setup guide: motors, homing, travel, and spindle."""
    for axis in range(3):
        mechanic.sets_up_motor(axis)
        if axis == 1:
            mechanic.task("Motor Z")  # comes next: a picture with two motors done
            take_picture(mechanic, "page_guide.png")
    mechanic.click("#guide-done")  # of the switches, with nothing to set
    mechanic.sets_up_homing()
    mechanic.measures_travel_of_x()
    mechanic.tries_spindle()


def set_zero_by_probe(mechanic: Mechanic) -> None:
    """Go over the middle of the work, set X and Y there, and Z by a plate of 0 mm."""
    middle = [-mm / 2 for mm in TRAVEL]
    mechanic.page.evaluate(f"grbl.send('G53 G0 X{middle[0]} Y{middle[1]} Z{middle[2]}')")
    mechanic.sees("Idle")
    mechanic.page.evaluate("grbl.send('G10 L20 P1 X0 Y0')")
    choose_probe(mechanic, "Plate", plate=0, far=10, feed=400, up=3)
    mechanic.click("#probe-run")
    mechanic.reads("#probe-says", "Done")


def choose_probe(mechanic: Mechanic, kind: str, **fields: float) -> None:
    """Select a kind of probing and fill in its fields; lengths are in mm."""
    mechanic.click("#tabs [data-tab=offsets]")
    mechanic.click(f"#probe-kinds button:text-is('{kind}')")
    for name, value in fields.items():
        mechanic.page.fill(f"#probe-{name}", f"{value:g}")


def map_heights(mechanic: Mechanic) -> None:
    """Probe 3 times 3 heights of the work, and adapt the program to them."""
    choose_probe(mechanic, "Height map", columns=3, rows=3, far=8, feed=600, up=2)
    mechanic.click("#probe-run")
    mechanic.reads("#probe-says", "9 points")
    take_picture(mechanic, "page_height_map.png")
    mechanic.click("#height-use")
    mechanic.reads("#job-name", "job_level.nc")


def home(mechanic: Mechanic) -> None:
    """Home the machine and wait until it stands near its switches."""
    mechanic.click("#tabs [data-tab=job]")
    mechanic.click("#home")
    mechanic.waits("!grbl.linesUnderWay && grbl.state === 'Idle' && grbl.machine[0] > -2")


def test_empty_board_ends_as_machine_that_finishes_job_after_tool_change_and_power_cut(mechanic):
    """All that a user does, from the board file to a job.

    The power is cut during the job; at its end no step is lost.
    """
    mechanic.open_from_disk()
    set_up_board(mechanic)
    set_up_machine(mechanic)
    home(mechanic)
    real_home_steps, reported_home_steps = real_steps(mechanic), reported_steps(mechanic)
    set_zero_by_probe(mechanic)
    mechanic.loads(_JOB)
    map_heights(mechanic)
    mechanic.click("#tabs [data-tab=job]")
    mechanic.click("#run")
    mechanic.reads("#tool-title", "Tool change: tool 2")
    mechanic.waits("grbl.modes.includes('M5')")
    mechanic.click("#tool-go")
    # In the line with F240, in the middle of a cut.
    mechanic.waits("grbl.state === 'Run' && grbl.feed > 200 && grbl.feed < 250")
    mechanic.pauses(1)

    board_of(mechanic).cut_power()
    mechanic.reads("#notices", "The connection is lost")
    board_of(mechanic).power_up()
    mechanic.click("text=Connect by USB")
    mechanic.sees("Alarm")
    mechanic.knows_all()
    home(mechanic)
    assert real_steps(mechanic) == real_home_steps, "the switches have not moved"
    mechanic.click("#run")
    # The page remembers the line that was being executed, and proposes it.
    mechanic.reads("#dialog", "Begin with line")
    mechanic.reads("#dialog", "down to Z-0.")
    take_picture(mechanic, "page_resume.png", _MIDDLE)
    mechanic.click("#dialog-yes")
    mechanic.reads("#job-words", "Job done: nothing refused")
    mechanic.sees("Idle")
    assert mechanic.place()[:2] == pytest.approx(_END, abs=0.01)
    real_moved_steps = [
        now - then for now, then in zip(real_steps(mechanic), real_home_steps, strict=True)
    ]
    reported_moved_steps = [
        now - then for now, then in zip(reported_steps(mechanic), reported_home_steps, strict=True)
    ]
    # The motors have made exactly the steps that the machine reports: none was lost.
    assert real_moved_steps == reported_moved_steps
