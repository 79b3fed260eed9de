"""The functions of every turn of the main loop, and of a `?`, have frames on the stack.

MicroPython has a place of 11 words for a function's frame. It allocates a larger one on the heap
and searches for free space there, which takes 6 to 100 us a call, and more as garbage collects.
"""

from collections.abc import Iterator

import pytest
from ugrbl.compiling import build, compilers, mpy
from ugrbl.paths import BOARDS

_MOST_WORDS = 11
_EXCEPTION_WORDS = 3  # of each nested try
_FUNCTIONS = {
    "control/canon": "auto_start make_room wait_for_room",
    "control/inputs": "active",
    "control/motor_control": "check_engine poll_motors",
    "control/realtime": "handle_events post run",
    "motion/planner": "catch_up full",
    "pio/engine": "fault idle position",
    "pio/pins": "levels",
    "ports/usb/usb_link": "_flush read_into",
    "talk/lines": "waiting",
    "talk/protocol": "_find_command pump service",
    "talk/report": "status",
}


@pytest.mark.thorough
@pytest.mark.skipif(not compilers.are_there("armv6m"), reason="the compilers are not installed")
def test_frames_of_every_turn_are_on_the_stack() -> None:
    files = build.for_board(BOARDS / "rpi_pico.py").files
    for module, functions in _FUNCTIONS.items():
        words = dict(_frames(files[f"{module}.mpy"]))
        for name in functions.split():
            assert words[name] <= _MOST_WORDS, (module, name)


def _frames(compiled: bytes) -> "Iterator[tuple[str, int]]":
    """Yield the name of each function in bytecode, and the words of its frame."""
    names = list(_names(compiled))
    reader = mpy._Reader(compiled)
    reader.pass_tables()
    parts = reader.function(lambda code: code)
    for head in parts:
        code = next(parts)
        if head[-1] & mpy._HAS_CHILDREN:
            next(parts)  # their number; each follows as a function
        if head[-1] & mpy._KINDS == mpy._BYTECODE:
            name, words = _prelude(code)
            yield names[name], words


def _names(compiled: bytes) -> "Iterator[str]":
    """Yield the texts of the table of names; "" for one of MicroPython's own."""
    reader = mpy._Reader(compiled)
    count, _constants = reader._number(), reader._number()
    for _ in range(count):
        length = reader._number()
        yield "" if length & mpy._IS_ROM else reader._take((length >> 1) + 1)[:-1].decode()


def _prelude(code: bytes) -> "tuple[int, int]":
    """Return the number of the function's name, and the words of its frame: see MicroPython's
    py/bc.h."""
    state, exceptions, at = code[0] >> 3 & 15, code[0] >> 2 & 1, 0
    while code[at] & 128:
        at += 1
        state |= (code[at] & 48) << 2 * (at - 1)
        exceptions |= (code[at] & 2) << (at - 1)
    reader = mpy._Reader(code)
    reader.at = at + 1
    reader._number()  # sizes
    return reader._number(), state + 1 + _EXCEPTION_WORDS * exceptions
