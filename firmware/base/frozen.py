"""Frozen: firmware that is a part of MicroPython's own file, and lies in flash with it.

Only such a build has this module (tools/compiling/freeze.py); it puts in_memory() before each
function of native code.
"""

from array import array

import uctypes
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

# What is frozen, as the build has it: the tools look for this in MicroPython's file, too.
ABOUT = "ugrbl frozen: nothing"

# Where a function's object has the address of its code, and a closure's that of the function.
_CODE_AT = const(12)
_FUNCTION_AT = const(4)
_ADDRESS = const(4)  # bytes
_HEAD = const(4)  # bytes in front of the code: a jump over its length


def in_memory(function: "Callable[..., object]") -> "Callable[..., object]":
    """Have the function run from memory. Kernels keep words of their own among their code
    (tools/compiling/machine_code.py), and those that code looks up may lie where they cannot be
    read in flash."""
    at = id(function)
    if type(function).__name__ == "closure":
        at = array("I", uctypes.bytearray_at(at + _FUNCTION_AT, _ADDRESS))[0]
    place = uctypes.bytearray_at(at + _CODE_AT, _ADDRESS)
    there = array("I", place)[0]
    head = uctypes.bytearray_at(there, _HEAD)
    code = bytearray(head[2] | head[3] << 8)
    code[:] = uctypes.bytearray_at(there + _HEAD, len(code))
    place[:] = bytes(array("I", (uctypes.addressof(code),)))
    return function
