"""Test tool changes of a job: by the page, where the machine refuses M6, and by custom.py.

The machine refuses M6, so the page pauses the job there: pauses_at_change() runs a job up to this,
goes_on() confirms the change. _JOB is at X20 Y4 Z5 when it comes to T2 M6 in line 8, and ends at
X0 Y0 Z5.

browser.py says what a person, a homer and the page's `grbl` and `job` are.
"""

import pytest
from ugrbl.paths import EXAMPLES

pytestmark = [pytest.mark.xdist_group("page jobs"), pytest.mark.thorough]

_JOB = (
    "G21 G90\nG0 Z5\nM3 S800\nG0 X10 Y4\nG1 Z-1 F600\nG1 X20\nG0 Z5\n"
    "T2 M6 (drill 3 mm)\nM3 S900\nG1 X12 Z3\nX6\nG0 Z5\nG0 X0 Y0\nM2\n"
)


def pauses_at_change(person, job=_JOB):
    """Run the program and wait for its first tool change."""
    person.page.fill("#jog-feed", "3000")
    person.loads(job)
    person.click("#run")
    person.waits("!document.getElementById('tool-change').hidden")


def goes_on(person):
    """Confirm the tool change and wait until the job continues, maybe up to the next change."""
    person.page.evaluate("window.confirmed = toolPause")
    person.click_at_once("#tool-go")
    person.waits("toolPause !== confirmed")


def programs_lines(person):
    """Return the lines sent, without questions for the state."""
    return [line for line in person.machine.lines() if line not in ("$G", "$#")]


def test_page_pauses_where_machine_refuses_m6_and_goes_on_after_confirmation(person):
    """The page waits at T2 M6 with spindle and coolant off.

    After confirmation it restores the modes and the job goes on to its end.
    """
    pauses_at_change(person)
    person.rests_at(20, 4, 5)
    person.reads("#tool-title", "Tool change: tool 2")
    person.reads("#tool-words", "line 8: T2 M6 (drill 3 mm)")
    person.reads("#job-words", "Tool change in line 8 of 14")
    person.waits("grbl.modes.includes('M5')")
    lines = programs_lines(person)
    # Refused, then spindle and coolant off; no hold.
    assert lines[-2:] == ["T2 M6", "M5 M9"] and "!" not in lines
    person.pauses(0.5)
    assert programs_lines(person) == lines, "it waits"
    goes_on(person)
    person.reads("#job-words", "Job done: nothing refused")
    person.rests_at(0, 0, 5)
    lines = programs_lines(person)
    assert lines.count("T2 M6") == 1
    # The modes are restored, T2 is sent without M6, and the program goes on.
    assert lines[lines.index("G0 G17 G21 G90") + 1 :][:2] == ["T2", "M3 S900"]


def test_machine_is_jogged_and_zeroed_in_change_and_returns_to_its_place(person):
    """During a change the machine may be jogged and Z set to zero for the new tool.

    It then returns over the work, first up, then across.
    """
    pauses_at_change(person)
    assert person.page.is_enabled("[data-jog='X+']") and person.page.is_enabled("#home") is False
    assert not person.page.is_enabled("#run"), "no second job"
    person.click("#steps >> text='10'")
    person.click("[data-jog='X-Y+']")
    person.rests_at(10, 14, 5)  # from X20 Y4 by a step of 10 mm
    person.click("[data-jog='Z-']")
    person.rests_at(10, 14, -5)
    person.reads("#tool-up", "Raise Z to 5")
    person.click("[aria-label='Set Z to zero here']")
    person.reads("#tool-measured", "G54: 0.000,0.000,0.000 is 0.000,0.000,-5.000 now.")
    person.reads("#tool-sends", "G0 Z5, G0 X20 Y4, ")
    goes_on(person)
    person.reads("#job-words", "Job done: nothing refused")
    person.rests_at(0, 0, 5)
    lines = person.machine.lines()
    # Up before across.
    assert lines.index("G0 Z5", lines.index("T2 M6")) < lines.index("G0 X20 Y4")
    assert person.machine.report()[1] == [0, 0, 0], "machine coordinates of Z5 by the new zero"


def test_return_starts_from_zero_that_was_set_just_before_confirmation(person):
    """Z is set to zero at Z5 and the change is confirmed before the page has heard of either."""
    pauses_at_change(person)
    person.page.evaluate("grbl.send('G10 L20 P1 Z0'); document.getElementById('tool-go').click()")
    person.waits("document.getElementById('tool-change').hidden")
    person.reads("#job-words", "Job done: nothing refused")
    lines = person.machine.lines()
    assert "G0 Z5" in lines[lines.index("T2 M6") : lines.index("T2")]  # from Z0 now


def test_second_change_returns_to_its_own_place_if_machine_answers_at_once(person):
    """All answers between two changes come in one piece, so the page is not told of the job in
    between. It returned to the place of the first change."""
    pauses_at_change(person, "G21 G90\nT1 M6\nG0 Z5\nT2 M6\nG0 Z3\nM2\n")
    person.page.evaluate("""() => {
        const tell = grbl.tell;
        grbl.tell = (name, ...rest) => {
            if (name !== "change" || job.state !== "running") tell.call(grbl, name, ...rest);
        };
    }""")
    goes_on(person)
    person.reads("#tool-title", "Tool change: tool 2")
    person.waits("toolPause.place")
    assert person.page.evaluate("toolPause.place") == [0, 0, 5]


def test_confirmation_is_possible_while_page_asks_for_modes(person):
    pauses_at_change(person)
    script = "() => { grbl.send('$G', true); renderAll(); return $('tool-go').disabled; }"
    assert person.page.evaluate(script) is False


def test_nothing_moves_before_place_of_pause_is_noted(person):
    """In a pause the page asks for the offsets, then notes the place to which the tool returns: a
    jog in between would change it."""
    person.page.evaluate("""() => {
        window.early = [];
        const enabled = () => !$("go-zero").disabled || NEEDS.jog();
        grbl.on("status", () => {
            if (job?.state === "tool" && $("tool-change").hidden) early.push(enabled());
        });
    }""")
    pauses_at_change(person)
    early = person.page.evaluate("early")
    assert early and not any(early)
    person.waits("!$('go-zero').disabled")


def test_board_is_not_restarted_in_change(person):
    """A file for the board restarts it: the place of the pause would be another one then."""
    pauses_at_change(person)
    sent = len(person.machine.sent)
    says = person.page.evaluate("micropython.enter().then(() => '', ({ message }) => message)")
    assert says == "A job is running. End it first."
    assert b"\x03" not in person.machine.sent[sent:]  # Ctrl-C


def test_confirmation_while_probing_begins_sends_nothing(person):
    """Else its lines were between those of the probing: G90 before G38.2 Z-20."""
    pauses_at_change(person)
    person.page.evaluate("$('probe-run').click(); $('tool-go').click()")
    person.waits("grbl.state === 'Run'")
    assert programs_lines(person)[-2:] == ["G21 G91", "G38.2 Z-20 F100"]
    person.click("#stop")


def test_modes_are_restored_after_change(person):
    """The job has inches, relative moves and G54; other modes are set during the change."""
    job = "G20 G91 G1 F30\nX0.1\nM6\nX0.1\nY0.2\n"
    pauses_at_change(person, job)
    person.reads("#state", "IdleTool change in line 3 of 5.")
    person.types("G21 G90 G18 G55 G0")
    person.waits("grbl.modes.includes('G55')")
    goes_on(person)
    person.reads("#job-words", "Job done: nothing refused")
    person.waits("grbl.state === 'Idle' && Math.abs(grbl.machine[0] - 5.08) < 0.01")  # 0.2 inch
    assert person.machine.report()[1] == pytest.approx([5.08, 5.08, 0], abs=0.01)
    # F762 mm/min is 30 inch/min.
    assert {"G1", "G20", "G91", "G17", "G54", "F762"} <= set(_words_after(person, "M6"))


def _words_after(person, line):
    lines = person.machine.lines()
    return [word for text in lines[lines.index(line) :] for word in text.split()]


def test_spindle_is_restarted_if_program_would_cut_without(person):
    """The page restarts the spindle after a change if the program does not. It then waits 4 s."""
    pauses_at_change(person, "G21 G90 M3 S700\nG1 X2 F600\nT3 M6\nG0 X4\nX6 Z2\nG1 Z1\nM2\n")
    person.reads("#tool-sends", "M3 S700, G4 P4")
    goes_on(person)
    person.reads("#job-words", "Job done: nothing refused")
    lines = person.machine.lines()
    assert lines[lines.index("M5 M9") :].count("M3 S700") == 1


def test_laser_stays_off_after_change(person_at):
    """A laser is not switched on by the page as a spindle would be."""
    person = person_at({32: "1"})  # laser mode
    person.open_from_disk()
    person.connect()
    pauses_at_change(person, "G21 G90 M3 S700\nG1 X2 F600\nM6\nX6\n")
    goes_on(person)
    person.reads("#job-words", "Job done: nothing refused")
    assert not {"M3", "M4"} & set(_words_after(person, "M5 M9"))


def test_tool_length_is_measured_in_change(person_at):
    """The first change measures the reference, the second one the difference."""
    person = person_at({}, "--input", "probe=Z-12")  # the simulated probe closes at Z-12 mm
    person.open_from_disk()
    person.connect()
    pauses_at_change(person, "G21 G90\nT1 M6\nG0 Z5\nT2 M6\nG0 Z3\nM2\n")
    person.click("#tool-length")
    person.reads("#probe-words", "Over a fixed plate")
    person.page.fill("#probe-feed", "400")
    person.click("#probe-run")
    person.reads("#probe-says", "Done.")
    goes_on(person)
    person.waits("!document.getElementById('tool-change').hidden")
    person.page.evaluate("probeSet.reference -= 2")  # as if the first tool were 2 mm shorter
    person.click("#tool-length")
    person.click("#probe-run")
    person.reads("#probe-says", "Done.")
    person.reads("#tool-measured", "Tool length: 0.000 is 2.000 now.")
    goes_on(person)
    person.reads("#job-words", "Job done: nothing refused")
    person.waits("grbl.state === 'Idle' && Math.abs(grbl.work[2] - 3) < 0.001")
    # Z3 of the program with a tool length offset of 2 mm.
    assert person.machine.report()[1][2] == pytest.approx(5, abs=0.01)


def test_failed_measuring_does_not_end_job(person):
    """A probing that fails during a change ends in an alarm.

    After unlocking, the job continues.
    """
    pauses_at_change(person)
    person.click("#tool-plate")
    person.page.fill("#probe-far", "2")  # mm: no contact within them
    person.page.fill("#probe-feed", "1000")
    person.click("#probe-run")
    person.reads("#probe-says", "ALARM:5")
    assert not person.page.is_enabled("#tool-go")  # while in alarm
    person.click("#unlock")
    goes_on(person)
    person.reads("#job-words", "Job done: nothing refused")
    person.rests_at(0, 0, 5)


def test_stop_and_end_work_in_change(person):
    """The change can be left by End, and by STOP (Escape)."""
    pauses_at_change(person)
    person.click("#tool-end")
    person.reads("#job-words", "Job stopped in line")
    person.reads("#job-words", "it was ended; the position is kept")
    person.waits("document.getElementById('tool-change').hidden")
    person.sees("Idle")
    pauses_at_change(person, "M6\nG0 X1\n")
    person.page.keyboard.press("Escape")
    person.reads("#job-words", "STOP was pressed")
    person.waits("document.getElementById('tool-change').hidden")
    assert "G0 X1" not in person.machine.lines()


def test_check_reads_rest_of_line_and_all_other_lines(person):
    """A check leaves out M6 and checks the rest of its line.

    Only G999 in line 2 is a fault here.
    """
    person.loads("G21\nT2 M06 G999\nM6\nG1 X5 F100\nT3 M6\nM6\n")
    person.click("#check")
    person.reads("#problems", "Line 2 error:20")
    person.sees("Idle")
    person.reads("#job-words", "Check done: 1 line refused")
    assert person.page.locator("#problems li").count() == 1
    assert person.shown_place() == [0, 0, 0]


def test_other_refused_word_beside_m6_is_refused(person):
    pauses_at_change(person, "T2 M6 G999\nG0 X1\n")
    goes_on(person)
    person.reads("#job-words", "Line 1 was refused. error:20")


def test_change_by_custom_py_needs_no_page_and_shows_its_question(person_at):
    """With a handler of the tool change on the board M6 is accepted.

    The page only shows the question of the handler, and resumes.
    """
    custom = str(EXAMPLES / "custom" / "tool_length.py")
    person = person_at({}, "--custom", custom, "--input", "probe=Z-30")
    person.open_from_disk()
    person.connect()
    person.loads("G21 G90\nT2 M6\nG0 X1\nM2\n")
    person.click("#run")
    person.reads("#notice-pause", "Its last message: Put in tool 2, then cycle start")
    assert not person.page.is_visible("#tool-change")
    person.click("#notice-pause button")  # cycle start
    person.reads("#job-words", "Job done: nothing refused")
    assert not person.page.query_selector("#notice-pause")
    assert person.machine.lines().count("T2 M6") == 1


def test_preview_is_asked_without_m6(person_at):
    """The server is asked about the program without M6, which its simulated machine would refuse.

    Comments stay.
    """
    person = person_at()
    # The scripted answer: 9 s.
    person.bridge.look = {"seconds": 9.0, "problems": [], "lines": 3, "times": [], "path": []}
    person.open_served()
    person.sees("Idle")
    person.knows_all()
    person.loads("G0 X1 (M6)\nT2 M6 (drill)\nM6\n")
    person.reads("#job-words", "It takes 9 s. Tool changes: 2.")
    assert person.bridge.looked["program"] == "G0 X1 (M6)\nT2\n"
