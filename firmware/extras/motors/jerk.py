# mypy: disable-error-code=arg-type
"""Limit jerk per axis while the machine runs: $800, $801, $802, in mm/s3.

The speed along the path is averaged over a time, so acceleration changes gradually:
jerk_kernel.py averages, jerk_plan.py adapts the planned speeds. The numbers of the settings are
grblHAL's, where the limit has to be compiled in. With 0, no limit, motion is the same as without
this module. Homing and parking are not limited. A board file enables it with JERK = True.
"""

from array import array

import micropython
from base.settings import AXIS
from micropython import const
from motion import layout, minifloat
from motion.layout import SLICES, SYSTEM

from extras.motors import jerk_layout as jl
from extras.motors import jerk_plan
from extras.motors.jerk_kernel import plan_slot, smooth
from extras.motors.jerk_layout import FILTER_TAPS

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from base.settings import Rows
    from base.state import State
    from motion.planner import Planner

    from extras.api import Cnc

_SETTINGS: "Rows" = (
    # Maximum jerk, one value per axis. How fast acceleration may change; 0: at once.
    (800, "jerk", AXIS, 0.0, "mm/sec^3"),
)
_MOST_SLOTS = const(64)  # over which speed is averaged at most
_MOST_SUM = const(1 << 29)  # highest sum of the taps, in units of the line
_HIGHEST_ROOT = const(32768)  # root of the highest scaled speed squared
_PIECES = const(2)  # pieces planned ahead with each row
_LIMITS_OF_AN_AXIS = const(3)  # in the planner's table, from LIMITS on,
_ACCELERATION = const(2)  # and the index among them of a real in mm/s2
_PER_MM = const(65536)  # distance units of the line per mm


class Jerk:
    """The stage between planner and engine. next() replaces Segments.next().

    It averages planned speeds in `line`, a delay line (an array; jerk_layout.py names its places):
    line[FILTER_TAPS] is the number of slots over which it averages, 0 without a limit. A slot
    lasts as long as a full segment. `flow`, `ring` and `table` are the planner's.
    """

    def __init__(self, planner: "Planner", state: "State") -> None:
        self._planner = planner
        self._flow = planner.flow
        self._ring = planner.ring
        self._table = planner.table
        self._line = array("i", (0 for _ in range(jl.TAP_DISTANCES + _MOST_SLOTS)))
        # The functions that plan() and next() replace, and call.
        self._plan = planner.move_hook or planner.plan
        planner.move_hook = self.plan
        hooks = state.hooks
        hooks.planned += (lambda: self.release_blocks(everything=0),)
        hooks.caught_up += (lambda: self.release_blocks(everything=1),)
        hooks.cleared += (self._clear,)
        hooks.replan += (self._replan,)
        self._next_segment, hooks.next_segment = hooks.next_segment, self.next

    @micropython.viper
    def next(self, row: object) -> int:
        """Fill in the next row, as Segments.next() does, from a segment of averaged speed.

        Segments.next() makes the row in any case. If it has rows of the present segment left
        (SLICES), this plans a little ahead before it; otherwise it computes the next averaged
        segment, from which that row is made. Return 1, or 0 if nothing is left to move. Called in
        the engine's interrupt.
        """
        flow = ptr32(self._flow)
        line = ptr32(self._line)  # the delay line
        ring = ptr32(self._ring)
        table = ptr32(self._table)
        # Not without a limit of jerk, nor in a move of the system's own, such as homing.
        if line[FILTER_TAPS] and flow[SYSTEM] == 0:
            if flow[SLICES]:
                plan_slot(flow, line, ring, table, _PIECES)
            elif int(smooth(flow, line, ring, table)) == 0:
                return 0
        return int(self._next_segment(row))  # Segments.next()

    # Hooks of the planner

    @micropython.native
    def plan(self, target: "array[float]", flags: int, line: int, power: int, rate: int) -> int:
        """Plan a block as Planner.plan() does, with the same arguments and result. Release it to
        the averaging plan, unless it is the system's own."""
        planned = self._plan(target, flags, line, power, rate)
        if not flags & layout.SYSTEM_MOTION:
            self.release_blocks(0)  # 0: not one by one if many are waiting
        return planned

    def release_blocks(self, everything: int) -> None:
        """Release the new blocks to the averaging plan, which reads no others: if they are many,
        or everything is not 0."""
        jerk_plan.release_blocks(self._table, self._ring, self._flow, self._line, everything)

    def may_start(self) -> bool:
        """Release all blocks before motion starts. Returns True: it may start."""
        self.release_blocks(everything=1)
        return True

    def _replan(self) -> bool:
        """Plan all blocks again after an override has changed. Returns False without a limit: the
        planner does it then."""
        if self._line[FILTER_TAPS]:
            jerk_plan.reschedule(self._table, self._ring, self._flow, self._line[layout.TAIL])
        return self._line[FILTER_TAPS] != 0

    def _clear(self) -> None:
        """Empty the delay line, after the planner was cleared. The limit stays."""
        line, flow = self._line, self._flow
        taps, per_tap = line[FILTER_TAPS], line[jl.PER_TAP]
        for i in range(len(line)):
            line[i] = 0
        line[FILTER_TAPS], line[jl.PER_TAP] = taps, per_tap
        line[layout.ROW_SIZE] = flow[layout.ROW_SIZE]
        line[layout.ROWS] = flow[layout.ROWS]
        # The plan goes on with the next block, and none is released.
        line[layout.TAIL] = line[layout.HEAD] = line[jl.RELEASED] = flow[layout.HEAD]

    def limit(self, accelerations: "list[float]", jerks: "list[float]", slot_s: float) -> None:
        """Set the limits of jerk per axis, in mm/s3; 0: no limit. Empties the delay line.

        accelerations: per axis, mm/s2. slot_s: length of a full segment, s. Call it while idle,
        after Planner.configure(). The averaging time is 2 * acceleration / jerk, of the axis that
        needs longest. At the highest speed it covers at most 2**29 units (8192 mm), because the
        kernel adds two such sums. An axis that needs more time gets less acceleration.
        """
        table, line = self._table, self._line
        limits = [(i, jerks[i]) for i in range(len(jerks)) if jerks[i] > 0]
        root_mm_s = minifloat.value(table[layout.ROOT_SCALE])
        slot_distance = root_mm_s * _HIGHEST_ROOT * slot_s * _PER_MM  # at the highest speed
        most_slots = max(min(_MOST_SLOTS, int(_MOST_SUM / slot_distance)), 1)
        slots = 0
        for i, jerk in limits:
            # The acceleration may change from + all of it to - all of it.
            wanted_slots = 2 * accelerations[i] / jerk / slot_s
            slots = max(slots, min(int(wanted_slots + 0.999), most_slots))  # rounded up
            if wanted_slots > most_slots:
                acceleration_at = layout.LIMITS + _LIMITS_OF_AN_AXIS * i + _ACCELERATION
                table[acceleration_at] = minifloat.real(jerk * most_slots * slot_s / 2)
        line[FILTER_TAPS] = slots
        table[layout.JUNCTION_DERATE] = 0
        if slots:
            line[jl.PER_TAP] = minifloat.real(1 / slots)
            # Mean time, in slots, to a corner in the middle of the averaging time of n slots:
            # n / 4, and 1 / 12 n because the corner is anywhere in its slot.
            mean_slots = slots / 4 + 1 / (12 * slots)
            table[layout.JUNCTION_DERATE] = minifloat.real(mean_slots * slot_s / root_mm_s)
        self._planner.clear()


def install(cnc: "Cnc") -> None:
    """Limit jerk as the settings say."""
    machine = cnc.machine
    settings: "Any" = machine.settings
    jerk = Jerk(machine.planner, machine.state)

    def configure() -> None:
        """Set the limits of the settings. Their accelerations are in mm/min2, jerks in mm/s3."""
        segment_ticks = 1 << machine.planner.table[layout.SEGMENT_LOG2]
        jerk.limit(
            [mm_min2 / 3600 for mm_min2 in settings.acceleration],
            list(settings.jerk),
            segment_ticks / machine.engine.tick_hz,
        )

    cnc.before_motion(jerk.may_start)
    cnc.add_settings(_SETTINGS)
    settings.on_change(configure)
