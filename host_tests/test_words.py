"""words.scan against a plain twin of how Grbl reads numbers: the oracle's."""

import struct
from array import array
from math import isfinite

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from oracle import read_number, read_words, single
from words import AXES, HAS_G0, HAS_G1, LASER, MODE, Words, add_single, plain, scan


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
def test_a_number_is_rounded_digit_by_digit_as_by_grbl(text: str) -> None:
    expected = read_number(text)
    end, value = Words().number(bytearray(text.encode() + b"\0"), 0)
    if expected is None:
        assert end == -1
    else:
        assert (end, bits(value)) == (expected[0], bits(expected[1]))


@given(st.lists(pieces, max_size=12).map(lambda parts: "".join(parts)[:127]))
def test_a_line_is_read_word_by_word_up_to_the_first_fault(text: str) -> None:
    line = Words()
    line.read(bytearray(text.encode() + b"\0"), 0, len(text))
    found = [(chr(line.letters[i]), bits(line.values[i])) for i in range(line.count)]
    expected, fault = read_words(text)
    assert found == [(letter, bits(value)) for letter, value in expected]
    assert line.fault == fault


@settings(max_examples=200)
@given(st.binary(max_size=126))
def test_any_bytes_are_read_without_raising(data: bytes) -> None:
    line = Words()
    line.read(bytearray(data + b"\0"), 0, len(data))
    assert line.count <= len(data)


@pytest.mark.parametrize("start", [0, 2])
def test_reading_begins_where_it_is_told(start: int) -> None:
    line = Words()
    text = b"$$X1Y2"[2 - start :]
    line.read(bytearray(text + b"\0"), start, len(text))
    assert bytes(line.letters[: line.count]) == b"XY"
    assert list(line.values[:2]) == [1, 2]


def test_nothing_is_read_behind_the_end() -> None:
    values = array("f", [0.0] * 4)
    assert scan(bytearray(b"X1Y2\0"), 2 << 8, bytearray(b"\1\0\0\0"), values) == 1


# Plain lines

normal = st.floats(width=32, min_value=-(2.0**100), max_value=2.0**100, allow_subnormal=False)
places = st.one_of(normal, st.sampled_from([0.0, 1.0, -1.0, 0.1, -16777216.0, 2.0**-100]))


@settings(max_examples=500)
@given(places, places)
@example(1.0, -1.0)
@example(1.0, 2.0**-24)
@example(1.0000001, 2.0**-24)
@example(1.0, -(2.0**-25))
@example(16777216.0, -0.50000006)
def test_an_offset_is_added_as_in_single_precision(value: float, offset: float) -> None:
    a, b = array("f", [offset]), array("f", [value])
    expected = single(b[0] + a[0])
    assume(expected == 0 or 2.0**-126 <= abs(expected))
    add_single(a, 0, b, 0)
    assert (b[0] == 0) if expected == 0 else bits(b[0]) == bits(expected)


def test_a_sum_beyond_single_precision_is_not_finite() -> None:
    a, b = array("f", [3e38]), array("f", [3e38])
    add_single(a, 0, b, 0)
    assert not isfinite(b[0])


modes = st.tuples(st.sampled_from([HAS_G0, HAS_G1]), st.booleans(), st.sampled_from([0.0, 500.0]))


@given(st.lists(pieces, max_size=6).map("".join), modes)
@example("N10000000X1", (HAS_G0, False, 0.0))
@example("N9999999X1", (HAS_G0, False, 0.0))
@example("G1X1F-1", (HAS_G1, False, 500.0))
@example("G1X1F500", (HAS_G1, False, 500.0))
@example("X1F0", (HAS_G1, False, 500.0))
@example("G1X1S5", (HAS_G0, True, 500.0))
@example("G1X1S5", (HAS_G1, False, 500.0))
@example("G00X-0F-0", (HAS_G0, False, 0.0))
def test_a_plain_line_holds_nothing_that_could_be_wrong(
    text: str, modes: "tuple[int, bool, float]"
) -> None:
    mode, laser, feed = modes
    found, fault = read_words(text)
    letters = [letter for letter, _ in found]
    line = Words()
    line.read(bytearray(text.encode() + b"\0"), 0, len(text))
    line.at[AXES], line.at[MODE], line.at[LASER] = 4, mode, laser
    code = scan(bytearray(text.encode() + b"\0"), len(text) << 8, line.letters, line.values)
    seen = plain(line.letters, line.values, code, line.at, array("f", [feed]))
    if not seen:
        return
    assert not fault
    assert set(letters) & set("XYZA")
    assert len(set(letters)) == len(letters)
    assert set(letters) <= set("GXYZAFNS")
    for at, (letter, value) in enumerate(found):
        bit = {"F": 4, "S": 5, "N": 8, "A": 3, "G": 6 + int(value)}.get(letter)
        assert letter != "G" or value in (0, 1)
        assert letter not in "FNS" or value >= 0
        assert letter != "N" or value < 10_000_000
        bit = ord(letter) - ord("X") if bit is None else bit
        is_new = {"F": value != feed, "G": bit and 1 << bit != mode}.get(letter, True)
        assert seen >> bit & 1 == is_new
        assert line.at[bit] == at
    words = dict(found)
    cuts = words.get("G", mode == HAS_G1) == 1
    assert words.get("F", feed) or not cuts
    assert "S" not in words or (laser and cuts)
