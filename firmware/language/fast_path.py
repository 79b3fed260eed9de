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
from base.singles import renew, to_mm, whole_part
from control import modes as md
from control.canon import judge
from control.modes import INCHES, INVERSE_TIME, MOTION, PLANE, RELATIVE, RPM, SPINDLE
from control.spindle import ASKED, weigh
from micropython import const
from motion import layout
from motion import planner as plan
from motion.plan_kernel import plan as plan_block
from motion.reals import per_second

from language import block_layout as b
from language import fast_kernel as fk
from language.fast_kernel import follow_line, jog, line_number, place, read

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from base.settings import Settings
    from base.state import State
    from control.coords import Coords
    from control.modes import Modes
    from control.spindle import Spindle
    from interfaces import Canon

    from language.block import Block


class FastPath:
    """The short path of an interpreter. is_open: lines may take it.

    follow(line, length) plans a line, and returns 1; or it returns 0, and has done nothing that
    execute() would not do, which waits for room. An extra may put another in its place; plain is
    our own.
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
        self._axes = axes = len(modes.position)
        self._move = plan.Move()
        # The numbers that it has: what they are made objects of takes memory.
        self._numbers = vector(2)
        self._target = vector(axes)
        self._known = array("i", (0 for _ in range(fk.OFFSETS + axes)))
        self._offsets = memoryview(self._known)[fk.OFFSETS :]
        self._rates = memoryview(self._known)[fk.FEED :]
        self._known[fk.INCH_MM] = 0x41CB3333  # the float 25.4
        self._jogs = array("i", self._known)  # what jogs depend on: the same, but for modes
        self._asked = False  # the last line was one of these
        self.is_open = True
        planner = canon.planner
        self._memory = (
            self._known,
            modes.position,
            self._target,
            canon.travel,
            planner.table,
            planner.ring,
            planner.flow,
            planner.speeds,
            state.changes,
            modes.rates,
            state.spindle,
            self._follow_news,
        )
        self.follow = self.plain = self._follow

    def memory(self) -> "tuple[Any, ...]":
        """What the kernel's follow() is called with behind the line."""
        return self._memory

    def _follow(self, line: bytearray, length: int) -> int:
        """The kernel's follow(), with all that it needs."""
        return follow_line(line, length, self._memory)

    @micropython.native
    def forget(self) -> None:
        """A line went the long way: what was known may be so no more."""
        self._known[fk.AXES] = self._jogs[fk.AXES] = 0
        self._asked = False

    def _look(self) -> None:
        """See whether lines that only move may go the shorter way now."""
        modes, coords, known = self._modes, self._coords, self._known
        modal = modes.modal
        known[fk.CHANGES] = self._state.changes[0]
        known[fk.AXES] = 0
        if (
            self.is_open
            and modal[MOTION] <= b.CCW_ARC
            and not modes.tool
            and coords.tool_length == 0
        ):
            known[fk.AXES] = self._axes
            copy(coords.zero(coords.active), self._offsets, self._axes)
            known[fk.DRY] = self._state.run == st.CHECK
            known[fk.LASER] = self._spindle.laser
            self._set()

    def _set(self) -> None:
        """How lines move from now on, unless they say otherwise."""
        modes, move, known = self._modes, self._move, self._known
        rates, numbers = modes.rates, self._numbers
        seeks = modes.modal[MOTION] == b.SEEK
        curves = modes.modal[MOTION] > b.LINEAR
        known[fk.MODE] = fk.HAS_G0 if seeks else fk.MODES if curves else fk.HAS_G1
        copy(rates, self._rates, 2)
        known[fk.RATE] = per_second(known, fk.FEED)
        if renew(numbers, md.FEED, rates, md.FEED):
            move.feed = rates[md.FEED]
        if renew(numbers, RPM, rates, RPM):
            move.spindle_rpm = rates[RPM]
        if seeks and known[fk.LASER]:
            known[fk.RPM] = 0
            move.spindle_rpm = numbers[RPM] = 0.0
        known[fk.LACKS] = 0
        move.flags = self._flags()
        known[fk.POWER] = fk.UNTOLD

    def _flags(self) -> int:
        """Those of a planner block, but for what power makes of them, by what is in force."""
        modal, flags = self._modes.modal, self._modes.accessory_flags()
        if modal[MOTION] == b.SEEK:
            flags |= layout.RAPID_MOTION
        if modal[INVERSE_TIME]:
            flags |= layout.INVERSE_TIME
        return flags

    def execute(self, line: bytearray, length: int) -> bool:
        """Execute a line that does no more than move, or nothing; False where it does, and nothing
        has changed."""
        known = self._known
        is_known = known[fk.AXES] and known[fk.CHANGES] == self._state.changes[0]
        if not is_known:
            fk.set_in_force(known, self._modes.modal)
        seen = read(line, 0, length, known)
        if seen != fk.ODD and not is_known:
            self._look()
            seen = read(line, 0, length, known)
        if seen <= 0 or not known[fk.AXES]:
            return False
        if seen & fk.CHANGED:
            self._take_meaning()
        if seen & fk.SAME:
            self._asked = False
            return True
        if seen & fk.NEWS or known[fk.LACKS]:
            self._take_news(seen)
        # Go where the line says.
        self._move.line_number = line_number(known, seen)
        place(known, seen, self._modes.position, self._target)
        self._canon.line(self._target, self._move)
        copy(self._target, self._modes.position, self._axes)
        self._asked = True
        return True

    @micropython.native
    def go(self, block: "Block") -> int:
        """Plan the line, if it is one, of a block that is in force and has no other command, and
        return 1; or 0, and nothing has been done. In one piece: the kernel needs much of the stack
        beneath it."""
        state, xyz = self._state, block.xyz
        if self.follow is not self.plain or not self.is_open or self._spindle.laser:
            return 0
        if block.ints[MOTION] > b.LINEAR or state.suspend or state.pending[st.ANY]:
            return 0
        _, position, _, travel, table, ring, flow, speeds, _, rates, scale, _ = self._memory
        if judge(xyz, travel, flow):
            return 0
        if state.run != st.CHECK:
            flags = self._flags()
            power = 0
            if flags & plan.SPINDLE_MASK:
                renew(scale, ASKED, rates, RPM)
                power = weigh(scale, flags)
            line = whole_part(block.singles, b.N, 0)
            renew(speeds, flow[layout.HEAD], rates, RPM)
            rate = per_second(block.singles, b.F)
            if not plan_block(xyz, table, ring, flow, flags, line, power, rate):
                return 0
        copy(xyz, position, self._axes)
        return 1

    def again(self, line: bytearray, length: int) -> int:
        """Once more with the line that lacked nothing but room (WAITS), behind a wait for that."""
        self._known[fk.WAITS] = 0
        self._canon.wait_for_room()
        return self.follow(line, length)

    def _follow_news(self, seen: int) -> int:
        """A line that goes the shortest way has something new. Returns the power for it."""
        known, move = self._known, self._move
        if seen & fk.CHANGED:
            self._take_meaning()
            if not seen & fk.NEWS:
                return known[fk.POWER]
        self._take_news(seen)
        power = 0 if known[fk.DRY] else self._canon.power_of(move)
        known[fk.FLAGS] = move.flags
        return power

    def _take_meaning(self) -> None:
        """A line changes how numbers are meant."""
        known, modal = self._known, self._modes.modal
        modal[INCHES] = known[fk.LINE_INCHES]
        modal[RELATIVE] = known[fk.LINE_RELATIVE]
        modal[PLANE] = known[fk.LINE_PLANE] - fk.XY
        fk.set_in_force(known, modal)
        self._jogs[fk.AXES] = 0

    def _take_news(self, seen: int) -> None:
        """A line changes motion mode, feed rate, or a laser's power."""
        modes, known = self._modes, self._known
        fk.take_rates(known, seen, modes.rates)
        if seen & fk.HAS_F and known[fk.IN_INCHES] and not known[fk.IS_TIMED]:
            to_mm(modes.rates, md.FEED)
        if seen & fk.MODES:
            modes.modal[MOTION] = b.SEEK if seen & fk.HAS_G0 else b.LINEAR
        self._set()

    def jog(self, line: bytearray, length: int) -> int:
        """Plan a "$J=" line, and return 1; or 0, and nothing has been done."""
        done = jog(line, length, self._jogs, self._memory)
        if done == fk.UNKNOWN and self._look_at_jogs():
            done = jog(line, length, self._jogs, self._memory)
        return 1 if done > 0 else 0

    def _look_at_jogs(self) -> bool:
        """See what jogs depend on. Returns whether they may go the shorter way."""
        modes, coords, known = self._modes, self._coords, self._jogs
        known[fk.AXES] = 0
        turns = modes.modal[SPINDLE]
        if self.follow is not self.plain or not self.is_open or coords.tool_length or turns:
            return False
        known[fk.CHANGES] = self._state.changes[0]
        known[fk.AXES] = axes = self._axes
        known[fk.IN_INCHES] = modes.modal[INCHES]
        known[fk.IS_RELATIVE] = modes.modal[RELATIVE]
        copy(coords.zero(coords.active), memoryview(known)[fk.OFFSETS :], axes)
        known[fk.FLAGS] = layout.NO_FEED_OVERRIDE | modes.accessory_flags()
        return True

    def tell(self) -> None:
        """A line has been planned: if it only moves, the next ones are like that."""
        known = self._known
        if self._asked and known[fk.POWER] == fk.UNTOLD:
            self._asked = False
            known[fk.FLAGS] = self._move.flags
            known[fk.POWER] = 0 if known[fk.DRY] else self._canon.power
