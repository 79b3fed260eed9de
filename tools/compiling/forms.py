"""Forms of viper functions, for leaves.py: what can be put in place, and how it is rewritten."""

import ast
import copy
from collections.abc import Callable, Iterable, Iterator, Mapping

# What becomes of a value that a leaf returns.
End = Callable[[ast.expr], list[ast.stmt]]

POINTERS = {"ptr8", "ptr16", "ptr32"}
CASTS = {"int", "uint", "bool", *POINTERS}
BUILT_IN = {"range", *CASTS}
# Between the name of a leaf and that of its local; no name of the sources has it.
MARK = "__"

_SMALL_INT_LIMIT = 1 << 30  # literals from there on are objects, unless written int(…)
_STATEMENTS = (
    *(ast.Assign, ast.AugAssign, ast.Expr, ast.Return, ast.Pass),
    *(ast.If, ast.For, ast.While, ast.Break, ast.Continue, ast.Try),
)
_EXPRESSIONS = (
    *(ast.Name, ast.Constant, ast.BinOp, ast.UnaryOp, ast.Compare, ast.BoolOp, ast.IfExp),
    *(ast.Call, ast.Subscript, ast.Attribute),
)


def vipers(tree: ast.Module, methods: bool) -> Iterator[ast.FunctionDef]:
    """A module's viper functions; with methods of its classes, or without."""
    for node in tree.body:
        inside = node.body if methods and isinstance(node, ast.ClassDef) else [node]
        for function in inside:
            if isinstance(function, ast.FunctionDef) and is_viper(function):
                yield function


def is_viper(function: ast.FunctionDef) -> bool:
    """Whether it is compiled to the processor's own code."""
    return any(ast.unparse(each) == "micropython.viper" for each in function.decorator_list)


def stored(node: ast.AST) -> set[str]:
    """Names that are stored to."""
    return {
        part.id
        for part in ast.walk(node)
        if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store)
    }


def local_names(function: ast.FunctionDef) -> set[str]:
    """Parameters and all else that is stored to."""
    return stored(function) | {
        node.arg for node in ast.walk(function) if isinstance(node, ast.arg)
    }


def is_plain(function: ast.FunctionDef) -> bool:
    """Whether everything in it is understood here. So a caller has to be."""
    return all(
        isinstance(node, (*_STATEMENTS, *_EXPRESSIONS))
        for statement in function.body
        for node in ast.walk(statement)
        if isinstance(node, ast.stmt | ast.expr | ast.comprehension | ast.keyword)
    ) and not any(MARK in name for name in local_names(function))


def is_leaf(function: ast.FunctionDef) -> bool:
    """Whether it may stand in place of its calls: numbers and pointers in, a number out."""
    arguments = function.args
    return (
        is_plain(function)
        and not any(isinstance(node, ast.Try) for node in ast.walk(function))
        and always_returns(function.body)
        and annotation(function.returns) == "int"
        and all(annotation(a.annotation) in {"int", "uint", *POINTERS} for a in arguments.args)
        and not (arguments.vararg or arguments.kwarg or arguments.kwonlyargs or arguments.defaults)
    )


def annotation(node: ast.expr | None) -> str:
    """A viper type as written."""
    return ast.unparse(node) if node else "object"


def body(function: ast.FunctionDef) -> list[ast.stmt]:
    """Its statements, without what documents them."""
    first = function.body[0]
    documented = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    return function.body[1 if documented else 0 :]


def size(function: ast.FunctionDef) -> int:
    """Nodes of its syntax tree: about two make an instruction."""
    return sum(
        isinstance(node, ast.stmt | ast.expr)
        for statement in body(function)
        for node in ast.walk(statement)
    )


def touches(node: ast.AST) -> bool:
    """Whether a node by itself looks at memory, or may change it."""
    match node:
        case ast.Subscript(ctx=ast.Load()) | ast.Attribute():
            return True
        case ast.Call(ast.Name(name)):
            return name not in BUILT_IN
        case ast.Call():
            return True
    return False


def is_pure(function: ast.FunctionDef) -> bool:
    """Whether its result depends on its arguments only, and is all there is to it."""
    return not any(
        touches(node) or isinstance(node, ast.Subscript)
        for statement in body(function)
        for node in ast.walk(statement)
    )


# Constants


def constants(tree: ast.Module) -> dict[str, int]:
    """What a module defines as `NAME = const(…)`, once and for all."""
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
    """A number, as viper wants it written."""
    node: ast.expr = ast.Constant(abs(value))
    if value < 0:
        node = ast.UnaryOp(ast.USub(), node)
    if not -_SMALL_INT_LIMIT <= value < _SMALL_INT_LIMIT:
        node = ast.Call(ast.Name("int", ast.Load()), [node], [])
    return node


# Names


def free_names(function: ast.FunctionDef) -> set[str]:
    """Global names in it."""
    used = {n.id for s in function.body for n in ast.walk(s) if isinstance(n, ast.Name)}
    return used - local_names(function) - BUILT_IN


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
    """A copy with other names, or numbers, for some names."""
    change = _Renamed(names)
    return [change.visit(copy.deepcopy(statement)) for statement in statements]


# Types


def types(function: ast.FunctionDef) -> dict[str, str]:
    """The viper type of each local: that of what is stored to it first."""
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
    """The viper type of a value; "object" too where it cannot be told."""
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


# Returns


class Refused(Exception):
    """A function cannot be put in place."""


def returns(node: ast.AST) -> bool:
    """Whether there is a `return` in it."""
    return any(isinstance(part, ast.Return) for part in ast.walk(node))


def always_returns(statements: "list[ast.stmt]") -> bool:
    """Whether no way leads through."""
    match statements:
        case [*_, ast.Return()]:
            return True
        case [*_, ast.If(_, body, orelse)]:
            return always_returns(body) and always_returns(orelse)
    return False


def ending(statements: "list[ast.stmt]", end: End) -> "list[ast.stmt]":
    """The same with something else in place of each `return`: what it would skip is nested.

    Refused where it returns out of a loop, or where statements would be needed twice.
    """
    made: list[ast.stmt] = []
    for number, statement in enumerate(statements):
        if isinstance(statement, ast.Return):
            return made + end(statement.value or ast.Constant(0))
        if not returns(statement):
            made.append(statement)
            continue
        if not isinstance(statement, ast.If):
            raise Refused
        body, orelse, rest = statement.body, statement.orelse, statements[number + 1 :]
        if always_returns(body):
            orelse = orelse + rest
        elif always_returns(orelse):
            body = body + rest
        elif rest:
            raise Refused
        return made + branch(statement.test, ending(body, end), ending(orelse, end))
    return made


def branch(test: ast.expr, body: "list[ast.stmt]", orelse: "list[ast.stmt]") -> "list[ast.stmt]":
    """An `if`, with nothing empty in it."""
    if body:
        return [ast.If(test, body, orelse)]
    if orelse:
        return [ast.If(ast.UnaryOp(ast.Not(), test), orelse, [])]
    return [ast.Expr(test)] if any(map(touches, ast.walk(test))) else []
