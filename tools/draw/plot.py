"""Jobs drawn into a file, as its name asks for: a page or a picture."""

from collections.abc import Sequence
from pathlib import Path

from .job import Job


def save(jobs: Sequence[Job], title: str, words: str, file: Path) -> None:
    """Draw the jobs beside each other; the suffix of the file says how."""
    suffix = file.suffix.lower()
    if suffix == ".html":
        from .page import page

        file.write_text(page(jobs, title, words), encoding="utf-8")
    else:
        from .image import draw

        draw(jobs, title, words, suffix == ".svg").savefig(file, format=suffix[1:])
