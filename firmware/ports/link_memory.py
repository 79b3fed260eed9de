"""What a link remembers, in one array: what the supervisor shares, then a USB link's own."""

from micropython import const

# Shared: it has been read since the supervisor's last beat; the machine was stopped meanwhile; how
# long, in ms, the main loop has been away, from less than 0 on where that is to last.
TURNED = const(0)
STOPPED = const(1)
AWAY = const(2)

RING = const(3)  # Where MicroPython's ring of bytes is,
LINE = const(4)  # where the host's control lines are (usb_ring.py); 0: not known,
TAKING = const(5)  # whether the main loop is taking bytes out of the ring,
DTR = const(6)  # whether the port is open,
USED = const(7)  # has been before,
OPENED = const(8)  # and has been opened once more: JUST now, or a while ago,
ESCAPES = const(9)  # whether bytes taken are such as ask for the prompt,
FULL = const(10)  # whether the ring was so full that more may wait behind it,
LENGTH = const(11)  # how much waits to be sent,
TURNS = const(12)  # for how many turns nothing has come since, and
DEAF = const(13)  # whether the host has not read for so long that it is taken for absent, and
ASKED = const(14)  # whether a $ has come that has not been answered yet.
REMEMBERED = const(15)
JUST = const(1)

# MicroPython's struct ringbuf_t: address, size : 16, iget : 16, iput : 16.
RING_BYTES = const(512)

# What is read at once at the most: so many pieces of 64 bytes hold all that may have arrived.
PIECES = const(16)
# How long a write may take: MicroPython gives a host that does not read up when nothing has gone
# for 500 ms, and a packet or two may go before.
WRITE_MS = const(1000)
