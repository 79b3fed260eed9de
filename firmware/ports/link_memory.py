"""Indices into a link's state, one array of integers: what it shares with the supervisor, then a
USB link's own."""

from micropython import const

TURNED = const(0)  # 1 if the link was read since the supervisor's last beat
# Why the supervisor has stopped the machine: ms that the main loop was away, -1 if the timer's
# interrupt failed; 0: it has not.
STOPPED = const(1)
AWAY = const(2)  # ms that the main loop has been away; begins below 0 if more is allowed

RING = const(3)  # address of MicroPython's ring of bytes, 0: not known
LINE = const(4)  # address of the host's control lines (usb_ring.py), 0: not known
TAKING = const(5)  # whether the main loop is reading from the ring
DTR = const(6)  # whether the port is open
USED = const(7)  # whether it has been open before, or bytes have arrived
OPENED = const(8)  # whether it has been opened again: JUST now, or a while ago
ESCAPES = const(9)  # whether control bytes were read that may request the prompt
FULL = const(10)  # whether the ring was so full that more bytes may wait outside it
LENGTH = const(11)  # how many bytes of answers wait to be sent
TURNS = const(12)  # for how many turns of the loop nothing was received meanwhile
DEAF = const(13)  # whether the host has not read for so long that it counts as absent
ASKED = const(14)  # whether a $ was received that has not been answered
REMEMBERED = const(15)  # length of the array
JUST = const(1)  # a value of OPENED

# MicroPython's struct ringbuf_t: address, size : 16, iget : 16, iput : 16.
RING_BYTES = const(512)

# Pieces of 64 bytes to read at most: so many hold all bytes that may have arrived.
PIECES = const(16)
# How long a write may take: MicroPython gives up on a host that does not read once nothing was
# sent for 500 ms, and a packet or two may be sent before.
WRITE_MS = const(1000)
