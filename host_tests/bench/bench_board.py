"""`make bench-board`: what a board can do, as a table. UGRBL_UF2 names an image, or PORT a board.

    bench_board.py [PART]...        all parts, or those named

Emulated times are those of the emulated chip; on hardware those of a sender are this computer's,
USB included. A real board is given the benchmark's commands at its prompt, and gets its program
and settings back; it moves its axes, so motors are better off. What has to be looked at from
power-up on or at the pins is left out there.
"""

import os
import resource
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

_HERE = Path(__file__).resolve().parent
sys.path[:0] = [
    str(_HERE),
    str(_HERE.parent / "emulator"),
    str(_HERE.parent.parent / "tools" / "sim" / "standins"),
    str(_HERE.parent.parent / "firmware"),
]

import pins  # noqa: E402
import talking  # noqa: E402
from bench_setup import Bench  # noqa: E402
from calibration import calibration  # noqa: E402
from rows import Row  # noqa: E402

_Part = Callable[[Bench], Iterator[Row]]

_PARTS: "dict[str, _Part]" = {
    "boot": talking.boot,
    "memory": talking.memory,
    "heap": talking.heap,
    "queries": talking.queries,
    "lines": talking.lines,
    "special": talking.special_lines,
    "share": pins.share,
    "hold": pins.hold,
    "rates": pins.rates,
    "stages": talking.stages,
    "gaps": talking.gaps,
    "calibration": calibration,
}
_EMULATED_ONLY = ("boot", "hold", "rates")


def main() -> None:
    """Print rows as they come."""
    port, uf2 = os.environ.get("PORT", ""), os.environ.get("UGRBL_UF2", "")
    names = sys.argv[1:] or list(_PARTS)
    unknown = ", ".join(name for name in names if name not in _PARTS)
    if unknown:
        sys.exit(f"no part {unknown}; there are {', '.join(_PARTS)}")
    if not port and not uf2:
        sys.exit("which board? UGRBL_UF2=RPI_PICO-….uf2 make bench-board, or PORT=/dev/ttyACM0")
    bench = Bench(port=port) if port else Bench(Path(uf2))
    print("emulated" if bench.emulated else f"on hardware, at {port}")
    for name in names:
        if not bench.emulated and name in _EMULATED_ONLY:
            print(f"{name}: emulated boards only")
            continue
        for row in _PARTS[name](bench):
            print(row.text(), flush=True)
    bench.close()
    used = resource.getrusage(resource.RUSAGE_SELF)
    print(f"{used.ru_utime + used.ru_stime:.0f} s of this computer's processor")


if __name__ == "__main__":
    main()
