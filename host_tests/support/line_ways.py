"""Which functions of the firmware a line passes through, from its last byte to its answer.

`.venv/bin/python host_tests/support/line_ways.py` prints the table of docs/architecture.md; given
a line, it prints the functions in order. Kernels run as Python here.
"""

import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType, SimpleNamespace
from typing import Any

os.environ["UGRBL_VIPER"] = "checked"

from ugrbl import paths
from ugrbl.boardfile.files import load_board
from ugrbl.sim import Machine

_LINES = (
    *("G1 X2", "G1 X3 F700", "T1 G1 X4", "G2 X5 Y1 R5", "$J=G91 X1 F500", "$110=500"),
    "M100",
)
# A user's own module, with a unique name.
_CUSTOM = "line_ways_custom"
_OWN = """\
from ugrbl import mcode

@mcode(100)
def nothing(m):
    pass
"""

Way = list[tuple[str, str]]  # file and function; empty if the line is refused


class _Tracer:
    """Record calls; a line's path begins where its last bytes have been read."""

    def __init__(self) -> None:
        self.way: Way = []
        self.answered: Way = []

    def __call__(self, frame: FrameType, event: str, _argument: object) -> None:
        file = Path(frame.f_code.co_filename)
        if event != "call" or not file.is_relative_to(paths.FIRMWARE):
            if event == "call" and frame.f_code.co_name == "write" and not self.answered:
                self.answered = list(self.way)
            return
        name = frame.f_code.co_name
        if name in ("feed", "take_bytes") and file.stem == "lines":
            self.way.clear()
            self.answered.clear()
        self.way.append((str(file.relative_to(paths.FIRMWARE)), name))


def ways(board: Any, lines: "tuple[str, ...]" = _LINES) -> "Iterator[tuple[str, Way]]":
    """Yield each line with its calls."""
    tracer = _Tracer()
    threading.setprofile(tracer)
    try:
        machine = Machine(board)
    finally:
        threading.setprofile(None)
    with machine:
        machine.program(["G1 X1 F500", "G1 X1.5"])
        machine.rest()
        for line in lines:
            said = machine.ask(line)
            yield line, tracer.answered if said[-1] == "ok" else []
            machine.rest()


def boards() -> "tuple[Any, Any]":
    """Return the simulator's board, and the same with LENIENT and a custom.py in the working
    folder."""
    Path(f"{_CUSTOM}.py").write_text(_OWN, encoding="utf-8")
    sys.path.insert(0, os.getcwd())
    plain = vars(load_board("sim"))
    more = {**plain, "LENIENT": True, "CUSTOM": _CUSTOM}
    return SimpleNamespace(**plain), SimpleNamespace(**more)


def table() -> "Iterator[str]":
    """Yield the rows of the table in docs/architecture.md."""
    yield "| line | files | functions | with `custom.py` and `LENIENT`: files | functions |"
    yield "| --- | --- | --- | --- | --- |"
    for (line, plain), (_, other) in zip(*map(ways, boards()), strict=True):
        counts = [len(found) for way in (plain, other) for found in (dict(way), set(way))]
        yield f"| `{line}` | {' | '.join(str(count or 'refused') for count in counts)} |"


def main(lines: "tuple[str, ...]") -> None:
    """Print the table, or the paths of these lines; if the plain board refuses one, the other
    board's."""
    if not lines:
        print("\n".join(table()))
        return
    for line in lines:
        found = (way for each in boards() for _, way in ways(each, (line,)) if way)
        print("\n".join(f"{file}: {name}" for file, name in dict.fromkeys(next(found, []))))


if __name__ == "__main__":
    with TemporaryDirectory() as folder:
        os.chdir(folder)
        main(tuple(sys.argv[1:]))
