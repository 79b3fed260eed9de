"""Kernels in C for a desktop with a C compiler: the firmware's viper functions translated.

Integers have 64 bits, enough for all values of the board's 32 bits. As in the stand-in for
`micropython`, an index outside a buffer and a value that does not fit raise an exception:
PyErr_SetString() sets it, and ctypes raises it after the function has returned. Objects are
borrowed for the duration of a call. Only modules without hardware are translated.
"""

from collections.abc import Mapping

from ..compiling.c_text import Function
from ..compiling.inline import inline
from ..compiling.viper import BITS, Module

OURS = __package__.partition(".")[0]
# Layers that do not depend on hardware.
_LAYERS = ("base", "motion", "control", "language", "talk", "extras", OURS)
_C_TYPES = {8: "uint8_t", 16: "uint16_t", 32: "int32_t"}

_HEAD = """\
#include <stdint.h>
#include <stdlib.h>
typedef struct {
    void *at, *object;
    intptr_t length, size;
    int is_readonly, dimensions;
    char *format;
    intptr_t *shape, *strides, *suboffsets;
    void *internal;
} Py_buffer;
typedef void *object;
typedef int64_t integer;
#define INT(value) INT64_C(value)
#define OF(type, o) of_##type(o)
#define AS(type, p) ((type){(void *)(p).at, (p).length * sizeof *(p).at / sizeof *((type *)0)->at})
#define ADDRESS(p) ((int64_t)(p).at)
#define TRUE(o) PyObject_IsTrue(o)
#define NUMBER(o) PyLong_AsLongLong(o)
#define RESULT(o) value(o)
#define DROP(o) drop(o)
#define BOX(value) (long long)(value)
#define CALL(f, n, kinds, ...) PyObject_CallFunction(f, kinds, ##__VA_ARGS__)
#define TAKE_APART(o, n) void *parts[n]; take_apart(o, n, parts)
#define PART(i) parts[i]
#define CHECK if (PyErr_Occurred()) return 0;
extern void *PyExc_IndexError, *PyExc_OverflowError, *PyExc_ValueError, *PyExc_ZeroDivisionError;
extern void PyErr_SetString(void *, const char *);
extern void *PyErr_Occurred(void);
extern void *PyObject_CallFunction(void *, const char *, ...);
extern int PyObject_IsTrue(void *);
extern int PyObject_GetBuffer(void *, Py_buffer *, int);
extern void PyBuffer_Release(Py_buffer *);
extern intptr_t PyTuple_Size(void *);
extern void *PyTuple_GetItem(void *, intptr_t);
extern long long PyLong_AsLongLong(void *);
extern void Py_DecRef(void *);

static void drop(void *made) { if (made) Py_DecRef(made); }
static int64_t value(void *made) {
    int64_t found = made ? PyLong_AsLongLong(made) : 0;
    drop(made);
    return found;
}
static void take_apart(void *tuple, intptr_t count, void **parts) {
    intptr_t size = PyTuple_Size(tuple);
    if (size >= 0 && size != count) PyErr_SetString(PyExc_ValueError, "values to unpack");
    for (intptr_t i = 0; i < count; i++) parts[i] = size == count ? PyTuple_GetItem(tuple, i) : 0;
}
static Py_buffer memory(void *object) {
    Py_buffer found = {0};
    if (PyObject_GetBuffer(object, &found, 0) == 0) PyBuffer_Release(&found);
    return found;
}
static int64_t fault(void *kind, const char *why) {
    if (!PyErr_Occurred()) PyErr_SetString(kind, why); // the first one is the cause
    return 0;
}
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
static inline ptr{bits} of_ptr{bits}(void *object) {{
    Py_buffer found = memory(object);
    return (ptr{bits}){{found.at, found.length / sizeof({type})}};
}}
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
    """Return the C text of the kernels in these modules. NotForC if a form is not supported.

    The string `kernels` in the C text lists them, a line each: module, name and parameter types.
    """
    texts = inline(sources, keep=True)
    modules = {name: Module(name, text) for name, text in texts.items() if _is_plain(name)}
    keys = [(name, function) for name, module in modules.items() for function in module.functions]
    functions = [_Function(modules, key) for key in keys]
    listed = "".join([f'    "{f.listed()}\\n"\n' for f in functions])
    pointers = [_POINTER.format(bits=bits, type=_C_TYPES[bits]) for bits in BITS.values()]
    declared = [f"static {f.head()};\n" for f in functions]
    table = f"const char kernels[] =\n{listed};\n"
    texts_of_functions = (part for f in functions for part in (f.body(), f.outer()))
    return "".join([_HEAD, *pointers, table, *declared, *texts_of_functions])


def _is_plain(module: str) -> bool:
    return module.partition(".")[0] in _LAYERS


class _Function(Function):
    """A function for a desktop."""

    def listed(self) -> str:
        """Return module, name and parameter types, for the caller."""
        return " ".join([self._module.name, self._function.name, *self.parameters.values()])

    def outer(self) -> str:
        """Return the function that ctypes calls. Where the kernel takes a pointer structure, it
        takes the address of one."""
        parameters, arguments = [], []
        for name, type in self.parameters.items():
            star = "*" if type in BITS else ""  # a pointer
            parameters.append(f"{self.c_type(type)} {star}{name}_")
            arguments.append(f"{star}{name}_")
        head = f"int64_t use_{self.name}({', '.join(parameters)})"
        return f"{head} {{ return {self.name}({', '.join(arguments)}); }}\n"
