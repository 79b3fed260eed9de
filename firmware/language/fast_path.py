# mypy: disable-error-code=arg-type
"""The fast path: lines that do no more than move, from text to a planner block in one go.

Nearly all lines of a program are G0 or G1 with places, and now and then F, S or N. What else they
depend on stays the same until another kind of line comes, or State.changes counts on: _look()
works it out once, into a table of integers. Such a line then is one call of follow(). Whatever
is less simple is for the interpreter, and what follow() does means the same as what that does.
"""

from array import array

import micropython
from base import state as st
from base.f32 import copy, vector
from base.singles import add_single, multiply, to_mm
from control import modes as md
from control.canon import judge
from control.modes import INCHES, INVERSE_TIME, MOTION, RELATIVE
from control.spindle import ASKED, weigh
from micropython import const
from motion import layout
from motion import planner as plan
from motion.layout import HEAD
from motion.plan_kernel import FULL, OUTSIDE
from motion.plan_kernel import plan as plan_block
from motion.reals import per_second

from language import block as b
from language.words import number

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from base.settings import Settings
    from base.state import State
    from control.coords import Coords
    from control.modes import Modes
    from control.spindle import Spindle
    from interfaces import Canon

# What read() found: bits of its mask. Bits 0 to 3 are X, Y, Z and A.
HAS_F = const(0x10)  # another feed rate than before
HAS_S = const(0x20)
HAS_G0 = const(0x40)  # G0, which was not in force
HAS_G1 = const(0x80)
HAS_N = const(0x100)
_MODES = const(0xC0)
_NEWS = const(0xF0)
ODD = const(-1)  # what is none of those, whatever is in force
_F = const(4)  # the same as bit numbers
_S = const(5)
_G0 = const(6)
_N = const(8)
_NO_LETTER = const(9)

# What is known: how many axes there are (0: nothing is known), the motion in force (HAS_G0 or
# HAS_G1), whether S goes with cutting motion, feed rate and spindle speed (bits of floats),
AXES = const(0)
MODE = const(1)
LASER = const(2)
FEED = const(3)
_RPM = const(4)
# whether places are relative, travel is limited, nothing is to move,
IS_RELATIVE = const(5)
LIMITED = const(6)
DRY = const(7)
# what the planner is told: flags, spindle power (UNTOLD: none of it is known yet), rate: a real;
_FLAGS = const(8)
_POWER = const(9)
_RATE = const(10)
_UNTOLD = const(0x3FFFFFFF)
# the line's numbers, by their bit; whether they are inches; what is added to places, per axis.
VALUES = const(11)
IN_INCHES = const(20)
_CHANGES = const(21)  # as they were counted when this was known
_LACKS = const(22)  # whether the move lacks what is new
_INCH_MM = const(23)
_WAITS = const(24)  # whether room is all that the last line has lacked
OFFSETS = const(25)


@micropython.viper
def read(text: ptr8, length: int, known: ptr32) -> int:
    """What a line holds if it does no more than move; ODD or 0 if it does, or if a word is wrong.
    Such have G0 and G1, X to Z and A, F, N and S, each once at the most, the last three not
    negative. Returns a mask of axes and of what is new, the public names above.
    """
    signs = ptr8(known)
    pos = 0
    seen = 0
    while pos < length:
        letter = text[pos]
        bit = _NO_LETTER
        if letter == 71:  # G
            bit = _G0
        elif letter >= 88 and letter <= 90:  # X, Y, Z
            bit = letter - 88
        elif letter == 65:  # A
            bit = 3
        elif letter == 70:  # F
            bit = _F
        elif letter == 83:  # S
            bit = _S
        elif letter == 78:  # N
            bit = _N
        if bit == _NO_LETTER:
            return ODD
        pos = int(number(text, pos + 1, known, VALUES + bit))
        if pos == 0:
            return 0
        value = known[VALUES + bit]
        if bit == _G0:
            if seen & _MODES:
                return 0
            if value == 0x3F800000:  # the float 1
                bit += 1
            elif value:
                return ODD
        elif bit > 3 and signs[4 * (VALUES + bit) + 3] & 128:
            return 0
        elif bit == _N and value >> 7 >= 0x96312D:  # ten million
            return 0
        if (seen >> bit) & 1:
            return 0
        seen |= 1 << bit
    if seen & 15 == 0 or (seen & 15) >> known[AXES]:
        return 0
    mode = seen & _MODES
    if mode == known[MODE]:
        seen ^= mode
    mode = mode or known[MODE]
    rate = known[FEED]
    if seen & HAS_F:
        if known[VALUES + _F] == rate and known[IN_INCHES] == 0:
            seen ^= HAS_F
        rate = known[VALUES + _F]
    if mode == HAS_G1:
        return seen if rate and (known[LASER] or not seen & HAS_S) else 0
    return 0 if seen & HAS_S else seen


@micropython.viper
def place(known: ptr32, seen: int, position: ptr32, target: ptr32) -> int:
    """Put the places of a line that has been read, offsets added, into target."""
    for i in range(known[AXES]):
        if (seen >> i) & 1:
            target[i] = known[VALUES + i]
            if known[IN_INCHES]:
                multiply(target, i, known, _INCH_MM)
            if known[IS_RELATIVE]:
                add_single(position, i, target, i)
            elif known[OFFSETS + i]:
                add_single(known, OFFSETS + i, target, i)
        else:
            target[i] = position[i]
    return 0


@micropython.viper
def line_number(known: ptr32, seen: int) -> int:
    """N of a line that has been read; 0 if it has none."""
    if not seen & HAS_N:
        return 0
    value = known[VALUES + _N]
    exponent = value >> 23
    return ((value & 0x7FFFFF) | 0x800000) >> (150 - exponent) if exponent >= 127 else 0


@micropython.viper
def follow(
    text: ptr8,
    length: int,
    known: ptr32,
    position: ptr32,
    target: ptr32,
    travel: ptr32,
    table: ptr32,
    ring: ptr32,
    flow: ptr32,
    speeds: ptr32,
    changes: ptr32,
    rates: ptr32,
    scale: ptr32,
    news: object,
) -> int:
    """Plan a line that does no more than move and has nothing in its way. Returns 1; or 0, and
    nothing has changed but what is new, to which whoever goes on with the line sees as well.

    news: sees to what is new but rare, and says what the spindle makes of it.
    """
    if known[AXES] == 0 or known[_POWER] == _UNTOLD or known[_CHANGES] != changes[0]:
        return 0
    seen = int(read(text, length, known))
    if seen <= 0:
        return 0
    place(known, seen, position, target)
    found = int(judge(target, travel, flow))
    if found & OUTSIDE and known[LIMITED]:
        return 0
    if known[DRY] == 0 and found & FULL:
        known[_WAITS] = 1
        return 0
    if seen & _NEWS:
        if seen & _MODES or (seen & HAS_F and known[IN_INCHES]):
            known[_POWER] = int(news(seen))  # type: ignore[operator]
        else:
            known[_LACKS] = 1
            if seen & HAS_F:
                known[FEED] = known[VALUES + _F]
                rates[md.FEED] = known[FEED]
                known[_RATE] = int(per_second(known, FEED))
            if seen & HAS_S:
                known[_RPM] = known[VALUES + _S]
                rates[md.RPM] = known[_RPM]
                scale[ASKED] = known[_RPM]
                if known[DRY] == 0:
                    known[_POWER] = int(weigh(scale, known[_FLAGS]))
    if known[DRY] == 0:
        at = flow[HEAD]
        line = int(line_number(known, seen))
        flags = known[_FLAGS]
        power = known[_POWER]
        rate = known[_RATE]
        if int(plan_block(target, table, ring, flow, flags, line, power, rate)) == 0:
            return 0
        speeds[at] = known[_RPM]
    copy(target, position, known[AXES])
    return 1


class FastPath:
    """The short path of an interpreter. is_open: lines may take it.

    follow(line, length) plans a line, and returns 1; or it returns 0, and has done nothing that
    execute() would not do, which waits for room.
    """

    follow: "Callable[[bytearray, int], int]"

    def __init__(
        self,
        modes: "Modes",
        coords: "Coords",
        state: "State",
        settings: "Settings",
        canon: "Canon",
        spindle: "Spindle",
    ) -> None:
        self._modes = modes
        self._coords = coords
        self._state = state
        self._settings = settings
        self._canon = canon
        self._spindle = spindle
        axes = len(modes.position)
        self._move = plan.Move()
        self._target = vector(axes)
        self._known = array("i", (0 for _ in range(OFFSETS + axes)))
        self._offsets = memoryview(self._known)[OFFSETS:]
        self._known[_INCH_MM] = 0x41CB3333  # the float 25.4
        self._asked = False  # the last line was one of these
        self.is_open = True
        self.follow = self._make_follow()

    def _make_follow(self) -> "Callable[[bytearray, int], int]":
        """What follow() needs is at hand: no look-up, no closure, whose frame is on the heap."""
        planner = self._canon.planner

        @micropython.native
        def follow_line(
            line: bytearray,
            length: int,
            known: "array[int]" = self._known,
            position: "array[float]" = self._modes.position,
            target: "array[float]" = self._target,
            travel: "array[int]" = self._canon.travel,
            table: "array[int]" = planner.table,
            ring: "array[int]" = planner.ring,
            flow: "array[int]" = planner.flow,
            speeds: "array[float]" = planner.speeds,
            changes: "array[int]" = self._state.changes,
            rates: "array[float]" = self._modes.rates,
            scale: "array[float]" = self._state.spindle,
            news: "Callable[[int], int]" = self._follow_news,
        ) -> int:
            return follow(
                line,
                length,
                known,
                position,
                target,
                travel,
                table,
                ring,
                flow,
                speeds,
                changes,
                rates,
                scale,
                news,
            )

        return follow_line

    def forget(self) -> None:
        """A line went the long way: what was known may be so no more."""
        self._known[AXES] = 0
        self._asked = False

    def _look(self) -> None:
        """See whether lines that only move may go the shorter way now."""
        modes, coords, known = self._modes, self._coords, self._known
        modal = modes.modal
        known[_CHANGES] = self._state.changes[0]
        known[AXES] = 0
        if (
            self.is_open
            and modal[MOTION] <= b.LINEAR
            and not (modal[INVERSE_TIME] or modes.tool)
            and coords.tool_length == 0
        ):
            axes = len(modes.position)
            known[AXES] = axes
            copy(coords.zero(coords.active), self._offsets, axes)
            known[IS_RELATIVE] = modal[RELATIVE]
            known[IN_INCHES] = modal[INCHES]
            known[LIMITED] = self._settings.soft_limits
            known[DRY] = self._state.run == st.CHECK
            known[LASER] = self._spindle.laser
            self._set()

    def _set(self) -> None:
        """How lines move from now on, unless they say otherwise."""
        modes, move, known = self._modes, self._move, self._known
        seeks = modes.modal[MOTION] == b.SEEK
        known[MODE] = HAS_G0 if seeks else HAS_G1
        copy(modes.rates, memoryview(known)[FEED:], 2)
        known[_RATE] = per_second(known, FEED)
        move.feed, move.spindle_rpm = modes.rates
        if seeks and known[LASER]:
            known[_RPM] = 0
            move.spindle_rpm = 0.0
        known[_LACKS] = 0
        move.flags = modes.accessory_flags() | (layout.RAPID_MOTION if seeks else 0)
        known[_POWER] = _UNTOLD

    def execute(self, line: bytearray, length: int) -> bool:
        """Execute a line that does no more than move; False where it does, and nothing has
        changed."""
        known = self._known
        if known[_WAITS]:
            known[_WAITS] = 0
            self._canon.wait_for_room()
            if self.follow(line, length):
                return True
        seen = read(line, length, known)
        if seen != ODD and not (known[AXES] and known[_CHANGES] == self._state.changes[0]):
            self._look()
            seen = read(line, length, known)
        if seen <= 0:
            return False
        if seen & _NEWS or known[_LACKS]:
            self._take_news(seen)
        # Go where the line says.
        self._move.line_number = line_number(known, seen)
        place(known, seen, self._modes.position, self._target)
        self._canon.line(self._target, self._move)
        copy(self._target, self._modes.position, len(self._modes.position))
        self._asked = True
        return True

    def _follow_news(self, seen: int) -> int:
        """A line that goes the shortest way has something new. Returns the power for it."""
        known, move = self._known, self._move
        self._take_news(seen)
        power = 0 if known[DRY] else self._canon.power_of(move)
        known[_FLAGS] = move.flags
        return power

    def _take_news(self, seen: int) -> None:
        """A line changes motion mode, feed rate, or a laser's power."""
        modes, known = self._modes, self._known
        for i in range(2):
            if seen >> (_F + i) & 1:
                copy(memoryview(known)[VALUES + _F + i :], memoryview(modes.rates)[i:], 1)
        if seen & HAS_F and known[IN_INCHES]:
            to_mm(modes.rates, md.FEED)
        if seen & _MODES:
            modes.modal[MOTION] = b.SEEK if seen & HAS_G0 else b.LINEAR
        self._set()

    def tell(self) -> None:
        """A line has been planned: if it only moves, the next ones are like that."""
        known = self._known
        if self._asked and known[_POWER] == _UNTOLD:
            self._asked = False
            known[_FLAGS] = self._move.flags
            known[_POWER] = 0 if known[DRY] else self._canon.power
