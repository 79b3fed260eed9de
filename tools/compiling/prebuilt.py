"""The compiled firmware in the package, for users without a compiler.

Each processor has a folder with a file per module, named after the module. The file `sources` has
the digest of the sources that were compiled. setup.py makes all this with the package
(folder.fill_stock()).

The sources as written are compared, not those after the first pass, because each version of Python
writes these differently.
"""

import hashlib
from collections.abc import Mapping

from .. import paths

_DIGEST = "sources"


class NotThere(Exception):
    """No compiled firmware for these sources. The text is the cause; "" if there is none at
    all."""


def find(sources: Mapping[str, str], arch: str) -> dict[str, bytes]:
    """Return the compiled modules of these sources for a processor, by name. NotThere."""
    digest = paths.COMPILED / _DIGEST
    if not digest.is_file():
        raise NotThere
    if digest.read_text(encoding="utf-8") != _digest(sources):
        raise NotThere("the firmware has changed since it was compiled")
    found = {file.name: file.read_bytes() for file in (paths.COMPILED / arch).glob("*")}
    if not found:
        raise NotThere(f"the package has no compiled firmware for {arch}")
    return found


def save(sources: Mapping[str, str], compiled: Mapping[str, Mapping[str, bytes]]) -> None:
    """Write compiled modules, by processor and name, into the package, with the digest of their
    sources."""
    for arch, modules in compiled.items():
        for name, content in modules.items():
            paths.write(paths.COMPILED / arch / name, content)
    paths.write(paths.COMPILED / _DIGEST, _digest(sources).encode())


def _digest(sources: Mapping[str, str]) -> str:
    return hashlib.sha256(repr(sorted(sources.items())).encode()).hexdigest()
