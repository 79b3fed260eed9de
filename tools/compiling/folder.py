"""A build as a folder: for mip, for whoever builds MicroPython with it, and for the desktop's."""

import json
from pathlib import Path

from .. import __version__, paths
from ..boardfile.chips import CHIPS
from . import prebuilt
from .build import KERNELS, START, Build, firmware, sources, texts
from .inline import inline

_PACKAGE_LIST = "package.json"


def save(made: Build, folder: Path) -> None:
    """Write the files there, and a list of them for mip; what an older build has compiled there
    goes."""
    for part in folders(made):
        for old in (folder / part).glob("*.mpy"):
            old.unlink()
    for path, content in made.files.items():
        file = folder / path
        paths.write(file, content)
    paths.write(folder / _PACKAGE_LIST, package_list(made).encode())


def package_list(made: Build) -> str:
    """What `mpremote mip install` reads: each file's path on the board, and beside this text.

    Left half way, the board is to start with MicroPython's prompt: main.py is the last."""
    order = sorted(made.files, key=lambda path: (path == START, path))
    rows = ",\n".join(f"    {json.dumps([path, path])}" for path in order)
    return f'{{\n  "urls": [\n{rows}\n  ],\n  "version": {json.dumps(__version__)}\n}}\n'


def save_to_freeze(made: Build, folder: Path) -> None:
    """Write nothing but these files there: not anew what is there as it should be, for MicroPython
    is built anew where something is newer."""
    for old in folder.rglob("*.mpy"):
        if old.relative_to(folder).as_posix() not in made.files:
            old.unlink()
    for path, content in made.files.items():
        file = folder / path
        if not file.is_file() or file.read_bytes() != content:
            paths.write(file, content)


def folders(made: Build) -> list[str]:
    """Where files of the firmware are, on this board or another; its root is an empty text."""
    return sorted({path.rpartition("/")[0] for path in (*made.files, *sources(), KERNELS)})


def fill_stock() -> None:
    """Compile the firmware for every processor, and write it where the package has it."""
    archs = {chip.mpy_arch for chip in CHIPS.values()}
    prebuilt.save(texts(), {arch: firmware(arch).modules for arch in archs})


def place(folder: Path) -> None:
    """Write the sources there as a desktop's MicroPython runs them: constants in place."""
    for name, text in inline(texts(), keep=True).items():
        file = folder / f"{name.replace('.', '/')}.py"
        paths.write(file, text.encode())
