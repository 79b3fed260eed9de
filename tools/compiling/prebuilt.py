"""The firmware that comes compiled in the package, for those who have no compiler.

A folder for each processor has every module in a file, called by its name; beside them is the
digest of what was compiled. setup.py makes it with the package (folder.fill_stock()).

Sources are compared, not what is compiled of them: each version of Python writes that its own way.
"""

import hashlib
from collections.abc import Mapping

from .. import paths

_DIGEST = "sources"


class NotThere(Exception):
    """It has not been compiled. The text says what; "" where there is no stock at all."""


def find(sources: Mapping[str, str], arch: str) -> dict[str, bytes]:
    """The modules of these sources for a processor, compiled, by name. NotThere."""
    digest = paths.COMPILED / _DIGEST
    if not digest.is_file():
        raise NotThere
    if digest.read_text(encoding="utf-8") != _digest(sources):
        raise NotThere("the firmware is another than what is compiled already")
    found = {file.name: file.read_bytes() for file in (paths.COMPILED / arch).glob("*")}
    if not found:
        raise NotThere(f"for {arch} nothing is compiled already")
    return found


def save(sources: Mapping[str, str], compiled: Mapping[str, Mapping[str, bytes]]) -> None:
    """Write what has been compiled of these sources, by processor and name, where the package
    has it."""
    for arch, modules in compiled.items():
        for name, content in modules.items():
            paths.write(paths.COMPILED / arch / name, content)
    paths.write(paths.COMPILED / _DIGEST, _digest(sources).encode())


def _digest(sources: Mapping[str, str]) -> str:
    return hashlib.sha256(repr(sorted(sources.items())).encode()).hexdigest()
