"""The page: its parts joined into one file, and that as a board serves it.

index.html names its parts, which are files beside it, in comments. DATA is no file: what board
files are made of, out of our tables. See firmware/ports/net/page.py for what a board serves.
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
# What a page from a board has no use for: browsers open a USB port only for a file from disk, or
# for an address that is this computer's or has TLS.
_USB_ONLY = (
    *(DATA, "prompt.js", "uf2_drive.js", "board_file.js", "board_wizard.js"),
    "board_wizard.html",
)


@cache
def page(from_board: bool = False) -> str:
    """The whole page; from_board: without what needs Web Serial. OSError where a part is gone."""

    def joined(text: str) -> str:
        return _PART.sub(part, text)

    def part(found: "re.Match[str]") -> str:
        name = found[1]
        return "" if from_board and name in _USB_ONLY else joined(_wrapped(name))

    return joined(_wrapped("index.html"))


def _wrapped(name: str) -> str:
    """A part as it stands in the page."""
    if name == DATA:
        from ..boardfile import page_data

        text = json.dumps(page_data.data(), separators=(",", ":"), ensure_ascii=False)
        # "</script>" in a comment of a board file would end it.
        text = text.replace("</", "<\\/")
        return f'<script type="application/json" id="{DATA}">{text}</script>\n'
    text = (_FOLDER / name).read_text(encoding="utf-8")
    return f'<script>\n"use strict";\n\n{text}</script>\n' if name.endswith(".js") else text


def names() -> tuple[str, str]:
    """What a board calls the first page, which fetches the other; and that, compressed."""
    paths.use_firmware()
    from ports.net import page as served

    return served.FIRST, served.NAME


def made() -> dict[str, bytes]:
    """What lies on a board of it, by path."""
    first, whole = names()
    return {
        first: (_FOLDER / "first.html").read_bytes(),
        whole: gzip.compress(page(from_board=True).encode(), mtime=0),
    }


def save(folder: Path) -> None:
    """Write it there."""
    for name, content in made().items():
        (folder / name).write_bytes(content)
