"""Registers: where RP2 chips have what the PIO engine's leaves read and write, in words.

RP2040 datasheet, 3.7 (PIO), 2.5.7 (DMA), 2.1.2 (aliases); the RP2350 has them in the same places.
"""

from micropython import const

# A PIO's; where they stand, the third in an RP2350.
PIO0_AT = const(0x50200000)
PIO1_AT = const(0x50300000)
PIO2_AT = const(0x50400000)
CTRL = const(0)
FDEBUG = const(2)
FLEVEL = const(3)
TXF = const(4)
RXF = const(8)
IRQ_FORCE = const(13)
PADOUT = const(15)  # levels of all pins
MACHINES = const(0x32)  # the first machine's begin here,
SM = const(6)  # and those of the next so much further
SET = const(0x800)  # the same register, where ones set bits,
CLEAR = const(0xC00)  # and where they clear them

# A machine's.
EXECCTRL = const(1)  # where its program begins, from bit 7 on
ADDR = const(3)
INSTR = const(4)
PINCTRL = const(5)  # the direction pin in its lowest bits

# Where the first DMA channel's stand, and bytes from one to the next; what each has, and the
# interrupt controller.
DMA_AT = const(0x50000000)
DMA_EACH = const(0x40)
READ = const(0)
WRITE = const(1)
COUNT = const(2)
STATUS = const(3)
COUNT_TRIGGER = const(7)
CREDITS = const(0x200)  # how many words a channel believes that its FIFO has room for
DISABLE = const(32)

# In FDEBUG, from the bit of the first machine on: a word has come to a FIFO that was full.
TXOVER = const(16)
