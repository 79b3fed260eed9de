"""Times that interrupts compare: us modulo 2**30, which is what a small integer holds."""

from micropython import const

MASK = const(0x3FFFFFFF)
NEGATIVE = const(0x20000000)  # from there on a difference is a negative one
