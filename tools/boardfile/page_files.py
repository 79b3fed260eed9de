"""The page: its parts joined into one file, and its files on a board.

index.html names its parts, which are files in its folder, in comments. DATA is not a file: it has
the data for making board files, from our tables. firmware/ports/net/page.py defines the file
names on a board.
"""

import gzip
import json
import re
from functools import cache
from pathlib import Path

from .. import paths

_FOLDER = paths.TOOLS / "web" / "page"
_PART = re.compile(r"<!-- part: ([\w.]+) -->\n")
DATA = "board_data"
# Parts that a page from a board cannot use, because browsers open a USB port only for a file from
# disk, or for an address that is this computer's or has TLS.
_USB_ONLY = (
    *(DATA, "prompt.js", "uf2_drive.js", "board_file.js", "board_wizard.js"),
    *("board_wizard.html", "board_send.js"),
)


@cache
def page(from_board: bool = False) -> str:
    """Return the page; from_board: without parts for Web Serial. OSError if a part is missing."""

    def joined(text: str) -> str:
        return _PART.sub(part, text)

    def part(found: "re.Match[str]") -> str:
        name = found[1]
        return "" if from_board and name in _USB_ONLY else joined(_wrapped(name))

    return joined(_wrapped("index.html"))


def _wrapped(name: str) -> str:
    """Return a part as it is in the page."""
    if name == DATA:
        from . import page_data

        text = json.dumps(page_data.data(), separators=(",", ":"), ensure_ascii=False)
        # Else "</script>" in a comment of a board file would end the element.
        text = text.replace("</", "<\\/")
        return f'<script type="application/json" id="{DATA}">{text}</script>\n'
    text = (_FOLDER / name).read_text(encoding="utf-8")
    return f'<script>\n"use strict";\n\n{text}</script>\n' if name.endswith(".js") else text


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
