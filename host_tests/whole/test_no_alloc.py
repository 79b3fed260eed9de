"""The interrupt's path and a line's kernels allocate nothing, under the desktop MicroPython."""

import pytest
from micropython_runner import needs_micropython, run_micropython
from ugrbl.paths import FIRMWARE

pytestmark = needs_micropython

# `proved` is called once to fill caches, then again with the heap locked. Its calls take no
# arguments: passing on a tuple of them would allocate by itself.
_BENCH = """
import gc
from array import array

from motion import arc_geometry, arcs, layout, plan_kernel
from talk import lines
import micropython
from control import canon
from control.coords import Coords
from control.modes import Modes
from language import block_layout as b
from language import line as ln
from language import words
from language.block import Block
from base.float32 import vector
from motion.planner import Move, Planner
from motion.segments import Segments
from base.state import State


class Settings:
    steps_per_mm = array("f", [250.0, 80.0, 4000.0])
    max_rate = array("f", [3000.0, 5000.0, 500.0])
    acceleration = array("f", [360000.0, 3600000.0, 36000.0])
    junction_deviation_mm = 0.01


def allocates(proved):
    proved()
    failed = False
    gc.collect()
    micropython.heap_lock()
    try:
        proved()
    except MemoryError:
        failed = True
    micropython.heap_unlock()
    return failed


state = State()
planner = Planner(3, 16, None, state)
planner.configure(Settings, 13107200, 17, 90909)
planner.override()
segments = Segments(planner)
rate = planner.rate(3000.0)
flow, ring, table = planner.flow, planner.ring, planner.table
row = array("i", [0] * layout.row_length(3))
move = Move()
target = vector(3)


def plan():
    for i in range(8):
        target[0] = 3.0 * (i % 3)
        target[1] = 0.7 * i
        target[2] = -0.1 * i
        move.feed = 1000.0
        planner.line(target, move, 0)


plan()
text = bytearray(b"G1X-12.345Y0.0000678Z99999999.9F1500S12000\\0")
end = len(text) - 1 << 8
letters = bytearray(128)
values = array("f", [0.0] * 128)
short = bytearray(b"G1X-12.345Y0.25N7\\0")
line = words.Words()
dot = bytearray(b"G1X-12.345Y0.25N7S500F300\\0")
bow = bytearray(b"G2X1Y0.02R50F300\\0")
there = array("i", [3, 0, 1000, 2000, 300])
block, modes = Block(b"XYZ", True, True), Modes(3)
modal = modes.modal
machine = array("i", [3, 7, 2] + [0] * (b.MACHINE_LENGTH - 3))
machine[b.IS_OPEN] = 1
kept = (
    block.ints, block.singles, block.xyz, modes.rates, modes.position, Coords(None, 3, 2).offsets,
    machine, state.spindle, (block.stored, block.arc.plane, block.arc.numbers),
)
course = array("i", [0] * arcs.course_length(3))
plans = (
    there, table, ring, flow, planner.speeds, state.running, None, planner.steps_per_mm, course,
)
memory = block.words, kept, plans
texts = [
    bytearray(text.encode() + b"\\0")
    for text in ("G10L20P1X1Y2", "G92X1", "G28X1", "G2X1Y1R5F9", "G49T1", "M56P0", "X", "Q1")
]


def look():
    for text in texts:
        ln.check_line(text, len(text) - 1 << 8, modal, 0, memory)


arc = arc_geometry.Arc()
arc.numbers[arc_geometry.RADIUS] = arc.numbers[arc_geometry.CENTRE_0] = 5.0
for axis in range(3):
    arcs.limit(course, axis, -arcs.FARTHEST, arcs.FARTHEST)
arcs.stray(course, 0.00002)
arc.lay(vector(3), vector(3), planner.steps_per_mm, course)
reader = lines.LineReader(128, 79, lambda byte: None)
heard, at, typed, kinds = reader.memory()
received = bytearray(b"G1 X1 (a comment) ? y2\\n")
"""

_CALLS = {
    "plan": "plan_kernel.plan_block(target, table, ring, flow, 0, 0, 0, rate)",
    "schedule": "plan_kernel.compute_profile(table, ring, 0)",
    "limit_entry": "plan_kernel.limit_entry(ring, flow, 2)",
    "reverse_pass": "plan_kernel.reverse_pass(ring, flow, 1)",
    "scan": "words.scan(text, end, letters, values)",
    "read": "line.read(short, 0, len(short) - 1)",
    "look": "look()",
    "an arc": "ln.execute(bow, len(bow) - 1, modal, machine, memory)",
    "execute": "ln.execute(dot, len(dot) - 1, modal, machine, memory)",
    "judge": "canon.check_travel(target, there, flow)",
    "chords": "planner.chords(course, move, 0, True)",
    "chords in check mode": "planner.chords(course, move, 0, False)",
    "feed": "reader.feed(received, len(received))",
    "clean": "lines.clean(heard, at, typed, kinds)",
}

_SEGMENTS = """
def make():
    made = 0
    for k in range(400):
        if k == 60:
            segments.hold(True)
        if k == 120:
            segments.hold(False)
        made += segments.next(row)
    return made

print(allocates(make), flow[layout.TAIL] > 2)
"""


_JERK = """
from extras.motors.jerk import Jerk
from extras.motors import jerk_plan

state.hooks.next_segment = segments.next
jerk = Jerk(planner, state)
jerk.limit([100.0, 1000.0, 10.0], [2000.0, 20000.0, 500.0], 0.01)
plan()
move.flags = 64


def make():
    made = 0
    for k in range(400):
        if k == 60:
            segments.hold(True)
        if k == 120:
            segments.hold(False)
        made += jerk.next(row)
    planner.catch_up()
    jerk_plan.reschedule(table, ring, flow, -1)
    return made


print(allocates(make), flow[layout.TAIL] > 5)
"""


def test_an_allocation_is_found() -> None:
    two_allocations = 'x = 1.0\nprint(allocates(lambda: x + 1.5), allocates(lambda: "%d" % 7))'
    assert run_micropython(_BENCH + two_allocations, paths=[FIRMWARE]).split() == ["True", "True"]


@pytest.mark.parametrize("call", _CALLS.values(), ids=_CALLS)
def test_a_kernel_allocates_nothing(call: str) -> None:
    code = f"print(allocates(lambda: {call}))"
    assert run_micropython(_BENCH + code, paths=[FIRMWARE]) == "False\n"


def test_segments_are_made_without_allocating_through_blocks_and_holds() -> None:
    """The script prints whether it allocated, and whether more than two blocks were executed."""
    assert run_micropython(_BENCH + _SEGMENTS, paths=[FIRMWARE]).split() == ["False", "True"]


def test_segments_are_made_without_allocating_with_jerk_limited() -> None:
    """The script prints whether it allocated, and whether more than five blocks were executed."""
    assert run_micropython(_BENCH + _JERK, paths=[FIRMWARE]).split() == ["False", "True"]
