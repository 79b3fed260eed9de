"""Control inputs, bit by bit, as ports have them in a mask."""

from micropython import const

RESET = const(1)
HOLD = const(2)
START = const(4)
DOOR = const(8)
EMERGENCY_STOP = const(16)  # from Port.attach() only
