"""Test outline, coordinate systems, macros, jobs on the board, and the search for settings.

jogs() returns the jog lines ($J) of the page. _JOB cuts from (10, 5) to (40, 25): its arc bulges
10 mm beyond X30.

browser.py says what a person, a homer and the page's `grbl` and `job` are.
"""

import json
from pathlib import Path

import pytest

pytestmark = [pytest.mark.xdist_group("page"), pytest.mark.thorough]

_JOB = "G21 G90\nG0 Z5\nG0 X10 Y5\nG1 Z-1 F300\nG1 X30\nG3 X30 Y25 R10\nG1 X10\nG0 Z5\nM2\n"


def jogs(person):
    return [line for line in person.machine.lines() if line.startswith("$J")]


# The outline


def test_outline_goes_round_cuts_with_tool_up(person):
    """The outline is a rectangle round all cuts.

    It is jogged with Z at the highest position of the program.
    """
    person.loads(_JOB)
    person.page.fill("#jog-feed", "2000")
    person.click("#outline")
    person.reads("#dialog-words", "X from 10 mm to 40 mm, Y from 5 mm to 25 mm")
    person.reads("#dialog-words", "First Z goes up to 5 mm")
    person.click("#dialog-yes")
    person.rests_at(10, 5, 5)
    places = [(10, 5), (40, 5), (40, 25), (10, 25), (10, 5)]
    moves = [f"$J=G21 G90 X{x} Y{y} F2000" for x, y in places]
    assert jogs(person) == ["$J=G21 G90 Z5 F2000", *moves]


def test_nothing_moves_when_outline_is_declined(person):
    """The outline asks before it moves."""
    person.loads(_JOB)
    person.click("#outline")
    person.click("#dialog-no")
    person.pauses(0.3)
    assert not jogs(person)


def test_laser_outline_runs_at_1_percent_and_ends_off(person_at):
    """A laser draws the outline at 1 % of its power, and is off at the end."""
    person = person_at({32: "1", 30: "1000"})  # $32=1: laser mode; S1000 is full power
    person.open_from_disk()
    person.connect()
    person.loads(_JOB)
    person.page.fill("#jog-feed", "2000")
    person.click("#outline")
    person.reads("#dialog-words", "The laser is on at S10")  # 1 % of 1000
    person.click("#dialog-yes")
    person.sees("Run")
    person.waits("!grbl.linesUnderWay && grbl.state === 'Idle' && grbl.modes.includes('M5')")
    assert "G1 X40 Y5 F2000 M4 S10" in person.machine.lines()
    assert person.machine.lines().index("M5 G0") > 0  # the laser is switched off, and G1 is left


# Coordinate systems


def test_coordinate_system_is_chosen_and_typed(person):
    """An offset typed for G55 is stored, and `Use G55` selects it; the machine does not move."""
    person.click("#tabs [data-tab=offsets]")
    person.page.fill("[aria-label='G55 X']", "12.5")
    person.page.keyboard.press("Enter")
    person.waits("grbl.offsets.get('G55') === '12.500,0.000,0.000'")
    person.click("[aria-label='Use G55']")
    person.waits("grbl.modes.includes('G55')")
    person.rests_at(-12.5, 0, 0)  # the same place by G55
    person.reads("#offsets", "in force")


def test_typed_offset_is_in_displayed_units(person):
    """The machine is in inches (G20), but the page shows mm, so 25.4 is typed and means mm."""
    person.types("G20")  # inches in programs; reports stay in mm ($13=0)
    person.waits("grbl.modes.includes('G20')")
    person.click("#tabs [data-tab=offsets]")
    person.page.fill("[aria-label='G56 Y']", "25.4")
    person.page.keyboard.press("Enter")
    person.waits("grbl.offsets.get('G56') === '0.000,25.400,0.000'")


def test_offset_typed_just_after_g20_is_in_displayed_units(person):
    person.click("#tabs [data-tab=offsets]")
    person.page.wait_for_selector("[aria-label='G56 Y']")
    script = """grbl.send("G20");
        const field = document.querySelector("[aria-label='G56 Y']");
        field.value = "25.4"; field.onchange({ target: field });"""
    person.page.evaluate(f"() => {{ {script} }}")
    person.waits("grbl.offsets.get('G56') === '0.000,25.400,0.000'")


# Macros


def test_macro_asks_for_numbers_and_runs_line_by_line(person):
    """A macro is made in the page; it asks for {depth} at each run, and survives a reload."""
    person.click("#macros-edit")
    person.click("#macro-add")
    person.page.fill("[aria-label='Name of macro 1']", "Down")
    # {depth=2} is asked for at each run; 2 is proposed.
    person.page.fill("#macros-rows textarea", "G91 (relative)\nG0 Z-{depth=2}\nG90\n")
    person.page.keyboard.press("Tab")
    person.click("#macros button:has-text('Down')")
    person.page.fill("#dialog input", "3.5")
    person.click("#dialog-yes")
    person.rests_at(0, 0, -3.5)
    lines = person.machine.lines()
    assert lines.index("G91") < lines.index("G0 Z-3.5") < lines.index("G90")
    person.page.reload()
    assert person.text("#macros").strip() == "Down"  # macros are stored in the browser


def test_job_does_not_start_between_lines_of_macro(person):
    """The machine is Idle in a dwell, but the lines after it are still to be sent."""
    person.loads("G21 G90\nG0 X1\n")
    lines = "G4 P1\nG91\nG0 Z1\nG90"
    person.page.evaluate(f"macros = [{{ name: 'up', lines: `{lines}` }}]; renderMacros()")
    person.click("#macros button")
    person.pauses(0.3)
    disabled = person.page.evaluate("['run', 'zero-all', 'go-zero'].map((id) => $(id).disabled)")
    assert disabled == [True] * 3
    person.page.evaluate("run()")
    person.rests_at(0, 0, 1)
    assert "G0 X1" not in person.machine.lines()
    person.waits("!$('run').disabled")


def test_macro_ends_at_refused_line(person, tmp_path):
    """G1 X5 has no feed and is refused, so the line after it is not sent.

    Macros are loaded from a file and saved to one.
    """
    macros = [{"name": "Bad", "lines": "G91\nG1 X5\nG0 Y9\n"}]
    file = tmp_path / "macros.json"
    file.write_text(json.dumps(macros))
    person.click("#macros-edit")
    person.page.set_input_files("#macros-file", str(file))
    person.click("#macros button:has-text('Bad')")
    person.reads("#notice-trouble", "Bad ends at: G1 X5")
    assert "G0 Y9" not in person.machine.lines()
    with person.page.expect_download() as saved:
        person.click("#macros-save")
    assert json.loads(Path(saved.value.path()).read_text()) == macros


def test_macro_ends_where_ok_and_welcome_come_together(person):
    """The machine is reset by somebody else just after its answer: no line may follow."""
    person.page.evaluate("macros = [{ name: 'up', lines: 'G91\\nG0 Z1' }]; renderMacros()")
    person.machine.hears = False
    person.click("#macros button")
    person.waits("grbl.linesUnderWay")
    person.machine.say(b"ok\r\n\r\nGrbl 1.1h ['$' for help]\r\n")
    person.reads("#notice-trouble", "no answer: a reset")
    assert person.machine.lines()[-1] != "G0 Z1"


def test_file_without_macros_changes_nothing(person, tmp_path):
    """A JSON file of another form is refused with its name."""
    file = tmp_path / "no.json"
    file.write_text('{"name": 1}')
    person.click("#macros-edit")
    person.page.set_input_files("#macros-file", str(file))
    person.reads("#notice-trouble", "no.json")
    assert person.page.evaluate("macros.length") == 0


# Settings


def test_settings_are_grouped_and_found_by_words(person):
    """A search shows only rows that have the words, and hides groups without any."""
    person.click("#tabs [data-tab=settings]")
    person.reads("#settings", "Limits and homing")
    person.page.fill("#settings-find", "accel")
    rows = person.page.locator("#settings tr[id]")
    assert rows.count() == 3 and person.page.is_visible("#setting-120")  # $120 to $122
    assert "Limits and homing" not in person.text("#settings")
    person.page.fill("#settings-find", "$22")
    assert rows.count() == 1 and person.page.is_visible("#setting-22")


def test_settings_that_differ_from_defaults_are_found_and_reset(person):
    """A filter shows the settings that differ from their defaults; a button resets one of them."""
    person.click("#tabs [data-tab=settings]")
    person.reads("#setting-110", "Default: 500")
    person.page.check("#settings-changed")
    numbers = [row.get_attribute("id") for row in person.page.locator("#settings tr[id]").all()]
    # The settings that the machine of this test starts with.
    assert numbers == [f"setting-{n}" for n in (110, 111, 112, 120, 121, 122)]
    person.click("[aria-label='Set $121 to its default, 10']")
    person.waits("grbl.settings.get(121) === '10.000' && !document.getElementById('setting-121')")
    person.page.uncheck("#settings-changed")
    assert "Default" not in person.text("#setting-121")


def test_changed_settings_are_undone_from_last_to_first(person):
    """Each press of Undo restores the value before the last accepted change."""
    person.click("#tabs [data-tab=settings]")
    assert not person.page.is_visible("#undo-setting")
    for value in ("2000", "1000"):
        person.page.fill("[aria-label^='$110 Maximum rate X']", value)
        person.page.keyboard.press("Enter")
        person.reads("#setting-110", f"{value} is kept")
    person.page.fill("[aria-label^='$0 ']", "1")  # refused, so there is nothing to undo
    person.page.keyboard.press("Enter")
    person.reads("#setting-0", "1 was not taken")
    person.click("#undo-setting:has-text('Undo: $110=2000.000')")
    person.waits("grbl.settings.get(110) === '2000.000'")
    person.click("#undo-setting:has-text('Undo: $110=3000.000')")
    person.waits("grbl.settings.get(110) === '3000.000'")
    assert not person.page.is_visible("#undo-setting")
    sent = [line for line in person.machine.lines() if line.startswith("$110=")]
    assert sent == ["$110=2000", "$110=1000", "$110=2000.000", "$110=3000.000"]


def test_masks_of_directions_and_switches_have_pictures(person):
    """Drawings show the bits of $3 (motor directions) and $23 (corner of the switches).

    They follow a change.
    """
    person.click("#tabs [data-tab=settings]")
    person.page.wait_for_selector("[aria-label='X as wired, Y as wired, Z as wired']")
    person.page.check("[aria-label='$3 Step direction invert, Y']")
    person.reads("#setting-3", "2 is kept")
    person.page.wait_for_selector("#setting-3 [aria-label='X as wired, Y inverted, Z as wired']")
    assert person.page.locator("#setting-3 path.on").count() == 1
    # Positions of the switches in the drawing; [0] is that of X, [1] that of Y.
    switches = "[...document.querySelectorAll('#setting-23 circle')]"
    corner = f"{switches}.map((dot) => [dot.cx.baseVal.value, dot.cy.baseVal.value])"
    before = person.page.evaluate(corner)
    assert person.page.is_visible("#setting-23 [aria-label='Switches: right, back, top']")
    person.page.check("[aria-label='$23 Homing direction invert, X']")
    person.page.wait_for_selector("#setting-23 [aria-label='Switches: left, back, top']")
    after = person.page.evaluate(corner)
    # The switch of X has moved to the left; that of Y has not moved.
    assert after[0][0] < before[0][0] and after[0][1] == before[0][1] and after[1] == before[1]


# Jobs on the board


def test_job_on_board_continues_at_line(person):
    """`$F=NAME@LINE` continues a stored job at a line.

    Without a line it continues where it was interrupted.
    """
    # Replaces the sending: the board is scripted and stores one job.
    person.page.evaluate("""
      grbl.send = (line, quiet, said) => {
        (window.sentThere ||= []).push(line);
        if (line === "$F") said.push("[FILE:/PART.NC|SIZE:1234]");
        return Promise.resolve("ok");
      };
    """)
    person.click("#board-files")
    person.click("[aria-label='Go on with PART.NC on the board']")
    person.reads("#dialog-words", "Home the machine first")
    person.page.fill("#dialog input", "120")
    person.click("#dialog-yes")
    person.waits("sentThere.includes('$F=PART.NC@120')")
    person.click("[aria-label='Go on with PART.NC on the board']")
    person.click("#dialog-yes")
    person.waits("sentThere.includes('$F=PART.NC@')")
