"""The PIO pulse engine tick by tick: its programs, its words, and the whole engine on a modelled
chip.

The assembled programs run on rp2040py's model of a PIO block. A second has 12.5 million ticks:
moves too slow to be played are computed from the timing that programs.py states; the model is
shown to keep that timing.

A row is a segment: its ticks, directions, power, and per axis its steps and the ticks of the first
and the last one. A word is what the engine makes of rows: DIR, a number of steps, and a delay.
Words.due has the steps (tick, DIR) that follow from rows, Words.played() those that the model
makes. An EngineBench has the whole engine: counted_steps() counts its steps, reported_steps() is
what it reports.
"""

import sys
from array import array
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import accumulate, chain, cycle, pairwise
from types import SimpleNamespace
from typing import Any

import machine
import pytest
import rings
import rp2
from hypothesis import given
from hypothesis import strategies as st
from laws import Bench, Limits, some
from motion.layout import KEEP_POWER, ROW_AXES, ROW_DIRS, ROW_POWER, ROW_STRIDE, ROW_TICKS
from pio import beam_program, memory, programs, pulses, state_layout
from pio.beam import slice_of
from pio.engine import PioEngine
from test_engines import _play_words
from ugrbl.boardfile.files import load_board
from ugrbl.sim.engine import step_tick

# Many cases of each: the first ring runs a sample.
pytestmark = pytest.mark.sampled(1)

pio_model = pytest.importorskip("pio_model", reason="rp2040py has no wheel for this platform")

HZ = 12_500_000
LOG2 = PioEngine.segment_log2
_STEP, _DIR = tuple(range(2, 20, 2)), tuple(range(3, 21, 2))
AXES = 3
STEP, DIR = _STEP[:AXES], _DIR[:AXES]
# Numbers of motors of a chip: from the fifth on they use PIO 1, the seventh and eighth need an
# RP2350.
MOTORS = (3, 4, 6, 8)
_OF_PIO_0 = 4
LONGEST_DELAY, MOST_STEPS = (1 << 19) - 1, (1 << 12) - 1

# $0, and hold and setup time of DIR, all in us.
Timing = tuple[int, int, int]
_BREAKOUT: Any = load_board("generic_breakout")
TIMINGS = {
    "usual": (10, 2, 5),
    "shortest pulse": (3, 2, 5),
    "1 us": (1, 2, 5),  # with STEP_PULSE_MIN_US
    "generic_breakout": (5, _BREAKOUT.DIR_HOLD_US, _BREAKOUT.DIR_SETUP_US),
    "no wait": (3, 0, 0),
}


def ticks(us: int) -> int:
    """Return the smallest number of ticks that lasts at least us."""
    return -(-us * 25 // 2)


def row(count: int, dirs: int, *axes: "tuple[int, int, int]") -> "array[int]":
    """Return a segment of count ticks without a change of power.

    dirs: a bit per axis, 1 for negative; per axis: steps, tick of the first, tick of the last.
    """
    return array("i", [count, dirs, KEEP_POWER, *(n for axis in axes for n in axis)])


def word(direction: int, steps: int, delay: int) -> int:
    """Return a word of the program; delay: ticks before each step, added to the program's own."""
    return direction | steps << 1 | delay << 13


# The drivers' view


@dataclass
class Driver:
    """The edges that the driver of one axis receives, in ticks."""

    steps: "list[tuple[int, int]]" = field(default_factory=list)  # tick, level of DIR
    pulses: "set[int]" = field(default_factory=set)  # lengths
    pause: int = HZ  # the shortest between pulses,
    setup: int = HZ  # from a change of DIR to a step
    hold: int = HZ  # from the end of a pulse to a change of DIR

    @property
    def place(self) -> int:
        return sum(-1 if level else 1 for _, level in self.steps)


def driver(edges: "Iterable[tuple[int, int, int]]", axis: int) -> Driver:
    """Turn a chip's edges (tick, pin, level) into a driver's view.

    DIR must not change while STEP is high.
    """
    seen = Driver()
    direction = step = 0  # levels
    fell = turned = -HZ  # ticks of STEP's last falling edge and of DIR's last change
    for tick, pin, level in edges:
        if pin == _DIR[axis]:
            assert not step, "DIR changes during a pulse"
            direction, turned = level, tick
            seen.hold = min(seen.hold, tick - fell)
        elif pin == _STEP[axis]:
            step = level
            if level:
                seen.steps.append((tick, direction))
                seen.pause = min(seen.pause, tick - fell)
                seen.setup = min(seen.setup, tick - turned)
            else:
                fell = tick
                seen.pulses.add(tick - seen.steps[-1][0])
    return seen


def check_times(seen: Driver, timing: Timing) -> None:
    """Check the times a driver may demand: pulse length, hold and setup of DIR."""
    pulse_us, hold_us, setup_us = timing
    assert seen.pulses <= {ticks(pulse_us)}  # or no pulses
    assert seen.hold >= ticks(hold_us)
    assert seen.setup >= ticks(setup_us)


# Words


class Words:
    """Segments converted to words as by the engine, and the steps expected from them."""

    def __init__(self, timing: Timing = TIMINGS["usual"]) -> None:
        self.pulse = ticks(timing[0])
        self.timing = array("i", [0] * pulses.TIMING_LENGTH)
        self.timing[pulses.AXES] = AXES
        pulses.set_timing(self.timing, *(ticks(us) for us in timing))
        self.lanes = array("i", [0] * (pulses.LANE * AXES))
        self.ring = array("i", [0] * (AXES << pulses.RING_LOG2))
        self.words: list[list[int]] = [[] for _ in range(AXES)]
        self.due: list[list[tuple[int, int]]] = [[] for _ in range(AXES)]  # steps: tick, DIR
        self.delays: list[int] = []  # ticks by which each piece is delayed, by DIR or the rate
        self.end = 0  # tick at which the last segment ends

    def lane(self, axis: int, what: int) -> int:
        """Return a field of the axis' state, such as pulses.HEAD."""
        return self.lanes[pulses.LANE * axis + what]

    def add(self, whole: "array[int]") -> None:
        """Convert a segment, in pieces if it is long."""
        pieces = list(cut(whole)) if whole[ROW_TICKS] > pulses.LONGEST else [whole]
        sent = len(self.delays)
        for piece in pieces:
            self._convert(piece)
        assert not any(self.delays[sent + 1 :]), "a later piece is delayed"
        start = self.end + self.delays[sent]
        for axis, due in enumerate(self.due):
            base = ROW_AXES + ROW_STRIDE * axis
            level = whole[ROW_DIRS] >> axis & 1
            due += [(start + step_tick(whole, base, k), level) for k in range(whole[base])]
        self.end = start + whole[ROW_TICKS]

    def _convert(self, piece: "array[int]") -> None:
        """Let the engine write the piece's words into its rings; copy them to self.words."""
        heads = [self.lane(i, pulses.HEAD) for i in range(AXES)]
        self.delays.append(pulses.convert(piece, self.lanes, self.ring, self.timing))
        for i, words in enumerate(self.words):
            count = (self.lane(i, pulses.HEAD) - heads[i]) % (1 << pulses.RING_LOG2)
            assert count <= 6, "a segment makes at most six words per ring"
            for k in range(count):
                at = (heads[i] + k) % (1 << pulses.RING_LOG2)
                words.append(self.ring[(i << pulses.RING_LOG2) + at] & 0xFFFFFFFF)

    def model(self) -> Any:
        """Return a PIO block that is ready to play the words."""
        model = pio_model.PioModel(programs.stepper, list(zip(STEP, DIR, strict=True)))
        for i, words in enumerate(self.words):
            model.load_isr(i, self.pulse - 3)  # the program itself takes 3 ticks of each pulse
            model.waiting[i] += words
        model.start()
        return model

    def played(self) -> "list[Driver]":
        """Play all words; return what the drivers receive."""
        model = self.model()
        # Until all words are fetched and every machine waits for the next one.
        while any(model.unread(i) or model.at(i) != programs.NEXT for i in range(AXES)):
            model.run(200)
        return [driver(model.edges, i) for i in range(AXES)]

    def computed(self) -> "list[list[tuple[int, int]]]":
        """Return the steps computed from the timing that programs.py states."""
        return [compute_steps(words, self.pulse)[0] for words in self.words]


def cut(whole: "array[int]") -> "Iterator[array[int]]":
    """Yield the pieces of a long segment."""
    begin = 0
    while True:
        piece = array("i", whole)
        begin = pulses.cut_row(piece, whole, begin, AXES)
        yield piece
        if not begin:
            return


def compute_steps(words: "Iterable[int]", pulse: int) -> "tuple[list[tuple[int, int]], int]":
    """Compute the steps of words from the timing in programs.py, and the tick the machine is
    ready for the next one. pulse: ticks of a pulse."""
    steps = []  # tick of the rising edge, DIR
    ready = 0
    for w in words:
        count, delay = w >> 1 & MOST_STEPS, w >> 13
        # The program takes 6 ticks to fetch a word, 9 between pulses and 3 after the last one.
        edge = ready + 6 + delay
        ready = edge
        for k in range(count):
            edge += pulse + 9 + delay if k else 0
            steps.append((edge, w & 1))
            ready = edge + pulse + 3
    return steps, ready


def segmented(
    targets: "Sequence[tuple[float, ...]]", feed: float, limits: Limits
) -> "list[array[int]]":
    """Return the segments that planner and kernels make of lines to these targets, in mm, at feed
    mm/s."""
    bench = Bench(limits, 64, HZ, LOG2)  # 64 blocks; segments of up to 1 << LOG2 ticks
    for target in targets:
        bench.line(target, feed * 60)  # mm/min
    rows = []
    while bench.segments.next(bench._row):
        rows.append(bench._row[:])
    return rows


def at_rate(
    hz: int, steps: int, ratio: "tuple[float, ...]", step_hz: int = 390_000
) -> "list[array[int]]":
    """Return segments of one line whose longest axis makes this many steps at hz, from a flying
    start.

    ratio: steps of each axis relative to the first. step_hz: the engine's highest rate; a higher
    rate would make full segments shorter than a board's.
    """
    # hz / 100 steps/mm: the first axis makes hz steps/s at 100 mm/s. Rates and accelerations are
    # too high to limit anything.
    limits = Limits((hz / 100,) * AXES, (6e6,) * AXES, (1e7,) * AXES, step_hz=step_hz)
    target = tuple(steps * 100 / hz * part for part in ratio)
    length = sum(mm * mm for mm in target) ** 0.5
    return segmented([target], 100 * length / target[0], limits)


# Lines of a few tenths of a second at most, by their special property.
_QUICK = Limits((80.0,) * 3, (6000.0,) * 3, (3000.0,) * 3)
_FAST = Limits((400.0,) * 3, (30_000.0,) * 3, (20_000.0,) * 3)
MOVES: "dict[str, tuple[Limits, float, list[tuple[float, ...]]]]" = {
    "diagonal": (_QUICK, 50.0, [(1.5, 1.1, -0.4)]),
    "reversals": (_QUICK, 50.0, [(0.6, 0.43, -0.1), (0.0, 0.1, 0.0), (0.2, 0.3, 0.1)]),
    "short lines": (_QUICK, 50.0, [(0.1 * k, 0.02 * k * k, -0.01 * k) for k in range(1, 12)]),
    "fast": (_FAST, 220.0, [(9.0, -6.5, 0.7), (8.0, -6.5, 0.0)]),
    "one step": (_QUICK, 5.0, [(0.0125, 0.0, 0.0)]),
    "slow": (_QUICK, 1.0, [(0.05, 0.0, 0.03)]),
}


def move_rows(name: str) -> "list[array[int]]":
    """Return the segments of one of the MOVES."""
    limits, feed, targets = MOVES[name]
    return segmented(targets, feed, limits)


@st.composite
def segments(draw: Any, gap: int, most: int = 8, motors: int = AXES) -> "list[array[int]]":
    """Draw segments that no planner makes: steps on their edges, reversals at full speed.

    gap: the least ticks from step to step within a segment; most: of segments.
    """
    rows = []
    for _ in range(draw(st.integers(1, most))):
        count = draw(st.integers(1, 5000) | st.integers(1, 8))  # ticks
        axes = []
        for _ in range(motors):
            steps = draw(st.integers(0, min(count // gap + 1, 30)))
            span = max(steps - 1, 0) * gap
            first = draw(st.integers(0, count - span)) if steps else 0
            last = draw(st.integers(first + span, count)) if steps > 1 else first
            axes.append((steps, first, last))
        rows.append(row(count, draw(st.integers(0, (1 << motors) - 1)), *axes))
    return rows


@st.composite
def timed_segments(
    draw: Any, most: int = 8, motors: int = AXES
) -> "tuple[Timing, list[array[int]]]":
    """Draw segments within the highest rate, with pulse settings."""
    timing = draw(st.sampled_from(sorted(TIMINGS.values())))
    return timing, draw(segments(pulses.shortest_gap(ticks(timing[0])), most, motors))


def words_of(rows: "Iterable[array[int]]", timing: Timing = TIMINGS["usual"]) -> Words:
    """Return the words of these segments."""
    words = Words(timing)
    for segment in rows:
        words.add(segment)
    return words


# The program


def play_words(words: "list[int]", pulse: int, run_ticks: int) -> "list[tuple[int, int, int]]":
    """Return the edges (tick, pin, level) of one machine that plays these words.

    pulse: ticks of a pulse.
    """
    model = pio_model.PioModel(programs.stepper, [(STEP[0], DIR[0])])
    model.load_isr(0, pulse - 3)  # the program itself takes 3 ticks of each pulse
    model.waiting[0] += words
    model.start()
    model.run(run_ticks)
    return list(model.edges)


@pytest.mark.parametrize("pulse_us", range(1, 21))
def test_a_pulse_has_the_requested_length(pulse_us: int) -> None:
    pulse = ticks(pulse_us)
    seen = driver(play_words([word(0, 3, 0), word(1, 2, 7)], pulse, run_ticks=3000), 0)
    assert len(seen.steps) == 5
    assert seen.pulses == {pulse}
    # In ns: a tick has 80. Rounded up, so that no pulse is shorter than requested.
    assert pulse_us * 1000 <= pulse * 80 < pulse_us * 1000 + 80


@pytest.mark.parametrize("delay", [0, 1, 2, 777])
@pytest.mark.parametrize("pulse", [13, 38, 125])
def test_edges_follow_the_timing_of_programs(pulse: int, delay: int) -> None:
    """The second word has no step: its DIR changes one tick after the machine is ready for it."""
    edges = play_words([word(0, 2, delay), word(1, 0, 0)], pulse, run_ticks=4000)
    # Ticks of the program: 6 to fetch a word, 9 between two pulses, 3 after the last.
    first = 6 + delay
    second = first + pulse + 9 + delay
    ready = second + pulse + 3
    assert edges == [
        (first, STEP[0], 1),
        (first + pulse, STEP[0], 0),
        (second, STEP[0], 1),
        (second + pulse, STEP[0], 0),
        (ready + 1, DIR[0], 1),
    ]


@pytest.mark.parametrize("delay", [0, 1, 1000, LONGEST_DELAY])
def test_a_word_without_steps_is_a_delay(delay: int) -> None:
    """The second word turns DIR one tick after the first has taken 6 ticks and its delay."""
    edges = play_words([word(0, 0, delay), word(1, 0, 0)], pulse=38, run_ticks=delay + 100)
    assert edges == [(6 + delay + 1, DIR[0], 1)]


def test_a_word_has_up_to_4095_steps() -> None:
    seen = driver(
        play_words([word(1, MOST_STEPS, 3)], pulse=38, run_ticks=MOST_STEPS * 50 + 100), 0
    )
    # First step: 6 ticks + delay 3. Interval: pulse 38 + 9 ticks of the program + delay 3.
    assert seen.steps == [(9 + 50 * k, 1) for k in range(MOST_STEPS)]


_ANY_WORD = st.builds(word, st.integers(0, 1), st.integers(0, 6), st.integers(0, 300))


@given(st.lists(_ANY_WORD, max_size=20), st.integers(4, 150))
def test_model_and_computation_agree_on_random_words(words: "list[int]", pulse: int) -> None:
    """Two words that turn DIR up and down are added: they show when the machine was ready."""
    steps, ready = compute_steps(words, pulse)
    edges = play_words([*words, word(1, 0, 0), word(0, 0, 0)], pulse, run_ticks=ready + 20)
    assert driver(edges, 0).steps == steps
    # The machine fetches the last two words as soon as it is ready, and again 6 ticks later.
    assert (ready + 7, DIR[0], 0) == edges[-1]


@pytest.mark.parametrize("name", ["reversals", "one step"])
def test_model_and_test_engines_agree_on_moves(name: str) -> None:
    """_play_words() of test_engines computes the steps; the model runs the programs."""
    rows = move_rows(name)
    waiting = iter(rows)

    def next_segment(into: "array[int]") -> int:
        """Copy the next row; return 0 if there is none."""
        segment = next(waiting, None)
        into[:] = segment or into
        return int(segment is not None)

    planner = SimpleNamespace(motors=AXES)
    stand_in: Any = SimpleNamespace(planner=planner, segments=SimpleNamespace(next=next_segment))
    by_arithmetic = _play_words(stand_in, us=1)  # tick, axis, sign; a tick as the unit of time
    played = words_of(rows).played()
    by_model = [
        (tick, i, -1 if level else 1) for i in range(AXES) for tick, level in played[i].steps
    ]
    assert sorted(by_model) == by_arithmetic
    assert by_model


# Segments


@given(timed_segments())
def test_every_step_comes_in_its_planned_tick(
    case: "tuple[Timing, list[array[int]]]",
) -> None:
    """Count, direction and time; a segment delayed by one axis is delayed as a whole.

    The steps expected (words.due) are computed from the segments, not from the words.
    """
    timing, rows = case
    words = words_of(rows, timing)
    assert [seen.steps for seen in words.played()] == words.due


@given(timed_segments())
def test_drivers_get_the_times_they_need(case: "tuple[Timing, list[array[int]]]") -> None:
    timing, rows = case
    for seen in words_of(rows, timing).played():
        check_times(seen, timing)
        assert seen.pause >= 9  # ticks of the program between two pulses


@pytest.mark.parametrize("timing", TIMINGS.values(), ids=TIMINGS)
def test_a_reversal_takes_the_shortest_allowed_time(timing: Timing) -> None:
    """At the highest rate, back and forth: hold and setup are exact to a tick, or take no extra
    time."""
    pulse, hold, setup = (ticks(us) for us in timing)
    gap = pulses.shortest_gap(pulse)
    # Four segments of four steps; every second one is backwards on all three axes (7).
    rows = [row(4 * gap, k % 2 * 7, *[(4, gap, 4 * gap)] * AXES) for k in range(4)]
    for seen in words_of(rows, timing).played():
        check_times(seen, timing)
        # Ticks from the last step before a turn to the first after it.
        turn_ticks = [b[0] - a[0] for a, b in pairwise(seen.steps) if a[1] != b[1]]
        # The program needs at least 10 and 5 ticks for a turn; the rate is never exceeded.
        assert turn_ticks == [max(pulse + max(hold, 10) + max(setup, 5), gap)] * 3


@given(timed_segments())
def test_machines_stay_synchronous_to_the_tick(case: "tuple[Timing, list[array[int]]]") -> None:
    """At the end, each axis carries ticks that its words have not used up. One more word uses them
    up, the next turns DIR: on all axes in the same tick."""
    timing, rows = case
    words = words_of(rows, timing)
    later_ticks = 1000  # ticks after the last segment
    for i in range(AXES):
        level = words.lane(i, pulses.DIR)
        delay = words.lane(i, pulses.CARRY) + later_ticks - 6  # a word takes 6 ticks itself
        words.words[i] += [word(level, 0, delay), word(1 - level, 0, 0)]
    model = words.model()
    model.run(words.end + later_ticks + 20)
    turn_ticks = [[tick for tick, pin, _ in model.edges if pin == DIR[i]][-1] for i in range(AXES)]
    assert turn_ticks == [words.end + later_ticks + 1] * AXES


@given(segments(gap=40))
def test_steps_requested_too_fast_come_late_and_complete(rows: "list[array[int]]") -> None:
    """Steps closer than the program allows: none is lost, and the machines stay synchronous."""
    words = words_of(rows)
    for i, seen in enumerate(words.played()):
        assert [level for _, level in seen.steps] == [level for _, level in words.due[i]]
        check_times(seen, TIMINGS["usual"])
    # Ready after the last word, plus the ticks not yet used up: the end, on every axis.
    ready = {
        compute_steps(words.words[i], words.pulse)[1] + words.lane(i, pulses.CARRY)
        for i in range(AXES)
    }
    assert ready == {words.end}


@pytest.mark.parametrize("name", MOVES)
def test_moves_are_exact_to_the_tick(name: str) -> None:
    """Moves of a planner, with a board's own times for DIR; due: the steps computed from rows."""
    timing = TIMINGS["generic_breakout"]
    words = words_of(move_rows(name), timing)
    for due, seen in zip(words.due, words.played(), strict=True):
        assert seen.steps == due
        check_times(seen, timing)


def test_the_longest_segment_fits_into_words() -> None:
    """Delays that fill all bits of a word: after a pause, and where one axis waits for another."""
    long, none = pulses.LONGEST, (0, 0, 0)
    rows = [row(1000, 0, (1, 1000, 1000), none, none)]
    rows += [row(long, 1, (2, 0, long), none, (1, long, long))]
    rows += [row(1000, 1, (1, 900, 900), (1, 900, 900), (1, 900, 900))]
    words = words_of(rows)
    assert words.delays[1] > 6  # the turn of the first axis delays the long segment
    assert max(w >> 13 for axis in words.words for w in axis) >= long
    assert [seen.steps for seen in words.played()] == words.due


def test_a_long_segment_is_cut_without_changing_its_steps() -> None:
    """Pieces have 131,072 ticks; some steps fall on the first or the last tick of a piece."""
    edges = [(1, 700_000, 700_000), (7, 131_072, 655_360), (3, 0, 262_143)]
    words = words_of([row(700_000, 2, *edges), row(300_000, 5, *[(2, 1, 299_999)] * 3)])
    assert [seen.steps for seen in words.played()] == words.due
    # Pieces: 5 of the first segment and 2 of the second; the last one of each is longer.
    assert len(words.delays) == 7


# Rates

# Ticks by which slice_kernel.place_steps may misplace the first step of a segment relative to the
# last of the one before: it rounds down, more than once.
_ROUNDING = 1.1


def steady_ticks(words: Words, rows: "list[array[int]]") -> "list[list[int]]":
    """Return the steps' ticks of each axis at a constant rate, without the ends of the move: two
    full segments at each end."""
    begin = 2 << LOG2
    end = words.end - begin
    return [[tick for tick, _ in axis if begin < tick < end] for axis in words.computed()]


def _shortest(hz: int) -> Timing:
    """Return the timing with the shortest pulse that a rate allows."""
    return TIMINGS["1 us" if hz > 250_000 else "shortest pulse"]


def _engine_hz(hz: int) -> int:
    """Return the highest rate of an engine with that timing, for at_rate()."""
    return 500_000 if hz > 250_000 else 390_000


def unevenness(steps: "list[int]") -> "tuple[float, float]":
    """Return the mean interval, and the largest deviation from it."""
    mean = (steps[-1] - steps[0]) / (len(steps) - 1)
    return mean, max(abs(b - a - mean) for a, b in pairwise(steps))


@pytest.mark.parametrize("hz", [1, 7, 50, 333, 1000, 12_345, 100_000, 250_000, 500_000])
def test_intervals_are_even_at_a_constant_rate(hz: int) -> None:
    """Within a tick or 1 %, whichever is more, within segments and from one to the next.

    Slow moves are computed, not played: an interval at 1 Hz has 12.5 million ticks.
    """
    # A twelfth of a second, or 12 steps if that is more.
    rows = at_rate(hz, max(hz // 12, 12), ratio=(1.0, 1.0, 1.0), step_hz=_engine_hz(hz))
    words = words_of(rows, _shortest(hz))
    assert not any(words.delays)
    if hz >= 1000:
        assert [seen.steps for seen in words.played()] == words.computed()
    for steps in steady_ticks(words, rows):
        assert len(steps) >= 6
        mean, worst = unevenness(steps)
        assert mean == pytest.approx(HZ / hz, rel=0.02)
        assert worst <= max(1.01, mean / 100)  # a tick, and 0.01 for rounding of the mean itself


@pytest.mark.parametrize("ratio", [(1.0, 1.0, 1.0), (1.0, 0.61, 0.383), (1.0, 0.999, 0.05)])
@pytest.mark.parametrize(
    "hz", [47_123, 71_060, 125_000, 171_640, 200_000, 250_000, 333_333, 411_000, 500_000]
)
def test_fast_axes_are_even_to_three_ticks_at_any_rate(
    hz: int, ratio: "tuple[float, ...]"
) -> None:
    """Intervals differ from their mean by 1.1 ticks, so from each other by less than three, or by
    1 %; the slower axes of the same line, too."""
    rows = at_rate(hz, hz // 4, ratio, step_hz=_engine_hz(hz))
    words = words_of(rows, _shortest(hz))
    assert not any(words.delays)
    for steps in steady_ticks(words, rows):
        mean, worst = unevenness(steps)
        assert worst <= max(_ROUNDING, mean / 100)


@pytest.mark.thorough
@pytest.mark.parametrize(("pulse_us", "hz"), [(3, 250_000), (1, 500_000)])
def test_three_axes_make_the_highest_rate(pulse_us: int, hz: int) -> None:
    """25,000 steps, all three axes in the same tick, counted; the processor makes none of the
    steps."""
    engine_says = HZ // pulses.shortest_gap(ticks(pulse_us))
    assert engine_says == hz
    rows = at_rate(engine_says, steps=25_000, ratio=(1.0, 1.0, -1.0), step_hz=engine_says)
    words = words_of(rows, (pulse_us, 2, 5))
    played = words.played()
    assert [seen.place for seen in played] == [25_000, 25_000, -25_000]
    assert [seen.steps for seen in played] == words.due
    assert {tick for tick, _ in played[0].steps} == {tick for tick, _ in played[2].steps}
    assert not any(words.delays[1:]), "except for the turn of the third axis at the start"
    assert max(len(w) for w in words.words) <= 4 * len(rows)  # not a word per step
    fastest = [tick for tick, _ in played[0].steps][5000:20_000]
    assert (fastest[-1] - fastest[0]) / (len(fastest) - 1) == pytest.approx(HZ / hz, rel=1e-3)
    assert min(seen.pause for seen in played) >= 9  # ticks of the program between two pulses


def test_pulse_plus_nine_ticks_is_the_programs_limit() -> None:
    """Within a segment and from one to the next; steps requested sooner come at that time."""
    for pulse_us in (1, 3, 10):
        pulse = ticks(pulse_us)
        for requested, played in ((pulse + 9, pulse + 9), (pulse + 8, pulse + 9)):
            steps = (5, requested, 5 * requested)
            rows = [row(5 * requested, 0, *[steps] * AXES) for _ in range(4)]
            for seen in words_of(rows, (pulse_us, 2, 5)).played():
                assert {b[0] - a[0] for a, b in pairwise(seen.steps)} == {played}


@pytest.mark.parametrize("ratio", [(1.0, 1.0, 1.0), (1.0, 0.61, 0.083), (1.0, 0.999, 0.5)])
@pytest.mark.parametrize("pulse_us", [1, 3])
def test_the_stated_rate_includes_a_margin_for_rounding(
    pulse_us: int, ratio: "tuple[float, ...]"
) -> None:
    """No segment waits for another, although rounding makes gaps up to a tick shorter."""
    gap = pulses.shortest_gap(ticks(pulse_us))
    assert gap > ticks(pulse_us) + 9  # the program's limit
    rows = at_rate(HZ // gap, 20_000, ratio, step_hz=600_000)
    assert not any(words_of(rows, (pulse_us, 2, 5)).delays)
    # Faster than the program allows.
    rows = at_rate(HZ // (ticks(pulse_us) + 8), 20_000, ratio, step_hz=600_000)
    assert any(words_of(rows, (pulse_us, 2, 5)).delays)


# Running empty, and stops


@given(timed_segments(5), st.lists(st.integers(0, 400), min_size=5, max_size=5))
@some(30)
def test_machines_wait_for_late_words(
    case: "tuple[Timing, list[array[int]]]", gaps: "list[int]"
) -> None:
    """No step is lost or repeated, no pulse is cut short, and no pin moves between words.

    gaps: ticks that the machines wait for the words of the next segment.
    """
    timing, rows = case
    words = Words(timing)
    model = words.model()
    for segment, gap in zip(rows, gaps, strict=False):
        sent = [len(w) for w in words.words]  # words of each axis
        words.add(segment)
        for i, count in enumerate(sent):
            model.waiting[i] += words.words[i][count:]
        # Long enough to play the segment and to end its last pulse.
        model.run(words.delays[-1] + segment[ROW_TICKS] + 2 * words.pulse + 400)
        edges = len(model.edges)
        model.run(gap)
        assert len(model.edges) == edges, "a pin has moved"
        assert all(model.at(i) == programs.NEXT for i in range(AXES))  # waiting for a word
    for i in range(AXES):
        seen = driver(model.edges, i)
        assert [level for _, level in seen.steps] == [level for _, level in words.due[i]]
        check_times(seen, timing)


def check_undone(words: Words, model: Any) -> None:
    """Check pulses.undone(): a machine's state gives the number of steps not yet made, signed."""
    for i in range(AXES):
        sent = words.lane(i, pulses.HEAD)  # words written
        undone = pulses.undone(words.ring, i, sent, model.unread(i), model.at(i), model.x(i))
        position_at_end = sum(-1 if level else 1 for _, level in words.due[i])
        assert driver(model.edges, i).place == position_at_end - undone


def test_undone_steps_are_known_in_every_tick() -> None:
    """Through every instruction of the program: turns, steps at once, words without steps."""
    words = Words(TIMINGS["shortest pulse"])
    for dirs in (2, 5, 5, 0):
        words.add(row(400, dirs, (4, 0, 200), (3, 60, 399), (1, 400, 400)))
    model = words.model()
    addresses = set()  # of the instructions at which a machine was checked
    for _ in range(words.end + 100):
        check_undone(words, model)
        addresses.update(model.at(i) for i in range(AXES))
        model.run(1)
    assert addresses == set(range(len(programs.stepper[0])))  # all
    check_undone(words, model)


@given(timed_segments(5), st.data())
@some(40)
def test_a_stop_in_any_tick_leaves_a_known_position(
    case: "tuple[Timing, list[array[int]]]", data: Any
) -> None:
    """The position follows from the state of the stopped machines; no pin changes any more."""
    timing, rows = case
    words = words_of(rows, timing)
    model = words.model()
    model.run(data.draw(st.integers(0, words.end)))
    model.stop()
    edges = len(model.edges)
    check_undone(words, model)
    model.run(500)
    assert len(model.edges) == edges


# The clock


@given(st.lists(st.integers(4, 4000), min_size=1, max_size=20))
def test_the_clock_interrupts_at_segment_boundaries(lengths: "list[int]") -> None:
    """lengths: ticks of each segment. The clock's program takes 4 ticks per word itself."""
    model = pio_model.PioModel(programs.clock, [None])
    model.waiting[0] += [length - 4 for length in lengths]
    model.start()
    model.run(sum(lengths) + 100)
    # The first interrupt comes one tick after the start.
    assert model.interrupts == [1 + tick for tick in accumulate([0, *lengths])]


# The engine, on a chip


class EngineBench:
    """An engine on a modelled chip, and the segments it has requested."""

    def __init__(self, patch: pytest.MonkeyPatch, timing: Timing, motors: int) -> None:
        self.timing = timing
        self.motors = motors
        self.chip = pio_model.PioChip(patch, _STEP[:motors], _DIR[:motors], *timing[1:])
        self.engine = self.chip.engine
        self.waiting: list[array[int]] = []
        self.powers: list[tuple[int, int]] = []  # tick, power
        self.request_ticks: list[int] = []  # ticks at which a segment was requested
        self.stop_ticks: list[int] = []  # ticks at which the machines stood still
        self.faults: list[int] = []  # ticks at which the engine reported a fault
        self.engine.attach(
            self._next,
            lambda power: self.powers.append((self.chip.now, power)),
            lambda: self.stop_ticks.append(self.chip.now),
        )
        self.engine.on_fault = lambda: self.faults.append(self.chip.now)
        self.engine.configure(timing[0], 0, 0)  # no pin is inverted
        self.engine.arm()

    def _next(self, into: Any) -> int:
        """Write the next segment to the engine's row; return 0 if there is none."""
        if not self.waiting:
            return 0
        self.request_ticks.append(self.chip.now)
        row = pulses.ptr32(into)  # an address
        for i, value in enumerate(self.waiting.pop(0)):
            row[i] = value
        return 1

    def start(self, rows: "Iterable[array[int]]") -> "EngineBench":
        self.waiting += rows
        self.engine.start()
        return self

    def restart(self, rows: "Iterable[array[int]]") -> "EngineBench":
        """Start motion after a stop."""
        self.waiting.clear()
        self.engine.arm()
        return self.start(rows)

    def finish(self) -> "EngineBench":
        self.chip.run_until_idle()
        return self

    def finish_with_latencies(self, latencies: "list[int]") -> None:
        """Run to the end with these interrupt latencies in turn, in ticks."""
        for latency in cycle(latencies):
            self.chip.latency = latency
            self.chip.run(1500)  # ticks
            if self.engine.idle() and not self.waiting:
                break
        self.finish()

    def drivers(self) -> "list[Driver]":
        """Return the drivers' views. Motors of PIO 1 appear a tick late: pio_model.PioChip says
        why."""
        of_pio_1 = [(tick - 1, *edge) for tick, *edge in self.chip.edges]
        edges: list[Any] = [self.chip.edges, of_pio_1]
        return [driver(edges[i >= _OF_PIO_0], i) for i in range(self.motors)]

    def counted_steps(self) -> "list[int]":
        """Return the position given by the steps received."""
        return [seen.place for seen in self.drivers()]

    def reported_steps(self) -> "list[int]":
        """Return the position that the engine reports."""
        steps = array("i", [0] * self.motors)
        self.engine.position(steps)
        return list(steps)

    def total_steps(self) -> int:
        """Return the steps so far, of all motors."""
        return sum(pin in _STEP and level for _, pin, level in self.chip.edges)


@contextmanager
def engine_bench(
    timing: Timing = TIMINGS["usual"],
    latency: int = 0,
    counted: bool = True,
    flight: int = 1,
    motors: int = AXES,
) -> "Iterator[EngineBench]":
    """Yield a bench; no word may be lost without a fault.

    latency: of interrupts, in ticks. counted, flight: how DMA detects free space, and ticks of a
    word from it to a FIFO (pio_model.Channel).
    """
    with pytest.MonkeyPatch.context() as patch:
        bench = EngineBench(patch, timing, motors)
        bench.chip.latency = latency
        for channel in bench.chip.channels:
            channel.counted, channel.flight = counted, flight
        yield bench
        assert not bench.chip.lost() or bench.faults


DMA_READINGS = st.tuples(st.booleans(), st.integers(1, 3))


def first_ticks(rows: "Iterable[array[int]]", drivers: "list[Driver]") -> "list[int | None]":
    """Return the first tick of each segment; None for one without steps.

    It follows from every step of every axis; all must agree.
    """
    steps = [iter(seen.steps) for seen in drivers]
    ticks_of_rows: list[int | None] = []
    for segment in rows:
        begin_ticks = set()  # of this segment, from each of its steps
        for axis, track in enumerate(steps):
            base = ROW_AXES + ROW_STRIDE * axis
            for k in range(segment[base]):
                tick, level = next(track)
                assert level == segment[ROW_DIRS] >> axis & 1
                begin_ticks.add(tick - step_tick(segment, base, k))
        assert len(begin_ticks) <= 1, "the axes' steps disagree"
        ticks_of_rows.append(begin_ticks.pop() if begin_ticks else None)
    assert not [step for track in steps for step in track], "steps that were not requested"
    return ticks_of_rows


def fast_rows(
    ways: "Sequence[int]", timing: Timing = TIMINGS["usual"], motors: int = AXES
) -> "list[array[int]]":
    """Return a segment at the highest rate for each mask of directions (1: negative).

    X and Y make 30 steps in each, Z 7, the first at once; motors after the third repeat these.
    """
    gap = pulses.shortest_gap(ticks(timing[0]))
    edges = [(30, gap, 30 * gap), (30, gap, 30 * gap), (7, 0, 25 * gap)]
    return [row(30 * gap, dirs, *(edges * 3)[:motors]) for dirs in ways]


def clock_intervals(words: Words, rows: "list[array[int]]") -> "list[int]":
    """Return the ticks between the clock's interrupts.

    A segment of 80,000 ticks or more has one 40,000 ticks before its end, too.
    """
    intervals = []
    for late, segment in zip(words.delays, rows, strict=True):
        whole = late + segment[ROW_TICKS]
        intervals += [whole - 40_000, 40_000] if segment[ROW_TICKS] >= 80_000 else [whole]
    return intervals


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("name", "latency"),
    [
        *[
            (name, latency)
            for name in ("reversals", "fast", "250 kHz", "500 kHz")
            for latency in (0, 13_000)
        ],
        ("whole segments", 35_000),
    ],
)
def test_the_engine_makes_all_steps_at_their_ticks(name: str, latency: int) -> None:
    """Through DMA and interrupts, which come as rows begin.

    They may be 2.8 ms late (35,000 ticks), or 1.0 ms (13,000) if rows are shorter than segments of
    full length.
    """
    hz = 500_000 if name == "500 kHz" else 250_000
    timing = _shortest(hz)
    rows = (
        move_rows(name) if name in MOVES else at_rate(hz, 15_000, (1.0, 1.0, -1.0), _engine_hz(hz))
    )
    if name == "whole segments":
        rows = at_rate(40_000, 3_000, (1.0, 1.0, -1.0))
        rows = [segment for segment in rows if segment[ROW_TICKS] > 80_000]
        assert len(rows) > 2
    words = words_of(rows, timing)
    with engine_bench(timing, latency) as bench:
        bench.start(rows).finish()
        shift = {  # ticks from start() to the first row: the same for every step
            tick - due
            for seen, track in zip(bench.drivers(), words.due, strict=True)
            for (tick, _), (due, _) in zip(seen.steps, track, strict=True)
        }
        assert len(shift) == 1, "the processor has delayed a step"
        # The first interrupt is caused by start().
        assert [b - a for a, b in pairwise(bench.chip.interrupts[1:])] == clock_intervals(
            words, rows
        )
        assert 0 < bench.chip.interrupts[1] - shift.pop() < 10
        assert bench.reported_steps() == bench.counted_steps()


def test_the_clock_waits_for_a_turn_like_the_machines() -> None:
    """A turn delays its segment, and with it the clock's interrupt; here in a segment of 3 ticks,
    which is shorter than the clock's own loop."""
    rows = [*fast_rows([0] * 5), row(3, 7, *[(1, 2, 2)] * AXES), *fast_rows([7] * 2)]
    words = words_of(rows)
    assert words.delays[5] > 100  # the segment that turns all axes
    with engine_bench() as bench:
        bench.start(rows).finish()
        assert [b - a for a, b in pairwise(bench.chip.interrupts[1:])] == clock_intervals(
            words, rows
        )


@pytest.mark.thorough
def test_the_engine_knows_its_position_in_motion() -> None:
    """Its reported steps are read often at the start, then at irregular times until the end."""
    rows = move_rows("fast")
    with engine_bench() as bench:
        bench.start(rows)
        for pause in chain([777] * 50, cycle([9_973, 41, 20_011])):
            bench.chip.run(pause)
            if bench.engine.idle():
                break
            # Its timer counts microseconds; a step may come in between.
            off = [
                abs(a - b)
                for a, b in zip(bench.reported_steps(), bench.counted_steps(), strict=True)
            ]
            assert max(off) <= 1
        # The last target of the move: (8.0, -6.5, 0.0) mm at 400 steps/mm.
        assert bench.reported_steps() == bench.counted_steps() == [3200, -2600, 0]


@pytest.mark.parametrize("motors", MOTORS)
@given(st.integers(0, 3000), DMA_READINGS, st.data())
@some(40)
def test_a_stop_of_the_engine_is_immediate_and_leaves_the_true_position(
    motors: int, latency: int, dma: "tuple[bool, int]", data: Any
) -> None:
    """Whichever words were made, handed over, fetched, or in transit from DMA to a FIFO.

    dma: arguments counted and flight of engine_bench().
    """
    timing, rows = data.draw(timed_segments(14, motors))
    with engine_bench(timing, latency, *dma, motors) as bench:
        bench.start(rows)
        bench.chip.run(data.draw(st.integers(0, 2 * latency + sum(r[ROW_TICKS] for r in rows))))
        bench.engine.stop()
        edges = len(bench.chip.edges)
        assert bench.engine.idle()
        assert bench.reported_steps() == bench.counted_steps()
        bench.chip.run(3000)
        assert len(bench.chip.edges) == edges
        assert bench.reported_steps() == bench.counted_steps()


@pytest.mark.sampled(1)
@pytest.mark.parametrize("motors", MOTORS)
@given(st.data())
@some(30)
def test_motion_after_a_stop_keeps_the_drivers_times(motors: int, data: Any) -> None:
    """The stop comes anywhere; the segments after it turn or not, with their first step at
    once.

    The motors' pulses, and the waits before and after a change of DIR, are never shorter than
    set.
    """
    timing = data.draw(st.sampled_from(sorted(TIMINGS.values())))
    ways = st.lists(st.integers(0, (1 << motors) - 1), min_size=3, max_size=3)
    with engine_bench(timing, 0, *data.draw(DMA_READINGS), motors) as bench:
        rows = fast_rows(data.draw(ways), timing, motors)
        bench.start(rows)
        bench.chip.run(data.draw(st.integers(0, sum(segment[ROW_TICKS] for segment in rows))))
        bench.engine.stop()
        stop_tick, before = bench.chip.now, bench.counted_steps()
        bench.engine.set_position(array("i", [0] * motors))
        rows = fast_rows(data.draw(ways), timing, motors)
        bench.restart(rows).finish()
        moved = [b - a for a, b in zip(before, bench.counted_steps(), strict=True)]
        assert bench.reported_steps() == moved
        drivers = bench.drivers()
        for seen in drivers:
            assert all(length >= ticks(timing[0]) for length in seen.pulses)
            assert seen.hold >= ticks(timing[1])
            assert seen.setup >= ticks(timing[2])
            seen.steps = [step for step in seen.steps if step[0] >= stop_tick]
        first_ticks(rows, drivers)  # checks that exactly the steps of these rows were made


@pytest.mark.parametrize("motors", MOTORS)
def test_a_turn_cut_off_by_a_stop_is_repeated(motors: int) -> None:
    """At the first stop the words that turn DIR were written already; the pin had not changed. The
    new words must turn it again, before Z's first step, which comes at once.

    After a stop while idle only the last motor turns back: its setup time must not depend on the
    others' delay.
    """
    back = (1 << motors) - 1  # all motors
    with engine_bench(motors=motors) as bench:
        bench.start(fast_rows([0, back], motors=motors))
        bench.chip.run(2000)  # ticks: in the first segment
        bench.engine.stop()
        bench.restart(fast_rows([back], motors=motors)).finish()
        bench.engine.stop()
        bench.restart(fast_rows([back >> 1], motors=motors)).finish()
        for seen in bench.drivers():
            assert {level for _, level in seen.steps} == {0, 1}
            assert seen.setup >= ticks(bench.timing[2])


@pytest.mark.sampled(1)
@pytest.mark.parametrize(("motors", "every"), [(3, 7), (6, 19), (8, 31)])
def test_a_stop_may_interrupt_the_engines_own_interrupt(motors: int, every: int) -> None:
    """A limit switch closes while the engine works: after every `every` accesses to memory; in the
    first ring after every 4 times as many."""
    rows = fast_rows([0, 255, 5], motors=motors)
    with engine_bench(motors=motors) as bench:
        total = bench.start(rows).finish().chip.accesses  # to memory and registers
    assert total > 1000
    for after in range(1, total, 4 * every if rings.is_first() else every):
        with engine_bench(motors=motors) as bench:
            places: list[list[int]] = []

            def stop(bench: EngineBench = bench, places: "list[list[int]]" = places) -> None:
                bench.engine.stop()
                places.append(bench.counted_steps())

            bench.chip.preempt(after, stop)
            bench.start(rows)
            while not places:
                bench.chip.run(100)
            bench.chip.run(300)
            assert bench.engine.idle()
            assert [bench.reported_steps()] == [bench.counted_steps()] == places


@pytest.mark.parametrize("motors", [3, 6, 8])
@pytest.mark.parametrize("work", ["stop", "lock", "position"])
def test_a_stop_may_interrupt_the_main_loops_calls(work: str, motors: int) -> None:
    """At any access to memory during the call, in motion, with an axis locked; the reported
    position is true.

    Each round stops one or a few accesses later, until the call ends before the stop.
    """
    for after in range(1, 1000, 2 if motors == AXES else 5):
        with engine_bench(motors=motors) as bench:
            steps = array("i", [0] * motors)
            calls: dict[str, Callable[[], None]] = {
                "stop": bench.engine.stop,
                "lock": lambda bench=bench: bench.engine.lock(0b110100),
                "position": lambda bench=bench, steps=steps: bench.engine.position(steps),
            }
            bench.start(fast_rows([0, 0], motors=motors))
            bench.chip.run(2500)  # ticks: during the motion
            bench.engine.lock(0b010)  # Y
            bench.chip.run(1100)
            before = bench.chip.accesses
            bench.chip.preempt(after, bench.engine.stop)
            bench.chip.interruptible(calls[work])
            if bench.chip.accesses - before < after:
                break  # the call ended before the stop: every access was tried
            assert bench.reported_steps() == bench.counted_steps()
            if work == "position":
                off = [abs(a - b) for a, b in zip(steps, bench.counted_steps(), strict=True)]
                assert max(off) <= 1
    else:
        raise AssertionError("the call never ended before the stop")
    assert after > 10


@pytest.mark.parametrize("motors", MOTORS)
@given(st.data(), st.lists(st.integers(0, 9000), min_size=1, max_size=9))
@some(20)
def test_late_interrupts_lose_no_step(motors: int, data: Any, latencies: "list[int]") -> None:
    """Motion pauses between segments, with all axes together, and continues.

    latencies: ticks of the interrupts in turn; 9000 are 0.7 ms.
    """
    rows = data.draw(segments(gap=160, most=12, motors=motors))
    with engine_bench(motors=motors) as bench:
        bench.start(rows).finish_with_latencies(latencies)
        first_ticks(rows, bench.drivers())
        assert bench.reported_steps() == bench.counted_steps()
        for seen in bench.drivers():
            check_times(seen, bench.timing)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("latency", [0, 60_000])
@pytest.mark.parametrize(
    ("motors", "locked_axis"),
    [(motors, locked_axis) for motors in MOTORS for locked_axis in range(1, motors)],
)
def test_a_locked_axis_stands_still_and_the_others_continue(
    motors: int, locked_axis: int, latency: int
) -> None:
    """Also if motion pauses meanwhile (late interrupts) and all machines are started again.

    After a stop the locked axis moves again. latency: of interrupts, in ticks.
    """
    row_steps = ([30, 30, 7] * 3)[:motors]  # steps of a row
    with engine_bench(motors=motors) as bench:
        bench.start(fast_rows([0] * 8 + [255] * 12, motors=motors))
        bench.chip.run(6000)  # ticks: in the first rows
        bench.chip.latency = latency
        bench.engine.lock(1 << locked_axis)
        locked_at = bench.counted_steps()[locked_axis]
        assert bench.reported_steps()[locked_axis] == locked_at > 0
        bench.finish()
        ends = [-4 * steps for steps in row_steps]  # 8 rows forwards, 12 backwards
        ends[locked_axis] = locked_at
        assert bench.counted_steps() == bench.reported_steps() == ends
        bench.chip.latency = 0
        bench.engine.stop()
        assert bench.reported_steps() == bench.counted_steps()
        # One more row: backwards, except the axis that was locked.
        bench.restart(fast_rows([255 - (1 << locked_axis)], motors=motors)).finish()
        ends = [at - steps for at, steps in zip(ends, row_steps, strict=True)]
        ends[locked_axis] = locked_at + row_steps[locked_axis]
        assert bench.reported_steps() == bench.counted_steps() == ends


@pytest.mark.parametrize("count", [4000, 60_000, 131_072])
def test_segments_are_requested_shortly_before_they_begin(count: int) -> None:
    """So that a hold acts soon: 3.2 ms before (40,000 ticks), or one or two segments if that is
    more.

    count: ticks of a segment.
    """
    rows = [row(count, 0, *[(9, 400, count)] * AXES) for _ in range(240_000 // count + 3)]
    with engine_bench() as bench:
        bench.start(rows).finish()
        starts = [start or 0 for start in first_ticks(rows, bench.drivers())]
        ahead = [
            start - asked for start, asked in zip(starts, bench.request_ticks, strict=True)
        ]  # ticks
        assert max(ahead) <= 40_000 + (2 * count if count < 80_000 else 0)
        assert min(ahead[len(rows) // 2 :]) >= 39_000  # without the first ones: nothing ran yet


@pytest.mark.parametrize("latency", [0, 700])
def test_power_is_reported_when_its_segment_begins(latency: int) -> None:
    """Only changes are reported; KEEP_POWER changes nothing."""
    rows = fast_rows([0] * 12)
    powers = [5, 5, 9, KEEP_POWER, 9, 0, 300, 300, 300, KEEP_POWER, 1, 1]
    for segment, power in zip(rows, powers, strict=True):
        segment[ROW_POWER] = power
    with engine_bench(latency=latency) as bench:
        bench.start(rows).finish()
        starts = first_ticks(rows, bench.drivers())
        assert [power for _, power in bench.powers] == [5, 9, 0, 300, 1]
        # k: the row that brings the change.
        for (tick, _), k in zip(bench.powers, (0, 2, 5, 6, 10), strict=True):
            # The first step may have to wait some ticks; the interrupt takes a tick per register.
            assert -16 <= tick - (starts[k] or 0) <= latency + 50


@given(segments(gap=160, most=12), st.lists(st.integers(0, 9000), min_size=1, max_size=5))
@some(20)
def test_power_after_motion_is_that_of_the_last_segment(
    rows: "list[array[int]]", latencies: "list[int]"
) -> None:
    """However late interrupts come: power of some segments may be skipped, never the last
    one's."""
    for k, segment in enumerate(rows):
        segment[ROW_POWER] = 900 - k  # falls from row to row: shows the order
    with engine_bench() as bench:
        bench.start(rows).finish_with_latencies(latencies)
        reported = [power for _, power in bench.powers]
        assert reported == sorted(set(reported), reverse=True)
        assert reported[-1] == rows[-1][ROW_POWER]


@pytest.mark.parametrize("after", range(300, 8000, 700))
def test_no_power_is_reported_after_a_stop(after: int) -> None:
    """after: ticks from the start to the stop; the interrupts are 450 ticks late."""
    rows = fast_rows([0] * 7)
    for k, segment in enumerate(rows):
        segment[ROW_POWER] = k
    with engine_bench(latency=450) as bench:
        bench.start(rows)
        bench.chip.run(after)
        bench.engine.stop()
        reports = len(bench.powers)
        bench.chip.run(3000)
        assert len(bench.powers) == reports


def test_a_long_segment_is_played_in_pieces() -> None:
    """A segment of 104 ms with 2 steps of X, as at 10 steps/s, between fast ones."""
    long = row(1_300_000, 2, (2, 650_000, 1_300_000), (1, 9, 9), (0, 0, 0))
    rows = [*fast_rows([0, 0]), long, *fast_rows([1])]
    with engine_bench() as bench:
        bench.start(rows).finish()
        starts = [start or 0 for start in first_ticks(rows, bench.drivers())]
        # The row after the long one turns X and Y back or forth, which delays it.
        assert starts[3] - starts[2] == long[ROW_TICKS] + words_of(rows).delays[-1]
        assert bench.reported_steps() == bench.counted_steps()


def test_pins_are_inverted_on_request() -> None:
    """Levels at the pins, also while idle: STEP of the second motor, DIR of the first and
    third."""
    with engine_bench() as bench:
        bench.engine.configure(10, 0b010, 0b101)  # pulse in us, inversion of STEP and of DIR
        pins = [bench.chip.mcu.gpio[pin] for pin in (*STEP, *DIR)]
        assert [pin.value.name for pin in pins] == ["LOW", "HIGH", "LOW", "HIGH", "LOW", "HIGH"]
        bench.chip.edges.clear()
        bench.start(fast_rows([0b001])).finish()  # X backwards, 30 steps of Y
        assert sum(pin == STEP[1] and not level for _, pin, level in bench.chip.edges) == 30
        assert [level for _, pin, level in bench.chip.edges if pin == DIR[0]] == [0]
        bench.engine.configure(10, 0, 0)  # X's DIR is high now: backwards, not inverted
        assert [pin.value.name for pin in pins] == ["LOW", "LOW", "LOW", "HIGH", "LOW", "LOW"]


def test_the_highest_rate_depends_on_the_pulse_length() -> None:
    """12 ticks between two pulses: the program's 9, and 3 as a margin for rounding."""
    with engine_bench() as bench:
        stated = [bench.engine.max_step_hz(us) for us in (1, 3, 5, 10, 255)]
        assert stated == [HZ // (ticks(us) + 12) for us in (1, 3, 5, 10, 255)]
        assert stated[:2] == [500_000, 250_000]


@pytest.mark.parametrize("hz", [125_000_000, 133_000_000, 150_000_000, 200_000_000])
def test_a_processor_clock_of_whole_ticks_is_required(
    hz: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A tick is 80 ns: a machine's clock divider must be a whole number."""
    monkeypatch.setattr(machine, "freq", lambda: hz)
    if hz % HZ:
        with pytest.raises(ValueError, match=r"12\.5 MHz"), engine_bench():
            pass
    else:
        with engine_bench() as bench:
            assert bench.engine.tick_hz == HZ
            machines = rp2.StateMachine.machines.values()
            assert [one.freq for one in machines] == [HZ] * (AXES + 1)  # axes and the clock


def test_rp2350_registers_match_its_data_sheet() -> None:
    """Addresses only: the model is the RP2040's with these moved. PIO 0 and 1 have the same
    addresses on both chips."""
    with engine_bench(), pytest.MonkeyPatch.context() as patch:
        state = memory.Memory(AXES, True).state  # True: of an RP2350
        timer, masked, busy = state_layout.TIMER, state_layout.MASKED_IRQS, state_layout.BUSY
        assert state[timer] == 0x400B0000 + 0x28  # TIMER0, TIMERAWL
        # IO_IRQ_BANK0, PIO1_IRQ_0, TIMER0_IRQ_0 to 3
        assert state[masked] == 1 << 21 | 1 << 17 | 0b1111
        assert state[busy] == 1 << 26  # CH0_CTRL_TRIG
        patch.setattr(sys.implementation, "_machine", "Raspberry Pi Pico2 with RP2350")
        pins = (*_STEP[:6], *_DIR[:6])
        # GPIOn_CTRL of IO_BANK0; 6: the function PIO 0.
        registers: dict[int, int] = {0x40028004 + 8 * pin: 6 for pin in pins}
        patch.setattr(machine, "mem32", registers)
        engine = PioEngine(_STEP[:6], _DIR[:6])
        engine.configure(10, 0b100001, 0b000100)  # pulse in us, inversion of STEP and of DIR
        inverted = {STEP[0], _STEP[5], DIR[2]}
        for pin in pins:  # GPIOn_CTRL, OUTOVER in bits 13:12
            assert registers[0x40028004 + 8 * pin] == 6 | (pin in inverted) << 12
        sixth = engine._memory.lanes[pulses.LANE * 5 + pulses.MACHINE]
        assert sixth == 0x50300000 + 0xE0  # PIO 1, SM1_CLKDIV
        assert engine._engine_state[state_layout.CLOCK_PIO] == 0x50300000
        patch.setattr(rp2.DMA, "claimed", 0)
        engine = PioEngine(_STEP[:8], _DIR[:8])
        eighth = engine._memory.lanes[pulses.LANE * 7 + pulses.MACHINE]
        assert eighth == 0x50300000 + 0x110  # PIO 1, SM3_CLKDIV
        assert engine._engine_state[state_layout.CLOCK_PIO] == 0x50400000  # PIO 2
        assert engine._engine_state[masked] == 1 << 21 | 1 << 19 | 1 << 17 | 0b1111  # PIO2_IRQ_0
        with pytest.raises(ValueError, match="only pins 0 to 31 make pulses"):
            PioEngine((2, 4, 6), (3, 5, 32))


# The laser


@given(
    st.lists(
        st.tuples(st.integers(0, 1), st.integers(0, 5), st.integers(0, 200)),
        min_size=1,
        max_size=12,
    ),
    st.integers(38, 130),
)
@some(30)
def test_the_laser_program_plays_words_at_the_times_of_steps(
    words: "list[tuple[int, int, int]]", pulse: int
) -> None:
    """A change of power comes one tick after the step's rising edge, for all words.

    The same words are played by the program of a motor and by that of the laser, which puts a word
    into its FIFO for each step. words: DIR, steps, delay; pulse: ticks.
    """
    motor = pio_model.PioModel(programs.stepper, [(2, 3)])
    beam = pio_model.PioModel(beam_program.beam, [None])
    fifo = beam._pio.machines[0].rx_fifo
    changes = []
    for model in (motor, beam):
        model.waiting[0] += [word(*one) for one in words]
        model.load_isr(0, pulse - 3)
        model.start()
    for _ in range(sum(9 + (steps or 1) * (delay + pulse + 9) for _, steps, delay in words)):
        motor.run(1)
        beam.run(1)
        assert fifo.item_count <= 1
        if fifo.item_count:
            changes.append(beam.now - 1)  # edges are recorded before their tick is counted
            fifo.pull()
    assert [tick - 1 for tick in changes] == [
        tick
        for tick, pin, level in motor.edges
        if (pin, level) == (2, 1)  # STEP rises
    ]
    assert len(changes) == sum(steps for _, steps, _ in words)
    assert motor.unread(0) == beam.unread(0) == 0


@pytest.mark.parametrize(
    ("pin", "place"),
    [(0, 0x40050000), (5, 0x40050028), (15, 0x4005008C), (16, 0x40050000), (25, 0x40050050)],
)
def test_the_pwm_slice_of_a_laser_pin_matches_the_data_sheet(pin: int, place: int) -> None:
    """Data sheet of the RP2040: 4.5.3 has the registers, 1.4.3 the pins."""
    with engine_bench():
        assert slice_of(pin) == place
