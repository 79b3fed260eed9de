"""From the firmware's sources to what goes on a board.

Two passes: constants in place (inline.py), and for Arm kernels by LLVM (kernel_module.py). Neither
moves a line or changes a name, so that a traceback on the board tells of the sources. Then
mpy-cross compiles each module; build.py says which of them a board needs.

Imports `boardfile`.
"""
