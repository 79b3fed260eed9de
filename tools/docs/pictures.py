"""The pictures in docs/pictures: drawn by a command, kept in fewer dots and colours."""

import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from .pages import DOCS, ROOT

FOLDER = DOCS / "pictures"
_WIDTH = 1200
_COLOURS = 64


class Picture(NamedTuple):
    """A picture by its name, and the words behind `ugrbl` that draw it, but for --plot FILE."""

    name: str
    words: str

    @property
    def command(self) -> str:
        """What to type to have it drawn, into build/."""
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


def draw(picture: Picture, file: Path) -> None:
    """Draw it there, as it is kept. Raises CalledProcessError where the command fails."""
    from PIL import Image

    with TemporaryDirectory() as folder:
        drawn = Path(folder) / picture.name
        command = [sys.executable, "-m", "ugrbl.cli", *picture.words.split(), "--plot", str(drawn)]
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        with Image.open(drawn) as image:
            size = (_WIDTH, image.height * _WIDTH // image.width)
            small = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    few = small.quantize(_COLOURS, method=Image.Quantize.MAXCOVERAGE)
    file.parent.mkdir(exist_ok=True)
    few.save(file, optimize=True)


def keep(picture: Picture) -> Path:
    """Draw it where the documents look for it."""
    file = FOLDER / picture.name
    draw(picture, file)
    return file
