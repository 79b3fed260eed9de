"""The page as a board serves it: see firmware/ports/net/page.py, which says what is called how."""

import gzip
from pathlib import Path

from .. import paths

_FOLDER = paths.TOOLS / "web" / "page"


def names() -> tuple[str, str]:
    """What a board calls the first page, which fetches the other; and that, compressed."""
    paths.use_firmware()
    from ports.net import page

    return page.FIRST, page.NAME


def made() -> dict[str, bytes]:
    """What lies on a board of it, by path."""
    first, whole = names()
    return {
        first: (_FOLDER / "first.html").read_bytes(),
        whole: gzip.compress((_FOLDER / "index.html").read_bytes(), mtime=0),
    }


def save(folder: Path) -> None:
    """Write it there."""
    for name, content in made().items():
        (folder / name).write_bytes(content)
