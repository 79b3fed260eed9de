# mypy: disable-error-code=arg-type
"""Single precision: the arithmetic of Grbl's replies, the same on every machine.

A board computes in single precision anyway; the desktop has doubles. Each result on which the
rounding of a reply or of a step count depends is passed through f32().
"""

import sys
from array import array

import micropython
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

_cell = array("f", (0.0,))


def f32(x: float) -> float:
    """Return x rounded to single precision."""
    _cell[0] = x
    return _cell[0]


def truncate(x: float) -> int:
    """Return x without its fraction, an integer; 0 if 32 bits, signed or not, cannot hold it."""
    return int(x) if -2147483648 <= x < 4294967296 else 0


def vector(axes: int) -> "array[float]":
    """Return a position or offset: one single-precision number per axis, all 0."""
    return array("f", (0.0 for _ in range(axes)))


INCH_PER_MM = f32(0.0393701)


@micropython.viper
def copy(source: ptr32, target: ptr32, count: int) -> int:
    """Copy count integers, or floats as bits, from source to target. Returns 0."""
    for i in range(count):
        target[i] = source[i]
    return 0


@micropython.viper
def address_of(memory: ptr8) -> int:
    """Return the address of an array's data. The caller keeps the array."""
    return int(memory)  # type: ignore[call-overload, no-any-return]


def for_kernels(memory: "Any") -> "Any":
    """Return an array as a kernel takes it at the least cost: as its address on RP2 chips, where
    an address is a small integer; from an array it takes 2 us. The caller keeps the array."""
    return address_of(memory) if sys.platform == "rp2" else memory
