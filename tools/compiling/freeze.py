"""Firmware to be frozen into MicroPython, which runs it directly from flash.

All of it is frozen, for every board of a chip. The board file stays in the file system, where an
update of the firmware leaves it, with the settings and the user's own Python; it decides which
modules are imported. Bytecode stays in flash. On Arm, the native code of each function is copied
into memory when its module is imported (firmware/base/frozen.py). For this, each function's length
precedes its code, and its definition has a decorator.
"""

import ast
import re
import struct
import textwrap
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from .. import __version__
from ..boardfile.files import load_for_build
from . import build, compilers, mpy
from .build import Build, BuildError

# The module with that decorator. It also has the text that the board and the tools read.
HELPER = "base.frozen"
_DECORATOR = "in_memory"
_NATIVE = ("micropython.viper", "micropython.native")

# If there is a main.py, files come before frozen modules. A deployment writes main.py last, so
# that after an interrupted one no file replaces a frozen module.
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
# Processors whose native code is copied into memory. An ESP32 runs it in flash.
_ARM = "arm"
_JUMP_OVER = 0xE000  # branch over the next half word, which has the length

# Creates another function within a function, or makes it a generator.
_INSIDE = (
    *(ast.Lambda, ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp),
    *(ast.FunctionDef, ast.AsyncFunctionDef, ast.Yield, ast.YieldFrom, ast.Await),
)


class NotFrozen(ValueError):
    """This module cannot be frozen."""


def for_board(file: Path) -> Build:
    """Build for the chip of a board file. Raises BoardFileError before it compiles."""
    board: Any = load_for_build(file)
    arch = board.MPY_ARCH
    if not compilers.are_there(arch):
        raise BuildError(compilers.missing("compiled firmware in the package cannot be frozen"))
    ready, sources = build.prepared(arch), build.texts()
    main, firmware_id = build.module(build.START), build.id_of(arch)
    unused = build.of_other_chips(ready.texts, arch)
    pieces = {name: keys for name, keys in ready.pieces.items() if name not in unused}
    texts = {name: text for name, text in ready.texts.items() if name not in unused}
    texts[main] = _start(sources[main])
    # The helper's source says "ugrbl frozen: nothing"; not_frozen() and the tools read it.
    about = f"{_MARK}{firmware_id} {__version__}"
    texts[HELPER] = sources[HELPER].replace(_MARK + _NOTHING, about)
    runs_in_memory = arch.startswith(_ARM)  # its native code
    if runs_in_memory:
        texts = {name: decorated(text) for name, text in texts.items()}
    code = build.compiled(arch, ready._replace(texts=texts, pieces=pieces), traceback_name=_file)
    made = Build(arch, {}, board.ENGINE, firmware_id)
    for name in sorted(code):
        path = _file(name).removesuffix(".py") + ".mpy"
        made.files[path] = with_lengths(code[name]) if runs_in_memory else code[name]
    return made


def _file(module: str) -> str:
    """Return the name of a module among the frozen files: `motion/planner.py`."""
    return build.path_of(module).replace(".mpy", ".py")


def decorated(text: str) -> str:
    """Return a module's text with a decorator on each native function that copies its code into
    memory; lines keep their numbers. NotFrozen if a native function is a generator or has
    functions within, because those are native too and would not be copied."""
    lines = text.splitlines(keepends=True)
    tree = ast.parse(text)
    if not (functions := [*_native(tree)]):
        return text
    for function in functions:
        inside = {node for node in ast.walk(function) if isinstance(node, _INSIDE)}
        if inside - {*functions}:
            raise NotFrozen(
                f"{function.name} is native code, and must not contain a function or a yield"
            )
        # The decorator needs the function itself, so only the lowest one stays below it:
        # micropython.viper or .native, which the compiler removes. The others move up by one, to
        # an empty line, so that no later line moves.
        highest, lowest = (function.decorator_list[index].lineno - 1 for index in (0, -1))
        empty = highest - 1
        if lines[empty].strip():
            raise NotFrozen(f"put an empty line above {function.name}")
        others = lines[highest:lowest]
        lines[empty:lowest] = [*others, f"{' ' * function.col_offset}@{_DECORATOR}\n"]
    has_docstring = isinstance(tree.body[0], ast.Expr)
    first = tree.body[int(has_docstring)].lineno - 1
    lines[first] = f"from {HELPER} import {_DECORATOR}; {lines[first]}"
    return "".join(lines)


def with_lengths(compiled: bytes) -> bytes:
    """Return a compiled module with each native function's length in front of its code."""

    def rewrite(code: bytes) -> bytes:
        return struct.pack("<2H", _JUMP_OVER, len(code)) + code

    return mpy.rewritten(compiled, rewrite)


def _start(text: str) -> str:
    """Return what MicroPython runs in place of main.py. text: the firmware's main.py."""
    return _START + textwrap.indent(text, "    ")


def not_frozen(made: Build, frozen: str) -> Build:
    """Return what goes into the file system: only the board's own files if a MicroPython with the
    firmware of that id ("": without firmware) has the rest."""
    if not frozen or frozen != made.id:
        return made
    return replace(made, files={path: made.files[path] for path in made.own})


def read(text: str) -> str:
    """Return the id of the firmware that is frozen into a MicroPython, from the helper's ABOUT, or
    from a text that contains it; "" if none is."""
    found = _ABOUT.search(text)
    return found[1] if found else ""


def _native(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    """Yield the functions that are compiled to native code: that decorator is the lowest one."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef):
            decorators = [ast.unparse(each) for each in node.decorator_list]
            if decorators and decorators[-1] in _NATIVE:
                yield node
