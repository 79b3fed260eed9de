"""The law of the path: whatever the rate, motors are where the line is, to half a step and a bit.

A row's steps are even but for a tick, and motors have different remainders: in rows of 10 ms, the
longer gaps first, two of them were 5 steps apart at 150 kHz.
"""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from laws import Bench, Limits, off_line, pulses, some
from test_braking import ENGINES, FASTEST_HZ
from test_engines import _play_words

# Besides the half step that rounding makes: what the order of gaps and ticks leave open, up to
# where rows are as short as in a ramp, in Hz.
_BIT = 0.3
_TO_HZ = 140_000
# How fast an engine makes steps: shorter pulses than 3 us are asked of none.
_MOST_HZ = {"sim": 250_000, "pio": 250_000, "i2s": 60_000, "rmt": 5_000}


def bench(engine: str, rate_hz: float, way: "tuple[float, ...]") -> Bench:
    """A line on which the fastest motor makes rate_hz, 1600 steps/mm, a ramp of 25 ms."""
    length = sum(mm * mm for mm in way) ** 0.5
    feed = rate_hz / 1600 * length / max(map(abs, way))
    limits = Limits((1600.0,) * 3, (feed * 60,) * 3, (feed * 40,) * 3, step_hz=FASTEST_HZ)
    made = Bench(limits, 16, *ENGINES[engine])
    made.line(way, feed * 60)
    return made


def apart(made: Bench) -> float:
    """How far the motors are from the line, in steps."""
    made.finish()
    rows = [(segment.start, segment.row) for segment in made.watch.made]
    return off_line([[tick for tick, _ in pulses(rows, axis)] for axis in range(3)])


@pytest.mark.parametrize("engine", ENGINES)
@some(6)
@given(
    st.floats(0.05, 1.0),
    st.tuples(st.floats(-4.0, 4.0), st.floats(-4.0, 4.0)),
)
def test_motors_keep_to_the_line(engine: str, part: float, others: "tuple[float, float]") -> None:
    rate_hz = part * _MOST_HZ[engine]
    off = apart(bench(engine, rate_hz, (4.0, *others)))
    steeper = max((rate_hz / _TO_HZ) ** 2, 1.0)
    assert off <= 0.5 + _BIT * steeper


@pytest.mark.parametrize(("feed", "was"), [(6000, 3.5), (9000, 5.3)])
def test_the_lines_that_were_found(feed: int, was: float) -> None:
    """G1X10Y7.3, 1600 steps/mm; was: half steps off the line."""
    rate_hz = feed / 60 * 1600 * 10 / (10**2 + 7.3**2) ** 0.5
    for engine in ("sim", "pio"):
        assert apart(bench(engine, rate_hz, (10.0, 7.3, 0.0))) < 0.5 + _BIT < was / 2


def test_the_words_of_the_pio_keep_to_the_line() -> None:
    """At the highest rate with pulses of 10 us."""
    made = bench("pio", 85_000, (10.0, 7.3, -2.2))
    steps = _play_words(made, 1)
    assert off_line([[at for at, i, _ in steps if i == axis] for axis in range(3)]) < 0.5 + _BIT
