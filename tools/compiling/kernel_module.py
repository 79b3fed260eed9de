"""The second of two passes: kernels, a module's viper functions, as separate machine code.

If there is machine code for the board's processor (machine_code.py), the functions are removed
from their modules, and each module that uses one imports it. Kernels of modules that every board
of the chip has are in one piece, `kernels.core`. Those of each other module are in a piece of
their own, so that a board has no kernel that it does not use. Lines keep their numbers.
"""

import ast
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

from . import machine_code, mpy, viper
from .inline import Edit, edited, imports, pruned
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
    kernels = {key: (_home(key[0], core), name) for key, name in _names(keys).items()}
    homes = {home for home, _ in kernels.values()}
    made = pruned({name: _without(text, modules[name], kernels) for name, text in texts.items()}, homes)
    asked = {key for text in made.values() for key in _imported(text)}
    pieces: dict[str, list[Key]] = {}
    for key, (home, name) in sorted(kernels.items(), key=lambda item: item[1][1]):
        if (home, name) in asked:
            pieces.setdefault(home, []).append(key)
    for home, there in pieces.items():
        made[home] = _TEXT.format(names=", ".join(kernels[key][1] for key in there))
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


def _imported(text: str) -> Iterator[Key]:
    """Yield module and name of each import."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from ((node.module, alias.name) for alias in node.names)


def _without(text: str, module: Module, kernels: "Mapping[Key, Key]") -> str:
    """Return a module's text with imports in place of its kernels. kernels: the module of kernels
    each one is in, and its name there."""
    tree = ast.parse(text)
    edits = []
    for kernel in viper.vipers(tree):
        kernel.lineno = kernel.decorator_list[0].lineno  # the decorator goes, too
        edits.append(Edit(kernel, _import([(kernels[module.name, kernel.name], kernel.name)])))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            ours = {a: kernels[node.module, a.name] for a in node.names if (node.module, a.name) in kernels}
            if ours:
                left = [a for a in node.names if a not in ours]
                asked = _import([(there, a.asname or a.name) for a, there in ours.items()])
                edits.append(Edit(node, f"{imports(node, left)}; {asked}" if left else asked))
    return edited(text, edits)


def _import(asked: "Sequence[tuple[Key, str]]") -> str:
    """Return imports of kernels, each under the name that it has in the importing module."""
    by_home: dict[str, list[ast.alias]] = {}
    for (home, name), here in asked:
        by_home.setdefault(home, []).append(ast.alias(name, None if name == here else here))
    return "; ".join(ast.unparse(ast.ImportFrom(home, names, 0)) for home, names in by_home.items())
