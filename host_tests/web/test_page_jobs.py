"""Test programs in the page: sent from it, or stored on the board.

browser.py says what a person, a homer and the page's `grbl` and `job` are.
"""

import pytest
from browser import FAR, sent_at_once
from ugrbl.paths import BOARDS

pytestmark = [pytest.mark.xdist_group("page jobs"), pytest.mark.thorough]


# Jobs


def test_job_with_hold_and_override_ends_at_its_end_point(person):
    """Hold, Resume and a feed override do not change where a job ends."""
    person.loads("G21 G90\nG1 X20 F600\nG2 X0 Y0 R10\nG1 Z-3\nG1 X12.5 Y5\nM2\n")
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


def test_job_does_not_start_after_stop(person):
    """STOP comes while the page still gives the program to the server."""
    person.loads("G21 G90\nG0 X10\n")
    person.waits("!$('run').disabled")
    person.page.evaluate("() => { share = () => new Promise((end) => { shared = end; }); }")
    person.click("#run")
    person.waits("globalThis.shared")
    person.click("#stop")
    person.knows_all()
    person.page.evaluate("shared()")
    person.reads("#notice-trouble", "no answer: a reset")
    person.pauses(0.5)
    assert "G0 X10" not in person.machine.lines() and person.page.evaluate("job") is None


def test_ended_job_is_reset_though_a_line_is_refused_meanwhile(person):
    """The answer comes after End job: it must not become a pause, with the machine in Hold."""
    person.loads("G21 G90\nG1 X5 F600\nT2 M6\nG1 X9\n")
    person.page.evaluate("""() => {
        const answered = Job.prototype.answered;
        Job.prototype.answered = function (line, answer) {
            if (answer !== "ok") this.end();
            answered.call(this, line, answer);
        };
    }""")
    person.click("#run")
    person.reads("#job-words", "it was ended")
    person.knows_all()
    assert b"\x18" in person.machine.sent and "G1 X9" not in person.machine.lines()


def test_job_ends_when_page_does_not_drive_any_more(person):
    """Another one may move the machine meanwhile, so the rest must not follow by itself."""
    person.loads(10 * FAR.replace("F600", "F3000"))
    person.click("#run")
    person.sees("Run")
    change = "(drives) => { grbl.link.drives = drives; grbl.link.tell('driver'); }"
    person.page.evaluate(change, False)
    person.reads("#job-words", "This page does not drive the machine")
    sent = person.machine.lines().count("G21 G90")
    person.page.evaluate(change, True)
    person.waits("grbl.settled && grbl.state === 'Idle'")
    assert person.machine.lines().count("G21 G90") == sent < 10


def test_modes_are_updated_while_job_runs(person):
    """The page queries $G during a job and shows the modes of the lines executed."""
    person.loads("G21 G91\nM3 S500\nG1 X40 F600\n")
    person.click("#run")
    person.sees("Run")
    person.reads("#modes", "G1 G54 G17 G21 G91 G94 M3 M9 T0 F600 S500")
    person.click("#stop")


def test_refused_line_holds_machine_and_is_named(person):
    """A refused line ends the sending and holds the machine.

    The person decides whether the job goes on.
    """
    later_lines = "".join(f"G1 X{i}\n" for i in range(20, 4, -1))
    person.loads(f"G21 G90\nG1 X20 F2400\nG999\n{later_lines}{later_lines}G1 X5\n")
    person.click("#run")
    person.reads("#job-words", "Line 3 was refused. error:20: The block has a word")
    person.sees("Hold")
    sent_lines = person.machine.lines()
    person.pauses(0.5)
    # No further line is sent, and most of the program's 36 lines were not yet sent.
    assert person.machine.lines() == sent_lines and len(sent_lines) < 30
    assert not person.page.is_enabled("#resume"), "how to go on is asked"
    person.click("#go-on")
    person.reads("#job-words", "Job done: 1 line refused")
    person.rests_at(5, 0, 0)


def test_key_of_resume_does_not_resume_after_refused_line(person):
    """In Hold:0, stopped, the button is disabled: only `Go on without that line` and `End job`
    decide."""
    person.loads("G21 G90\nG1 X30 F600\nBAD\nG1 X0\n")
    person.click("#run")
    person.waits("job?.state === 'refused' && grbl.state === 'Hold' && grbl.detail === '0'")
    person.page.keyboard.press("~")
    person.pauses(0.5)
    assert person.machine.report()[0] == "Hold"


def test_refused_line_is_skipped_only_after_machine_has_stopped(person_at):
    """Grbl ignores a resume while it brakes for a hold."""
    person = person_at({120: "10"})  # X brakes with only 10 mm/s²
    person.open_from_disk()
    person.connect()
    person.loads("G21 G91 F2000\n" + "G1 X5\n" * 30 + "G999\nG1 X5\n")
    person.click("#run")
    person.reads("#job-words", "Line 32 was refused.")
    assert not person.page.is_enabled("#go-on"), "seconds of braking lie ahead"
    person.click("#go-on")  # waits until it is enabled
    person.reads("#job-words", "Job done: 1 line refused")
    person.rests_at(155, 0, 0)  # 31 moves of 5 mm


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
def test_file_that_is_no_program_is_refused_with_reason(person, name, content, words):
    """A refused file leaves the open program as it was; a valid file removes the message."""
    person.loads("G0 X1\n")
    (person.folder / name).write_bytes(content)
    person.page.set_input_files("#job-file", str(person.folder / name))
    person.reads("#notice-trouble", words)
    assert person.text("#job-name") == "job.nc, 1 lines"
    person.loads("G0 X2 (f\u00fcr)\n", "other.nc")
    assert not person.page.query_selector("#notice-trouble")


def test_file_that_is_read_while_job_begins_does_not_replace_it(person):
    """Else the page would go on sending the job, but could neither end nor follow it."""
    person.loads(FAR)
    person.waits("!$('run').disabled")
    person.page.evaluate("""() => {
        const read = new Promise((resolve) => setTimeout(() => resolve("G0 X-7"), 500));
        openJob({ name: "slow.nc", text: () => read });
        $("run").click();
    }""")
    person.reads("#notice-trouble", "A job is running")
    assert person.text("#job-name").startswith("job.nc") and person.page.evaluate("busy()")


def test_file_dropped_on_question_is_not_run_instead(person):
    """The way to line 3 of one program would lead into another one."""
    person.loads("G21 G90\nG0 Z2\nG1 X5 F600\nG0 Z5\n")
    person.page.fill("#from", "3")
    person.click("#run")
    person.waits("$('dialog').open")
    person.page.evaluate("""() => {
        const dataTransfer = new DataTransfer();
        dataTransfer.items.add(new File(["G21\\nG0 X1\\nG0 X2\\nG0 X44"], "other.nc"));
        $("dialog").dispatchEvent(new DragEvent("drop", { bubbles: true, dataTransfer }));
    }""")
    person.pauses(0.3)
    person.click("#dialog-yes")
    person.reads("#job-words", "Job done")
    assert "G0 X44" not in person.machine.lines() and "G1 X5 F600" in person.machine.lines()


def test_comment_in_other_encoding_is_accepted(person):
    """A file in Latin-1, with a letter that is no UTF-8, is run."""
    (person.folder / "old.nc").write_bytes("G0 X1 (f\u00fcr)\n".encode("latin-1"))
    person.page.set_input_files("#job-file", str(person.folder / "old.nc"))
    person.reads("#job-name", "old.nc")
    person.click("#run")
    person.rests_at(1, 0, 0)


def test_ended_job_keeps_position(person):
    """End stops a job without an alarm, so the position stays valid."""
    person.loads(FAR)
    person.click("#run")
    person.sees("Run")
    person.pauses(1)  # some motion
    person.click("#end")
    person.reads("#job-words", "it was ended; the position is kept")
    person.sees("Idle")
    assert person.shown_place()[0] > 1
    # Hold first, and a reset once it has stopped: no step is lost.
    assert sent_at_once(person.machine) == b"!\x18"


def test_job_ended_with_door_open_does_not_go_on(person):
    """End resets the machine also in the state Door: Resume would execute the lines it has."""
    person.loads(FAR)
    person.click("#run")
    person.waits("grbl.machine[0] > 2")
    person.machine.write(b"\x84")  # safety door
    person.sees("Door")
    person.click("#end")
    person.reads("#job-words", "it was ended; the position is kept")
    person.sees("Idle")


def test_ended_job_names_line_in_execution(person):
    """The line named at the end is the one executed, not the last one answered.

    Fifteen of these lines are queued in the machine.
    """
    stairs = [f"G1 {'XY'[k % 2]}{4 * (k // 2 + 1)}" for k in range(60)]
    person.loads("G21 G90 F900\n" + "\n".join(stairs) + "\n")
    person.click("#run")
    person.sees("Run")
    person.pauses(2)
    person.click("#end")
    person.reads("#job-words", "it was ended; the position is kept")
    person.sees("Idle")
    x, y, _ = person.shown_place()
    line_number = int(person.page.input_value("#from"))
    assert f"Job stopped in line {line_number}: " in person.text("#job-words")
    # File lines count from 1, and line 1 is the header: line 2 is stairs[0].
    assert _is_in(stairs[: line_number - 2], stairs[line_number - 2], x, y)


def _is_in(before: list[str], line: str, x: float, y: float) -> bool:
    """Return whether (x, y), in mm, is on `line` of the stairs, within 0.05 mm.

    `before` are the lines before it, each `G1 X<mm>` or `G1 Y<mm>`.
    """
    start_mm = {"X": 0.0, "Y": 0.0}
    # Of `G1 X12` [3] is the axis and [4:] the position in mm.
    start_mm.update({word[3]: float(word[4:]) for word in before})
    axis, end_mm = line[3], float(line[4:])
    along_mm, across_mm, other_axis = (x, y, "Y") if axis == "X" else (y, x, "X")
    return (
        start_mm[axis] - 0.05 < along_mm < end_mm + 0.05
        and abs(across_mm - start_mm[other_axis]) < 0.05
    )


def test_realtime_characters_in_comments_are_not_sent(person):
    """`!`, `~` and `?` in a comment would be commands to Grbl, so comments are removed."""
    person.loads("G21 (wait! ~ really?)\n; what? ~!\nG0 X1 (ümlaut)\n")
    person.click("#run")
    person.reads("#job-words", "Job done: nothing refused")
    assert {"G21", "G0 X1"} <= set(person.machine.lines())
    assert not sent_at_once(person.machine)


def test_realtime_character_in_code_is_not_sent(person):
    person.loads("G21\nG0 X1!\n")
    person.click("#run")
    person.reads("#notice-trouble", "line 2: ! does not belong in a line")
    assert not sent_at_once(person.machine)


def test_thousands_of_lines_stream_without_stalling(person_at):
    """3000 short moves are sent to a simulator that runs as fast as it can; each is sent once."""
    person = person_at({}, "--speed", "max")
    person.open_from_disk()
    person.connect()
    moves = "".join(f"G1 X{i % 100 / 10:.1f} Y{i % 70 / 10:.1f}\n" for i in range(3_000))
    person.loads(f"G21 G90 F3000\n{moves}")
    person.click("#run")
    person.page.wait_for_function(
        "() => document.getElementById('job-words').textContent.includes('done')", timeout=180_000
    )
    assert person.text("#job-words").startswith("Job done: nothing refused")
    assert sum(line.startswith("G1") for line in person.machine.lines()) == 3_000
    person.rests_at(9.9, 5.9, 0)  # the last line: 2999 % 100 / 10, 2999 % 70 / 10


def test_check_mode_checks_program_without_motion(person):
    """The page switches Grbl's check mode ($C) on, sends the program, and switches it off."""
    person.loads("G21 G90\nG1 X20 F600\nG999\nG1 X5\n")
    person.click("#check")
    person.reads("#problems", "Line 3 error:20")
    person.sees("Idle")
    assert person.shown_place() == [0, 0, 0]
    assert person.machine.lines().count("$C") == 2  # check mode on and off


def test_check_pressed_twice_moves_nothing(person):
    """A second $C would switch the check mode off, and the program would be executed."""
    person.loads("G21 G90\nG1 X20 F600\nG1 X5\n")
    person.waits("!$('check').disabled")
    person.page.evaluate("$('check').click(); $('check').click()")
    person.reads("#job-words", "Check done")
    person.waits("grbl.state === 'Idle' && !grbl.linesUnderWay")
    assert person.shown_place() == [0, 0, 0]
    assert person.machine.lines().count("$C") == 2  # on and off


def test_start_from_line_lists_its_first_moves_and_asks(person):
    """A job is started at line 6.

    First the page sends what restores modes, spindle, position and depth as the lines before would
    have left them.
    """
    person.loads("G21 G90\nM3 S500\nG0 Z5\nG1 X20 F2400\nG1 Z-2\nG1 Y10\nG1 X0\nG0 Z5\nM5\n")
    person.page.fill("#from", "6")
    person.click("#run")
    for said in ("up to Z5", "spindle on: M3 S500", "across to X20", "down to Z-2 at 2400 mm/min"):
        person.reads("#dialog", said)
    assert not any(line.startswith("G0") for line in person.machine.lines()), "it asks first"
    person.click("#dialog-yes")
    person.reads("#job-words", "Job done: nothing refused")
    lines = [line for line in person.machine.lines() if line != "$G"]
    # The first line of the restoration; then Z goes up, the spindle starts (4 s wait), and so on.
    first = lines.index("G21 G90 G94 M5")
    assert lines[first + 1 : first + 7] == [
        "G0 Z5",
        "M3 S500",
        "G4 P4",
        "G0 X20",
        "G1 Z-2 F2400",
        "G1 G17 G21 G90 S500",
    ]
    assert lines[first + 7] == "G1 Y10"  # line 6 of the program
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
def test_line_that_cannot_be_start_is_refused_with_reason(person, program, line, words):
    """A program cannot be continued at a line whose state before is not known for certain."""
    person.loads(program)
    person.page.fill("#from", str(line))
    person.click("#run")
    person.reads("#notice-trouble", words)
    # Nothing of the restoration is sent.
    assert "G21 G90 G94 M5" not in person.machine.lines()


def test_coordinate_system_set_just_before_start_is_known(person):
    """G55 is chosen and a job begun at line 3 before the page has heard of it."""
    person.loads("G21 G90\nG0 Z2\nG1 X5 F600\n")
    person.page.fill("#from", "3")
    person.waits("!$('run').disabled")
    person.page.evaluate("grbl.send('G55'); $('run').click()")
    person.reads("#notice-trouble", "The program is in G54 by then, and the machine in G55")


# Files on the board


@pytest.fixture
def keeper(person_at, tmp_path):
    """A person at a board that stores jobs.

    A folder of the computer stands for its flash memory.
    """
    board = tmp_path / "my.py"
    jobs = tmp_path / "jobs"
    board.write_text((BOARDS / "rpi_pico.py").read_text() + f'\nJOBS = "{jobs}"\n')
    made = person_at({20: "0"}, "--board", str(board))
    made.open_from_disk()
    made.connect()
    return made


PART = "G21 G91\n\n; done? not yet!\n(ok)\nG1 X3 F1200\nG1 X-1\n"


def test_program_is_sent_to_board_opened_run_and_deleted(keeper):
    """A program is stored on the board and used there: opened in the page, run, deleted."""
    program_text = PART + "".join(f"(line {n} {'x' * (n % 50)})\n" for n in range(200))
    keeper.loads(program_text, "my part.nc")
    keeper.click("#board-files")
    keeper.reads("#files-words", "kB")
    keeper.click("#upload")
    keeper.reads("#files-words", "MY_PART.NC is on the board.")
    assert (keeper.folder / "jobs" / "MY_PART.NC").read_text() == program_text
    keeper.loads("G0 X1\n")  # another program, which opening the stored one replaces
    keeper.click("[aria-label='Open MY_PART.NC']")
    keeper.reads("#job-name", "MY_PART.NC")
    assert keeper.page.evaluate("program.lines") == program_text.splitlines()
    keeper.click("[aria-label='Run MY_PART.NC on the board']")
    keeper.reads("#dialog", "The board runs it by itself")
    keeper.click("#dialog-yes")
    keeper.rests_at(2, 0, 0)  # PART's moves: +3 mm, -1 mm
    keeper.click("[aria-label='Delete MY_PART.NC']")
    keeper.click("#dialog-yes")
    keeper.reads("#files-words", "MY_PART.NC is deleted.")
    assert not list((keeper.folder / "jobs").glob("*.NC"))
    assert not keeper.page.query_selector("#notice-trouble")


def test_job_of_board_is_shown_with_progress(keeper):
    """The page shows a program that the board runs by itself, and STOP ends it."""
    (keeper.folder / "jobs").mkdir(exist_ok=True)
    (keeper.folder / "jobs" / "LONG.NC").write_text("G21 G91 F600\n" + "G1 X1\nG1 X-1\n" * 20)
    keeper.click("#board-files")
    keeper.click("[aria-label='Run LONG.NC on the board']")
    keeper.click("#dialog-yes")
    keeper.reads("#job-words", "The board runs LONG.NC, ")
    keeper.click("#stop")
    keeper.sees("Alarm")


def test_modes_that_job_of_board_has_set_are_known(keeper):
    (keeper.folder / "jobs").mkdir(exist_ok=True)
    (keeper.folder / "jobs" / "INCH.NC").write_text("G20 G91 G55\nG1 X0.1 F40\n")
    keeper.click("#board-files")
    keeper.click("[aria-label='Run INCH.NC on the board']")
    keeper.click("#dialog-yes")
    keeper.waits("['G20', 'G91', 'G55'].every((word) => grbl.modes.includes(word))")


def test_machine_without_stored_files_says_so(person):
    person.click("#board-files")
    person.reads("#files-words", "This machine keeps no files.")
    assert not person.page.is_visible("#upload")
    assert not person.page.query_selector("#notice-trouble")
