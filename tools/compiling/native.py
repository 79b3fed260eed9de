"""Kernels in C: the firmware's viper functions once more, for a desktop that has a C compiler.

Integers have 64 bits, which hold what the board's 32 do. As in the stand-in for `micropython`, an
index outside a buffer and a value that does not fit raise: PyErr_SetString() notes it, and ctypes
raises when the function has returned. Only what needs no chip is translated.
"""

import ast
from collections.abc import Mapping

from . import forms
from .c_text import BITS, Function
from .inline import inline
from .marks import Key
from .modules import Module

OURS = __package__.partition(".")[0]
# Layers that know no hardware.
_LAYERS = ("base", "motion", "control", "language", "talk", OURS)
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


def in_c(sources: Mapping[str, str]) -> str:
    """The C text of the kernels among these modules. NotForC where it knows a form not.

    Its text `kernels` lists them: module, name and the parameters' types, a line each.
    """
    texts = inline(sources, keep=True)
    modules = [Module(name, text) for name, text in texts.items() if _is_plain(name)]
    every = {
        (module.name, name): (module, function)
        for module in modules
        for name, function in module.functions.items()
    }
    left_out = _in_python(every)
    functions = [_Function(*every[key]) for key in every if key not in left_out]
    listed = "".join([f'    "{f.listed()}\\n"\n' for f in functions])
    pointers = [_POINTER.format(bits=bits, type=_C_TYPES[bits]) for bits in BITS.values()]
    declared = [f"static {f.head()};\n" for f in functions]
    table = f"const char kernels[] =\n{listed};\n"
    texts_of_functions = (part for f in functions for part in (f.body(), f.outer()))
    return "".join([_HEAD, *pointers, table, *declared, *texts_of_functions])


def _is_plain(module: str) -> bool:
    return module.partition(".")[0] in _LAYERS


def _in_python(every: "Mapping[Key, tuple[Module, ast.FunctionDef]]") -> set[Key]:
    """Those of them that need Python, and all that call one of these."""
    found = {key for key, (module, function) in every.items() if _needs_python(module, function)}
    calls = {
        key: {module.means(node.id) for node in ast.walk(function) if isinstance(node, ast.Name)}
        for key, (module, function) in every.items()
    }
    while more := {key for key in every.keys() - found if calls[key] & found}:
        found |= more
    return found


def _needs_python(module: Module, function: ast.FunctionDef) -> bool:
    """It does more with objects than to call them, or to pass them to another kernel."""
    objects = {
        arg.arg for arg in function.args.args if forms.annotation(arg.annotation) == "object"
    }
    named = [node for node in ast.walk(function) if isinstance(node, ast.Name)]
    calls = [node for node in ast.walk(function) if isinstance(node, ast.Call)]
    used = [call.func for call in calls]
    for call in calls:
        if isinstance(call.func, ast.Name) and module.means(call.func.id):
            used += call.args
    return any(node.id in objects and node not in used for node in named)


class _Function(Function):
    """A function as a desktop has it."""

    integer = "int64_t"
    object = "void *"
    zero_pointer = "{0}"

    def listed(self) -> str:
        """It and its types, for whoever calls it."""
        return " ".join([self._module.name, self._function.name, *self.parameters.values()])

    def outer(self) -> str:
        """The one that ctypes calls, which takes pointers to pointers."""
        listed, handed = [], []
        for name, type in self.parameters.items():
            star = "*" if type in BITS else ""
            listed.append(f"{self.c_type(type)} {star}{name}_")
            handed.append(f"{star}{name}_")
        outer = f"int64_t use_{self.name}({', '.join(listed)})"
        return f"{outer} {{ return {self.name}({', '.join(handed)}); }}\n"

    def number(self, value: int) -> str:
        return f"INT64_C({value})"

    def load(self, bits: int, pointer: str, index: str) -> str:
        return f"get{bits}({pointer}, {index})"

    def store(self, bits: int, pointer: str, index: str, value: str) -> str:
        return f"set{bits}({pointer}, {index}, {value});"

    def cast(self, type: str, node: ast.expr) -> str:
        to, of = BITS[type], BITS[self.pointer_type(node)]
        memory = self.expression(node)
        return f"((ptr{to}){{(void *){memory}.at, {memory}.length * {of} / {to}}})"

    def call_object(self, node: ast.Call) -> str:
        return f"call({self._handed(node)})"

    def tell_object(self, node: ast.Call) -> str:
        return f"tell({self._handed(node)})"

    def after_objects(self) -> str:
        return "if (PyErr_Occurred()) return 0;"

    def knows(self, key: Key) -> bool:
        return _is_plain(key[0])

    def _handed(self, node: ast.Call) -> str:
        """An object that is called, and the number it is called with, if any."""
        match [self.expression(argument) for argument in (node.func, *node.args)]:
            case [function]:
                return f'{function}, "", 0'
            case [function, number]:
                return f'{function}, "L", {number}'
        raise self.refuse(node)
