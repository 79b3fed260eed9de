"""Test single precision on the desktop: it rounds as a board rounds."""

import struct

from base.float32 import INCH_PER_MM, f32, vector
from hypothesis import given
from hypothesis import strategies as st
from talk.digits import number


def to_single(x: float) -> float:
    """Return x rounded to single precision."""
    return struct.unpack("f", struct.pack("f", x))[0]


def printed(x: float, decimals: int) -> str:
    """Follow Grbl's printFloat step by step in single precision, up to 2**31."""
    minus = x < 0
    x = -x if minus else x
    for _ in range(decimals // 2):
        x = to_single(x * 100)
    if decimals % 2:
        x = to_single(x * 10)
    digits = str(min(int(to_single(x + 0.5)), 2**31)).rjust(decimals + 1, "0")
    if decimals:
        digits = digits[:-decimals] + "." + digits[-decimals:]
    return "-" * minus + digits


# A number below 2**-125 is printed without a sign.
single_floats = st.floats(-1e9, 1e9, width=32).map(lambda x: x if abs(x) > 1e-37 else 0.0)


@given(st.floats(min_value=-1e30, max_value=1e30))
def test_numbers_are_rounded_to_single_precision(x: float) -> None:
    assert f32(x) == to_single(x)
    assert f32(f32(x)) == f32(x)


def test_constants_are_single_precision() -> None:
    assert to_single(f32(25.4)) == f32(25.4)
    assert to_single(INCH_PER_MM) == INCH_PER_MM


def test_vector_holds_single_precision() -> None:
    values = vector(3)
    values[1] = 0.1
    assert list(values) == [0.0, to_single(0.1), 0.0]


@given(single_floats, st.integers(0, 4))
def test_numbers_are_printed_as_by_grbl(x: float, decimals: int) -> None:
    assert number(x, decimals) == printed(x, decimals)


@given(st.integers(-(10**6), 10**6))
def test_number_with_three_decimals_is_printed_unchanged(thousandths: int) -> None:
    text = number(to_single(thousandths / 1000), 3)
    assert abs(float(text) - thousandths / 1000) < 0.0006
