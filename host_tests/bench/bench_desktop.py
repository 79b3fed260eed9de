"""`make bench`: how fast the firmware runs on this desktop, as ratios within one run.

Times of a shared machine mean little by themselves. So a plain Python loop is timed before and
after, and each figure is also given in turns of that loop. Kernels are compiled if there is a C
compiler; UGRBL_VIPER=fast runs them as Python.
"""

from statistics import median
from time import perf_counter

from ugrbl.paths import EXAMPLES
from ugrbl.run.program import run_program

_LOOPS = 200_000
_RUNS = 3
_SETTINGS = ("$110=5000", "$111=5000", "$112=2000", "$120=500", "$121=500", "$122=300")
_SHORT = [
    b"G91 F1200",
    *(b"G1X0.0%dY0.0%d" % (3 + i % 5, 6 - i % 5) for i in range(50_000)),
]
# Each line has a new feed rate.
_FEEDS = [line + b"F12%02d" % (i % 100) for i, line in enumerate(_SHORT[1:6001])]


def _loop_s() -> float:
    """Return the seconds for one turn of a plain Python loop."""
    begin_s = perf_counter()
    total = 0
    for i in range(_LOOPS):
        total += i & 3
    return (perf_counter() - begin_s) / _LOOPS


def _measure(name: str, lines: "list[bytes]", check: bool = False) -> str:
    figures = []
    for _ in range(_RUNS):
        loop_before_s = _loop_s()
        begin_s = perf_counter()
        result, _ = run_program(lines, settings=_SETTINGS, check=check)
        seconds = perf_counter() - begin_s
        loop_s = (loop_before_s + _loop_s()) / 2
        assert not result.errors, result.errors[:3]
        figures.append(
            (seconds / len(lines), seconds / len(lines) / loop_s, result.totals.time_s / seconds)
        )
    line, turns, speed = (median(column) for column in zip(*figures, strict=True))
    real = "" if check else f"{speed:8.1f} times real time"
    return f"{name:<24}{1 / line:8.0f} lines/s {turns:8.0f} loop turns a line{real}"


def main() -> None:
    badge = (EXAMPLES / "badge.nc").read_bytes().splitlines()
    print(_measure("short moves", _SHORT))
    print(_measure("the same, check mode", _SHORT, check=True))
    print(_measure("each with a new F", [_SHORT[0], *_FEEDS]))
    print(_measure("badge.nc", badge))
    print(_measure("badge.nc, check mode", badge, check=True))


if __name__ == "__main__":
    main()
