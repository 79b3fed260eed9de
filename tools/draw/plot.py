"""Draw jobs into a file, as a page or a picture, according to its name."""

import io
import sys
from collections.abc import Sequence
from pathlib import Path

from .. import paths
from ..grbl.gcode_file import STDIN
from .job import Job
from .script import PAGE

_HEAD = PAGE.index("<title>")


def save(jobs: Sequence[Job], title: str, words: str, file: Path) -> None:
    """Draw the jobs side by side; the file's suffix selects the format. `-` is a page on stdout.

    words: a line below the title, or "". OSError says in words why it cannot be written.
    """
    if str(file) == STDIN:
        sys.stdout.write(_page(jobs, title, words))
        return
    suffix = file.suffix.lower()
    if suffix == ".html":
        paths.write(file, _page(jobs, title, words).encode())
        return
    from .image import draw

    picture = io.BytesIO()
    draw(jobs, title, words, suffix == ".svg").savefig(picture, format=suffix[1:])
    paths.write(file, picture.getvalue())


def has_drawn(file: Path) -> bool:
    """Return whether an existing file is a page of ours."""
    with file.open("rb") as page:
        return page.read(_HEAD) == PAGE[:_HEAD].encode()


def _page(jobs: Sequence[Job], title: str, words: str) -> str:
    from .page import page

    return page(jobs, title, words)
