"""Test the page as a file: small, self-contained, with the firmware's words. Needs no browser.

TEXT is the file of the page; WORDS are the texts in it: for each module with settings, {number:
[name, ..., unit, limits, ...]}.
"""

import gzip
import json
import re

from bridge import PAGE
from ugrbl import paths
from ugrbl.boardfile import page_files
from ugrbl.docs import browser
from ugrbl.grbl.comments import setting_comments

TEXT = PAGE.read_text(encoding="utf-8")
WORDS = json.loads(re.search(r'id="words">(.*?)</script>', TEXT, re.DOTALL)[1])
EXTRAS = paths.FIRMWARE / "extras"


def test_page_is_small_and_smaller_on_board():
    assert len(gzip.compress(PAGE.read_bytes())) < 111_000
    assert len(page_files.made()["page.gz"]) < 60_000


def test_page_on_board_has_no_parts_for_usb():
    text = page_files.page(from_board=True)
    assert 'data-step-panel="guide"' in text and "class Prompt" not in text
    assert not re.findall(r"<!-- part|board_data|data-step-panel=\"pins|what-if", text)


def test_nothing_is_loaded_from_elsewhere():
    assert not re.findall(r"""(?:https?:)?//[\w-]+\.[\w.]+|\bsrc=|@import|url\(""", TEXT)


def test_text_is_inserted_as_text():
    assert not re.findall(r"innerHTML|outerHTML|insertAdjacent|document\.write|eval\(", TEXT)


def test_words_are_those_of_firmware():
    source = browser.PAGE.read_text(encoding="utf-8")
    assert browser.update(source) == source, "make docs"
    assert {"errors", "alarms", "settings", "punch", "laser"} == set(WORDS)


def test_every_setting_of_firmware_has_words():
    """Settings of extras are included, from the table that each module declares."""
    extras = (path.relative_to(paths.FIRMWARE).with_suffix("") for path in EXTRAS.rglob("*.py"))
    for module in ("base/settings", *(path.as_posix() for path in extras)):
        if module == "extras/dialects/dialect_09":
            continue  # words of Grbl 0.9, a dialect that the page does not use
        for number in setting_comments(module):
            # A tool has its own table; all other modules share that of "settings".
            module_words = WORDS.get(module.removeprefix("extras/tools/"), WORDS["settings"])
            name, _, unit, limits, *_ = module_words[str(number)]
            assert name and unit and limits, f"{module} ${number}"
