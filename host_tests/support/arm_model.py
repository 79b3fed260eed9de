"""A board's kernels as machine code, run on this computer by the emulator Unicorn.

The code lies at one address of its memory, the kernels' arguments at another. Of MicroPython only
those functions exist that the code calls through its table (py/nativeglue.h), as far as integers
need them.
"""

import struct
from array import array
from collections.abc import Callable
from typing import Any

from ugrbl.compiling import build, machine_code
from ugrbl.compiling.viper import Key, Module
from unicorn import UC_ARCH_ARM, UC_HOOK_CODE, UC_MODE_MCLASS, UC_MODE_THUMB, Uc
from unicorn.arm_const import (
    UC_ARM_REG_LR,
    UC_ARM_REG_PC,
    UC_ARM_REG_R0,
    UC_ARM_REG_R1,
    UC_ARM_REG_R2,
    UC_ARM_REG_R3,
    UC_ARM_REG_SP,
    UC_CPU_ARM_CORTEX_M0,
    UC_CPU_ARM_CORTEX_M33,
)

_CPUS = {"armv6m": UC_CPU_ARM_CORTEX_M0, "armv7emsp": UC_CPU_ARM_CORTEX_M33}
_REGISTERS = (UC_ARM_REG_R0, UC_ARM_REG_R1, UC_ARM_REG_R2, UC_ARM_REG_R3)

CODE = 0x2000_0000
_HEAP = 0x2010_0000
_STACK_END = 0x2030_0000
_PYTHON = 0x1000_0000  # MicroPython's functions, one every 4 bytes, and their table
_TABLE = _PYTHON + 0x1000
_BACK = _PYTHON + 0x800
_BX_LR = 0x4770
_ENTRIES = 100

_FROM_OBJECT, _TO_OBJECT, _IS_TRUE, _NEW_TUPLE, _CALL = 3, 4, 16, 19, 27
_QUOTIENT, _MODULO, _TYPE_OF_FUNCTIONS = 46, 47, 81
_TYPE = 0x1234_5678


def signed(value: int) -> int:
    """Return a word as a signed integer."""
    return (value & 0xFFFFFFFF) - ((value & 0x8000_0000) << 1)


def kernels_of(arch: str) -> "tuple[str, list[Key]]":
    """Return the C text of all kernels, and their keys."""
    apart = build.prepared(arch)
    return apart.c, [key for keys in apart.pieces.values() for key in keys]


def c_of(text: str) -> "tuple[str, list[Key]]":
    """Return the same for a module given as text."""
    module = Module("made", "import micropython\n" + text)
    keys = [("made", name) for name in module.functions]
    return machine_code.in_c({"made": module}, keys), keys


class Board:
    """Memory with that code in it, shifted by `moved` bytes."""

    def __init__(self, c: str, keys: "list[Key]", arch: str = "armv6m", moved: int = 0) -> None:
        self.code = machine_code.linked(c, arch, tuple(keys))
        self._cpu = Uc(UC_ARCH_ARM, UC_MODE_THUMB | UC_MODE_MCLASS)
        self._cpu.ctl_set_cpu_model(_CPUS[arch])
        self._cpu.mem_map(CODE, _STACK_END - CODE)
        self._cpu.mem_map(_PYTHON, 0x2000)
        self._cpu.mem_write(_PYTHON, struct.pack("<H", _BX_LR) * 0x800)
        entries = [(_PYTHON + 4 * i) | 1 for i in range(_ENTRIES)]
        entries[_TYPE_OF_FUNCTIONS] = _TYPE
        self._cpu.mem_write(_TABLE, struct.pack(f"<{_ENTRIES}I", *entries))
        self._cpu.hook_add(UC_HOOK_CODE, self._asked, begin=_PYTHON, end=_PYTHON + 0x7FF)
        self._place = CODE + moved
        self._cpu.mem_write(self._place, self.code)
        self._free = _HEAP
        self._objects: list[Any] = []
        self.heard: list[int] = []
        self.instructions = 0
        self.functions = self._start(keys)

    def _start(self, keys: "list[Key]") -> "dict[Key, int]":
        """Return the code address of each function, from its object."""
        objects = self.put(struct.pack("<I", _TABLE))
        context = self.put(struct.pack("<4I", 0, 0, 0, objects))
        itself = self.put(struct.pack("<2I", 0, context))
        made = self.run(self._place, itself) & 0xFFFFFFFF
        count, *items = struct.unpack(
            f"<{1 + len(keys)}I", self._cpu.mem_read(made + 4, 4 + 4 * len(keys))
        )
        assert count == len(keys)
        found = {}
        for key, item in zip(keys, items, strict=True):
            kind, _, code = struct.unpack("<3I", self._cpu.mem_read(item, 12))
            assert kind == _TYPE
            assert self._place <= code < self._place + len(self.code)
            found[key] = code
        return found

    def put(self, content: bytes) -> int:
        """Write content into memory; return its address."""
        at = self._free
        self._free += len(content) + 15 & ~15
        self._cpu.mem_write(at, content)
        return at

    def call(self, key: Key, *arguments: Any) -> int:
        """Call a kernel with integers, buffers (it may change them) and callables."""
        mark, self._objects = self._free, []
        given, buffers = [], []
        for argument in arguments:
            if isinstance(argument, int):
                given.append(self._object(argument))
            elif argument is None or callable(argument):
                given.append(self._keep(argument))
            else:
                view = memoryview(argument).cast("B")
                at = self.put(view.tobytes())
                buffers.append((view, at))
                given.append(at << 1 | 1)
        at = self.put(struct.pack(f"<{len(given)}I", *given))
        result = self._value(self.run(self.functions[key], len(given), at))
        for view, at in buffers:
            if not view.readonly:
                view[:] = bytes(self._cpu.mem_read(at, len(view)))
        self._free = mark
        return result

    def run(self, code: int, *registers: int) -> int:
        """Run from this address until it returns."""
        for register, value in zip(_REGISTERS, registers, strict=False):
            self._cpu.reg_write(register, value)
        self._cpu.reg_write(UC_ARM_REG_SP, _STACK_END - 16)
        self._cpu.reg_write(UC_ARM_REG_LR, _BACK | 1)
        self._cpu.emu_start(code | 1, _BACK, count=10_000_000)
        assert self._cpu.reg_read(UC_ARM_REG_PC) & ~1 == _BACK
        return int(self._cpu.reg_read(UC_ARM_REG_R0))

    # MicroPython

    def _object(self, value: int) -> int:
        if -(1 << 30) <= value < 1 << 30:
            return (value << 1 | 1) & 0xFFFFFFFF
        return self._keep(value)

    def _keep(self, thing: Any) -> int:
        self._objects.append(thing)
        return 4 * len(self._objects)

    def _value(self, thing: int) -> Any:
        thing &= 0xFFFFFFFF
        return signed(thing) >> 1 if thing & 1 else self._objects[thing // 4 - 1]

    def _asked(self, _cpu: Uc, at: int, _size: int, _data: object) -> None:
        """Execute a MicroPython function when the code calls it; the code then returns at once."""
        a, b, c = (int(self._cpu.reg_read(register)) for register in _REGISTERS[:3])
        answers: dict[int, Callable[[], int]] = {
            _FROM_OBJECT: lambda: self._value(a),
            _TO_OBJECT: lambda: self._object(signed(a)),
            _IS_TRUE: lambda: bool(self._value(a)),
            _NEW_TUPLE: lambda: self.put(struct.pack("<2I", 0, a) + bytes(4 * a)),
            _CALL: lambda: self._called(a, b, c),
            _QUOTIENT: lambda: signed(a) // signed(b),
            _MODULO: lambda: signed(a) % signed(b),
        }
        self._cpu.reg_write(UC_ARM_REG_R0, answers[(at - _PYTHON) // 4]() & 0xFFFFFFFF)

    def _called(self, function: int, count: int, at: int) -> int:
        given = struct.unpack(f"<{count}I", self._cpu.mem_read(at, 4 * count))
        return self._object(self._value(function)(*map(self._value, given)))


def use(board: Board, apart: "Callable[[str, str], bool]" = lambda module, name: True) -> None:
    """Run the firmware's kernels on the board, from the next import of a firmware module on."""
    import micropython

    def find(module: str, name: str) -> "Callable[..., int] | None":
        key = (module, name)
        if key not in board.functions or not apart(*key):
            return None
        return lambda *arguments: board.call(key, *map(_plain, arguments))

    micropython.compiled = find


def _plain(argument: Any) -> Any:
    """Convert an argument of the stand-in for a kernel."""
    return argument if not isinstance(argument, array) else memoryview(argument)
