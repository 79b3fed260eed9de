"""The package ugrbl_motion on an emulated Pico: put there as by mip, and its pulses counted."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from chips import CHIP, power_up
from ugrbl.boardfile.files import board_file, load_for_build
from ugrbl.compiling import motion_package

pytestmark = pytest.mark.xdist_group("pico group")

STEP, DIRECTION, CAMERA, SWITCH = (2, 3), (5, 6), 15, 16
_LIMIT_US = 60_000_000
_US = 1000  # edges are in ns
_CLOSED_AT = -40  # steps of y

PROGRAM = b"""
import asyncio, gc, time
gc.collect()
free = [gc.mem_free()]
from ugrbl_motion import Axis, Group, Output
from ugrbl_motion.homing import Homing, Switch
x = Axis(2, 5, steps_per_unit=80, speed=100, acceleration=1000)
y = Axis(3, 6, steps_per_unit=80, speed=100, acceleration=1000)
gc.collect()
free.append(gc.mem_free())
group = Group(x=x, y=y, camera=Output(15))
gc.collect()
free.append(gc.mem_free())
print("FREE", *free)
since = time.ticks_us()
for k in range(5):
    group.move_by(20, x=0.5, camera=k % 2 == 0)
print("MOVES", time.ticks_diff(time.ticks_us(), since) // 5)
group.move(30, x=0, y=1)
group.wait()
print("PLAIN", x.steps, y.steps)

async def main():
    first = group.move(30, x=2)
    group.move(30, y=0)
    await group.moved(first)
    print("FIRST", x.steps)
    group.move(x=50)
    await asyncio.sleep(0.1)
    group.stop()
    await group.moved()
    print("STOPPED", x.steps, x.position == x.target)
    await Homing(Switch(16, position=1), -10, 2, back_off=0.25, travel=60).found(y)
    print("HOMED", y.position, y.steps)
    await asyncio.sleep(0.01)
    print("TRACK")
    x.run(15.041)
    since = time.ticks_ms()
    while time.ticks_diff(time.ticks_ms(), since) < 5000:
        pass  # rp2040py gives PIO a whole cycle for each sleep that is shorter: a tick in 80 ms
    group.halt()
    await x.moved()
    print("END", x.steps)

asyncio.run(main())
"""


class Run:
    """One run of the program."""

    def __init__(self, uf2: Path) -> None:
        arch = load_for_build(board_file(CHIP.board)).MPY_ARCH
        made = motion_package.compile_for(arch)
        files = {f"lib/{path}": content for path, content in made.files.items()}
        self.pico = power_up(uf2, {**files, "main.py": PROGRAM})
        self.pico.record([*STEP, *DIRECTION, CAMERA])
        self.pico.drive(SWITCH, 1)
        self._seen, self._sign, self._y = 0, 1, 0  # edges evaluated; y's direction and steps
        assert self.pico.run_until(self._update_switch, _LIMIT_US, step_us=1000), self.text
        self.pico.run_us(100_000)

    @property
    def text(self) -> str:
        return bytes(self.pico.usb.received).decode()

    def _update_switch(self) -> bool:
        """Close the switch while y is half a unit below 0 or lower; return whether the program has
        ended."""
        for edge in self.pico.edges[self._seen :]:
            if edge.pin == DIRECTION[1]:
                self._sign = -1 if edge.level else 1
            elif edge.pin == STEP[1] and edge.level:
                self._y += self._sign
        self._seen = len(self.pico.edges)
        self.pico.drive(SWITCH, 0 if self._y <= _CLOSED_AT else 1)
        return "END" in self.text or "Error" in self.text

    def values_of(self, word: str) -> "list[str]":
        """Return the other words of the line of the output that begins with this word."""
        lines = [line.split() for line in self.text.splitlines()]
        rests = [line[1:] for line in lines if line[:1] == [word]]
        assert len(rests) == 1, self.text
        return rests[0]

    def pulses(self, axis: int) -> "list[tuple[float, int]]":
        """Return (ns, 1 or -1) of each step."""
        steps, sign = [], 1
        for edge in self.pico.edges:
            if edge.pin == DIRECTION[axis]:
                sign = -1 if edge.level else 1
            elif edge.pin == STEP[axis] and edge.level:
                steps.append((edge.ns, sign))
        return steps

    def steps(self, axis: int) -> int:
        return sum(sign for _, sign in self.pulses(axis))


@pytest.fixture(scope="module")
def run(uf2: Path) -> Run:
    return Run(uf2)


def test_the_program_counts_the_steps_that_the_pins_make(run: Run) -> None:
    """PLAIN is printed with x at 0 and y at 1 unit of 80 steps, END with x's count at the end."""
    assert run.values_of("PLAIN") == ["0", "80"]
    assert int(run.values_of("END")[0]) == run.steps(0)


def test_moves_and_waits_of_tasks_are_those_of_the_simulator(run: Run) -> None:
    """FIRST is printed when a move of x to 2 units has ended, of 80 steps each. STOPPED is printed
    after a stop on its way to 50, which makes the place of the stop its target."""
    assert 160 <= int(run.values_of("FIRST")[0]) <= 161
    steps, at_target = run.values_of("STOPPED")
    assert at_target == "True" and 160 < int(steps) < 50 * 80


def test_the_switch_is_found_to_the_step(run: Run) -> None:
    """Homing sets position 1 at the switch, and backs off by 0.25: 1.25 units, of 80 steps."""
    position, steps = run.values_of("HOMED")
    assert abs(float(position) - 1.25) <= 1 / 80 and int(steps) == round(float(position) * 80)
    # At the pins: y closed it half a unit below 0, and went back a quarter of a unit.
    assert abs(run.steps(1) - (-40 + 20)) <= 2


def test_the_output_changes_with_its_moves(run: Run) -> None:
    """The program's first five moves are of 0.5 units, 40 steps, and switch the camera's output
    on and off in turn."""
    changes = [(edge.ns, edge.level) for edge in run.pico.edges if edge.pin == CAMERA]
    assert [level for _, level in changes[:5]] == [1, 0, 1, 0, 1]
    x_pulses = run.pulses(0)
    steps = [sum(sign for ns, sign in x_pulses if ns < change) for change, _ in changes[:5]]
    # The interrupt sets it some microseconds after a move begins; a step takes 600 us there.
    assert steps == [0, 40, 80, 120, 160]


def test_the_rate_is_exact_in_single_precision(run: Run) -> None:
    """The program's last motion, x.run(15.041) units/s, of 80 steps. Measured over more than 4 s,
    because a step may be 1 to 2 us off its time."""
    steps = [ns for ns, _ in run.pulses(0)]
    track: "list[Any]" = []  # steps after the last pause
    for before, ns in pairwise(steps):
        track = [*track, ns] if ns - before < 2_000 * _US else [ns]
    track = track[200:-5]  # without acceleration and the end
    assert len(track) > 5000
    steps_per_s = (len(track) - 1) / (track[-1] - track[0]) * 1e9
    assert abs(steps_per_s / (15.041 * 80) - 1) < 1e-6


def test_memory_and_speed(run: Run) -> None:
    """Free bytes and us of a move; docs have the figures that are printed."""
    before, imported, made = map(int, run.values_of("FREE"))
    print(f"free: {before}, {imported} with the package, {made} with a group of two axes")
    print(f"a move takes {run.values_of('MOVES')[0]} us")
    assert before - imported < 45_000 and imported - made < 20_000
    assert int(run.values_of("MOVES")[0]) < 2500
