"""Test that the integer routines give exactly the bits of single-precision arithmetic."""

import math
import struct
from array import array

from base import float32_math
from base.float32 import f32
from hypothesis import example, given
from hypothesis import strategies as st

# A board has no subnormal numbers, and everything above 3.4e38 counts as infinite.
_SMALLEST = 2.0**-126
_BEYOND = 2.0**128

numbers = st.floats(-(2.0**60), 2.0**60, width=32).map(lambda x: x if abs(x) >= 1e-18 else 0.0)
any_numbers = st.floats(allow_nan=False, allow_infinity=False, width=32).map(
    lambda x: x if abs(x) >= _SMALLEST else 0.0
)


def bits(x: float) -> int:
    """Return the bits of a float; 0 has no sign."""
    return struct.unpack("<I", struct.pack("<f", x))[0] if x else 0


def to_single(x: float) -> float:
    """Round a double to single precision; return 0 where it is too small for a board."""
    if abs(x) >= _BEYOND:
        return math.copysign(math.inf, x)
    rounded = f32(x)
    return rounded if abs(rounded) >= _SMALLEST else 0.0


@given(any_numbers, any_numbers)
@example(0.0, -2.5)
@example(3.4e38, 1.1)
def test_product_matches_single_precision(a: float, b: float) -> None:
    """multiply(a, i, b, j) changes a[i], also if it multiplies by itself."""
    values = array("f", (a, b))
    float32_math.multiply(values, 0, values, 1)
    assert bits(values[0]) == bits(to_single(a * b))
    values[0] = b
    float32_math.multiply(values, 0, values, 0)
    assert bits(values[0]) == bits(to_single(b * b))


@given(any_numbers, any_numbers.filter(bool))
def test_quotient_matches_single_precision(a: float, b: float) -> None:
    values = array("f", (a, b))
    float32_math.quotient(values, 0, values, 1)
    assert bits(values[0]) == bits(to_single(a / b))


@given(any_numbers, any_numbers)
@example(3.4e38, 3.4e38)
@example(1.5e-38, -1.6e-38)
@example(7.0, -7.0)
def test_sum_matches_single_precision(a: float, b: float) -> None:
    values = array("f", (a, b))
    float32_math.add_single(values, 0, values, 1)
    assert bits(values[1]) == bits(to_single(a + b))


@given(any_numbers)
@example(0.0)
def test_root_matches_single_precision(a: float) -> None:
    values = array("f", (abs(a),))
    float32_math.root(values, 0)
    assert bits(values[0]) == bits(f32(math.sqrt(abs(a))))


@given(numbers, st.integers(-60, 60))
def test_whole_part_rounds_towards_0_and_has_30_bits(a: float, power: int) -> None:
    """whole_part() returns a * 2**power as an integer, or 0 if that is too large."""
    whole = int(a * 2.0**power)
    result = float32_math.whole_part(array("f", (a,)), 0, power)
    assert result == (whole if abs(whole) < 1 << 30 else 0)
