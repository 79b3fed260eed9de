"""Rehearsals: a machine's state in the simulator, which line is executed when, entry at a line."""

from pathlib import Path
from typing import Any

import pytest
from ugrbl.device import machine_snapshot
from ugrbl.device.from_line import CannotEnter, approach
from ugrbl.grbl.custom_codes import CustomCodes
from ugrbl.run.rehearsal import Forecast, Job, Rehearsal, check, rehearse

_BY_AXIS = ((100, 250), (110, 3000), (120, 300), (130, 100))
MACHINE = [
    *("$11=0.010", "$13=0", "$20=1", "$22=1", "$32=0"),
    *(f"${base + axis}={value}.000" for base, value in _BY_AXIS for axis in range(3)),
]
REPLIES = [
    *MACHINE,
    "[G54:-50.000,-40.000,-30.000]",
    "[G55:-10.000,-10.000,-10.000]",
    "[G28:-1.000,-1.000,-1.000]",
    "[G92:1.000,0.000,0.000]",
    "[TLO:2.000]",
    "[GC:G1 G54 G17 G20 G90 G94 M5 M9 T0 F254 S0]",
]


@pytest.fixture
def snapshot() -> machine_snapshot.MachineSnapshot:
    """Return the state of a machine that is at X-20 Y-20 Z-5 in machine coordinates."""
    snapshot = machine_snapshot.read(REPLIES)
    snapshot.place = [-20.0, -20.0, -5.0]
    return snapshot


def job(lines: list[str], commands: list[str], **options: Any) -> Job:
    return Job([line.encode() for line in lines], commands, **options)


def forecast(
    snapshot: machine_snapshot.MachineSnapshot, lines: list[str], report_state_before_line: int = 0
) -> Forecast:
    """Rehearse lines on a simulator with this state, without an error; return the forecast."""
    result, made = rehearse(
        job(lines, snapshot.commands(), report_state_before_line=report_state_before_line)
    )
    assert not result.errors and not result.stopped, result
    return made


# State of the simulator


def test_the_simulator_starts_with_the_machines_state(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    predicted = forecast(snapshot, ["G0 X0", "G91 Y-1"], report_state_before_line=1)
    assert predicted.start == [-20.0, -20.0, -5.0]
    # X0: G54 and G92, -50 + 1. Then 1 inch down from Y-20.
    ends_mm = [-49.0, -20.0, -5.0, -49.0, -45.4, -5.0]  # two blocks: X, Y, Z each
    assert list(predicted.block_ends) == pytest.approx(ends_mm, abs=1e-4)
    before_line = machine_snapshot.read(predicted.at_line)
    assert before_line.offsets["G92"] == [1.0, 0.0, 0.0] and before_line.tool_length() == 2.0
    assert "G20" in before_line.modes and before_line.word("F") == 254


def test_offsets_in_inches_are_converted(snapshot: machine_snapshot.MachineSnapshot) -> None:
    """With $13=1 the machine reports inches; offsets and feed of the snapshot are in mm."""
    inches = machine_snapshot.read(["$13=1", "[G54:1.0000,2.0000,0.0000]", "[GC:G0 G54 F10]"])
    assert inches.offsets["G54"] == [25.4, 50.8, 0.0] and inches.feed_mm_min() == 254


def test_soft_limits_use_the_machines_position(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    # G54 is -50: X-40 is -90 + 1, within the travel of 100; X-60 is not
    lines = ["G21", "G0 X-40", "X-60"]
    result, line = check(job(lines, snapshot.commands()))
    assert (result.stopped, line) == ("ALARM:2", 3)


def test_commands_for_an_idle_machine_are_no_errors(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    """$H and $10 are accepted; only line 4, T1 M6, is an error, because M6 is unknown."""
    result, _ = check(job(["$H", "$10=3", "G0 X0", "T1 M6"], snapshot.commands()))
    assert result.errors == [(4, "error:20")]


def test_a_machine_of_four_axes_is_rehearsed_with_four() -> None:
    of_a = [(base, 3, value) for base, value in ((100, 250), (110, 3000), (120, 300), (130, 100))]
    settings = [*MACHINE, *(f"${base + axis}={value}.000" for base, axis, value in of_a)]
    snapshot = machine_snapshot.read([*settings, "[G54:-50.000,-40.000,-30.000,-20.000]"])
    snapshot.place = [-20.0, -20.0, -5.0, -60.0]
    job_of_four = job(["G21", "G0 A-10", "G0 A-79", "G0 A-81"], snapshot.commands(), axes=4)
    # offset -20, travel 100: A-79 is the last in reach
    result, line = check(job_of_four)
    assert not result.errors and (result.stopped, line) == ("ALARM:2", 4)
    job_of_three = job(["G0 A-10"], snapshot.commands())
    assert check(job_of_three)[0].errors == [(1, "error:20")]  # no axis A


# The line being executed


def squares(count: int) -> list[str]:
    """Return lines that go round a square of 1 mm, `count` times."""
    return ["G21 G91 F1000", *(["G1 X1", "Y1", "X-1", "Y-1"] * count)]


def test_each_line_of_many_has_its_own_block() -> None:
    """block_line: the line of each block of motion, in order."""
    lines_without_motion = {7: "M8", 8: "(a comment)", 10: "", 12: "$", 45: "G4 P0.1"}
    lines = [
        "G21 G91 F600",
        *(lines_without_motion.get(n, f"G1 X{(-1) ** n}") for n in range(2, 70)),
    ]
    _, forecast_of_job = rehearse(job(lines, []))
    assert list(forecast_of_job.block_line) == [
        n for n in range(2, 70) if n not in lines_without_motion
    ]


def test_a_line_is_found_by_its_position(snapshot: machine_snapshot.MachineSnapshot) -> None:
    """The machine stopped there after 8 answers; its planner has 15 blocks, and reports no number
    of them."""
    predicted = forecast(snapshot, ["G21 G91 F1000", *(f"G1 X-{n}" for n in range(1, 9))])
    x = -20.0 - 1 - 2 - 1.5  # in the middle of X-3, line 4
    assert predicted.line_at(8, [x, -20.0, -5.0], planned=15, left=None) == 4


def test_of_several_lines_at_a_position_the_earlier_is_chosen(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    """Lines 2, 6 and 10 all pass X-19.5: it is better to repeat a part than to leave one out."""
    predicted = forecast(snapshot, squares(3))
    assert predicted.line_at(13, [-19.5, -20.0, -5.0], planned=15, left=None) == 2
    # A planner of 6 blocks: lines before the last 7 blocks are done.
    assert predicted.line_at(13, [-19.5, -20.0, -5.0], planned=6, left=None) == 10


def test_a_line_is_found_by_the_number_of_waiting_blocks(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    """Line 13 is answered; with 3 blocks left in the planner, line 11 is being executed."""
    predicted = forecast(snapshot, squares(3))
    assert predicted.line_at(13, [0.0, 0.0, 0.0], planned=15, left=3) == 11
    assert predicted.line_at(13, [0.0, 0.0, 0.0], planned=15, left=0) == 13


def test_a_position_off_the_path_is_no_line(snapshot: machine_snapshot.MachineSnapshot) -> None:
    assert forecast(snapshot, squares(1)).line_at(5, [-90.0, 0.0, 0.0], 15, None) is None


def test_an_arc_is_one_line(snapshot: machine_snapshot.MachineSnapshot) -> None:
    predicted = forecast(snapshot, ["G21 G91 F1000", "G1 X5", "G2 X0 Y0 I5", "G1 X-1"])
    assert set(predicted.block_line) == {2, 3, 4} and predicted.block_line.count(3) > 20
    on_arc = [-10.0, -15.0, -5.0]
    # The arc is in motion, and not yet answered.
    assert predicted.line_at(2, on_arc, planned=15, left=None) == 3


def test_time_left_falls_from_line_to_line(snapshot: machine_snapshot.MachineSnapshot) -> None:
    """seconds_left(n): from the answer to line n until the end of the program."""
    predicted = forecast(snapshot, ["G21 G91 F600", *["G1 X-1"] * 40])  # 40 mm at 10 mm/s
    left_s = [predicted.seconds_left(n) or 0 for n in range(42)]
    assert 4.0 < left_s[0] < 4.5 and left_s == sorted(left_s, reverse=True)
    assert 1.0 < left_s[41] < 2.0  # moves still in the planner at the last answer


def test_a_rehearsal_in_a_separate_process_gives_the_same_result(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    made = job(squares(5), snapshot.commands(), report_state_before_line=3)
    running = Rehearsal(made)
    assert running.wait() == rehearse(made)[1]
    running.close()


# Entry at a line


PART = [
    b"G21 G90 G54 G92.1",
    b"T1 M3 S8000 (3 mm)",
    b"M8",
    b"G0 X5 Y5 Z10",
    b"G1 Z-1 F120",
    b"X8 F300",
    b"G2 X10 Y7 I0 J2",
    b"X8 Y9 I-2 J0",
    b"G0 Z10",
]


def entry_lines(
    snapshot: machine_snapshot.MachineSnapshot, number: int, lines: list[bytes] = PART
) -> list[str]:
    """Return the lines of the entry at line `number`."""
    made = forecast(snapshot, [line.decode() for line in lines], report_state_before_line=number)
    return [line.text for line in approach(lines, number, made, snapshot).lines]


def test_the_entry_rises_crosses_and_descends_at_feed(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    """Rise to the safe height, start the spindle, cross to X5 Y5, descend, and set the modes of
    line 5. G54 is at -50, -40, -30 and G92 is set again."""
    snapshot.place[2] = -25.0
    assert entry_lines(snapshot, 6) == [
        "G21 G90 G94 M5",
        "G53 G0 Z-18.000",
        "M3 S8000",
        "G4 P4",
        "M8",
        "G53 G0 X-45.000 Y-35.000",
        "G53 G1 Z-29.000 F120",
        "G54 G92 X5.000 Y5.000 Z-1.000",
        "F120",
        "G1 G54 G17 G21 G90 G94 S8000",
    ]


def test_the_entry_is_the_same_for_a_machine_that_reports_inches(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    in_mm = entry_lines(snapshot, 6)
    snapshot.settings[13] = "1"
    snapshot.modes = ["F10" if word[0] == "F" else word for word in snapshot.modes]
    assert entry_lines(snapshot, 6) == in_mm


def test_a_laser_is_switched_on_only_at_the_entry_point(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    """Line 6 of PART has no G1 of its own, so the beam would have to be on before it: refused.
    Line 7 has a G2."""
    snapshot.settings[32] = "1"  # laser mode
    with pytest.raises(CannotEnter, match="line 6 continues G1"):
        entry_lines(snapshot, 6)
    lines = entry_lines(snapshot, 7)
    assert lines.index("G0 M3 S8000") > lines.index("G53 G1 Z-29.000 F300")
    assert "G4 P4" not in lines  # no delay for a spindle


def test_entry_at_a_continued_arc_is_refused(snapshot: machine_snapshot.MachineSnapshot) -> None:
    with pytest.raises(CannotEnter, match="line 8 continues G2"):
        entry_lines(snapshot, 8)
    assert entry_lines(snapshot, 7)[-1].startswith("G1 ")


def test_entry_at_a_continued_drilling_cycle_is_refused(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    """The forecast is of lines without the cycle, which the simulated board does not have."""
    lines = [b"G21 G90", b"G0 Z10", b"G99 G81 X5 Y5 Z-2 R2 F100", b"X10", b"G80", b"G0 X20"]
    predicted = forecast(
        snapshot, ["G21 G90", "G0 Z10", "G0 X5", "X10"], report_state_before_line=4
    )
    with pytest.raises(CannotEnter, match="line 4 continues the drilling cycle of line 3"):
        approach(lines, 4, predicted, snapshot)
    assert approach(lines, 6, predicted, snapshot).lines


def test_conditions_that_only_the_user_knows_are_reported(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    """cautions: a text each for relative moves, a changed origin and a tool, before the entry."""
    lines = [b"G91", b"G10 L2 P2 X1", b"G92 X0", *PART]
    predicted = forecast(snapshot, [line.decode() for line in lines], report_state_before_line=9)
    moves, origin, tool = approach(lines, 9, predicted, snapshot).cautions
    assert "line 1 moves relatively" in moves and "line 3 sets the origin" in origin
    assert "line 5 names a tool" in tool


def test_the_entry_stores_offsets_written_by_earlier_lines(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    """The machine has executed line 4 already: entry at line 3 stores the offsets of line 2
    again."""
    lines = [b"G21 G90 G55", b"G10 L2 P2 X-9 Y-9 Z-9", b"G0 X0", b"G10 L2 P2 X-8", b"G0 X-1"]
    snapshot.offsets["G55"] = [-8.0, -9.0, -9.0]  # the program has run to there
    assert "G10 L2 P2 X-9.000 Y-9.000 Z-9.000" in entry_lines(snapshot, 3, lines)
    assert not any("G10" in line for line in entry_lines(snapshot, 5, lines))
    predicted = forecast(snapshot, [line.decode() for line in lines], report_state_before_line=3)
    assert "line 4 stores offsets" in approach(lines, 3, predicted, snapshot).cautions[-1]


def test_entry_after_a_changed_stored_position_is_refused(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    """G28.1 in line 3 stores X-7 Y-7 Z-7: the machine must have that position for G28."""
    lines = [b"G21 G90", b"G53 G0 X-7 Y-7 Z-7", b"G28.1", b"G0 X1", b"G28"]
    with pytest.raises(CannotEnter, match="another position for G28"):
        entry_lines(snapshot, 4, lines)
    snapshot.offsets["G28"] = [-7.0, -7.0, -7.0]
    assert entry_lines(snapshot, 4, lines)


def test_entry_after_a_changed_setting_is_refused(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    """The program sets $30 before the entry: the machine must have that value already."""
    lines = [b"$30=500", b"G21 G90", b"G0 X1"]
    snapshot.settings[30] = "1000"
    with pytest.raises(CannotEnter, match=r"line 1 sets \$30, which is 1000 now"):
        entry_lines(snapshot, 3, lines)
    snapshot.settings[30] = "500"
    assert entry_lines(snapshot, 3, lines)


def test_entry_after_a_line_that_cannot_be_simulated_is_refused(
    snapshot: machine_snapshot.MachineSnapshot,
) -> None:
    """The simulator has no object to touch: the probe ends in an alarm."""
    lines = ["G21", "G38.2 Z-30 F100", "G0 X1"]
    _, predicted = rehearse(job(lines, snapshot.commands(), report_state_before_line=3))
    with pytest.raises(CannotEnter, match="ALARM"):
        approach([line.encode() for line in lines], 3, predicted, snapshot)


# The machine's own Python


OWN = """\
from ugrbl import mcode, on

@mcode(100, "P")
def down(m, P):
    print("no JSON")
    m.out("vacuum", P)
    m.probe("G53 Z-30 F300")

@mcode(101)
def late(m):
    m.wait_for("part")
"""


def job_with_custom(
    snapshot: machine_snapshot.MachineSnapshot, folder: Path, lines: list[str], *inputs: str
) -> Job:
    """Return a job with the custom module OWN; inputs: as for --input, e.g. "probe=Z-12"."""
    (folder / "mine.py").write_text(OWN)
    commands = snapshot.commands()
    return job(
        lines,
        commands,
        custom=str(folder / "mine.py"),
        inputs=[*inputs],
        report_state_before_line=2,
    )


def test_a_custom_probe_ends_at_the_contact(
    snapshot: machine_snapshot.MachineSnapshot, tmp_path: Path
) -> None:
    _, predicted = rehearse(job_with_custom(snapshot, tmp_path, ["M100 P1", "G21"], "probe=Z-12"))
    assert not predicted.refused and not predicted.stopped
    # the contact at Z-12, and the way to brake
    assert -13 < predicted.at_place[2] < -12 and predicted.outputs_on == ["vacuum"]
    assert predicted.own == "M100, M101"


def test_output_of_a_handler_does_not_disturb_the_forecast(
    snapshot: machine_snapshot.MachineSnapshot, tmp_path: Path
) -> None:
    """The process of the rehearsal writes its forecast to stdout, where the handler prints, too.
    G64 is refused."""
    running = Rehearsal(job_with_custom(snapshot, tmp_path, ["M100 P0", "G64"], "probe=Z-12"))
    made = running.wait()
    running.close()
    assert made and made.refused == [2]


def test_an_endless_wait_stops_the_rehearsal_with_a_message(
    snapshot: machine_snapshot.MachineSnapshot, tmp_path: Path
) -> None:
    """wait_for("part") would wait for ever; the message names the option that sets the input."""
    _, predicted = rehearse(job_with_custom(snapshot, tmp_path, ["M101", "G0 X1"]))
    assert "--input part=on" in predicted.stopped


def test_broken_python_stops_the_rehearsal_with_a_message(
    snapshot: machine_snapshot.MachineSnapshot, tmp_path: Path
) -> None:
    made = job_with_custom(snapshot, tmp_path, ["M101"])
    (tmp_path / "mine.py").write_text("1 / 0")
    running = Rehearsal(made)
    predicted = running.wait()
    running.close()
    assert predicted and "ZeroDivisionError" in predicted.stopped


# Custom words listed by $I


INFO = [
    "[OPT:V,15,128]",
    "[MSG:Custom: M100, G10 L1, G81.1, on.tool_change, on.spindle, every 50]",
]


@pytest.mark.parametrize(
    ("line", "word", "handler"),
    [
        (b"N5 m0100p1", "M100", "M100"),
        (b"G10 P1 L1 Z3", "G10 L1", "G10 L1"),
        (b"G10 L2 P1 Z3", "", ""),
        (b"G81.1", "G81.1", "G81.1"),
        (b"G81", "", ""),
        (b"T1 M06", "M6", "M6"),
        (b"(M100) G0 X1 ; M6", "", ""),
        (b"M3", "", "on.spindle"),
        (b"G1 X1 S300", "", "on.spindle"),
        (b"M30", "", "on.spindle"),
        (b"M8", "", ""),
        (b"T1", "", ""),
    ],
)
def test_custom_words_and_events_of_a_line_are_found(line: bytes, word: str, handler: str) -> None:
    """word: the custom word in the line; handler: what is called, a word's or an event's; "":
    none."""
    own_words = CustomCodes.read(INFO)
    assert (own_words.word_in(line), own_words.handler_of(line)) == (word, handler)
    assert CustomCodes.read(INFO[:1]).handler_of(line) == ""  # no list of custom words
    # version 0.9 listed them without MSG:
    older_info = [line.replace("MSG:", "") for line in INFO]
    assert CustomCodes.read(older_info).text == own_words.text


def test_the_last_word_of_a_truncated_list_is_unknown() -> None:
    """The list is cut at 112 characters: its last number may lack digits, and events are
    unknown."""
    text = ", ".join(f"M{n}" for n in range(100, 140))[:112]
    codes = CustomCodes.read([f"[MSG:Custom: {text}]"])
    last_word = text.split(", ")[-1].encode()
    assert codes.is_cut and codes.word_in(b"M110") and not codes.word_in(last_word)
    assert codes.handler_of(b"M8") == "on.coolant"
