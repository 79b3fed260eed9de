"""The first of two passes: replace constants of other modules by numbers, drop unused imports.

MicroPython's compiler replaces only a module's own constants whose names begin with an underscore.
A public constant costs 30 bytes of the board's memory and, wherever another module uses it, two
look-ups of 2 us. A viper function cannot use a number of another module at all. This pass
therefore writes the numbers in place of the names, and leaves out imports that are then unused. No
line moves, and CPython behaves the same without this pass.
"""

import ast
import copy
from collections.abc import Iterator, Mapping
from typing import NamedTuple

Constants = dict[str, int]
_Import = ast.Import | ast.ImportFrom


class _Module(NamedTuple):
    """A module's tree, and results that are needed repeatedly."""

    tree: ast.Module
    imports: list[_Import]
    stored: list[str]  # each name that is assigned, once per assignment


class _Edit(NamedTuple):
    """New text for a node."""

    node: ast.expr | ast.stmt
    text: str


def inline(sources: Mapping[str, str], keep: bool = False) -> dict[str, str]:
    """Replace public constants of all modules by numbers. Returns the modules by name.

    keep: the definitions stay, for programs that are not among these modules.
    """
    modules = {name: _read(text) for name, text in sources.items()}
    known: dict[str, Constants] = {name: {} for name in modules}
    while True:  # a constant may depend on another module's
        found = {name: _public(module, known) for name, module in modules.items()}
        if found == known:
            break
        known = found
    return {
        name: _apply(text, list(_edits(modules[name], known[name], known, keep)))
        for name, text in sources.items()
    }


def pruned(sources: Mapping[str, str]) -> dict[str, str]:
    """Return the modules, by name, without unused imports of const and of these modules."""
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
    """Yield module and name for each use of another module; module "" stands for any."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from ((node.module, alias.name) for alias in node.names)
        elif isinstance(node, ast.Attribute):
            yield "", node.attr


def _used(tree: ast.Module) -> Iterator[str]:
    """Yield the names that the code uses; not the const() calls that the compiler resolves."""
    found = (statement for statement in tree.body if isinstance(statement, ast.Assign))
    calls = (each.value for each in found if isinstance(each.value, ast.Call))
    consts = {call.func for call in calls if ast.unparse(call.func) == "const"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node not in consts:
            yield node.id


def _bound(alias: ast.alias) -> str:
    """Return the name that an import binds."""
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
    """Return the public constants that a module assigns exactly once."""
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
    """Return imported constants, and imported modules with their constants, by their local
    names."""
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
    """Return name and value of `NAME = const(value)`; ("", None) for other statements."""
    match statement:
        case ast.Assign([ast.Name(name)], ast.Call(ast.Name("const"), [value])):
            return name, value
    return "", None


def _evaluate(node: ast.expr, known: Constants, modules: Mapping[str, Constants]) -> int:
    """Evaluate an expression of integers; ValueError or KeyError if it is not one."""
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
    """Replaces `module.NAME` by its number; KeyError if it is not a constant."""

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
    """Return what remains of an import."""
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


def moved(text: str, names: Mapping[str, str]) -> str:
    """Return a module with its imports of modules replaced by those of other names.

    names: the new name of each module, and of each package from which modules are imported.
    """
    edits = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and (new := names.get(node.module or "")):
            edits.append(_Edit(node, ast.unparse(ast.ImportFrom(new, node.names, 0))))
    return _apply(text, edits)


def _apply(text: str, edits: list[_Edit]) -> str:
    """Apply edits from the end to the start, so that positions stay valid; keep the line count."""
    lines = text.splitlines(keepends=True)
    for edit in sorted(edits, key=lambda e: (e.node.lineno, e.node.col_offset), reverse=True):
        node = edit.node
        first, last = node.lineno - 1, (node.end_lineno or node.lineno) - 1
        head = lines[first].encode()[: node.col_offset].decode()
        tail = lines[last].encode()[node.end_col_offset :].decode()
        lines[first : last + 1] = [head + edit.text + tail, *["\n"] * (last - first)]
    return "".join(lines)
