"""Programs and senders at the simulated machine: from the name of a board to its motors' motion.

Imports `grbl`, `boardfile`, `compiling` and `sim`. Unlike `sim`, it is for CPython only.
"""
