# mypy: disable-error-code="arg-type, has-type, misc"
"""Clusters of laser powers, S0:0:875:0: one line, one block, up to 16 dots of equal length.

A line with a cluster has only what move-only lines have: G1, axes, F, S and N, with $32 on. The
rest of the machine handles it as a line with its last S, and its block as any other block. The
powers of its dots are in an array with one row per row of the planner's ring.
"""

from array import array

import micropython
from base.errors import BAD_NUMBER_FORMAT, GCODE_MAX_VALUE_EXCEEDED, NEGATIVE_VALUE
from control.spindle import ASKED, power_from_rpm
from language.block_layout import CHECKED, MOVE, ONLY, S_IN_MOTION
from language.words import number, scan
from micropython import const
from motion.beam_layout import LEVEL
from motion.layout import (
    BLOCK_AT,
    DYNAMIC,
    EVENTS,
    FLAGS,
    HEAD,
    KEEP_POWER,
    LOADED,
    MOTORS,
    ROW_AXES,
    ROW_POWER,
    ROW_SIZE,
    ROW_STRIDE,
    ROW_TICKS,
    ROWS,
    STEPS,
    SYSTEM_MOTION,
    TAIL,
)
from motion.planner import SPINDLE_MASK
from motion.slice_kernel import scaled_power, speed_share, step_tick

from extras.tools.laser import Laser, emit, move_power, place_changes

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from interfaces import Options
    from motion.planner import Planner
    from talk.controller import Controller

    from extras.api import Cnc

_LINE_LENGTH = const(160)
_COLON = const(58)  # ASCII
_S = const(83)  # ASCII
_MINUS_BYTE = const(3)  # the sign of a float is in this byte of its four,
_MINUS = const(128)  # and is this bit
_STRAIGHT_CUT = const(CHECKED | MOVE | S_IN_MOTION)  # all that a line with a cluster may ask for

# The array `clusters` has a row per block: the number of dots, 0 for a normal block, then their
# powers, as a block's own power: PWM steps, or 1/64 of one if power follows speed.
MOST = const(16)  # dots of a block
CLUSTER_LENGTH = const(17)  # integers of a block in `clusters`: number of dots, and their powers
# The S values of a block's dots are in another array, MOST per block.

# Indices into `dots`, the dots of the line just read: their number, then their S values, as bits
# of floats.
DOTS = const(0)  # index in `dots`: the number of dots,
FIRST_DOT = const(1)  # from here on their S values


@micropython.viper
def read_dots(line: object, span: int, found: int, memory: object) -> int:
    """Read the numbers after a colon, where scan() has stopped. For Block.read_on.

    All numbers of an S go into dots; the last one is also the value of S. memory: the arrays of
    letters and values that scan() fills, dots, and the block's ints.

    span: the end of the line in bits 8 to 15. found, and the result, as scan() returns them: count
    of words in bits 0 to 7, error number << 8, index in the line of the colon << 16; 0 for none.
    ints[ONLY] is set: a line that asks for more than a straight cut is refused for that.
    """
    _letters, _values, _dots, _ints = memory
    text = ptr8(line)
    letters = ptr8(_letters)
    values = ptr32(_values)
    dots = ptr32(_dots)
    ints = ptr32(_ints)
    count = found & 255  # words read; the last one's number ends at the colon
    pos = found >> 16
    while count and pos and text[pos] == _COLON:
        word = count - 1  # index of the word with the cluster
        if letters[word] != _S:
            return word | BAD_NUMBER_FORMAT << 8
        if ptr8(values)[4 * word + _MINUS_BYTE] & _MINUS:
            return word | NEGATIVE_VALUE << 8
        dots[FIRST_DOT] = values[word]
        dots[DOTS] = 1
        while text[pos] == _COLON:
            if dots[DOTS] == MOST:
                return word | GCODE_MAX_VALUE_EXCEEDED << 8
            pos = int(number(text, pos + 1, values, word))  # the place after the number
            if pos == 0:  # there was none
                return word | BAD_NUMBER_FORMAT << 8
            if ptr8(values)[4 * word + _MINUS_BYTE] & _MINUS:
                return word | NEGATIVE_VALUE << 8
            dots[FIRST_DOT + dots[DOTS]] = values[word]
            dots[DOTS] += 1
        ints[ONLY] = _STRAIGHT_CUT
        # Read the words after the cluster, from pos on: word + 1 have been read.
        found = int(scan(text, word + 1 << 16 | (span & 0xFF00) | pos, letters, values))
        count = found & 255
        pos = found >> 16
    return found


@micropython.viper
def reach(row: ptr32, base: int, whole: int, over: int, parts: int) -> int:
    """Return the tick in the segment at which a motor reaches whole + over / parts steps.

    row[base] and the two after it: the motor's number of steps, tick of the first, tick of the
    last. Step k, from 0, is generated half way between the positions k and k + 1, so

        tick = tick of step `whole` + gap * (over / parts - 1 / 2)

    with the gap between two steps, in ticks.
    """
    gaps = row[base] - 1
    span = row[base + 2] - row[base + 1]  # ticks from the first step to the last one
    gap = span // gaps if gaps > 0 else row[ROW_TICKS]
    return int(step_tick(row, base, whole)) + gap // (2 * parts) * (2 * over - parts)


@micropython.viper
def leading_motor(ring: ptr32, at: int) -> int:
    """Return the index of the motor with the most steps in the block that begins at ring[at]: its
    steps are the block's events."""
    motor = 0
    while ring[at + STEPS + motor] != ring[at + EVENTS]:
        motor += 1
    return motor


@micropython.viper
def dots_begun(done: int, events: int, parts: int) -> int:
    """Return how many of a block's equal parts have begun after `done` of its events: ceil(done *
    parts / events)."""
    return (done * parts + events - 1) // events


@micropython.viper
def write_dots(
    flow: ptr32,
    ring: ptr32,
    table: ptr32,
    row: ptr32,
    beam: ptr32,
    levels: ptr32,
    clusters: ptr32,
    cluster: int,
) -> int:
    """Write the changes of power in a segment of a cluster's block. Returns 0.

    flow, ring, table: the planner's; row: the segment's; beam, levels: see laser.emit().
    clusters[cluster]: the number of the block's dots, with their powers after it.

    All dots have equal length, and the first begins with the block. If power follows speed (M4), a
    segment in which no dot begins has the power of the current dot at the segment's speed. Events
    are steps of the block's leading motor. Dot n, from 0, begins at events * n / parts, which is
    whole + over / parts steps. If events are fewer than dots, there are only as many parts.
    """
    at = flow[BLOCK_AT]  # index of the block in ring
    events = ring[at + EVENTS]
    count = clusters[cluster]
    parts = count if count < events else events
    motor = int(leading_motor(ring, at))
    base = ROW_AXES + ROW_STRIDE * motor  # index in row of its number of steps
    done_after = events - flow[MOTORS + 2 * motor]  # events made when the segment ends,
    done_before = done_after - row[base]  # and when it begins
    dot = int(dots_begun(done_before, events, parts))  # the first that begins in the segment
    changes = int(dots_begun(done_after, events, parts)) - dot  # how many begin in it
    first_tick = 0  # of the segment, when the first of them begins,
    last_tick = 0  # and the last one
    dynamic = ring[at + FLAGS] & DYNAMIC
    if changes:
        whole = events * dot // parts
        over = events * dot - whole * parts
        if done_before:
            first_tick = int(reach(row, base, whole - done_before, over, parts))
        last_tick = first_tick
        if changes > 1:
            last_dot = dot + changes - 1
            whole = events * last_dot // parts
            over = events * last_dot - whole * parts
            last_tick = int(reach(row, base, whole - done_before, over, parts))
    elif dynamic:
        changes = 1  # at the segment's start: the current dot's power at the new speed
        dot -= 1
    begins_here = dot * events >= done_before * parts  # 0: `dot` has begun before
    speed = int(speed_share(flow, ring))
    for i in range(changes):
        index = dot + i if parts == count else (dot + i) * count // parts  # of the dot
        power = clusters[cluster + 1 + index]
        if dynamic:
            power = int(scaled_power(table, power, speed))
        if begins_here or power != beam[LEVEL]:
            emit(beam, levels, power)
        else:
            changes = 0  # the power of the current dot is still right
    place_changes(table, row, beam, changes, first_tick, last_tick)
    return 0


@micropython.viper
def move_dots(
    flow: ptr32,
    ring: ptr32,
    table: ptr32,
    row: ptr32,
    beam: ptr32,
    levels: ptr32,
    clusters: ptr32,
) -> int:
    """Move a segment's power to the beam, as laser.move_power(), also if its block is a cluster.
    Returns 0. flow, ring, table: the planner's; row: the segment's; beam, levels: see emit()."""
    # The block's row number times the length of a row in clusters.
    cluster = flow[BLOCK_AT] // flow[ROW_SIZE] * CLUSTER_LENGTH  # index of the block's dots
    if clusters[cluster] == 0:
        move_power(table, row, beam, levels)
        return 0
    write_dots(flow, ring, table, row, beam, levels, clusters, cluster)
    if flow[LOADED] == 0:  # that was the block's last segment
        clusters[cluster] = 0
    row[ROW_POWER] = KEEP_POWER
    return 0


@micropython.viper
def store_dots(
    values: ptr32,
    count: int,
    scale: ptr32,
    flags: int,
    clusters: ptr32,
    speeds: ptr32,
    block: int,
) -> int:
    """Store the powers of a block's dots, and the S values that they are computed from.

    values: `count` S values, as bits of floats. block: index of its row in the planner's ring.
    clusters: see CLUSTER_LENGTH; speeds: the S values of all blocks, MOST each. scale, flags: see
    spindle.power_from_rpm(). Equal S values in a row are computed once. Returns 0.
    """
    cluster = CLUSTER_LENGTH * block  # index of the block's dots
    last = -1  # no S value
    power = 0
    for i in range(count):
        if values[i] != last:
            last = values[i]
            scale[ASKED] = last
            power = int(power_from_rpm(scale, flags))
        clusters[cluster + 1 + i] = power
        speeds[MOST * block + i] = last
    clusters[cluster] = count
    return 0


class ClusterLaser(Laser):
    """A laser whose power also changes within blocks."""

    def connect_dots(self, planner: "Planner", clusters: "array[int]") -> None:
        """Connect the planner's blocks and the dots of each (clusters: see CLUSTER_LENGTH)."""
        self._flow, self._ring, self._clusters = planner.flow, planner.ring, clusters

    @micropython.viper
    def next(self, row: object) -> int:
        """Fill the next segment's row, as segments.Segments.next(), with its changes of power.
        Returns 1, or 0 if nothing is left to move. Called in the engine's interrupt."""
        if int(self._next_segment(row)) == 0:
            return 0
        flow = ptr32(self._flow)
        ring = ptr32(self._ring)
        table = ptr32(self._table)
        beam = ptr32(self._beam)
        levels = ptr32(self._levels)
        move_dots(flow, ring, table, ptr32(row), beam, levels, ptr32(self._clusters))
        return 1

    def restore_dot(self) -> bool:
        """Restore the power of a dot that a hold has interrupted, before motion starts. Without
        this the laser would stay off until the next dot begins.

        Power that follows speed (M4) starts at 0 instead. Returns True: motion may start.
        """
        flow, ring = self._flow, self._ring
        at = flow[BLOCK_AT]  # index of the block in ring
        cluster = at // flow[ROW_SIZE] * CLUSTER_LENGTH  # index of its dots
        count = self._clusters[cluster]
        if count and flow[LOADED] and not self._reversed and self._engine.idle():
            events = ring[at + EVENTS]
            parts = min(count, events)
            done = events - flow[MOTORS + 2 * leading_motor(ring, at)]
            dot = dots_begun(done, events, parts) - 1
            if dot >= 0:  # else the block has not begun
                self.set_power(self._clusters[cluster + 1 + dot * count // parts])
        return True


class Clusters:
    """Hooks of clusters in the reading of lines and in the planner.

    powers, _speeds: powers and S values of each block's dots, see CLUSTER_LENGTH and MOST. _dots:
    the dots of the line just read, see DOTS; _values: their S values, a part of _dots. _ints: the
    interpreter's block.
    """

    def __init__(self, machine: "Controller") -> None:
        self._machine = machine
        flow = machine.planner.flow
        blocks = flow[ROWS] + 1  # and the system's own
        self.powers = array("i", (0 for _ in range(CLUSTER_LENGTH * blocks)))
        # A spindle override computes the powers from them again.
        self._speeds = array("f", (0.0 for _ in range(MOST * blocks)))
        self._dots = array("i", (0 for _ in range(FIRST_DOT + MOST)))
        self._values = memoryview(self._dots)[FIRST_DOT:]
        block = machine.interpreter.block
        self._ints = block.ints
        letters, values = block.words[:2]
        block.read_on = read_dots, (letters, values, self._dots, self._ints)
        planner = machine.planner
        self._plan, planner.move_hook = planner.move_hook or planner.plan, self.plan
        hooks = machine.state.hooks
        hooks.cleared += (self._clear,)
        hooks.powered += (self._compute_all_powers,)

    # The planner

    def _compute_powers(self, power: "Any", flags: int, block: int) -> None:
        """Compute the powers of a block's dots from their S values, by power(flags, S). block:
        index of its row in the planner's ring; flags: the block's."""
        for i in range(self.powers[CLUSTER_LENGTH * block]):
            self.powers[CLUSTER_LENGTH * block + 1 + i] = power(
                flags, self._speeds[MOST * block + i]
            )

    @micropython.native
    def plan(self, target: "array[float]", flags: int, line: int, power: int, rate: int) -> int:
        """Plan a line, as Planner.plan(), whose arguments and result it has. Store the dots of its
        block first, because the engine may begin it at once. Without M3 and M4 it has none."""
        machine = self._machine
        head = machine.planner.flow[HEAD]
        if not flags & SYSTEM_MOTION:
            # ints[ONLY] is set by read_dots(): the line has a cluster.
            count = self._dots[DOTS] if self._ints[ONLY] and flags & SPINDLE_MASK else 0
            scale = machine.state.spindle
            store_dots(self._values, count, scale, flags, self.powers, self._speeds, head)
        planned = self._plan(target, flags, line, power, rate)
        if machine.planner.flow[HEAD] == head:  # no block was planned
            self.powers[CLUSTER_LENGTH * head] = 0
        return planned

    def _compute_all_powers(self, power: "Any") -> None:
        """Compute the powers of the dots of all blocks again."""
        planner = self._machine.planner
        flow = planner.flow
        row = flow[TAIL]
        while row != flow[HEAD]:
            self._compute_powers(power, planner.ring[row * flow[ROW_SIZE] + FLAGS], row)
            row = (row + 1) % flow[ROWS]

    def _clear(self) -> None:
        """Forget all dots, because the planner is empty."""
        for i in range(0, len(self.powers), CLUSTER_LENGTH):
            self.powers[i] = 0


def prepare(options: "Options", board: "ModuleType") -> None:
    """Check the board file before the machine is created. ValueError without a laser on PIO."""
    option = board.__dict__.get
    if option("TOOL", "spindle") != "laser":
        raise ValueError('CLUSTERS needs TOOL = "laser"')
    if option("ENGINE", "") in ("rmt", "i2s"):
        raise ValueError("CLUSTERS needs a Pico: it uses PIO state machines")
    options.line_length = _LINE_LENGTH
    options.spindle = ClusterLaser


def install(cnc: "Cnc") -> None:
    """Hook into the reading of lines, the planner and the laser's segments.

    A dot that a hold has interrupted gets its power back before each motion.
    """
    machine = cnc.machine
    laser: "Any" = machine.spindle
    laser.connect_dots(machine.planner, Clusters(machine).powers)
    cnc.before_motion(laser.restore_dot)
