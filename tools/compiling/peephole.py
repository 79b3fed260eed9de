"""Native code for the Cortex-M0+, shorter: it lies in a board's memory, and there it is run.

MicroPython's compiler writes each expression by itself: a comparison becomes 0 or 1 before it is
looked at, a local is stored and loaded again, a number is put into a register for an instruction
that could hold it. What others can see stays as it is: memory but the function's own stack is read
and written as often, and in the same order.
"""

from collections import Counter
from functools import lru_cache

from . import thumb
from .known import Block, moved
from .thumb import (
    ADDRESS,
    BRANCH,
    COMPARE,
    FLAGS,
    JUMP,
    LOAD,
    LOOKS,
    LOW_MOVE,
    MOVE,
    NOP,
    SET,
    NotUnderstood,
    Op,
    drop,
    effects,
)

_SLOT = 17  # live: bits of registers, flags, and from this one on the stack's slots
_EQUAL = BRANCH
# Arithmetic of two registers, by its number.
_AND, _EOR, _NEG, _ORR, _MUL, _MVN = 0, 1, 9, 12, 13, 15


@lru_cache(1024)
def shorter(code: bytes) -> bytes:
    """The code of a function; as it is, where it is not understood."""
    try:
        made = shortened(thumb.read(code))
    except NotUnderstood:
        return code
    return made if len(made) < len(code) else code


def shortened(ops: "list[Op]") -> bytes:
    """The code of these instructions. Raises NotUnderstood where it is not."""
    return thumb.write(_Function(ops).shortened())


def slot_effects(op: Op) -> "tuple[int, int]":
    """As effects(), the stack's slots included. Where one's address is taken, all from there on
    are read."""
    reads, writes = effects(op)
    slot = 1 << _SLOT + (op.code & 0xFF)
    match op.code & 0xF800 if op.value is None else 0:
        case thumb.STORE:
            writes |= slot
        case thumb.LOAD:
            reads |= slot
        case thumb.ADDRESS:
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
            Block(self._ops, self._aimed).follow()
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
            drop(op)
        elif op.branches and i + 2 < len(ops) and ops[i + 1].code == JUMP:
            if op.target is ops[i + 2] and ops[i + 1] not in self._aimed:
                op.code ^= 0x100
                op.target = ops[i + 1].target
                drop(ops[i + 1])

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
                drop(op)

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
                drop(op)

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
        if out.target is not compare or compare.code != COMPARE or not last.branches:
            return
        if (no.code, yes.code) not in ((SET, SET | 1), (SET | 1, SET)):
            return
        if last.code & 0xFE00 != _EQUAL or last in self._aimed or self._after[i + 5] & (1 | FLAGS):
            return
        if self._aims[yes] != 1 or self._aims[compare] != 1:
            return
        is_one = yes.code == SET | 1
        if is_one == (last.code == _EQUAL):  # it branches where it is 0, or by the contrary
            branch.code ^= 0x100
        branch.target = last.target
        for op in (no, out, yes, compare, last):
            drop(op)

    def _move(self, i: int) -> None:
        """A result that is moved on goes there at once."""
        op, move = self._ops[i : i + 2]
        source, to = moved(move)
        if to < 0 or self._after[i + 1] >> source & 1:
            return
        field = _result(op)
        if field >= 0 and op.code >> field & 7 == source:
            op.code += (to - source) << field
            drop(move)

    def _move_behind(self, i: int) -> None:
        """The same, where it is made of what the register has had before."""
        first, op, move = self._ops[i : i + 3]
        source, to = moved(move)
        begin, place = moved(first)
        if to < 0 or place != source or begin < 0 or self._after[i + 2] >> source & 1:
            return
        if 0x3000 <= op.code < 0x4000 and op.code >> 8 & 7 == source:
            op.code += (to - source) << 8
        elif op.code & 0xFC00 == 0x4000 and op.code & 7 == source:
            operation, other = op.code >> 6 & 15, op.code >> 3 & 7
            if operation in (*LOOKS, _NEG, _MVN) or other == source:
                return
            if other == to:
                if operation not in (_AND, _EOR, _ORR, _MUL):
                    return
                op.code = op.code & 0xFFC0 | begin << 3 | to
                drop(first)
                drop(move)
                return
            op.code += to - source
        else:
            return
        first.code = NOP if begin == to else MOVE | begin << 3 | to
        drop(move)

    def _compare(self, i: int) -> None:
        """A comparison with 0 behind an instruction whose result has been compared with it."""
        op, compare, branch = self._ops[i : i + 3]
        if compare.code & 0xF8FF != COMPARE or branch.code & 0xFE00 != _EQUAL:
            return
        if op.value is None and op.code < 0x4400 and self._after[i + 2] & FLAGS == 0:
            if effects(op)[1] == FLAGS | 1 << (compare.code >> 8 & 7):
                drop(compare)


def _result(op: Op) -> int:
    """Where the register stands that an instruction writes and does not read; -1: nowhere."""
    code = op.code
    if op.value is not None or code & 0xF800 in (SET, LOAD, ADDRESS):
        return 8
    if code < 0x2000 or code & LOW_MOVE == MOVE:
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
