"""Test probing and height maps in the page, on a machine with a tilted table.

A `prober` is a person in the page at a simulated machine whose table carries solids that the probe
touches. _HEIGHT is the top of the work at X0 Y0, -4 mm, and surface(x, y) that at another place.
The machine starts in mid-travel, where all positions are 0.

browser.py says what a person, a homer and the page's `grbl` and `job` are.
"""

import json
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import body_machine
import pytest
from bridge import Machine
from browser import Person, settings_file

pytestmark = [pytest.mark.xdist_group("page"), pytest.mark.thorough]

_PER_MM = [80.0, 80.0, 400.0]
# The top of the work is 4 mm below the middle of the travel, and tilted.
_HEIGHT, _ALONG_X, _ALONG_Y = -4.0, 0.02, -0.03
_SURFACE = {"surface": [_HEIGHT, _ALONG_X, _ALONG_Y]}
_STEP_MM = 1 / 80
_CUTS = "G1 Z-0.5 F600\nG1 X12\nG3 X12 Y9 I0 J4\nG1 X2\nG4 P0.1\nG1 Y1 M5\n"
_JOB = f"G21 G90\nM3 S1000\nG0 Z5\nG0 X2 Y1\n{_CUTS}G0 Z5\nM2\n"


@pytest.fixture
def prober_at(person_at: Callable[..., Person], tmp_path: Path) -> Iterator[Callable[..., Person]]:
    """Return a function that opens the page at a machine with solids on its table."""
    machines: "list[Machine]" = []

    def make(solids: "dict[str, list[float]]") -> Person:
        """Start the machine and connect the page to it.

        solids: "surface" (height in mm, slopes along X and Y), "block" (x and y of its corner) or
        "hole" (x and y of its centre, radius).
        """
        person = person_at()
        person.machine.close()
        settings = {100 + axis: f"{steps:g}" for axis, steps in enumerate(_PER_MM)}
        body = {
            "settings": str(settings_file(tmp_path, settings)),
            "steps_per_mm": _PER_MM,
            "travel_mm": [100.0, 100.0, 60.0],
            "swapped": "",  # no motor turns the wrong way
            "ruler": str(tmp_path / "ruler.json"),  # a file for the real position
            **solids,
        }
        command = [sys.executable, body_machine.__file__, json.dumps(body)]
        machines.append(Machine(Path(), command=command))
        machines[-1].waits_for(b"Grbl ")
        person.machine = person.bridge.machine = machines[-1]
        person.open_from_disk()
        person.connect()
        return person

    yield make
    for machine in machines:
        machine.close()


@pytest.fixture
def prober(prober_at: Callable[..., Person]) -> Person:
    """A person at a machine with the probe 4 mm above the work."""
    return prober_at(_SURFACE)


def choose(person: Person, kind: str) -> None:
    person.click("#tabs [data-tab=offsets]")
    # Not click(): the tab is still being filled, and its buttons move.
    person.page.locator(f"#probe-kinds button:text-is('{kind}')").dispatch_event("click")


def test_plate_sets_z_and_keeps_modes(prober):
    """A touch plate of 1.5 mm sets Z: its top is at Z1.5.

    The lines shown before are those that were sent.
    """
    choose(prober, "Plate")
    prober.page.fill("#probe-plate", "1.5")
    prober.page.fill("#probe-feed", "400")
    prober.reads("#probe-lines", "G10 L20 P0 Z1.5")
    prober.click("#probe-run")
    prober.reads("#probe-says", "Done")
    prober.waits("grbl.modes.includes('G90')")
    prober.waits("!grbl.offsets.get('G54').endsWith(',0.000')")
    offset_mm = prober.page.evaluate("Number(grbl.offsets.get('G54').split(',')[2])")
    # Contact, at -4 mm, is Z1.5 now: work zero is 1.5 mm below.
    assert offset_mm == pytest.approx(_HEIGHT - 1.5, abs=2 / 400)  # two steps
    # (where it touched) stands for a number that is known only after the contact.
    shown_lines = [re.escape(line) for line in prober.text("#probe-lines").split("\n")]
    pattern = "\n".join(shown_lines).replace(re.escape("(where it touched)"), r"-\d(\.\d+)?")
    assert re.search(pattern, "\n".join(prober.machine.lines()))


def work_zero(person: Person) -> "list[float]":
    """Return the work zero in machine coordinates, once the page knows it."""
    person.click("#read-offsets")
    person.waits("!grbl.linesUnderWay")
    text: str = person.page.evaluate("grbl.offsets.get('G54')")
    return [float(mm) for mm in text.split(",")]


@pytest.mark.parametrize(("side", "axis", "edge_mm"), [("left", 0, 8), ("front", 1, 6)])
def test_edge_accounts_for_tool_and_plate(prober_at, side, axis, edge_mm):
    """Zero is set at the edge itself: half the tool and the plate are added to the contact."""
    # The block's left front corner: one side is at `edge_mm`, the other one 20 mm away.
    prober = prober_at({"block": [8, -20] if axis == 0 else [-20, 6]})
    choose(prober, "Edge")
    prober.page.select_option("#probe-side", side)
    for name, value in (("tool", "4"), ("plate", "1"), ("feed", "600")):
        prober.page.fill(f"#probe-{name}", value)
    prober.click("#probe-run")
    prober.reads("#probe-says", "Done")
    # Contact is at `edge_mm`. The page adds half the tool's diameter, 2, and the plate, 1.
    assert work_zero(prober)[axis] == pytest.approx(edge_mm + 2 + 1, abs=2 * _STEP_MM)


def test_corner_is_found_from_two_sides(prober_at):
    """Both sides of the corner are probed; X and Y are zero at the corner."""
    prober = prober_at({"block": [5, -4]})  # mm, its left front corner
    choose(prober, "Corner")
    for name, value in (("tool", "2"), ("plate", "0"), ("far", "12"), ("feed", "900")):
        prober.page.fill(f"#probe-{name}", value)
    prober.click("#probe-run")
    prober.reads("#probe-says", "Done")
    x, y, _ = work_zero(prober)
    # The probe has no width here, and the page was given a tool diameter of 2 mm.
    assert (x, y) == pytest.approx((5 + 1, -4 + 1), abs=2 * _STEP_MM)


def test_centre_of_hole_is_found_and_approached(prober_at):
    """Four points of a hole are probed; the tool then stands at its centre, the new work zero."""
    prober = prober_at({"hole": [3, -2, 8]})  # mm: centre and radius
    choose(prober, "Hole")
    prober.page.fill("#probe-feed", "900")
    prober.click("#probe-run")
    prober.reads("#probe-says", "Done")
    assert work_zero(prober)[:2] == pytest.approx([3, -2], abs=2 * _STEP_MM)
    prober.rests_at(0, 0, 0)


def test_probe_without_contact_says_what_to_do(prober):
    """The search is too short for contact, which ends in ALARM:5; no offset (G10) is set."""
    choose(prober, "Plate")
    prober.page.fill("#probe-far", "2")  # mm, but the work is 4 mm away
    prober.page.fill("#probe-feed", "400")
    prober.click("#probe-run")
    prober.reads("#probe-says", "ALARM:5")
    prober.reads("#probe-says", "Check that the probe is below the tool")
    assert not any(line.startswith("G10") for line in prober.machine.lines())


def test_modes_are_restored_after_unlocking_from_failed_probing(prober):
    """Probing is relative and in mm. An alarm ends it in G91, until the machine is unlocked."""
    prober.types("G20 G90")
    prober.waits("grbl.modes.includes('G20')")
    choose(prober, "Plate")
    prober.page.fill("#probe-far", "2")  # mm: no contact within them
    prober.page.fill("#probe-feed", "400")
    prober.click("#probe-run")
    prober.reads("#probe-says", "ALARM:5")
    prober.page.evaluate("() => { grbl.modes = []; }")  # until $G is asked again
    prober.click("#unlock")
    prober.waits("['G20', 'G90'].every((mode) => grbl.modes.includes(mode))")


def test_modes_are_not_restored_after_reset_or_another_driver(prober):
    """A reset has set them, or another page. Both come while the probing moves or is unlocked."""
    prober.types("G20 G90")
    prober.waits("grbl.modes.includes('G20')")
    choose(prober, "Plate")
    prober.page.evaluate("""() => {
        grbl.on("welcome", () => { globalThis.welcomed = true; });
        grbl.on("sent", ({ text }) => {
            if (text.startsWith("G38.2"))
                setTimeout(() => grbl.link.write(Uint8Array.of(RESET)), 100);
        });
    }""")
    prober.click("#probe-run")
    prober.reads("#probe-says", "ALARM:3")
    prober.waits("globalThis.welcomed && !acting")
    assert prober.page.evaluate("owedModes") == ""
    prober.page.evaluate("owedModes = 'G20 G90'; grbl.link.tell('driver')")
    assert prober.page.evaluate("owedModes") == ""


def test_probing_ends_at_reset_before_its_motion(prober):
    """STOP comes while the page asks for the offsets. Nothing is sent after the welcome."""
    choose(prober, "Plate")
    prober.page.evaluate("""() => grbl.on("sent", ({ text }) => {
        if (text === "$G" && acting) setTimeout(() => $("stop").click());
    })""")
    prober.click("#probe-run")
    prober.reads("#probe-says", "no answer: a reset")
    prober.knows_all()
    assert not any(re.search("G91|G38", line) for line in prober.machine.lines())


def test_triggered_probe_moves_nothing(prober):
    """A probe that is closed at the start cannot find anything, so no probing (G38) is sent."""
    prober.types("G0 Z-5")  # mm: into the work at -4, so the probe is closed
    prober.waits("grbl.pins.includes('P')")
    choose(prober, "Plate")
    prober.reads("#probe-state", "touches")
    prober.click("#probe-run")
    prober.reads("#probe-says", "The probe touches already")
    assert not any("G38" in line for line in prober.machine.lines())


def test_contact_of_an_older_status_does_not_refuse_next_probing(prober):
    choose(prober, "Plate")
    prober.page.fill("#probe-feed", "400")
    prober.page.evaluate("grbl.pins = 'P'; document.getElementById('probe-run').click()")
    prober.reads("#probe-says", "Done")


def test_later_tool_gets_difference_to_first(prober):
    """The first tool measured is the reference.

    A later one gets the difference as its length offset.
    """
    choose(prober, "Tool length")
    prober.page.fill("#probe-feed", "400")
    prober.click("#probe-run")
    prober.reads("#probe-says", "Done")
    reference = prober.page.evaluate("probeSet.reference")
    assert reference == pytest.approx(_HEIGHT, abs=2 / 400)
    # The stored reference is changed instead of the tool: the new tool is 2.5 mm longer.
    prober.page.evaluate("probeSet.reference = probeSet.reference - 2.5")
    prober.click("#probe-run")
    prober.reads("#probe-says", "Done")
    prober.waits("Math.abs(Number(grbl.offsets.get('TLO')) - 2.5) < 0.01")


def test_first_tool_is_forgotten_with_the_position_and_on_another_day(prober):
    """What was measured is a place of the machine. It survives a reload, but no new tab."""
    prober.page.evaluate("probeSet.reference = -4; keepProbe()")
    prober.page.evaluate("grbl.tell('alarm', 5)")  # no contact: the position is known
    assert prober.page.evaluate("[probeSet.reference, readProbe().reference]") == [-4, -4]
    assert prober.page.evaluate("sessionStorage.clear(); readProbe().reference") is None
    prober.page.evaluate("grbl.tell('alarm', 3)")  # reset during motion
    assert prober.page.evaluate("probeSet.reference") is None


def surface(x: float, y: float) -> float:
    return _HEIGHT + _ALONG_X * x + _ALONG_Y * y


def test_height_map_is_probed_drawn_saved_and_applied_to_program(prober, tmp_path):
    """3 times 3 points are probed.

    The program then follows the surface, and the map can be saved and survives a reload.
    """
    prober.loads(_JOB)
    choose(prober, "Height map")
    prober.page.fill("#probe-columns", "3")
    prober.page.fill("#probe-rows", "3")
    prober.page.fill("#probe-feed", "600")
    prober.page.fill("#probe-up", "1")
    # The extent of the cuts in _JOB.
    prober.reads("#probe-lines", "3 times 3 points: X 2 … 16, Y 1 … 9")
    prober.click("#probe-run")
    prober.reads("#probe-says", "9 points")
    height_map = prober.page.evaluate("heightMap")
    assert height_map["x"] == [2, 9, 16] and height_map["y"] == [1, 5, 9]
    for y, row in zip(height_map["y"], height_map["z"], strict=True):
        for x, z in zip(height_map["x"], row, strict=True):
            assert z == pytest.approx(surface(x, y), abs=0.02)
    assert prober.page.is_visible("#height-plot")

    prober.click("#height-use")
    prober.reads("#job-name", "job_level.nc")
    levelled = prober.page.evaluate("program.text")
    # Each cut is split into short lines that follow the surface.
    cuts = [
        tuple(map(float, words))
        for words in re.findall(r"^G1 X(\S+) Y(\S+) Z(\S+) F600$", levelled, re.MULTILINE)
    ]
    assert len(cuts) > 20  # from 5 moves in _CUTS
    for x, y, z in cuts:
        # The program cuts at Z-0.5.
        assert z == pytest.approx(-0.5 + surface(x, y), abs=0.03)
    # Lines without motion stay in their places.
    assert (
        levelled.index("M3 S1000")
        < levelled.index("G1 ")
        < levelled.index("G4 P0.1")
        < levelled.index("M2")
    )
    with prober.page.expect_download() as saved:
        prober.click("#tabs [data-tab=offsets]")
        prober.click("#height-save")
    assert json.loads(Path(saved.value.path()).read_text()) == height_map
    prober.page.reload()
    assert prober.page.evaluate("heightMap") == height_map


@pytest.mark.parametrize(
    ("program", "why"),
    [
        ("G21 G90\nG0 X0 Y0 Z1\nG38.2 Z-5 F50\nG1 X5\n", "line 3 has G38.2"),
        ("G21 G90\nG0 X0 Y0 Z1\nG81 X5 Z-1 R1 F50\nG1 X6\n", "line 3 has G81"),
        ("G21 G90\nG0 X0 Y0 Z1\nG91\nG1 X5 F50\n", "relative"),
    ],
)
def test_program_that_cannot_follow_map_is_reported(person, program, why):
    """withHeights() refuses probing, cycles, and relative moves."""
    person.loads(program)
    message = person.page.evaluate(
        """() => {
          try {
            return withHeights(program, { x: [0, 9], y: [0, 9], z: [[0, 1], [0, 1]] });
          } catch (error) { return error.message; }
        }"""
    )
    assert why in message
