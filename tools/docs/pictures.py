"""The pictures in docs/pictures, reduced in size and colours.

Pictures of the tools are drawn by a command each; those of the page are taken by its tests.
"""

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from .pages import DOCS, ROOT

FOLDER = DOCS / "pictures"
MOST_BYTES = 100_000
_MOST_WIDTH = 1200
_COLOURS = 64
_COMPARED_SIZE = (240, 206)  # dots to which two pictures are reduced to be compared
_MOST_DIFFERENCE = 4.0  # mean of a colour, of 255


class Picture(NamedTuple):
    """A picture by its name, and the arguments of `ugrbl` that draw it, except --plot FILE."""

    name: str
    words: str

    @property
    def command(self) -> str:
        """Return the command that draws it into build/."""
        return f"ugrbl {self.words} --plot build/{self.name}"


_FAST = "--set 110=6000 --set 111=6000 --set 112=3000 --set 120=500 --set 121=500 --set 122=300"
PICTURES = (
    Picture(
        "badge.png",
        f"run examples/badge.nc {_FAST}",
    ),
    Picture("punch.png", "run examples/punch.nc --board sim_punch"),
    Picture(
        "blade.png",
        "run examples/blade.nc --board sim_xyza --custom examples/custom/oscillating.py"
        f" {_FAST} --set 113=6000 --set 123=500",
    ),
    Picture(
        "knife.png",
        "run examples/knife.nc --board sim_xyza --custom examples/custom/knife.py"
        f" {_FAST} --set 113=6000 --set 123=500 --set 133=400",
    ),
    Picture(
        "height_map.png",
        "run examples/height_map.nc --custom examples/custom/height_map.py --input probe=Z-8"
        f" {_FAST}",
    ),
)


# Made by tests in host_tests/web: test_served_page.py, and the last three test_whole_way.py.
OF_THE_PAGE = (
    *("page.png", "page_phone.png", "page_pins.png", "page_tool_change.png"),
    *("page_guide.png", "page_height_map.png", "page_resume.png"),
)


def draw(picture: Picture, file: Path) -> None:
    """Draw a picture into a file, reduced. Raises CalledProcessError if the command fails."""
    with TemporaryDirectory() as folder:
        drawn = Path(folder) / picture.name
        command = [sys.executable, "-m", "ugrbl.cli", *picture.words.split(), "--plot", str(drawn)]
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        shrink(drawn, file)


def shrink(drawn: Path, file: Path, greys: bool = False) -> None:
    """Save a picture with fewer dots and colours. greys: it has many of them."""
    from PIL import Image

    method = Image.Quantize.MEDIANCUT if greys else Image.Quantize.MAXCOVERAGE
    with Image.open(drawn) as image:
        width = min(_MOST_WIDTH, image.width)
        size = (width, image.height * width // image.width)
        small = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    colours = 2 * _COLOURS if greys else _COLOURS
    few = small.quantize(colours, method=method, dither=Image.Dither.NONE)
    file.parent.mkdir(exist_ok=True)
    few.save(file, optimize=True)


def same(file: Path, other: Path) -> bool:
    """Return whether two pictures show the same. Fonts may differ between computers, and numbers
    between runs, but not lines and colours."""
    from PIL import Image, ImageChops, ImageStat

    pair = []
    for path in (file, other):
        with Image.open(path) as image:
            pair.append(image.convert("RGB").resize(_COMPARED_SIZE))
    return max(ImageStat.Stat(ImageChops.difference(*pair)).mean) < _MOST_DIFFERENCE


def renew(fresh: Path, kept: Path) -> None:
    """Replace a stored picture if the new one differs, or if there is none."""
    if not kept.exists() or not same(fresh, kept):
        shutil.copyfile(fresh, kept)


def keep(picture: Picture) -> Path:
    """Draw a picture into the folder of the documents."""
    file = FOLDER / picture.name
    draw(picture, file)
    return file
