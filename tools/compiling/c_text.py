"""Viper functions in C: what both dialects have in common, the desktop's (native.py) and a
board's (machine_code.py).

Viper knows integers, pointers and simple statements, so the C is nearly the same text. Every
integer is of one type, every local is declared at the beginning, and each name has an underscore
behind it, so that it is none of C's own.
"""

import ast
from collections.abc import Iterator

from . import viper
from .viper import Key, Module

BITS = {"ptr8": 8, "ptr16": 16, "ptr32": 32}

_BINARY = dict(zip((ast.Add, ast.Sub, ast.Mult, ast.BitAnd, ast.BitOr, ast.BitXor), "+-*&|^"))
_BY_FUNCTION = {
    ast.FloorDiv: "quotient",
    ast.Mod: "modulo",
    ast.LShift: "left",
    ast.RShift: "right",
}
_COMPARE = dict(
    zip(
        (ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE),
        ("==", "!=", "<", "<=", ">", ">="),
        strict=True,
    )
)
_PLACE = "@"  # stands for an index that has been worked out; no name of the sources


class NotForC(Exception):
    """A form that no kernel has had so far."""


def c_name(module: str, name: str) -> str:
    """What a function is called in C; with `use_` before it, as it is called from outside."""
    return f"{module.replace('.', '_')}__{name}"


class Function:
    """One function on its way into C. A dialect says what its integers are, how memory is reached
    and how objects are called."""

    integer = ""  # the type
    object = ""
    zero_pointer = ""

    def __init__(self, module: Module, function: ast.FunctionDef) -> None:
        self._module = module
        self._function = function
        self.name = c_name(module.name, function.name)
        self.parameters = {
            argument.arg: viper.annotation(argument.annotation) for argument in function.args.args
        }
        self._types = self.parameters | {
            name: type if type in BITS or type == "object" else "int"
            for name, type in viper.types(function).items()
            if name not in self.parameters
        }

    def head(self) -> str:
        """Its declaration."""
        listed = [f"{self.c_type(type)} {name}_" for name, type in self.parameters.items()]
        return f"{self.integer} {self.name}({', '.join(listed) or 'void'})"

    def body(self) -> str:
        """The function itself."""
        own = [name for name in self._types if name not in self.parameters]
        zero = {name: self.zero_pointer if self._types[name] in BITS else "0" for name in own}
        declared = [f"{self.c_type(self._types[name])} {name}_ = {zero[name]};" for name in own]
        lines = [*declared, *self._block(viper.body(self._function)), "return 0;"]
        inner = "\n    ".join(lines)
        return f"static {self.head()} {{\n    {inner}\n}}\n"

    def c_type(self, type: str) -> str:
        """What a viper type is in C."""
        return type if type in BITS else self.object if type == "object" else self.integer

    # What a dialect has

    def number(self, value: int) -> str:
        """A constant."""
        raise NotImplementedError

    def load(self, bits: int, pointer: str, index: str) -> str:
        """What stands in memory."""
        raise NotImplementedError

    def store(self, bits: int, pointer: str, index: str, value: str) -> str:
        """A statement that writes there."""
        raise NotImplementedError

    def cast(self, type: str, node: ast.expr) -> str:
        """Something as a pointer of this type."""
        raise NotImplementedError

    def call_object(self, node: ast.Call) -> str:
        """What an object returns, as an integer."""
        raise NotImplementedError

    def call_statement(self, node: ast.Call) -> str:
        """An object is called, and what it returns need be no number."""
        raise NotImplementedError

    def after_objects(self) -> str:
        """A statement to follow one that has used an object; an empty text: none."""
        return ""

    def knows(self, key: Key) -> bool:
        """Whether this function is in C, too."""
        raise NotImplementedError

    def refuse(self, node: ast.AST) -> NotForC:
        """The exception to be raised."""
        return NotForC(f"{self.name}: {ast.unparse(node)}")

    def type_of(self, node: ast.expr) -> str:
        """The viper type of a value."""
        return viper.type_of(node, self._types)

    # Statements

    def _block(self, body: "list[ast.stmt]") -> Iterator[str]:
        for statement in body:
            yield from self._statement(statement)
            if not isinstance(statement, ast.If | ast.For | ast.While):
                yield self._after(statement)

    def _after(self, node: ast.AST) -> str:
        return self.after_objects() if any(map(self.is_object, ast.walk(node))) else ""

    def is_object(self, node: ast.AST) -> bool:
        """Whether it is a name for an object."""
        return isinstance(node, ast.Name) and self._types.get(node.id) == "object"

    def _statement(self, node: ast.stmt) -> Iterator[str]:
        match node:
            case ast.Assign([ast.Name(name)], value):
                yield f"{name}_ = {self.expression(value)};"
            case ast.Assign([ast.Subscript() as place], value):
                yield f"{{ {self.integer} v = {self.expression(value)};"
                yield self._after(value)
                yield f"{self._store(place, 'v')} }}"
            case ast.Assign([ast.Tuple(names)], value) if self.is_object(value):
                yield self._take_apart(node, names, value)
            case ast.AugAssign(ast.Name(name) as target, op, value):
                old = ast.Name(target.id, ast.Load())
                yield f"{name}_ = {self.expression(ast.BinOp(old, op, value))};"
            case ast.AugAssign(ast.Subscript(pointer, index), op, value):
                yield f"{{ {self.integer} place = {self.expression(index)};"
                place = ast.Subscript(pointer, ast.Name(_PLACE, ast.Load()), ast.Load())
                yield f"{self.integer} v = {self.expression(ast.BinOp(place, op, value))};"
                yield f"{self._store(place, 'v')} }}"
            case ast.Return(value):
                yield f"return {self.expression(value) if value else 0};"
            case ast.Expr(ast.Call(called) as call) if self.is_object(called):
                yield f"{self.call_statement(call)};"
            case ast.Expr(value):
                yield f"(void){self.expression(value)};"
            case ast.If(test, body, orelse):
                yield f"if ({self.truth(test)}) {{"
                yield from self._block(body)
                yield "} else {"
                yield from self._block(orelse)
                yield "}"
            case ast.While(test, body, []):
                yield f"while ({self.truth(test)}) {{"
                yield from self._block(body)
                yield "}"
            case ast.For(ast.Name(name), ast.Call(ast.Name("range"), bounds), body, []):
                yield from self._for(name, bounds, body)
            case ast.Pass() | ast.Break() | ast.Continue():
                yield {"Pass": "", "Break": "break", "Continue": "continue"}[
                    type(node).__name__
                ] + ";"
            case _:
                raise self.refuse(node)

    def _take_apart(self, node: ast.stmt, names: "list[ast.expr]", value: ast.expr) -> str:
        raise self.refuse(node)

    def _for(self, name: str, bounds: "list[ast.expr]", body: "list[ast.stmt]") -> Iterator[str]:
        if len(bounds) > 2:
            raise self.refuse(bounds[2])
        first, end = ["0", *(self.expression(bound) for bound in bounds)][-2:]
        yield f"for ({self.integer} turn = {first}, end = {end}; turn < end; turn++) {{"
        yield f"{name}_ = turn;"
        yield from self._block(body)
        yield "}"

    # Expressions: integers, all but pointers and objects

    def expression(self, node: ast.expr) -> str:
        """A value."""
        match node:
            case ast.Constant(int() as value):
                return self.number(int(value))
            case ast.Name(name) if name in self._types:
                return f"{name}_"
            case ast.Name(name) if name == _PLACE:
                return "place"
            case ast.Subscript(pointer, index):
                bits = BITS[self.pointer_type(pointer)]
                return self.load(bits, self.expression(pointer), self.expression(index))
            case ast.UnaryOp(ast.USub(), operand):
                return f"(-{self.expression(operand)})"
            case ast.UnaryOp(ast.Not(), operand):
                return f"(({self.integer})!{self.truth(operand)})"
            case ast.UnaryOp(ast.Invert(), operand):
                return f"(~{self.expression(operand)})"
            case ast.BinOp(one, op, other):
                return self._binary(self.expression(one), op, self.expression(other))
            case ast.Compare(one, [op], [other]):
                sign = _COMPARE[type(op)]
                return (
                    f"(({self.integer})({self.expression(one)} {sign} {self.expression(other)}))"
                )
            case ast.BoolOp(op, values):
                return self._either(op, [self.truth(value) for value in values])
            case ast.IfExp(test, one, other):
                parts = [self.truth(test), self.expression(one), self.expression(other)]
                return f"({parts[0]} ? {parts[1]} : {parts[2]})"
            case ast.Call(ast.Name(name), arguments):
                return self._call(node, name, arguments)
        raise self.refuse(node)

    def truth(self, node: ast.expr) -> str:
        """A value of which only matters whether it is 0."""
        return self.expression(node)

    def _binary(self, one: str, op: ast.operator, other: str) -> str:
        if type(op) in _BY_FUNCTION:
            return f"{_BY_FUNCTION[type(op)]}({one}, {other})"
        return f"({one} {_BINARY[type(op)]} {other})"

    def _either(self, op: ast.boolop, values: "list[str]") -> str:
        """Python's `and` and `or` are one of the values."""
        *before, made = values
        for value in reversed(before):
            parts = ("t", made) if isinstance(op, ast.Or) else (made, "t")
            made = f"({{ {self.integer} t = {value}; t ? {parts[0]} : {parts[1]}; }})"
        return made

    def _store(self, place: ast.Subscript, value: str) -> str:
        bits = BITS[self.pointer_type(place.value)]
        return self.store(bits, self.expression(place.value), self.expression(place.slice), value)

    def pointer_type(self, node: ast.expr) -> str:
        """Which pointer it is; NotForC where it is none."""
        if (type := self.type_of(node)) in BITS:
            return type
        raise self.refuse(node)

    def _call(self, node: ast.Call, name: str, arguments: "list[ast.expr]") -> str:
        if self.is_object(node.func):
            return self.call_object(node)
        if name == "int":
            return self.as_int(arguments[0])
        if name in BITS:
            return self.cast(name, arguments[0])
        meant = self._module.means(name)
        if meant is None or not self.knows(meant):
            raise self.refuse(node)
        return f"{c_name(*meant)}({', '.join(self.handed(meant, arguments))})"

    def handed(self, key: Key, arguments: "list[ast.expr]") -> "list[str]":
        """What one of our functions is called with."""
        return [self.expression(argument) for argument in arguments]

    def as_int(self, node: ast.expr) -> str:
        """What `int()` makes of a value."""
        return self.expression(node)
