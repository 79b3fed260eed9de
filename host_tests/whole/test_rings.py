"""Each ring has its tests: the right number of cases of each sampled test, in order."""

from types import SimpleNamespace
from typing import Any

import pytest
import rings

FIRST, SECOND, WHOLE = ({"all": n > 0, "whole": n > 1, "seed": 7} for n in range(3))


def marked(name: str, *marks: "tuple[Any, ...]") -> Any:
    """Return a test with these marks, the closest first."""
    found = [SimpleNamespace(name=mark, args=args) for mark, *args in marks]
    return SimpleNamespace(nodeid=name, iter_markers=lambda: iter(found))


_SAMPLED = [marked(f"sampled[{n}]", ("sampled", 2, 5), ("thorough",)) for n in range(9)]
_FIRST_ONLY = [marked(f"all_later[{n}]", ("sampled", 1)) for n in range(4)]
_LATER = [marked(f"later[{n}]", ("sampled", 0, 1)) for n in range(3)]
_TESTS = [marked("plain"), marked("thorough", ("thorough",)), *_SAMPLED, *_FIRST_ONLY, *_LATER]


@pytest.mark.parametrize(
    ("ring", "counts"),
    [
        (FIRST, {"plain": 1, "sampled": 2, "all_later": 1}),
        (SECOND, {"plain": 1, "thorough": 1, "sampled": 5, "all_later": 4, "later": 1}),
        (WHOLE, {"plain": 1, "thorough": 1, "sampled": 9, "all_later": 4, "later": 3}),
    ],
)
def test_a_ring_has_the_right_number_of_cases_of_each_test(
    ring: "dict[str, int]", counts: "dict[str, int]", monkeypatch: pytest.MonkeyPatch
) -> None:
    """_ring holds the chosen ring; counts: cases by test. sampled has 9, all_later 4, later 3.

    Marks of _TESTS: sampled(2, 5) is 2 cases in the first ring and 5 in the second; sampled(1): 1
    and all; thorough: none in the first.
    """
    monkeypatch.setattr(rings, "_ring", ring)
    names = [item.nodeid.partition("[")[0] for item in rings._of_ring(_TESTS)]
    assert {name: names.count(name) for name in names} == counts


def test_a_sample_is_in_order_and_the_same_for_the_same_seed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """rings.sample() takes 10 of 100 items in the first ring, with the ring's seed."""
    monkeypatch.setattr(rings, "_ring", FIRST)
    few = rings.sample(range(100), 10)
    assert few == sorted(few) == rings.sample(range(100), 10)
    monkeypatch.setattr(rings, "_ring", {**FIRST, "seed": 8})
    assert few != rings.sample(range(100), 10)
