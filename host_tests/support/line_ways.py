"""Which functions of the firmware a line comes through, from its last byte to its answer.

`.venv/bin/python host_tests/support/line_ways.py` prints the table of docs/architecture.md; given
a line, the functions that it comes through, in their order. Kernels run as Python here.
"""

import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType, SimpleNamespace
from typing import Any

os.environ["UGRBL_VIPER"] = "checked"

from ugrbl import paths
from ugrbl.boardfile.files import load_board
from ugrbl.sim import Machine

_LINES = ("G1 X2", "G1 X3 F700", "T1 G1 X4", "G2 X5 Y1 R5", "$J=G91 X1 F500", "$110=500")

Way = list[tuple[str, str]]  # file and function


class _Tracer:
    """Notes what is called; a line's way begins where its last bytes have been read."""

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
        if name == "feed" and file.stem == "lines":
            self.way.clear()
            self.answered.clear()
        self.way.append((str(file.relative_to(paths.FIRMWARE)), name))


def ways(board: Any, lines: "tuple[str, ...]" = _LINES) -> "Iterator[tuple[str, Way]]":
    """Each line, and what it calls."""
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
            machine.ask(line)
            yield line, tracer.answered
            machine.rest()


def board(**more: object) -> Any:
    """The simulator's, with these options besides."""
    return SimpleNamespace(**{**vars(load_board("sim")), **more})


def table() -> "Iterator[str]":
    """As it stands in docs/architecture.md."""
    yield "| line | files | functions | with `LENIENT`: files | functions |"
    yield "| --- | --- | --- | --- | --- |"
    boards = board(), board(LENIENT=True)
    for (line, plain), (_, other) in zip(*map(ways, boards), strict=True):
        counts = [len(found) for way in (plain, other) for found in (dict(way), set(way))]
        yield f"| `{line}` | {' | '.join(map(str, counts))} |"


if __name__ == "__main__":
    if sys.argv[1:]:
        for _, way in ways(board(), tuple(sys.argv[1:])):
            print("\n".join(f"{file}: {name}" for file, name in dict.fromkeys(way)))
    else:
        print("\n".join(table()))
