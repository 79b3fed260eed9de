"""Native code for the Cortex-M0+, shorter: it lies in a board's memory, and there it is run.

MicroPython's compiler writes each expression by itself: a comparison becomes 0 or 1 before it is
looked at, a local is stored and loaded again, a number is put into a register for an instruction
that could hold it. What others can see stays as it is: memory but the function's own stack is read
and written as often, and in the same order.
"""

from collections import Counter
from collections.abc import Set as AbstractSet
from functools import lru_cache

from . import thumb
from .thumb import BRANCH, FLAGS, JUMP, NOP, NotUnderstood, Op, effects

_SLOT = 17  # live: bits of registers, flags, and from this one on the stack's slots
_STORE, _LOAD, _ADDRESS = 0x9000, 0x9800, 0xA800  # of a slot; the register is in bits 8 to 10
_SET, _COMPARE, _ADD, _SUBTRACT = 0x2000, 0x2800, 0x3000, 0x3800  # with a number, the same
_MOVE = 0x4600
_LOW_MOVE = 0xFFC0  # mask of a move between the registers 0 to 7
_EQUAL = BRANCH
# Arithmetic of two registers, by its number.
_AND, _EOR, _NEG, _ORR, _MUL, _MVN = 0, 1, 9, 12, 13, 15
_LOOKS = (8, 10, 11)
_SHIFTS = {2: 0x0000, 3: 0x0800, 4: 0x1000}  # by a register, and by a number


@lru_cache(1024)
def shorter(code: bytes) -> bytes:
    """The code of a function; as it is, where it is not understood."""
    try:
        made = thumb.write(_Function(thumb.read(code)).shortened())
    except NotUnderstood:
        return code
    return made if len(made) < len(code) else code


def slot_effects(op: Op) -> "tuple[int, int]":
    """As effects(), the stack's slots included. Where one's address is taken, all from there on
    are read."""
    reads, writes = effects(op)
    slot = 1 << _SLOT + (op.code & 0xFF)
    match op.code & 0xF800 if op.value is None else 0:
        case 0x9000:
            writes |= slot
        case 0x9800:
            reads |= slot
        case 0xA800:
            reads |= (1 << _SLOT + 256) - slot
    return reads, writes


def live_before(ops: "list[Op]") -> "list[int]":
    """What is read later, in front of each instruction."""
    place = {op: i for i, op in enumerate(ops)}
    known = [slot_effects(op) for op in ops]
    live = [0] * (len(ops) + 1)
    changed = True
    while changed:
        changed = False
        for i in range(len(ops) - 1, -1, -1):
            op = ops[i]
            after = 0 if op.jumps else live[i + 1]
            if op.target:
                after |= live[place[op.target]]
            reads, writes = known[i]
            before = reads | after & ~writes
            if before != live[i]:
                live[i] = before
                changed = True
    return live[:-1]


class _Function:
    """A function, and what is known of it."""

    def __init__(self, ops: "list[Op]") -> None:
        self._ops = ops
        _check_stack(ops)

    def shortened(self) -> "list[Op]":
        """Its instructions, when there is nothing left to do."""
        before = -1
        self._clear()
        while before != self._count():
            before = self._count()
            _Block(self._ops, self._aimed).follow()
            self._clear()
            self._look()
            for i in range(len(self._ops)):
                self._join(i)
            self._clear()
            self._look()
            self._drop_dead()
            self._clear()
        return self._ops

    def _count(self) -> int:
        return sum(2 + (op.value is not None) for op in self._ops)

    # The way through it

    def _clear(self) -> None:
        """Let go of what does nothing, and of what is never come to."""
        before = -1
        while before != len(self._ops):
            before = len(self._ops)
            self._aim()
            for i in range(len(self._ops)):
                self._straighten(i)
            self._reach()
            self._remove()
        self._aim()

    def _aim(self) -> None:
        self._aims = Counter(op.target for op in self._ops if op.target)
        self._aimed = set(self._aims)

    def _straighten(self, i: int) -> None:
        """A jump to a jump, over a jump, or to the next instruction."""
        ops, op = self._ops, self._ops[i]
        if op.target is None:
            return
        far = op.target.target
        if op.target.code == JUMP and far and far is not op.target:
            op.target = far
        if op.target is self._next(i):
            _drop(op)
        elif op.branches and i + 2 < len(ops) and ops[i + 1].code == JUMP:
            if op.target is ops[i + 2] and ops[i + 1] not in self._aimed:
                op.code ^= 0x100
                op.target = ops[i + 1].target
                _drop(ops[i + 1])

    def _next(self, i: int) -> "Op | None":
        return self._ops[i + 1] if i + 1 < len(self._ops) else None

    def _reach(self) -> None:
        place = {op: i for i, op in enumerate(self._ops)}
        left, reached = [0], set()
        while left:
            i = left.pop()
            while i not in reached:
                reached.add(i)
                op = self._ops[i]
                if op.target:
                    left.append(place[op.target])
                if op.jumps:
                    break
                i += 1
                if i == len(self._ops):
                    raise NotUnderstood("no end")
        for i, op in enumerate(self._ops):
            if i not in reached:
                _drop(op)

    def _remove(self) -> None:
        """Those that do nothing; whoever jumps there goes to the next."""
        following: dict[Op, Op] = {}
        kept: list[Op] = []
        for op in reversed(self._ops):
            if op.code == NOP and kept:
                following[op] = kept[-1]
            elif op.code != NOP:
                kept.append(op)
        for op in kept:
            if op.target:
                op.target = following.get(op.target, op.target)
        self._ops = kept[::-1]

    # What is read later

    def _look(self) -> None:
        live = live_before(self._ops)
        place = {op: i for i, op in enumerate(self._ops)}
        self._after = []
        for i, op in enumerate(self._ops):
            after = 0 if op.jumps else live[i + 1]
            self._after.append(after | (live[place[op.target]] if op.target else 0))

    def _drop_dead(self) -> None:
        for op, after in zip(self._ops, self._after):
            if _is_private(op) and not slot_effects(op)[1] & after:
                _drop(op)

    def _join(self, i: int) -> None:
        """Some instructions in a row, none but the first of which is jumped to."""
        ops = self._ops[i : i + 6]
        number = 1
        while number < len(ops) and ops[number] not in self._aimed:
            number += 1
        if len(ops) == 6 and number >= 3:
            self._branch(i)
        if number > 1:
            self._move(i)
        if number > 2:
            self._move_behind(i)
            self._compare(i)

    def _branch(self, i: int) -> None:
        """0 or 1 by a comparison, and a branch by that."""
        branch, no, out, yes, compare, last = self._ops[i : i + 6]
        if not (branch.branches and branch.target is yes and out.code == JUMP):
            return
        if out.target is not compare or compare.code != _COMPARE or not last.branches:
            return
        if (no.code, yes.code) not in ((_SET, _SET | 1), (_SET | 1, _SET)):
            return
        if last.code & 0xFE00 != _EQUAL or last in self._aimed or self._after[i + 5] & (1 | FLAGS):
            return
        if self._aims[yes] != 1 or self._aims[compare] != 1:
            return
        is_one = yes.code == _SET | 1
        if is_one == (last.code == _EQUAL):  # it branches where it is 0, or by the contrary
            branch.code ^= 0x100
        branch.target = last.target
        for op in (no, out, yes, compare, last):
            _drop(op)

    def _move(self, i: int) -> None:
        """A result that is moved on goes there at once."""
        op, move = self._ops[i : i + 2]
        source, to = _moved(move)
        if to < 0 or self._after[i + 1] >> source & 1:
            return
        field = _result(op)
        if field >= 0 and op.code >> field & 7 == source:
            op.code += (to - source) << field
            _drop(move)

    def _move_behind(self, i: int) -> None:
        """The same, where it is made of what the register has had before."""
        first, op, move = self._ops[i : i + 3]
        source, to = _moved(move)
        begin, place = _moved(first)
        if to < 0 or place != source or begin < 0 or self._after[i + 2] >> source & 1:
            return
        if 0x3000 <= op.code < 0x4000 and op.code >> 8 & 7 == source:
            op.code += (to - source) << 8
        elif op.code & 0xFC00 == 0x4000 and op.code & 7 == source:
            operation, other = op.code >> 6 & 15, op.code >> 3 & 7
            if operation in (*_LOOKS, _NEG, _MVN) or other == source:
                return
            if other == to:
                if operation not in (_AND, _EOR, _ORR, _MUL):
                    return
                op.code = op.code & 0xFFC0 | begin << 3 | to
                _drop(first)
                _drop(move)
                return
            op.code += to - source
        else:
            return
        first.code = _MOVE | begin << 3 | to
        _drop(move)

    def _compare(self, i: int) -> None:
        """A comparison with 0 behind an instruction whose result has been compared with it."""
        op, compare, branch = self._ops[i : i + 3]
        if compare.code & 0xF8FF != _COMPARE or branch.code & 0xFE00 != _EQUAL:
            return
        if op.value is None and op.code < 0x4400 and self._after[i + 2] & FLAGS == 0:
            if effects(op)[1] == FLAGS | 1 << (compare.code >> 8 & 7):
                _drop(compare)


class _Block:
    """Goes along the instructions, and knows what registers hold."""

    def __init__(self, ops: "list[Op]", aimed: "AbstractSet[Op]") -> None:
        self._ops = ops
        self._aimed = aimed
        self._shares = any(op.code & 0xF800 == _ADDRESS and op.value is None for op in ops)
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
        if op.code & 0xF800 == _LOAD:
            register = op.code >> 8 & 7
            for holder, slot in self._slots.items():
                if slot == op.code & 0xFF and holder < 8:
                    op.code = NOP if holder == register else _MOVE | holder << 3 | register
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
            op.code = _COMPARE | low << 8 | numbers[middle]
        elif code & 0xFC00 == 0x4000 and (code >> 6 & 15) in _SHIFTS:
            if 0 < numbers.get(middle, 0) < 32:
                op.code = _SHIFTS[code >> 6 & 15] | numbers[middle] << 6 | low << 3 | low
        elif code & 0xFC00 in (0x1800, 0x1C00) and code < 0x1C00:
            subtracts = code >> 9 & 1
            if not subtracts and middle in numbers and high not in numbers:
                middle, high = high, middle
            if high in numbers:
                if low == middle:
                    op.code = (_SUBTRACT if subtracts else _ADD) | low << 8 | numbers[high]
                elif numbers[high] < 8:
                    op.code = 0x1C00 | subtracts << 9 | numbers[high] << 6 | middle << 3 | low

    def _note(self, op: Op) -> None:
        writes = effects(op)[1]
        source, to = _moved(op)
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
        elif op.code & 0xF800 == _SET:
            self._numbers[register] = slot
        elif op.code & 0xF800 == _LOAD:
            self._slots[register] = slot
        elif op.code & 0xF800 == _STORE:
            self._slots = {r: s for r, s in self._slots.items() if s != slot}
            self._slots[register] = slot

    def _lose(self, register: int) -> None:
        self._copies = {
            to: source for to, source in self._copies.items() if register not in (to, source)
        }
        self._numbers.pop(register, None)
        self._slots.pop(register, None)


def _drop(op: Op) -> None:
    op.code, op.target, op.value = NOP, None, None


def _moved(op: Op) -> "tuple[int, int]":
    """From which register to which it moves, both of the lower eight; or -1."""
    if op.value is None and op.code & _LOW_MOVE == _MOVE:
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
    if code & 0xF800 in (_COMPARE, _STORE):
        return (8,)
    if code & 0xFC00 == 0x4000:
        return (0, 3) if code >> 6 & 15 in _LOOKS else (3,)
    if code & _LOW_MOVE == _MOVE:
        return (3,)
    if 0x5000 <= code < 0x6000:
        return (0, 3, 6) if code < 0x5600 else (3, 6)
    if 0x6000 <= code < 0x9000:
        return (3,) if code & 0x800 else (0, 3)
    return ()


def _result(op: Op) -> int:
    """Where the register stands that an instruction writes and does not read; -1: nowhere."""
    code = op.code
    if op.value is not None or code & 0xF800 in (_SET, _LOAD, _ADDRESS):
        return 8
    if code < 0x2000 or code & _LOW_MOVE == _MOVE:
        return 0
    if code & 0xFC00 == 0x4000:
        return 0 if code >> 6 & 15 in (_NEG, _MVN) else -1
    if 0x5600 <= code < 0x6000 or (0x6000 <= code < 0x9000 and code & 0x800):
        return 0
    return -1


def _is_private(op: Op) -> bool:
    """Whether it does nothing but write registers, flags and slots."""
    code = op.code
    if op.target or op.calls or code == NOP:
        return False
    if op.value is not None or code < 0x4700 or 0x9000 <= code < 0xB000:
        return True
    return code & 0xFF00 == 0xB200


def _check_stack(ops: "list[Op]") -> None:
    """Raises NotUnderstood where slots are not counted from the same place throughout."""
    pushed = 0
    for op in ops:
        if op.value is None and op.target is None:
            if op.code & 0xFF00 == 0xB400:
                pushed += 1
            elif op.code & 0xFF00 == 0xBC00:
                pushed -= 1
            elif pushed and 0x9000 <= op.code < 0xB000:
                raise NotUnderstood("a slot behind a push")
