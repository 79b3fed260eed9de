# mypy: disable-error-code=arg-type
"""Stack: how much of the C stack has been used at most, by the main loop and what interrupts it.

Both share 8 kB on these chips. What has never been used still holds the pattern that paint()
left there; an interrupt that finds no room fails, so what is left is worth knowing.
"""

import sys

import micropython
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

SIZE = const(8192)
_TOP = const(0x20042000)
_TOP_2350 = const(0x20082000)
_PATTERN = const(0x2A2A2A2A)
_CALLS = const(256)  # what paint() itself may use, and whom it calls


@micropython.viper
def _fill(words: ptr32, count: int) -> int:
    for i in range(count):
        words[i] = _PATTERN
    return 0


@micropython.viper
def _untouched(words: ptr32, count: int) -> int:
    """How many words from the bottom on still hold the pattern."""
    i = 0
    while i < count and words[i] == _PATTERN:
        i += 1
    return i


def _bottom() -> int:
    return (_TOP_2350 if "RP2350" in sys.implementation._machine else _TOP) - SIZE


def paint() -> None:
    """Begin anew: what lies below the present depth has not been used."""
    free = SIZE - micropython.stack_use() - _CALLS
    _fill(_bottom(), free // 4)


def watch() -> "Callable[[], str]":
    """Begin now; returns who tells of it."""
    paint()
    return report


def used() -> int:
    """Bytes of the stack that have been used at most since paint()."""
    return SIZE - 4 * _untouched(_bottom(), SIZE // 4)


def report() -> str:
    """The same in words, for a message."""
    return "Stack: %d of %d bytes used" % (used(), SIZE)
