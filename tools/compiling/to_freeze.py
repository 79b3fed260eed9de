"""The firmware of a board as it is frozen into its MicroPython: what manifest.py takes up.

Which pins there are is not frozen: the board file lies in the file system, where an update leaves
it, with settings and the user's own Python.
"""

from pathlib import Path
from typing import Any

from ..boardfile.files import load_for_build
from . import build, compilers, freeze
from .build import Build, BuildError, Progress

# Processors whose native code is brought into memory. An ESP32 runs it where it lies.
_ARM = "arm"


def for_board(
    file: Path, progress: Progress = lambda name, size: None, debug: bool = False
) -> Build:
    """What the board of that file has a use for. BoardFileError before anything is compiled."""
    board: Any = load_for_build(file)
    if not compilers.are_there(board.MPY_ARCH):
        raise BuildError(compilers.missing("what is compiled already is not to be frozen"))
    chosen, described = build.chosen_texts(board.MPY_ARCH, board, debug)
    modules = build.modules_of(board)
    sources = build.texts()
    start = build.module(build.START)
    texts = {**chosen, start: freeze.start(sources[start])}
    texts[freeze.HELPER] = freeze.about(sources[freeze.HELPER], described["id"], modules)
    moved = board.MPY_ARCH.startswith(_ARM)
    if moved:
        texts = {name: freeze.decorated(text) for name, text in texts.items()}
    code = build.compiled(board.MPY_ARCH, texts, debug, told=_file)
    made = Build(board.MPY_ARCH, {}, board.ENGINE, described, frozenset(modules))
    for name in sorted(code):
        path = _file(name).removesuffix(".py") + ".mpy"
        made.files[path] = freeze.with_lengths(code[name]) if moved else code[name]
        progress(path, len(made.files[path]))
    return made


def _file(module: str) -> str:
    """What MicroPython looks for in what is frozen: `motion/__init__.py`."""
    return build.path_of(module).replace(".mpy", ".py")
