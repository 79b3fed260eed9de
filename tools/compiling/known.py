"""What registers hold, followed along native code: what can be said shorter for it.

From one place that is jumped to to the next it is known which register is a copy of another, which
has a number, and which holds what lies in a slot of the stack.
"""

from collections.abc import Set as AbstractSet

from .thumb import (
    ADD,
    ADDRESS,
    COMPARE,
    LOAD,
    LOOKS,
    LOW_MOVE,
    MOVE,
    NOP,
    SET,
    STORE,
    SUBTRACT,
    Op,
    effects,
)

# Shifts by a register, as arithmetic of two has them, and by a number.
_SHIFTS = {2: 0x0000, 3: 0x0800, 4: 0x1000}


class Block:
    """Goes along the instructions, and knows what registers hold."""

    def __init__(self, ops: "list[Op]", aimed: "AbstractSet[Op]") -> None:
        self._ops = ops
        self._aimed = aimed
        self._shares = any(op.code & 0xF800 == ADDRESS and op.value is None for op in ops)
        self._forget()

    def _forget(self) -> None:
        self._copies: dict[int, int] = {}  # the register that holds the same
        self._numbers: dict[int, int] = {}
        self._slots: dict[int, int] = {}

    def follow(self) -> None:
        """From the first to the last."""
        for op in self._ops:
            if op in self._aimed:
                self._forget()
            if op.value is None and op.target is None:
                self._simplify(op)
            self._note(op)

    def _simplify(self, op: Op) -> None:
        if op.code & 0xF800 == LOAD:
            register = op.code >> 8 & 7
            for holder, slot in self._slots.items():
                if slot == op.code & 0xFF and holder < 8:
                    op.code = NOP if holder == register else MOVE | holder << 3 | register
                    return
            return
        for field in _reads(op.code):
            register = op.code >> field & 7
            op.code += (self._copies.get(register, register) - register) << field
        self._put_number(op)

    def _put_number(self, op: Op) -> None:
        """A number into an instruction that can hold it."""
        code, numbers = op.code, self._numbers
        low, middle, high = code & 7, code >> 3 & 7, code >> 6 & 7
        if code & 0xFFC0 == 0x4280 and middle in numbers:
            op.code = COMPARE | low << 8 | numbers[middle]
        elif code & 0xFC00 == 0x4000 and (code >> 6 & 15) in _SHIFTS:
            if 0 < numbers.get(middle, 0) < 32:
                op.code = _SHIFTS[code >> 6 & 15] | numbers[middle] << 6 | low << 3 | low
        elif code & 0xFC00 in (0x1800, 0x1C00) and code < 0x1C00:
            subtracts = code >> 9 & 1
            if not subtracts and middle in numbers and high not in numbers:
                middle, high = high, middle
            if high in numbers:
                if low == middle:
                    op.code = (SUBTRACT if subtracts else ADD) | low << 8 | numbers[high]
                elif numbers[high] < 8:
                    op.code = 0x1C00 | subtracts << 9 | numbers[high] << 6 | middle << 3 | low

    def _note(self, op: Op) -> None:
        writes = effects(op)[1]
        source, to = moved(op)
        for register in range(15):
            if writes >> register & 1 and not (to == register and source == to):
                self._lose(register)
        register, slot = op.code >> 8 & 7, op.code & 0xFF
        if op.value is not None:
            return
        if op.calls or (self._shares and _stores(op)):
            self._slots.clear()
        if to >= 0 and source != to:
            self._copies[to] = self._copies.get(source, source)
            for known in (self._numbers, self._slots):
                if source in known:
                    known[to] = known[source]
        elif op.code & 0xF800 == SET:
            self._numbers[register] = slot
        elif op.code & 0xF800 == LOAD:
            self._slots[register] = slot
        elif op.code & 0xF800 == STORE:
            self._slots = {r: s for r, s in self._slots.items() if s != slot}
            self._slots[register] = slot

    def _lose(self, register: int) -> None:
        self._copies = {
            to: source for to, source in self._copies.items() if register not in (to, source)
        }
        self._numbers.pop(register, None)
        self._slots.pop(register, None)


def moved(op: Op) -> "tuple[int, int]":
    """From which register to which it moves, both of the lower eight; or -1."""
    if op.value is None and op.code & LOW_MOVE == MOVE:
        return op.code >> 3 & 7, op.code & 7
    return -1, -1


def _stores(op: Op) -> bool:
    """Whether it writes to memory that is not a slot."""
    code = op.code
    return 0x5000 <= code < 0x5600 or (0x6000 <= code < 0x9000 and not code & 0x800)


def _reads(code: int) -> "tuple[int, ...]":
    """Where the registers stand that an instruction reads and does not change."""
    if code < 0x1800:
        return (3,)
    if code < 0x2000:
        return (3,) if code & 0x400 else (3, 6)
    if code & 0xF800 in (COMPARE, STORE):
        return (8,)
    if code & 0xFC00 == 0x4000:
        return (0, 3) if code >> 6 & 15 in LOOKS else (3,)
    if code & LOW_MOVE == MOVE:
        return (3,)
    if 0x5000 <= code < 0x6000:
        return (0, 3, 6) if code < 0x5600 else (3, 6)
    if 0x6000 <= code < 0x9000:
        return (3,) if code & 0x800 else (0, 3)
    return ()
