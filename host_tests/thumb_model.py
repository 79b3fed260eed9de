"""The Cortex-M0+'s instructions, run one by one: what a function does that others can see.

Memory outside its stack, and what a call returns, are made up as they are looked at, from a seed:
two functions that do the same see the same. Told are loads and stores there, in their order, and
calls with registers 0 to 3 and what these show of the stack.
"""

import random
import struct
from typing import Any

_STACK = 0x2000_0000
_STACK_WORDS = 1024
_ENTRY = 0x2000_0000 + 4 * 900  # of the stack pointer
CODE = 0x3000_0000
_END = 0xFFFF_FFFE  # where the function returns to
_MASK = 0xFFFFFFFF
FAR = 0xFA12FA12  # in register 1 behind a far jump: there is nothing in it


class Run:
    """One call of a function with arguments of its own."""

    def __init__(self, code: bytes, seed: int) -> None:
        self._code = code
        self._dice = random.Random(seed)
        self._seed = seed
        self.told: "list[tuple[Any, ...]]" = []
        self._memory: dict[int, int] = {}
        start = [self._dice.getrandbits(32) for _ in range(_STACK_WORDS)]
        self._stack = bytearray(struct.pack(f"<{_STACK_WORDS}I", *start))
        self._r = [self._any() for _ in range(16)]
        self._r[0] = 0x1000_0000  # the function itself
        self._r[13], self._r[14], self._r[15] = _ENTRY, _END | 1, CODE
        self._n = self._z = self._c = self._v = 0

    def _any(self) -> int:
        """What a word may hold: a small number, often."""
        kind = self._dice.randrange(4)
        return self._dice.getrandbits((3, 8, 30, 32)[kind])

    def go(self, steps: int) -> "list[tuple[Any, ...]]":
        """Run it to its end, or so many instructions; what it has done."""
        while steps and self._r[15] != _END:
            steps -= 1
            at = self._r[15]
            word = struct.unpack_from("<H", self._code, at - CODE)[0]
            self._r[15] = at + 2
            self._one(word, at)
        if self._r[15] == _END:
            self.told.append(("ends", self._r[0], self._r[4:8], self._r[13]))
        return self.told

    # Memory

    def _load(self, at: int, size: int, signed: bool = False) -> int:
        if CODE <= at < CODE + len(self._code):
            return int.from_bytes(self._code[at - CODE : at - CODE + size], "little")
        if _STACK <= at < _STACK + 4 * _STACK_WORDS:
            at -= _STACK
            return int.from_bytes(self._stack[at : at + size], "little", signed=signed) & _MASK
        if at not in self._memory:
            self._memory[at] = random.Random(f"{self._seed} {at} {size}").choice(
                [self._any_at(at, bits) for bits in (1, 8, 30, 32)]
            )
        value = self._memory[at] & (1 << 8 * size) - 1
        self.told.append(("load", at, size, value))
        return (value - (value >> 8 * size - 1 << 8 * size)) & _MASK if signed else value

    def _any_at(self, at: int, bits: int) -> int:
        return random.Random(f"{self._seed} {at} {bits}").getrandbits(bits)

    def _store(self, at: int, size: int, value: int) -> None:
        value &= (1 << 8 * size) - 1
        if CODE <= at < CODE + len(self._code):
            at -= CODE
            self._code = self._code[:at] + value.to_bytes(size, "little") + self._code[at + size :]
            return
        if _STACK <= at < _STACK + 4 * _STACK_WORDS:
            self._stack[at - _STACK : at - _STACK + size] = value.to_bytes(size, "little")
            return
        self.told.append(("store", at, size, value))
        self._memory[at] = value

    # Instructions

    def _one(self, word: int, at: int) -> None:
        if word < 0x2000:
            self._shift_or_add(word)
        elif word < 0x4000:
            self._number(word)
        elif word < 0x4400:
            self._arithmetic(word)
        elif word < 0x4800:
            self._high(word)
        elif word < 0x5000:
            self._r[word >> 8 & 7] = self._load((at + 4 & ~3) + 4 * (word & 0xFF), 4)
        elif word < 0xA000:
            self._access(word)
        elif word & 0xF800 == 0xA000:
            self._r[word >> 8 & 7] = (at + 4 & ~3) + 4 * (word & 0xFF)
        elif word & 0xF800 == 0xA800:
            self._r[word >> 8 & 7] = self._r[13] + 4 * (word & 0xFF)
        elif word & 0xFF00 == 0xB000:
            self._r[13] += -4 * (word & 0x7F) if word & 0x80 else 4 * (word & 0x7F)
        elif word & 0xFF00 == 0xB200:
            self._extend(word)
        elif word & 0xF800 == 0xF000:  # the first half of a call to another place of this code
            self._r[14] = self._r[15] + 2 | 1
            far = struct.unpack_from("<H", self._code, self._r[15] - CODE)[0]
            self._r[15] = at + 4 + ((word & 0x7FF ^ 0x400) - 0x400 << 12) + ((far & 0x7FF) << 1)
        elif word & 0xF600 == 0xB400:
            self._push_or_pop(word)
        elif word & 0xF000 == 0xD000:
            if self._holds(word >> 8 & 15):
                self._r[15] = at + 4 + 2 * ((word & 0xFF ^ 0x80) - 0x80)
        elif word & 0xF800 == 0xE000:
            self._r[15] = at + 4 + 2 * ((word & 0x7FF ^ 0x400) - 0x400)
        else:
            assert word == 0xBF00, f"{word:04x}"

    def _put(self, register: int, value: int) -> None:
        """A result, with what the flags say of it."""
        self._r[register] = value = value & _MASK
        self._n, self._z = value >> 31, int(value == 0)

    def _add(self, a: int, b: int, carry: int) -> int:
        total = a + b + carry
        value = total & _MASK
        self._c = total >> 32
        self._n, self._z = value >> 31, int(value == 0)
        self._v = ((a ^ value) & (b ^ value)) >> 31 & 1
        return value

    def _shifted(self, kind: int, value: int, by: int) -> int:
        if by == 0:
            return value
        if kind == 0:
            self._c = value >> 32 - by & 1 if by <= 32 else 0
            return value << by & _MASK
        if kind == 2 and value >> 31:
            value -= 1 << 32
        self._c = value >> min(by, 33) - 1 & 1
        return value >> min(by, 33) & _MASK

    def _shift_or_add(self, word: int) -> None:
        low, middle, high = word & 7, self._r[word >> 3 & 7], word >> 6 & 7
        if word < 0x1800:
            by = word >> 6 & 31
            kind = word >> 11
            self._put(low, self._shifted(kind, middle, by or (32 if kind else 0)))
            return
        other = high if word & 0x400 else self._r[high]
        subtracts = word >> 9 & 1
        self._r[low] = self._add(middle, other ^ (_MASK if subtracts else 0), subtracts)

    def _number(self, word: int) -> None:
        register, number = word >> 8 & 7, word & 0xFF
        kind = word >> 11 & 3
        if kind == 0:
            self._put(register, number)
            return
        value = self._add(self._r[register], number ^ (0 if kind == 2 else _MASK), kind != 2)
        if kind != 1:
            self._r[register] = value

    def _arithmetic(self, word: int) -> None:
        kind, low, b = word >> 6 & 15, word & 7, self._r[word >> 3 & 7]
        a = self._r[low]
        if kind in (2, 3, 4):
            self._put(low, self._shifted(kind - 2, a, b & 0xFF))
        elif kind == 5:
            self._r[low] = self._add(a, b, self._c)
        elif kind == 6:
            self._r[low] = self._add(a, b ^ _MASK, self._c)
        elif kind == 9:
            self._r[low] = self._add(0, b ^ _MASK, 1)
        elif kind in (10, 11):
            self._add(a, b ^ _MASK if kind == 10 else b, kind == 10)
        elif kind == 8:
            value = a & b
            self._n, self._z = value >> 31, int(value == 0)
        else:
            results = {0: a & b, 1: a ^ b, 12: a | b, 13: a * b, 14: a & ~b, 15: ~b}
            self._put(low, results[kind])

    def _high(self, word: int) -> None:
        to, source = word & 7 | word >> 4 & 8, word >> 3 & 15
        value = self._r[source] + (2 if source == 15 else 0)
        if word & 0xFF80 == 0x4780:
            self._call(value)
        elif word >= 0x4600:
            assert word < 0x4700 and to != 15
            self._r[to] = value
        elif word >= 0x4500:
            self._add(self._r[to], value ^ _MASK, 1)
        else:
            self._r[to] = self._r[to] + value + (2 if to == 15 else 0) & _MASK
            if to == 15:  # a far jump, for which the compiler gives up register 1
                self._r[1] = FAR

    def _call(self, function: int) -> None:
        shown = [
            bytes(self._stack[max(x - _STACK, 0) :])
            for x in self._r[:4]
            if self._r[13] <= x < _ENTRY
        ]
        self.told.append(("call", function, self._r[:4], shown))
        dice = random.Random(f"{self._seed} {len(self.told)}")
        for i in range(4):
            self._r[i] = dice.getrandbits(dice.choice((1, 8, 32)))
        self._n, self._z, self._c, self._v = (dice.getrandbits(1) for _ in range(4))

    def _access(self, word: int) -> None:
        low, base, high = word & 7, self._r[word >> 3 & 7], word >> 6 & 31
        if word >= 0x9000:
            at, register = self._r[13] + 4 * (word & 0xFF), word >> 8 & 7
            size, loads, signed, low = 4, word & 0x800, False, register
        elif word >= 0x6000:
            size = {0x6000: 4, 0x7000: 1, 0x8000: 2}[word & 0xF000]
            at, loads, signed = base + high * size & _MASK, word & 0x800, False
        else:
            kind = word >> 9 & 7
            at = base + self._r[high & 7] & _MASK
            size, loads, signed = (4, 2, 1, 1, 4, 2, 1, 2)[kind], kind > 2, kind in (3, 7)
        if loads:
            self._r[low] = self._load(at, size, signed)
        else:
            self._store(at, size, self._r[low])

    def _extend(self, word: int) -> None:
        value, kind = self._r[word >> 3 & 7], word >> 6 & 3
        bits = 8 if kind & 1 else 16
        value &= (1 << bits) - 1
        if kind < 2:
            value = (value ^ 1 << bits - 1) - (1 << bits - 1)
        self._r[word & 7] = value & _MASK

    def _push_or_pop(self, word: int) -> None:
        registers = [i for i in range(8) if word >> i & 1]
        if word & 0x100:
            registers.append(15 if word & 0x800 else 14)
        if word & 0x800:
            for register in registers:
                self._r[register] = self._load(self._r[13], 4) & (~1 if register == 15 else _MASK)
                self._r[13] += 4
        else:
            self._r[13] -= 4 * len(registers)
            for i, register in enumerate(registers):
                self._store(self._r[13] + 4 * i, 4, self._r[register])

    def _holds(self, condition: int) -> bool:
        n, z, c, v = self._n, self._z, self._c, self._v
        held = (z, c, n, v, c and not z, n == v, not z and n == v)[condition >> 1]
        return bool(held) != bool(condition & 1)
