"""A person with a ruler at a real machine, who follows the page's setup guide."""

import json
import time
from pathlib import Path

import pytest
from browser import Person

PER_MM = [80.0, 80.0, 400.0]
TRAVEL = [60.0, 50.0, 40.0]
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

    def sets_up_homing(self) -> None:
        """Home towards the far, right and upper ends."""
        self.task("Homing")
        assert self.page.get_attribute("#guide-home", "disabled") is not None
        self.page.fill("#guide-seek", "1500")
        self.click("#guide-use")
        self.reads("#guide-says", "$22=1")
        self.page.evaluate("grbl.send('$25=3000')")
        self.click("#guide-home")
        self.reads("#guide-says", "It is home")
        self.click("#guide-done")

    def measures_travel_of_x(self) -> None:
        """Find the other end of X, as the ruler shows it, and turn the limits on."""
        self.task("Travel")
        self.page.evaluate("grbl.send('G91 G0 X-56')")
        self.waits("grbl.state === 'Idle' && grbl.machine[0] < -56")
        self.click("#guide-here-X")
        self.reads("#guide-says", "travel of X")
        assert self.page.evaluate("grbl.setting(130)") == pytest.approx(58, abs=0.2)
        self.click("#guide-arm")
        self.reads("#guide-says", "Soft limits")
        self.page.evaluate("grbl.send('G90')")
        self.click("#guide-done")

    def tries_spindle(self) -> None:
        """Hold the button; the spindle runs as long."""
        self.task("Tool")
        self.press("#guide-run")
        self.waits("grbl.accessories.includes('S')")
        self.page.mouse.up()
        self.waits("!grbl.accessories.includes('S') && grbl.modes.includes('M5')")
        self.click("#guide-done")
