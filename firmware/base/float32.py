# mypy: disable-error-code=arg-type
"""Single precision: the arithmetic of Grbl's replies, the same on every machine.

A board computes in single precision by itself; the desktop has doubles. Where
a reply or a step count depends on rounding, each result goes through f32().
"""

from array import array

import micropython

_cell = array("f", (0.0,))


def f32(x: float) -> float:
    """X rounded to single precision."""
    _cell[0] = x
    return _cell[0]


def truncate(x: float) -> int:
    """X without its fraction; 0 where 32 bits cannot hold it."""
    return int(x) if -2147483648 <= x < 4294967296 else 0


def vector(axes: int) -> "array[float]":
    """A position or offset: one single-precision number per axis, all 0."""
    return array("f", (0.0 for _ in range(axes)))


INCH_PER_MM = f32(0.0393701)


@micropython.viper
def copy(source: ptr32, target: ptr32, count: int) -> int:
    """Copy integers, or floats as bits."""
    for i in range(count):
        target[i] = source[i]
    return 0
