"""The simulator: one more board, in virtual time. standins/ has what only boards have.

Its modules run under CPython and under the desktop MicroPython alike, so they keep to what both
understand. The stand-ins are `machine`, `rp2` and others, for CPython: their folder is put on the
path, and is no package.

Imports nothing of the other rooms; the firmware is the one thing that it runs.
"""
