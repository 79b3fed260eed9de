"""What is done to pairs of values before the firmware is compiled."""

import pytest
from ugrbl.compiling.pairs import pairs


@pytest.mark.parametrize(
    ("text", "bare"),
    [
        ("a, b = (c, d)\n", "a, b = c, d\n"),
        ("a, b, c = (b, c, 'ä, (')  # (a, b)\n", "a, b, c = b, c, 'ä, ('  # (a, b)\n"),
        ("if x:\n    a.b, c[0] = (f(1, 2), (3, 4))\n", "if x:\n    a.b, c[0] = f(1, 2), (3, 4)\n"),
        ("a, b = (c), (d)\n", "a, b = c, d\n"),
        ("a, b = (1, 2); c, d = (3, 4)\n", "a, b = 1, 2; c, d = 3, 4\n"),
    ],
)
def test_what_is_taken_apart_at_once_is_no_tuple(text: str, bare: str) -> None:
    assert pairs(text) == bare


@pytest.mark.parametrize(
    "text",
    [
        "a = (c, d)\n",
        "a, b = c\n",
        "a, b = x = (c, d)\n",
        "a, *b = (c, d)\n",
        "a, b = (*c, d)\n",
        "a, b, c, d = (e, f, g, h)\n",
        "a, b = (\n    c,\n    d,\n)\n",
    ],
)
def test_other_tuples_stay(text: str) -> None:
    assert pairs(text) == text
