"""Test `ugrbl web --sim` with a browser, from the first click to the last.

With UGRBL_PICTURES=1 (`make pictures`) the pictures of the page in docs/pictures are written
again.

The server `web` and its simulated mill serve all tests of this file. A visit() opens its page in a
new browser, as a `Visitor`. The mill has 150 mm of travel on each axis; homed, it stands at -1 mm
on each. job.made is the number of lines executed.

browser.py says what a person, a homer and the page's `grbl` and `job` are.
"""

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import Visitor, settings_file
from ugrbl import paths
from ugrbl.docs import pictures
from web_process import Web

pytestmark = [pytest.mark.xdist_group("served page"), pytest.mark.thorough]

MILL = {
    **dict.fromkeys((110, 111, 112), "6000.000"),
    **dict.fromkeys((130, 131, 132), "150.000"),
    20: "1",
    22: "1",
    24: "600.000",
    25: "6000.000",
}
EXAMPLE = paths.EXAMPLES / "badge.nc"
FROM_LINE = 2300
DESKTOP = {"width": 1200, "height": 800}
PHONE = {"width": 390, "height": 844}
Visit = Callable[..., Visitor]


@pytest.fixture(scope="module")
def web(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Web]:
    """Start the server with a simulated mill, once for all tests.

    Each test finds the state that the one before left.
    """
    file = settings_file(tmp_path_factory.mktemp("mill"), MILL)
    running = Web("--sim", "--no-browser", "--settings", str(file))
    yield running
    running.close()


@pytest.fixture
def visit(opened: Any, web: Web, tmp_path: Path) -> Iterator[Visit]:
    """Return a function that opens the page in a new browser.

    At the end the fixture checks that no script has failed.
    """
    contexts: list[Any] = []
    visitors: list[Visitor] = []

    def open_page(address: str = "", **screen: Any) -> Visitor:
        contexts.append(opened.new_context(**{"viewport": DESKTOP, **screen}))
        visitors.append(Visitor(contexts[-1].new_page(), tmp_path))
        visitors[-1].page.goto(address or web.address)
        return visitors[-1]

    yield open_page
    for context in contexts:
        context.close()
    assert not [fault for visitor in visitors for fault in visitor.faults], "the script failed"


def make_idle(visitor: Visitor) -> Visitor:
    """Bring the machine from any state to Idle; its position is then undefined."""
    visitor.waits("grbl.drives && grbl.state")
    # Resets the machine and waits for its welcome and a status report.
    reset_and_wait = "grbl.on('welcome', () => grbl.on('status', done)); grbl.reset()"
    visitor.page.evaluate(f"new Promise((done) => {{ {reset_and_wait} }}).then(() => 0)")
    if visitor.page.evaluate("grbl.state") == "Alarm":
        visitor.click("#unlock")
    visitor.sees("Idle")
    visitor.knows_all()
    return visitor


def opens_example(visitor: Visitor) -> None:
    visitor.page.set_input_files("#job-file", str(EXAMPLE))
    visitor.reads("#job-words", "It takes 9 min")


def compare_screenshot(visitor: Visitor, name: str) -> None:
    """Compare a screenshot with the saved picture of that name.

    With UGRBL_PICTURES set, the picture is replaced first.
    """
    screenshot = visitor.folder / name
    visitor.page.screenshot(path=screenshot)
    small = visitor.folder / f"small-{name}"
    pictures.shrink(screenshot, small, greys=True)
    assert small.stat().st_size < pictures.MOST_BYTES
    if os.environ.get("UGRBL_PICTURES"):
        pictures.renew(small, pictures.FOLDER / name)
    assert pictures.same(small, pictures.FOLDER / name), "make pictures"


def jog_to_the_corner(person: Visitor) -> None:
    """Jog by taps from the switches to a corner of the stock and set zero there."""
    person.page.fill("#jog-feed", "6000")
    # From -1 mm: X and Y by 2 * 50 + 3 * 10 mm, Z by 2 * 10 mm.
    for step, axes, times in ((50, "XY", 2), (10, "XY", 3), (10, "Z", 2)):
        person.click(f"#steps >> text='{step}'")
        for axis in axes * times:
            person.click(f"[data-jog='{axis}-']")
            person.waits("!grbl.linesUnderWay")
    person.waits("grbl.state === 'Idle' && String(grbl.machine) === '-131,-131,-21'")
    person.click("#zero-all")
    person.rests_at(0, 0, 0)


def test_pins_are_chosen_in_drawing_without_board(visit: Visit) -> None:
    """The setup needs no board at the computer: pins of a known board are shown in the drawing."""
    person = visit(viewport={"width": 1200, "height": 1000})
    person.click("#tabs [data-tab=setup]")
    person.click("#setup-steps [data-step=board]")
    person.click("#board-cards b:text-is('pico_gantry')")
    person.reads("#pins-says", "No rule is broken")
    # The step output of motor 3, counted from 0.
    assert person.page.input_value("#pin-19") == "STEP 3"
    compare_screenshot(person, "page_pins.png")


def test_example_runs_from_first_click_to_last(visit: Visit, web: Web) -> None:
    """A whole session, from homing to the end.

    The simulator is killed during the job, which is then continued from a line.
    """
    person = visit()
    person.sees("Alarm")
    person.reads("#state-words", "Locked")  # until it is homed
    person.knows_all()
    person.homes()
    jog_to_the_corner(person)
    opens_example(person)
    person.reads("#job-words", "No problems")

    person.click("#run")
    person.sees("Run")
    person.waits("job?.line > 20")
    person.click("#hold")
    person.reads("#state-words", "At rest")
    held_mm = person.place()
    person.reads("#job-words", "Held: line ")
    assert person.place() == held_mm
    person.click("#resume")
    person.click("[aria-label='Feed +10 %']")
    person.reads("#ov-feed", "110 %")
    person.waits("job?.line > 25")

    (simulator,) = web.children()
    os.kill(simulator, signal.SIGKILL)  # like unplugging
    person.reads("#notice-lost", "The job stopped in line ")
    person.reads("#notice-lost", "A spindle stays on")
    person.sees("Not connected")
    assert 25 < person.page.evaluate("job.line") < 100
    person.sees("Alarm")  # restarted, so its position is lost
    assert not person.page.query_selector("#notice-lost")
    person.homes()
    person.rests_at(130, 130, 20)  # by the stored work zero

    person.page.fill("#from", str(FROM_LINE))
    person.click("#run")
    person.reads("#dialog", "spindle on: M3 S12000")
    person.click("#dialog-yes")
    person.waits(f"job?.line > {FROM_LINE + 15}")
    compare_screenshot(person, "page.png")
    person.click("#end")
    person.reads("#job-words", "it was ended; the position is kept")
    person.sees("Idle")


SLOW = "G21 G91\nG1 X-40 F600\nG1 X20\nG1 X20\n"


def test_travel_violation_is_shown_before_run(visit: Visit) -> None:
    """The preview names lines that would leave the travel.

    They are no longer named once zero or the travel is changed so that the program fits.
    """
    person = homed_at_zero(visit())
    person.loads("G21 G90\nG0 X-10\nX-20 Y30\n")
    # Zero is at -1 mm, so Y30 is +29 mm, beyond the end at 0.
    person.reads("#problems", "Line 3 ALARM:2 - Y would go to 29.000 mm in machine coordinates")
    person.reads("#job-words", "1 problem.")
    person.types("G10 L20 P1 Y50")
    person.click("#tabs [data-tab=job]")
    person.reads("#job-words", "No problems.")
    person.types("$130=5")  # 5 mm of travel: the page knows it at once
    person.click("#tabs [data-tab=job]")
    person.reads("#problems", "Line 2 ALARM:2 - X would go to")
    person.types("$130=150")
    person.click("#tabs [data-tab=job]")
    person.reads("#job-words", "No problems.")
    person.click("#run")
    person.reads("#job-words", "Job done: nothing refused")


def test_second_browser_watches_until_it_takes_over(visit: Visit) -> None:
    """A phone shows the motion of the first browser, then takes control and jogs.

    The first browser watches then.
    """
    first = make_idle(visit())
    first.homes()
    phone = visit(viewport=PHONE, color_scheme="dark", has_touch=True, is_mobile=True)
    phone.reads("#notice-watch", "Another browser drives this machine")
    assert not phone.page.is_enabled("[data-jog='X-']")
    first.reads("#link-words", "1 watching")
    first.click("[data-jog='X-']")
    phone.waits("grbl.machine[0] === -2 && grbl.state === 'Idle'")  # -1 mm and a step of 1 mm
    phone.click("#take")  # takes control
    phone.knows_all()
    first.reads("#notice-watch", "Another browser drives this machine")
    assert not first.page.is_enabled("#hold")
    phone.page.tap("[data-jog='X+']")
    phone.waits("String(grbl.machine) === '-1,-1,-1' && grbl.state === 'Idle'")
    first.waits("String(grbl.machine) === '-1,-1,-1'")
    compare_screenshot(phone, "page_phone.png")


def long_job() -> str:
    """Return 40 lines, far more than the planner holds, and a last one that shows they all ran."""
    return "G21 G91 F1200\n" + "G1 X-2\nG1 X1\n" * 20 + "G1 Y-3\n"


def test_page_reloaded_in_job_finds_it_held_and_continues(visit: Visit) -> None:
    """The server holds the machine when the browser that sends a job is lost, here by a reload.

    The job, stored on the server, can be continued.
    """
    person = make_idle(visit())
    person.homes()
    person.loads(long_job())
    person.reads("#job-words", "It takes")
    person.click("#run")
    person.waits("job?.made > 8")
    person.page.on("dialog", lambda dialog: dialog.accept())  # confirms leaving the page
    person.page.reload()
    person.sees("Hold")
    person.waits("grbl.drives")
    person.reads("#job-name", "job.nc, 42 lines")
    person.reads("#job-words", "the browser that sent it has gone")
    assert not person.page.is_enabled("#resume") and not person.page.is_enabled("#run")
    lines_made = person.page.evaluate("job.made")
    assert 8 < lines_made < 42
    person.click("#go-on")
    person.waits(f"job.made > {lines_made}")
    person.reads("#job-words", "Job done: nothing refused")
    # -1 mm, less 20 mm in X and 3 mm in Y.
    person.waits("grbl.state === 'Idle' && String(grbl.machine) === '-21,-4,-1'")


def test_job_is_visible_to_all_and_continued_after_takeover(visit: Visit) -> None:
    """A second browser sees the job of the first, takes control, and continues it."""
    first, second = make_idle(visit()), visit()
    first.homes()
    first.loads(long_job(), "other.nc")
    second.reads("#job-name", "other.nc, 42 lines")
    first.reads("#job-words", "It takes")
    first.click("#run")
    second.waits("job?.made > 8")
    second.reads("#job-words", " of 42, ")
    assert not second.page.is_enabled("#end")
    second.click("#take")
    first.reads("#job-words", "the browser that sent it has gone")
    assert not first.page.is_enabled("#go-on")
    second.click("#go-on")
    second.reads("#job-words", "Job done: nothing refused")
    # -1 mm, less 20 mm in X and 3 mm in Y.
    second.waits("grbl.state === 'Idle' && String(grbl.machine) === '-21,-4,-1'")
    first.reads("#job-words", "Job done: nothing refused")


def test_line_refused_before_takeover_is_shown_to_next_client(visit: Visit) -> None:
    """A page reloaded in a job is shown a line that was refused meanwhile.

    The answer itself went to the page before.
    """
    person = make_idle(visit())
    person.homes()
    person.loads("G21 G91 F300\n" + "G1 X-2\nG1 X2\n" * 12 + "G999\nG1 Y-3\n")
    person.reads("#problems", "Line 26 error:20")
    person.click("#run")
    person.click("#dialog-yes")  # runs it in spite of the problem
    person.sees("Run")
    person.page.on("dialog", lambda dialog: dialog.accept())
    person.page.reload()
    person.sees("Hold")
    # Line 26, which is refused, is not reached yet.
    person.waits("grbl.drives && job?.state === 'left' && job.line < 26")
    person.click("#go-on")
    person.reads("#job-words", "was refused. error:20")
    person.click("#go-on")
    person.reads("#job-words", "Job done: 1 line refused")
    person.waits("grbl.state === 'Idle' && String(grbl.machine) === '-1,-4,-1'")


def test_page_closed_in_jog_ends_jog(visit: Visit) -> None:
    """The server cancels a held jog when its browser is closed."""
    person, watcher = make_idle(visit()), visit()
    person.homes()
    person.press("[data-jog='X-']")
    watcher.waits("grbl.state === 'Jog' && grbl.machine[0] < -3")
    person.page.close()
    watcher.sees("Idle")
    assert -20 < watcher.page.evaluate("grbl.machine[0]") < -3


def test_browser_from_network_needs_token(visit: Visit) -> None:
    """A server open to the network requires the token of the address that it has printed."""
    guarded = Web("--sim", "--no-browser", "--host", "0.0.0.0")
    try:
        port = guarded.address.partition("?")[0].rstrip("/").rpartition(":")[2]
        token = guarded.address.partition("?")[2]  # "token=..."
        stranger = visit(f"http://127.0.0.1:{port}/?token=guessed")
        assert "the token is missing or wrong" in stranger.text("body")
        owner = visit(f"http://127.0.0.1:{port}/?{token}")
        owner.sees("Idle")
        owner.knows_all()
        owner.click("[data-jog='X+']")
        owner.rests_at(1, 0, 0)
        owner.loads("G21\nG1 X9 F600\n")
        owner.reads("#job-words", "No problems")
    finally:
        guarded.close()


# Tool changes, times


def homed_at_zero(person: Visitor) -> Visitor:
    """Take control, home, and set zero there."""
    make_idle(person)
    person.homes()
    person.click("#zero-all")
    person.rests_at(0, 0, 0)
    return person


def reloads_and_goes_on(person: Visitor) -> None:
    """Reload the page in a tool change, and go on with the job up to this change."""
    person.page.on("dialog", lambda dialog: dialog.accept())
    person.page.reload()
    person.reads("#job-words", "the browser that sent it has gone")
    person.waits("document.getElementById('tool-change').hidden && grbl.drives")
    person.click("#go-on")
    person.waits("!document.getElementById('tool-change').hidden")


def test_page_reloaded_in_tool_change_pauses_again(visit: Visit) -> None:
    """A page reloaded during a tool change offers the job again, and asks for the tool again."""
    person = homed_at_zero(visit())
    person.loads("G21 G91 F1200\nG1 X-3\nT4 M6 (drill 3 mm)\nG1 X-2\n", "tools.nc")
    person.reads("#job-words", "No problems. It takes")
    person.reads("#job-words", "Tool changes: 1.")
    person.click("#run")
    person.reads("#tool-title", "tool 4")
    person.waits("!document.getElementById('tool-change').hidden")
    person.reads("#tool-sends", "G1 G17 G21 G91")  # the modes that are restored after the change
    person.pauses(0.5)
    compare_screenshot(person, "page_tool_change.png")
    reloads_and_goes_on(person)
    # -1 mm, less 3 mm; the move after the change is not made yet.
    assert person.page.evaluate("grbl.machine[0]") == -4
    person.click("#tool-go")
    person.reads("#job-words", "Job done: nothing refused")
    person.waits("grbl.state === 'Idle' && String(grbl.machine) === '-6,-1,-1'")


def test_machine_moved_before_reload_in_tool_change_returns_to_its_place(visit: Visit) -> None:
    """The page that takes the job up knows place and modes of the pause from the page before."""
    person = homed_at_zero(visit())
    person.loads("G21 G91 F1200 M3 S700\nG1 X-3\nT4 M6\nG1 X-2\n", "tools.nc")
    person.click("#run")
    person.waits("!document.getElementById('tool-change').hidden")
    pause = person.page.evaluate("toolPause")
    person.types("G90 G0 X0")
    person.waits("grbl.modes.includes('G90')")
    reloads_and_goes_on(person)
    assert person.page.evaluate("toolPause") == pause
    assert person.page.evaluate("toolChangeLines().join()").endswith(
        "G0 X-3 Y0,M3 S700,G4 P4,F1200 S700,G1 G17 G21 G91"
    )


ZIGZAG = "G21 G90 F6000\n" + "".join(f"G1 X{-9 * (k % 2)} Y{-k}\n" for k in range(1, 17))


def seconds(text: str) -> int:
    """Return the seconds in a duration of less than a minute."""
    assert text.endswith(" s") and "min" not in text
    return int(text[:-2])


def with_zigzag(person: Visitor) -> Visitor:
    """Take control, home, set zero there, and load the program."""
    homed_at_zero(person)
    person.loads(ZIGZAG)
    person.reads("#job-words", "It takes")
    return person


def test_estimated_and_real_time_are_shown_side_by_side(visit: Visit) -> None:
    """The page shows the time so far, the estimated total, and the real duration at the end."""
    person = with_zigzag(visit())
    person.click("#run")
    person.waits("job?.made > 10")
    so_far_s, all_s = seconds(person.text("#time-here")), seconds(person.text("#time-all"))
    assert 1 <= so_far_s < all_s == round(person.page.evaluate("program.look.seconds"))
    person.reads("#job-words", "Job done")
    assert person.text("#time-here") == person.text("#time-all")
    assert all_s - 1 <= seconds(person.text("#time-real")) <= all_s + 4, "the machine is exact"


def test_what_if_estimates_with_other_settings_and_leaves_machine_alone(visit: Visit) -> None:
    """'What if' estimates the program with other settings, and sends nothing to the machine."""
    person = with_zigzag(visit())
    before = person.page.evaluate("[...grbl.settings]")
    estimate_s = person.page.evaluate("program.look.seconds")
    person.click("#what-if summary")
    person.click("#what-if-go")
    person.reads("#what-if-says", "Change a number first.")
    # Every line that the page sends from now on.
    person.page.evaluate("window.sent = []; grbl.on('sent', ({ text }) => sent.push(text))")
    person.page.fill("[aria-label^='What if $120,']", "4000")
    person.page.keyboard.press("Enter")
    person.reads("#what-if-says", "$120=4000: ")
    answer = person.page.text_content("#what-if-says li")
    # A higher acceleration saves more than 1 s.
    assert seconds(answer.split(": ")[1].split(",")[0]) < estimate_s - 1 and "less" in answer
    person.page.fill("[aria-label^='What if $110,']", "600")
    person.page.keyboard.press("Enter")
    person.reads("#what-if-says", "$110=600 $120=4000: ")
    assert "more" in person.page.text_content("#what-if-says li")
    assert person.page.locator("#what-if-says li").count() == 3  # the message and two answers
    person.page.fill("[aria-label^='What if $110,']", "0")
    person.page.keyboard.press("Enter")
    person.reads("#what-if-says", "$110 wants a number of more than 0.")
    assert person.page.evaluate("sent") == []
    person.types("$$")
    person.waits("!grbl.linesUnderWay")
    assert person.page.evaluate("[...grbl.settings]") == before
