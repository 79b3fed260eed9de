"""Where commands write: looked at before the work, so that none is done in vain."""

import os
from collections.abc import Iterable
from pathlib import Path

# What a path or a job can be drawn as.
PICTURES = (".html", ".png", ".svg")


def check_outputs(
    *files: Path | None, plot: Path | None = None, keep: Iterable[Path | None] = ()
) -> None:
    """Make the folders of files to be written. OSError or ValueError where one cannot be.

    plot: one that is a drawing; keep: files that are read and never to be written over.
    """
    if plot and plot.suffix.lower() not in PICTURES:
        raise ValueError(f"{plot}: it can be {', '.join(PICTURES)}")
    keep = tuple(keep)
    for file in (*files, plot):
        if file is not None and str(file) != "-":
            if file.exists() and any(file.samefile(one) for one in keep if one and one.exists()):
                raise ValueError(f"{file} is what is read: it is not written over")
            _check(file)


def _check(file: Path) -> None:
    if file.is_dir():
        raise IsADirectoryError(f"{file} is a folder: name a file")
    there = next(folder for folder in file.absolute().parents if folder.exists())
    if not there.is_dir():
        raise NotADirectoryError(f"{file} cannot be written: {there} is no folder")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"{file} cannot be written: {error.strerror}") from error
    if not os.access(file if file.exists() else file.parent, os.W_OK):
        raise PermissionError(f"{file} cannot be written: permission denied")
