"""Kernels in C: the firmware's viper functions once more, for a desktop that has a C compiler.

Viper knows integers, pointers and simple statements, so the C is nearly the same text. Integers
have 64 bits, which hold what the board's 32 do. As in the stand-in for `micropython`, an index
outside a buffer and a value that does not fit raise: PyErr_SetString() notes it, and ctypes
raises when the function has returned. Only what needs no chip is translated.
"""

import ast
from collections.abc import Iterator, Mapping

from . import forms
from .inline import inline
from .modules import Module

# Layers that know no hardware.
_LAYERS = ("base", "motion", "control", "language", "talk")
_BITS = {"ptr8": 8, "ptr16": 16, "ptr32": 32}
_C_TYPES = {8: "uint8_t", 16: "uint16_t", 32: "int32_t"}

_HEAD = """\
#include <stdint.h>
#include <stdlib.h>
extern void *PyExc_IndexError, *PyExc_OverflowError, *PyExc_ZeroDivisionError;
extern void PyErr_SetString(void *, const char *);
extern void *PyErr_Occurred(void);
extern void *PyObject_CallFunction(void *, const char *, ...);
extern long long PyLong_AsLongLong(void *);
extern void Py_DecRef(void *);

static int64_t call(void *function, const char *format, int64_t argument) {
    void *made = PyObject_CallFunction(function, format, (long long)argument);
    if (!made) return 0;
    int64_t value = PyLong_AsLongLong(made);
    Py_DecRef(made);
    return value;
}
static void tell(void *function, const char *format, int64_t argument) {
    void *made = PyObject_CallFunction(function, format, (long long)argument);
    if (made) Py_DecRef(made);
}
static int64_t fault(void *kind, const char *why) { PyErr_SetString(kind, why); return 0; }
static inline int64_t quotient(int64_t a, int64_t b) {
    if (!b) return fault(PyExc_ZeroDivisionError, "division by zero");
    return a / b - (a % b && (a < 0) != (b < 0));
}
static inline int64_t modulo(int64_t a, int64_t b) { return a - quotient(a, b) * b; }
static inline int64_t left(int64_t a, int64_t n) {
    if ((uint64_t)n > 31) return fault(PyExc_OverflowError, "shift count");
    return a << n;
}
static inline int64_t right(int64_t a, int64_t n) {
    if ((uint64_t)n > 31) return fault(PyExc_OverflowError, "shift count");
    return a >> n;
}
"""
_POINTER = """\
typedef struct {{ {type} *at; int64_t length; }} ptr{bits};
static inline int64_t get{bits}(ptr{bits} p, int64_t i) {{
    return (uint64_t)i < (uint64_t)p.length ? p.at[i] : fault(PyExc_IndexError, "index");
}}
static inline void set{bits}(ptr{bits} p, int64_t i, int64_t value) {{
    if ((uint64_t)i >= (uint64_t)p.length) fault(PyExc_IndexError, "index");
    else if (({type})value != value) fault(PyExc_OverflowError, "value does not fit");
    else p.at[i] = value;
}}
"""
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


def in_c(sources: Mapping[str, str]) -> str:
    """The C text of the kernels among these modules. NotForC where it knows a form not.

    Its text `kernels` lists them: module, name and the parameters' types, a line each.
    """
    texts = inline(sources, keep=True)
    functions = [
        _Function(module, function)
        for module in (Module(name, text) for name, text in texts.items() if _is_plain(name))
        for function in module.functions.values()
        if not _hands_on(function)
    ]
    listed = "".join([f'    "{f.listed()}\\n"\n' for f in functions])
    pointers = [_POINTER.format(bits=bits, type=_C_TYPES[bits]) for bits in _BITS.values()]
    declared = [f"static {f.head()};\n" for f in functions]
    table = f"const char kernels[] =\n{listed};\n"
    return "".join([_HEAD, *pointers, table, *declared, *(f.text() for f in functions)])


def c_name(module: str, name: str) -> str:
    """What a function is called in C; with `use_` before it, as it is called from outside."""
    return f"{module.replace('.', '_')}__{name}"


def _is_plain(module: str) -> bool:
    return module.partition(".")[0] in _LAYERS


def _hands_on(function: ast.FunctionDef) -> bool:
    """It does more with objects than to call them: that stays Python."""
    objects = {
        arg.arg for arg in function.args.args if forms.annotation(arg.annotation) == "object"
    }
    named = [node for node in ast.walk(function) if isinstance(node, ast.Name)]
    called = [node.func for node in ast.walk(function) if isinstance(node, ast.Call)]
    return any(node.id in objects and node not in called for node in named)


class _Function:
    """One function on its way into C."""

    def __init__(self, module: Module, function: ast.FunctionDef) -> None:
        self._module = module
        self._function = function
        self._name = c_name(module.name, function.name)
        self._parameters = {
            argument.arg: forms.annotation(argument.annotation) for argument in function.args.args
        }
        self._types = {**self._parameters, **self._locals()}

    def _locals(self) -> dict[str, str]:
        types = dict.fromkeys(forms.stored(self._function) - self._parameters.keys(), "int")
        for node in ast.walk(self._function):
            match node:
                case ast.Assign([ast.Name(name)], ast.Call(ast.Name(cast))) if cast in _BITS:
                    types[name] = cast
        return types

    def listed(self) -> str:
        """It and its types, for whoever calls it."""
        return " ".join([self._module.name, self._function.name, *self._parameters.values()])

    def head(self) -> str:
        """Its declaration."""
        listed = [f"{_c_type(type)} {name}_" for name, type in self._parameters.items()]
        return f"int64_t {self._name}({', '.join(listed) or 'void'})"

    def text(self) -> str:
        """The function, and the one that ctypes calls, which takes pointers to pointers."""
        own = [n for n in self._types if n not in self._parameters]
        zero = {n: "{0}" if self._types[n] in _BITS else "0" for n in own}
        declared = [f"{_c_type(self._types[n])} {n}_ = {zero[n]};" for n in own]
        lines = [*declared, *self._block(forms.body(self._function)), "return 0;"]
        listed, handed = [], []
        for name, type in self._parameters.items():
            star = "*" if type in _BITS else ""
            listed.append(f"{_c_type(type)} {star}{name}_")
            handed.append(f"{star}{name}_")
        outer = f"int64_t use_{self._name}({', '.join(listed)})"
        inner = "\n    ".join(lines)
        return (
            f"static {self.head()} {{\n    {inner}\n}}\n"
            f"{outer} {{ return {self._name}({', '.join(handed)}); }}\n"
        )

    def _refuse(self, node: ast.AST) -> NotForC:
        return NotForC(f"{self._name}: {ast.unparse(node)}")

    # Statements

    def _block(self, body: "list[ast.stmt]") -> Iterator[str]:
        for statement in body:
            yield from self._statement(statement)
            if not isinstance(statement, ast.If | ast.For | ast.While) and any(
                self._is_object(node) for node in ast.walk(statement)
            ):
                yield "if (PyErr_Occurred()) return 0;"

    def _is_object(self, node: ast.AST) -> bool:
        return isinstance(node, ast.Name) and self._types.get(node.id) == "object"

    def _statement(self, node: ast.stmt) -> Iterator[str]:
        match node:
            case ast.Assign([ast.Name(name)], value):
                yield f"{name}_ = {self._expression(value)};"
            case ast.Assign([ast.Subscript() as place], value):
                yield f"{{ int64_t v = {self._expression(value)};"
                yield f"{self._access('set', place, 'v')}; }}"
            case ast.AugAssign(ast.Name(name) as target, op, value):
                old = ast.Name(target.id, ast.Load())
                yield f"{name}_ = {self._expression(ast.BinOp(old, op, value))};"
            case ast.AugAssign(ast.Subscript(pointer, index), op, value):
                yield f"{{ int64_t place = {self._expression(index)};"
                place = ast.Subscript(pointer, ast.Name(_PLACE, ast.Load()), ast.Load())
                yield f"int64_t v = {self._expression(ast.BinOp(place, op, value))};"
                yield f"{self._access('set', place, 'v')}; }}"
            case ast.Return(value):
                yield f"return {self._expression(value) if value else 0};"
            case ast.Expr(ast.Call(called, arguments)) if self._is_object(called):
                # What it returns need be no number.
                yield f"tell({self._handed(node, called, arguments)});"
            case ast.Expr(value):
                yield f"(void){self._expression(value)};"
            case ast.If(test, body, orelse):
                yield f"if ({self._expression(test)}) {{"
                yield from self._block(body)
                yield "} else {"
                yield from self._block(orelse)
                yield "}"
            case ast.While(test, body, []):
                yield f"while ({self._expression(test)}) {{"
                yield from self._block(body)
                yield "}"
            case ast.For(ast.Name(name), ast.Call(ast.Name("range"), bounds), body, []):
                yield from self._for(name, bounds, body)
            case ast.Pass() | ast.Break() | ast.Continue():
                yield {"Pass": "", "Break": "break", "Continue": "continue"}[
                    type(node).__name__
                ] + ";"
            case _:
                raise self._refuse(node)

    def _for(self, name: str, bounds: "list[ast.expr]", body: "list[ast.stmt]") -> Iterator[str]:
        if len(bounds) > 2:
            raise self._refuse(bounds[2])
        first, end = ["0", *(self._expression(bound) for bound in bounds)][-2:]
        yield f"for (int64_t turn = {first}, end = {end}; turn < end; turn++) {{"
        yield f"{name}_ = turn;"
        yield from self._block(body)
        yield "}"

    # Expressions, all of them int64_t but pointers

    def _expression(self, node: ast.expr) -> str:
        match node:
            case ast.Constant(int() as value):
                return f"INT64_C({int(value)})"
            case ast.Name(name) if name in self._types:
                return f"{name}_"
            case ast.Name(name) if name == _PLACE:
                return "place"
            case ast.Subscript():
                return self._access("get", node)
            case ast.UnaryOp(ast.USub(), operand):
                return f"(-{self._expression(operand)})"
            case ast.UnaryOp(ast.Not(), operand):
                return f"((int64_t)!{self._expression(operand)})"
            case ast.UnaryOp(ast.Invert(), operand):
                return f"(~{self._expression(operand)})"
            case ast.BinOp(one, op, other):
                return self._binary(self._expression(one), op, self._expression(other))
            case ast.Compare(one, [op], [other]):
                sign = _COMPARE[type(op)]
                return f"((int64_t)({self._expression(one)} {sign} {self._expression(other)}))"
            case ast.BoolOp(op, values):
                return self._either(op, [self._expression(value) for value in values])
            case ast.IfExp(test, one, other):
                parts = [self._expression(part) for part in (test, one, other)]
                return f"({parts[0]} ? {parts[1]} : {parts[2]})"
            case ast.Call(ast.Name(name), arguments):
                return self._call(node, name, arguments)
        raise self._refuse(node)

    def _binary(self, one: str, op: ast.operator, other: str) -> str:
        if type(op) in _BY_FUNCTION:
            return f"{_BY_FUNCTION[type(op)]}({one}, {other})"
        return f"({one} {_BINARY[type(op)]} {other})"

    def _either(self, op: ast.boolop, values: "list[str]") -> str:
        """Python's `and` and `or` are one of the values."""
        *before, made = values
        for value in reversed(before):
            parts = ("t", made) if isinstance(op, ast.Or) else (made, "t")
            made = f"({{ int64_t t = {value}; t ? {parts[0]} : {parts[1]}; }})"
        return made

    def _access(self, how: str, place: ast.Subscript, *value: str) -> str:
        bits = _BITS[self._pointer_type(place.value)]
        parts = [self._expression(place.value), self._expression(place.slice), *value]
        return f"{how}{bits}({', '.join(parts)})"

    def _pointer_type(self, node: ast.expr) -> str:
        match node:
            case ast.Name(name) if self._types.get(name) in _BITS:
                return self._types[name]
            case ast.Call(ast.Name(cast)) if cast in _BITS:
                return cast
        raise self._refuse(node)

    def _call(self, node: ast.Call, name: str, arguments: "list[ast.expr]") -> str:
        if self._is_object(node.func):
            return f"call({self._handed(node, node.func, arguments)})"
        handed = [self._expression(argument) for argument in arguments]
        if name == "int":
            return handed[0]
        if name in _BITS:
            to, of = _BITS[name], _BITS[self._pointer_type(arguments[0])]
            memory = handed[0]
            return f"((ptr{to}){{(void *){memory}.at, {memory}.length * {of} / {to}}})"
        meant = self._module.means(name)
        if meant is None or not _is_plain(meant[0]):
            raise self._refuse(node)
        return f"{c_name(*meant)}({', '.join(handed)})"

    def _handed(self, node: ast.AST, called: ast.expr, arguments: "list[ast.expr]") -> str:
        """An object that is called, and the number it is called with, if any."""
        match [self._expression(argument) for argument in (called, *arguments)]:
            case [function]:
                return f'{function}, "", 0'
            case [function, number]:
                return f'{function}, "L", {number}'
        raise self._refuse(node)


def _c_type(type: str) -> str:
    return type if type in _BITS else "void *" if type == "object" else "int64_t"
