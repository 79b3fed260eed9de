"""Compare the emulated clock with figures that others have published of real boards.

A few lines of our own do the same operations as theirs, at MicroPython's prompt without our
firmware. The row is `measured / published`: below 1 the emulator is faster than a real chip. All
boards are RP2040 at 125 MHz. Their MicroPython is older than 1.28. In 1.28 interpreter and memory
management run from flash because of a fault in a linker script; before and after it they run
from RAM (LINKER). So with 1.28 and the model of the flash cache (host_tests/emulator/xip.py)
ratios have to be above 1: the loops have 1.14 to 1.54. With an image of 1.23.0 (SHAO's version,
built here) they are 0.93 to 0.99 with and without the model, because a loop hardly misses the
cache when its interpreter is in RAM.

So the loops do not show the cost of a miss; LINKER does. Twelve programs of tests/perf_bench
become faster on a Pico W when the interpreter moves to RAM: 13 % in the mean, 29 % at most. With
the model and two images of 1.28 that differ in that line alone, the mean is 13 % at 30 cycles a
miss, 17 % at 40 and 21 % at 50. At 40 each program is 9 % away from its real figure (root mean
square), because each image places other code in the same line of the cache. NANO's score of
bm_chaos, with the interpreter in flash, is 154; the model gives 171, 154 and 140. The choice of
the way that is replaced makes no difference (random: 17 %). We know no published figure of viper
code; it lies in RAM, and the emulator counts its instructions like those of the interpreter.

    SHAO    github.com/shaoziyang/micropython_benchmarks, README.md at 46c413b (2025-06-25), row
            RP2040, MicroPython v1.23.0, 125 MHz: ms for 10000 turns of `C = p[1] + p[2]` and the
            like, by kind of number. Ours: fewer turns.
    GEORGE  github.com/micropython/micropython/pull/12846, comment of 2023-11-09, a Pico with 1.22
            in the making, after that change: scores of tests/perf_bench with N=100 M=100; a score
            is 1e6 * count / us. bm_float 3769.89, count 250: so many objects, scaled to unit
            length and compared (sine, cosine, root, methods). core_locals 28.30, count 8: as many
            objects, 8 rounds of getattr and setattr each, with 141 names of which 83 differ. Ours:
            250, and 1 object.
    LINKER  github.com/micropython/micropython/pull/19370, description of 2026-06-23.
    NANO    github.com/micropython/micropython/pull/19352, description of 2026-06-18.
"""

from collections.abc import Iterator
from typing import NamedTuple

import prompt
from bench_setup import Bench
from rows import Row

_TIMED = """
import gc, time
def timed(act, *args):
    gc.collect()
    start = time.ticks_us()
    act(*args)
    return time.ticks_diff(time.ticks_us(), start)
"""
_TURNS = """
def turns(p):
    for _ in range(p[0]):
        s = p[1] {} p[2]
print(timed(turns, [{}, {}, {}]))
"""
_POINTS = """
import math
class Point:
    def __init__(self, i):
        self.x = x = math.sin(i)
        self.y = math.cos(i) * 3
        self.z = (x * x) / 2
    def unit(self):
        x, y, z = self.x, self.y, self.z
        length = math.sqrt(x * x + y * y + z * z)
        self.x /= length
        self.y /= length
        self.z /= length
    def most(self, other):
        self.x = self.x if self.x > other.x else other.x
        self.y = self.y if self.y > other.y else other.y
        self.z = self.z if self.z > other.z else other.z
        return self
def points(n):
    made = [None] * n
    for i in range(n):
        made[i] = Point(i)
    for point in made:
        point.unit()
    best = made[0]
    for point in made[1:]:
        best = best.most(point)
print(timed(points, 250))
"""
_NAMES = """
class Holder:
    pass
names = {}
def rounds(n):
    holder = Holder()
    for _ in range(n):
        for name in names:
            setattr(holder, name, getattr(holder, name, 0) + 1)
print(timed(rounds, 8))
"""
_WORDS = [f"n{(k * (k // 83 + 1) % 83) * 7919 % 9973}" for k in range(141)]


class _Figure(NamedTuple):
    """Yield the ratios measured / published (see the module's docstring)."""

    name: str
    us: float
    source: str
    code: str


def _turns(name: str, ms: float, sign: str, a: float, b: float, turns: int) -> _Figure:
    code = _TURNS.format(sign, turns, a, b)
    return _Figure(name, ms * 1000 * turns / 10_000, "SHAO", code)


_FIGURES = (
    _turns("integers added", 80, "+", 12345678, 56781234, 4000),
    _turns("long integers multiplied", 276, "*", 12345678, 56781234, 1000),
    _turns("integers divided", 126, "/", 99999991, 45481, 2000),
    _turns("floats added", 129, "+", 12345678.1234, 56781234.5678, 2000),
    _turns("floats multiplied", 129, "*", 12345678.1234, 56781234.5678, 2000),
    _turns("floats to the power of", 993, "**", 1234.5678, 2.3456, 300),
    _Figure("objects, methods and floats", 250e6 / 3769.89, "GEORGE", _POINTS),
    _Figure("attributes by name", 8e6 / 28.30 / 8, "GEORGE", _NAMES.format(_WORDS)),
)


def calibration(bench: Bench) -> Iterator[Row]:
    """Ratios, as said above."""
    talk = bench.bare()
    prompt.run(talk, _TIMED)
    ratios = []
    for figure in _FIGURES:
        ratios.append(int(prompt.run(talk, figure.code)) / figure.us)
        published = f"of {figure.us / 1000:.2f} ms ({figure.source})"
        yield Row(f"calibration: {figure.name}", ratios[-1], published)
    yield Row("calibration: least", min(ratios), "of published")
    yield Row("calibration: most", max(ratios), "of published")
