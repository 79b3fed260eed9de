"""`make bench-board`: measure a board and print a table. UGRBL_UF2 names an image, PORT a board.

    bench_board.py [--columns plain,cache] [PART]...        all parts, or those named

Emulated times are those of the emulated chip. On hardware a sender's times are this computer's,
USB included. An emulated board is measured twice: with the plain emulator, in which reads of flash
take no time, and with a model of the chip's flash cache (host_tests/emulator/xip.py), in which the
core waits after a miss. A real board gets the benchmark's commands at its prompt; its program and
settings are restored at the end. It moves its axes, so switch the motors off. Rows that need
power-up or the pins are left out there.
"""

import argparse
import os
import resource
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

_HERE = Path(__file__).resolve().parent
sys.path[:0] = [
    str(Path(sys.prefix) / "emulator"),  # compiled, three times as fast
    str(_HERE),
    str(_HERE.parent / "emulator"),
    str(_HERE.parent.parent / "tools" / "sim" / "standins"),
    str(_HERE.parent.parent / "firmware"),
]

import pins  # noqa: E402
import talking  # noqa: E402
import xip  # noqa: E402
from bench_setup import Bench, Counts  # noqa: E402
from calibration import calibration  # noqa: E402
from chips import CHIP  # noqa: E402
from programs import programs  # noqa: E402
from rows import Row, head, text  # noqa: E402

_Part = Callable[[Bench], Iterator[Row]]

_PARTS: "dict[str, _Part]" = {
    "boot": talking.boot,
    "memory": talking.memory,
    "heap": talking.heap,
    "settings": talking.settings,
    "queries": talking.queries,
    "lines": talking.lines,
    "special": talking.special_lines,
    "long": talking.long_lines,
    "clusters": talking.clusters,
    "axes": talking.axes,
    "chords": talking.chords,
    "share": pins.share,
    "hold": pins.hold,
    "rates": pins.rates,
    "stages": talking.stages,
    "gaps": talking.gaps,
    "programs": programs,
    "calibration": calibration,
}
_EMULATED_ONLY = ("boot", "clusters", "axes", "hold", "rates", "programs")


_PLAIN, _CACHE = "plain", "cache"


def _benches(port: str, uf2: str, columns: "Sequence[str]") -> "list[Bench]":
    """Return one bench for each column; exit if a column is impossible."""
    if port:
        return [Bench(port=port)]
    if not uf2:
        sys.exit("which board? UGRBL_UF2=RPI_PICO-….uf2 make bench-board, or PORT=/dev/ttyACM0")
    if _CACHE in columns and not (CHIP.name == "rp2040" and xip.is_there()):
        print("no model of the flash cache: of an RP2040 there is one, make compiled-emulator")
        columns = [_PLAIN]
    return [Bench(Path(uf2), cache=column == _CACHE) for column in columns]


def _measure(name: str, benches: "list[Bench]") -> "Iterator[Sequence[Row]]":
    """Return a part's rows, and the cycles that its columns waited for flash."""
    before = [bench.counts() for bench in benches]
    yield from zip(*(_PARTS[name](bench) for bench in benches), strict=True)
    if any(bench.cache for bench in benches):
        yield from zip(*(_waits(name, *x) for x in zip(before, (b.counts() for b in benches))))


def _waits(name: str, before: Counts, after: Counts) -> "Iterator[Row]":
    hits, misses, stalled, cycles = (b - a for a, b in zip(before, after))
    reads = hits + misses
    yield Row(f"{name}: reads of flash", reads / 1e6, "millions")
    yield Row(f"{name}: not in the cache", 100 * misses / max(reads, 1), "%")
    yield Row(f"{name}: cycles that wait for flash", 100 * stalled / max(cycles, 1), "%")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="What a board can do, as a table.")
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(_PARTS))
    parser.add_argument("--columns", default=f"{_PLAIN},{_CACHE}", help="plain, cache or both")
    arguments = parser.parse_args()
    unknown = [name for name in arguments.parts if name not in _PARTS]
    if unknown:
        parser.error(f"no part {', '.join(unknown)}; there are {', '.join(_PARTS)}")
    return arguments


def main() -> None:
    """Print rows as soon as they are measured."""
    arguments = _arguments()
    port = os.environ.get("PORT", "")
    benches = _benches(port, os.environ.get(CHIP.image, ""), arguments.columns.split(","))
    if port:
        print(f"on hardware, at {port}")
    else:
        print(head([_CACHE if bench.cache else "emulated" for bench in benches]))
    for name in arguments.parts or _PARTS:
        if port and name in _EMULATED_ONLY:
            print(f"{name}: emulated boards only")
            continue
        for rows in _measure(name, benches):
            print(text(rows), flush=True)
    for bench in benches:
        bench.close()
    used = resource.getrusage(resource.RUSAGE_SELF)
    print(f"{used.ru_utime + used.ru_stime:.0f} s of this computer's processor")


if __name__ == "__main__":
    main()
