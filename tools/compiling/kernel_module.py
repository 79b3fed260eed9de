"""A board's kernels in a module of their own: machine code, where there is such for its processor.

The viper functions of all modules are taken out of their texts, and compiled together
(machine_code.py); a module that calls one imports it from there. Lines stay where they are.
"""

import ast
from collections.abc import Collection, Iterator, Mapping
from functools import lru_cache
from typing import NamedTuple

from . import forms, machine_code, mpy
from .marks import Key
from .modules import Module
from .scan import walk

MODULE = "kernels"
_TEXT = """\
import micropython
@micropython.viper
def start() -> object:
    return None
{names}, = start()
"""


class Apart(NamedTuple):
    """texts: the modules without kernels, by name. c: those, all of them. names: which is which,
    by the name under which they are imported."""

    texts: "dict[str, str]"
    c: str
    names: "dict[str, Key]"


def taken_apart(texts: "Mapping[str, str]") -> Apart:
    """Kernels, and what is left without them. NotForC where one is in no form for C."""
    modules = {name: Module(name, text) for name, text in texts.items()}
    keys = [(name, function) for name, module in modules.items() for function in module.functions]
    names = _names(keys)
    known = {key: name for name, key in names.items()}
    asked = {key for module in modules.values() for key in _asked_of(module)}
    left = {name: _Left(text, modules[name], known, asked).text() for name, text in texts.items()}
    return Apart(left, machine_code.in_c(modules, keys), names)


def text(texts: "Collection[str]") -> str:
    """The module that has what these import of it; an empty text where that is nothing."""
    found = {name for each in texts for name in _imported(each)}
    return _TEXT.format(names=", ".join(sorted(found))) if found else ""


@lru_cache(300)  # boards have most modules in common
def _imported(text: str) -> "frozenset[str]":
    return frozenset(
        alias.name
        for node in walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom) and node.module == MODULE
        for alias in node.names
    )


def with_code(compiled: bytes, text: str, apart: Apart, arch: str) -> bytes:
    """This module, compiled, with the kernels' code in it."""
    (names,) = (
        statement.targets[0].elts
        for statement in ast.parse(text).body
        if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Tuple)
    )
    keys = tuple(apart.names[ast.unparse(name)] for name in names)
    code = machine_code.linked(apart.c, arch, keys)
    assert mpy.table_place(compiled) == 0
    return mpy.rewritten(compiled, lambda _code, _place: code)


def _names(keys: "list[Key]") -> "dict[str, Key]":
    """Each function's own name, if no other has it."""
    functions = [function for _, function in keys]
    return {
        (
            function
            if functions.count(function) == 1
            else f"{function}_{module.rpartition('.')[2]}"
        ): (module, function)
        for module, function in keys
    }


def _asked_of(module: Module) -> Iterator[Key]:
    """What a module asks others for, by their names."""
    for node in walk(module.tree):
        match node:
            case ast.Attribute(ast.Name(alias), name) if alias in module.aliases:
                yield module.aliases[alias], name


class _Left:
    """A module's text without kernels. known: what these are called; asked: what is asked of
    modules by name, anywhere."""

    def __init__(
        self, text: str, module: Module, known: "Mapping[Key, str]", asked: "Collection[Key]"
    ) -> None:
        self._lines = text.splitlines(keepends=True)
        self._module = module
        self._known = known
        self._tree = ast.parse(text)
        self._kernels = [*forms.vipers(self._tree, methods=False)]
        others = [statement for statement in self._tree.body if statement not in self._kernels]
        self._used = {
            node.id
            for statement in others
            for node in walk(statement)
            if isinstance(node, ast.Name)
        } | {name for of, name in asked if of == module.name}

    def text(self) -> str:
        """What is left."""
        for kernel in self._kernels:
            key = (self._module.name, kernel.name)
            wanted = [(self._known[key], kernel.name)] if kernel.name in self._used else []
            self._replace(kernel.decorator_list[0], kernel, [], wanted)
        for node in walk(self._tree):
            if isinstance(node, ast.ImportFrom) and node.module:
                self._import(node, node.module)
            elif isinstance(node, ast.Import) and "micropython" not in self._used:
                left = [ast.Import([a]) for a in node.names if a.name != "micropython"]
                if len(left) < len(node.names):
                    self._replace(node, node, left, [])
        return "".join(self._lines)

    def _import(self, node: ast.ImportFrom, module: str) -> None:
        kernels = [a for a in node.names if (module, a.name) in self._known]
        if not kernels:
            return
        left = [a for a in node.names if a not in kernels]
        wanted = [
            (self._known[module, a.name], name)
            for a in kernels
            if (name := a.asname or a.name) in self._used
        ]
        self._replace(node, node, [ast.ImportFrom(module, left, 0)] if left else [], wanted)

    def _replace(
        self,
        first: "ast.expr | ast.stmt",
        last: ast.stmt,
        left: "list[ast.Import] | list[ast.ImportFrom]",
        wanted: "list[tuple[str, str]]",
    ) -> None:
        """Statements that stand alone on their lines: by imports, on the first of these."""
        names = [ast.alias(name, None if name == here else here) for name, here in wanted]
        made: list[ast.stmt] = [*left]
        if names:
            made.append(ast.ImportFrom(MODULE, names, 0))
        text = "; ".join(map(ast.unparse, made)) or "pass"
        begin, end = first.lineno - 1, (last.end_lineno or last.lineno) - 1
        indent = " " * last.col_offset
        self._lines[begin : end + 1] = [indent + text + "\n", *["\n"] * (end - begin)]
