"""Viper functions that call one another as machine code does, without MicroPython in between.

As compiled, each argument becomes an object for the call and a number again behind it, and so does
the result: 5 to 8 us on a Pico, a fifth of all that a line takes. So a function that others of
viper call is given two entries: in front, for everybody, one that takes objects, and behind that
its own, which takes an array of bare values and returns one. A call of it looks the function up
as before, and then goes to that second entry.

What is changed are the few sequences that the compiler writes for calls, arguments and results
(calling.py); where it has written another one, all stays as it is.
"""

import ast
from collections.abc import Mapping
from functools import lru_cache

from . import forms, mpy, thumb
from .calling import Divided, Entry, redirect
from .marks import Key
from .modules import Module
from .peephole import shortened, shorter
from .thumb import NotUnderstood


def linked(compiled: "Mapping[str, bytes]", texts: "Mapping[str, str]") -> "dict[str, bytes]":
    """The modules, by name: with such calls, and all code as short as can be."""
    program = _Program(compiled, {name: Module(name, texts[name]) for name in compiled})
    return {name: program.module(name) for name in compiled}


class _Program:
    """All modules, and which of their functions have two entries."""

    def __init__(self, compiled: "Mapping[str, bytes]", modules: "Mapping[str, Module]") -> None:
        self._compiled = compiled
        self._modules = modules
        self._entries: dict[Key, Entry] = {}
        called = _called(modules)
        for name, module in modules.items():
            code = mpy.vipers(compiled[name])
            for function, each in zip(module.functions, code, strict=True):
                if (name, function) in called and (entry := _entry(each)):
                    self._entries[name, function] = entry

    def module(self, name: str) -> bytes:
        """One of them, rewritten."""
        module, functions = self._modules[name], list(self._modules[name].functions)
        meant = map(module.means, mpy.names(self._compiled[name]))
        entries = tuple(self._entries.get(key) if key else None for key in meant)

        def rewrite(code: bytes, place: int) -> bytes:
            has_two = place != mpy.APART and (name, functions[place]) in self._entries
            return _rewritten(code, entries, has_two)

        return mpy.rewritten(self._compiled[name], rewrite)


# Kept from build to build: boards have most functions in common.


@lru_cache(1024)
def _entry(code: bytes) -> "Entry | None":
    """The second entry that a function can have."""
    try:
        divided = Divided(code)
        shortened(divided.ops)  # or it could not be written
    except NotUnderstood:
        return None
    return divided.entry


@lru_cache(4096)
def _rewritten(code: bytes, entries: "tuple[Entry | None, ...]", has_two: bool) -> bytes:
    """A function's code. entries: of what it may call, by the numbers of names; has_two: it is to
    have a second one itself."""
    if has_two:
        divided = Divided(code)
        redirect(divided.ops, entries.__getitem__)
        return divided.front + shortened(divided.ops)
    try:
        ops = thumb.read(code)
        return shortened(ops) if redirect(ops, entries.__getitem__) else shorter(code)
    except NotUnderstood:
        return code


def _called(modules: "Mapping[str, Module]") -> "set[Key]":
    """Functions that others of viper call, whose result is an integer, and that are never set to
    something else."""
    found: set[Key] = set()
    for module in modules.values():
        for caller in forms.vipers(module.tree, methods=True):
            for node in ast.walk(caller):
                if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
                    found.add(module.means(node.func.id) or ("", ""))
    set_elsewhere = {key for module in modules.values() for key in _set_in(module)}
    return {
        (name, function)
        for name, module in modules.items()
        for function, tree in module.functions.items()
        if forms.annotation(tree.returns) == "int"
    } & (found - set_elsewhere)


def _set_in(module: Module) -> "list[Key]":
    """Names that a module sets: its own, and those of modules that it has imported."""
    found: list[Key] = []
    for node in ast.walk(module.tree):
        match node:
            case ast.Global(names):
                found += [(module.name, name) for name in names]
            case ast.Attribute(ast.Name(alias), name, ast.Store() | ast.Del()):
                found.append((module.aliases.get(alias, ""), name))
    top = [n for n in module.tree.body if not isinstance(n, ast.FunctionDef | ast.ClassDef)]
    stored = set[str]().union(*map(forms.stored, top))
    return found + [(module.name, name) for name in stored]
