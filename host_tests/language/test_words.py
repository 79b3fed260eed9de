"""words.scan against the oracle's plain version of Grbl's number reader."""

import struct
from array import array
from math import isfinite

import pytest
from base.float32 import f32
from base.float32_math import add_single, multiply
from hypothesis import assume, example, given
from hypothesis import strategies as st
from language.words import Words, bare, scan
from laws import some
from oracle import read_number, read_words, single


def bits(x: float) -> int:
    return struct.unpack("I", struct.pack("f", x))[0]


numbers = st.from_regex(r"[+-]?[0-9]{0,12}\.?[0-9]{0,12}", fullmatch=True)
pieces = st.one_of(
    st.tuples(st.sampled_from("GMXYZFSTNPIJKLR"), numbers).map("".join),
    st.sampled_from(["$", "X", "Y-", ".", "=", "\x7f", "1", "X..5", "Z1.2.3"]),
)


@given(numbers)
@example("16777217")
@example("99999999.99999999")
@example("33554433")
@example("0.00000000000000000001")
@example("00000000123456789")
@example("123456789012345678901234567890123456789012345678901234567890")
@example("." + 60 * "0" + "1")
@example("-.5")
@example("-0")
def test_a_number_is_rounded_digit_by_digit_like_grbl(text: str) -> None:
    """bare() returns (offset of the end, value), or an end of -1 if there is no number."""
    expected = read_number(text)
    end, value = bare(bytearray(text.encode() + b"\0"), 0)
    if expected is None:
        assert end == -1
    else:
        assert (end, bits(value)) == (expected[0], bits(expected[1]))


@given(st.lists(pieces, max_size=12).map(lambda parts: "".join(parts)[:127]))
def test_a_line_is_read_word_by_word_up_to_the_first_error(text: str) -> None:
    """Words.read() sets letters, values, count and fault, an error number or 0."""
    line = Words(127)
    line.read(bytearray(text.encode() + b"\0"), 0, len(text))
    words = [(chr(line.letters[i]), bits(line.values[i])) for i in range(line.count)]
    expected, fault = read_words(text)
    assert words == [(letter, bits(value)) for letter, value in expected]
    assert line.fault == fault


@some(200)
@given(st.binary(max_size=126))
def test_random_bytes_are_read_without_raising(data: bytes) -> None:
    line = Words(127)
    line.read(bytearray(data + b"\0"), 0, len(data))
    assert line.count <= len(data)


@pytest.mark.parametrize("start", [0, 2])
def test_reading_begins_at_the_given_offset(start: int) -> None:
    line = Words(127)
    text = b"$$X1Y2"[2 - start :]  # with `start` bytes before X
    line.read(bytearray(text + b"\0"), start, len(text))
    assert bytes(line.letters[: line.count]) == b"XY"
    assert list(line.values[:2]) == [1, 2]


def test_nothing_is_read_after_the_end() -> None:
    """The span of scan() is end << 8 | start: X1 is read, and Y2 is not."""
    values = array("f", [0.0] * 4)
    assert scan(bytearray(b"X1Y2\0"), 2 << 8, bytearray(b"\1\0\0\0"), values) == 1


normal = st.floats(width=32, min_value=-(2.0**100), max_value=2.0**100, allow_subnormal=False)
places = st.one_of(normal, st.sampled_from([0.0, 1.0, -1.0, 0.1, -16777216.0, 2.0**-100]))


@some(500)
@given(places, places)
@example(1.0, -1.0)
@example(1.0, 2.0**-24)
@example(1.0000001, 2.0**-24)
@example(1.0, -(2.0**-25))
@example(16777216.0, -0.50000006)
def test_an_offset_is_added_in_single_precision(value: float, offset: float) -> None:
    a, b = array("f", [offset]), array("f", [value])
    expected = single(b[0] + a[0])
    assume(expected == 0 or 2.0**-126 <= abs(expected))  # no subnormal result: a board has none
    add_single(a, 0, b, 0)
    assert (b[0] == 0) if expected == 0 else bits(b[0]) == bits(expected)


@given(places)
@example(1e37)
@example(1.0000001)
def test_inches_become_millimetres_in_single_precision(value: float) -> None:
    inches = array("f", [value])
    expected = single(inches[0] * f32(25.4))
    multiply(inches, 0, array("f", [25.4]), 0)
    assert bits(inches[0]) == bits(expected)


def test_a_sum_beyond_single_precision_is_not_finite() -> None:
    a, b = array("f", [3e38]), array("f", [3e38])
    add_single(a, 0, b, 0)
    assert not isfinite(b[0])
