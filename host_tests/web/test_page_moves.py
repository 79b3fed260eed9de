"""Test the page's controls that move the machine by hand, and those that stop it."""

import pytest
from browser import FAR, sent_at_once

pytestmark = [pytest.mark.xdist_group("page moves"), pytest.mark.thorough]


# Alarms


def test_locked_machine_is_unlocked(homer):
    assert "Locked" in homer.text("#state-words")
    assert not homer.page.is_enabled("[data-jog='X+']")
    homer.click("#unlock")
    homer.sees("Idle")


def test_homing_ends_at_pull_off(homer):
    homer.page.evaluate("window.states = []; grbl.on('status', () => states.push(grbl.state))")
    homer.click("#home")
    homer.reads("#state-words", "Homing")  # although the machine answers nothing meanwhile
    homer.homes()
    assert "Home" in homer.page.evaluate("states")
    homer.page.click("#frame-machine")
    homer.waits("document.querySelector('#axes .value').textContent === '-1.000'")
    assert homer.place() == [-1, -1, -1]


def test_reset_in_motion_ends_in_explained_alarm(person):
    person.loads(FAR)
    person.click("#run")
    person.sees("Run")
    person.page.keyboard.press("Escape")
    person.sees("Alarm")
    person.reads("#notice-alarm", "ALARM:3: Reset while moving: steps may have been lost.")
    person.reads("#notice-alarm", "What to do:")
    person.reads("#job-words", "Job stopped in line")
    person.click("#unlock")
    person.sees("Idle")
    assert not person.page.query_selector("#notice-alarm")


def test_alarm_is_shown_at_once_and_disables_run(homer):
    """This holds without a status report, too, as after ALARM:2."""
    homer.homes()
    homer.types("$20=1")
    homer.click("#tabs [data-tab=job]")
    homer.loads("G0 X-50\n")
    homer.waits("!document.querySelector('#run').disabled && grbl.setting(20) === 1")
    state = "$('state-name').textContent, $('state').dataset.tone"
    homer.page.evaluate(
        "grbl.on('alarm', () => requestAnimationFrame(() => requestAnimationFrame(() => {"
        f"window.seen = [{state}, $('run').disabled, $('unlock').disabled]; }})))"
    )
    homer.click("#run")
    homer.reads("#notice-alarm", "ALARM:2")
    homer.waits("window.seen")
    assert homer.page.evaluate("seen") == ["Alarm", "bad", True, True]
    homer.reads("#state-words", "ALARM:2: only STOP works")
    homer.waits("grbl.silent")
    assert homer.text("#state-name") == "Alarm"
    homer.click("#stop")
    homer.waits("!document.querySelector('#unlock').disabled")
    homer.click("#unlock")
    homer.sees("Idle")


def test_stop_works_while_button_is_still_down(person):
    person.loads(FAR)
    person.click("#run")
    person.sees("Run")
    person.press("#stop")
    person.sees("Alarm")
    person.page.mouse.up()
    assert sent_at_once(person.machine) == b"\x18"


def test_escape_in_field_stops_nothing(person):
    person.click("#tabs [data-tab=console]")
    person.page.focus("#line")
    person.page.keyboard.press("Escape")
    person.pauses(0.3)
    assert not sent_at_once(person.machine)


# Jogging


def test_tap_jogs_one_step_each_time(person):
    person.page.fill("#jog-feed", "3000")
    person.click("#steps >> text='10'")
    person.click("[data-jog='X+']")
    person.rests_at(10, 0, 0)
    person.click("#steps >> text='0.1'")
    person.click("[data-jog='Z-']")
    person.rests_at(10, 0, -0.1)
    assert not sent_at_once(person.machine)


# A jog at 20 mm/s on a machine with 500 mm/s²; at most 0.5 s of motion is queued.
JOG_MM_S = 20.0
BRAKE_MM = JOG_MM_S**2 / 2 / 500
ASKED_MM = BRAKE_MM + JOG_MM_S * 0.5


def assert_jog_was_cancelled(person):
    """Check that only cancels were sent, until the machine obeyed, and no jog line after them."""
    assert set(sent_at_once(person.machine)) == {0x85}
    assert b"$J" not in person.machine.sent.partition(b"\x85")[2]


def hold_to_jog(person, button):
    """Press it and wait until it moves at its full speed."""
    person.page.fill("#jog-feed", f"{60 * JOG_MM_S:g}")
    person.press(button)
    person.waits(f"grbl.feed === {60 * JOG_MM_S:g}")


def test_held_button_moves_without_slowing_until_released(person):
    hold_to_jog(person, "[data-jog='Y-']")
    begun = len(person.machine.said)
    person.waits("grbl.machine[1] < -40")
    feeds = [feed for _, _, feed in person.machine.reports(begun)]
    # A loaded computer may send a piece late now and then.
    assert len(feeds) > 4 and sorted(feeds)[len(feeds) // 3] > 0.95 * 60 * JOG_MM_S
    at = person.machine.report()[1][1]
    person.page.mouse.up()
    state, (x, y, _), _ = person.machine.report("Idle")
    assert x == 0 and y <= at
    assert_jog_was_cancelled(person)
    pieces = [line for line in person.machine.lines() if line.startswith("$J")]
    assert len(pieces) > 10
    person.pauses(0.3)
    assert person.machine.report() == (state, [x, y, 0], 0)


LOSSES = {
    "crashed": lambda person: person.crash(),
    "hangs": lambda person: person.hang(),
    "unplugged": lambda person: person.machine.unplug(),
}


@pytest.mark.parametrize("lost", LOSSES.values(), ids=LOSSES)
def test_jog_stops_by_itself_when_page_sends_no_more(person, lost):
    """It stops within the distance that docs/web.md states, whatever happened to the page."""
    hold_to_jog(person, "[data-jog='X+']")
    person.waits("grbl.machine[0] > 10")
    lost(person)
    at = person.machine.report()[1][0]
    _, (x, _, _), _ = person.machine.report("Idle")
    assert at <= x < at + ASKED_MM
    assert b"\x85" not in person.machine.sent, "no cancel has ended it"


def test_jog_faster_than_axis_is_not_sent_ahead(person_at):
    """A jog on an axis with a slow acceleration is not sent ahead either."""
    person = person_at({110: "600", 120: "25"})
    person.open_from_disk()
    person.connect()
    person.page.fill("#jog-feed", "9000")
    person.press("[data-jog='X+']")
    person.waits("grbl.feed === 600")
    person.waits("grbl.machine[0] > 15")
    person.crash()
    at = person.machine.report()[1][0]
    _, (x, _, _), _ = person.machine.report("Idle")
    assert at <= x < at + 10.0**2 / 2 / 25 + 10.0 * 0.5


def test_opposite_jog_begins_after_first_has_ended(person):
    hold_to_jog(person, "[data-jog='X+']")
    person.page.mouse.up()
    person.press("[data-jog='X-']")
    person.waits("grbl.machine[0] < -5")
    person.page.mouse.up()
    person.sees("Idle")


def test_refused_held_jog_is_reported_once(homer):
    homer.homes()
    homer.types("$20=1")
    homer.waits("grbl.setting(20) === 1")
    homer.page.evaluate("grbl.settings.set(20, '0')")  # the page does not know that $20 is on
    homer.click("#tabs [data-tab=job]")
    homer.page.fill("#jog-feed", "3000")
    homer.press("[data-jog='X-']")
    homer.reads("#notice-trouble", "error:15")
    homer.pauses(0.5)
    assert homer.machine.said.count(b"error:15") == 1
    assert homer.machine.report()[0] == "Idle"


@pytest.mark.parametrize("event", ["blur", "pagehide"])
def test_leaving_page_stops_jog(person, event):
    person.press("[data-jog='X+']")
    person.sees("Jog")
    person.page.evaluate(f"dispatchEvent(new Event('{event}'))")
    there = person.shown_place()
    assert 0 < there[0] < 40


def test_lost_pointer_stops_jog(person):
    person.press("[data-jog='X+']")
    person.sees("Jog")
    person.page.evaluate("""document.querySelector("[data-jog='X+']").releasePointerCapture(1)""")
    assert 0 < person.shown_place()[0] < 40


def test_arrow_keys_jog_only_when_enabled(person):
    person.page.keyboard.press("ArrowRight")
    person.pauses(0.3)
    assert not [line for line in person.machine.lines() if line.startswith("$J")]
    person.click("#keys")
    person.page.keyboard.press("ArrowRight")
    person.rests_at(1, 0, 0)
    person.page.keyboard.down("ArrowUp")
    person.waits("grbl.machine[1] > 2")
    person.page.keyboard.up("ArrowUp")
    assert person.shown_place()[1] > 1


def test_cancel_before_jog_has_begun_is_repeated(person):
    """Grbl ignores a cancel that arrives before the jog line is read; the jog must still end."""
    person.page.evaluate("""{
        jogger.press([1, 0, 0]);
        setTimeout(() => jogger.release(), Jogger.HOLD_MS + 1);
    }""")
    person.pauses(0.6)
    assert 0 <= person.shown_place()[0] < 20


def test_jog_ends_before_soft_limits(homer):
    homer.homes()
    homer.types("$20=1")
    homer.types("$$")
    homer.waits("grbl.setting(20) === 1")
    homer.page.fill("#jog-feed", "3000")
    homer.press("[data-jog='X-']")
    homer.waits("grbl.machine[0] < -28 && grbl.state === 'Idle'")  # still held
    homer.page.mouse.up()
    homer.page.click("#frame-machine")
    assert homer.shown_place()[0] == pytest.approx(-29.99, abs=0.02)
    assert not homer.page.query_selector("#notice-trouble")


def test_zero_is_set_and_returned_to(person):
    person.page.fill("#jog-feed", "3000")
    person.click("#steps >> text='10'")
    person.click("[data-jog='X+']")
    person.rests_at(10, 0, 0)
    person.click("[aria-label='Set X to zero here']")
    person.rests_at(0, 0, 0)
    person.click("[data-jog='X+']")
    person.click("[data-jog='Y+']")
    person.rests_at(10, 10, 0)
    person.click("#go-zero")
    person.rests_at(0, 0, 0)
    person.page.click("#frame-machine")
    person.waits("document.querySelector('#axes .value').textContent === '10.000'")


def test_reports_in_inches_are_shown_and_jogged_in_inches(person_at):
    person = person_at({13: "1"})
    person.open_from_disk()
    person.connect()
    person.reads("#steps", "in")
    person.click("#steps >> text='0.1'")
    person.click("[data-jog='X+']")
    person.waits("document.querySelector('#axes .value').textContent === '0.1000'")
    assert person.text(".facts [data-unit=rate]") == "in/min"


def test_keyboard_alone_jogs_and_stops(person):
    person.page.fill("#jog-feed", "1200")
    person.page.focus("[data-jog='X+']")
    person.page.keyboard.press("Space")
    person.rests_at(1, 0, 0)
    person.page.keyboard.down("Enter")
    person.waits("grbl.machine[0] > 5")
    person.page.keyboard.up("Enter")
    assert person.machine.report("Idle")[1][0] > 5
    assert_jog_was_cancelled(person)
    person.page.focus("#tabs [data-tab=job]")
    person.page.keyboard.press("ArrowRight")
    assert person.page.is_visible("#log")
