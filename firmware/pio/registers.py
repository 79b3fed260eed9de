"""Registers: where RP2 chips have what the kernels of the PIO engine read and write.

Offsets are in words. RP2040 datasheet, 3.7 (PIO), 2.5.7 (DMA), 2.1.2 (aliases); the RP2350 has the
registers in the same places.
"""

from micropython import const

# A PIO's registers, after the addresses of the PIOs; the third is an RP2350's.
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
MACHINES = const(0x32)  # registers of the first machine begin here
MACHINE_STRIDE = const(6)  # words from one machine's registers to those of the next
SET = const(0x800)  # alias in which ones set bits of the same register
CLEAR = const(0xC00)  # alias in which ones clear bits of the same register

# A machine's registers.
EXECCTRL = const(1)  # the start of its program, from bit 7 on
ADDR = const(3)
INSTR = const(4)
PINCTRL = const(5)  # the direction pin in its lowest 5 bits

# The first DMA channel, bytes from one to the next, and a channel's registers; last, the interrupt
# controller's.
DMA_AT = const(0x50000000)
DMA_EACH = const(0x40)
READ = const(0)
WRITE = const(1)
COUNT = const(2)
STATUS = const(3)
COUNT_TRIGGER = const(7)
CREDITS = const(0x200)  # words that the channel expects it can move now; a write resets that
DISABLE = const(32)

# FDEBUG, from this bit on, one per machine: a word was written to a full FIFO.
TXOVER = const(16)
