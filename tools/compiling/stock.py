"""The firmware that comes compiled in the package, for those who have no compiler.

fill_stock.py makes it with the package: each file once, called by its digest, and an index, where

    sources   is the digest of what was compiled
    maps      has those of all of it by their id, see symbols.py
    cuts      are what boards have, each:
      arch      the processor
      map       the id of its map
      modules   of the firmware that are in it
      bundles   what its map has besides; null where each module has a file of its own
      files     by their path on the board: their digests

Sources are compared, not what is compiled of them: each version of Python writes that its own way.
"""

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping
from typing import Any, NamedTuple

from .. import paths

_INDEX = "index.json"


class NotThere(Exception):
    """It has not been compiled. The text says what; "" where there is no stock at all."""


class Cut(NamedTuple):
    """What goes together on a board. map: see symbols.py."""

    arch: str
    modules: list[str]
    files: Mapping[str, bytes]
    map: Mapping[str, Any]


def find(
    sources: Mapping[str, str], arch: str, modules: list[str], apart: Collection[str] = ()
) -> tuple[dict[str, bytes], dict[str, Any]]:
    """Files by their path, and the map, of a board with these modules of these sources.

    apart: its files where modules stay apart, which may come out of a cut with more. NotThere.
    """
    index = _index(sources)
    for cut in index["cuts"]:
        wider = apart and cut["bundles"] is None
        if cut["arch"] == arch and (wider or cut["modules"] == modules):
            wanted = [path for path in cut["files"] if not apart or path in apart]
            files = {path: (paths.COMPILED / cut["files"][path]).read_bytes() for path in wanted}
            map_ = index["maps"][cut["map"]]
            return files, {**map_, **({} if wider else {"bundles": cut["bundles"]})}
    raise NotThere(f"for {arch} with these options nothing is compiled already")


def maps_of(sources: Mapping[str, str]) -> dict[str, Any]:
    """The maps of all that is there of these sources, by their id."""
    try:
        return dict(_index(sources)["maps"])
    except NotThere:
        return {}


def _index(sources: Mapping[str, str]) -> dict[str, Any]:
    file = paths.COMPILED / _INDEX
    if not file.is_file():
        raise NotThere
    index: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    if index["sources"] != _digest(sources):
        raise NotThere("the firmware is another than what is compiled already")
    return index


def save(sources: Mapping[str, str], cuts: Iterable[Cut]) -> None:
    """Write what has been compiled of these sources where the package has it."""
    paths.COMPILED.mkdir()
    rows: list[dict[str, Any]] = []
    maps: dict[str, Any] = {}
    for cut in cuts:
        map_ = dict(cut.map)
        bundles = map_.pop("bundles", None)
        maps[map_["id"]] = map_
        files = {path: _put(content) for path, content in cut.files.items()}
        row = {"arch": cut.arch, "map": map_["id"], "modules": cut.modules}
        rows.append({**row, "bundles": bundles, "files": files})
    index = {"sources": _digest(sources), "maps": maps, "cuts": rows}
    (paths.COMPILED / _INDEX).write_text(json.dumps(index), encoding="utf-8")


def _put(content: bytes) -> str:
    name = hashlib.sha256(content).hexdigest()[:16]
    (paths.COMPILED / name).write_bytes(content)
    return name


def _digest(sources: Mapping[str, str]) -> str:
    return hashlib.sha256(repr(sorted(sources.items())).encode()).hexdigest()
