"""Kernels against plain floats; the stand-in for viper raises if 32 bits do not suffice."""

import struct
from array import array
from fractions import Fraction
from math import hypot, isqrt

import pytest
from base.float32 import copy, vector
from hypothesis import example, given
from hypothesis import strategies as st
from laws import Bench, Limits, some
from motion import layout, minifloat, plan_kernel, ramps
from motion.minifloat import real, value
from motion.steps import to_steps

HIGHEST = 2**30 - 1
_PRECISION = 2**-13

words = st.integers(0, HIGHEST)
positive = st.integers(1, HIGHEST)
floats = st.floats(min_value=1e-6, max_value=1e9)
parts = st.integers(0, 2**17)


def to_single(x: float) -> float:
    """Return x rounded to single precision."""
    return struct.unpack("f", struct.pack("f", x))[0]


def is_near(got: float, expected: float, part: float = _PRECISION) -> bool:
    return abs(got - expected) <= part * abs(expected)


# Minifloats


@given(floats)
def test_a_minifloat_is_the_nearest_below(x: float) -> None:
    assert x * (1 - 2**-14) < value(real(x)) <= x


@given(st.one_of(st.just(0.0), st.floats(0.001, 1e9)))
def test_a_rate_per_minute_becomes_the_nearest_below_per_second(feed: float) -> None:
    bits = array("i", array("f", (feed,)).tobytes())
    exact = Fraction(to_single(feed)) / 60
    got = Fraction(value(minifloat.per_second(bits, 0)))
    assert got <= exact <= got * (1 + Fraction(1, 2**14))


@given(floats, floats)
def test_minifloats_compare_like_integers(x: float, y: float) -> None:
    assert (real(x) < real(y)) == (value(real(x)) < value(real(y)))


def test_zero_is_packed_as_zero() -> None:
    assert real(0.0) == minifloat.pack(0, 64) == minifloat.mul(0, real(2.0)) == 0
    assert minifloat.product(0, real(1.0), real(9.0)) == 0


@given(positive, st.integers(40, 90))
def test_packing_keeps_fifteen_bits(n: int, exponent: int) -> None:
    assert is_near(value(minifloat.pack(n, exponent)), n * 2.0 ** (exponent - 64), 2**-14)


@given(floats, floats)
def test_a_product_is_within_tolerance(x: float, y: float) -> None:
    a, b = real(x), real(y)
    assert is_near(value(minifloat.mul(a, b)), value(a) * value(b))


@given(words, floats)
def test_a_ratio_is_within_tolerance(n: int, x: float) -> None:
    assert is_near(value(minifloat.ratio(n, real(x))), n / value(real(x)))


@given(floats)
def test_results_are_normalised(x: float) -> None:
    assert 16384 <= minifloat.mul(real(x), real(3.0)) % 32768


@given(st.integers(0, 2**31 - 1))
@example(0)
@example(1)
@example(2**31 - 1)
def test_square_roots_are_exact(n: int) -> None:
    assert minifloat.square_root(n) == isqrt(n)


@given(floats, floats, floats)
def test_a_product_of_three_is_truncated_and_saturates(x: float, y: float, z: float) -> None:
    """product() returns an integer, at most HIGHEST."""
    exact = value(real(x)) * value(real(y)) * value(real(z))
    got = minifloat.product(real(x), real(y), real(z))
    if exact > HIGHEST * 1.001:
        assert got == HIGHEST
    else:
        assert abs(got - min(exact, HIGHEST)) <= 1 + exact * _PRECISION


# Steps


@given(
    st.floats(width=32, min_value=-20000, max_value=20000),
    st.floats(width=32, min_value=0.0625, max_value=5000),
)
@example(0.5, 1.0)  # half steps are rounded away from 0
@example(-0.5, 1.0)
@example(2.5, 1.0)
@example(0.002, 250.0)  # half a step after the product is rounded
@example(-0.00600000005, 250.0)
@example(0.0, 250.0)
@example(-0.0, 250.0)
@example(1.17549435e-38, 5000.0)  # the smallest normal float
@example(8388607.5, 1.0)  # the largest float with a half
@example(107374.18, 5000.0)  # at the limit, 2**29 steps
def test_millimetres_become_steps_in_single_precision(mm: float, resolution: float) -> None:
    """resolution: steps/mm. Rounding is that of single precision, as in Grbl; out of reach:
    False."""
    target, resolutions = vector(1), vector(1)
    target[0], resolutions[0] = mm, resolution
    table = array("i", [1] + [0] * layout.table_length(1, 1))
    copy(resolutions, memoryview(table)[layout.LIMITS + layout.RESOLUTION :], 1)
    product = to_single(mm * resolution)
    in_reach = to_steps(target, table)
    steps = table[layout.LIMITS + layout.TARGET :]
    farthest = 2**29  # PLACE_BIAS, added to steps, so that none is negative
    assert in_reach == (abs(product) < farthest) or abs(product) == farthest
    if in_reach:
        rounded = int(abs(product) + 0.5)  # exact: a double holds both
        assert steps[0] - farthest == (rounded if product >= 0 else -rounded)


def test_a_position_out_of_reach_keeps_its_direction() -> None:
    """Blocks to a target that cannot be counted in steps: motors still turn the right way."""
    bench = Bench()
    bench.line((10, -10, 0))
    bench.line((3e6, -4e6, 0))
    assert bench.watch.planned[-1].motors[0] > 0 > bench.watch.planned[-1].motors[1]


# The interrupt's arithmetic


@given(words, positive)
def test_a_share_never_exceeds_the_whole(part: int, total: int) -> None:
    """share() returns part / total in 2**-17; a part larger than the total counts as the total."""
    exact = part / total * 2**17
    got = ramps.share(part, total)
    assert got == 2**17 if part >= total else abs(got - exact) <= 2 + exact * 2**-20


@given(words, parts)
def test_times_is_a_product_with_a_fraction(x: int, part: int) -> None:
    exact = x * part / 2**17
    assert abs(ramps.times(x, part) - exact) <= 2 + x * 2**-15


speeds = st.integers(0, 2**30 - 1)
accelerations = st.integers(1, 2**30 - 1)


@given(speeds, speeds, accelerations, st.sampled_from([0, 18]))
def test_braking_distance_matches_floats(speed_1: int, speed_2: int, ramp: int, unit: int) -> None:
    """v**2 = 2 a s, in fixed point; too far: HIGHEST. Speeds and the acceleration, ramp, are in
    2**-18 step per full segment, the distance in 2**-unit step."""
    fast, slow = max(speed_1, speed_2), min(speed_1, speed_2)
    exact = (fast - slow) * (fast + slow) / 2 / ramp * 2.0 ** (unit - 18)
    got = ramps.braking(fast, slow, ramp, unit)
    if exact >= HIGHEST * 1.001:
        assert got == HIGHEST
    elif exact < HIGHEST * 0.999:
        assert abs(got - exact) <= 1 + exact * 2**-12


@given(speeds, accelerations, speeds, st.booleans())
@example(2**30 - 1, 1, 1, False)
@example(2**30 - 1, 2**29, 2**30 - 1, True)
@example(2**28, 2**26, 2**29, True)
def test_speed_after_a_distance_matches_floats(
    speed: int, ramp: int, distance: int, down: bool
) -> None:
    """v**2 = v0**2 + 2 a s, or -2 a s if down; below 0 it is 0. ramp: the acceleration."""
    square = speed**2 + (-2 if down else 2) * ramp * distance
    got = ramps.after(speed, ramp, distance, int(down))
    tolerance = (speed**2 + 2 * ramp * distance) * 2**-11 + 4
    assert got >= 0
    if square < HIGHEST**2 * 0.999:
        exact = max(square, 0)
        assert abs(got**2 - exact) <= tolerance + 4 * got


# Extreme but legal settings: nothing exceeds 32 bits, and every law holds.

extremes = st.builds(
    Limits,
    st.tuples(*[st.sampled_from([1.0, 7.3, 250.0, 5000.0])] * 3),
    st.tuples(*[st.sampled_from([1.0, 60.0, 3000.0, 100_000.0])] * 3),
    st.tuples(*[st.sampled_from([1.0, 30.0, 800.0, 20_000.0])] * 3),
    st.sampled_from([0.0, 0.001, 0.01, 10.0]),
    st.sampled_from([90_909, 250_000]),
)
travels = st.tuples(*[st.sampled_from([-10_000.0, -0.5, 0.0, 0.001, 1.0, 9_999.9])] * 3)


@some(150)
@given(extremes, st.lists(st.tuples(travels, st.sampled_from([0.0, 1.0, 1e3, 1e6])), max_size=4))
def test_extreme_settings_and_distances_stay_within_32_bits(limits, moves) -> None:
    """The stand-in for viper raises if they do not."""
    bench = Bench(limits)
    for target, feed in moves:
        if not bench.planner.full():
            bench.line(target, feed)
        bench.pull(6)  # segments
    bench.hold()
    bench.pull(3)


def test_one_step_in_a_minute_is_made() -> None:
    bench = Bench(Limits((1.0,) * 3, (1.0,) * 3))
    bench.line((3, 1, 0))
    bench.check()


@pytest.mark.parametrize("rate", [60.0, 100_000.0])
@pytest.mark.parametrize("acceleration", [1.0, 20_000.0])
@pytest.mark.parametrize("resolution", [1.0, 5000.0])
def test_a_short_move_at_extreme_settings_keeps_every_law(rate, acceleration, resolution) -> None:
    bench = Bench(Limits((resolution,) * 3, (rate,) * 3, (acceleration,) * 3))
    # 20 steps, and the way of 20 ms at the highest rate
    travel_mm = 20 / resolution + rate / 60 / 50
    bench.line((travel_mm, 0, 0))
    bench.line((travel_mm, travel_mm / 2, -travel_mm / 3))
    bench.check()


# The planner


@given(st.lists(st.integers(-40_000, 40_000), min_size=2, max_size=6))
@example([29_000] * 6)  # the sum of six squares of 14 bits needs more than 30
def test_the_length_of_a_block_matches_its_distances(steps: "list[int]") -> None:
    axes = len(steps)
    # 1 step/mm, 60 mm/min, 100 mm/s2
    bench = Bench(Limits(*[(1.0,) * axes, (60.0,) * axes, (100.0,) * axes]))
    if bench.line([float(count) for count in steps]):
        row = bench.planner.row()
        assert row is not None
        assert is_near(value(row[layout.LENGTH]), hypot(*steps), 2**-11)


mantissas = st.integers(minifloat.SMALLEST, minifloat.LIMIT - 1)


@given(mantissas, mantissas, mantissas)
@example(32767, 16385, 16384)  # the product has one bit more than a mantissa
def test_a_limit_along_a_move_is_the_axis_limit_divided_by_its_share(
    limit_mantissa: int, length_mantissa: int, axis_mantissa: int
) -> None:
    """One axis; as (exponent, mantissa) of minifloats: its limits are (80, limit), its distance
    (64, axis), the block's length (66, length)."""
    table = array("i", [0] * (layout.LIMITS + 6))
    table[layout.AXES] = 1
    # With one axis, from LIMITS on: mm per step, mm/s, mm/s2, two directions, distance.
    table[layout.LIMITS + 1] = table[layout.LIMITS + 2] = (80 << 15) + limit_mantissa
    table[layout.LIMITS + 5] = (64 << 15) + axis_mantissa
    ring = layout.ring(1, 2)
    ring[layout.LENGTH] = (66 << 15) + length_mantissa
    plan_kernel.limit(table, ring, 0)
    # length / distance: their exponents differ by 2, a factor of 4
    expected = value((80 << 15) + limit_mantissa) * 4 * length_mantissa / axis_mantissa
    for column in (layout.RAPID, layout.ACCEL):
        assert is_near(value(ring[column]), expected, 2**-12), "two quotients are truncated"
