"""Kernels as machine code: viper functions compiled by way of C, in pieces.

MicroPython's own compiler keeps each local in memory and looks up each function that is called.
LLVM, from the package `ziglang`, compiles the same functions to code that is half as long and
takes half the time. Memory accesses are the same in number and order, because every pointer is
volatile. Integers wrap at 32 bits.

A piece is the code of one viper function, `start`, and may lie at any address. It takes
MicroPython's function table from its own object, makes a function object of each kernel that is
called from outside, and returns a tuple of them. These objects are part of the piece: a reference
to `start` keeps them alive.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from .c_text import Function, c_name
from .cache import cached
from .compilers import PROCESSORS, llvm
from .viper import BITS, Key, Module

_TARGET = "thumb-freestanding-eabi"
_FLAGS = (
    "-Os",
    "-std=gnu11",
    "-ffreestanding",
    "-fno-builtin",  # no loop becomes a call of memset()
    "-fno-strict-aliasing",
    "-fwrapv",
    "-fpic",
    "-fvisibility=hidden",
    "-ffunction-sections",
    "-fdata-sections",
    "-fno-jump-tables",
    "-fno-unwind-tables",
    "-fno-asynchronous-unwind-tables",
    "-Wno-everything",
    "-Werror=int-conversion",
    "-Werror=incompatible-pointer-types",
)
_LINKED = """\
ENTRY(start)
SECTIONS {{
    . = 0;
    .text : {{
        KEEP(*(.text.start))
        *(.text .text.* .rodata .rodata.*)
        . = ALIGN(4);
        exports_begin = .;
        {exports}
        exports_end = .;
        *(.data .data.* .bss .bss.*)
    }}
    /DISCARD/ : {{ *(.ARM.exidx* .ARM.attributes .comment) }}
}}
"""

# Positions in MicroPython's function table, py/nativeglue.h. The last one is meant for dynamically
# linked native modules; it is fixed for a version of the .mpy format.
_HEAD = """\
#include <stdint.h>
typedef void *object;
typedef int32_t integer;
typedef volatile uint8_t *ptr8;
typedef volatile uint16_t *ptr16;
typedef volatile int32_t *ptr32;
enum { INT = 2, POINTER = 4 };
static struct {
    object none, no, yes;
    uint32_t (*from_object)(object, uint32_t);
    object (*to_object)(uint32_t, uint32_t);
    void *others_5[11];
    _Bool (*is_true)(object);
    void *others_17[2];
    struct { void *type; uint32_t length; object items[]; } *(*new_tuple)(uint32_t, void *);
    void *others_20[7];
    object (*call)(object, uint32_t, const object *);
    void *others_28[11];
    void (*take_apart)(object, uint32_t, object *);
    void *others_40[6];
    int32_t (*quotient)(int32_t, int32_t);
    int32_t (*modulo)(int32_t, int32_t);
    void *others_48[33];
    void *type_of_functions;
} *python;
struct function { void *type; uint32_t signature; uintptr_t code; };
extern __attribute__((visibility("hidden"))) struct function exports_begin[], exports_end[];
struct context { void *type, *globals, *names; void **objects; };
struct itself { void *type; struct context *context; };

#define quotient(a, b) python->quotient(a, b)
#define modulo(a, b) python->modulo(a, b)
#define left(a, n) ((a) << (n))
#define right(a, n) ((a) >> (n))
#define INT(value) ((int32_t)(value))
#define get8(p, i) ((int32_t)(p)[i])
#define get16 get8
#define get32 get8
#define set8(p, i, value) (p)[i] = (value)
#define set16 set8
#define set32 set8
#define OF(type, o) ((type)memory(o))
#define AS(type, pointer) ((type)(pointer))
#define ADDRESS(pointer) ((int32_t)(pointer))
#define TRUE(o) python->is_true(o)
#define NUMBER(o) number(o)
#define RESULT(o) number(o)
#define DROP(o) o
#define BOX(value) boxed(value)
#define CALL(f, n, kinds, ...) python->call(f, n, (object[]){__VA_ARGS__})
#define TAKE_APART(o, n) enum { last = n - 1 }; object parts[n]; python->take_apart(o, n, parts)
#define PART(i) parts[last - i]
#define CHECK
// Kernels are handed hundreds of objects: in place, these three would take 5 kB of memory.
#define APART __attribute__((noinline)) static
APART int32_t number(object o) {
    return (uintptr_t)o & 1 ? (int32_t)(intptr_t)o >> 1 : (int32_t)python->from_object(o, INT);
}
APART void *memory(object o) {
    return (void *)((uintptr_t)o & 1 ? (intptr_t)o >> 1 : python->from_object(o, POINTER));
}
APART object boxed(int32_t value) {
    int32_t small = value << 1;
    return small >> 1 == value ? (object)(small | 1) : python->to_object(value, INT);
}
object start(const struct itself *self) {
    uintptr_t base = (uintptr_t)start & ~(uintptr_t)1;
    int32_t count = exports_end - exports_begin;
    python = self->context->objects[0];
    void *made = python->new_tuple(count, 0);
    object *items = (object *)made + 2;
    for (int32_t i = 0; i < count; i++) {
        struct function *function = &exports_begin[i];
        if (!function->type) function->code += base;
        function->type = python->type_of_functions;
        items[i] = function;
    }
    return made;
}
"""
_EXPORT = """\
static object use_{name}(uint32_t count, const object *given) {{
    return boxed({name}({given}));
}}
__attribute__((section(".exports.{name}"), used))
struct function export_{name} = {{0, {signature}, (uintptr_t)use_{name}}};
"""


def in_c(modules: Mapping[str, Module], keys: "Sequence[Key]") -> str:
    """Return the C text of these functions, all declared before the first definition."""
    functions = [_Function(modules, key) for key in keys]
    declared = [f"static {function.head()};\n" for function in functions]
    defined = [text for function in functions for text in (function.body(), function.outer())]
    return "".join([_HEAD, *declared, *defined])


@cached
def compiled(text: str, arch: str) -> bytes:
    """Compile C text to an object file. CompilerError."""
    with TemporaryDirectory() as folder:
        source, made = Path(folder, "kernels.c"), Path(folder, "kernels.o")
        source.write_text(text, encoding="utf-8")
        target = ("-target", _TARGET, f"-mcpu={PROCESSORS[arch]}")
        llvm("cc", *target, *_FLAGS, "-c", "-o", str(made), str(source))
        return made.read_bytes()


@cached
def linked(text: str, arch: str, exports: "tuple[Key, ...]") -> bytes:
    """Link a piece from the C text of all kernels: the function objects `exports`, in this order,
    and only the functions that these need. Returns its code. CompilerError."""
    kept = [f"KEEP(*(.exports.{c_name(*key)}))" for key in exports]
    with TemporaryDirectory() as folder:
        objects, script, elf, code = (
            Path(folder, name) for name in ("kernels.o", "script", "kernels.elf", "kernels.bin")
        )
        objects.write_bytes(compiled(text, arch))
        script.write_text(_LINKED.format(exports="\n        ".join(kept)), encoding="utf-8")
        llvm("ld.lld", "--gc-sections", "-T", str(script), "-o", str(elf), str(objects))
        llvm("objcopy", "-O", "binary", str(elf), str(code))
        return code.read_bytes()


class _Function(Function):
    """A function for a board."""

    def outer(self) -> str:
        """Return the function that MicroPython calls with an array of objects, `given`, and its
        function object."""
        as_pointers = dict.fromkeys(BITS, "memory(given[{}])")
        conversions = {"object": "given[{}]", **as_pointers}  # by type; others are numbers
        types = self.parameters.values()
        arguments = [
            conversions.get(type, "number(given[{}])").format(i) for i, type in enumerate(types)
        ]
        # MP_OBJ_FUN_MAKE_SIG of py/obj.h: fewest and most arguments, which are the same number
        signature = len(types) << 17 | len(types) << 1
        return _EXPORT.format(name=self.name, given=", ".join(arguments), signature=signature)
