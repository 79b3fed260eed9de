"""A build as a folder: for mip, for a build of MicroPython with it frozen, and for the desktop."""

import json
from pathlib import Path

from .. import __version__, paths
from . import motion_package
from .build import KERNELS, LIBRARY, START, Build, sources, texts
from .inline import inline

PACKAGE_LIST = "package.json"


def save(made: Build, folder: Path, for_mip: bool = True) -> None:
    """Write the files to a folder, with a package list if mip may install them.

    Compiled files of an older build are removed. Unchanged files are not written again, because
    MicroPython is rebuilt if a frozen file is newer.
    """
    files = made.files | ({PACKAGE_LIST: package_list(made).encode()} if for_mip else {})
    for part in folders(made):
        for old in (folder / part).glob("*.mpy"):
            if old.relative_to(folder).as_posix() not in made.files:
                old.unlink()
    for path, content in files.items():
        file = folder / path
        if not file.is_file() or file.read_bytes() != content:
            paths.write(file, content)


def package_list(made: Build) -> str:
    """Return the text for `mpremote mip install`: the path of each file, on the board and in this
    folder.

    main.py comes last, so that a board with half an installation starts with MicroPython's prompt.
    """
    order = sorted(made.files, key=lambda path: (path == START, path))
    listed = {"version": __version__, "urls": [[path, path] for path in order]}
    return json.dumps(listed, indent=1) + "\n"


def folders(made: Build) -> list[str]:
    """Return the folders that may have firmware files, on any board; "" is the root."""
    return sorted({path.rpartition("/")[0] for path in (*made.files, *sources(), KERNELS)})


def place(folder: Path) -> None:
    """Write the sources for MicroPython on a desktop, of the firmware and of ugrbl_motion, with
    numbers in place of constants."""
    library = motion_package.texts()
    package_init = {f"{LIBRARY}.__init__": library.pop(LIBRARY)}
    for name, text in inline({**texts(), **library, **package_init}, keep=True).items():
        file = folder / f"{name.replace('.', '/')}.py"
        paths.write(file, text.encode())
