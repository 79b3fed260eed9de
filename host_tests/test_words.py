"""words.scan against a plain twin of how Grbl reads a number, in single precision by struct."""

import struct
from array import array

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from words import LETTER_EXPECTED, NUMBER_EXPECTED, Words, scan


def single(x: float) -> float:
    """X rounded to single precision; what is too large is infinite."""
    try:
        return struct.unpack("f", struct.pack("f", x))[0]
    except OverflowError:
        return float("inf")


def read_number(text: str) -> "tuple[int, float] | None":
    """Grbl's reader: eight digits count, the rest move the point. Returns length and value."""
    pos = 0
    if text[:1] in ("-", "+"):
        pos = 1
    number = exponent = digits = 0
    point = False
    while pos < len(text):
        c = text[pos]
        if c in "0123456789":
            digits += 1
            if digits <= 8:
                number = number * 10 + int(c)
                exponent -= point
            elif not point:
                exponent += 1
        elif c == "." and not point:
            point = True
        else:
            break
        pos += 1
    if not digits:
        return None
    value = single(number)
    while value and exponent <= -2:
        value = single(value * single(0.01))
        exponent += 2
    if value and exponent < 0:
        value = single(value * single(0.1))
    while value and exponent > 0:
        value = single(value * 10.0)
        exponent -= 1
    return pos, -value if text[0] == "-" else value


def read_words(text: str) -> "tuple[list[tuple[str, float]], int]":
    """All words of a line, and what is wrong behind the last."""
    found = []
    while text:
        if not "A" <= text[0] <= "Z":
            return found, LETTER_EXPECTED
        number = read_number(text[1:])
        if number is None:
            return found, NUMBER_EXPECTED
        found.append((text[0], number[1]))
        text = text[1 + number[0] :]
    return found, 0


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
