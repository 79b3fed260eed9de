"""What names there are in a module's source, and what they stand for."""

import ast
import re
from collections.abc import Collection, Iterable, Iterator

# Packages of which a board has a module or two, or none.
ON_REQUEST = ("extras",)
# Modules that few boards have, of packages which all have.
_SELDOM = (
    *("ports.driver_wire", "ports.storage.job_files", "ports.storage.sd_blocks"),
    *("ports.storage.sd_card", "ports.storage.user_files"),
)
_SELDOM_PACKAGES = ("ports.net.",)
# Who calls this with the name of a module lets go of it: merged with others that are needed, it
# would stay in memory.
FORGET = "forget"
_NAME = re.compile(r"[\w.]+")
_SCOPES = (ast.FunctionDef, ast.ClassDef, ast.Lambda, ast.comprehension)


class _Branches(dict[type[ast.AST], tuple[str, ...]]):
    """Where a node of a kind has others, by the kind; but for contexts, of which there are many:
    whether a name is read or made something."""

    def __missing__(self, kind: type[ast.AST]) -> tuple[str, ...]:
        scalar = kind in (ast.Name, ast.Constant)
        self[kind] = () if scalar else tuple(name for name in kind._fields if name != "ctx")
        return self[kind]


_BRANCHES = _Branches()


def children(node: ast.AST) -> list[ast.AST]:
    """What stands right below a node, as ast.iter_child_nodes() has it but for contexts."""
    return _below([node])


def walk(node: ast.AST) -> list[ast.AST]:
    """A node and all below it, as ast.walk() has them but for contexts, in a third of its time:
    half of what it takes to prepare the firmware is to look through trees."""
    found, level = [node], [node]
    while level:
        level = _below(level)
        found += level
    return found


def _below(nodes: list[ast.AST]) -> list[ast.AST]:
    found: list[ast.AST] = []
    for each in nodes:
        values = each.__dict__
        for name in _BRANCHES[type(each)]:
            value = values.get(name)
            if isinstance(value, list):
                found += [part for part in value if isinstance(part, ast.AST)]
            elif isinstance(value, ast.AST):
                found.append(value)
    return found


def is_common(module: str) -> bool:
    """Most boards have this module."""
    seldom = module in _SELDOM or module.startswith(_SELDOM_PACKAGES)
    return module.partition(".")[0] not in ON_REQUEST and not seldom


def root(node: ast.expr) -> str:
    """`a` of `a.b().c[d]`; an empty text where there is no name."""
    while isinstance(node, ast.Attribute | ast.Subscript | ast.Call):
        node = node.func if isinstance(node, ast.Call) else node.value
    return node.id if isinstance(node, ast.Name) else ""


def texts(tree: ast.AST) -> Iterator[ast.Constant]:
    """Every text that is no documentation and no annotation."""
    other: set[ast.AST] = set()
    for node in walk(tree):
        if isinstance(node, ast.Expr):
            other.add(node.value)
        for part in (getattr(node, "annotation", None), getattr(node, "returns", None)):
            other |= set(walk(part)) if part else set()
    for node in walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in other:
            yield node


def asked_by_text(tree: ast.AST) -> Iterator[str]:
    """Names in getattr(…, "name") and its like."""
    for node in walk(tree):
        match node:
            case ast.Call(ast.Name(function), [_, ast.Constant(str(name)), *_]):
                if function in ("getattr", "setattr", "hasattr", "delattr"):
                    yield name


def named_in_calls(tree: ast.AST, function: str) -> Iterator[str]:
    """Texts that a function or method of that name is called with, alone."""
    for node in walk(tree):
        match node:
            case ast.Call(ast.Name(call) | ast.Attribute(_, call), [ast.Constant(str(text))]):
                if call == function:
                    yield text


def imports(tree: ast.AST) -> Iterator[str]:
    """Names that imports make."""
    for node in walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield from ((alias.asname or alias.name).partition(".")[0] for alias in node.names)


def public(tree: ast.Module) -> Iterator[str]:
    """Variables of a module that others may ask for."""
    imported = set(imports(tree))
    return (name for name in variables(tree) if name[0] != "_" and name not in imported)


def variables(tree: ast.Module) -> Iterator[str]:
    """What the statements of a module make, functions and classes aside."""
    for statement in tree.body:
        if not isinstance(statement, ast.FunctionDef | ast.ClassDef):
            yield from bound(statement)


def fields(node: ast.ClassDef) -> Iterator[str]:
    """Attributes that a class has in its own body."""
    for statement in node.body:
        match statement:
            case ast.Assign([ast.Name(name)]) | ast.AnnAssign(ast.Name(name)):
                yield name


def private_methods(node: ast.ClassDef, kept: Collection[str] = ()) -> Iterator[ast.FunctionDef]:
    """Methods with a name that nobody outside has a use for. kept: how others begin."""
    for statement in node.body:
        if isinstance(statement, ast.FunctionDef) and re.match("_(?!_)", statement.name):
            if not statement.name.startswith(tuple(kept)):
                yield statement


def loaded(node: ast.ClassDef) -> set[str]:
    """What the body of a class, outside of its functions, makes of names."""
    found: set[str] = set()
    for statement in node.body:
        match statement:
            case ast.FunctionDef() | ast.ClassDef():
                parts: Iterable[ast.AST] = statement.decorator_list
            case ast.Assign([ast.Name()], value) | ast.AnnAssign(ast.Name(), value=value):
                parts = [value] if value else []
            case ast.Expr(ast.Constant()):
                parts = []
            case _:
                parts = [statement]
        found |= {n.id for part in parts for n in walk(part) if isinstance(n, ast.Name)}
    return found


def attributes(tree: ast.Module) -> Iterator[str]:
    """What objects are asked for, and given."""
    for node in walk(tree):
        if isinstance(node, ast.Attribute):
            yield node.attr


def asked_of_strangers(tree: ast.Module, ours: Collection[str]) -> Iterator[str]:
    """`sha1` and `digest` of `hashlib.sha1(key).digest()`: attributes, as often as they are there,
    that are only read, of modules which are none of ours and are called nothing else."""
    names: set[str] = set()
    others: set[str] = set()
    for statement in tree.body:
        if isinstance(statement, ast.Import):
            names |= set(imports(statement))
        else:
            others |= set(bound(statement))
    names -= {*ours, *others}
    for node in walk(tree):
        match node:
            case ast.Attribute(value, name, ast.Load()) if root(value) in names:
                yield name


def identifiers(tree: ast.AST) -> Iterator[str]:
    """Every name there is, and texts that may be one: of a single word, or with dots."""
    for node in walk(tree):
        if isinstance(node, ast.Constant) and not _NAME.fullmatch(str(node.value)):
            continue
        for _, value in ast.iter_fields(node):
            for part in value if isinstance(value, list) else (value,):
                if isinstance(part, str):
                    yield from re.findall(r"\w+", part)


def bound(tree: ast.AST) -> Iterator[str]:
    """Every name that is made something, wherever below a node."""
    for node in walk(tree):
        match node:
            case ast.Name(name, ast.Store() | ast.Del()):
                yield name
            case ast.arg(name) | ast.FunctionDef(name) | ast.ClassDef(name):
                yield name
        yield from _otherwise(node)


def inside(tree: ast.Module) -> Iterator[str]:
    """Names that are, anywhere in a module, not only the module's own."""
    for statement in tree.body:
        if not isinstance(statement, ast.Import | ast.ImportFrom):
            yield from inner(statement)


def inner(tree: ast.AST) -> Iterator[str]:
    """Names that are bound in what may be a scope of its own, or otherwise than by `=`."""
    outside = [tree]
    for node in outside:
        if isinstance(node, _SCOPES):
            yield from bound(node)
        else:
            yield from _otherwise(node)
            outside += children(node)


def _otherwise(node: ast.AST) -> Iterator[str]:
    match node:
        case ast.ExceptHandler(name=str(name)):
            yield name
        case ast.Global(names) | ast.Nonlocal(names):
            yield from names
        case ast.Import() | ast.ImportFrom():
            yield from imports(node)


def constants(tree: ast.Module) -> Iterator[str]:
    """`NAME = const(value)`."""
    for statement in tree.body:
        match statement:
            case ast.Assign([ast.Name(name)], ast.Call(ast.Name("const"))):
                yield name
