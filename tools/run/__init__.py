"""Programs and senders at the simulated machine: from the name of a board to what its motors did.

Imports `grbl`, `boardfile`, `compiling` and `sim`. Other than `sim` it is for CPython only.
"""
