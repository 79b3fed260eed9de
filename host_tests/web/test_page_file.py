"""The page as a file: small, by itself, with the firmware's own words. It needs no browser."""

import gzip
import json
import re

import pytest
from bridge import PAGE
from ugrbl.grbl import messages, settings_file
from ugrbl.grbl.comments import setting_comments

TEXT = PAGE.read_text(encoding="utf-8")
WORDS = json.loads(re.search(r'id="words">(.*?)</script>', TEXT, re.DOTALL)[1])
PER_AXIS = (100, 110, 120, 130)


def test_it_is_small_enough_for_a_board_to_serve():
    assert len(gzip.compress(PAGE.read_bytes())) < 60_000


def test_nothing_comes_from_elsewhere():
    assert not re.findall(r"""(?:https?:)?//[\w-]+\.[\w.]+|\bsrc=|@import|url\(""", TEXT)


def test_text_goes_in_as_text():
    assert not re.findall(r"innerHTML|outerHTML|insertAdjacent|document\.write|eval\(", TEXT)


@pytest.mark.parametrize("kind", ["errors", "alarms"])
def test_meanings_are_the_firmwares_own(kind):
    assert WORDS[kind] == {str(n): text for n, text in getattr(messages, kind)().items()}


def test_settings_are_the_firmwares_own():
    expected = {str(n): list(settings_file.meaning(n)) for n in setting_comments()}
    for number in PER_AXIS:
        name, *rest = expected[str(number)]
        expected[str(number)] = [name.removesuffix(" X"), *rest]
    assert WORDS["settings"] == expected
