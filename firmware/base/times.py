"""Times that interrupts compare: us modulo 2**30, which fits a small integer."""

from micropython import const

MASK = const(0x3FFFFFFF)
NEGATIVE = const(0x20000000)  # a difference from here on is negative
