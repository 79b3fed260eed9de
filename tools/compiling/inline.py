"""The first of two passes: replace constants of other modules by numbers, drop unused imports.

MicroPython's compiler replaces only a module's own constants whose names begin with an underscore.
A public constant costs 30 bytes of the board's memory and, wherever another module uses it, two
look-ups of 2 us. A viper function cannot use a number of another module at all. This pass
therefore writes the numbers in place of the names, and leaves out imports that are then unused. No
line moves, and CPython behaves the same without this pass.
"""

import ast
from collections.abc import Iterable, Iterator, Mapping
from types import SimpleNamespace
from typing import NamedTuple

Constants = dict[str, int]
# What global names are: numbers, and modules with their constants.
Names = Mapping[str, "int | SimpleNamespace"]


class Edit(NamedTuple):
    """New text for a node."""

    node: ast.expr | ast.stmt
    text: str


def inline(sources: Mapping[str, str], keep: bool = False) -> dict[str, str]:
    """Replace public constants of all modules by numbers. Returns the modules by name.

    keep: definitions and imports stay, for programs that are not among these modules.
    """
    trees = {name: ast.parse(text) for name, text in sources.items()}
    known: dict[str, Constants] = {name: {} for name in trees}
    while True:  # a constant may depend on another module's: repeat until none is added
        found = {name: _public(tree, known) for name, tree in trees.items()}
        if found == known:
            break
        known = found
    inlined = {
        name: edited(text, _edits(trees[name], known[name], known, keep))
        for name, text in sources.items()
    }
    return inlined if keep else pruned(inlined)


def pruned(sources: Mapping[str, str], ours: Iterable[str] = ()) -> dict[str, str]:
    """Return the modules, by name, without unused imports of const and of these modules.

    ours: names of further modules whose unused imports are dropped.
    """
    trees = {name: ast.parse(text) for name, text in sources.items()}
    used_elsewhere = {key for tree in trees.values() for key in _names_of_others(tree)}
    may_be_dropped = {"micropython", *sources, *ours}
    result = {}
    for name, text in sources.items():
        # A name that another module takes from this one is used, too.
        used = {*_used(trees[name]), *(what for of, what in used_elsewhere if of == name)}
        edits = []
        for node in ast.walk(trees[name]):
            if isinstance(node, ast.Import | ast.ImportFrom) and _is_of(node, may_be_dropped):
                kept = [alias for alias in node.names if _bound(alias) in used]
                if len(kept) < len(node.names):
                    edits.append(Edit(node, imports(node, kept)))
        result[name] = edited(text, edits)
    return result


def imported(tree: ast.AST) -> Iterator[tuple[str, str, str]]:
    """Yield for each import the name that it gets there, the module, and the name in the module;
    "" if the module itself is imported."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((n.asname or n.name, n.name, "") for n in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            yield from ((n.asname or n.name, node.module, n.name) for n in node.names)


def _names_of_others(tree: ast.Module) -> Iterator[tuple[str, str]]:
    """Yield module and name for each name of another module that is imported, or used as
    `module.name`."""
    modules = {}  # by their names here; also what may be a module: `from base import ring`
    for here, module, name in imported(tree):
        modules[here] = f"{module}.{name}" if name else module
        yield module, name
    for node in ast.walk(tree):
        match node:
            case ast.Attribute(ast.Name(here), name) if here in modules:
                yield modules[here], name


def _used(tree: ast.Module) -> Iterator[str]:
    """Yield the names that the code uses or exports (`__all__`); not the const() calls that the
    compiler resolves."""
    assignments = [statement for statement in tree.body if isinstance(statement, ast.Assign)]
    for statement in assignments:
        if ast.unparse(statement.targets[0]) == "__all__":
            yield from ast.literal_eval(statement.value)
    calls = (each.value for each in assignments if isinstance(each.value, ast.Call))
    consts = {call.func for call in calls if ast.unparse(call.func) == "const"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node not in consts:
            yield node.id


def _bound(alias: ast.alias) -> str:
    """Return the name that an import binds."""
    return (alias.asname or alias.name).partition(".")[0]


def _is_of(node: ast.Import | ast.ImportFrom, modules: set[str]) -> bool:
    """Return whether all that is imported is of these modules."""
    if isinstance(node, ast.ImportFrom):
        return bool(modules & {node.module, *(f"{node.module}.{n.name}" for n in node.names)})
    return all(alias.name in modules for alias in node.names)


def constants(tree: ast.Module, names: Names) -> Constants:
    """Return the constants that a module assigns exactly once, as `NAME = const(…)`. names: those
    that it imports, which its own may be computed from."""
    known, found = dict(names), {}
    for statement in tree.body:
        name, value = _definition(statement)
        if value and (number := _number(value, known)) is not None:
            known[name] = found[name] = number
    assigned = _stored(tree)
    return {name: number for name, number in found.items() if assigned.count(name) == 1}


def _public(tree: ast.Module, known: Mapping[str, Constants]) -> Constants:
    found = constants(tree, _imported(tree, known))
    return {name: number for name, number in found.items() if name[0] != "_"}


def _imported(tree: ast.Module, known: Mapping[str, Constants]) -> Names:
    """Return what a module imports, by the names there: constants, and modules with their
    constants, so that `module.NAME` can be evaluated. known: the constants of all modules."""
    found: dict[str, int | SimpleNamespace] = {}
    for here, module, name in imported(tree):
        number = known.get(module, {}).get(name)
        if number is not None:
            found[here] = number
        else:  # a module, or anything else, which then has no constants
            as_module = f"{module}.{name}" if name else module
            found[here] = SimpleNamespace(**known.get(as_module, {}))
    return found


def _definition(statement: ast.stmt) -> tuple[str, ast.expr | None]:
    """Return name and value of `NAME = const(value)`; ("", None) for other statements."""
    match statement:
        case ast.Assign([ast.Name(name)], ast.Call(ast.Name("const"), [value])):
            return name, value
    return "", None


def _number(node: ast.expr, names: Names) -> int | None:
    """Return the value of an expression; None if it is not an integer, or has unknown names."""
    code = compile(ast.Expression(node), "", "eval")
    try:
        value = eval(code, {"__builtins__": {}}, dict(names))
    except (NameError, AttributeError, TypeError):
        return None
    return value if isinstance(value, int) else None


def _stored(tree: ast.Module) -> list[str]:
    """Return each name that is assigned, once per assignment."""
    names = (node for node in ast.walk(tree) if isinstance(node, ast.Name))
    return [node.id for node in names if isinstance(node.ctx, ast.Store)]


def _edits(
    tree: ast.Module, own: Constants, known: Mapping[str, Constants], keep: bool
) -> Iterator[Edit]:
    """Yield the edits that put numbers in place of a module's constants. own: its public ones;
    their definitions become `pass`, or with `keep` a number. known: those of all modules."""
    parameters = {n.arg for n in ast.walk(tree) if isinstance(n, ast.arg)}
    hidden = {*_stored(tree), *parameters}  # an imported name may mean something else somewhere
    names = {n: v for n, v in _imported(tree, known).items() if n not in hidden} | own
    for statement in tree.body:
        name, value = _definition(statement)
        if name in own and value:
            yield Edit(value, _literal(own[name])) if keep else Edit(statement, "pass")
        else:
            yield from _uses(statement, names)


def _uses(statement: ast.stmt, names: Names) -> Iterator[Edit]:
    """Yield an edit for each `NAME` or `module.NAME` that is a known constant."""
    for node in ast.walk(statement):
        number = None
        match node:
            case ast.Name(name, ast.Load()):
                number = names.get(name)
            case ast.Attribute(ast.Name(module), name, ast.Load()):
                number = getattr(names.get(module), name, None)
        if isinstance(node, ast.expr) and isinstance(number, int):
            yield Edit(node, _literal(number))


def _literal(value: int) -> str:
    return str(value) if value >= 0 else f"({value})"


def moved(text: str, names: Mapping[str, str]) -> str:
    """Return a module with its imports of modules replaced by those of other names.

    names: the new name of each module, and of each package from which modules are imported.
    """
    edits = []
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and (new := names.get(node.module or "")):
            edits.append(Edit(node, ast.unparse(ast.ImportFrom(new, node.names, 0))))
    return edited(text, edits)


def imports(node: ast.Import | ast.ImportFrom, names: list[ast.alias]) -> str:
    """Return an import with these names only; "pass" if there are none."""
    source = f"from {node.module} " if isinstance(node, ast.ImportFrom) else ""
    return f"{source}import {', '.join(map(ast.unparse, names))}" if names else "pass"


def edited(text: str, edits: Iterable[Edit]) -> str:
    """Apply edits from the end to the start, so that positions stay valid; keep the line count."""
    lines = text.splitlines(keepends=True)
    for edit in sorted(edits, key=lambda e: (e.node.lineno, e.node.col_offset), reverse=True):
        node = edit.node
        first, last = node.lineno - 1, (node.end_lineno or node.lineno) - 1
        # Columns are counted in bytes of UTF-8.
        before = lines[first].encode()[: node.col_offset].decode()
        after = lines[last].encode()[node.end_col_offset :].decode()
        lines[first : last + 1] = [before + edit.text + after, *["\n"] * (last - first)]
    return "".join(lines)
