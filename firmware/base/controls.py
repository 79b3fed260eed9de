"""Bits of the input masks that ports report."""

from micropython import const

RESET = const(1)
HOLD = const(2)
START = const(4)
DOOR = const(8)
EMERGENCY_STOP = const(16)  # from Port.attach() only

# Port.levels() reports all inputs at once: the controls, then the probe, then the limits.
PROBE_AT = const(5)
LIMITS_AT = const(6)
