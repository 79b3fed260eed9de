"""Test jogs in two axes, Z with its own step and feed, and jogs by dragging in the drawing.

`said` are the bytes that the machine has sent; jogs() returns the jog lines ($J) of the page. The
machine accelerates with 500 mm/s².

browser.py says what a person, a homer and the page's `grbl` and `job` are.
"""

import pytest
from browser import sent_at_once

pytestmark = [pytest.mark.xdist_group("page moves"), pytest.mark.thorough]


def jogs(person):
    return [line for line in person.machine.lines() if line.startswith("$J")]


# Diagonals


def test_diagonal_tap_steps_both_axes(person):
    person.page.fill("#jog-feed", "3000")
    person.click("[data-jog='X-Y+']")
    person.rests_at(-1, 1, 0)
    assert jogs(person) == ["$J=G21 G91 X-1 Y1 F3000"]


def test_held_diagonal_moves_both_axes_equally_and_stops_on_release(person):
    """A held diagonal button moves at the set feed along the path until it is released."""
    person.page.fill("#jog-feed", "1200")
    person.press("[data-jog='X+Y-']")
    person.waits("grbl.machine[0] > 4")
    first_byte = len(person.machine.said)
    person.waits("grbl.machine[0] > 30")
    feeds_mm_min = [feed for _, _, feed in person.machine.reports(first_byte)]
    # A loaded computer may send a piece late now and then.
    # Two thirds of the reports show at least 95 % of the feed.
    assert len(feeds_mm_min) > 4 and sorted(feeds_mm_min)[len(feeds_mm_min) // 3] > 0.95 * 1200, (
        "along the diagonal"
    )
    person.page.mouse.up()
    x, y, _ = person.machine.report("Idle")[1]  # machine position, mm
    assert 30 < x < 55 and y == pytest.approx(-x, abs=0.01)
    assert set(sent_at_once(person.machine)) == {0x85}  # a jog cancel
    person.pauses(0.3)
    assert person.machine.report()[1][:2] == [x, y]


def test_held_diagonal_ends_at_first_soft_limit(homer):
    """Y has only 10 mm of travel, so it ends the diagonal jog.

    X stops with it, without an alarm.
    """
    homer.homes()
    homer.types("$20=1")  # soft limits on
    homer.types("$131=10")  # Y travels from 0 to -10 mm
    homer.types("$$")
    homer.waits("grbl.setting(20) === 1 && grbl.setting(131) === 10")
    homer.page.fill("#jog-feed", "1200")
    homer.press("[data-jog='X-Y-']")
    homer.waits("grbl.machine[1] < -9 && grbl.state === 'Idle'")
    homer.page.mouse.up()
    x, y, _ = homer.machine.report("Idle")[1]
    # The page stops 0.01 mm before the limit; both axes began at -1 mm.
    assert y == pytest.approx(-9.99, abs=0.01) and x == pytest.approx(y, abs=0.02)
    assert b"error" not in homer.machine.said and b"ALARM" not in homer.machine.said


def test_two_arrow_keys_jog_diagonally_until_one_is_released(person):
    """Releasing one of two arrow keys stops the jog; the other key starts no new one."""
    person.page.fill("#jog-feed", "1200")
    person.click("#keys")
    person.page.keyboard.down("ArrowRight")
    person.page.keyboard.down("ArrowUp")
    person.waits("grbl.machine[0] > 4")
    person.page.keyboard.up("ArrowRight")
    x, y, _ = person.machine.report("Idle")[1]
    assert 4 < x < 30 and y == pytest.approx(x, abs=0.01)
    person.page.keyboard.up("ArrowUp")
    person.pauses(0.5)
    assert person.machine.report()[1][:2] == [x, y], "it is no tap"


# Z


def test_z_has_its_own_step_and_feed(person):
    """Step and feed of Z apply to its buttons and to `Go to Z0`, those of X and Y to theirs."""
    person.page.select_option("#z-step", "0.1")
    person.page.fill("#z-feed", "60")
    person.click("#steps >> text='10'")  # mm, of X and Y
    person.click("[data-jog='Z-']")
    person.rests_at(0, 0, -0.1)
    person.click("[data-jog='X+']")
    person.rests_at(10, 0, -0.1)
    person.click("[aria-label='Go to Z0']")
    person.rests_at(10, 0, 0)
    assert jogs(person) == [
        "$J=G21 G91 Z-0.1 F60",
        "$J=G21 G91 X10 F500",  # X and Y have their own feed, 500 mm/min by default
        "$J=G21 G90 Z0 F60",
    ]


# By the drawing


def tool_on_screen(person):
    """Return where the tool is drawn, in px of the page."""
    box = person.page.locator("#tool").bounding_box()
    x, y = person.page.evaluate("plot.pixel(plot.place)")
    return box["x"] + x, box["y"] + y


def px_per_mm(person):
    """Return the scale of the drawing."""
    return person.page.evaluate("plot.pixel([1, 0, 0])[0] - plot.pixel([0, 0, 0])[0]")


def drags_tool(person, x_mm, y_mm):
    """Press on the tool in the drawing and drag it by x_mm and y_mm; the button stays down."""
    start_px, scale = tool_on_screen(person), px_per_mm(person)
    person.page.mouse.move(*start_px)
    person.page.mouse.down()
    person.page.mouse.move(start_px[0] + x_mm * scale, start_px[1] - y_mm * scale, steps=5)


def test_machine_follows_dragged_tool_and_stays_there(person):
    """The machine jogs to where the tool is dragged, and follows again when it is dragged on."""
    person.page.fill("#jog-feed", "2400")
    person.click("#drag")
    drags_tool(person, 12, 9)
    person.waits("Math.hypot(grbl.machine[0] - 12, grbl.machine[1] - 9) < 0.5")
    target_mm = person.page.evaluate("plot.target")
    person.waits("grbl.state === 'Idle'")
    assert person.machine.report()[1][:2] == pytest.approx(target_mm, abs=0.02)
    # The pointer goes back to the tool, still pressed.
    person.page.mouse.move(*tool_on_screen(person))
    jogs_before = len(jogs(person))
    # 5 mm to the right and down: Y decreases.
    person.page.mouse.move(*[px + 5 * px_per_mm(person) for px in tool_on_screen(person)])
    person.waits("grbl.machine[1] < 5.5 && grbl.state === 'Idle'")
    assert len(jogs(person)) > jogs_before
    person.page.mouse.up()
    assert person.page.evaluate("plot.target") is None


def test_release_of_dragged_tool_stops_jog(person):
    """Released early, the tool stops by a jog cancel, short of the target 40 mm away."""
    person.page.fill("#jog-feed", "600")
    person.click("#drag")
    drags_tool(person, 40, 0)
    person.waits("grbl.machine[0] > 3")
    person.page.mouse.up()
    x_mm = person.machine.report("Idle")[1][0]
    assert 3 < x_mm < 20
    assert set(sent_at_once(person.machine)) == {0x85}
    person.pauses(0.3)
    assert person.machine.report()[1][0] == x_mm


def test_jog_to_dragged_tool_stops_by_itself_when_page_sends_no_more(person):
    """The tab crashes during a drag, so no jog cancel is sent.

    The machine executes the jogs that it has received and stops.
    """
    person.page.fill("#jog-feed", "1200")
    person.click("#drag")
    drags_tool(person, 45, 20)
    person.waits("grbl.machine[0] > 10")
    person.crash()
    x, y, _ = person.machine.report()[1]
    end_x, end_y, _ = person.machine.report("Idle")[1]
    moved_mm = ((end_x - x) ** 2 + (end_y - y) ** 2) ** 0.5
    # Braking from 20 mm/s with 500 mm/s², and 0.5 s of motion that may be queued.
    assert moved_mm < 20**2 / 2 / 500 + 20 * 0.5, "the distance that docs/web.md states"
    assert b"\x85" not in person.machine.sent


def test_stop_ends_dragged_jog(person):
    """STOP resets the machine during a drag; after it no further jog is sent."""
    person.page.fill("#jog-feed", "600")
    person.click("#drag")
    drags_tool(person, 40, 0)
    person.sees("Jog")
    person.page.keyboard.press("Escape")  # STOP
    person.sees("Alarm")
    person.page.mouse.up()
    jogs_before = jogs(person)
    person.pauses(0.5)
    assert jogs(person) == jogs_before and b"\x18" in person.machine.sent


def test_drawing_is_panned_without_motion_until_dragging_is_switched_on(person):
    """Dragging pans the drawing.

    After #drag is switched on, dragging the tool, and only the tool, moves the machine.
    """
    zero_px = person.page.evaluate("plot.pixel([0, 0, 0])")
    drags_tool(person, 10, 0)
    person.page.mouse.up()
    person.pauses(0.3)
    # Work zero is drawn elsewhere now.
    assert person.page.evaluate("plot.pixel([0, 0, 0])") != zero_px and not jogs(person)
    person.click("#drag")
    x_px, y_px = tool_on_screen(person)
    person.page.mouse.move(x_px + 60, y_px + 60)  # not on the tool
    person.page.mouse.down()
    person.page.mouse.move(x_px + 90, y_px + 60)
    person.page.mouse.up()
    person.pauses(0.3)
    assert not jogs(person)


def test_dragged_point_stays_within_soft_limits(homer):
    """A target outside the travel is moved to its edge: X stays, Y goes 5 mm."""
    homer.homes()
    homer.types("$20=1")  # soft limits on
    homer.types("$$")
    homer.waits("grbl.setting(20) === 1")
    homer.click("#tabs [data-tab=job]")
    homer.page.fill("#jog-feed", "2000")
    homer.click("#drag")
    drags_tool(homer, 30, -5)  # mm; X is at -1 and would leave the travel at 0
    homer.waits("grbl.machine[1] < -5.9 && grbl.state === 'Idle'")
    homer.page.mouse.up()
    x, y, _ = homer.machine.report("Idle")[1]
    assert x == pytest.approx(-0.01, abs=0.01) and y == pytest.approx(-6, abs=0.1)
    assert b"error" not in homer.machine.said


def test_held_jog_replaces_longer_one(person):
    """Its pieces would else begin where `Go to X0 Y0` ends, and not where the tool is."""
    person.page.fill("#jog-feed", "600")
    person.types("$J=G91 X40 F6000")
    person.rests_at(40, 0, 0)
    person.click("#go-zero")
    person.waits("grbl.work[0] < 38")
    person.press("[data-jog='X+']")
    person.pauses(2)
    person.page.mouse.up()
    assert person.shown_place()[0] > 35


def test_keys_move_point_and_enter_goes_there_while_held(person):
    """With the focus on the drawing, arrow keys move a target.

    The machine jogs there while Enter is held.
    """
    person.page.fill("#jog-feed", "600")
    person.click("#keys")  # arrows would jog elsewhere
    person.click("#steps >> text='10'")
    person.click("#drag")
    person.page.focus("#plot")
    for key in ("ArrowRight", "ArrowRight", "ArrowUp"):
        person.page.keyboard.press(key)
    person.reads("#drag-words", "X20 Y10")
    person.pauses(0.3)
    assert not jogs(person)
    person.page.keyboard.down("Enter")
    person.waits("grbl.machine[0] > 2")
    person.page.keyboard.up("Enter")
    x, y, _ = person.machine.report("Idle")[1]
    assert 2 < x < 15 and y == pytest.approx(x / 2, abs=0.01)
    # The target is moved from where the machine stopped.
    person.waits(f"Math.abs(grbl.machine[0] - {x}) < 0.001 && grbl.state === 'Idle'")
    person.page.keyboard.press("ArrowLeft")
    person.page.keyboard.down("Enter")
    person.waits(f"grbl.machine[0] < {x - 9.9} && grbl.state === 'Idle'")
    person.page.keyboard.up("Enter")
    assert person.machine.report()[1][:2] == pytest.approx([x - 10, y], abs=0.02)
