"""Test the page with a headless browser and the simulator, which runs the exact firmware.

`person_at(settings, *options, on=...)` makes a person with such $-settings of the machine, options
of the simulator, and options of the browser. `person.bridge` is the server of the page: `look` is
its scripted answer to a request for a preview, `looked` the last request.

browser.py says what a person, a homer and the page's `grbl` and `job` are.
"""

import re
from pathlib import Path

import pytest
from browser import CUT_OFF, FAR, HOMING, sent_at_once
from ugrbl.grbl.messages import meaning

pytestmark = [pytest.mark.xdist_group("page"), pytest.mark.thorough]


# Connecting


@pytest.mark.sampled(1)
def test_nothing_is_sent_before_connecting_and_only_queries_after(person_at):
    """The page sends nothing before Connect, then only queries: $I, $$, $G and $#."""
    person = person_at()
    person.open_from_disk()
    person.reads("#state-words", "press Connect")
    person.pauses(0.5)
    assert not person.machine.sent and person.text("#state-name") == "Not connected"
    person.connect()
    person.pauses(1)
    assert set(person.machine.lines()) == {"$I", "$$", "$G", "$#"}
    assert not sent_at_once(person.machine)  # no realtime byte except ?


def test_state_position_and_modes_are_shown(person):
    assert person.place() == [0, 0, 0]
    assert person.text("#modes").startswith("G0 G54 G17 G21 G90 G94 M5")
    assert person.page.evaluate("grbl.window") == 127


def test_without_web_serial_page_says_what_to_do(person_at):
    """A browser without Web Serial shows an explanation instead of a Connect button."""
    person = person_at()
    person.page.add_init_script("delete Navigator.prototype.serial")
    person.page.goto(_page_uri())
    person.reads("#notices", "This browser cannot open a USB port")
    assert not person.page.is_visible("#connect")


def _page_uri():
    from bridge import PAGE

    return PAGE.as_uri()


def test_machine_that_does_not_answer_is_reported(person_at):
    """The port opens, but no answer comes: the page says so and offers no jog."""
    person = person_at()
    person.machine.hears = False
    person.open_from_disk()
    person.click("#connect")
    person.sees("No answer")
    # No jog is offered.
    assert not person.page.is_enabled("[data-jog='X+']")


def test_unplugging_in_job_is_reported_and_reconnecting_works(person):
    """The cable is pulled during a job.

    The machine executes what it has received, and Connect opens the port again.
    """
    # A program of some seconds.
    person.loads(FAR.replace("F600", "F1200"))
    person.click("#run")
    person.sees("Run")
    person.machine.unplug()
    person.reads("#notice-lost", "The connection is lost")
    person.reads("#notice-lost", "The job stopped in line")
    person.reads("#notice-lost", "A spindle stays on")
    person.sees("Not connected")
    person.click("#connect")
    person.sees("Run")  # it executes the lines already received
    person.sees("Idle")
    person.waits("grbl.settled && !document.getElementById('notice-lost')")
    assert person.page.evaluate("portsOpened") == 2  # the stand-in's count of opened USB ports


def test_disconnecting_shows_no_warning(person):
    """Only a connection that is lost, not one that is closed on purpose, gives a warning."""
    person.click("#disconnect")
    person.sees("Not connected")
    assert not person.page.query_selector("#notice-lost")
    person.click("#connect")
    person.sees("Idle")


# The console


def test_console_has_history_and_explains_answers(person):
    """Errors are shown with their meaning; the arrow keys recall earlier lines."""
    person.types("G1 X5")
    person.reads("#log", "error:22: The feed rate has not been set")
    person.types("M5")
    person.page.press("#line", "ArrowUp")
    person.page.press("#line", "ArrowUp")
    assert person.page.input_value("#line") == "G1 X5"
    person.page.press("#line", "ArrowDown")  # towards the newest line
    assert person.page.input_value("#line") == "M5"


def test_markup_is_shown_as_text(person):
    """HTML in messages, files, settings and reports is shown as text, never interpreted."""
    person.machine.say(b"[MSG:<img src=x onerror=alert(1)>]\r\n")
    person.reads("#log", "<img src=x onerror=alert(1)>")
    person.loads("G21 (<b id=evil>x</b>)\nG999 X<i id=evil>\n", "<b id=evil>.nc")
    person.machine.say(b"$99=<b id=evil>\r\n[G54:<b id=evil>]\r\nALARM:<b id=evil>\r\n")
    person.machine.say(b"<Run<b id=evil>|MPos:0.000,0.000,0.000|Pn:<b>>\r\n")
    person.pauses(0.5)
    assert not person.page.query_selector("#evil, img, main b b, #log b")
    assert "<b id=evil>" in person.text("#job-name")


# Settings


def test_setting_is_changed_and_stored(person):
    """A value typed in the settings is sent. The page then shows what the machine has stored."""
    person.click("#tabs [data-tab=settings]")
    person.page.fill("[aria-label^='$110 Maximum rate X']", "2500")
    person.page.keyboard.press("Enter")
    person.reads("#setting-110", "2500 is kept")
    person.waits("grbl.settings.get(110) === '2500.000'")


def test_refused_setting_is_shown_in_its_row_and_keeps_typed_text(person):
    """The machine refuses $0=1 and $20=1.

    The reasons stand in their rows until a value is accepted.
    """
    person.click("#tabs [data-tab=settings]")
    person.page.fill("[aria-label^='$0 ']", "1")  # 1 µs is too short
    person.page.keyboard.press("Enter")
    person.reads("#setting-0", "1 was not taken: error:6: The step pulse time")
    person.reads("#setting-0", "It is still 10.")
    assert person.page.input_value("[aria-label^='$0 ']") == "1"
    # Tries to switch soft limits on, while homing is off.
    person.page.click("[aria-label^='$20 ']")
    person.reads("#setting-20", "1 was not taken: error:10: Soft limits ($20) need homing")
    assert not person.page.is_checked("[aria-label^='$20 ']"), "it is not on"
    person.page.fill("[aria-label^='$0 ']", "5")
    person.page.keyboard.press("Enter")
    person.reads("#setting-0", "5 is kept")
    assert not person.page.query_selector("#notice-trouble")


def test_switch_is_checkbox_and_mask_is_checkbox_per_axis(person):
    """$5 is on or off; $3 and $10 are bit masks, shown as one checkbox for each bit."""
    person.click("#tabs [data-tab=settings]")
    person.page.check("[aria-label='$5 Invert limit pins']")
    person.reads("#setting-5", "1 is kept")
    assert person.page.is_checked("[aria-label='$5 Invert limit pins']")
    for axis in "XZ":
        person.page.check(f"[aria-label='$3 Step direction invert, {axis}']")
        # Bit 0 is X, bit 2 is Z.
        person.reads("#setting-3", {"X": "1 is kept", "Z": "5 is kept"}[axis])
    assert not person.page.is_checked("[aria-label='$3 Step direction invert, Y']")
    # $10 was 1, machine position; without that bit reports give the work position.
    person.page.uncheck("[aria-label='$10 Status report options, machine position']")
    person.waits("grbl.settings.get(10) === '0' && grbl.placeIs === 'WPos'")
    lines = [line for line in person.machine.lines() if line[:2] in ("$5", "$3", "$1")]
    assert lines == ["$5=1", "$3=1", "$3=5", "$10=0"]


def test_bits_without_name_stay_unchanged(person):
    """A bit of a mask that the page has no name for is sent back as it was."""
    person.types("$10=5")  # bit 0: machine position; bit 2 has no name in the page
    person.waits("grbl.settings.get(10) === '5'")
    person.click("#tabs [data-tab=settings]")
    person.page.check("[aria-label='$10 Status report options, buffer state']")
    person.reads("#setting-10", "7 is kept")  # 5 and bit 1, the buffer state


def test_setting_typed_in_console_is_shown_at_once(person):
    """Settings that a program has changed are shown, too."""
    person.types("$110=1234")
    person.waits("grbl.settings.get(110) === '1234.000'")
    person.types("$RST=$")  # restores the defaults
    person.waits("grbl.settings.get(110) === '500.000'")
    person.loads("$111=777\nG0 X1\n")  # a program that changes a setting
    person.click("#run")
    person.waits("grbl.settings.get(111) === '777.000'")
    person.types("$112=-1")  # refused, so nothing is read again
    person.reads("#log", "error:4")
    person.pauses(0.5)
    # $$ was sent on connecting and after each of the three changes that were accepted.
    assert person.machine.lines().count("$$") == 4, "only where one was taken"


def test_settings_of_extras_have_meaning_unit_and_limits(person):
    """The names of settings depend on which other settings the machine has."""
    # As if the machine had these settings of extras, such as a laser, a gantry and jerk limits.
    person.machine.say(b"$33=5000\r\n$170=-0.500\r\n$143=800.000\r\n$802=0.000\r\nok\r\n")
    person.click("#tabs [data-tab=settings]")
    for words in (
        "Spindle PWM frequency, Hz",
        "X squaring offset, millimeters",
        "Motor current A, milliampere",
        "Maximum jerk Z, mm/sec^3How fast acceleration may change; 0: at once. (0 or more)",
        "Invert limit pinsOff: switches pull their pins to ground when hit.",
    ):
        person.reads("#settings", words)
    person.machine.say(b"$30=0\r\n$33=1\r\nok\r\n")
    person.reads("#settings", "Punch actuator down invert")


@pytest.mark.parametrize(("number", "value"), [(0, "256"), (1, "1.5"), (100, "-1")])
def test_value_outside_limits_is_not_sent(person, number, value):
    """The page itself refuses the value: it stays in its field and no line is sent."""
    person.click("#tabs [data-tab=settings]")
    person.page.fill(f"[aria-label^='${number} ']", value)
    person.page.keyboard.press("Enter")
    person.reads(f"#setting-{number}", f"{value} was not taken: it may be 0 ")
    assert person.page.input_value(f"[aria-label^='${number} ']") == value
    assert not [line for line in person.machine.lines() if line.startswith(f"${number}=")]


def test_nothing_is_queried_while_setting_is_written(person):
    """Until the machine answers to $110=..., the page sends nothing, not even `?`."""
    person.machine.hears = False  # so the setting is never answered
    person.types("$110=2000")
    person.pauses(0.3)
    sent = bytes(person.machine.sent)
    assert sent.endswith(b"$110=2000\n")
    person.pauses(1)
    assert bytes(person.machine.sent) == sent


def test_settings_are_saved_compared_and_restored(person):
    """A backup is saved.

    A file that differs in one setting is compared with the machine and restored.
    """
    person.click("#tabs [data-tab=settings]")
    with person.page.expect_download() as download:
        person.click("#backup")
    saved_text = Path(download.value.path()).read_text()
    assert "$110=3000.000 ; Maximum rate X, mm/min\n" in saved_text
    # The saved file, with one setting changed, is opened again.
    (person.folder / "kept.txt").write_text(saved_text.replace("$110=3000.000", "$110=2000.000"))
    person.page.set_input_files("#settings-file", str(person.folder / "kept.txt"))
    person.reads("#settings-words", "1 of 34 settings in kept.txt differ")
    assert person.page.locator("tr.differs").count() == 1
    person.click("#restore")
    person.reads("#dialog", "$110: 3000.000 becomes 2000.000")
    person.click("#dialog-yes")
    person.reads("#settings-words", "1 settings are restored")
    assert person.page.evaluate("grbl.settings.get(110)") == "2000.000"


def test_file_without_settings_is_refused_with_its_line(person):
    person.click("#tabs [data-tab=settings]")
    (person.folder / "job.nc").write_text("G0 X1\n")
    person.page.set_input_files("#settings-file", str(person.folder / "job.nc"))
    person.reads("#settings-words", "Line 1 is no setting such as $100=250: G0 X1")


# Served by `ugrbl web`


def test_served_page_connects_by_itself_and_passes_query_on(person_at):
    """A page from a server connects without a click.

    Its own query, with the token, is part of each request that it sends.
    """
    # With the content security policy of the served page.
    person = person_at(on={"bypass_csp": False})
    person.bridge.look = {
        "seconds": 75.0,
        "problems": [{"line": 2, "text": "error:20 - unsupported command", "code": 20}],
        "lines": 2,
        # times: [line, seconds at its end]; path: x, y, z in mm, kind (0 rapid, 1 feed), line,
        # mm/min.
        "times": [[1, 0], [2, 75]],
        "path": [[0, 0, 0, 0, 1, 0], [9, 9, 0, 1, 2, 600]],
    }
    person.open_served("?token=secret")
    person.sees("Idle")
    person.waits("grbl.settings.size > 30")
    person.loads("G1 X9 F600\nG999\n")
    person.reads("#job-words", "1 problem. It takes 1 min 15 s")
    person.reads("#problems", "Line 2 error:20 - unsupported command")
    assert person.bridge.looked["settings"]["110"] == "3000.000"
    assert {"/ws?token=secret", "/api/look?token=secret"} <= set(person.bridge.asked_for)
    person.click("#run")
    person.reads("#dialog", "There are problems")


def test_program_longer_than_the_travel_is_marked(person_at):
    """The extent of a program is compared with the travel, wherever work zero is."""
    person = person_at()
    person.open_from_disk()
    person.connect()
    person.knows_all()
    person.loads("G21 G90\nG0 X0\nG0 X150\n")  # within the travel of 200 mm ($130)
    person.reads("#extent", "X 0 … 150")
    assert "travel" not in person.text("#extent")
    person.loads("G21 G90\nG0 X0\nG0 X150\nG0 X-100\n")  # each end is within $130, but not both
    person.reads("#extent", "longer than the travel: X")


def test_program_is_previewed_at_its_position_and_again_after_zero_moves(person_at):
    """The request for a preview states position, offsets and modes.

    It is repeated when zero is set anew, and only then.
    """
    person = person_at()
    person.bridge.look = {
        "seconds": 7.0,
        "problems": [],
        "lines": 1,
        "times": [[1, 7]],
        # In machine coordinates; work zero will be at X-30.
        "path": [[-30, 0, 0, 0, 0, 0], [10, 0, 0, 0, 1, 500]],
    }
    person.open_served()
    person.sees("Idle")
    person.knows_all()
    person.types("G10 L2 P1 X-30 Z1.5")
    person.waits("String(grbl.work) === '30,0,-1.5' && !grbl.linesUnderWay")
    person.loads("G0 X10\n")
    person.reads("#job-words", "No problems. It takes 7 s")
    person.reads("#extent", "X 0 … 40   Y 0 … 0   Z -1.5 … -1.5")  # in work coordinates
    request = person.bridge.looked
    assert request["place"] == [0, 0, 0] and request["offsets"]["G54"] == [-30, 0, 1.5]
    assert {"G54", "G21", "G90", "F0"} <= set(request["modes"])
    assert set(request["offsets"]) == {
        *(f"G5{n}" for n in range(4, 10)),
        "G28",
        "G30",
        "G92",
        "TLO",
    }
    person.click("#tabs [data-tab=job]")
    person.click("[aria-label='Set X to zero here']")
    person.waits("String(grbl.work) === '0,0,-1.5'")
    person.reads("#extent", "X -30 … 10")
    assert person.bridge.looked["offsets"]["G54"] == [0, 0, 1.5]
    count = person.bridge.asked_for.count("/api/look")
    person.pauses(1.5)
    assert person.bridge.asked_for.count("/api/look") == count == 2, "only after a change"


def test_reports_in_inches_are_previewed_in_millimetres(person_at):
    """Offsets and feed are reported in inches and sent to the preview in mm."""
    person = person_at({13: "1"})  # $13=1: the machine reports in inches
    person.bridge.look = {"seconds": 1.0, "problems": [], "lines": 1, "times": [], "path": []}
    person.open_served()
    person.sees("Idle")
    person.knows_all()
    person.types("G21 G10 L2 P1 X25.4")
    person.types("G1 F254")
    person.waits("grbl.modes.includes('F10.0') && !grbl.linesUnderWay")  # 254 mm/min in inches
    person.loads("G0 X10\n")
    person.reads("#job-words", "It takes")
    request = person.bridge.looked
    assert request["offsets"]["G54"][0] == pytest.approx(25.4) and "F254" in request["modes"]


def test_second_page_watches_until_it_takes_over(person_at):
    """A page that does not control the machine only shows it; after taking control it jogs."""
    person = person_at()
    # The server does not let this page control the machine at first.
    person.bridge.drives = False
    person.open_served()
    person.reads("#notice-watch", "Another browser drives this machine")
    report = b"<Idle|MPos:1.000,2.000,3.000|FS:0,0%b>\r\n"
    person.machine.say(report % b"")
    person.sees("Idle")
    # MPos alone gives no work position: the page shows dashes until an offset (WCO) is reported.
    assert person.page.locator("#axes .value").all_text_contents() == ["\u2013"] * 3, (
        "no offset yet"
    )
    person.machine.say(report % b"|WCO:0.000,0.000,0.000")
    person.waits("document.querySelector('#axes .value').textContent === '1.000'")
    assert not person.page.is_enabled("[data-jog='X+']") and not person.machine.sent
    person.click("#take")
    person.waits("grbl.settled && grbl.modes.length")
    person.click("[data-jog='X+']")
    person.rests_at(1, 0, 0)
    person.click("#give")
    person.reads("#notice-watch", "Nobody drives")


def test_stop_on_watching_page_takes_over_first(person_at):
    """STOP on a watching page takes control and then sends the reset."""
    person = person_at()
    # The server does not let this page control the machine at first.
    person.bridge.drives = False
    person.open_served()
    person.reads("#notice-watch", "STOP works here, too")
    person.click("#stop")
    person.waits("grbl.drives")
    assert person.machine.sent.startswith(b"\x18")  # the reset


def test_lost_server_is_reported_and_reconnected(person_at):
    """A page from a server connects again by itself."""
    person = person_at()
    person.open_served()
    person.sees("Idle")
    person.machine.unplug()  # the page reconnects by itself
    person.reads("#notice-lost", "The connection is lost: the server does not answer")
    person.sees("Idle")
    person.waits("!document.getElementById('notice-lost')")


# Layout


@pytest.mark.parametrize("width", [390, 320])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_nothing_is_cut_off_on_phone(person_at, scheme, width):
    """Long texts do not widen any tab, and STOP stays large and on the screen."""
    screen = {"width": width, "height": 640}
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
        assert person.page.evaluate("document.documentElement.scrollWidth") <= width
        assert not person.page.evaluate(CUT_OFF)  # controls beyond the right edge
        box = person.page.locator("#stop").bounding_box()
        assert box["height"] >= 60 and box["width"] >= 60 and 0 <= box["y"] <= 640 - 60


@pytest.mark.parametrize("size", [(1280, 800), (1920, 1080)])
def test_all_parts_of_job_are_visible_on_desktop(person_at, size):
    """The drawing takes the remaining height; the list of lines fills its space."""
    width, height = size
    person = person_at(on={"viewport": {"width": width, "height": height}})
    person.open_from_disk()
    person.connect()
    person.loads("M3 S12000\n" + "".join(f"G1 X{k / 20} F1200\n" for k in range(2000)))
    person.click("#run")
    person.waits("job.made > 1 && grbl.modes.includes('S12000') && grbl.modes.includes('F1200')")
    assert person.page.evaluate("document.documentElement.scrollHeight") <= height
    names = ["#ov-feed", "#ov-spindle", "#m5", "#flood", "#end", "#jog-feed", "#lines .now"]
    # The box of each element in px: top, bottom, width, height.
    boxes = person.page.evaluate(_BOXES, [*names, "#plot", "#lines"])
    for name in names:
        assert boxes[name]["top"] >= 0 and boxes[name]["bottom"] <= height, name
    assert boxes["#plot"]["width"] * boxes["#plot"]["height"] > 0.24 * width * height
    assert boxes["#lines"]["height"] > 12 * boxes["#lines .now"]["height"]
    person.click("#stop")


@pytest.mark.parametrize("width", [860, 1024, 1199])
def test_all_job_controls_are_visible_on_small_desktop(person_at, width):
    """All controls of a running job are on the screen without scrolling."""
    person = person_at(on={"viewport": {"width": width, "height": 800}})
    person.open_from_disk()
    person.connect()
    person.loads("M3 S12000\n" + "".join(f"G1 X{k / 20} F1200\n" for k in range(2000)))
    person.click("#run")
    person.waits("job.made > 1")
    names = ["#ov-feed", "#ov-spindle", "#m5", "#flood", "#end", "#bar", "#jog-feed"]
    for name, box in person.page.evaluate(_BOXES, names).items():
        assert box["top"] >= 0 and box["bottom"] <= 800 and box["right"] <= width, name
    assert person.page.evaluate("document.documentElement.scrollWidth") <= width
    person.click("#stop")


def test_refusal_by_custom_py_is_not_explained_as_command(person_at, tmp_path):
    """error:3 after M100 means that the handler refused.

    After a $ command it means an unknown one.
    """
    custom = tmp_path / "custom.py"
    custom.write_text(
        "from ugrbl import Refuse, mcode\n\n\n"
        "@mcode(100)\ndef close(m):\n    raise Refuse('close the door')\n"
    )
    person = person_at({}, "--custom", str(custom))
    person.open_from_disk()
    person.connect()
    person.types("M100")
    person.reads("#log", "[MSG:close the door]")
    person.reads("#log", f"error:3: {meaning('error:3', 'M100')}")
    person.types("$999=1")
    person.reads("#log", f"error:3: {meaning('error:3')}")


def test_disabled_controls_give_reason(person):
    """A disabled button states the reason in its tooltip; no longer once it is enabled."""
    assert person.page.get_attribute("#home", "title").startswith("Homing is off: $22=1")
    assert person.page.is_visible("#home-off")
    assert person.page.get_attribute("#run", "title") == "No file is open."
    person.types("$22=1")
    person.waits("!document.querySelector('#home').disabled")
    assert person.page.get_attribute("#home", "title") == ""
    assert not person.page.is_visible("#home-off")


_BOXES = """(names) => Object.fromEntries(names.map((name) =>
    [name, document.querySelector(name).getBoundingClientRect().toJSON()]))"""

# Controls that extend past the right edge of the screen, outside of parts that scroll sideways.


def test_buttons_are_large_enough_for_finger(person):
    """Every visible button is at least 40 px high."""
    small = person.page.evaluate(
        "[...document.querySelectorAll('button')].filter((button) => button.offsetParent)"
        ".filter((button) => button.offsetHeight < 40).map((button) => button.outerHTML)"
    )
    assert not small


def test_every_field_and_button_has_name(person):
    """A control needs a text, a label or an aria-label."""
    nameless = person.page.evaluate(
        "[...document.querySelectorAll('main button, main input, header button')].filter("
        "(element) => !element.textContent && !element.labels?.length && !element.ariaLabel)"
        ".map((element) => element.outerHTML)"
    )
    assert not nameless


def test_path_is_rotated_and_zoomed_without_fault(person):
    """The fixture fails the test if the page's script raises an error."""
    person.loads(FAR)
    person.click("#turn")  # switches dragging to rotation
    person.page.hover("#plot")
    person.page.mouse.down()
    person.page.mouse.move(700, 500)
    person.page.mouse.up()
    person.page.mouse.wheel(0, -300)
    person.click("#fit")
    assert re.search(r"X 0 … 40", person.text("#extent"))
