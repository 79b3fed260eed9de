"""Firmware that is to be frozen into MicroPython, which runs it where it lies: in flash.

Bytecode may stay there. Native code is brought into memory, function by function, as its module is
imported (firmware/base/frozen.py): each has its length in front, and its definition a decorator.
"""

import ast
import re
import struct
import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

from . import mpy
from .build import Build

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
_ABOUT = re.compile(_MARK + r"([0-9a-f]{8})((?: [\w.]+)+)")
_JUMP_OVER = 0xE000  # the next half word

# What makes a function of its own within another, or a generator of it.
_INSIDE = (
    *(ast.Lambda, ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp),
    *(ast.FunctionDef, ast.AsyncFunctionDef, ast.Yield, ast.YieldFrom, ast.Await),
)


class NotFrozen(ValueError):
    """A module that cannot be."""


def decorated(text: str) -> str:
    """A module whose native functions come into memory. NotFrozen where one has functions within
    that would not, for those are native, too; or is a generator."""
    tree = ast.parse(text)
    if not (functions := [*_native(tree)]):
        return text
    for function in functions:
        inside = {node for node in ast.walk(function) if isinstance(node, _INSIDE)}
        if inside - {*functions}:
            raise NotFrozen(f"{function.name} is native code with a function or a yield within")
        # The last one, for it wants the function itself.
        function.decorator_list.insert(-1, ast.Name(_DECORATOR, ast.Load()))
    # Behind documentation, or what gives names their places (order.py).
    first = int(isinstance(tree.body[0], ast.Expr))
    tree.body.insert(first, ast.ImportFrom(HELPER, [ast.alias(_DECORATOR)], 0))
    return ast.unparse(ast.fix_missing_locations(tree)) + "\n"


def with_lengths(compiled: bytes) -> bytes:
    """Such a module, compiled, with each function's length in front of its code."""

    def rewrite(code: bytes, place: int) -> bytes:
        return struct.pack("<2H", _JUMP_OVER, len(code)) + code

    return mpy.rewritten(compiled, rewrite)


def start(text: str) -> str:
    """What MicroPython runs in place of main.py. text: the firmware's."""
    return _START + textwrap.indent(text, "    ")


class Frozen(NamedTuple):
    """What is frozen: which build, and which modules of the firmware."""

    build: str
    modules: frozenset[str]

    def lacks(self, made: Build) -> str:
        """Why a board cannot do without the files of this build; "" where it can."""
        if self.build != made.map.get("id"):
            return f"the build {self.build} is frozen into it, and here is {made.map.get('id')}"
        missing = sorted(made.modules - self.modules)
        return f"what is frozen into it has no {', '.join(missing)}" if missing else ""


def beside(made: Build, frozen: Frozen | None) -> Build:
    """What goes into the file system of a MicroPython: the board's own, where all is frozen."""
    if frozen is None or frozen.lacks(made):
        return made
    return replace(made, files={path: made.files[path] for path in made.own})


def about(text: str, build: str, modules: Iterable[str]) -> str:
    """The helper's source, which tells what is frozen."""
    return text.replace(_MARK + _NOTHING, f"{_MARK}{build} {' '.join(modules)}")


def read(text: str) -> "Frozen | None":
    """What the helper's ABOUT tells. text: that, or what has it within; None where it has not."""
    found = _ABOUT.search(text)
    return Frozen(found[1], frozenset(found[2].split())) if found else None


def _native(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            decorators = [ast.unparse(each) for each in node.decorator_list]
            if decorators and decorators[-1] in _NATIVE:
                yield node
