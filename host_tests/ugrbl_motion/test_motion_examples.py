"""The examples of ugrbl_motion: a mount, a turntable, a plotter. In both Pythons."""

import asyncio
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from micropython_runner import needs_micropython, run_micropython
from motion.layout import ROW_AXES, ROW_DIRS
from ugrbl.paths import EXAMPLES, FIRMWARE
from ugrbl.sim import group_program
from ugrbl.sim.group_hardware import SimHardware

_FOLDER = EXAMPLES / "motion"
_NAMES = sorted(path.stem for path in _FOLDER.glob("*.py"))
_TOOLS = Path(group_program.__file__).parents[1]
_MOST_LINES = 30


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch) -> "Iterator[None]":
    """Run in the examples' folder; restore what a simulated program replaces."""
    monkeypatch.chdir(_FOLDER)
    monkeypatch.setattr("ugrbl_motion.hardware.own", None)
    policy = asyncio.get_event_loop_policy()
    yield
    asyncio.set_event_loop_policy(policy)


def run_example(name: str, *changes: "tuple[str, str]") -> SimHardware:
    """Run an example with changes of its text; return its hardware."""
    text = (_FOLDER / f"{name}.py").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (hardware,) = group_program.run(text, name)
    return hardware


@pytest.mark.parametrize("name", _NAMES)
def test_an_example_has_at_most_thirty_lines(name: str) -> None:
    assert len((_FOLDER / f"{name}.py").read_text().splitlines()) <= _MOST_LINES


# Step ticks of an axis


def step_ends(hardware: SimHardware, axis: int) -> "list[tuple[int, int]]":
    """Return (tick of the last step of a row, steps made so far) of an axis."""
    count_at = ROW_AXES + 3 * axis
    ends, total_steps = [], 0
    for start, row in hardware.made:
        total_steps += row[count_at]
        if row[count_at]:
            ends.append((start + row[count_at + 2], total_steps))
    return ends


@pytest.mark.parametrize("seconds", [100, pytest.param(3600, marks=pytest.mark.thorough)])
def test_the_mount_follows_the_sky_with_an_error_below_1e_6(seconds: int) -> None:
    """mount.py slews both axes, then tracks for `seconds` at 15 arc seconds per second."""
    hardware = run_example("mount", ("3600)", f"{seconds})"))
    per_arcsec = 200 * 64 * 3 * 144 / 1_296_000  # steps; 1296000 arc seconds are a turn
    ends = step_ends(hardware, 1)  # axes are in the order of their names: dec, ra
    hz = hardware.sim.tick_hz
    # the slew of ra ends at 54000 arc seconds
    slewed = next(total_steps for tick, total_steps in ends if total_steps >= 54_000 * per_arcsec)
    track = [(tick, total_steps) for tick, total_steps in ends if total_steps > slewed + 10][:-10]
    (first_tick, first_steps), (last_tick, last_steps) = track[0], track[-1]
    assert last_tick - first_tick > (seconds - 10) * hz
    rate = (last_steps - first_steps) / per_arcsec / ((last_tick - first_tick) / hz)
    assert abs(rate / 15.0 - 1) < 1e-6
    # Nor is it ever off: each step within a thousandth of its interval.
    interval = hz / (15.0 * per_arcsec)
    for tick, total_steps in track:
        assert (
            abs(tick - first_tick - (total_steps - first_steps) * interval) < interval / 1000 + 2
        )
    assert hardware.steps()[0] == round(36_000 * per_arcsec)  # dec


def test_the_scanner_triggers_its_camera_after_equal_steps_without_a_stop() -> None:
    hardware = run_example("scanner")
    on = [(tick, steps[0]) for tick, levels, steps in hardware.outputs if levels]
    assert len(on) == 36
    steps_per_photo = 10 * 200 * 16 * 4 / 360  # 10 degrees
    assert [steps for _, steps in on] == [round(steps_per_photo * (k + 1)) for k in range(36)]
    intervals = [b - a for (a, _), (b, _) in pairwise(on)]
    tick_hz = hardware.sim.tick_hz
    # a photo every third of a second
    assert all(
        abs(time - tick_hz / 3) < tick_hz / 3 * 0.002 for time in intervals
    )  # a step is 0.3 %


DRAWING = """<svg><path id="one" d="M10,10 L30 10 30,20.5 z"/>
<path d="m 5 5 c 0,-2.5 2,-4.5 4.5,-4.5 l1-1 M 1e-1 0 C 1 0 2 0 3,0"/></svg>"""


def corners(hardware: SimHardware, pen: float = 0.0) -> "list[tuple[float, float]]":
    """Return the positions (mm) at the ends of rows with the pen down, corners among them.
    pen: its steps when down; axes: pen, x, y, with 80 steps per mm, y inverted."""
    corners_mm, steps = [], [0, 0, 0]
    for _, row in hardware.made:
        steps_before = tuple(steps)
        for i in range(3):
            count = row[ROW_AXES + 3 * i]
            steps[i] += -count if row[ROW_DIRS] >> i & 1 else count
        if steps[0] == pen and steps_before != tuple(steps):
            corners_mm.append((steps[1] / 80, -steps[2] / 80))
    return corners_mm


def test_the_plotter_draws_the_paths(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The corners of the paths are reached within 0.5 mm; places off them are not."""
    (tmp_path / "drawing.svg").write_text(DRAWING)
    monkeypatch.chdir(tmp_path)
    corners_mm = corners(run_example("plotter"))
    distance = lambda x, y: min(abs(x - a) + abs(y - b) for a, b in corners_mm)  # noqa: E731
    for place in ((10, 10), (30, 10), (30, 20.5), (20, 15.25), (5, 5), (9.5, 0.5), (10.5, -0.5)):
        assert distance(*place) < 0.5, place
    assert distance(6.125, 2.1) < 0.6  # on the curve
    assert distance(20, 18) > 2 and distance(15, 5) > 2  # no line is there
    assert distance(3, 0) < 0.1  # end of the last curve


def test_the_drawing_of_the_example_is_drawn_and_ends_with_the_pen_up() -> None:
    hardware = run_example("plotter")
    assert hardware.steps()[0] == 800  # the pen, up
    corners_mm = corners(hardware)
    # size of the drawing, mm
    assert max(x for x, _ in corners_mm) == 55 and max(y for _, y in corners_mm) == 45


@pytest.mark.parametrize("name", ["plotter", "scanner"])
@needs_micropython
def test_both_pythons_move_equally(name: str) -> None:
    """The simulated run prints steps and times: the output is the same."""
    script = f"import sys; sys.argv[1:] = ['{name}.py']; __import__('sim.group_program')"
    script += "; sys.modules['sim.group_program'].main()"
    in_micropython = run_micropython(script, paths=[FIRMWARE, _TOOLS], heapsize="64M")
    command = [sys.executable, "-m", "ugrbl.sim.group_program", f"{name}.py"]
    in_python = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert in_python == in_micropython and "steps" in in_python


_TASKS = """
import sys
from sim.group_hardware import simulate
from sim.virtual_asyncio import install
made = simulate()
install(made)
import asyncio
from ugrbl_motion import Axis, Group
from ugrbl_motion.homing import Homing, Switch
x = Axis(2, 5, 80, 100, 500)
group = Group(x=x)
made[0].switch(20, 0, -800, above=False)
seen = []
async def watch():
    while True:
        seen.append(x.steps)
        await asyncio.sleep(0.05)
async def main():
    task = asyncio.create_task(watch())
    await Homing(Switch(20, position=3), speed=-50, slow=2, back_off=1, travel=50).found(x)
    print(x.position, made[0].steps()[0])
    first = group.move(20, x=10)
    group.move(x=20)
    await x.moved(first)
    group.stop()
    await x.moved()
    print(group.done(), x.position == x.target, 10 <= x.position < 13)
    x.run(-15.041)
    await asyncio.sleep(10)
    group.pace(1.5)
    await asyncio.sleep(1)
    group.stop()
    await group.moved()
    print(len(seen) > 200)
    task.cancel()
asyncio.run(main())
"""


@needs_micropython
def test_tasks_run_in_micropython(tmp_path: Path) -> None:
    """Homing, stop and pace by tasks; what the script prints: position 4 = 3 + 1 and -800 + 80
    steps; then checks."""
    out = run_micropython(_TASKS, paths=[FIRMWARE, _TOOLS], heapsize="64M")
    assert out.splitlines() == ["4.0 -720", "True True True", "True"]


_NO_ALLOCATION = """
import gc, micropython
from array import array
from sim.group_hardware import SimHardware
from ugrbl_motion import Axis, Group, Output
hardware = SimHardware()
hardware.write = lambda levels: None
x, y = Axis(2, 5, 80, 100, 500), Axis(3, 6, 80, 100, 500)
group = Group(x=x, y=y, out=Output(15), hardware=hardware)
lines = group._lines
lines.paused = True  # the engine does not pull
for k in range(6):
    group.move_by(15.041, x=1.0, y=0.3, out=k % 2)
row = array("i", [0] * 12)
segment, on_row, on_rest, halt = lines._segments.next, lines._on_row, lines._on_rest, lines.halt

def interrupt():
    for _ in range(20):
        segment(row)
        on_row(row[2])
    on_rest()
    halt()

interrupt()
gc.collect()
micropython.heap_lock()
try:
    interrupt()
    print("nothing allocated", row[0] > 0)
except MemoryError:
    print("allocated")
micropython.heap_unlock()
"""


@needs_micropython
def test_the_interrupts_path_allocates_nothing() -> None:
    """In an interrupt MicroPython cannot allocate memory; heap_lock() forbids it here."""
    out = run_micropython(_NO_ALLOCATION, paths=[FIRMWARE, _TOOLS])
    assert out == "nothing allocated True\n"
