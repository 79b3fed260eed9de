# mypy: ignore-errors
"""Watching state machines of PIO 1. They read pins that others drive; no wire is needed.

They use machines 4 to 6, unless a motor after the fourth or a laser's beam needs one; 7 is the
pulse engine's clock. They count steps. The last one alternates between counting and sampling all
pins into memory by DMA, as a logic analyser. A tick is the engine's tick, so times in ticks are
exact.
"""

from array import array

import board
import micropython
import rp2
from machine import Pin

from .config import CONFIG
from .programs import count_program, sample_program

TICK_HZ = 12_500_000
ALL = 0xFFFFFFFF
LANES = len(board.STEP) + (getattr(board, "TOOL", "spindle") == "laser")
FIRST = max(LANES, 4)  # the first state machine that counts, by its number in both PIOs
LAST = 6  # the last one, which also samples
PIO1 = 0x50300000
# Instructions that are forced into a machine.
FILL_X = 0xA02B  # mov(x, invert(null)): X becomes 2**32 - 1
FILL_Y = 0xA04B
TAKE_X = 0xA0C1  # mov(isr, x)
TAKE_Y = 0xA0C2
PUSH = 0x8000  # push(noblock)
SET = 0x2000  # alias of a register: ones set bits; with CLEAR they clear bits
CLEAR = 0x3000


class Counter:
    """Counts the steps of one axis, from its creation on. number: of the state machine."""

    def __init__(self, number, step, direction):
        self._machine = rp2.StateMachine(
            number, count_program, freq=TICK_HZ, in_base=Pin(step), jmp_pin=Pin(direction)
        )
        self._machine.exec(FILL_X)
        self._machine.exec(FILL_Y)
        self._machine.active(1)

    def _read(self, source):
        """Return how often X or Y has counted down. source: the instruction that takes it."""
        self._machine.exec(source)
        self._machine.exec(PUSH)
        return ALL - self._machine.get()

    def steps(self):
        """Return the forward steps and the backward steps."""
        return self._read(TAKE_X), self._read(TAKE_Y)

    def close(self):
        """Stop counting."""
        self._machine.active(0)


class Sampler:
    """Samples the levels of all pins, `length` times, once per tick."""

    def __init__(self, length):
        self.length = length
        self.words = bytearray(4 * length)
        self.dma = rp2.DMA()
        self._control = self.dma.pack_ctrl(
            size=2,  # words of four bytes
            inc_read=False,
            inc_write=True,
            treq_sel=12 + LAST - 4,  # paced by that machine's output; 12 is that of machine 4
        )
        self.hz = TICK_HZ

    def ready(self):
        """Discard the old samples and prepare sampling; go() or shoot() (limits.py) starts it."""
        self.machine = rp2.StateMachine(LAST, sample_program, freq=self.hz)
        self.dma.active(0)
        self.dma.config(
            read=self.machine,
            write=self.words,
            count=self.length,
            ctrl=self._control,
            trigger=False,
        )

    def go(self):
        """Start sampling."""
        self.dma.active(1)
        self.machine.active(1)

    def wait(self):
        """Wait until all samples are taken."""
        while self.dma.active():
            pass
        self.machine.active(0)
        while self.machine.rx_fifo():  # else another program of this machine would read them
            self.machine.get()

    def look(self):
        """Sample, and wait until it is complete."""
        self.ready()
        self.go()
        self.wait()

    def edges(self, pin, begin=0):
        """Return the level at tick `begin`, then the ticks after it at which the level changes. If
        there are more than `found` holds, only the last ones, and the level before these."""
        size = len(found)  # a ring
        count = find_edges(self.words, begin, self.length, pin, found, size)
        if count > size:
            begin = found[count % size] - 1  # before the oldest one still stored
        ticks = [found[index % size] for index in range(max(count - size, 0), count)]
        ticks.insert(0, self.level(pin, begin))
        return ticks

    def level(self, pin, at):
        """Return the level of a pin at a tick."""
        return find_level(self.words, at, pin)


@micropython.viper
def find_level(words: ptr32, at: int, pin: int) -> int:
    """Return the level of a pin at a tick."""
    return (words[at] >> pin) & 1


@micropython.viper
def find_edges(words: ptr32, begin: int, end: int, pin: int, found: ptr32, room: int) -> int:
    """Store the ticks at which a pin's level changes into a ring. Returns how many there are.

    words: the levels of all pins, per tick. begin, end: the ticks to look at. found: the ring, of
    `room` integers; if there are more, it has the last ones.
    """
    count = 0
    place = 0
    before = (words[begin] >> pin) & 1
    tick = begin + 1
    while tick < end:
        level = (words[tick] >> pin) & 1
        if level != before:
            found[place] = tick
            count += 1
            place += 1
            if place == room:
                place = 0
            before = level
        tick += 1
    return count


found = array("i", [0] * CONFIG["edges"])
