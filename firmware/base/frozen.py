"""Frozen: support for firmware that is part of MicroPython's own image in flash.

Only a frozen build has this module (tools/compiling/freeze.py). It decorates each function of
native code with in_memory().
"""

from array import array

import uctypes
from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

# Describes the frozen build. The tools also search MicroPython's image for this text.
ABOUT = "ugrbl frozen: nothing"

_CODE_AT = const(12)  # place in a function object, in bytes, of the address of its code
_FUNCTION_AT = const(4)  # place in a closure of the address of its function object
_ADDRESS = const(4)  # bytes of an address
_HEAD = const(4)  # bytes before the code: a jump over two bytes, and these, the code's length


def in_memory(function: "Callable[..., object]") -> "Callable[..., object]":
    """Copy the function's code to RAM and make the function run from there.

    Kernels keep data words among their code (tools/compiling/machine_code.py), and words that the
    code reads may lie where flash cannot be read as data. In MicroPython's function object, the
    address of the code is replaced by that of the copy, which the garbage collector finds there.
    Returns the function.
    """
    object_at = id(function)
    if type(function).__name__ == "closure":
        object_at = array("I", uctypes.bytearray_at(object_at + _FUNCTION_AT, _ADDRESS))[0]
    # bytearray_at() gives the memory itself: what is assigned to its bytes is written there.
    pointer = uctypes.bytearray_at(object_at + _CODE_AT, _ADDRESS)
    code_at = array("I", pointer)[0]
    head = uctypes.bytearray_at(code_at, _HEAD)
    code = bytearray(head[2] | head[3] << 8)  # the length that the head has
    code[:] = uctypes.bytearray_at(code_at + _HEAD, len(code))
    pointer[:] = bytes(array("I", (uctypes.addressof(code),)))
    return function
