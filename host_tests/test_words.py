"""words.scan against a plain twin of how Grbl reads numbers: the oracle's."""

import struct
from array import array

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from oracle import read_number, read_words
from words import Words, scan


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
    words = Words()
    words.read(bytearray(text.encode() + b"\0"), 0, len(text))
    found = [(chr(words.letters[i]), bits(words.values[i])) for i in range(words.count)]
    expected, fault = read_words(text)
    assert found == [(letter, bits(value)) for letter, value in expected]
    assert words.fault == fault


@settings(max_examples=200)
@given(st.binary(max_size=126))
def test_any_bytes_are_read_without_raising(data: bytes) -> None:
    words = Words()
    words.read(bytearray(data + b"\0"), 0, len(data))
    assert words.count <= len(data)


@pytest.mark.parametrize("start", [0, 2])
def test_reading_begins_where_it_is_told(start: int) -> None:
    words = Words()
    text = b"$$X1Y2"[2 - start :]
    words.read(bytearray(text + b"\0"), start, len(text))
    assert bytes(words.letters[: words.count]) == b"XY"
    assert list(words.values[:2]) == [1, 2]


def test_nothing_is_read_behind_the_end() -> None:
    values = array("f", [0.0] * 4)
    assert scan(bytearray(b"X1Y2\0"), 2 << 8, bytearray(b"\1\0\0\0"), values) == 1
