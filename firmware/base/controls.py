"""Inputs, bit by bit, as ports have them in a mask."""

from micropython import const

RESET = const(1)
HOLD = const(2)
START = const(4)
DOOR = const(8)
EMERGENCY_STOP = const(16)  # from Port.attach() only

# Port.levels() has all inputs at once: the controls, and behind them the probe and the limits.
PROBE_AT = const(5)
LIMITS_AT = const(6)
