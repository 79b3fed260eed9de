"""Maps of builds (compiling/symbols.py): kept, and found when a board tells of a fault.

A map lies beside what `ugrbl build` has made, and in a folder of this user's for each deployment.
For the firmware that is here none is needed: it is made anew, or comes with the package.
"""

import json
import os
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import typer

from .. import paths
from . import build, stock, symbols

SUFFIX = ".map.json"
# Where `ugrbl build` writes by default.
_BUILT = Path("build")
_HERE = "the firmware that is here"
# One that has kernels as machine code, and one that has not: their texts differ.
_PROCESSORS = ("armv6m", "xtensawin")
_MOST = 50  # maps of 100 kB each
# Says where maps are kept, where it is not in the user's folder.
_VARIABLE = "UGRBL_MAPS"


class MapError(Exception):
    """There is none that fits; the text says what there is, and what helps."""


class Found(NamedTuple):
    """A map, and where it comes from, in words."""

    map: dict[str, Any]
    where: str


def folder() -> Path:
    """Where maps of deployments are kept."""
    return Path(os.environ.get(_VARIABLE) or Path(typer.get_app_dir("ugrbl")) / "maps")


def beside(made: Path) -> Path:
    """The map of a build in this folder."""
    return made.with_name(made.name + SUFFIX)


def save(map_: dict[str, Any], file: Path) -> None:
    """Write it."""
    paths.write(file, json.dumps(map_).encode())


def keep(map_: dict[str, Any]) -> None:
    """Remember it for this user; those that are oldest go."""
    save(map_, folder() / f"{map_['id']}{SUFFIX}")
    files = sorted(folder().glob(f"*{SUFFIX}"), key=lambda file: file.stat().st_mtime)
    for old in files[:-_MOST]:
        old.unlink()


def read(file: Path) -> dict[str, Any]:
    """A map out of its file. OSError where there is none."""
    try:
        map_ = json.loads(file.read_text(encoding="utf-8"))
    except ValueError:
        map_ = None
    if isinstance(map_, dict) and map_.keys() >= {"id", "modules", "classes"}:
        return map_
    raise MapError(f"{file} is no map: `ugrbl build` writes those")


def find(number: str) -> Found:
    """The map of the build with this id. MapError where there is none."""
    if number == symbols.OF_SOURCES:
        return Found({"id": number, "modules": {}, "classes": {}}, "sources, which have all names")
    there = [*folder().glob(f"*{SUFFIX}"), *_BUILT.glob(f"*{SUFFIX}")]
    for file in there:
        map_ = _readable(file)
        if map_.get("id") == number:
            return Found(map_, str(file))
    compiled = stock.maps_of(build.texts())
    if number in compiled:
        return Found(compiled[number], _HERE)
    for debug, arch in product((False, True), _PROCESSORS):
        if build.prepared_firmware(debug, arch).id == number:
            return Found(of(debug, arch), _HERE)
    known = sorted({str(_readable(file).get("id", "")) for file in there} - {""})
    others = f", and maps of {', '.join(known)}" if known else ""
    here = " and ".join(compiled) or build.prepared_firmware().id
    raise MapError(
        f"there is no map of the build {number}: here is the firmware {here}{others}; on the "
        f"computer that built it the map lies beside its folder (build/*{SUFFIX}): --map FILE"
    )


def of(debug: bool, arch: str = "armv6m") -> dict[str, Any]:
    """The map of the firmware that is here."""
    return symbols.describe(build.texts(), build.prepared_firmware(debug, arch), debug)


def _readable(file: Path) -> dict[str, Any]:
    """A map that may have been damaged, be of a later version, or be gone: empty then."""
    try:
        return read(file)
    except (MapError, OSError):
        return {}
