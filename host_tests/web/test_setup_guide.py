"""Test the setup guide on a machine that does not match its settings."""

import json
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import body_machine
import pytest
from bridge import Machine
from browser import Person, settings_file

pytestmark = [pytest.mark.xdist_group("page"), pytest.mark.thorough]

_PER_MM = [80.0, 80.0, 400.0]
_TRAVEL = [60.0, 50.0, 40.0]
_RULER_MM = 0.1  # resolution of a reading by eye


class Mechanic(Person):
    """A person at a real machine who sees its motion and has a ruler."""

    ruler: Path

    def really_at(self) -> "list[float]":
        since = time.time()
        while (read := json.loads(self.ruler.read_text()))["time"] < since:
            self.pauses(0.02)
        place: "list[float]" = read["mm"]
        return place

    def rests(self) -> "list[float]":
        """Return the real position once the machine stands still, rounded to 0.1 mm."""
        before: "list[float]" = []
        while before != (now := self.really_at()):
            before = now
            self.sees("Idle")
            self.pauses(0.6)
        return [round(mm / _RULER_MM) * _RULER_MM for mm in now]

    def task(self, name: str) -> None:
        if self.page.get_attribute("#tabs [data-tab=setup]", "aria-selected") != "true":
            self.click("#tabs [data-tab=setup]")
        self.click("#setup-steps [data-step=guide]")
        self.click(f"#guide-tasks button:has-text('{name}')")

    def moves(self, axis: int, mm: float) -> float:
        """Move an axis with the guide; return the real distance moved in mm."""
        before = self.rests()[axis]
        self.page.fill("#guide-mm", f"{abs(mm):g}")
        self.click("#guide-plus" if mm > 0 else "#guide-minus")
        self.reads("#guide-says", "asked to go")
        while abs(self.really_at()[axis] - before) < _RULER_MM:
            self.pauses(0.1)
        return self.rests()[axis] - before

    def sets_up_motor(self, axis: int) -> None:
        """Do the guide's task for one motor: direction first, then steps per mm with a ruler."""
        self.task(f"Motor {'XYZ'[axis]}")
        if self.moves(axis, 1) < 0:
            self.click("#guide-wrong")
            self.reads("#guide-says", "turns the other way now")
            assert self.moves(axis, 1) > 0
        for way in (2, -10):
            went = self.moves(axis, way)
            self.page.fill("#guide-real", f"{abs(went):.1f}")
            self.click("#guide-set")
            self.reads("#guide-says", "Move it once more")
        assert abs(self.moves(axis, 10) - 10) < 2 * _RULER_MM
        self.click("#guide-done")


@pytest.fixture
def mechanic(
    person_at: Callable[..., Person], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Mechanic]:
    """A machine whose belts have another pitch than its settings state, with one motor swapped."""
    person = person_at()
    person.machine.close()
    ruler = tmp_path / "ruler.json"
    body = {
        "settings": str(settings_file(tmp_path, {100: "250", 101: "250", 102: "250"})),
        "steps_per_mm": _PER_MM,
        "travel_mm": _TRAVEL,
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
    for axis in range(3):
        mechanic.sets_up_motor(axis)
    settings = "[100, 101, 102, 3].map((number) => grbl.setting(number))"
    *per_mm, inverted = mechanic.page.evaluate(settings)
    assert per_mm == pytest.approx(_PER_MM, rel=0.02)
    assert inverted == 2  # Y

    # Switches: a person would push the table against each one; here the task is marked as done.
    mechanic.reads("#guide-tasks [aria-pressed=true]", "Switches")
    mechanic.click("#guide-done")

    # Homing, towards the far, right and upper ends
    assert mechanic.page.get_attribute("#guide-home", "disabled") is not None
    mechanic.page.fill("#guide-seek", "1500")
    mechanic.click("#guide-use")
    mechanic.reads("#guide-says", "$22=1")
    mechanic.page.evaluate("grbl.send('$25=3000')")
    mechanic.click("#guide-home")
    mechanic.reads("#guide-says", "It is home")
    half = [mm / 2 for mm in _TRAVEL]
    assert mechanic.rests() == pytest.approx([mm - 1 for mm in half], abs=0.3)
    mechanic.click("#guide-done")

    # Travel: to the other end of X, which the ruler shows
    mechanic.page.evaluate("grbl.send('G91 G0 X-56')")
    mechanic.waits("grbl.state === 'Idle' && grbl.machine[0] < -56")
    mechanic.click("#guide-here-X")
    mechanic.reads("#guide-says", "travel of X")
    assert mechanic.page.evaluate("grbl.setting(130)") == pytest.approx(58, abs=0.2)
    mechanic.click("#guide-arm")
    mechanic.reads("#guide-says", "Soft limits")
    mechanic.click("#guide-done")

    # The spindle runs while a button is held
    mechanic.press("#guide-run")
    mechanic.waits("grbl.accessories.includes('S')")
    mechanic.page.mouse.up()
    mechanic.waits("!grbl.accessories.includes('S') && grbl.modes.includes('M5')")
    mechanic.click("#guide-done")
    with mechanic.page.expect_download() as saved:
        mechanic.click("#guide-save")
    text = Path(saved.value.path()).read_text()
    assert "$3=2 " in text and "$22=1 " in text


def test_guide_continues_where_it_was_left(mechanic):
    mechanic.sets_up_motor(0)
    mechanic.reads("#guide-tasks [aria-pressed=true]", "Motor Y")
    mechanic.page.reload()
    mechanic.sees("Idle")
    mechanic.knows_all()
    mechanic.click("#tabs [data-tab=setup]")
    mechanic.reads("#guide-tasks", "Motor X ✓")
    mechanic.reads("#guide-tasks [aria-pressed=true]", "Motor Y")


def test_homing_in_wrong_direction_is_stopped_and_reversed(mechanic):
    for axis in range(3):
        mechanic.sets_up_motor(axis)
    mechanic.task("Homing")
    mechanic.page.select_option("#guide-end-X", "-")
    mechanic.page.fill("#guide-seek", "600")
    mechanic.click("#guide-use")
    mechanic.reads("#guide-says", "$23=1, $22=1")
    before = mechanic.really_at()[0]
    mechanic.click("#guide-home")
    mechanic.pauses(1)
    mechanic.waits("document.getElementById('guide-says').textContent.includes('Homing')")
    mechanic.click("text=It goes the wrong way: stop")
    mechanic.reads("#guide-says", "It did not come home")
    mechanic.pauses(0.5)
    stopped = mechanic.really_at()
    mechanic.pauses(0.5)
    assert mechanic.really_at() == stopped
    assert stopped[0] <= before


def test_switches_are_shown_while_pressed(mechanic):
    mechanic.task("Switches")
    mechanic.machine.say(b"<Idle|MPos:0.000,0.000,0.000|FS:0,0|Pn:XP>\r\n")
    mechanic.reads("#guide-switches .on", "limit X: pressed")
    mechanic.waits("!document.querySelector('#guide-switches .on')")
    mechanic.reads("#guide-switches", "limit X ✓")
    assert "limit Y ✓" not in mechanic.text("#guide-switches")
    mechanic.click("text=Turn limits round")
    mechanic.waits("grbl.setting(5) === 1 && grbl.pins.includes('Y')")
