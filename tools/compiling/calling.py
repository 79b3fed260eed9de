"""How MicroPython's compiler writes calls, arguments and results of viper functions: changed so
that one calls another with bare values. See direct.py.
"""

import struct
from collections.abc import Callable
from typing import NamedTuple

from .peephole import live_before
from .thumb import (
    ADDRESS,
    BRANCH,
    CELL,
    COMPARE,
    JUMP,
    LOAD,
    LOAD_CONSTANT,
    MOVE,
    NOP,
    SET,
    STORE,
    NotUnderstood,
    Op,
    drop,
    effects,
    read,
)

# Out of MicroPython's table of functions, to which register 7 points, into register 3.
_FROM_OBJECT, _TO_OBJECT, _LOOK_UP, _CALL = 0x68FB, 0x693B, 0x69FB, 0x6EFB
_BLX_R1, _BLX_R3 = 0x4788, 0x4798
_R1, _R2, _R3 = 0x100, 0x200, 0x300
_INT = 2  # types, as that table's functions have them

# How a viper function begins: registers are put aside, room is made for slots; out of its object
# come its names and that table; how many arguments there are, and where: register 5.
_PUSH, _ROOM, _ROOM_BACK = 0xB5FE, 0xB080, 0xB000
_TABLES = [0x6847, 0x68BE, 0x68FF]
# And the number that the last has among the module's objects, if it is below 32 or not:
_TABLE, _FAR_TABLE, _FAR_TABLE_END = 0x683F, 0x3700, 0x6FFF
_ARGUMENTS = [0x4608, 0x4611, 0x461D]
_ARGUMENT = 0x6828  # ldr r0, [r5, #…]
_TO_R4, _TO_R5 = MOVE | 4, MOVE | 5  # the latter of the last one
_POP = 0xBDFE
_MOST = 16  # arguments, whose conversion the front can jump over

# Where a function's object has its code, and names among its module's.
_CODE_OF = 0x68C1  # ldr r1, [r0, #12]
_NAME = 0x8830  # ldrh r0, [r6, #…]
_FAR_NAME = [0x4630, 0x3000, 0x8FC0]  # mov r0, r6; adds r0, #…; ldrh r0, [r0, #62]
_ADD_R1 = 0x3100
_ADDRESS_R1, _STORE_THERE = 0xA100, 0x6008  # add r1, pc, #…; str r0, [r1]
_NOT_EQUAL = 0x100
_GIVEN = ADDRESS | _R2  # the first argument's slot, for a call
_BOXING = 5  # instructions that make an object of an argument
# How a larger constant is made in register 2.
_SHIFT, _NEGATE, _ADD = 0x0012, 0x4252, 0x3200


class Entry(NamedTuple):
    """A function's second entry: how far behind the first, and which arguments are objects."""

    offset: int
    objects: "tuple[bool, ...]"


def _codes(ops: "list[Op]") -> "list[int]":
    """Instructions; -1 for those that jump or load a constant."""
    return [op.code if op.target is None and op.value is None else -1 for op in ops]


# A function that is called


class Divided:
    """A function whose result is an integer. front: code for those who call it with objects, which
    calls what is behind it; ops: that, which takes and returns bare values. NotUnderstood where
    its code is not as the compiler writes it."""

    def __init__(self, code: bytes) -> None:
        self.ops = read(code)
        self._types: list[int] = []  # of arguments; 0: an object
        self._take_bare()
        self._return_bare()
        self.front = _front(self._types, self._table)
        self.entry = Entry(len(self.front), tuple(kind == 0 for kind in self._types))

    def _take_bare(self) -> None:
        ops = self.ops
        found = _codes(ops)
        tables = 1 + (found[1] & 0xFF80 == _ROOM)
        table = tables + len(_TABLES)
        if found[0] != _PUSH or found[tables:table] != _TABLES:
            raise NotUnderstood("its beginning")
        begin = table + 1 + (found[table] & 0xFF00 == _FAR_TABLE)
        self._table = found[table:begin]
        if self._table[0] & 0xF83F != _TABLE and self._table[1:] != [_FAR_TABLE_END]:
            raise NotUnderstood("where the table is")
        begin += found[begin] & 0xFF00 == STORE
        jumps = [op.target for op in ops[begin:] if op.code == JUMP][:2]
        if found[begin : begin + 3] != _ARGUMENTS or len(jumps) < 2:
            raise NotUnderstood("its arguments")
        at = next(i for i, op in enumerate(ops) if op is jumps[1])  # behind a wrong count
        count = [code & 0xFF for code in found[begin:at] if code & 0xFF00 == SET | _R2]
        for op in [*ops[begin : begin + 2], *ops[begin + 3 : at]]:
            drop(op)
        while found[at] == _ARGUMENT | len(self._types) << 6 and len(self._types) < _MOST:
            at = self._take_one(at + 1, found)
        if count != [len(self._types)]:
            raise NotUnderstood("their count")

    def _take_one(self, at: int, found: "list[int]") -> int:
        """An argument: made a number of, or left an object, and put in its place."""
        kind = 0
        if found[at + 1 : at + 3] == [_FROM_OBJECT, _BLX_R3] and found[at] & 0xFF00 == SET | _R1:
            kind = found[at] & 0xFF
            for op in self.ops[at : at + 3]:
                drop(op)
            at += 3
        if found[at] not in (_TO_R4, _TO_R5) and found[at] & 0xFF00 != STORE:
            raise NotUnderstood("an argument's place")
        self._types.append(kind)
        return at + 1

    def _return_bare(self) -> None:
        """The result stays what it is; it goes by a slot where exceptions are looked at."""
        ops = self.ops
        found = _codes(ops)
        if found[-1] != _POP:
            raise NotUnderstood("its end")
        end = len(ops) - 1 - (found[-2] & 0xFF80 == _ROOM_BACK)
        slot = found[end - 1]
        if slot & 0xFF00 == LOAD:
            ways = [i for i, code in enumerate(found) if code == STORE | slot & 0xFF]
        else:
            ways = [i for i, op in enumerate(ops) if op.target is ops[end]]
            if not ops[end - 1].jumps and ops[end - 1].code != NOP:
                ways.append(end)
        for way in ways:
            if found[way - 3 : way] != [SET | _R1 | _INT, _TO_OBJECT, _BLX_R3]:
                raise NotUnderstood("a result")
            for op in ops[way - 3 : way]:
                drop(op)
        if not ways:
            raise NotUnderstood("no result")


def _front(types: "list[int]", table: "list[int]") -> bytes:
    """Code that takes objects, makes values of them on the stack, calls what is behind it with
    these, and returns its result as an object."""
    room = len(types) + (len(types) + 1) % 2  # with the registers, a multiple of 8 bytes
    # push {r0, r4, r5, r7, lr}; room; MicroPython's table to register 7, the arguments to 5
    words = [0xB5B1, _ROOM | room, _TABLES[0], _TABLES[2], *table, _ARGUMENTS[2]]
    # cmp r2, #0; bne; cmp r1, #…; beq over what tells of a wrong count: it is given the counts,
    # and the right one, and does not return.
    words += [0x2A00, 0xD101, 0x2900 | len(types), 0xD000 | 6]
    words += [*_ARGUMENTS[:2], 0x4A00, 0x463B, 0x3334, 0x6FDB, _BLX_R3]
    constant = words.index(0x4A00)
    for i, kind in enumerate(types):
        words.append(_ARGUMENT | i << 6)
        if kind:
            words += [SET | _R1 | kind, _FROM_OBJECT, _BLX_R3]
        words.append(STORE | i)
    words += [0x466B, LOAD | room]  # mov r3, sp; the function itself to register 0
    call = len(words)  # bl, two half words; at the end, pop {r1, r4, r5, r7, pc}
    words += [0, 0, SET | _R1 | _INT, _TO_OBJECT, _BLX_R3, _ROOM_BACK | room, 0xBDB2]
    words += [NOP] * (len(words) % 2)
    words[constant] |= (len(words) - (constant + 2 & -2)) // 2
    words += [len(types) << 1 & 0xFFFF, len(types) << 1]
    way = 2 * (len(words) - call) - 4
    words[call : call + 2] = [0xF000 | way >> 12, 0xF800 | way >> 1 & 0x7FF]
    return struct.pack(f"<{len(words)}H", *words)


# A call


def redirect(ops: "list[Op]", entry_of: "Callable[[int], Entry | None]") -> int:
    """Have calls of functions go to their second entries. entry_of: by the number of a name, where
    there is one. Returns how many do."""
    calls = [
        at
        for at in range(len(ops) - 8)
        if _codes(ops[at + 3 : at + 5]) == [_CALL, _BLX_R3] and ops[at].code & 0xFF00 == _GIVEN
    ]
    live = live_before(ops) if calls else []
    made = [call for at in calls if (call := _Call(ops, at, entry_of)).redirect(live[at + 5])]
    for place in sorted((call.look_up for call in made), reverse=True):
        _look_up_once(ops, *place)
    return len(made)


def _look_up_once(ops: "list[Op]", begin: int, end: int) -> None:
    """What these instructions find is kept in the code itself, which lies in memory."""
    cell = Op(CELL)
    known = [Op(LOAD_CONSTANT, cell=cell), Op(COMPARE), Op(BRANCH | _NOT_EQUAL, target=ops[end])]
    for op in ops:
        if op.target is ops[begin]:
            op.target = known[0]
    ops[end:end] = [Op(_ADDRESS_R1, cell=cell), Op(_STORE_THERE), cell]
    ops[begin:begin] = known


class _Call:
    """A call at this place: it gives the address of the first argument's slot."""

    def __init__(
        self, ops: "list[Op]", at: int, entry_of: "Callable[[int], Entry | None]"
    ) -> None:
        self._ops = ops
        self._at = at
        self._entry_of = entry_of
        self._slot = ops[at].code & 0xFF
        self.look_up = (0, 0)  # where the function is looked up

    def redirect(self, live: int) -> bool:
        """Whether it goes to a second entry now. live: what is read behind it."""
        ops, at = self._ops, self._at
        entry = self._entry()
        is_int = _codes(ops[at + 5 : at + 8]) == [SET | _R1 | _INT, _FROM_OBJECT, _BLX_R3]
        if entry is None or not (is_int or not live & 1):
            return False
        boxed = self._boxed()
        constants = self._constants(at - _BOXING * len(boxed))
        numbers = boxed.keys() | constants.keys()
        if any((self._slot + i in numbers) == each for i, each in enumerate(entry.objects)):
            return False
        for op in (op for many in boxed.values() for op in many):
            drop(op)
        for many in constants.values():
            _set(many, _value(many) >> 1)
        ops[at].code += _R1  # to register 3, where arguments are expected
        for op, code in zip(ops[at + 2 : at + 5], (_CODE_OF, _ADD_R1 | entry.offset | 1, _BLX_R1)):
            op.code = code
        for op in ops[at + 5 : at + 8] if is_int else ():
            drop(op)
        return True

    def _entry(self) -> "Entry | None":
        """Of the function that is looked up for this call, if it has as many arguments."""
        ops, at = self._ops, self._at
        load, count = _codes(ops[at + 1 : at + 3])
        places = [i for i in range(5, at) if ops[i].code == STORE | load & 0xFF]
        if load & 0xFF00 != LOAD or count & 0xFF00 != SET | _R1 or not places:
            return None
        place = places[-1]
        while not effects(ops[place - 1])[1] & 1:  # it may have waited in its register
            place -= 1
        *name, look_up, call = _codes(ops[place - 5 : place])
        number, length = _number(name)
        if (look_up, call) != (_LOOK_UP, _BLX_R3) or number < 0:
            return None
        self.look_up = (place - 2 - length, place)
        entry = self._entry_of(number)
        return entry if entry and len(entry.objects) == count & 0xFF else None

    def _boxed(self) -> "dict[int, list[Op]]":
        """What makes objects of arguments, by their slots: it stands right before."""
        found: dict[int, list[Op]] = {}
        end = self._at
        while end >= _BOXING:
            many = self._ops[end - _BOXING : end]
            load, kind, *make, store = _codes(many)
            if make != [_TO_OBJECT, _BLX_R3] or kind & 0xFF00 != SET | _R1:
                break
            if store != STORE | load & 0xFF or load & 0xFF00 != LOAD:
                break
            found[load & 0xFF] = many
            end -= _BOXING
        return found

    def _constants(self, end: int) -> "dict[int, list[Op]]":
        """What puts small integers in place that are objects already, by their slots."""
        found: dict[int, list[Op]] = {}
        while end > 1 and _codes(self._ops[end - 1 : end])[0] & 0xFF00 == STORE | _R2:
            begin = end - 2
            while begin and _changes(_codes(self._ops[begin : begin + 1])[0]):
                begin -= 1
            many = self._ops[begin:end]
            if many[0].code & 0xFF00 not in (SET | _R2, LOAD_CONSTANT | _R2):
                break
            if not _value(many) & 1:
                break
            found[many[-1].code & 0xFF] = many
            end = begin
            while self._ops[end - 1].code == NOP:  # so that a constant stands where words do
                end -= 1
        return found


def _number(codes: "list[int]") -> "tuple[int, int]":
    """Of the name that these instructions load, the number, -1 where they do not; and how many
    do."""
    if codes[-1] & 0xF83F == _NAME:
        return codes[-1] >> 6 & 31, 1
    if [codes[0], codes[1] & 0xFF00, codes[2]] == _FAR_NAME:
        return (codes[1] & 0xFF) // 2 + 31, len(_FAR_NAME)
    return -1, 0


def _changes(code: int) -> bool:
    return code == _NEGATE or code & 0xFF00 == _ADD or (code >= 0 and code & 0xF83F == _SHIFT)


def _value(many: "list[Op]") -> int:
    """The number that register 2 holds in the end."""
    value = many[0].code & 0xFF if many[0].value is None else many[0].value
    for op in many[1:-1]:
        if op.code == _NEGATE:
            value = -value
        elif op.code & 0xFF00 == _ADD:
            value += op.code & 0xFF
        else:
            value <<= op.code >> 6 & 31
    return value


def _set(many: "list[Op]", value: int) -> None:
    """Have it hold this one."""
    for op in many[1:-1]:
        drop(op)
    many[0].code, many[0].value = LOAD_CONSTANT | _R2, value & 0xFFFFFFFF
    if 0 <= value < 256:
        many[0].code, many[0].value = SET | _R2 | value, None
