"""Test the laser: its setting, and the power for S.

S is the speed of a spindle in rpm, from $31 to $30, which a laser has as its power. $32=1 selects
a laser, and $33 is the frequency of its PWM output. Bench.say(text, until) sends a text, waits for
`until`, and returns the output.
"""

import bisect
from array import array
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from base.state import RPM, State
from boot.options import Options
from control.spindle import CCW, CW, Spindle
from esp_bench import esp_machine, gpio_esp, reset_stand_ins
from fakes import FakePort
from hypothesis import example, given
from hypothesis import strategies as st
from laws import some
from motion import layout
from motion.layout import ROW_POWER
from rig_bench import Machine
from test_settings_effects import Bench
from ugrbl.boardfile.board_check import problems
from ugrbl.boardfile.files import load_board

# Power of an Uno, of 255, for S between $31 and $30: recorded from Grbl (spindle_coolant_laser).
_RECORDED = [
    # S, $30, $31, power
    *((1, 1000, 0, 1), (3, 1000, 0, 1), (4, 1000, 0, 2), (127, 255, 0, 127), (128, 255, 0, 128)),
    *((254, 255, 0, 254), (1, 12000, 500, 1), (500, 12000, 500, 1), (501, 12000, 500, 1)),
    *((6250, 12000, 500, 127), (11999, 12000, 500, 254), (7, 7, 1, 255), (4, 7, 1, 128)),
]


def make_spindle(most: float, least: float, full: int) -> Spindle:
    """Return a spindle with these $30 and $31, on a port with `full` steps of power."""
    port = FakePort()
    port.pwm_max = full
    spindle = Spindle(port, State(), enable_by_direction=False)
    settings: Any = SimpleNamespace(max_rpm=most, min_rpm=least, laser_mode=0)
    spindle.configure(settings, array("i", [0] * layout.table_length(axes=3, motors=3)))
    return spindle


@pytest.mark.parametrize(("rpm", "most", "least", "power"), _RECORDED)
def test_power_is_grbls_with_the_same_resolution(
    rpm: float, most: float, least: float, power: int
) -> None:
    assert make_spindle(most, least, full=255).power(rpm) == power


@pytest.mark.parametrize(("rpm", "most", "least", "power"), _RECORDED)
def test_power_of_finer_steps_is_within_one_step_of_grbls(
    rpm: float, most: float, least: float, power: int
) -> None:
    assert abs(make_spindle(most, least, full=1000).power(rpm) * 255 / 1000 - power) <= 1


def test_s_without_m3_and_m4_is_no_power() -> None:
    spindle = make_spindle(most=1000, least=0, full=1000)
    assert spindle.block_power(0, 500) == 0
    assert spindle.block_power(CW, 500) == 500


def to_single(x: float) -> float:
    """Return x rounded to single precision."""
    return array("f", [x])[0]


def grbl_power(
    flags: int, rpm: float, most: float, least: float, full: int, percent: int
) -> "tuple[int, float]":
    """Return power and speed in rpm as Grbl computes them, step by step in single precision.

    Power that follows speed (M4) is in 1/64 of a step.
    """
    span = to_single(most - least)
    gradient = to_single((full - 1) / span) if span > 0 else 0.0
    if gradient * most >= 1 << 23:  # not in Grbl: 64 times the power has up to 30 bits
        gradient = 0.0
    rpm = to_single(rpm * to_single(to_single(0.01) * percent))
    if flags & layout.DYNAMIC:
        return int(to_single(min(rpm, most) * gradient) * 64), 0.0
    if least >= most or rpm >= most:
        return full, most
    if rpm <= least:
        return (1, least) if rpm else (0, 0.0)
    return int(to_single(to_single(rpm - least) * gradient)) + 1, rpm


@given(
    st.one_of(st.floats(0.125, 2000, width=32), st.integers(0, 20000), st.just(2.0**120)),
    st.floats(1, 30000, width=32),
    st.one_of(st.just(0.0), st.floats(0.125, 30000, width=32)),
    st.sampled_from((1000, 255, 16383)),
    st.integers(10, 200),
    st.booleans(),
)
@some(500)
@example(-0.0, 1000, 0, 1000, 100, False)
@example(-0.0, 1000, 0, 1000, 50, True)
@example(500, 1000, 1000, 255, 100, True)
@example(1000, 1000, 999.9999389648438, 1000, 100, True)
@example(1000, 1000, 999.875, 1000, 100, True)
def test_power_is_computed_as_in_single_precision(
    rpm: float, most: float, least: float, full: int, percent: int, follows: bool
) -> None:
    """grbl_power() computes the expected power and speed.

    rpm: S. most, least: $30 and $31. full: steps of power. percent: override. follows: M4, whose
    power follows the speed of motion.
    """
    spindle = make_spindle(most, least, full)
    state = spindle._state
    state.override_spindle(percent)
    # No value that block_power() could write: the speed must be written anew.
    state.spindle[RPM] = -1
    flags = CCW | layout.DYNAMIC if follows else CW
    power, speed = grbl_power(flags, rpm, most, least, full, percent)
    assert spindle.block_power(flags, rpm) == power
    assert state.spindle[RPM] == speed


# Holds


_QUEUE = 7  # rows of steps that may have been made ahead of the executed one


@pytest.mark.parametrize("spindle_word", ["M3", "M4"])
@pytest.mark.parametrize("words", [("S500", "S200", "S999"), ("", "S0", ""), ("S1500", "", "S9")])
def test_report_in_motion_has_the_speed_of_the_beam(
    spindle_word: str, words: "tuple[str, ...]"
) -> None:
    """A report in motion has the spindle speed of a row that is executed or planned next.

    Words: S of three moves that follow the first. Overrides change it in the middle of motion.
    """
    machine = Machine({32: 1, 110: 6000, 120: 300})
    reports: "list[tuple[int, str]]" = []

    def script() -> Iterator[Any]:
        """Send four moves with words of S; ask for reports; once override the speed."""
        yield from machine.start()
        rig = machine.rig
        # A rapid, then lines, of 3 mm each.
        lines = [f"G{k > 0:d}X{3 * k}{word}" for k, word in enumerate(("", *words), 1)]
        rig.link.send("\n".join([spindle_word + "S400F1200", *lines, ""]).encode())
        for number in range(22):  # a report every 29 ms, and an override
            yield rig.ms(29)
            if number == 11:
                # Each byte lowers the spindle override by 10 %.
                rig.link.send(b"\x9b\x9b\x9b")
                continue
            rig.link.send(b"?")
            yield from machine.sender.until(lambda: any("<" in x for x in machine.sender.lines))
            reports.append((rig.now, machine.take()[-1]))
        yield from machine.rest()

    machine.run(script())
    runs = [(time, line) for time, line in reports if line.startswith("<Run")]
    assert len(runs) > 12
    row_starts = [start for start, _ in machine.rows]
    for time, line in runs:
        rpm = int(line.partition("FS:")[2].partition("|")[0].strip(">").split(",")[1])
        # The report arrives some ms later.
        first = bisect.bisect(row_starts, time - 12 * machine.rig.ticks_per_ms) - 1
        rows = machine.rows[max(first, 0) : bisect.bisect(row_starts, time) + _QUEUE]
        powers = {row[ROW_POWER] for _, row in rows}
        # 255 steps of power for S1000.
        assert min(abs(rpm * 255 / 1000 - power) for power in powers) <= 4, (line, powers)


@pytest.mark.parametrize(
    ("spindle", "laser", "resumed_by", "is_reported"),
    [
        ("M3", 1, "~", False),
        ("M4", 1, "~", False),
        ("M4", 1, "\x9e", True),
        ("M4", 0, "\x9e~", True),
    ],
)
def test_laser_given_back_by_the_end_of_a_hold_is_no_change_to_report(
    spindle: str, laser: int, resumed_by: str, is_reported: bool
) -> None:
    """A hold turns a laser off, and its end on again: no report needs an "Ov:" field for that.

    A change that the user made by the spindle stop byte (0x9e) is reported.
    """
    bench = Bench({32: laser})
    reports = []

    def script() -> Iterator[Any]:
        """Turn the tool on, hold, resume; ask for three reports after each."""
        yield from bench.say(spindle + "S600\n", "ok")
        # A spindle in hold does not stop by itself: without laser mode, 0x9e stops it.
        for sent in ("!", "" if laser else "\x9e", resumed_by):
            yield from bench.say(sent, "ms 50")
            for _ in range(3):  # WCO: comes first
                reports.append((yield from bench.say("?", "report"))[0])

    bench.run(script())
    # Only the three reports after the end of the hold count.
    assert any("|Ov:" in line for line in reports[-3:]) == is_reported, reports


# $33


def answers_to(bench: Bench, *lines: str) -> "list[list[str]]":
    """Return the answers to each line, after the start of the machine."""
    answers = []

    def script() -> Iterator[Any]:
        for line in lines:
            answers.append((yield from bench.say(line + "\n", "ok")))

    bench.run(script())
    return answers


@pytest.mark.parametrize("hz", [0, 9.9, 100_001, 1e9])
def test_frequency_out_of_range_is_refused_and_nothing_changes(hz: float) -> None:
    """Neither the setting, the output nor the stored file changes."""
    bench = Bench({}, "sim_laser")
    refused, listed = answers_to(bench, f"$33={hz:f}", "$$")
    assert refused == ["error:3"]
    # 5000 Hz is the default.
    assert "$33=5000" in listed and bench.port.pwm.freq() == 5000
    assert not any(
        "$33=" in line for line in bench.rig.store.files["settings"] if "5000" not in line
    )


@pytest.mark.parametrize("hz", [10, 100_000])
def test_limits_of_the_frequency_are_accepted(hz: int) -> None:
    bench = Bench({}, "sim_laser")
    assert answers_to(bench, f"$33={hz}") == [["ok"]]
    assert bench.port.pwm.freq() == hz


def test_board_without_a_laser_has_no_frequency_setting() -> None:
    bench = Bench({})
    refused, listed = answers_to(bench, "$33=5000", "$$")
    assert refused == ["error:3"]
    assert not any(line.startswith("$33") for line in listed)


def test_impossible_stored_frequency_is_replaced_by_the_nearest() -> None:
    bench = Bench({}, "sim_laser")
    bench.rig.store.files["settings"] = ["$33=7"]
    answers_to(bench)
    assert bench.port.pwm.freq() == 10


def test_frequency_of_the_board_file_is_the_default() -> None:
    options = Options(load_board("pico_laser"))
    assert options.defaults == {32: 1, 33: load_board("pico_laser").PWM_HZ}
    assert load_board("pico_laser").DEFAULTS == {32: 1}


def test_esp32_changes_frequency_at_once_and_keeps_power() -> None:
    """A stand-in for the chip records frequency and duty of pin 16."""
    reset_stand_ins()
    port = gpio_esp.EspPort(SimpleNamespace(SPINDLE_PWM=16, PWM_MAX=1000))
    port.spindle(True, 250)  # a quarter of PWM_MAX
    output = esp_machine.PWM.outputs[16]
    port.pwm.freq(20_000)
    # The chip's duty has 16 bits.
    assert (output.frequency, output.duty) == (20_000, 250 * 65535 // 1000)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"PWM_HZ": 5}, "TOOL = laser: PWM_HZ is 10 to 100000"),
        ({"SPINDLE_PWM": None}, "TOOL = laser: there is no pin for SPINDLE_PWM"),
    ],
)
def test_impossible_board_file_is_reported(changes: "dict[str, Any]", said: str) -> None:
    assert problems(load_board_with(**changes)) == [said]


def load_board_with(**changes: Any) -> Any:
    return SimpleNamespace(**{**vars(load_board("pico_laser")), **changes})


@pytest.mark.parametrize("dots", ["S-1", "S-1:0:5", "S0:-1:5", "S5:0:-1"])
def test_dot_below_0_is_refused_wherever_it_is(dots: str) -> None:
    """S with colons is the power of each dot of a line of pixels; none may be negative."""
    machine = Machine({32: 1}, "sim_laser", watched=False)
    answers: "list[str]" = []
    # converse() calls the function with each line and its replies.
    machine.converse(
        ["G21G91G1F3000M3", f"X0.8{dots}"], lambda line, replies: answers.append(replies[-1])
    )
    assert answers == ["ok", "error:4"]
