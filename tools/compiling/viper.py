"""Viper functions of a module as syntax trees: a list of them, and what their names refer to."""

import ast
import copy
from collections.abc import Iterable, Iterator, Mapping

POINTERS = {"ptr8", "ptr16", "ptr32"}
CASTS = {"int", "uint", "bool", *POINTERS}

# Module and name of a function.
Key = tuple[str, str]

_SMALL_INT_LIMIT = 1 << 30  # a literal from here on is an object, unless it is written int(…)


def vipers(tree: ast.Module, methods: bool) -> Iterator[ast.FunctionDef]:
    """Yield a module's viper functions; with or without methods of its classes."""
    for node in tree.body:
        inside = node.body if methods and isinstance(node, ast.ClassDef) else [node]
        for function in inside:
            if isinstance(function, ast.FunctionDef) and is_viper(function):
                yield function


def is_viper(function: ast.FunctionDef) -> bool:
    """Return whether the function is compiled by viper."""
    return any(ast.unparse(each) == "micropython.viper" for each in function.decorator_list)


def local_names(function: ast.FunctionDef) -> set[str]:
    """Return the names of parameters and of all other locals."""
    nodes = list(ast.walk(function))
    stored = {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    return stored | {node.arg for node in nodes if isinstance(node, ast.arg)}


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
        self.functions = {f.name: f for f in vipers(self.tree, methods=False)}
        self.imported: dict[str, Key] = {}
        self.aliases: dict[str, str] = {}  # of modules
        numbers = {n: literal(v) for n, v in constants(self.tree).items()}
        for function in vipers(self.tree, methods=True):
            hidden = local_names(function)
            here = {n: v for n, v in numbers.items() if n not in hidden}
            function.body = renamed(function.body, here)
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                self.aliases.update((n.asname or n.name, n.name) for n in node.names)
            elif isinstance(node, ast.ImportFrom) and node.module:
                for n in node.names:
                    self.imported[n.asname or n.name] = (node.module, n.name)
                    self.aliases[n.asname or n.name] = f"{node.module}.{n.name}"

    def means(self, name: str) -> Key | None:
        """Return the function that a global name refers to, or may refer to if it is imported;
        else None."""
        return (self.name, name) if name in self.functions else self.imported.get(name)


# Constants


def constants(tree: ast.Module) -> dict[str, int]:
    """Return the constants that a module assigns exactly once, as `NAME = const(…)`."""
    values: dict[str, int] = {}
    for statement in tree.body:
        match statement:
            case ast.Assign([ast.Name(name)], ast.Call(ast.Name("const"), [value])):
                code = compile(ast.Expression(value), "", "eval")
                try:
                    number = eval(code, {"__builtins__": {}}, dict(values))
                except (NameError, TypeError):
                    continue
                if type(number) is int:
                    values[name] = number
    names = [
        n.id for n in ast.walk(tree) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)
    ]
    return {name: value for name, value in values.items() if names.count(name) == 1}


def literal(value: int) -> ast.expr:
    """Return a number in the form that viper accepts."""
    node: ast.expr = ast.Constant(abs(value))
    if value < 0:
        node = ast.UnaryOp(ast.USub(), node)
    if not -_SMALL_INT_LIMIT <= value < _SMALL_INT_LIMIT:
        node = ast.Call(ast.Name("int", ast.Load()), [node], [])
    return node


class _Renamed(ast.NodeTransformer):
    def __init__(self, names: Mapping[str, ast.expr]) -> None:
        self._names = names

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id not in self._names:
            return node
        new = copy.deepcopy(self._names[node.id])
        if isinstance(new, ast.Name):
            new.ctx = node.ctx
        return new


def renamed(statements: Iterable[ast.stmt], names: Mapping[str, ast.expr]) -> list[ast.stmt]:
    """Return a copy of statements in which some names are replaced by other names or by
    numbers."""
    change = _Renamed(names)
    return [change.visit(copy.deepcopy(statement)) for statement in statements]


# Types


def types(function: ast.FunctionDef) -> dict[str, str]:
    """Return the viper type of each local; the first assignment decides."""
    found = {a.arg: annotation(a.annotation) for a in function.args.args}
    _Stores(found).generic_visit(function)
    return found


class _Stores(ast.NodeVisitor):
    """Visits statements in the order of the source, as MicroPython's compiler does."""

    def __init__(self, found: dict[str, str]) -> None:
        self._found = found

    def visit_Assign(self, node: ast.Assign) -> None:
        for target in node.targets:
            if isinstance(target, ast.Name):
                self._found.setdefault(target.id, type_of(node.value, self._found))
            elif isinstance(target, ast.Tuple):
                names = (name.id for name in target.elts if isinstance(name, ast.Name))
                self._found.update(dict.fromkeys(names, "object") | self._found)

    def visit_For(self, node: ast.For) -> None:
        is_range = isinstance(node.iter, ast.Call) and annotation(node.iter.func) == "range"
        if isinstance(node.target, ast.Name):
            self._found.setdefault(node.target.id, "int" if is_range else "object")
        self.generic_visit(node)


def type_of(node: ast.expr, known: Mapping[str, str]) -> str:
    """Return the viper type of a value; "object" also if it cannot be determined."""
    match node:
        case ast.Constant(bool()) | ast.Compare() | ast.UnaryOp(ast.Not()):
            return "bool"
        case ast.Constant(int()):
            return "int"
        case ast.Name(name):
            return known.get(name, "object")
        case ast.Call(ast.Name(name)) if name in CASTS:
            return name
        case ast.Subscript(value) if type_of(value, known) in POINTERS:
            return "int"
        case ast.UnaryOp(_, value) | ast.IfExp(body=value):
            return type_of(value, known)
        case ast.BoolOp(values=[value, *others]):
            kinds = {type_of(other, known) for other in others}
            return kinds.pop() if kinds == {type_of(value, known)} else "object"
        case ast.BinOp(left, _, right) if type_of(left, known) == type_of(right, known) == "int":
            return "int"
    return "object"
