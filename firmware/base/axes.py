"""Axes: their numbers and letters, in the order used everywhere."""

from micropython import const

X = const(0)
Y = const(1)
Z = const(2)
# The axis that a tool length offset (G43.1) acts on.
TOOL_LENGTH = const(2)

LETTERS = "XYZABC"
