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
from language import fast_kernel
from language import words
from base.f32 import vector
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
dot = bytearray(b"X-12.345S500F300\\0")
here = vector(3)
rates = vector(2)
there = array("i", [3, 0, 1000, 2000, 300])
known = array("i", [0] * (fast_kernel.OFFSETS + 3))
known[fast_kernel.AXES], known[fast_kernel.MODE] = 3, fast_kernel.HAS_G1
known[fast_kernel.FEED] = 7
known[fast_kernel.OFFSETS] = 7
arc = arc_geometry.Arc()
arc.numbers[arc_geometry.RADIUS] = arc.numbers[arc_geometry.CENTRE_0] = 5.0
course = array("i", [0] * arcs.course_length(3))
for axis in range(3):
    arcs.limit(course, axis, -arcs.FARTHEST, arcs.FARTHEST)
arc.lay(vector(3), vector(3), 0.00002, planner.steps_per_mm, course)
reader = lines.LineReader(128, 79, lambda byte: None)
heard, at, typed, kinds = reader.memory()
received = bytearray(b"G1 X1 (a comment) ? y2\\n")
"""

_PROVED = {
    "plan": "plan_kernel.plan(target, table, ring, flow, 0, 0, 0, rate)",
    "schedule": "plan_kernel.schedule(table, ring, 0)",
    "limit_entry": "plan_kernel.limit_entry(ring, flow, 2)",
    "reverse_pass": "plan_kernel.reverse_pass(ring, flow, 1)",
    "scan": "words.scan(text, end, letters, values)",
    "read": "line.read(short, 0, len(short) - 1)",
    "fast_kernel.read": "fast_kernel.read(short, 0, len(short) - 1, known)",
    "place": "fast_kernel.place(known, 7, here, target)",
    "line_number": "fast_kernel.line_number(known, fast_kernel.HAS_N)",
    "judge": "canon.judge(target, there, flow)",
    "follow": "fast_kernel.follow(short, len(short) - 1, known, here, target, there, table, ring, "
    "flow, planner.speeds, state.changes, rates, state.spindle, None)",
    "follow with a new S": "fast_kernel.follow(dot, len(dot) - 1, known, here, target, there, "
    "table, ring, flow, planner.speeds, state.changes, rates, state.spindle, None)",
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
from extras.jerk import Jerk
from motion import jerk_plan

jerk = Jerk(planner, state, segments.next)
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
    jerk_plan.reschedule(table, ring, flow)
    return made


print(allocates(make), flow[layout.TAIL] > 5)
"""


def test_what_allocates_is_found() -> None:
    control = 'x = 1.0\nprint(allocates(lambda: x + 1.5), allocates(lambda: "%d" % 7))'
    assert run_micropython(_BENCH + control, paths=[FIRMWARE]).split() == ["True", "True"]


@pytest.mark.parametrize("call", _PROVED.values(), ids=_PROVED)
def test_a_kernel_allocates_nothing(call: str) -> None:
    proof = f"print(allocates(lambda: {call}))"
    assert run_micropython(_BENCH + proof, paths=[FIRMWARE]) == "False\n"


def test_segments_are_made_without_allocating_through_blocks_and_holds() -> None:
    assert run_micropython(_BENCH + _SEGMENTS, paths=[FIRMWARE]).split() == ["False", "True"]


def test_segments_are_made_without_allocating_where_jerk_is_limited() -> None:
    assert run_micropython(_BENCH + _JERK, paths=[FIRMWARE]).split() == ["False", "True"]
