"""The second of two passes: kernels, a module's viper functions, as separate machine code.

If there is machine code for the board's processor (machine_code.py), the functions are removed
from their modules, and each module that uses one imports it. Kernels of modules that every board
of the chip has are in one piece, `kernels.core`. Those of each other module are in a piece of
their own, so that a board has no kernel that it does not use. Lines keep their numbers.
"""

import ast
from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

from . import machine_code, mpy, viper
from .viper import Key, Module

PACKAGE = "kernels"
_CORE = f"{PACKAGE}.core"
_TEXT = """\
import micropython

@micropython.viper
def start() -> object:
    return None
{names}, = start()
"""


class Apart(NamedTuple):
    """texts: the modules without kernels and the modules of kernels, by name. c: all kernels as C
    text. pieces: the kernels in each module of kernels, in order."""

    texts: "dict[str, str]"
    c: str
    pieces: "dict[str, list[Key]]"


def taken_apart(texts: "Mapping[str, str]", core: "Collection[str]") -> Apart:
    """Separate kernels from the rest. core: modules that every board has. NotForC if a kernel has
    a form that cannot be translated."""
    modules = {name: Module(name, text) for name, text in texts.items()}
    keys = [(name, function) for name, module in modules.items() for function in module.functions]
    names = _names(keys)
    homes = {key: _home(key[0], core) for key in keys}
    asked = {key for module in modules.values() for key in _asked_of(module)}
    left = {name: _Left(text, modules[name], names, homes, asked) for name, text in texts.items()}
    made = {name: each.text() for name, each in left.items()}
    wanted = {key for each in left.values() for key in each.wanted}
    pieces: dict[str, list[Key]] = {}
    for key in sorted(wanted, key=lambda key: names[key]):
        pieces.setdefault(homes[key], []).append(key)
    for home, there in pieces.items():
        made[home] = _TEXT.format(names=", ".join(names[key] for key in there))
    return Apart(made, machine_code.in_c(modules, keys), pieces)


def with_code(compiled: bytes, name: str, apart: Apart, arch: str) -> bytes:
    """Return a compiled module of kernels with their machine code in it. CompilerError."""
    code = machine_code.linked(apart.c, arch, tuple(apart.pieces[name]))
    assert mpy.table_place(compiled) == 0
    return mpy.rewritten(compiled, lambda _start: code)


def _home(module: str, core: "Collection[str]") -> str:
    return _CORE if module in core else f"{PACKAGE}.{module.replace('.', '_')}"


def _names(keys: "list[Key]") -> "dict[Key, str]":
    """Return a name for each kernel: the function's own if it is unique, else with its
    module's."""
    functions = [function for _, function in keys]
    return {
        (module, function): (
            function
            if functions.count(function) == 1
            else f"{function}_{module.rpartition('.')[2]}"
        )
        for module, function in keys
    }


def _asked_of(module: Module) -> Iterator[Key]:
    """Yield the attributes of other modules that a module uses."""
    for node in ast.walk(module.tree):
        match node:
            case ast.Attribute(ast.Name(alias), name) if alias in module.aliases:
                yield module.aliases[alias], name


class _Left:
    """A module's text without kernels. names: of all kernels. homes: the module of kernels each
    one is in. asked: attributes that any module uses."""

    def __init__(
        self,
        text: str,
        module: Module,
        names: "Mapping[Key, str]",
        homes: "Mapping[Key, str]",
        asked: "Collection[Key]",
    ) -> None:
        self.wanted: list[Key] = []
        self._lines = text.splitlines(keepends=True)
        self._module = module
        self._names = names
        self._homes = homes
        self._tree = ast.parse(text)
        self._kernels = [*viper.vipers(self._tree, methods=False)]
        others = [statement for statement in self._tree.body if statement not in self._kernels]
        self._used = {
            node.id
            for statement in others
            for node in ast.walk(statement)
            if isinstance(node, ast.Name)
        } | {name for of, name in asked if of == module.name}

    def text(self) -> str:
        """Return what remains of the module."""
        for kernel in self._kernels:
            key = (self._module.name, kernel.name)
            wanted = {key: kernel.name} if kernel.name in self._used else {}
            self._replace(kernel.decorator_list[0], kernel, [], wanted)
        for node in ast.walk(self._tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                self._import(node, node.module)
            elif isinstance(node, ast.Import) and "micropython" not in self._used:
                left = [ast.Import([a]) for a in node.names if a.name != "micropython"]
                if len(left) < len(node.names):
                    self._replace(node, node, left, {})
        return "".join(self._lines)

    def _import(self, node: ast.ImportFrom, module: str) -> None:
        kernels = [a for a in node.names if (module, a.name) in self._names]
        if not kernels:
            return
        left = [a for a in node.names if a not in kernels]
        here = {(module, a.name): a.asname or a.name for a in kernels}
        wanted = {key: name for key, name in here.items() if name in self._used}
        self._replace(node, node, [ast.ImportFrom(module, left, 0)] if left else [], wanted)

    def _replace(
        self,
        first: "ast.expr | ast.stmt",
        last: ast.stmt,
        left: "list[ast.Import] | list[ast.ImportFrom]",
        wanted: "Mapping[Key, str]",
    ) -> None:
        """Replace statements that stand alone on their lines by imports on the first of these
        lines."""
        self.wanted += wanted
        asked: dict[str, list[ast.alias]] = {}
        for key, here in wanted.items():
            name = self._names[key]
            alias = ast.alias(name, None if name == here else here)
            asked.setdefault(self._homes[key], []).append(alias)
        made = [*left, *(ast.ImportFrom(home, names, 0) for home, names in asked.items())]
        text = "; ".join(map(ast.unparse, made)) or "pass"
        begin, end = first.lineno - 1, (last.end_lineno or last.lineno) - 1
        indent = " " * last.col_offset
        self._lines[begin : end + 1] = [indent + text + "\n", *["\n"] * (end - begin)]
