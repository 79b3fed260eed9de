"""Viper functions of a module as syntax trees: a list of them, and what their names refer to."""

import ast
from collections import ChainMap
from collections.abc import Iterable, Iterator, Mapping, MutableMapping

from .inline import constants, imported

BITS = {"ptr8": 8, "ptr16": 16, "ptr32": 32}  # by pointer type
CASTS = {"int", "uint", "bool", *BITS}

# Module and name of a function.
Key = tuple[str, str]


def vipers(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    """Yield the functions of a module that viper compiles, without methods of its classes."""
    for node in tree.body:
        if isinstance(node, ast.FunctionDef):
            if "micropython.viper" in map(ast.unparse, node.decorator_list):
                yield node


def annotation(node: ast.expr | None) -> str:
    """Return an annotation as text; "object" if there is none."""
    return ast.unparse(node) if node else "object"


def body(function: ast.FunctionDef) -> list[ast.stmt]:
    """Return the function's statements without its docstring."""
    first = function.body[0]
    documented = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    return function.body[1 if documented else 0 :]


class Module:
    """A module, and what its names refer to."""

    def __init__(self, name: str, text: str) -> None:
        self.name = name
        self.tree = ast.parse(text)
        self.functions = {f.name: f for f in vipers(self.tree)}
        self.numbers = constants(self.tree, names={})  # computed from no imported ones
        # An imported name here: the module that defines it, and its name there.
        self.imported = {here: (module, there) for here, module, there in imported(self.tree)}

    def means(self, name: str) -> Key | None:
        """Return the function that a global name refers to, or may refer to if it is imported;
        else None."""
        return (self.name, name) if name in self.functions else self.imported.get(name)


# Types


def types(function: ast.FunctionDef, numbers: Iterable[str]) -> dict[str, str]:
    """Return the viper type of each local; the first assignment decides. numbers: constants."""
    found = {a.arg: annotation(a.annotation) for a in function.args.args}
    _Stores(ChainMap(found, dict.fromkeys(numbers, "int"))).generic_visit(function)
    return found


class _Stores(ast.NodeVisitor):
    """Adds the type of each local that a statement assigns to `found`, unless it has one already.
    Statements come in the order of the source, as in MicroPython's compiler."""

    def __init__(self, found: MutableMapping[str, str]) -> None:
        self._found = found

    def visit_Assign(self, node: ast.Assign) -> None:
        for target in node.targets:
            if isinstance(target, ast.Name):
                self._found.setdefault(target.id, type_of(node.value, self._found))
            elif isinstance(target, ast.Tuple):
                for name in target.elts:
                    if isinstance(name, ast.Name):
                        self._found.setdefault(name.id, "object")

    def visit_For(self, node: ast.For) -> None:
        is_range = isinstance(node.iter, ast.Call) and annotation(node.iter.func) == "range"
        if isinstance(node.target, ast.Name):
            self._found.setdefault(node.target.id, "int" if is_range else "object")
        self.generic_visit(node)


def type_of(node: ast.expr, known: Mapping[str, str]) -> str:
    """Return the viper type of a value; "object" also if it cannot be determined. known: the types
    of names."""
    match node:
        case ast.Constant(bool()) | ast.Compare() | ast.UnaryOp(ast.Not()):
            return "bool"
        case ast.Constant(int()):
            return "int"
        case ast.Name(name):
            return known.get(name, "object")
        case ast.Call(ast.Name(name)) if name in CASTS:
            return name
        case ast.Subscript(value) if type_of(value, known) in BITS:
            return "int"
        case ast.UnaryOp(_, value) | ast.IfExp(body=value):
            return type_of(value, known)
        case ast.BoolOp(values=[value, *others]):
            kinds = {type_of(other, known) for other in others}
            return kinds.pop() if kinds == {type_of(value, known)} else "object"
        case ast.BinOp(left, _, right) if type_of(left, known) == type_of(right, known) == "int":
            return "int"
    return "object"
