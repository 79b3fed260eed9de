# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True
"""The flash cache of an RP2040, which rp2040py does not have, and a chip whose core waits for it.

compile_emulator.py makes a library of this beside its copy of rp2040py. The chip and the core are
derived from those of rp2040py, which stay as they are: a board without the model (xip.py) pays
nothing for it. What is modelled:

- RP2040 data sheet 2.6.3: 16 kB, two ways, lines of 8 bytes; the aliases 0x10 to 0x13; CTRL.EN; a
  flush takes 1024 cycles.
- Each half of a line is valid by itself, and a miss fetches one half: 4 bytes. So its designer,
  github.com/raspberrypi/pico-sdk/issues/1182, 2023-01-23.
- Which of two ways is given up is not published; here it is the one used longer ago.
- The core fetches words of 32 bits, two instructions as a rule. What it fetches in vain behind a
  branch is left out, and so is what DMA reads.
"""

cimport cython
from libc.string cimport memset

from rp2040py.native._bit cimport read_uint16_le, read_uint32_le
from rp2040py.native._cortex_m0_core cimport CortexM0Core
from rp2040py.native._rp2040 cimport RP2040

cdef enum:
    WAYS = 2
    SETS = 1024
    LINE_BITS = 3
    TAG_SHIFT = 13  # what remains above the bits of a line and of a set
    FLUSH_CYCLES = 1024
    WAIT_STEP = 8  # cycles of waiting at a time
    NOT_ALLOCATING = 1  # in the alias, bits 24 and 25 of an address
    NOT_CACHED = 2
    FLASH_ALIASES = 0x10 >> 2  # 0x10 to 0x13, by the uppermost six bits
    IN_FLASH = 0xFFFFFF


@cython.final
cdef class Cache:
    """Which parts of flash are at hand. Counts what was read, and cycles."""

    cdef public int miss_cycles
    cdef public bint enabled
    cdef public unsigned long long hits, misses
    cdef public unsigned long long stalled_cycles, cycles  # of all that the core has worked
    cdef unsigned short _tags[SETS][WAYS]
    cdef unsigned char _halves[SETS][WAYS]  # of a line, a bit each: those that are valid
    cdef unsigned char _older[SETS]  # the way that was used longer ago
    cdef readonly long long due  # cycles that the core has still to wait

    def __init__(self):
        self.enabled = True

    def flush(self) -> None:
        """Nothing is at hand any more."""
        memset(self._halves, 0, sizeof(self._halves))
        self.due += FLUSH_CYCLES

    cdef int _way(self, unsigned int line, unsigned int tag) noexcept:
        """Where a line is, or -1."""
        cdef int way
        for way in range(WAYS):
            if self._halves[line][way] and self._tags[line][way] == tag:
                return way
        return -1

    cdef int _make_room(self, unsigned int line, unsigned int tag) noexcept:
        """The way that is free, or else given up, for a line."""
        cdef int way = self._older[line]
        if not self._halves[line][1 - way]:
            way = 1 - way
        self._tags[line][way] = tag
        self._halves[line][way] = 0
        return way

    cdef void _read(self, unsigned int at) noexcept:
        """The core reads flash there."""
        cdef unsigned int line = (at >> LINE_BITS) & (SETS - 1)
        cdef unsigned int tag = (at & IN_FLASH) >> TAG_SHIFT
        cdef unsigned int half = 2 if at & 4 else 1
        cdef unsigned int alias = at >> 24
        cdef int way = self._way(line, tag) if self.enabled else -1
        if way >= 0 and self._halves[line][way] & half and not alias & NOT_CACHED:
            self.hits += 1
        else:
            self.misses += 1
            self.due += self.miss_cycles
            if alias & NOT_ALLOCATING or not self.enabled:
                return
            if way < 0:
                way = self._make_room(line, tag)
            self._halves[line][way] |= half
        self._older[line] = 1 - way


@cython.final
cdef class CachedChip(RP2040):
    """An RP2040 with this cache in front of its flash."""

    cdef public Cache cache
    cdef bint _runs  # the core does: whoever else reads neither changes anything nor waits
    cdef unsigned int _fetched  # where the last instruction was

    def __cinit__(self):
        self.core = CachedCore(self)
        self.cache = Cache()

    cdef bint _has_come(self, unsigned int at) noexcept:
        """Whether this is the second instruction of a word that has been fetched."""
        cdef unsigned int before = self._fetched
        if at - (self.core.registers[15] & 0xFFFFFFFEU) > 2:
            return False  # data
        self._fetched = at
        return at & 2 and before == at - 2

    cpdef unsigned int read_uint32(self, long long address) except? 0:
        cdef unsigned int at = <unsigned int> address
        if at >> 26 != FLASH_ALIASES or at & 3:
            return RP2040.read_uint32(self, address)
        if self._runs:
            self.cache._read(at)
        return read_uint32_le(self._flash, at & IN_FLASH)

    cpdef unsigned int read_uint16(self, long long address):
        cdef unsigned int at = <unsigned int> address
        if at >> 26 != FLASH_ALIASES:
            return RP2040.read_uint16(self, address)
        if self._runs and not self._has_come(at):
            self.cache._read(at)
        return read_uint16_le(self._flash, at & IN_FLASH)

    cpdef unsigned int read_uint8(self, long long address):
        cdef unsigned int at = <unsigned int> address
        if at >> 26 != FLASH_ALIASES:
            return RP2040.read_uint8(self, address)
        if self._runs:
            self.cache._read(at)
        return self._flash[at & IN_FLASH]


@cython.final
cdef class CachedCore(CortexM0Core):
    """Its core: behind an instruction it waits for the flash that this has read."""

    cpdef int execute_instruction(self) except -1:
        """The next instruction; or some of the cycles that the last one has still to wait, for
        PIO, interrupts and clock follow behind each return."""
        cdef CachedChip chip = <CachedChip> self.rp2040
        cdef Cache cache = chip.cache
        cdef int cycles
        if cache.due > 0:
            cycles = <int> min(cache.due, WAIT_STEP)
            cache.due -= cycles
            cache.stalled_cycles += cycles
            self.cycles += cycles
        else:
            chip._runs = True
            cycles = CortexM0Core.execute_instruction(self)
            chip._runs = False
        cache.cycles += cycles
        return cycles
