"""The laser: power changes at the right step, through holds, overrides and resets.

Each step that the simulated machine makes is recorded with its power, and compared with the dots
of the program. test_settings_effects.py explains Bench; say(text, "stream") sends a line when the
receive buffer has space for it, "idle" waits until motion ends.

That the hardware changes power on request is shown on the emulated Pico
(emulator/test_pico_laser.py), and here for the program of its state machine.
"""

from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest
from extras.tools import clusters
from hypothesis import example, given
from hypothesis import strategies as st
from laws import some
from motion import layout
from motion.layout import ROW_AXES, ROW_DIRS, ROW_POWER
from test_laser import make_spindle
from test_settings_effects import Bench

# Many cases of each: the first ring runs a sample.
pytestmark = [pytest.mark.sampled(2), pytest.mark.usefixtures("each_ms")]

# A fast machine for the amount it burns.
_SETTINGS = {32: 1, 110: 6000, 111: 6000, 120: 800, 121: 800}
_PER_MM = 250
_FULL_POWER = 1000  # of power, and of S


@dataclass
class LaserRun:
    """What a program has burnt.

    steps: power of each step of X, in order; place: position of X in steps.
    """

    steps: "list[int]" = field(default_factory=list)
    answers: "list[str]" = field(default_factory=list)
    power_after: int = 0  # the program
    place: int = 0
    signs: "list[int]" = field(default_factory=list)  # of X, a sign per step


def run_laser(
    *lines: str, before: str = "G91G1F3000M3S0", events: "list[tuple[float, str]] | None" = None
) -> LaserRun:
    """Run lines, after `before`; events: bytes sent meanwhile, each this many ms after the one
    before."""
    bench, result = Bench(_SETTINGS, "sim_laser"), LaserRun()
    x_count_at = ROW_AXES  # index in a row of X's number of steps

    def trace(_start: int, row: "array[int]") -> None:
        sign = -1 if row[ROW_DIRS] & 1 else 1
        result.steps += [row[ROW_POWER]] * row[x_count_at]
        result.signs += [sign] * row[x_count_at]

    def script() -> Iterator[Any]:
        """Run the lines (with events: send bytes meanwhile), wait, and record power and
        position."""
        assert (yield from bench.say(before + "\n", "ok")) == ["ok"]
        bench.rig.engine.trace = trace
        text = "".join(line + "\n" for line in lines)
        if events is None:
            result.answers = yield from bench.say(text, "stream")
        else:
            bench.rig.link.send(text.encode())
            yield bench.rig.moving
            for ms, byte in events:
                yield bench.rig.ms(ms)
                bench.rig.link.send(byte.encode("latin-1"))
        yield from bench.say("", "idle")
        result.power_after = bench.port.spindle_pwm
        result.place = bench.place()[0]

    bench.run(script())
    return result


def dot_of(step: int, steps: int, dots: "list[int]") -> "set[int]":
    """Return the powers that step (from 0) of a line may have: those within half a step."""
    places = (step, step + 0.5, step + 1)  # a step is made in the middle of its interval
    return {dots[min(int(place * len(dots) / steps), len(dots) - 1)] for place in places}


def dots_line(mm: float, dots: "list[int]") -> str:
    """Return a line that moves X by mm and has these dots: S values divided by colons."""
    return f"X{mm:.3f}S" + ":".join(map(str, dots))


def assert_powers(result: LaserRun, lines: "list[tuple[float, list[int]]]") -> None:
    """Check that every step has the power of its dot, within half a step."""
    first_step = 0
    for mm, dots in lines:
        steps = abs(round(mm * _PER_MM))
        for step in range(steps):
            power = result.steps[first_step + step]
            assert power in dot_of(step, steps, dots), (mm, dots, step)
        first_step += steps
    assert len(result.steps) == first_step


_dots = st.lists(st.sampled_from((0, 1, 250, 600, 1000)), min_size=2, max_size=16)
_lines = st.lists(st.tuples(st.sampled_from((0.4, 0.8, 1.6, 0.02, 2.5)), _dots), max_size=6)


@given(_lines, st.sampled_from((300, 3000, 6000)))
@some(25)
@example([(0.02, [1000, 0] * 8), (0.8, [1, 250])], 6000)  # more dots than steps
@example([(1.6, [0, 1000] * 8)] * 3, 6000)
def test_every_dot_is_burnt_at_its_place(
    lines: "list[tuple[float, list[int]]]", feed: int
) -> None:
    result = run_laser(*(dots_line(*line) for line in lines), before=f"G91G1F{feed}M3S0")
    assert result.answers == ["ok"] * len(lines)
    assert_powers(result, lines)


@pytest.mark.parametrize("with_plain_lines", [False, True])
def test_dots_are_kept_while_lines_wait_for_space_in_the_planner(with_plain_lines: bool) -> None:
    """60 lines are more than the planner holds; with_plain_lines: a line with one S after each."""
    lines = [(0.8, [0, 10 * k, 500, 1000 - 10 * k]) for k in range(60)]
    plain_line = ["X0.8S300"] if with_plain_lines else []
    result = run_laser(*(text for line in lines for text in (dots_line(*line), *plain_line)))
    assert set(result.answers) == {"ok"}
    assert_powers(
        result, [part for line in lines for part in (line, (0.8, [300]))[: 1 + with_plain_lines]]
    )


@given(_lines.filter(bool))
@some(10)
def test_the_dots_of_a_line_get_the_planned_energy(
    lines: "list[tuple[float, list[int]]]",
) -> None:
    """Energy: power summed over steps, which at the constant power of M3 have equal lengths."""
    result = run_laser(*(dots_line(*line) for line in lines))
    planned_energy = sum(abs(round(mm * _PER_MM)) * sum(dots) / len(dots) for mm, dots in lines)
    edges = sum(len(dots) for _, dots in lines)
    # each edge of a dot may be off by a step
    assert abs(sum(result.steps) - planned_energy) <= _FULL_POWER * edges


_HOLDS = st.lists(st.tuples(st.integers(2, 40), st.sampled_from("!\x91\x92\x93\x94")), max_size=4)


@given(_HOLDS)
@some(15)
@example([(20, "!"), (20, "!")])
def test_holds_and_overrides_move_no_dot(events: "list[tuple[int, str]]") -> None:
    lines = [(1.6, [0, 1000, 250, 600]), (0.8, [1000, 0]), (1.6, [100 * k for k in range(10)])]
    # `~` 150 ms after each byte ends a hold, else it changes nothing
    resumed_events = [pair for ms, byte in events for pair in ((ms, byte), (150, "~"))]
    result = run_laser(*(dots_line(*line) for line in lines), events=[*resumed_events, (300, "~")])
    assert_powers(result, lines)
    assert result.place == sum(round(mm * _PER_MM) for mm, _ in lines)


def test_the_laser_is_off_in_a_hold_and_dots_continue_after_it() -> None:
    lines = [(1.6, [1000, 900]), (1.6, [800, 700])]
    bench = Bench(_SETTINGS, "sim_laser")

    def script() -> Iterator[Any]:
        """Hold 25 ms after the first step, look at the power, and resume."""
        yield from bench.say("G91G1F3000M3S0\n", "ok")
        bench.rig.link.send("".join(dots_line(*line) + "\n" for line in lines).encode())
        yield bench.rig.moving
        yield bench.rig.ms(25)  # into the first line: 1.6 mm at 50 mm/s take 32 ms and more
        yield from bench.say("!", "idle")
        assert bench.port.spindle_pwm == 0 and not bench.rig.moving()
        yield from bench.say("~", "idle")
        assert bench.port.spindle_pwm == 700  # M3: the last dot's power stays

    bench.run(script())


# Where power follows speed


def test_the_dots_of_m4_follow_the_speed() -> None:
    """At the programmed speed a dot has full power; below it, proportionally less."""
    # ramps are in the dark lines
    result = run_laser("X2S0", dots_line(4, [1000, 500]), "X2S0", before="G91G1F3000M4S0")
    # 250 steps/mm: steps 500 to 1500 are the 4 mm
    first, second = result.steps[500:1000], result.steps[1000:1500]
    assert set(first[1:]) == {1000} and set(second[1:]) == {500}
    # ramps are in the burnt line: power rises and falls
    slow_powers = run_laser(dots_line(4, [1000, 500]), before="G91G1F6000M4S0").steps
    assert (
        slow_powers[:50] == sorted(slow_powers[:50]) and slow_powers[10] < 500 < slow_powers[400]
    )
    assert slow_powers[-50:] == sorted(slow_powers[-50:], reverse=True) and slow_powers[-1] < 250
    assert result.power_after == 0


def test_m4_is_off_at_rest_and_m3_stays_on() -> None:
    assert run_laser(dots_line(1, [100, 300]), before="G91G1F3000M4S0").power_after == 0
    assert run_laser(dots_line(1, [100, 300]), before="G91G1F3000M3S0").power_after == 300


def test_a_spindle_override_rescales_dots() -> None:
    """To 50 %, by five times -10 %, also of blocks that wait in the planner. The dot under way,
    1000 in half of the first 625 steps, keeps its power."""
    lines = [(2.5, [1000, 500])] * 3
    result = run_laser(*(dots_line(*line) for line in lines), events=[(5, "\x9b" * 5)])
    assert result.steps[0] == 1000 and 500 not in result.steps[:600]
    assert set(result.steps[-600:]) == {500, 250} and result.power_after == 250
    result = run_laser("X1S5", dots_line(2.5, [1000, 500]), events=[(2, "\x9b" * 5)])
    assert set(result.steps[-300:]) == {250}  # the last dot, 500, halved


# Lines without a cluster


@given(st.lists(st.tuples(st.sampled_from((0.4, 1.2, -0.8)), st.integers(0, 1000)), min_size=1))
@some(15)
def test_every_step_of_a_line_without_cluster_has_its_power(
    lines: "list[tuple[float, int]]",
) -> None:
    lines = lines[:8]
    result = run_laser(*(f"X{mm}S{power}" for mm, power in lines))
    assert_powers(result, [(mm, [power]) for mm, power in lines])
    assert result.power_after == lines[-1][1]


# Lines with a cluster


def answers_to(*lines: str, before: str = "G91G1F3000M3S0") -> "list[list[str]]":
    """Return the machine's answers to each of `lines`, sent after `before`."""
    bench, answers = Bench(_SETTINGS, "sim_laser"), []

    def script() -> Iterator[Any]:
        for line in (before, *lines):
            answers.append((yield from bench.say(line + "\n", "idle")))

    bench.run(script())
    return answers[1:]


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("X1S1:2", "ok"),
        ("N7X1S.5:2.25:1000", "ok"),
        ("G1X1Y1F600S" + ":".join("5" * 16), "ok"),
        ("X1S9999:5", "ok"),  # full power, as S9999
        ("X1S1:", "error:2"),
        ("X1S:1", "error:2"),
        ("X1S1::2", "error:2"),
        ("X1:2S1", "error:2"),
        ("X:", "error:2"),
        ("X1S1:-2", "error:4"),
        ("X1S" + ":".join("5" * 17), "error:38"),
        ("S1:2", "error:20"),
        ("G0X1S1:2", "error:20"),
        ("G2X1R1S1:2", "error:20"),
        ("M4X1S1:2", "error:20"),
        ("G93X1F9S1:2", "error:20"),
        ("X1S1:2S3", "error:25"),
    ],
)
def test_a_line_with_a_cluster_is_answered_once_and_a_refused_one_changes_nothing(
    line: str, answer: str
) -> None:
    modes_before, answers, modes_after = answers_to("$G", line, "$G")
    assert answers == [answer]
    assert (modes_before == modes_after) == (answer != "ok")  # the modes, as reported by $G


def test_a_cluster_in_g0_is_refused_even_beyond_the_travel() -> None:
    (answers,) = answers_to("X-5S1:2", before="$20=0")
    assert answers == ["error:20"]  # G0 is in force


def test_clusters_are_refused_without_laser_mode() -> None:
    assert answers_to("X1S1:2", before="$32=0") == [["error:20"]]


def test_s_after_a_cluster_is_its_last_value() -> None:
    result = run_laser(dots_line(1, [100, 300]), "X1")
    assert set(result.steps[250:]) == {300}


def test_check_mode_accepts_clusters_and_burns_nothing() -> None:
    assert answers_to("$C", "X1S1:2", "X1S1:", "X1S5:6")[1:] == [["ok"], ["error:2"], ["ok"]]


def test_a_cluster_has_no_power_without_m3_or_m4() -> None:
    assert set(run_laser(dots_line(1, [100, 300]), before="G91G1F3000M5").steps) == {0}


def test_lines_with_and_without_clusters_can_alternate() -> None:
    lines = [(0.8, [0, 1000]), (0.8, [250]), (0.8, [1, 600, 250]), (0.4, [1000])] * 4
    result = run_laser(*(dots_line(*line) for line in lines))
    assert_powers(result, lines)


def test_a_reset_discards_the_dots_of_discarded_lines() -> None:
    """After the reset, lines with S7 burn at 7 only: no dot of 900 or 1000 is left."""
    bench = Bench(_SETTINGS, "sim_laser")
    powers: list[int] = []

    def script() -> Iterator[Any]:
        """Reset in the first of five lines with dots; unlock, and burn other lines."""
        yield from bench.say("G91G1F3000M3S0\n", "ok")
        bench.rig.link.send("".join(dots_line(1.6, [1000, 900]) + "\n" for _ in range(5)).encode())
        yield bench.rig.moving
        yield bench.rig.ms(25)  # into the first line
        yield from bench.say("\x18", "banner")
        assert bench.port.spindle_pwm == 0
        yield from bench.say("$X\n", "ok")
        bench.rig.engine.trace = lambda _, row: powers.append(row[ROW_POWER])
        yield from bench.say("G91G1F3000M3S7\n" + "X0.4\n" * 8, "stream")
        yield from bench.say("", "idle")

    bench.run(script())
    assert set(powers) <= {0, 7}


def test_a_line_longer_than_grbls_is_accepted_up_to_a_limit() -> None:
    values = ":".join(["123.25"] * 16)
    assert answers_to("X1S" + values, "X1" + "S1" * 90) == [["ok"], ["error:11"]]


def test_a_board_without_clusters_refuses_them() -> None:
    bench = Bench(_SETTINGS)  # the board "sim"
    answers: list[list[str]] = []

    def script() -> Iterator[Any]:
        for line in ("G91G1F3000M3S0", "X1S1:2"):
            answers.append((yield from bench.say(line + "\n", "ok")))

    bench.run(script())
    assert answers == [["ok"], ["error:1"]]


# The meaning of S


@given(
    st.lists(st.floats(0, 2000, width=32), min_size=1, max_size=16),
    st.sampled_from((1000, 255, 12000, 1)),
    st.sampled_from((0, 1, 30.5, 1000)),
    st.sampled_from((1000, 255, 16383)),
    st.booleans(),
)
@some(300)
def test_a_dot_has_the_same_power_as_s(
    values: "list[float]", most: float, least: float, full: int, dynamic: bool
) -> None:
    """store_dots() computes the powers of dots; Spindle.block_power() those of S.

    most, least: $30, $31; full: levels of the PWM.
    """
    spindle = make_spindle(most, least, full)
    spindle.laser = True
    flags = 0x20 | (layout.DYNAMIC if dynamic else 0)  # 0x20: the spindle turns
    spindle.block_power(flags, 0)  # reads the override
    scale = spindle._state.spindle
    # of two blocks: a count and 16 dots each; 16 S values each. The second block is used.
    powers, speeds = array("i", [0] * 34), array("f", [0] * 32)
    clusters.store_dots(array("f", values), len(values), scale, flags, powers, speeds, 1)
    assert powers[17] == len(values)
    assert list(speeds[16:][: len(values)]) == list(array("f", values))
    for value, power in zip(array("f", values), powers[18:], strict=False):
        assert power == spindle.block_power(flags, value)
