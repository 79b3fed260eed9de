"""The simulator: one more board, in virtual or real time.

Its modules run under CPython and under the desktop MicroPython alike, so they
keep to what both understand.
"""
