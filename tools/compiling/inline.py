"""The first of two passes: constants of other modules in place, and imports in vain gone.

MicroPython's compiler puts a module's own constants in place, for names that begin with an
underscore. A public constant costs 30 bytes of the board's memory and, wherever another module
uses it, two look-ups of 2 us; a viper function cannot take a number from there at all. So this
writes the numbers where the names were, and leaves out what nobody imports for anything else then.
No line moves, and CPython does the same without it.
"""

import ast
import copy
from collections.abc import Iterator, Mapping
from typing import NamedTuple

Constants = dict[str, int]
_Import = ast.Import | ast.ImportFrom


class _Module(NamedTuple):
    """A module's tree, and what is wanted of it again and again."""

    tree: ast.Module
    imports: list[_Import]
    stored: list[str]  # every name that is given a value, as often as it is


class _Edit(NamedTuple):
    """Text to put in place of a node's."""

    node: ast.expr | ast.stmt
    text: str


def inline(sources: Mapping[str, str], keep: bool = False) -> dict[str, str]:
    """The modules, by name, with each other's public constants in place. keep: they stay where
    they are defined, too, for programs that are not among these modules."""
    modules = {name: _read(text) for name, text in sources.items()}
    known: dict[str, Constants] = {name: {} for name in modules}
    while True:  # a constant may be made of another module's
        found = {name: _public(module, known) for name, module in modules.items()}
        if found == known:
            break
        known = found
    return {
        name: _apply(text, list(_edits(modules[name], known[name], known, keep)))
        for name, text in sources.items()
    }


def pruned(sources: Mapping[str, str]) -> dict[str, str]:
    """The modules, by name, without imports of ours, and of const, that none of them uses."""
    trees = {name: ast.parse(text) for name, text in sources.items()}
    asked = {key for tree in trees.values() for key in _asked(tree)}
    found = {}
    for name, text in sources.items():
        used = {*_used(trees[name]), *(what for module, what in asked if module in (name, ""))}
        edits = []
        for node in ast.walk(trees[name]):
            if isinstance(node, _Import) and _is_ours(node, sources):
                gone = [alias for alias in node.names if _bound(alias) not in used]
                edits += [_Edit(node, _import(node, gone))] if gone else []
        found[name] = _apply(text, edits)
    return found


def _asked(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Module, or an empty text for any, and what it is asked for."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from ((node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Attribute):
            yield "", node.attr


def _used(tree: ast.Module) -> Iterator[str]:
    """Names that the code asks for; const() where the compiler does not see to it."""
    found = (statement for statement in tree.body if isinstance(statement, ast.Assign))
    calls = (each.value for each in found if isinstance(each.value, ast.Call))
    consts = {call.func for call in calls if ast.unparse(call.func) == "const"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node not in consts:
            yield node.id


def _bound(alias: ast.alias) -> str:
    """The name that an import makes."""
    return (alias.asname or alias.name).partition(".")[0]


def _is_ours(node: _Import, sources: Mapping[str, str]) -> bool:
    if isinstance(node, ast.ImportFrom):
        known = (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))
        return node.module == "micropython" or any(name in sources for name in known)
    return all(alias.name in sources for alias in node.names)


def _read(text: str) -> _Module:
    tree = ast.parse(text)
    imports = [node for node in ast.walk(tree) if isinstance(node, _Import)]
    return _Module(tree, imports, [node.id for node in _names(tree, ast.Store)])


def _public(module: _Module, known: Mapping[str, Constants]) -> Constants:
    """Constants that a module defines, once and for all, for others too."""
    own: Constants = {}
    values, modules = _imported(module, known)
    for statement in module.tree.body:
        name, value = _definition(statement)
        if name and value is not None:
            try:
                own[name] = values[name] = _evaluate(value, values, modules)
            except (KeyError, ValueError):
                continue
    return {n: v for n, v in own.items() if n[0] != "_" and module.stored.count(n) == 1}


def _imported(
    module: _Module, known: Mapping[str, Constants]
) -> tuple[Constants, dict[str, Constants]]:
    """Constants, and modules with constants, by the names that a module imports them under."""
    names: Constants = {}
    modules: dict[str, Constants] = {}
    for node in module.imports:
        if isinstance(node, ast.Import):
            modules.update((n.asname or n.name, known.get(n.name, {})) for n in node.names)
        elif node.module:
            constants = known.get(node.module, {})
            for n in node.names:
                modules[n.asname or n.name] = known.get(f"{node.module}.{n.name}", {})
                if n.name in constants:
                    names[n.asname or n.name] = constants[n.name]
    return names, modules


def _definition(statement: ast.stmt) -> tuple[str, ast.expr | None]:
    """Name and value of `NAME = const(value)`."""
    match statement:
        case ast.Assign([ast.Name(name)], ast.Call(ast.Name("const"), [value])):
            return name, value
    return "", None


def _evaluate(node: ast.expr, known: Constants, modules: Mapping[str, Constants]) -> int:
    """An integer out of integers; ValueError or KeyError where it is not."""
    node = _WithoutModules(modules).visit(copy.deepcopy(node))
    for name in _names(node, ast.Load):
        known[name.id]
    if any(isinstance(part, ast.Call | ast.Attribute | ast.Subscript) for part in ast.walk(node)):
        raise ValueError
    expression = ast.fix_missing_locations(ast.Expression(node))
    value = eval(compile(expression, "", "eval"), {"__builtins__": {}}, dict(known))
    if type(value) is not int:
        raise ValueError
    return value


class _WithoutModules(ast.NodeTransformer):
    """Numbers in place of `module.NAME`; KeyError where that is no constant."""

    def __init__(self, modules: Mapping[str, Constants]) -> None:
        self._modules = modules

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        if isinstance(node.value, ast.Name):
            return ast.Constant(self._modules[node.value.id][node.attr])
        return node


def _names(tree: ast.AST, context: type[ast.expr_context]) -> Iterator[ast.Name]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, context):
            yield node


def _edits(
    module: _Module, own: Constants, known: Mapping[str, Constants], keep: bool
) -> Iterator[_Edit]:
    tree = module.tree
    stored = {*module.stored, *(node.arg for node in ast.walk(tree) if isinstance(node, ast.arg))}
    names, modules = _imported(module, known)
    here = own | {n: v for n, v in names.items() if n not in stored}
    for node in module.imports:
        if isinstance(node, ast.ImportFrom) and node.module:
            gone = [n for n in node.names if _is_gone(n, known.get(node.module, {}), stored)]
            if gone:
                yield _Edit(node, _import(node, gone))
    for statement in tree.body:
        name, value = _definition(statement)
        if name in own and value is not None:
            yield _Edit(value, _literal(own[name])) if keep else _Edit(statement, "pass")
    seen = {alias: constants for alias, constants in modules.items() if alias not in stored}
    yield from _uses(tree, here, seen)


def _is_gone(name: ast.alias, constants: Constants, stored: set[str]) -> bool:
    return name.name in constants and name.name not in stored


def _import(node: _Import, gone: list[ast.alias]) -> str:
    """What is left of an import."""
    left = ", ".join(ast.unparse(alias) for alias in node.names if alias not in gone)
    if not left:
        return "pass"
    source = f"from {node.module} " if isinstance(node, ast.ImportFrom) else ""
    return f"{source}import {left}"


def _uses(tree: ast.Module, here: Constants, modules: Mapping[str, Constants]) -> Iterator[_Edit]:
    inside = set()
    for statement in tree.body:
        if _definition(statement)[0] in here:
            inside |= set(ast.walk(statement))
    for node in ast.walk(tree):
        if node in inside:
            continue
        match node:
            case ast.Name(name, ast.Load()) if name in here:
                yield _Edit(node, _literal(here[name]))
            case ast.Attribute(ast.Name(module), name, ast.Load()):
                if name in modules.get(module, {}):
                    yield _Edit(node, _literal(modules[module][name]))


def _literal(value: int) -> str:
    return str(value) if value >= 0 else f"({value})"


def _apply(text: str, edits: list[_Edit]) -> str:
    """Replace from the end on, so that places stay true; keep the number of lines."""
    lines = text.splitlines(keepends=True)
    for edit in sorted(edits, key=lambda e: (e.node.lineno, e.node.col_offset), reverse=True):
        node = edit.node
        first, last = node.lineno - 1, (node.end_lineno or node.lineno) - 1
        head = lines[first].encode()[: node.col_offset].decode()
        tail = lines[last].encode()[node.end_col_offset :].decode()
        lines[first : last + 1] = [head + edit.text + tail, *["\n"] * (last - first)]
    return "".join(lines)
