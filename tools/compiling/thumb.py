"""Thumb, the Cortex-M0+'s instructions, as MicroPython's compiler writes them: read and written.

Jumps and constants stand for what they mean, so that instructions between can go: a jump forward
is written for the farthest target there may be, with its rest filled up, and a constant of more
than 16 bits stands in the middle of the code, with a jump around it. Written again, each takes as
little as it can. What the compiler does not write is not understood.
"""

import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

FLAGS = 1 << 16  # beside a bit for each register
LR = 1 << 14
ALL = 0xFF
_CALL_READS = 0xF | ALL & 0xF0  # arguments, and whatever an exception goes back to
_CALL_WRITES = 0xF | LR | FLAGS

NOP = 0xBF00
# A word of the function's own in the middle of its code, 0 at first, and a jump around it.
CELL = 0x1E002
JUMP = 0xE000
BRANCH = 0xD000  # with a condition, in four bits
LOAD_CONSTANT = 0x4800
# A slot of the stack, and a number: the register is in bits 8 to 10.
STORE, LOAD, ADDRESS = 0x9000, 0x9800, 0xA800
SET, COMPARE, ADD, SUBTRACT = 0x2000, 0x2800, 0x3000, 0x3800
MOVE = 0x4600
LOW_MOVE = 0xFFC0  # mask of a move between the registers 0 to 7
LOOKS = (8, 10, 11)  # arithmetic of two registers that only sets flags, by its number

_JUMP_FAR = 0x448F  # add pc, r1
_OVER_WORD = 0xE001
_FURTHEST_JUMP = 2046
_FURTHEST_BRANCH = 254
_FURTHEST_POOL = 1020
_FAR = 10  # bytes of a jump or constant that does not reach
_CELL_BYTES = 8  # of a cell, with what is around it


class NotUnderstood(ValueError):
    """Code that the compiler does not write."""


@dataclass(eq=False)
class Op:
    """An instruction. target: of a jump or branch; value: the constant it loads; cell: the word
    that it loads, or whose address."""

    code: int
    target: "Op | None" = None
    value: "int | None" = None
    cell: "Op | None" = None

    @property
    def jumps(self) -> bool:
        """Whether what is behind it is never come to from it."""
        return self.code == JUMP or self.code & 0xFF00 == 0xBD00

    @property
    def branches(self) -> bool:
        """A conditional jump."""
        return self.code & 0xF000 == BRANCH

    @property
    def calls(self) -> bool:
        """A call."""
        return self.code & 0xFF87 == 0x4780


def drop(op: Op) -> None:
    """Have it do nothing."""
    op.code, op.target, op.value = NOP, None, None


def read(code: bytes) -> "list[Op]":
    """The instructions of a function."""
    words = struct.unpack(f"<{len(code) // 2}H", code)
    ops: dict[int, Op] = {}
    targets: list[tuple[Op, int]] = []
    at = 0
    while at < len(words):
        op, length, target = _read_one(words, at)
        ops[at] = op
        if target is not None:
            targets.append((op, target))
        at += length
    for op, target in targets:
        if target not in ops:
            raise NotUnderstood(f"a jump to {target}")
        op.target = ops[target]
    return list(ops.values())


def _read_one(words: "Sequence[int]", at: int) -> "tuple[Op, int, int | None]":
    """An instruction, how many half words it takes, and where it jumps to."""
    word = words[at]
    if word & 0xF800 == LOAD_CONSTANT:
        if at & 1 or word & 0xFF:
            raise NotUnderstood("a constant elsewhere")
        value = words[at + 2] | words[at + 3] << 16
        if words[at + 1] == _OVER_WORD:
            return Op(word, value=value), 4, None
        if words[at + 1] == _JUMP_FAR and word == LOAD_CONSTANT | 0x100:
            return Op(JUMP), 4, at + 3 + _signed(value, 32) // 2
    if word & 0xF000 == BRANCH and word < 0xDE00:
        return Op(word & 0xFF00), 1, at + 2 + _signed(word & 0xFF, 8)
    if word & 0xF800 == JUMP:
        return Op(JUMP), 1, at + 2 + _signed(word & 0x7FF, 11)
    effects(Op(word))
    return Op(word), 1, None


def _signed(value: int, bits: int) -> int:
    return value - (value >> (bits - 1) << bits)


def effects(op: Op) -> "tuple[int, int]":
    """What it reads, and what it writes."""
    code = op.code
    low, middle, high = 1 << (code & 7), 1 << (code >> 3 & 7), 1 << (code >> 6 & 7)
    eight = 1 << (code >> 8 & 7)
    if code < 0x1800:
        return middle, low | FLAGS
    if code < 0x2000:
        return middle | (0 if code & 0x400 else high), low | FLAGS
    if code < 0x4000:
        operation = code >> 11 & 3
        return 0 if operation == 0 else eight, FLAGS | (0 if operation == 1 else eight)
    if code < 0x4400:
        return _arithmetic(code >> 6 & 15, low, middle)
    if code < 0x4800:
        return _with_high(op)
    if code < 0x5000:
        return 0, eight
    if code < 0x6000:
        stores = code >> 9 & 7 < 3
        return middle | high | (low if stores else 0), 0 if stores else low
    if code < 0x9000:
        loads = code & 0x800
        return middle | (0 if loads else low), low if loads else 0
    if code < 0xA000:
        return (0, eight) if code & 0x800 else (eight, 0)
    if code < 0xB000:
        return 0, eight
    return _rest(op)


def _arithmetic(operation: int, low: int, middle: int) -> "tuple[int, int]":
    if operation in (8, 10, 11):  # tst, cmp, cmn
        return low | middle, FLAGS
    if operation in (9, 15):  # neg, mvn
        return middle, low | FLAGS
    if operation in (5, 6):  # adc, sbc
        return low | middle | FLAGS, low | FLAGS
    return low | middle, low | FLAGS


def _with_high(op: Op) -> "tuple[int, int]":
    code = op.code
    if op.calls:
        return _CALL_READS | 1 << (code >> 3 & 15), _CALL_WRITES
    to, source = code & 7 | code >> 4 & 8, code >> 3 & 15
    if code >= 0x4700 or 15 in (to, source):
        raise NotUnderstood(f"{code:04x}")
    if code >= 0x4600:
        return 1 << source, 1 << to
    return 1 << source | 1 << to, FLAGS if code >= 0x4500 else 1 << to


def _rest(op: Op) -> "tuple[int, int]":
    code = op.code
    if op.branches:
        return FLAGS, 0
    if code in (JUMP, NOP, CELL) or code & 0xFF00 == 0xB000:
        return 0, 0
    if code & 0xFF00 == 0xB200:  # sxth and the like
        return 1 << (code >> 3 & 7), 1 << (code & 7)
    if code & 0xFE00 == 0xB400:
        return code & 0xFF, 0
    if code & 0xFF00 == 0xBC00:
        return 0, code & 0xFF
    if code & 0xFF00 == 0xBD00:
        return 1, 0
    raise NotUnderstood(f"{code:04x}")


# Written


def write(ops: "Sequence[Op]") -> bytes:
    """Code of these instructions. A jump that is far takes register 1, as the compiler's do."""
    return _Layout(ops).code()


class _Layout:
    """Where each instruction comes to stand. Jumps and constants are far to begin with."""

    def __init__(self, ops: "Sequence[Op]") -> None:
        self._ops = ops
        self._size = {op: _most(op) for op in ops}
        self._at: dict[Op, int] = {}
        self._end = 0

    def code(self) -> bytes:
        """The bytes."""
        while self._closer():
            pass
        near = [x.value for x in self._ops if x.value is not None and self._size[x] == 2]
        self._lay_pool(sum(self._size.values()), near)
        made = b"".join(self._written(op) for op in self._ops)
        made += bytes(self._end - len(made))
        return made + b"".join(struct.pack("<I", value) for value in self._pool)

    def _closer(self) -> bool:
        """Lay them out; whether any takes less room now."""
        at = 0
        for op in self._ops:
            self._at[op] = at
            at += self._size[op]
        self._lay_pool(at, [op.value for op in self._ops if op.value is not None])
        less = {op: size for op in self._ops if (size := self._least(op)) < self._size[op]}
        self._size.update(less)
        return bool(less)

    def _lay_pool(self, at: int, values: "Iterable[int]") -> None:
        self._end = at + (at & 2) if values else at
        self._pool = {value: self._end + 4 * i for i, value in enumerate(dict.fromkeys(values))}

    def _least(self, op: Op) -> int:
        """What it takes as they stand now, who can only come closer."""
        if op.value is not None:
            return 2 if self._pool[op.value] - self._at[op] <= _FURTHEST_POOL else _FAR
        if op.target is None:
            return _CELL_BYTES if op.code == CELL else 2
        way = abs(self._at[op.target] - self._at[op] - 4)
        if op.branches:
            return 2 if way <= _FURTHEST_BRANCH else 4 if way < _FURTHEST_JUMP else _FAR + 2
        return 2 if way <= _FURTHEST_JUMP else _FAR

    def _written(self, op: Op) -> bytes:
        at, size = self._at[op], self._size[op]
        if op.value is not None:
            if size == 2:
                return _words(op.code | (self._pool[op.value] - (at + 4 & -4)) // 4)
            return _aligned(at, [op.code, _OVER_WORD + (at & 2 == 0)], op.value)
        if op.cell:
            return _words(op.code | ((self._at[op.cell] + 4 & -4) - (at + 4 & -4)) // 4)
        if op.code == CELL:
            return _words(JUMP | 2, *((0, 0, NOP) if at & 2 else (NOP, 0, 0)))
        if op.target is None:
            return _words(op.code)
        way = self._at[op.target] - at - 4
        if not op.branches:
            return _jump(at, way, size)
        if size == 2:
            return _words(op.code | way // 2 & 0xFF)
        return _words((op.code ^ 0x100) | (size - 4) // 2) + _jump(at + 2, way - 2, size - 2)


def _most(op: Op) -> int:
    if op.target is not None or op.value is not None:
        return _FAR + 2 * op.branches
    return _CELL_BYTES if op.code == CELL else 2


def _jump(at: int, way: int, size: int) -> bytes:
    if size == 2:
        return _words(JUMP | way // 2 & 0x7FF)
    way -= 2 + (at & 2)
    return _aligned(at, [LOAD_CONSTANT | 0x100, _JUMP_FAR], way & 0xFFFFFFFF)


def _aligned(at: int, before: "list[int]", word: int) -> bytes:
    """Two instructions and a word behind them, which stands where words stand."""
    words = [*before, word & 0xFFFF, word >> 16]
    return _words(*([NOP, *words] if at & 2 else [*words, NOP]))


def _words(*words: int) -> bytes:
    return struct.pack(f"<{len(words)}H", *words)
