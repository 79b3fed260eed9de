"""From the firmware's sources to the files of a board.

There are two passes: inline.py puts constants in place, and kernel_module.py compiles kernels with
LLVM (Arm only). Neither pass moves a line or changes a name, so tracebacks on the board refer to
the sources. Then mpy-cross compiles each module. build.py selects the modules that a board needs.

Imports `boardfile`.
"""
