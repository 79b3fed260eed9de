"""The page as a file: small, by itself, with the firmware's own words. It needs no browser."""

import gzip
import json
import re

from bridge import PAGE
from ugrbl import paths
from ugrbl.compiling import page_files
from ugrbl.docs import browser
from ugrbl.grbl.comments import setting_comments

TEXT = PAGE.read_text(encoding="utf-8")
WORDS = json.loads(re.search(r'id="words">(.*?)</script>', TEXT, re.DOTALL)[1])
EXTRAS = paths.FIRMWARE / "extras"


def test_it_is_small_and_smaller_where_a_board_serves_it():
    assert len(gzip.compress(PAGE.read_bytes())) < 110_000
    assert len(page_files.made()["page.gz"]) < 60_000


def test_a_board_serves_nothing_that_needs_its_usb_port():
    text = page_files.page(from_board=True)
    assert 'data-step-panel="guide"' in text and "class Prompt" not in text
    assert not re.findall(r"<!-- part|board_data|data-step-panel=\"pins", text)


def test_nothing_comes_from_elsewhere():
    assert not re.findall(r"""(?:https?:)?//[\w-]+\.[\w.]+|\bsrc=|@import|url\(""", TEXT)


def test_text_goes_in_as_text():
    assert not re.findall(r"innerHTML|outerHTML|insertAdjacent|document\.write|eval\(", TEXT)


def test_its_words_are_the_firmwares_own():
    source = browser.PAGE.read_text(encoding="utf-8")
    assert browser.update(source) == source, "make docs"
    assert {"errors", "alarms", "settings", "punch", "laser"} == set(WORDS)


def test_every_setting_of_the_firmware_has_its_words():
    """Those of extras, too: what a module declares as its table is not left out."""
    extras = (path.relative_to(paths.FIRMWARE).with_suffix("") for path in EXTRAS.rglob("*.py"))
    for module in ("base/settings", *(path.as_posix() for path in extras)):
        if module == "extras/dialects/dialect_09":
            continue  # words of Grbl 0.9, which the page does not speak with
        for number in setting_comments(module):
            tool = WORDS.get(module.removeprefix("extras/tools/"), WORDS["settings"])
            name, _, unit, limits, *_ = tool[str(number)]
            assert name and unit and limits, f"{module} ${number}"
