"""Letters of the axes, in the order in which they stand everywhere: see base/axes.py."""

LETTERS = "XYZABC"
