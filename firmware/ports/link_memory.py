"""Indices into a link's state, one array of integers: what it shares with the supervisor, then a
USB link's own. A flag is 0 or 1."""

from micropython import const

LOOP_HAS_READ = const(0)  # flag: the main loop has read the link since the supervisor's last beat
# Why the supervisor has stopped the machine: ms that the main loop was away, -1 if the timer's
# interrupt failed; 0: it has not.
STOP_CAUSE = const(1)
AWAY_MS = const(2)  # how long the main loop has been away; begins below 0 if more is allowed

RING_ADDRESS = const(3)  # of MicroPython's ring of bytes, 0: not known
LINE_STATE_ADDRESS = const(4)  # of the host's control lines (usb_ring.py), 0: not known
LOOP_READS_RING = const(5)  # flag: the main loop is moving the ring's read index now
IS_OPEN = const(6)  # flag: a program has the port open (DTR)
WAS_USED = const(7)  # flag: the port has been open before, or bytes have arrived
REOPENED = const(8)  # 1: the port has just been opened again; 2: a while ago; 0: nothing to greet
HAS_CONTROL_BYTES = const(9)  # flag: control bytes were read that may request the prompt
RING_WAS_FULL = const(10)  # flag: more bytes may wait outside the ring
ANSWER_BYTES = const(11)  # how many bytes of answers wait to be sent
QUIET_TURNS = const(12)  # turns of the loop without input since answers wait
HOST_IS_DEAF = const(13)  # flag: the host has not read for so long that it counts as absent
DOLLAR_WAITS = const(14)  # flag: a $ was received that has not been answered
STATE_LENGTH = const(15)  # of the array
JUST_NOW = const(1)  # a value of REOPENED

# MicroPython's struct ringbuf_t: address, size : 16, iget : 16, iput : 16.
RING_BYTES = const(512)

DISCARD_PIECES = const(16)  # reads of 64 bytes that drop all bytes that may have arrived
# How long a write may take: MicroPython gives up on a host that does not read once nothing was
# sent for 500 ms, and a packet or two may be sent before.
WRITE_MS = const(1000)
