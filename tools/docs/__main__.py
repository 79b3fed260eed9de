"""Update the tables in docs/, and the words of the page in the browser: `python -m ugrbl.docs`.

The meaning of a row is the comment above it in the firmware, or a text in meanings.py; without one
the table is not made. --pictures also draws the pictures.
"""

from pathlib import Path
from typing import Annotated

import typer

from . import browser, pages, pictures, ramp


def main(
    draw: Annotated[bool, typer.Option("--pictures", help="Draw the pictures as well.")] = False,
) -> None:
    """Update the tables in docs/."""
    for page in pages.PAGES:
        _renew(page, pages.update(page.read_text(encoding="utf-8")))
    _renew(browser.PAGE, browser.update(browser.PAGE.read_text(encoding="utf-8")))
    if draw:
        for picture in pictures.PICTURES:
            print(f"{pictures.keep(picture).name} has been drawn")
        if ramp.RECORDING.is_file():
            print(f"{ramp.keep().name} has been drawn")


def _renew(file: Path, new: str) -> None:
    """Write a file if its text has changed, and print which."""
    old = file.read_text(encoding="utf-8") if file.exists() else ""
    if new != old:
        file.write_text(new, encoding="utf-8")
    print(file.name, "has been brought up to date" if new != old else "is up to date")


if __name__ == "__main__":
    typer.run(main)
