"""Viper functions in C: the common part of two dialects, the desktop's (native.py) and a board's
(machine_code.py).

Viper knows integers, pointers and simple statements, so the C text is nearly the same. All
integers have one type. Every local is declared at the beginning. Each name ends in an underscore,
so that it cannot be a keyword of C.
"""

import ast
from collections.abc import Iterator, Mapping

from . import viper
from .viper import BITS, Key, Module

_BINARY = dict(zip((ast.Add, ast.Sub, ast.Mult, ast.BitAnd, ast.BitOr, ast.BitXor), "+-*&|^"))
_FUNCTIONS = {ast.FloorDiv: "quotient", ast.Mod: "modulo", ast.LShift: "left", ast.RShift: "right"}
_COMPARED = (ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE)
_COMPARE = dict(zip(_COMPARED, "== != < <= > >=".split(), strict=True))
_PLACE = "@"  # stands for an index that has been computed already; not a name in the sources


class NotForC(Exception):
    """A form of Python that this translator does not support; no kernel needs it so far."""


def c_name(module: str, name: str) -> str:
    """Return a function's name in C. The function that is called from outside has `use_` before
    it."""
    return f"{module.replace('.', '_')}__{name}"


class Function:
    """Translates one function to C."""

    def __init__(self, modules: "Mapping[str, Module]", key: Key) -> None:
        """modules: all, by name. key: the function's module and name."""
        self._modules = modules
        self._module = module = modules[key[0]]
        self._function = function = module.functions[key[1]]
        self.name = c_name(module.name, function.name)
        self.parameters = {
            argument.arg: viper.annotation(argument.annotation) for argument in function.args.args
        }
        # Of parameters and locals. For a local, bool and uint are integers, too.
        self._types = self.parameters | {
            name: type if type in BITS or type == "object" else "int"
            for name, type in viper.types(function, module.numbers).items()
            if name not in self.parameters
        }

    def head(self) -> str:
        """Return its declaration."""
        listed = [f"{self.c_type(type)} {name}_" for name, type in self.parameters.items()]
        return f"integer {self.name}({', '.join(listed) or 'void'})"

    def body(self) -> str:
        """Return its definition."""
        own = [name for name in self._types if name not in self.parameters]  # its locals
        declared = [f"{self.c_type(self._types[name])} {name}_ = {{0}};" for name in own]
        lines = [*declared, *self._block(viper.body(self._function)), "return 0;"]
        inner = "\n    ".join(lines)
        return f"static {self.head()} {{\n    {inner}\n}}\n"

    def c_type(self, type: str) -> str:
        """Return the C type of a viper type."""
        return type if type in BITS or type == "object" else "integer"

    def refuse(self, node: ast.AST) -> NotForC:
        """Return the exception to raise for a form that is not supported."""
        return NotForC(f"{self.name}: {ast.unparse(node)}")

    # Statements

    def _block(self, body: "list[ast.stmt]") -> Iterator[str]:
        for statement in body:
            yield from self._statement(statement)
            if not isinstance(statement, ast.If | ast.For | ast.While):
                yield self._after(statement)

    def _after(self, node: ast.AST) -> str:
        """Return the check for an exception, if the node uses an object; else ""."""
        return "CHECK" if any(map(self.is_object, ast.walk(node))) else ""

    def is_object(self, node: ast.AST) -> bool:
        """Return whether it is the name of an object."""
        return isinstance(node, ast.Name) and self._types.get(node.id) == "object"

    def _statement(self, node: ast.stmt) -> Iterator[str]:
        """Yield the lines of a statement in C. Capitals are macros of the two dialects."""
        match node:
            case ast.Assign([ast.Name(name)], value):
                yield f"{name}_ = {self.expression(value)};"
            case ast.Assign([ast.Subscript() as place], value):
                yield f"{{ integer v = {self.expression(value)};"
                yield self._after(value)
                yield f"{self._store(place, 'v')} }}"
            case ast.Assign([ast.Tuple(names)], value) if self.is_object(value):
                unpacked = f"TAKE_APART({self.expression(value)}, {len(names)});"
                parts = [f"{self.expression(n)} = PART({i});" for i, n in enumerate(names)]
                yield f"{{ {unpacked} {' '.join(parts)} }}"
            case ast.AugAssign(ast.Name(name) as target, op, value):
                old = ast.Name(target.id, ast.Load())
                yield f"{name}_ = {self.expression(ast.BinOp(old, op, value))};"
            case ast.AugAssign(ast.Subscript(pointer, index), op, value):
                # p[index] += value, with the index computed once: _PLACE becomes the C name place
                yield f"{{ integer place = {self.expression(index)};"
                place = ast.Subscript(pointer, ast.Name(_PLACE, ast.Load()), ast.Load())
                yield f"integer v = {self.expression(ast.BinOp(place, op, value))};"
                yield f"{self._store(place, 'v')} }}"
            case ast.Return(value):
                yield f"return {self.expression(value) if value else 0};"
            case ast.Expr(ast.Call(called) as call) if self.is_object(called):
                yield f"DROP({self.called(call)});"
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
            case ast.Break() | ast.Continue():
                yield f"{type(node).__name__.lower()};"
            case ast.Pass():
                yield ";"
            case _:
                raise self.refuse(node)

    def _for(self, name: str, bounds: "list[ast.expr]", body: "list[ast.stmt]") -> Iterator[str]:
        """Yield `for name in range(*bounds)`. bounds: the end, or start and end. A hidden variable
        counts, so that the loop may assign to the name, as in Python."""
        if len(bounds) > 2:  # a step
            raise self.refuse(bounds[2])
        first, end = ["0", *(self.expression(bound) for bound in bounds)][-2:]
        yield f"for (integer turn = {first}, end = {end}; turn < end; turn++) {{"
        yield f"{name}_ = turn;"
        yield from self._block(body)
        yield "}"

    # Expressions; they are integers, except pointers and objects

    def expression(self, node: ast.expr) -> str:
        """Return a value in C."""
        match node:
            case ast.Constant(int() as value):
                return f"INT({int(value)})"
            case ast.Name(name) if name in self._types:
                return f"{name}_"
            case ast.Name(name) if name in self._module.numbers:
                return f"INT({self._module.numbers[name]})"
            case ast.Name(name) if name == _PLACE:
                return "place"
            case ast.Subscript(pointer, index):
                bits = BITS[self.pointer_type(pointer)]
                return f"get{bits}({self.expression(pointer)}, {self.expression(index)})"
            case ast.UnaryOp(ast.USub(), operand):
                return f"(-{self.expression(operand)})"
            case ast.UnaryOp(ast.Not(), operand):
                return f"((integer)!{self.truth(operand)})"
            case ast.UnaryOp(ast.Invert(), operand):
                return f"(~{self.expression(operand)})"
            case ast.BinOp(one, op, other):
                return self._binary(self.expression(one), op, self.expression(other))
            case ast.Compare(one, [op], [other]):
                sign = _COMPARE[type(op)]
                return f"((integer)({self.expression(one)} {sign} {self.expression(other)}))"
            case ast.BoolOp(op, values):
                return self._either(op, [self.truth(value) for value in values])
            case ast.IfExp(test, one, other):
                parts = [self.truth(test), self.expression(one), self.expression(other)]
                return f"({parts[0]} ? {parts[1]} : {parts[2]})"
            case ast.Call(ast.Name(name), arguments):
                return self._call(node, name, arguments)
        raise self.refuse(node)

    def truth(self, node: ast.expr) -> str:
        """Return a value that is only compared with 0."""
        value = self.expression(node)
        return f"TRUE({value})" if self.is_object(node) else value

    def _binary(self, one: str, op: ast.operator, other: str) -> str:
        if type(op) in _FUNCTIONS:
            return f"{_FUNCTIONS[type(op)]}({one}, {other})"
        return f"({one} {_BINARY[type(op)]} {other})"

    def _either(self, op: ast.boolop, values: "list[str]") -> str:
        """Return an expression for the value that Python's `and` or `or` returns: the first one
        that decides, else the last one."""
        *others, result = values  # built from the last value to the first
        for value in reversed(others):
            if_true, if_false = ("t", result) if isinstance(op, ast.Or) else (result, "t")
            result = f"({{ integer t = {value}; t ? {if_true} : {if_false}; }})"
        return result

    def _store(self, place: ast.Subscript, value: str) -> str:
        bits = BITS[self.pointer_type(place.value)]
        return (
            f"set{bits}({self.expression(place.value)}, {self.expression(place.slice)}, {value});"
        )

    def pointer_type(self, node: ast.expr) -> str:
        """Return the type of a pointer; NotForC if it is not a pointer."""
        if (type := viper.type_of(node, self._types)) in BITS:
            return type
        raise self.refuse(node)

    def _call(self, node: ast.Call, name: str, arguments: "list[ast.expr]") -> str:
        """Return a call as a number or a pointer: of an object, a cast, or another kernel."""
        if self.is_object(node.func):
            return f"RESULT({self.called(node)})"
        if name == "int":
            value = self.expression(arguments[0])
            if self.is_object(arguments[0]):
                return f"NUMBER({value})"
            return (
                f"ADDRESS({value})" if viper.type_of(arguments[0], self._types) in BITS else value
            )
        if name in BITS:
            return self.cast(name, arguments[0])
        key = self._module.means(name)
        if key is None or key[1] not in getattr(self._modules.get(key[0]), "functions", ()):
            raise self.refuse(node)  # it is no kernel
        parameters = self._modules[key[0]].functions[key[1]].args.args
        types = [viper.annotation(parameter.annotation) for parameter in parameters]
        passed = [
            self.cast(type, argument) if type in BITS else self.expression(argument)
            for type, argument in zip(types, arguments, strict=True)
        ]
        return f"{c_name(*key)}({', '.join(passed)})"

    def cast(self, type: str, node: ast.expr) -> str:
        """Return a value as a pointer: an object's buffer, another pointer, or an address."""
        if viper.type_of(node, self._types) == type:
            return self.expression(node)
        return f"{'OF' if self.is_object(node) else 'AS'}({type}, {self.expression(node)})"

    def called(self, node: ast.Call) -> str:
        """Return the call of an object with objects and numbers: the macro CALL with the function,
        the number of arguments, their kinds, "(OL)", as CPython's C API wants them, and
        the arguments. A number is boxed for MicroPython."""
        kinds = "".join("O" if self.is_object(argument) else "L" for argument in node.args)
        values = map(self.expression, node.args)
        passed = [v if kind == "O" else f"BOX({v})" for kind, v in zip(kinds, values, strict=True)]
        function, format = self.expression(node.func), f'"({kinds})"'
        return f"CALL({', '.join([function, str(len(kinds)), format, *passed])})"
