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
            words, at = _prelude(code)
            yield names[_number(code, at)[0]], words


def _prelude(code: bytes) -> "tuple[int, int]":
    """Return the words of the frame, and the index of the name's number: MicroPython's py/bc.h."""
    state, exceptions, at = code[0] >> 3 & 15, code[0] >> 2 & 1, 0
    while code[at] & 128:
        at += 1
        state |= (code[at] & 48) << 2 * (at - 1)
        exceptions |= (code[at] & 2) << (at - 1)
    at = _number(code, at + 1)[1]  # over the sizes
    return state + 1 + _EXCEPTION_WORDS * exceptions, at


def _names(compiled: bytes) -> "Iterator[str]":
    """Yield the texts of the table of names; "" for one of MicroPython's own."""
    count, at = _number(compiled, mpy._HEAD)
    _, at = _number(compiled, at)  # of constants
    for _ in range(count):
        length, at = _number(compiled, at)
        size = 0 if length & mpy._IS_ROM else (length >> 1) + 1
        yield compiled[at : at + size - 1].decode() if size else ""
        at += size


def _number(data: bytes, at: int) -> "tuple[int, int]":
    """Return the number that mpy.number() has encoded at index `at`, and the index after it."""
    value = 0
    while True:
        byte = data[at]
        value, at = value << 7 | byte & 127, at + 1
        if byte < 128:
            return value, at
