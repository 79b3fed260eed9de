"""The second of two passes: kernels, a module's viper functions, as separate machine code.

If there is machine code for the board's processor (machine_code.py), the functions are removed
from their modules, and each module that uses one imports it. Kernels of modules that every board
of the chip has are in one piece, `kernels.core`. Those of each other module are in a piece of
their own, so that a board has no kernel that it does not use. Lines keep their numbers.
"""

import ast
from collections.abc import Collection, Mapping
from typing import NamedTuple

from . import machine_code, mpy, viper
from .inline import Edit, edited, imported, imports, pruned
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
    """Separate kernels from the rest. texts: of all modules, by name. core: names of the modules
    that every board has. NotForC if a kernel has a form that cannot be translated.

    A kernel that only other kernels call gets no name in Python: it is in the C text alone.
    """
    modules = {name: Module(name, text) for name, text in texts.items()}
    keys = [(name, function) for name, module in modules.items() for function in module.functions]
    homes = {name: _home(name, core) for name, module in modules.items() if module.functions}
    without_kernels = {name: _without(text, modules, name, homes) for name, text in texts.items()}
    # Without imports that only kernels needed; the others show which kernels Python code uses.
    left = pruned(without_kernels, homes.values())
    trees = map(ast.parse, left.values())
    exported = {(home, name) for tree in trees for _, home, name in imported(tree)}
    pieces: dict[str, list[Key]] = {}
    for module, name in sorted(keys, key=lambda key: key[1]):
        if (homes[module], name) in exported:
            pieces.setdefault(homes[module], []).append((module, name))
    for home, piece in pieces.items():
        left[home] = _TEXT.format(names=", ".join(name for _, name in piece))
    return Apart(left, machine_code.in_c(modules, keys), pieces)


def with_code(compiled: bytes, name: str, apart: Apart, arch: str) -> bytes:
    """Return a compiled module of kernels with their machine code in it. CompilerError."""
    code = machine_code.linked(apart.c, arch, tuple(apart.pieces[name]))
    return mpy.rewritten(compiled, lambda _start: code)


def _home(module: str, core: "Collection[str]") -> str:
    """Return the name of the module of kernels that gets the kernels of this module."""
    return _CORE if module in core else f"{PACKAGE}.{module.replace('.', '_')}"


def _without(
    text: str, modules: "Mapping[str, Module]", name: str, homes: "Mapping[str, str]"
) -> str:
    """Return the text of the module `name` with imports in place of its kernels, and in place of
    its imports of other modules' kernels. modules: all, by name. homes: the module of kernels for
    each module that has some."""

    def import_of(source: str, kernels: "list[ast.alias]") -> str:
        """Return an import of kernels that were defined in the module `source`."""
        return ast.unparse(ast.ImportFrom(homes[source], kernels, 0))

    tree = ast.parse(text)
    edits = []
    for kernel in viper.vipers(tree):
        kernel.lineno = kernel.decorator_list[0].lineno  # the decorator goes, too
        edits.append(Edit(kernel, import_of(name, [ast.alias(kernel.name)])))
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module and node.module in homes:
            kernels = [a for a in node.names if a.name in modules[node.module].functions]
            others = [a for a in node.names if a not in kernels]
            statements = [imports(node, others)] if others else []
            statements += [import_of(node.module, kernels)] if kernels else []
            edits.append(Edit(node, "; ".join(statements)))
    return edited(text, edits)
