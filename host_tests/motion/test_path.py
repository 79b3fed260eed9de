"""The law of the path: at any rate motors are on the line, within half a step and a margin.

The steps of a row are even to a tick, and motors have different remainders: when the longer gaps
came first in rows of 10 ms, two motors were 5 steps apart at 150 kHz.
"""

from array import array

import pytest
from extras.tools import clusters
from hypothesis import given
from hypothesis import strategies as st
from laws import Bench, Limits, off_line, pulses, some
from motion import slice_kernel
from motion.layout import ROW_AXES
from test_braking import ENGINES, FASTEST_HZ
from test_engines import _play_words
from ugrbl.sim.engine import step_tick

# In addition to half a step of rounding: what the order of gaps and ticks leaves open, up to the
# rate in Hz at which rows are as short as in a ramp.
_MARGIN_STEPS = 0.3
_SHORT_ROWS_HZ = 140_000
# The highest step rate of an engine; with STEP_PULSE_MIN_US where pulses may be that short.
_MOST_HZ = {"sim": 500_000, "pio": 500_000, "i2s": 60_000, "rmt": 5_000}


def make_bench(engine: str, rate_hz: float, travel_mm: "tuple[float, ...]") -> Bench:
    """Return a bench with a line on which the fastest motor makes rate_hz, at 1600 steps/mm, after
    a ramp of 25 ms."""
    length = sum(mm * mm for mm in travel_mm) ** 0.5
    mm_s = rate_hz / 1600 * length / max(map(abs, travel_mm))
    limits = Limits((1600.0,) * 3, (mm_s * 60,) * 3, (mm_s * 40,) * 3, step_hz=FASTEST_HZ)
    bench = Bench(limits, 16, *ENGINES[engine])
    bench.line(travel_mm, mm_s * 60)
    return bench


def off_line_steps(bench: Bench) -> float:
    """Return how far the motors are from the line, in steps."""
    bench.finish()
    rows = [(segment.start, segment.row) for segment in bench.watch.made]
    return off_line([[tick for tick, _ in pulses(rows, axis)] for axis in range(3)])


@pytest.mark.parametrize("engine", ENGINES)
@some(6)
@given(
    st.floats(0.05, 1.0),
    st.tuples(st.floats(-4.0, 4.0), st.floats(-4.0, 4.0)),
)
def test_motors_keep_to_the_line(
    engine: str, fraction: float, y_z_mm: "tuple[float, float]"
) -> None:
    """fraction: of the engine's highest step rate; above _SHORT_ROWS_HZ the tolerance
    grows with its square."""
    rate_hz = fraction * _MOST_HZ[engine]
    off_steps = off_line_steps(make_bench(engine, rate_hz, (4.0, *y_z_mm)))
    allowance = max((rate_hz / _SHORT_ROWS_HZ) ** 2, 1.0)
    assert off_steps <= 0.5 + _MARGIN_STEPS * allowance


@pytest.mark.parametrize(("feed", "was"), [(6000, 3.5), (9000, 5.3)])
def test_lines_that_once_failed_keep_to_the_line(feed: int, was: float) -> None:
    """G1X10Y7.3, 1600 steps/mm; was: how far motors were off the line then, in half steps."""
    # of X: its share of the feed
    rate_hz = feed / 60 * 1600 * 10 / (10**2 + 7.3**2) ** 0.5
    for engine in ("sim", "pio"):
        assert (
            off_line_steps(make_bench(engine, rate_hz, (10.0, 7.3, 0.0)))
            < 0.5 + _MARGIN_STEPS
            < was / 2
        )


def test_the_words_of_the_pio_keep_to_the_line() -> None:
    """The words sent to the state machines, at the highest rate with pulses of 10 us."""
    bench = make_bench("pio", 85_000, (10.0, 7.3, -2.2))
    steps = _play_words(bench, us=1)  # times in ticks, as if one lasted 1 us
    assert (
        off_line([[tick for tick, motor, _ in steps if motor == axis] for axis in range(3)])
        < 0.5 + _MARGIN_STEPS
    )


@given(st.integers(1, 4095), st.integers(0, 1000), st.integers(0, 2**18), st.data())
def test_every_reader_of_a_row_places_its_steps_alike(
    steps: int, first: int, span: int, data: st.DataObject
) -> None:
    """Simulator, slicing and dots of a laser (clusters.reach) compute the tick of step k from a
    row: steps, first and last tick."""
    span = span if steps > 1 else 0
    # ticks, directions, power; steps of the motor, first and last tick
    row = array("i", (first + span + 100, 0, 0, steps, first, first + span))
    k = data.draw(st.integers(0, steps - 1))
    tick = step_tick(row, ROW_AXES, k)
    assert slice_kernel.step_tick(row, ROW_AXES, k) == tick
    assert clusters.reach(row, ROW_AXES, k, 1, 2) == tick  # of k + 1/2 steps
