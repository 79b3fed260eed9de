"""Jobs drawn into a file, as its name asks for: a page or a picture."""

import sys
from collections.abc import Sequence
from pathlib import Path

from ..grbl.gcode_file import STDIN
from .job import Job


def save(jobs: Sequence[Job], title: str, words: str, file: Path) -> None:
    """Draw the jobs beside each other; the file's suffix says how. `-` is a page on stdout."""
    suffix = file.suffix.lower()
    if str(file) == STDIN:
        from .page import page

        sys.stdout.write(page(jobs, title, words))
    elif suffix == ".html":
        from .page import page

        file.write_text(page(jobs, title, words), encoding="utf-8")
    else:
        from .image import draw

        draw(jobs, title, words, suffix == ".svg").savefig(file, format=suffix[1:])
