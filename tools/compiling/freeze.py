"""Firmware that is to be frozen into MicroPython, which runs it where it lies: in flash.

All of it is, for every board of a chip: the board file lies in the file system, where an update
leaves it, with settings and the user's own Python, and says what is imported. Bytecode stays in
flash. An Arm's native code is brought into memory, function by function, as its module is imported
(firmware/base/frozen.py): each has its length in front, and its definition a decorator.
"""

import ast
import re
import struct
import textwrap
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from ..boardfile.files import load_for_build
from . import build, compilers, mpy
from .build import Build, BuildError, Progress

# The module with that decorator, and what the board and the tools read of it.
HELPER = "base.frozen"
_DECORATOR = "in_memory"
_NATIVE = ("micropython.viper", "micropython.native")

# Files come first where there is a main.py, the last that a deployment writes. Without it, as one
# that was cut short leaves them, no file takes the place of what is frozen.
_START = """
import os, sys
if "main.py" in os.listdir():
    exec(open("main.py").read())
else:
    sys.path.remove(".frozen")
    sys.path.insert(0, ".frozen")
    __import__("base.frozen")  # by which the firmware knows
"""

_MARK = "ugrbl frozen: "
_NOTHING = "nothing"
_ABOUT = re.compile(_MARK + r"([0-9a-f]{8})")
# Processors whose native code is brought into memory. An ESP32 runs it where it lies.
_ARM = "arm"
_JUMP_OVER = 0xE000  # the next half word

# What makes a function of its own within another, or a generator of it.
_INSIDE = (
    *(ast.Lambda, ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp),
    *(ast.FunctionDef, ast.AsyncFunctionDef, ast.Yield, ast.YieldFrom, ast.Await),
)


class NotFrozen(ValueError):
    """A module that cannot be."""


def for_board(file: Path, progress: Progress = lambda name, size: None) -> Build:
    """For the chip of the board of that file. BoardFileError before anything is compiled."""
    board: Any = load_for_build(file)
    arch = board.MPY_ARCH
    if not compilers.are_there(arch):
        raise BuildError(compilers.missing("what is compiled already is not to be frozen"))
    ready, sources = build.prepared(arch), build.texts()
    start, number = build.module(build.START), build.id_of(arch)
    texts = {**ready.texts, start: _start(sources[start])}
    texts[HELPER] = sources[HELPER].replace(_MARK + _NOTHING, _MARK + number)
    moved = arch.startswith(_ARM)
    if moved:
        texts = {name: decorated(text) for name, text in texts.items()}
    code = build.compiled(arch, ready._replace(texts=texts), told=_file)
    made = Build(arch, {}, board.ENGINE, number)
    for name in sorted(code):
        path = _file(name).removesuffix(".py") + ".mpy"
        made.files[path] = with_lengths(code[name]) if moved else code[name]
        progress(path, len(made.files[path]))
    return made


def _file(module: str) -> str:
    """What MicroPython looks for in what is frozen: `motion/planner.py`."""
    return build.path_of(module).replace(".mpy", ".py")


def decorated(text: str) -> str:
    """A module whose native functions come into memory. NotFrozen where one has functions within
    that would not, for those are native, too; or is a generator."""
    lines = text.splitlines(keepends=True)
    tree = ast.parse(text)
    if not (functions := [*_native(tree)]):
        return text
    for function in functions:
        inside = {node for node in ast.walk(function) if isinstance(node, _INSIDE)}
        if inside - {*functions}:
            raise NotFrozen(f"{function.name} is native code with a function or a yield within")
        # Right above the last one, for it wants the function itself; others move up to an empty
        # line, so that no line after that moves.
        first, last = (function.decorator_list[at].lineno - 1 for at in (0, -1))
        if lines[first - 1].strip():
            raise NotFrozen(f"there is no empty line above {function.name}")
        others = lines[first:last]
        lines[first - 1 : last] = [*others, f"{' ' * function.col_offset}@{_DECORATOR}\n"]
    begin = tree.body[int(isinstance(tree.body[0], ast.Expr))].lineno - 1  # behind documentation
    lines[begin] = f"from {HELPER} import {_DECORATOR}; {lines[begin]}"
    return "".join(lines)


def with_lengths(compiled: bytes) -> bytes:
    """Such a module, compiled, with each function's length in front of its code."""

    def rewrite(code: bytes) -> bytes:
        return struct.pack("<2H", _JUMP_OVER, len(code)) + code

    return mpy.rewritten(compiled, rewrite)


def _start(text: str) -> str:
    """What MicroPython runs in place of main.py. text: the firmware's."""
    return _START + textwrap.indent(text, "    ")


class Frozen(NamedTuple):
    """What is frozen: the firmware with this id."""

    id: str

    def lacks(self, made: Build) -> str:
        """Why a board cannot do without the files of this build; "" where it can."""
        if self.id != made.id:
            return f"the build {self.id} is frozen into it, and here is {made.id}"
        return ""


def beside(made: Build, frozen: Frozen | None) -> Build:
    """What goes into the file system of a MicroPython: the board's own, where all is frozen."""
    if frozen is None or frozen.lacks(made):
        return made
    return replace(made, files={path: made.files[path] for path in made.own})


def read(text: str) -> "Frozen | None":
    """What the helper's ABOUT tells. text: that, or what has it within; None where it has not."""
    found = _ABOUT.search(text)
    return Frozen(found[1]) if found else None


def _native(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            decorators = [ast.unparse(each) for each in node.decorator_list]
            if decorators and decorators[-1] in _NATIVE:
                yield node
