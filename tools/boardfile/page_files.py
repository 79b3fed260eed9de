"""The page: its parts joined into one file, and its files on a board.

index.html names its parts, which are files in its folder, in comments. DATA and TEXTS are not
files: they have the data for making board files, from our tables, and the other languages. The
joined page has neither comments nor indentation, so it is smaller by an eighth.
firmware/ports/net/page.py defines the file names on a board.
"""

import gzip
import json
import re
from functools import cache
from pathlib import Path
from typing import Any

from .. import paths
from . import page_script, page_texts

_FOLDER = paths.TOOLS / "web" / "page"
_PART = re.compile(r"<!-- part: ([\w.]+) -->\n")
_SCRIPT = re.compile("(<script>\n)(.*?)(</script>)", re.DOTALL)
_STYLE = re.compile("(<style>)(.*?)(</style>)", re.DOTALL)
_STYLE_WASTE = re.compile(r"/\*.*?\*/|\s*([{};,\n])\s*", re.DOTALL)
_HTML_WASTE = re.compile(r"<!--(?! part).*?-->\n|^ +(?=<)", re.DOTALL | re.MULTILINE)
DATA = "board_data"
TEXTS = "texts"
# Parts that a page from a board cannot use: browsers open a USB port only for a file from disk, or
# for an address that is this computer's or has TLS, and only `ugrbl web` simulates programs.
_NOT_FROM_BOARD = (
    *(DATA, "prompt.js", "uf2_drive.js", "board_file.js", "board_wizard.js"),
    *("board_wizard.html", "board_send.js", "what_if.html", "what_if.js"),
)


@cache
def page(from_board: bool = False) -> str:
    """Return the page. OSError if a part is missing.

    from_board: as a board serves it, in English only, and without parts that it cannot use.
    """

    def with_parts(text: str) -> str:  # the parts may name parts
        return _PART.sub(replacement, text)

    def replacement(found: "re.Match[str]") -> str:
        name = found[1]
        if name == TEXTS:
            languages = {} if from_board else page_texts.tables(_FOLDER)
            return _as_data(name, page_texts.data(languages))
        return "" if from_board and name in _NOT_FROM_BOARD else with_parts(_wrapped(name))

    return with_parts(_wrapped("index.html"))


def _wrapped(name: str) -> str:
    """Return a part as it is in the page: a script in its tags, data as JSON, and without
    comments and indentation."""
    if name == DATA:
        from . import page_data

        return _as_data(name, page_data.data())
    text = (_FOLDER / name).read_text(encoding="utf-8")
    if name.endswith(".js"):
        return f'<script>\n"use strict";\n{page_script.lean(text)}</script>\n'
    text = _STYLE.sub(lambda found: found[1] + _STYLE_WASTE.sub(r"\1", found[2]) + found[3], text)
    text = _HTML_WASTE.sub("", text)
    return _SCRIPT.sub(lambda found: found[1] + page_script.lean(found[2]) + found[3], text)


def _as_data(name: str, content: dict[str, Any]) -> str:
    text = json.dumps(content, separators=(",", ":"), ensure_ascii=False)
    # Else "</script>" in a comment of a board file would end the element.
    text = text.replace("</", "<\\/")
    return f'<script type="application/json" id="{name}">{text}</script>\n'


def names() -> tuple[str, str]:
    """Return the file names on a board: of the first page, which fetches the other one, and of the
    compressed main page."""
    paths.use_firmware()
    from ports.net import page as served

    return served.FIRST, served.NAME


def made() -> dict[str, bytes]:
    """Return the page's files on a board, by path."""
    first, whole = names()
    return {
        first: (_FOLDER / "first.html").read_bytes(),
        whole: gzip.compress(page(from_board=True).encode(), mtime=0),
    }


def save(folder: Path) -> None:
    """Write the page's files to a folder."""
    for name, content in made().items():
        (folder / name).write_bytes(content)
