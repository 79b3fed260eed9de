# mypy: disable-error-code=arg-type
"""Stack: measure how much of the C stack the main loop and its interrupts have used at most.

Both share 8 kB on these chips. Words that were never used still hold the pattern that paint()
wrote. An interrupt that finds the stack full fails, so the rest is worth knowing.
"""

import sys

import micropython
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

SIZE = const(8192)  # bytes of the stack
_TOP = const(0x20042000)  # address of its end
_TOP_2350 = const(0x20082000)  # the same of an RP2350
_PATTERN = const(0x2A2A2A2A)  # a word that the stack hardly ever holds
_CALLS_BYTES = const(256)  # bytes that paint() itself and its calls may use


@micropython.viper
def _fill(words: ptr32, count: int) -> int:
    """Write the pattern into `count` words, from the address `words` on. Returns 0."""
    for i in range(count):
        words[i] = _PATTERN
    return 0


@micropython.viper
def _untouched(words: ptr32, count: int) -> int:
    """Return how many words still hold the pattern, from the stack's lowest address (words) on.

    count: the stack's words.
    """
    i = 0
    while i < count and words[i] == _PATTERN:
        i += 1
    return i


def _bottom() -> int:
    """Return the lowest address of the stack, which grows downwards."""
    return (_TOP_2350 if "RP2350" in sys.implementation._machine else _TOP) - SIZE


def paint() -> None:
    """Start a new measurement: fill the stack below the present depth with the pattern.

    It grows downwards, so the bytes that no call uses now (`free`) are the lowest.
    """
    free = SIZE - micropython.stack_use() - _CALLS_BYTES
    _fill(_bottom(), free // 4)


def watch() -> "Callable[[], str]":
    """Start a measurement; return the function that reports it."""
    paint()
    return report


def used() -> int:
    """Return the most bytes of the stack used since paint()."""
    return SIZE - 4 * _untouched(_bottom(), SIZE // 4)


def report() -> str:
    """Return used() as a text, for a message."""
    return "Stack: %d of %d bytes used" % (used(), SIZE)
