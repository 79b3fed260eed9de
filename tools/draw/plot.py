"""Jobs drawn into a file, as its name asks for: a page or a picture."""

import sys
from collections.abc import Sequence
from pathlib import Path

from ..grbl.gcode_file import STDIN
from .job import Job


def save(jobs: Sequence[Job], title: str, words: str, file: Path) -> None:
    """Draw the jobs beside each other; the file's suffix says how. `-` is a page on stdout.

    OSError says in words why it cannot be written.
    """
    if str(file) == STDIN:
        sys.stdout.write(_page(jobs, title, words))
        return
    suffix = file.suffix.lower()
    try:
        if suffix == ".html":
            file.write_text(_page(jobs, title, words), encoding="utf-8")
        else:
            from .image import draw

            draw(jobs, title, words, suffix == ".svg").savefig(file, format=suffix[1:])
    except OSError as error:
        raise OSError(f"{file} cannot be written: {error.strerror}") from error


def _page(jobs: Sequence[Job], title: str, words: str) -> str:
    from .page import page

    return page(jobs, title, words)
