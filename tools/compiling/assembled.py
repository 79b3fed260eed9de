"""Programs of PIO state machines are assembled here, and not on the board at each start.

MicroPython's own assembler is Python: it takes 25 ms of a start, and looks in flash for a module
for each program. What stands in a module instead is the list that it would make: asm_pio() in
ports/rp2/modules/rp2.py, MicroPython 1.26 and newer.
"""

import ast
from array import array
from collections.abc import Mapping
from typing import Any

from .. import paths

_WANTED = "from rp2 import PIO, asm_pio\n"
_HAS = "from array import array\n"


def assembled(sources: Mapping[str, str]) -> dict[str, str]:
    """The modules, by name: those of assembly only have lists. No line moves."""
    return {name: _lists(text) if _WANTED in text else text for name, text in sources.items()}


def _lists(text: str) -> str:
    paths.use_firmware()
    made: dict[str, Any] = {}
    exec(text, made)
    lines = text.replace(_WANTED, _HAS).splitlines(keepends=True)
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef):
            first = node.decorator_list[0].lineno - 1
            count = (node.end_lineno or 0) - first
            program = f"{node.name} = {_written(made[node.name])}\n"
            lines[first : first + count] = [program] + ["\n"] * (count - 1)
    return "".join(lines)


def _written(program: list[Any]) -> str:
    """A list, with its array as MicroPython reads one: of bytes, the lower one first."""
    words = [
        f'array("H", {_low_first(item)!r})' if isinstance(item, array) else repr(item)
        for item in program
    ]
    return f"[{', '.join(words)}]"


def _low_first(words: "array[int]") -> bytes:
    return b"".join(word.to_bytes(2, "little") for word in words)
