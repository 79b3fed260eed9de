"""Registers: where RP2 chips have what the PIO engine's leaves read and write, in words.

RP2040 datasheet, 3.7 (PIO), 2.5.7 (DMA), 2.1.2 (aliases); the RP2350 has them in the same places.
"""

from micropython import const

# A PIO's.
CTRL = const(0)
FDEBUG = const(2)
FLEVEL = const(3)
TXF = const(4)
RXF = const(8)
IRQ_FORCE = const(13)
PADOUT = const(15)  # levels of all pins
ADDR = const(0x35)
INSTR = const(0x36)
PINCTRL = const(0x37)  # the direction pin in its lowest bits
SM = const(6)  # from one machine to the next
SET = const(0x800)  # the same register, where ones set bits,
CLEAR = const(0xC00)  # and where they clear them

# A DMA channel's, and the interrupt controller's.
READ = const(0)
COUNT = const(2)
STATUS = const(3)
COUNT_TRIGGER = const(7)
DISABLE = const(32)

# In FDEBUG, from the bit of the first machine on: a word has come to a FIFO that was full.
TXOVER = const(16)
