"""Test the page in other languages: complete tables, and no English left where a person reads.

TABLES[code] has for each English text of the page its translation into a language. SHOWN are the
English texts that the page can show. A `Reader` is a person at the page in another language:
collect_english() adds each English word that is visible to its set `english_left`.
"""

import json
import re
from collections.abc import Callable
from typing import Any

import pytest
import shown_texts
from bridge import PAGE
from browser import Person
from ugrbl.boardfile import page_files, page_script, page_texts

pytestmark = pytest.mark.xdist_group("page")

TABLES = page_texts.tables(shown_texts.PAGE)
SHOWN = shown_texts.shown()
# Sentences in scripts that are not shown by the page: parts of files, G-code, and values of data.
_NOT_SHOWN = {
    *("use strict", "True or False", "whole number", "0 or more", "#offsets input"),
    *("(prefers-color-scheme: dark)", "[MSG:Another has control]", "My machine"),
    *("(moves follow a height map)", "# See esp32_devkit.py."),
}
_IN_BOARD_FILE = re.compile("[A-Z_]+ = ")
# What a translation must keep: values, settings, words of answers and files, names of options.
_KEPT = re.compile(
    r"\{\w+\}|\$\d+|\n|error:\d+|ALARM:\d?|docs/\S+\.md|\b[A-Z][A-Z_]{3,}\b|G\d+(?:\.\d)?"
)
# Words of the field, names, and answers of the machine, which stay as they are.
_TERMS = set("alarm check edge error hold home jog run usb wifi page uart".split())
# Where a person reads lines of the machine or of a file, not texts of the page.
_OTHER = (
    "#log, #lines, #board-text, #probe-lines, .mono, #state-name, #language, script, style,"
    " #board-cards button:not(.main)"  # the first lines of board files
)


@pytest.mark.parametrize("code", TABLES)
def test_every_text_has_a_translation_and_none_is_unused(code: str) -> None:
    table = TABLES[code]
    assert not SHOWN - set(table), "texts without a translation"
    assert not set(table) - SHOWN - {page_texts.NAME}, "translations of texts that are not shown"
    assert all(text.strip() for text in table.values())


@pytest.mark.parametrize("code", TABLES)
def test_translations_keep_values_numbers_names_and_spaces(code: str) -> None:
    """What is no language stays.

    Placeholders, settings, error numbers and option names occur in a translation as often as in
    the text.
    """
    for text, translation in TABLES[code].items():
        if text == page_texts.NAME:  # the entry with the language's own name
            continue
        # Values, numbers, and names of options, each as often as in the English text.
        assert sorted(_KEPT.findall(text)) == sorted(_KEPT.findall(translation)), (
            text,
            translation,
        )
        # The same blanks at start and end.
        assert re.findall(r"^\s*|\s*$", text) == re.findall(r"^\s*|\s*$", translation), (
            text,
            translation,
        )


def test_every_sentence_in_scripts_is_tagged() -> None:
    """A text shown by a script is written as t`...`, which looks up its translation.

    Strings that no person reads, listed as exceptions here, need no tag.
    """
    untagged = [
        where
        for where in shown_texts.untagged()
        if (text := where.partition(": ")[2]) not in _NOT_SHOWN
        and not _IN_BOARD_FILE.match(text)
        and not re.match(r'\n|"""', text)  # of a Python file
    ]
    assert not untagged, "write t`…`"


def test_no_two_texts_have_one_number() -> None:
    texts = {*SHOWN, *shown_texts.same()}
    chosen = page_texts.multiplier(SHOWN)
    assert len({page_texts.number(text, chosen) for text in texts}) == len(texts)


def test_another_multiplier_is_chosen_if_two_texts_have_one_number() -> None:
    assert page_texts.number("Aa", 31) == page_texts.number("BB", 31)
    data = page_texts.data({"cs": {"": "Cs", "Aa": "1", "BB": "2"}})
    assert data == {"multiplier": 33, "steps": [2242, 2], "languages": {"cs": ["Cs", "1", "2"]}}


def test_script_is_lean_and_means_the_same() -> None:
    """lean() removes comments and blanks, but none within strings, patterns and templates.

    pieces() splits a script without losing a character.
    """
    script = """// a comment
const a = { b : "x // y" }; // another
  /** one
   * more */
  return /[/"`] : / .test(`${a ? `} : ${ b }` : "c"}  d`) && a / b / c;
text = `one
  two`;
"""
    assert page_script.lean(script) == (
        """const a={b:"x // y"};
return /[/"`] : / .test(`${a?`} : ${ b }`:"c"}  d`)&&a / b / c;
text=`one
  two`;
"""
    )
    assert "".join(text for _, text in page_script.pieces(script)) == script


def test_page_has_no_comments_and_its_python_is_unchanged() -> None:
    page = page_files.page()
    assert not re.search(r"^\s*(//|/\*\*)", page, re.MULTILINE)
    python = re.search("ABOUT_BOARD=(`.*?`)", page, re.DOTALL)
    assert python and python[1] in (shown_texts.PAGE / "prompt.js").read_text(encoding="utf-8")


def test_page_from_board_is_in_english() -> None:
    assert '"languages":{}' in page_files.page(from_board=True)


# In a browser


def test_browser_and_python_compute_same_numbers(opened: Any) -> None:
    """Texts are stored under a hash.

    Both sides compute it, so each must find the same number for every text.
    """
    page = opened.new_page()
    page.goto(PAGE.as_uri())
    texts = sorted(SHOWN)
    numbers_in_browser = page.evaluate("texts => texts.map(numberOf)", texts)
    # The multiplier of the hash, chosen so that no two texts have the same number.
    multiplier = page_texts.multiplier(SHOWN)
    assert numbers_in_browser == [page_texts.number(text, multiplier) for text in texts]
    page.close()


def test_selected_language_is_remembered(opened: Any) -> None:
    """A selected language survives a reload.

    The page starts in English even in a German browser.
    """
    with opened.new_context(locale="de-DE") as context:
        page = context.new_page()
        page.goto(PAGE.as_uri())
        assert page.evaluate("document.documentElement.lang") == "en"
        page.click("#tabs [data-tab=settings]")
        assert page.locator("#language option").all_text_contents() == [
            "English",
            *(TABLES[code][page_texts.NAME] for code in TABLES),
        ]
        page.select_option("#language", "es")
        page.wait_for_selector("html[lang=es]")
        page.reload()
        page.click("#tabs [data-tab=settings]")
        assert page.text_content("#state-name") == TABLES["es"]["Not connected"]
        page.select_option("#language", "en")
        page.wait_for_selector("html[lang=en]")
        assert page.text_content("#state-name") == "Not connected"


_READ = """where => {
  const found = [], walker = document.createTreeWalker(document.body, 1 | 4); // elements, texts
  while (walker.nextNode()) {
    const node = walker.currentNode, element = node.nodeType === 3 ? node.parentElement : node;
    if (!element.checkVisibility() || element.closest(where)) continue;
    if (node.nodeType === 3) found.push(node.data);
    else for (const name of NAMES) found.push(node.getAttribute(name) || "");
  }
  return found;
}""".replace("NAMES", json.dumps(shown_texts.ATTRIBUTES))


class Reader(Person):
    """A person who collects the English words that the page shows."""

    english: "set[str]"
    english_left: "set[str]"

    def collect_english(self) -> None:
        for text in self.page.evaluate(_READ, _OTHER):
            if wrong := self.english & words(text):
                self.english_left.add(f"{sorted(wrong)} in {text!r}")


def words(text: str) -> "set[str]":
    """Return the words of a text, without names of files and options, in small letters."""
    text = re.sub(r"docs/\S+|\w+\.py|\w*_\w*|\b[A-Z]{2,}\b", "", text)
    return set(re.findall(r"[^\W\d_]{2,}", text.lower()))


def sets_up(reader: Reader) -> None:
    """Read each part of the setup, with each chip and board."""
    page = reader.page
    reader.click("#tabs [data-tab=setup]")
    page.evaluate(
        "() => { for (const one of document.querySelectorAll('details')) one.open = true; }"
    )
    reader.collect_english()
    for chip in page.evaluate("() => Object.keys(BOARDS.chips)"):
        reader.click("#setup-steps [data-step=board]")
        page.select_option("#board-chip", chip)
        reader.collect_english()
        reader.click("#board-cards button.main")
        reader.collect_english()
    # As if pin 0 were selected for the first step output.
    page.evaluate("() => givePin(0, 'STEP 0')")
    page.fill("#own-name", "vacuum")
    reader.click("#own-pins button[value=outputs]")
    reader.collect_english()
    for name in page.evaluate("() => Object.keys(BOARDS.boards)"):
        page.evaluate("name => chooseBoard(name)", name)
        reader.collect_english()
    page.evaluate("() => chooseBoard('rpi_pico')")
    reader.click("#setup-steps [data-step=options]")
    page.evaluate(
        "() => { for (const one of document.querySelectorAll('details')) one.open = true; }"
    )
    reader.collect_english()
    for name in ("board.py", "custom.py"):
        reader.click("#setup-steps [data-step=file]")
        page.select_option("#file-name", name)
        reader.collect_english()
    reader.click("#setup-steps [data-step=guide]")
    for index in range(page.locator("#guide-tasks button").count()):
        page.locator("#guide-tasks button").nth(index).click()
        reader.collect_english()


def jobs(reader: Reader) -> None:
    """Read what the page shows of jobs.

    These are the questions, the end, a refused line, a tool change, and the stored files.
    """
    reader.loads("G21 G90\nG0 X1\nG1 X2 F300\nM3 S100\nG1 Y2\n")
    reader.collect_english()
    reader.page.fill("#from", "5")
    # Both ask before they start: line 5 is not the first line.
    for button in ("#run", "#outline"):
        reader.click(button)
        reader.waits("document.getElementById('dialog').open")
        reader.collect_english()
        reader.click("#dialog-no")
    reader.page.fill("#from", "1")
    reader.click("#check")
    reader.waits("job?.state === 'done'")
    reader.collect_english()
    reader.sees("Idle")
    reader.loads("G21 G90\nG1 X2 F300\nG1 X3 Q7\n", "refused.nc")
    reader.click("#run")
    reader.waits("job?.state === 'refused' && job.rests")
    reader.collect_english()
    reader.click("#end")
    reader.waits("job.state === 'stopped'")
    reader.collect_english()
    reader.sees("Idle")
    reader.loads("G21 G90\nT1 M6\nG1 X2 F300\n", "tools.nc")
    reader.click("#run")
    reader.waits("!document.getElementById('tool-change').hidden")
    reader.collect_english()
    reader.click("#tool-end")
    reader.waits("job.state === 'stopped'")
    reader.sees("Idle")
    reader.click("#board-files")
    reader.reads("#files-words", ".")
    reader.collect_english()


@pytest.mark.thorough
@pytest.mark.parametrize("code", TABLES)
def test_no_english_is_left(person_at: Callable[..., Person], code: str) -> None:
    """Each part of the page is opened in a language.

    No word may be visible that only the English texts have.
    """
    person = person_at(on={"locale": code})
    reader = Reader(person.page, person.machine, person.bridge, person.folder)
    # Texts that are the same in both languages are left out.
    table = {text: said for text, said in TABLES[code].items() if text != said}
    # Words of the English texts that no translation uses.
    reader.english = set().union(*map(words, table)) - set().union(*map(words, table.values()))
    reader.english -= _TERMS
    reader.english_left = set()
    reader.open_from_disk()
    assert reader.page.evaluate("document.documentElement.lang") == code
    reader.collect_english()
    reader.connect()
    for tab in ("job", "console", "settings", "offsets"):
        reader.click(f"#tabs [data-tab={tab}]")
        reader.collect_english()
    for index in range(reader.page.locator("#probe-kinds button").count()):
        reader.page.locator("#probe-kinds button").nth(index).click()
        reader.collect_english()
    reader.click("#macros-edit")
    reader.click("#macro-add")
    reader.collect_english()
    sets_up(reader)
    jobs(reader)
    reader.types("$J=G91X1")  # refused: no feed
    reader.click("#tabs [data-tab=job]")
    reader.collect_english()
    for number in reader.page.evaluate("() => Object.keys(WORDS.alarms)"):
        # Each alarm, as if the machine had sent it.
        reader.page.evaluate("number => grbl.tell('alarm', Number(number))", number)
        reader.collect_english()
    assert not reader.english_left
