"""Test the setup guide on a machine that does not match its settings.

A `Mechanic` is a person with a ruler at a simulated machine: really_at() is the real position in
mm, sets_up_motor() and sets_up_homing() do tasks of the guide.

browser.py says what a person, a homer and the page's `grbl` and `job` are.
"""

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import body_machine
import pytest
from bridge import Machine
from browser import Person, settings_file
from mechanic import PER_MM, TRAVEL, Mechanic

pytestmark = [pytest.mark.xdist_group("page"), pytest.mark.thorough]


@pytest.fixture
def mechanic(
    person_at: Callable[..., Person], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Mechanic]:
    """Start a machine whose settings are wrong.

    They state 250 steps/mm instead of PER_MM, and motor Y turns the wrong way.
    """
    person = person_at()
    person.machine.close()
    ruler = tmp_path / "ruler.json"
    body = {
        "settings": str(settings_file(tmp_path, {100: "250", 101: "250", 102: "250"})),
        "steps_per_mm": PER_MM,
        "travel_mm": TRAVEL,
        "swapped": "Y",
        "ruler": str(ruler),
    }
    machine = Machine(Path(), command=[sys.executable, body_machine.__file__, json.dumps(body)])
    machine.waits_for(b"Grbl ")
    person.bridge.machine = machine
    made = Mechanic(person.page, machine, person.bridge, tmp_path)
    made.ruler = ruler
    made.open_served()
    made.sees("Idle")
    made.knows_all()
    yield made
    assert not made.faults
    machine.close()


def test_machine_with_wrong_pitch_and_swapped_motor_is_corrected(mechanic):
    """The guide corrects steps per mm ($100 to $102) and the direction of Y ($3).

    Then it sets up homing and measures the travel.
    """
    for axis in range(3):
        mechanic.sets_up_motor(axis)
    settings = "[100, 101, 102, 3].map((number) => grbl.setting(number))"
    *per_mm, inverted = mechanic.page.evaluate(settings)
    assert per_mm == pytest.approx(PER_MM, rel=0.02)
    assert inverted == 2  # bit 1: Y

    # Switches: a person would push the table against each one; here the task is marked as done.
    mechanic.reads("#guide-tasks [aria-pressed=true]", "Switches")
    mechanic.click("#guide-done")

    mechanic.sets_up_homing()
    half_travel_mm = [mm / 2 for mm in TRAVEL]
    # Real positions count from mid-travel; homing ends 1 mm from the switches at the upper ends.
    assert mechanic.rests() == pytest.approx([mm - 1 for mm in half_travel_mm], abs=0.3)
    mechanic.measures_travel_of_x()
    mechanic.tries_spindle()
    with mechanic.page.expect_download() as saved:
        mechanic.click("#guide-save")
    text = Path(saved.value.path()).read_text()
    assert "$3=2 " in text and "$22=1 " in text


def test_guide_continues_where_it_was_left(mechanic):
    """After a reload the tasks done are still ticked, and the next one is open."""
    mechanic.sets_up_motor(0)  # X, so that Y comes next
    mechanic.reads("#guide-tasks [aria-pressed=true]", "Motor Y")
    mechanic.page.reload()
    mechanic.sees("Idle")
    mechanic.knows_all()
    mechanic.click("#tabs [data-tab=setup]")
    mechanic.reads("#guide-tasks", "Motor X ✓")
    mechanic.reads("#guide-tasks [aria-pressed=true]", "Motor Y")


def test_homing_in_wrong_direction_is_stopped_and_reversed(mechanic):
    """A person stops a homing that goes away from the switch; the machine stands still at once."""
    for axis in range(3):
        mechanic.sets_up_motor(axis)
    mechanic.task("Homing")
    # X is set to home towards its lower end, where it has no switch.
    mechanic.page.select_option("#guide-end-X", "-")
    mechanic.page.fill("#guide-seek", "600")
    mechanic.click("#guide-use")
    mechanic.reads("#guide-says", "$23=1, $22=1")  # homing direction of X reversed, homing on
    start_x_mm = mechanic.really_at()[0]
    mechanic.click("#guide-home")
    mechanic.pauses(1)
    mechanic.waits("document.getElementById('guide-says').textContent.includes('Homing')")
    mechanic.click("text=It goes the wrong way: stop")
    mechanic.reads("#guide-says", "It did not come home")
    mechanic.pauses(0.5)
    stopped_at_mm = mechanic.really_at()
    mechanic.pauses(0.5)
    assert mechanic.really_at() == stopped_at_mm
    assert stopped_at_mm[0] <= start_x_mm  # it went towards the lower end


def test_switches_are_shown_while_pressed(mechanic):
    """The guide shows a pressed switch and ticks it; inverting the inputs is one click."""
    mechanic.task("Switches")
    # The machine's own reports would show the switch released before the page is read.
    mechanic.machine.hears = False
    while "limit X: pressed" not in mechanic.text("#guide-switches"):
        mechanic.machine.say(b"<Idle|MPos:0.000,0.000,0.000|FS:0,0|Pn:XP>\r\n")
        mechanic.pauses(0.1)
    mechanic.machine.hears = True
    mechanic.waits("!document.querySelector('#guide-switches .on')")
    mechanic.reads("#guide-switches", "limit X ✓")
    assert "limit Y ✓" not in mechanic.text("#guide-switches")
    mechanic.click("text=Turn limits round")  # inverts the limit inputs ($5)
    # The open inputs count as pressed now.
    mechanic.waits("grbl.setting(5) === 1 && grbl.pins.includes('Y')")
