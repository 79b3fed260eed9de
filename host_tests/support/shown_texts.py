"""Find the texts that the page can show: in its HTML, in its scripts, and in its data.

In scripts a text is a template tagged with t, or comes from data by translated(). `untagged`
returns the literals that look like a sentence and are not tagged.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from html.parser import HTMLParser

from ugrbl import paths
from ugrbl.boardfile import page_data, page_script
from ugrbl.docs import browser

PAGE = paths.TOOLS / "web" / "page"
ATTRIBUTES = ("title", "placeholder", "aria-label")  # as in texts.js
# Names and units that are the same in all languages, and placeholders.
_SAME = re.compile(
    r"Raspberry Pi Pico( 2)?( W)?|ESP32(-S3)?|STOP|Hz|mm/(min|m)|(board|custom)\.py|\{depth=5\}"
)
_LETTERS = re.compile("[A-Za-z]{2}")  # else it is the same in all languages, as in texts.js
_SCRIPT = re.compile("<script>\n(.*?)</script>", re.DOTALL)
_ESCAPE = re.compile(r"\\(.)", re.DOTALL)
# Two words, of which one begins with a small letter.
_SENTENCE = re.compile(r"[A-Za-z']{2,}[,.:;]? [a-z]{2,}|[a-z']{2,}[,.:;]? [A-Za-z]{2,}")
# Where a literal is no text: a style, a class, a selector, a message for the console.
_NO_TEXT = re.compile(r"(className|style|class|font): $|font = $|(querySelector(All)?|info)\($")


@dataclass
class Literal:
    """A string or template. parts: its texts, around its values; before: the code before it."""

    parts: list[str]
    before: str

    @property
    def text(self) -> str:
        """The text with {0}, {1} … for values, as in the tables."""
        first, *rest = (_ESCAPE.sub(_unescaped, part) for part in self.parts)
        return first + "".join(f"{{{index}}}{part}" for index, part in enumerate(rest))

    @property
    def is_tagged(self) -> bool:
        return re.search(r"(?<![\w$])t$", self.before) is not None


def shown() -> set[str]:
    """Return all texts that the tables must have."""
    literals = [one for source in _scripts().values() for one in _literals(source)]
    tagged = (literal.text for literal in literals if literal.is_tagged)
    found = {*_of_html(), *_of_words(), *_of_boards(), *tagged}
    return {text for text in found if not _SAME.fullmatch(text)}


def same() -> set[str]:
    """Return the texts that the page looks up, and that are the same in all languages."""
    return {text for text in (*_of_html(), *_of_words(), *_of_boards()) if _SAME.fullmatch(text)}


def untagged() -> list[str]:
    """Return the sentences in scripts that are not tagged, with their file."""
    return [
        f"{name}: {one.text}"
        for name, source in _scripts().items()
        for one in _literals(source)
        if not one.is_tagged and _SENTENCE.search(one.text) and not _NO_TEXT.search(one.before)
    ]


# HTML


class _Texts(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: set[str] = set()
        self._skips = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, "str | None"]]) -> None:
        self._skips = tag in ("script", "style", "title")
        found = (value or "" for name, value in attrs if name in ATTRIBUTES)
        self.found.update(filter(_LETTERS.search, found))

    def handle_endtag(self, tag: str) -> None:
        self._skips = False

    def handle_data(self, data: str) -> None:
        text = " ".join(data.split())
        if not self._skips and _LETTERS.search(text):
            self.found.add(text)


def _of_html() -> set[str]:
    parser = _Texts()
    for file in PAGE.glob("*.html"):
        if file.name != "first.html":  # it only fetches the page
            parser.feed(file.read_text(encoding="utf-8"))
    return parser.found


# Data


def _of_words() -> Iterator[str]:
    words = browser.words()
    yield from words["errors"].values()
    yield from words["alarms"].values()
    for kind in ("settings", "laser", "punch"):
        for name, text, unit, limits, *_ in words[kind].values():
            boxes = unit in ("boolean", "mask")  # its unit and limits are not shown
            yield from filter(None, (name, text) if boxes else (name, text, unit, limits))
    yield "0 or 1"  # in the answer to another value


def _of_boards() -> Iterator[str]:
    data = page_data.data()
    for chip in data["chips"].values():
        yield from (chip["title"], *chip["odd"].values())
    for title, options in data["forms"].items():
        yield from (title, *(option["meaning"] for option in options))
    yield data["noPage"]


# Scripts


def _scripts() -> dict[str, str]:
    index = (PAGE / "index.html").read_text(encoding="utf-8")
    files = {file.name: file.read_text(encoding="utf-8") for file in sorted(PAGE.glob("*.js"))}
    return {"index.html": "\n".join(_SCRIPT.findall(index)), **files}


def _literals(source: str) -> list[Literal]:
    """Return all strings and templates, also those in the values of templates."""
    found: list[Literal] = []
    open_templates: list[Literal] = []
    before = ""
    for kind, text in page_script.pieces(source):
        if kind == page_script.LITERAL and text[0] in "\"'":
            found.append(Literal([text[1:-1]], before))
        elif kind == page_script.LITERAL and text[0] != "/":
            if text[0] == "`":
                open_templates.append(Literal([], before))
            goes_on = text.endswith("${")
            open_templates[-1].parts.append(text[1 : -2 if goes_on else -1])
            if not goes_on:
                found.append(open_templates.pop())
        before = text
    return found


def _unescaped(found: "re.Match[str]") -> str:
    return {"n": "\n", "t": "\t"}.get(found[1], found[1])
