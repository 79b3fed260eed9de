"""The page at the exact firmware: a browser without a window, and the simulator behind it."""

import re
from pathlib import Path

import pytest
from browser import sent_at_once
from ugrbl.paths import BOARDS

pytestmark = pytest.mark.xdist_group("page")

HOMING = {22: "1", 25: "2000.000", 24: "500.000", 130: "30.000", 131: "30.000", 132: "30.000"}
FAR = "G21 G90\nG1 X40 F600\nG1 Y20\nG1 X0\nG1 Y0\n"


@pytest.fixture
def homer(person_at):
    """At a machine that has switches, and is locked until it is homed."""
    made = person_at(HOMING, "--switches")
    made.open_from_disk()
    made.connect("Alarm")
    return made


# Connecting


def test_nothing_is_sent_before_somebody_connects_and_only_questions_after(person_at):
    person = person_at()
    person.open_from_disk()
    person.reads("#state-words", "press Connect")
    person.pauses(0.5)
    assert not person.machine.sent and person.text("#state-name") == "Not connected"
    person.connect()
    person.pauses(1)
    assert set(person.machine.lines()) == {"$I", "$$", "$G", "$#"}
    assert not sent_at_once(person.machine)


def test_state_place_and_modes_are_shown(person):
    assert person.place() == [0, 0, 0]
    assert person.text("#modes").startswith("G0 G54 G17 G21 G90 G94 M5")
    assert person.page.evaluate("grbl.window") == 127


def test_without_web_serial_it_says_what_to_do(person_at):
    person = person_at()
    person.page.add_init_script("delete Navigator.prototype.serial")
    person.page.goto(_page_uri())
    person.reads("#notices", "This browser cannot open a USB port")
    assert not person.page.is_visible("#connect")


def _page_uri():
    from bridge import PAGE

    return PAGE.as_uri()


def test_a_machine_that_does_not_answer_is_said_to(person_at):
    person = person_at()
    person.machine.hears = False
    person.open_from_disk()
    person.click("#connect")
    person.sees("No answer")
    assert not person.page.is_enabled("[data-jog='X+']")


def test_the_plug_pulled_in_a_job_is_said_and_connecting_again_works(person):
    person.loads(FAR.replace("F600", "F2400"))
    person.click("#run")
    person.sees("Run")
    person.machine.unplug()
    person.reads("#notice-lost", "The connection is lost")
    person.reads("#notice-lost", "The job stopped behind line")
    person.reads("#notice-lost", "A spindle stays on")
    person.sees("Not connected")
    person.click("#connect")
    person.sees("Run")  # it ends what it was given
    person.sees("Idle")
    person.waits("grbl.settled && !document.getElementById('notice-lost')")
    assert person.page.evaluate("portsOpened") == 2


def test_disconnecting_is_no_accident(person):
    person.click("#disconnect")
    person.sees("Not connected")
    assert not person.page.query_selector("#notice-lost")
    person.click("#connect")
    person.sees("Idle")


# Alarms


def test_a_locked_machine_is_unlocked(homer):
    assert "Locked" in homer.text("#state-words")
    assert not homer.page.is_enabled("[data-jog='X+']")
    homer.click("#unlock")
    homer.sees("Idle")


def test_homing_ends_at_the_pull_off(homer):
    homer.click("#home")
    homer.sees("Home")
    homer.sees("Idle")
    homer.page.click("#frame-machine")
    homer.waits("document.querySelector('#axes .value').textContent === '-1.000'")
    assert homer.place() == [-1, -1, -1]


def test_a_reset_in_motion_ends_in_an_alarm_in_words(person):
    person.loads(FAR)
    person.click("#run")
    person.sees("Run")
    person.page.keyboard.press("Escape")
    person.sees("Alarm")
    person.reads("#notice-alarm", "ALARM:3: Reset while moving: steps may have been lost.")
    person.reads("#notice-alarm", "What to do:")
    person.reads("#job-words", "Job stopped behind line")
    person.click("#unlock")
    person.sees("Idle")
    assert not person.page.query_selector("#notice-alarm")


def test_stop_works_with_one_tap_while_the_button_is_still_down(person):
    person.loads(FAR)
    person.click("#run")
    person.sees("Run")
    person.press("#stop")
    person.sees("Alarm")
    person.page.mouse.up()
    assert sent_at_once(person.machine) == b"\x18"


def test_escape_in_a_field_stops_nothing(person):
    person.click("#tabs [data-tab=console]")
    person.page.focus("#line")
    person.page.keyboard.press("Escape")
    person.pauses(0.3)
    assert not sent_at_once(person.machine)


# Jogging


def test_a_tap_jogs_one_step_each_time(person):
    person.page.fill("#jog-feed", "3000")
    person.click("#steps >> text='10'")
    person.click("[data-jog='X+']")
    person.rests_at(10, 0, 0)
    person.click("#steps >> text='0.1'")
    person.click("[data-jog='Z-']")
    person.rests_at(10, 0, -0.1)
    assert not sent_at_once(person.machine)


# A jog, in mm/s, on a machine with 500 mm/s²; nobody asks for more than half a second of it.
JOG_MM_S = 20.0
BRAKE_MM = JOG_MM_S**2 / 2 / 500
ASKED_MM = BRAKE_MM + JOG_MM_S * 0.5


def hold_to_jog(person, button):
    """Press it and wait until it moves at its full speed."""
    person.page.fill("#jog-feed", f"{60 * JOG_MM_S:g}")
    person.press(button)
    person.waits(f"grbl.feed === {60 * JOG_MM_S:g}")


def test_a_button_that_is_held_moves_without_slowing_until_it_is_let_go(person):
    hold_to_jog(person, "[data-jog='Y-']")
    begun = len(person.machine.said)
    person.waits("grbl.machine[1] < -40")
    feeds = [feed for _, _, feed in person.machine.reports(begun)]
    assert len(feeds) > 4 and min(feeds) > 0.95 * 60 * JOG_MM_S
    at = person.machine.report()[1][1]
    person.page.mouse.up()
    state, (x, y, _), _ = person.machine.report("Idle")
    assert x == 0 and at - 0.2 * JOG_MM_S < y < at, "it ends at once"
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
def test_a_jog_stops_by_itself_where_nobody_asks_for_more(person, lost):
    """Within the distance that docs/web.md states, whatever has become of the page."""
    hold_to_jog(person, "[data-jog='X+']")
    person.waits("grbl.machine[0] > 10")
    lost(person)
    at = person.machine.report()[1][0]
    _, (x, _, _), _ = person.machine.report("Idle")
    assert at < x < at + ASKED_MM
    assert b"\x85" not in person.machine.sent, "no cancel has ended it"


def test_a_jog_faster_than_the_axis_is_not_sent_ahead(person_at):
    """Nor is one of a slow acceleration."""
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
    assert at < x < at + 10.0**2 / 2 / 25 + 10.0 * 0.5


def test_the_other_way_at_once_begins_when_the_first_has_ended(person):
    hold_to_jog(person, "[data-jog='X+']")
    person.page.mouse.up()
    person.press("[data-jog='X-']")
    person.waits("grbl.machine[0] < -5")
    person.page.mouse.up()
    person.sees("Idle")


def test_a_held_jog_that_is_refused_is_said_once(homer):
    homer.click("#home")
    homer.sees("Home")
    homer.sees("Idle")
    homer.types("$20=1")  # and the page does not know of it
    homer.click("#tabs [data-tab=job]")
    homer.page.fill("#jog-feed", "3000")
    homer.press("[data-jog='X-']")
    homer.reads("#notice-trouble", "error:15")
    homer.pauses(0.5)
    assert homer.machine.said.count(b"error:15") == 1
    assert homer.machine.report()[0] == "Idle"


@pytest.mark.parametrize("event", ["blur", "pagehide"])
def test_a_page_that_is_left_stops_the_jog(person, event):
    person.press("[data-jog='X+']")
    person.sees("Jog")
    person.page.evaluate(f"dispatchEvent(new Event('{event}'))")
    there = person.shown_place()
    assert 0 < there[0] < 40


def test_a_lost_pointer_stops_the_jog(person):
    person.press("[data-jog='X+']")
    person.sees("Jog")
    person.page.evaluate("""document.querySelector("[data-jog='X+']").releasePointerCapture(1)""")
    assert 0 < person.shown_place()[0] < 40


def test_arrow_keys_jog_only_when_they_are_switched_on(person):
    person.page.keyboard.press("ArrowRight")
    person.pauses(0.3)
    assert not [line for line in person.machine.lines() if line.startswith("$J")]
    person.click("#keys")
    person.page.keyboard.press("ArrowRight")
    person.rests_at(1, 0, 0)
    person.page.keyboard.down("ArrowUp")
    person.sees("Jog")
    person.page.keyboard.up("ArrowUp")
    assert person.shown_place()[1] > 1


def test_a_cancel_before_the_jog_has_begun_is_said_again(person):
    """A cancel that comes before the line is read is ignored; the jog must end all the same."""
    person.page.evaluate("""{
        jogger.press(0, 1);
        setTimeout(() => jogger.release(), Jogger.HOLD_MS + 1);
    }""")
    person.pauses(0.6)
    assert 0 <= person.shown_place()[0] < 20


def test_a_jog_ends_before_soft_limits_do(homer):
    homer.click("#home")
    homer.sees("Home")
    homer.sees("Idle")
    homer.types("$20=1")
    homer.types("$$")
    homer.waits("grbl.setting(20) === 1")
    homer.page.fill("#jog-feed", "3000")
    homer.press("[data-jog='X-']")
    homer.waits("grbl.machine[0] < -28 && grbl.state === 'Idle'")  # and held all the same
    homer.page.mouse.up()
    homer.page.click("#frame-machine")
    assert homer.shown_place()[0] == pytest.approx(-29.99, abs=0.02)
    assert not homer.page.query_selector("#notice-trouble")


def test_zero_and_the_way_back_to_it(person):
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
    assert "in/min" in person.text("#feed")


# Jobs


def test_a_job_with_a_hold_and_an_override_ends_at_the_right_place(person):
    person.loads("G21 G90\nG1 X20 F1500\nG2 X0 Y0 R10\nG1 Z-3\nG1 X12.5 Y5\nM2\n")
    person.click("#run")
    person.sees("Run")
    person.click("#hold")
    person.reads("#state-words", "At rest")
    person.reads("#job-words", "Held")
    person.click("#resume")
    person.click("[aria-label='Feed +10 %']")
    person.reads("#ov-feed", "110 %")
    person.reads("#job-words", "Job done: nothing refused")
    person.rests_at(12.5, 5, -3)


def test_modes_are_followed_while_a_job_runs(person):
    person.loads("G21 G91\nM3 S500\nG1 X40 F600\n")
    person.click("#run")
    person.sees("Run")
    person.reads("#modes", "G1 G54 G17 G21 G91 G94 M3 M9 T0 F600 S500")
    person.click("#stop")


def test_a_line_that_is_refused_holds_the_machine_and_is_named(person):
    later = "".join(f"G1 X{i}\n" for i in range(20, 4, -1))
    person.loads(f"G21 G90\nG1 X20 F2400\nG999\n{later}{later}G1 X5\n")
    person.click("#run")
    person.reads("#job-words", "Line 3 was refused. error:20: The block holds a word")
    person.sees("Hold")
    sent = person.machine.lines()
    person.pauses(0.5)
    assert person.machine.lines() == sent and len(sent) < 30
    assert not person.page.is_enabled("#resume"), "how to go on is asked"
    person.click("#go-on")
    person.reads("#job-words", "Job done: 1 line refused")
    person.rests_at(5, 0, 0)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.nc", b"", "empty.nc is empty."),
        (
            "photo.png",
            b"G0 X1\n\x89PNG\r\n\x1a\n\0\0",
            "photo.png is no G-code: line 2",
        ),
    ],
)
def test_what_is_no_program_is_refused_in_words(person, name, content, words):
    """And what was open stays."""
    person.loads("G0 X1\n")
    (person.folder / name).write_bytes(content)
    person.page.set_input_files("#job-file", str(person.folder / name))
    person.reads("#notice-trouble", words)
    assert person.text("#job-name") == "job.nc, 1 lines"
    person.loads("G0 X2 (f\u00fcr)\n", "other.nc")
    assert not person.page.query_selector("#notice-trouble")


def test_a_comment_in_another_code_page_is_no_reason_to_refuse(person):
    (person.folder / "old.nc").write_bytes("G0 X1 (f\u00fcr)\n".encode("latin-1"))
    person.page.set_input_files("#job-file", str(person.folder / "old.nc"))
    person.reads("#job-name", "old.nc")
    person.click("#run")
    person.rests_at(1, 0, 0)


def test_by_keyboard_alone_it_jogs_and_stops(person):
    person.page.fill("#jog-feed", "1200")
    person.page.focus("[data-jog='X+']")
    person.page.keyboard.press("Space")
    person.rests_at(1, 0, 0)
    person.page.keyboard.down("Enter")
    person.waits("grbl.machine[0] > 5")
    person.page.keyboard.up("Enter")
    at = person.machine.report()[1][0]
    assert person.machine.report("Idle")[1][0] < at + 4
    person.page.focus("#tabs [data-tab=job]")
    person.page.keyboard.press("ArrowRight")
    assert person.page.is_visible("#log")


def test_a_job_that_is_ended_keeps_the_position(person):
    person.loads(FAR)
    person.click("#run")
    person.sees("Run")
    person.pauses(1)
    person.click("#end")
    person.reads("#job-words", "it was ended; the position is kept")
    person.sees("Idle")
    assert person.shown_place()[0] > 1
    assert sent_at_once(person.machine) == b"!\x18"


def test_signs_that_act_at_once_do_not_leave_comments(person):
    person.loads("G21 (wait! ~ really?)\n; what? ~!\nG0 X1 (ümlaut)\n")
    person.click("#run")
    person.reads("#job-words", "Job done: nothing refused")
    assert {"G21", "G0 X1"} <= set(person.machine.lines())
    assert not sent_at_once(person.machine)


def test_a_sign_that_acts_at_once_in_the_code_is_not_sent(person):
    person.loads("G21\nG0 X1!\n")
    person.click("#run")
    person.reads("#notice-trouble", "line 2: ! does not belong in a line")
    assert not sent_at_once(person.machine)


def test_ten_thousand_lines_stream_without_stalling(person_at):
    person = person_at(None, "--speed", "max")
    person.open_from_disk()
    person.connect()
    moves = "".join(f"G1 X{i % 100 / 10:.1f} Y{i % 70 / 10:.1f}\n" for i in range(10_000))
    person.loads(f"G21 G90 F3000\n{moves}")
    person.click("#run")
    person.page.wait_for_function(
        "document.getElementById('job-words').textContent.includes('done')", timeout=180_000
    )
    assert person.text("#job-words").startswith("Job done: nothing refused")
    assert sum(line.startswith("G1") for line in person.machine.lines()) == 10_000
    person.rests_at(9.9, 5.9, 0)


def test_the_machine_checks_a_program_and_nothing_moves(person):
    person.loads("G21 G90\nG1 X20 F600\nG999\nG1 X5\n")
    person.click("#check")
    person.reads("#problems", "Line 3 error:20")
    person.sees("Idle")
    assert person.shown_place() == [0, 0, 0]
    assert person.machine.lines().count("$C") == 2


def test_from_a_line_on_it_says_what_it_does_first_and_asks(person):
    person.loads("G21 G90\nM3 S500\nG0 Z5\nG1 X20 F2400\nG1 Z-2\nG1 Y10\nG1 X0\nG0 Z5\nM5\n")
    person.page.fill("#from", "6")
    person.click("#run")
    words = person.page.text_content("#dialog")
    for said in ("up to Z5", "spindle on: M3 S500", "across to X20", "down to Z-2 at 2400 mm/min"):
        assert said in words
    assert not any(line.startswith("G0") for line in person.machine.lines()), "it asks first"
    person.click("#dialog-yes")
    person.reads("#job-words", "Job done: nothing refused")
    lines = person.machine.lines()
    first = lines.index("G21 G90 G94 M5")
    assert lines[first + 1 : first + 7] == [
        "G0 Z5",
        "M3 S500",
        "G4 P4",
        "G0 X20",
        "G1 Z-2 F2400",
        "G1 G17 G21 G90 G94 S500",
    ]
    assert lines[first + 7] == "G1 Y10"
    person.rests_at(0, 10, 5)


@pytest.mark.parametrize(
    ("program", "line", "words"),
    [
        ("G2 X10 I5 F100\nX0 I-5\n", 2, "goes on with G2 of a line before"),
        ("G92 X5\nG0 X1\n", 2, "Line 1 sets offsets"),
        ("G55\nG0 X1\n", 2, "The program is in G55 by then, and the machine in G54"),
        ("G0 X1\n", 3, "has lines 1 to 1"),
    ],
)
def test_a_line_that_nobody_can_begin_with_is_refused_in_words(person, program, line, words):
    person.loads(program)
    person.page.fill("#from", str(line))
    person.click("#run")
    person.reads("#notice-trouble", words)
    assert "G21 G90 G94 M5" not in person.machine.lines()


# The console


def test_lines_have_a_history_and_answers_their_meaning(person):
    person.types("G1 X5")
    person.reads("#log", "error:22: The feed rate has not been set")
    person.types("M5")
    person.page.press("#line", "ArrowUp")
    person.page.press("#line", "ArrowUp")
    assert person.page.input_value("#line") == "G1 X5"
    person.page.press("#line", "ArrowDown")
    assert person.page.input_value("#line") == "M5"


def test_markup_is_shown_as_text(person):
    person.machine.say(b"[MSG:<img src=x onerror=alert(1)>]\r\n")
    person.reads("#log", "<img src=x onerror=alert(1)>")
    person.loads("G21 (<b id=evil>x</b>)\nG999 X<i id=evil>\n", "<b id=evil>.nc")
    person.machine.say(b"$99=<b id=evil>\r\n[G54:<b id=evil>]\r\nALARM:<b id=evil>\r\n")
    person.machine.say(b"<Run<b id=evil>|MPos:0.000,0.000,0.000|Pn:<b>>\r\n")
    person.pauses(0.5)
    assert not person.page.query_selector("#evil, img, main b b, #log b")
    assert "<b id=evil>" in person.text("#job-name")


# Settings


def test_a_setting_is_changed_and_kept(person):
    person.click("#tabs [data-tab=settings]")
    person.page.fill("[aria-label^='$110 Maximum rate X']", "2500")
    person.page.keyboard.press("Enter")
    person.reads("#settings-words", "$110=2500 is kept")
    person.waits("grbl.settings.get(110) === '2500.000'")
    person.page.fill("[aria-label^='$0 ']", "1")
    person.page.keyboard.press("Enter")
    person.reads("#settings-words", "error:6: The step pulse time")
    assert person.page.input_value("[aria-label^='$0 ']") == "10"


def test_settings_of_extras_have_their_meaning_unit_and_limits(person):
    person.machine.say(b"$33=5000\r\n$170=-0.500\r\n$143=800.000\r\n$802=0.000\r\nok\r\n")
    person.click("#tabs [data-tab=settings]")
    for words in (
        "Spindle PWM frequency, Hz",
        "X squaring offset, millimeters",
        "Motor current A, milliampere",
        "Maximum jerk Z, mm/sec^3How fast acceleration may change; 0: at once. (0 or more)",
        "Invert limit pins, booleanOff: switches pull their pins to ground when hit. (0 or 1)",
    ):
        person.reads("#settings", words)
    person.machine.say(b"$30=0\r\n$33=1\r\nok\r\n")
    person.reads("#settings", "Punch actuator down invert, boolean")


@pytest.mark.parametrize(("number", "value"), [(5, "2"), (3, "256"), (1, "1.5"), (100, "-1")])
def test_a_value_outside_of_a_settings_limits_is_not_sent(person, number, value):
    person.click("#tabs [data-tab=settings]")
    person.page.fill(f"[aria-label^='${number} ']", value)
    person.page.keyboard.press("Enter")
    person.reads("#settings-words", f"${number} may be 0 ")
    assert not [line for line in person.machine.lines() if line.startswith(f"${number}=")]


def test_nothing_is_asked_while_a_setting_is_written(person):
    person.machine.hears = False
    person.types("$110=2000")
    person.pauses(0.3)
    sent = bytes(person.machine.sent)
    assert sent.endswith(b"$110=2000\n")
    person.pauses(1)
    assert bytes(person.machine.sent) == sent


def test_settings_are_backed_up_compared_and_restored(person):
    person.click("#tabs [data-tab=settings]")
    with person.page.expect_download() as download:
        person.click("#backup")
    kept = Path(download.value.path()).read_text()
    assert "$110=3000.000 ; Maximum rate X, mm/min\n" in kept
    (person.folder / "kept.txt").write_text(kept.replace("$110=3000.000", "$110=2000.000"))
    person.page.set_input_files("#settings-file", str(person.folder / "kept.txt"))
    person.reads("#settings-words", "1 of 34 settings in kept.txt differ")
    assert person.page.locator("tr.differs").count() == 1
    person.click("#restore")
    person.reads("#dialog", "$110: 3000.000 becomes 2000.000")
    person.click("#dialog-yes")
    person.reads("#settings-words", "1 settings are restored")
    assert person.page.evaluate("grbl.settings.get(110)") == "2000.000"


def test_a_file_that_holds_no_settings_is_refused_with_its_line(person):
    person.click("#tabs [data-tab=settings]")
    (person.folder / "job.nc").write_text("G0 X1\n")
    person.page.set_input_files("#settings-file", str(person.folder / "job.nc"))
    person.reads("#settings-words", "Line 1 is no setting such as $100=250: G0 X1")


# Served


def test_served_it_connects_by_itself_and_passes_its_query_on(person_at):
    person = person_at(on={"bypass_csp": False})
    person.bridge.look = {
        "seconds": 75.0,
        "problems": [{"line": 2, "text": "error:20 - unsupported command", "code": 20}],
        "lines": 2,
        "times": [[1, 0], [2, 75]],
        "path": [[0, 0, 0, 0, 1, 0], [9, 9, 0, 1, 2, 600]],
    }
    person.open_served("?token=secret")
    person.sees("Idle")
    person.waits("grbl.settings.size > 30")
    person.loads("G1 X9 F600\nG999\n")
    person.reads("#job-words", "1 problem. It takes 1:15 min")
    person.reads("#problems", "Line 2 error:20 - unsupported command")
    assert person.bridge.looked["settings"]["110"] == "3000.000"
    assert {"/ws?token=secret", "/api/look?token=secret"} <= set(person.bridge.asked_for)
    person.click("#run")
    person.reads("#dialog", "There are problems")


def test_a_program_is_looked_at_where_it_will_run_and_again_when_zero_is_moved(person_at):
    person = person_at()
    person.bridge.look = {
        "seconds": 7.0,
        "problems": [],
        "lines": 1,
        "times": [[1, 7]],
        "path": [[-30, 0, 0, 0, 0, 0], [10, 0, 0, 0, 1, 500]],
    }
    person.open_served()
    person.sees("Idle")
    person.knows_all()
    person.types("G10 L2 P1 X-30 Z1.5")
    person.waits("String(grbl.work) === '30,0,-1.5' && !grbl.linesUnderWay")
    person.loads("G0 X10\n")
    person.reads("#job-words", "No problems. It takes 0:07 min")
    person.reads("#extent", "X 0 … 40   Y 0 … 0   Z -1.5 … -1.5")  # in work coordinates
    asked = person.bridge.looked
    assert asked["place"] == [0, 0, 0] and asked["offsets"]["G54"] == [-30, 0, 1.5]
    assert {"G54", "G21", "G90", "F0"} <= set(asked["modes"])
    assert set(asked["offsets"]) == {*(f"G5{n}" for n in range(4, 10)), "G28", "G30", "G92", "TLO"}
    person.click("#tabs [data-tab=job]")
    person.click("[aria-label='Set X to zero here']")
    person.waits("String(grbl.work) === '0,0,-1.5'")
    person.reads("#extent", "X -30 … 10")
    assert person.bridge.looked["offsets"]["G54"] == [0, 0, 1.5]
    count = person.bridge.asked_for.count("/api/look")
    person.pauses(1.5)
    assert person.bridge.asked_for.count("/api/look") == count == 2, "not for nothing"


def test_reports_in_inches_are_looked_at_in_millimetres(person_at):
    person = person_at({13: "1"})
    person.bridge.look = {"seconds": 1.0, "problems": [], "lines": 1, "times": [], "path": []}
    person.open_served()
    person.sees("Idle")
    person.knows_all()
    person.types("G21 G10 L2 P1 X25.4")
    person.types("G1 F254")
    person.waits("grbl.modes.includes('F10.0') && !grbl.linesUnderWay")
    person.loads("G0 X10\n")
    person.reads("#job-words", "It takes")
    asked = person.bridge.looked
    assert asked["offsets"]["G54"][0] == pytest.approx(25.4) and "F254" in asked["modes"]


def test_a_second_page_watches_until_it_takes_over(person_at):
    person = person_at()
    person.bridge.drives = False
    person.open_served()
    person.reads("#notice-watch", "Another browser drives this machine")
    person.machine.say(b"<Idle|MPos:1.000,2.000,3.000|FS:0,0>\r\n")
    person.waits("document.querySelector('#axes .value').textContent === '1.000'")
    assert not person.page.is_enabled("[data-jog='X+']") and not person.machine.sent
    person.click("#take")
    person.waits("grbl.settled && grbl.modes.length")
    person.click("[data-jog='X+']")
    person.rests_at(1, 0, 0)
    person.click("#give")
    person.reads("#notice-watch", "Nobody drives")


def test_stop_on_a_page_that_watches_takes_over_first(person_at):
    person = person_at()
    person.bridge.drives = False
    person.open_served()
    person.reads("#notice-watch", "STOP works here, too")
    person.click("#stop")
    person.waits("grbl.drives")
    assert person.machine.sent.startswith(b"\x18")


def test_a_server_that_goes_is_said_and_found_again(person_at):
    person = person_at()
    person.open_served()
    person.sees("Idle")
    person.machine.unplug()
    person.reads("#notice-lost", "The connection is lost: the server does not answer")
    person.sees("Idle")
    person.waits("!document.getElementById('notice-lost')")


# How it looks


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_cut_off_on_a_phone(person_at, scheme):
    screen = {"width": 360, "height": 640}
    person = person_at(HOMING, on={"viewport": screen, "color_scheme": scheme, "has_touch": True})
    person.open_from_disk()
    person.connect("Alarm")
    person.machine.say(b"ALARM:9\r\n")
    person.click("#tabs [data-tab=job]")
    person.loads(f"(a comment {'that does not end ' * 9})\nG1 X99999.999 F100\n")
    for tab in ("machine", "job", "console", "settings", "offsets"):
        person.click(f"#tabs [data-tab={tab}]")
        person.pauses(0.2)
        person.page.screenshot(path=person.folder / f"{scheme}-{tab}.png", full_page=True)
        assert person.page.evaluate("document.documentElement.scrollWidth") <= 360
        assert not person.page.evaluate(_CUT_OFF)
        box = person.page.locator("#stop").bounding_box()
        assert box["height"] >= 40 and 0 <= box["y"] < 640 - 40


# Controls that reach over the screen's edge, outside of what can be scrolled sideways.
_CUT_OFF = """[...document.querySelectorAll("button, input, .file")]
    .filter((element) => element.offsetParent && !element.closest("[style*=overflow-x], #tabs"))
    .filter((element) => element.getBoundingClientRect().right > innerWidth + 0.5)
    .map((element) => element.outerHTML)"""


def test_buttons_are_large_enough_for_a_finger(person):
    small = person.page.evaluate(
        "[...document.querySelectorAll('button')].filter((button) => button.offsetParent)"
        ".filter((button) => button.offsetHeight < 40).map((button) => button.outerHTML)"
    )
    assert not small


def test_every_field_and_button_has_a_name(person):
    nameless = person.page.evaluate(
        "[...document.querySelectorAll('main button, main input, header button')].filter("
        "(element) => !element.textContent && !element.labels?.length && !element.ariaLabel)"
        ".map((element) => element.outerHTML)"
    )
    assert not nameless


def test_the_path_is_turned_and_zoomed_without_a_fault(person):
    person.loads(FAR)
    person.click("#turn")
    person.page.hover("#plot")
    person.page.mouse.down()
    person.page.mouse.move(700, 500)
    person.page.mouse.up()
    person.page.mouse.wheel(0, -300)
    person.click("#fit")
    assert re.search(r"X 0 … 40", person.text("#extent"))


# Files on the board


@pytest.fixture
def keeper(person_at, tmp_path):
    """At a board that keeps jobs."""
    board = tmp_path / "my.py"
    jobs = tmp_path / "jobs"
    board.write_text((BOARDS / "rpi_pico.py").read_text() + f'\nJOBS = "{jobs}"\n')
    made = person_at({20: "0"}, "--board", str(board))
    made.open_from_disk()
    made.connect()
    return made


PART = "G21 G91\n\n; done? not yet!\n(ok)\nG1 X3 F1200\nG1 X-1\n"


def test_a_program_is_sent_to_the_board_opened_from_there_run_and_deleted(keeper):
    long = PART + "".join(f"(line {n} {'x' * (n % 50)})\n" for n in range(200))
    keeper.loads(long, "my part.nc")
    keeper.click("#board-files")
    keeper.reads("#files-words", "kB")
    keeper.click("#upload")
    keeper.reads("#files-words", "MY_PART.NC is on the board.")
    assert (keeper.folder / "jobs" / "MY_PART.NC").read_text() == long
    keeper.loads("G0 X1\n")
    keeper.click("[aria-label='Open MY_PART.NC']")
    keeper.reads("#job-name", "MY_PART.NC")
    assert keeper.page.evaluate("program.lines") == long.splitlines()
    keeper.click("[aria-label='Run MY_PART.NC on the board']")
    keeper.reads("#dialog", "The board runs it by itself")
    keeper.click("#dialog-yes")
    keeper.rests_at(2, 0, 0)
    keeper.click("[aria-label='Delete MY_PART.NC']")
    keeper.click("#dialog-yes")
    keeper.reads("#files-words", "MY_PART.NC is deleted.")
    assert not list((keeper.folder / "jobs").glob("*.NC"))
    assert not keeper.page.query_selector("#notice-trouble")


def test_a_job_of_the_board_is_shown_with_its_progress(keeper):
    (keeper.folder / "jobs").mkdir(exist_ok=True)
    (keeper.folder / "jobs" / "LONG.NC").write_text("G21 G91 F600\n" + "G1 X1\nG1 X-1\n" * 20)
    keeper.click("#board-files")
    keeper.click("[aria-label='Run LONG.NC on the board']")
    keeper.click("#dialog-yes")
    keeper.reads("#job-words", "The board runs LONG.NC, ")
    keeper.click("#stop")
    keeper.sees("Alarm")


def test_a_machine_that_keeps_no_files_says_so(person):
    person.click("#board-files")
    person.reads("#files-words", "This machine keeps no files.")
    assert not person.page.is_visible("#upload")
    assert not person.page.query_selector("#notice-trouble")
