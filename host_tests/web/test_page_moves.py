"""Test the page's controls that move the machine by hand, and those that stop it.

browser.py says what a person, a homer and the page's `grbl` and `job` are.
"""

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
    """After homing the machine stands 1 mm ($27) off its switches."""
    # Every state that the page learns is recorded, because Home is reported only once.
    homer.page.evaluate("window.states = []; grbl.on('status', () => states.push(grbl.state))")
    homer.click("#home")
    homer.reads("#state-words", "Homing")  # although the machine answers nothing meanwhile
    homer.homes()
    assert "Home" in homer.page.evaluate("states")
    homer.page.click("#frame-machine")  # shows machine coordinates
    homer.waits("document.querySelector('#axes .value').textContent === '-1.000'")
    assert homer.place() == [-1, -1, -1]


def test_reset_in_motion_ends_in_explained_alarm(person):
    """Escape is STOP: a reset.

    In motion it ends in ALARM:3, which the page explains until unlocked.
    """
    person.loads(FAR)
    person.click("#run")
    person.sees("Run")
    person.page.keyboard.press("Escape")  # STOP
    person.sees("Alarm")
    person.reads("#notice-alarm", "ALARM:3: Reset while moving: steps may have been lost.")
    person.reads("#notice-alarm", "What to do:")
    person.reads("#job-words", "Job stopped in line")
    person.click("#unlock")
    person.sees("Idle")
    assert not person.page.query_selector("#notice-alarm")


def test_alarm_is_shown_at_once_and_disables_run(homer):
    """The state Alarm is displayed from the line ALARM:2 alone.

    The machine sends no status report after it.
    """
    homer.homes()
    homer.types("$20=1")  # soft limits on
    homer.click("#tabs [data-tab=job]")
    homer.loads("G0 X-50\n")  # beyond the travel of 30 mm
    homer.waits("!document.querySelector('#run').disabled && grbl.setting(20) === 1")
    # Name and colour of the displayed state; recorded two frames after the alarm, with two
    # buttons.
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
    homer.waits("grbl.silent")  # no report for a while
    assert homer.text("#state-name") == "Alarm"
    homer.click("#stop")
    homer.waits("!document.querySelector('#unlock').disabled")
    homer.click("#unlock")
    homer.sees("Idle")


def test_stop_works_while_button_is_still_down(person):
    """STOP acts when the button goes down, not on release."""
    person.loads(FAR)
    person.click("#run")
    person.sees("Run")
    person.press("#stop")
    person.sees("Alarm")
    person.page.mouse.up()
    assert sent_at_once(person.machine) == b"\x18"


def test_escape_in_field_stops_nothing(person):
    """While a text is typed Escape belongs to the field, so it is no STOP."""
    person.click("#tabs [data-tab=console]")
    person.page.focus("#line")
    person.page.keyboard.press("Escape")
    person.pauses(0.3)
    assert not sent_at_once(person.machine)


# Jogging


def test_tap_jogs_one_step_each_time(person):
    """A short press moves by one step, without a cancel."""
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
    """Check that a jog was cancelled.

    The cancel may be repeated; no other realtime byte and no later jog line was sent.
    """
    assert set(sent_at_once(person.machine)) == {0x85}
    assert b"$J" not in person.machine.sent.partition(b"\x85")[2]


def hold_to_jog(person, button):
    """Press the button, keep it down, and wait until the machine moves at 20 mm/s."""
    person.page.fill("#jog-feed", f"{60 * JOG_MM_S:g}")
    person.press(button)
    person.waits(f"grbl.feed === {60 * JOG_MM_S:g}")


def test_held_button_moves_without_slowing_until_released(person):
    """A held jog is sent as many short jogs, which must join without slowing down."""
    hold_to_jog(person, "[data-jog='Y-']")
    first_byte = len(person.machine.said)
    person.waits("grbl.machine[1] < -40")
    feeds_mm_min = [feed for _, _, feed in person.machine.reports(first_byte)]
    # A loaded computer may send a piece late now and then.
    # Two thirds of the reports show at least 95 % of the feed in mm/min.
    assert (
        len(feeds_mm_min) > 4
        and sorted(feeds_mm_min)[len(feeds_mm_min) // 3] > 0.95 * 60 * JOG_MM_S
    )
    y_before_mm = person.machine.report()[1][1]
    person.page.mouse.up()
    state, (x, y, _), _ = person.machine.report("Idle")
    assert x == 0 and y <= y_before_mm
    assert_jog_was_cancelled(person)
    jog_lines = [line for line in person.machine.lines() if line.startswith("$J")]
    assert len(jog_lines) > 10
    person.pauses(0.3)
    assert person.machine.report() == (state, [x, y, 0], 0)


LOSSES = {
    "crashed": lambda person: person.crash(),
    "hangs": lambda person: person.hang(),
    "unplugged": lambda person: person.machine.unplug(),
}


@pytest.mark.parametrize("lose_page", LOSSES.values(), ids=LOSSES)
def test_jog_stops_by_itself_when_page_sends_no_more(person, lose_page):
    """It stops within the distance that docs/web.md states, whatever happened to the page."""
    hold_to_jog(person, "[data-jog='X+']")
    person.waits("grbl.machine[0] > 10")
    lose_page(person)
    x_before_mm = person.machine.report()[1][0]
    _, (x_end_mm, _, _), _ = person.machine.report("Idle")
    assert x_before_mm <= x_end_mm < x_before_mm + ASKED_MM
    assert b"\x85" not in person.machine.sent, "no cancel has ended it"


def test_jog_faster_than_axis_is_not_sent_ahead(person_at):
    """The page queues jogs by what the slow axis can do.

    Neither its rate nor its acceleration allows the feed that was asked.
    """
    person = person_at({110: "600", 120: "25"})  # X: 600 mm/min, 25 mm/s²
    person.open_from_disk()
    person.connect()
    person.page.fill("#jog-feed", "9000")
    person.press("[data-jog='X+']")
    person.waits("grbl.feed === 600")
    person.waits("grbl.machine[0] > 15")
    person.crash()
    x_before_mm = person.machine.report()[1][0]
    _, (x_end_mm, _, _), _ = person.machine.report("Idle")
    # Braking from 10 mm/s with 25 mm/s², and 0.5 s of motion that may be queued.
    assert x_before_mm <= x_end_mm < x_before_mm + 10.0**2 / 2 / 25 + 10.0 * 0.5


def test_opposite_jog_begins_after_first_has_ended(person):
    """The second button is pressed while the first jog still brakes; its jog is not lost."""
    hold_to_jog(person, "[data-jog='X+']")
    person.page.mouse.up()
    person.press("[data-jog='X-']")
    person.waits("grbl.machine[0] < -5")
    person.page.mouse.up()
    person.sees("Idle")


def test_refused_held_jog_is_reported_once(homer):
    """The page ends a held jog when its first line is refused."""
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
    """A held jog ends when the window loses the focus or the page is left."""
    person.press("[data-jog='X+']")
    person.sees("Jog")
    person.page.evaluate(f"dispatchEvent(new Event('{event}'))")
    stopped_at_mm = person.shown_place()
    assert 0 < stopped_at_mm[0] < 40


def test_hold_stops_held_jog(person):
    """A hold is a jog cancel for Grbl, so the next piece of the jog would move on."""
    person.press("[data-jog='X+']")
    person.sees("Jog")
    person.page.keyboard.press("!")
    stopped_at_mm = person.shown_place()
    person.pauses(0.5)
    assert person.place() == stopped_at_mm and 0 < stopped_at_mm[0] < 40


def test_command_key_stops_jog_by_key(person):
    """macOS reports no key's release while Command is down."""
    person.click("#keys")
    person.page.keyboard.down("ArrowRight")
    person.sees("Jog")
    person.page.keyboard.down("Meta")
    assert 0 < person.shown_place()[0] < 40


def test_lost_pointer_stops_jog(person):
    person.press("[data-jog='X+']")
    person.sees("Jog")
    person.page.evaluate("""document.querySelector("[data-jog='X+']").releasePointerCapture(1)""")
    assert 0 < person.shown_place()[0] < 40


def test_arrow_keys_jog_only_when_enabled(person):
    """Arrow keys jog after #keys is switched on: a tap by one step, held until released."""
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
    # Released 1 ms after the press counts as held, so the first jog line is hardly sent.
    person.page.evaluate("""{
        jogger.press([1, 0, 0]);
        setTimeout(() => jogger.release(), Jogger.HOLD_MS + 1);
    }""")
    person.pauses(0.6)
    assert 0 <= person.shown_place()[0] < 20


def test_jog_ends_before_soft_limits(homer):
    """A held jog towards the end of the travel stops there without an alarm or an error."""
    homer.homes()
    homer.types("$20=1")
    homer.types("$$")
    homer.waits("grbl.setting(20) === 1")
    homer.page.fill("#jog-feed", "3000")
    homer.press("[data-jog='X-']")
    homer.waits("grbl.machine[0] < -28 && grbl.state === 'Idle'")  # still held
    homer.page.mouse.up()
    homer.page.click("#frame-machine")
    # The travel is 30 mm; the page stops 0.01 mm before its end.
    assert homer.shown_place()[0] == pytest.approx(-29.99, abs=0.02)
    assert not homer.page.query_selector("#notice-trouble")


def test_zero_is_set_and_returned_to(person):
    """Work zero is set at X10; jogging away and `go to zero` returns there."""
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
    person.page.click("#frame-machine")  # shows machine coordinates
    # In machine coordinates: work zero was set at X10.
    person.waits("document.querySelector('#axes .value').textContent === '10.000'")


def test_reports_in_inches_are_shown_and_jogged_in_inches(person_at):
    """With $13=1 the page shows inches, and its steps are inches, too."""
    person = person_at({13: "1"})  # $13=1: the machine reports in inches
    person.open_from_disk()
    person.connect()
    person.reads("#steps", "in")
    person.click("#steps >> text='0.1'")
    person.click("[data-jog='X+']")
    person.waits("document.querySelector('#axes .value').textContent === '0.1000'")
    assert person.text(".facts [data-unit=rate]") == "in/min"


def test_jog_feed_is_converted_to_unit_of_reports(person):
    """Else 500 mm/min would become 500 in/min with $13=1."""
    person.page.fill("#z-feed", "254")
    person.types("$13=1")
    person.reads("#steps", "in")
    assert person.page.evaluate("[jogFeed(), zFeed()]") == [19.7, 10]
    person.types("$13=0")
    person.reads("#steps", "mm")
    assert person.page.evaluate("[jogFeed(), zFeed()]") == [500, 254]


def test_keyboard_alone_jogs_and_stops(person):
    """Buttons work by key: Space is a tap, held Enter a held button, and arrows change tabs."""
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
    assert person.page.is_visible("#log")  # the console, the tab after the job
