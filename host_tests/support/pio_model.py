"""PIO programs run tick by tick: rp2040py's model of the chip, without its processor.

PioModel is one PIO block and its words. PioChip is all hardware that PioEngine uses, with CPython
as the processor: the firmware's own code reads and writes the registers of the modelled PIOs and
timer, and its arrays lie in the modelled memory. DMA is modelled here: rp2040py's puts a word into
a FIFO at once when space is free, where a chip counts credits.
"""

import builtins
import sys
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import machine
import pytest
import rp2
from motion import slice_kernel
from pio import engine, engine_state, memory, pulses, refill, stops
from rp2040py.irq import IRQ
from rp2040py.rp2040 import RP2040

# Addresses from the data sheet.
_PIO = (0x50200000, 0x50300000, 0x50400000)
_CTRL, _FDEBUG, _FLEVEL, _TXF, _INSTR_MEM = 0x00, 0x08, 0x0C, 0x10, 0x48
_SM, _SM_STRIDE = 0xC8, 0x18
_CLKDIV, _EXECCTRL, _SHIFTCTRL, _ADDR, _INSTR, _PINCTRL = range(0, 0x18, 4)
_FUNCTION = 0x40014004  # GPIO0_CTRL
_DMA, _DMA_STRIDE, _DMA_END = 0x50000000, 0x40, 0x50001000
_DMA_READ, _DMA_CONTROL, _DMA_TRIGGER, _DMA_CREDITS = 0x00, 0x10, 0x1C, 0x800
_BUSY, _BUSY_2350 = 1 << 24, 1 << 26
_FIFO = 4  # words
_NVIC_ENABLE, _NVIC_DISABLE = 0xE000E100, 0xE000E180
_RAM, _RAM_END = 0x20000000, 0x20042000
# RP2350 addresses that the model has elsewhere: timer, and control of pins.
_MOVED = {0x400B0: 0x40054, 0x40028: 0x40014}
MOST_OF_RP2040 = 6  # motors; a chip with more is an RP2350

_OUT_ENABLE = 0xE081  # set(pindirs, 1)
_PULL, _LOAD_ISR = 0x8080, 0xA0C7  # pull(noblock), mov(isr, osr)
_MACHINES = 4  # of a block
_TXOVER = 16
_TICK_NS = 80
_CLOCK_FLAG = 1 << 3  # the clock is machine 3


class _Chip:
    """Common part: programs, pins, and a log of edges."""

    def __init__(self) -> None:
        self.now = 0
        self.edges: list[tuple[int, int, int]] = []  # tick, pin, level
        self.mcu = RP2040()
        self.mcu.simulator = self  # or a block would run by itself

    def write(self, address: int, value: int) -> None:
        self.mcu.write_uint32(address, value & 0xFFFFFFFF)

    def load(self, block: int, program: "list[Any]", at: int) -> None:
        """Put a program's instructions where MicroPython does."""
        for i, word in enumerate(program[0]):
            jump = word >> 13 == 0
            self.write(_PIO[block] + _INSTR_MEM + 4 * (at + i), word + at if jump else word)

    def set_up(
        self, block: int, number: int, program: "list[Any]", at: int, pins: "Sequence[int]"
    ) -> None:
        """Set up a machine as MicroPython does; pins: step and direction, or none."""
        base = _PIO[block] + _SM + _SM_STRIDE * number
        self.write(base + _CLKDIV, 1 << 16)
        self.write(base + _EXECCTRL, program[4] + (at << 12) | at << 7)
        self.write(base + _SHIFTCTRL, program[5])
        self.write(base + _INSTR, at)
        for pin in pins:
            self.write(_FUNCTION + 8 * pin, 6 + block)
            self.write(base + _PINCTRL, 1 << 26 | pin << 5)
            self.write(base + _INSTR, _OUT_ENABLE)
            self.mcu.gpio[pin].add_listener(self._listener(pin))
        if pins:
            self.write(base + _PINCTRL, 1 << 26 | 1 << 20 | pins[0] << 5 | pins[1])

    def _listener(self, pin: int) -> Any:
        def on_change(new: Any, old: Any) -> None:
            if old.name in ("LOW", "HIGH"):  # else the pin has only become an output
                self.edges.append((self.now, pin, int(new.name == "HIGH")))

        return on_change


class PioModel(_Chip):
    """One PIO block: a program in every machine, words fed as by DMA, edges logged.

    machines: per machine its step and direction pins, none for a program without pins.
    """

    def __init__(self, program: "list[Any]", machines: "Sequence[tuple[int, int] | None]") -> None:
        super().__init__()
        self.interrupts: list[int] = []
        self.waiting: list[list[int]] = [[] for _ in machines]
        self._pio = self.mcu.pio[0]
        self._count = len(machines)
        self.load(0, program, 0)
        for number, pins in enumerate(machines):
            self.set_up(0, number, program, 0, pins or ())

    def load_isr(self, number: int, value: int) -> None:
        """Load ISR, as the engine does before it starts a machine."""
        self.write(_PIO[0] + _TXF + 4 * number, value)
        for instruction in (_PULL, _LOAD_ISR):
            self.write(_PIO[0] + _SM + _SM_STRIDE * number + _INSTR, instruction)

    def start(self) -> None:
        """Enable all machines at once, their clocks in phase."""
        self._feed()
        machines = (1 << self._count) - 1
        self.write(_PIO[0] + _CTRL, machines << 8 | machines)

    def stop(self) -> None:
        """Disable all machines at once."""
        self.write(_PIO[0] + _CTRL, 0)

    def run(self, ticks: int) -> None:
        """Advance this many ticks."""
        pio = self._pio
        for _ in range(ticks):
            pio.advance(1)
            self.now += 1
            if pio.irq:
                self.interrupts.append(self.now)
                pio.irq = 0
            self._feed()

    def _feed(self) -> None:
        for number, words in enumerate(self.waiting):
            while words and not self._pio.machines[number].tx_fifo.full:
                self.write(_PIO[0] + _TXF + 4 * number, words.pop(0))

    def at(self, number: int) -> int:
        """Return a machine's program counter."""
        return int(self.mcu.read_uint32(_PIO[0] + _SM + _SM_STRIDE * number + _ADDR))

    def x(self, number: int) -> int:
        """Return a machine's X register."""
        return int(self._pio.machines[number].x)

    def unread(self, number: int) -> int:
        """Return the number of words not yet fetched."""
        return int(self._pio.machines[number].tx_fifo.item_count) + len(self.waiting[number])


class Channel:
    """A DMA channel that moves words from a ring in memory into the FIFO of one machine.

    The data sheets can be read in two ways about how it detects free space. counted: it has a
    counter
    of its own, 4 at first, decremented by each word that it sends, and incremented by each word
    taken
    out of the FIFO, whatever has put it there. Otherwise it looks at the FIFO. A word is in
    transit
    for `flight` ticks, during which it is neither in the count nor in the FIFO.
    """

    def __init__(self, chip: "PioChip", number: int) -> None:
        self.counted = True
        self.flight = 1
        self._chip = chip
        block, own = divmod(number, _MACHINES)
        self._put_at = _PIO[block] + _TXF + 4 * own
        self._fifo = chip.pios[block].machines[own].tx_fifo
        self._level = 0  # of the FIFO, when last seen
        self._room = _FIFO
        self._flying: deque[tuple[int, int]] = deque()  # tick of arrival, word
        self._at = self._mask = self._left = 0

    @property
    def busy(self) -> bool:
        return self._left > 0 or len(self._flying) > 0

    def read(self, register: int) -> int:
        """Return one of its registers."""
        match register:
            case 0x00:
                return self._at
            case 0x08 | 0x1C:
                return self._left
            case 0x0C:
                return self._chip.busy_bit if self.busy else 0
            case 0x800:
                return self._room
        raise AssertionError(f"nobody asks for register {register:#x} of DMA")

    def write(self, register: int, value: int) -> None:
        if register == _DMA_READ:
            assert not self.busy, "the address changed while words were in transit"
            self._at = value
        elif register == _DMA_CONTROL:
            self._mask = (1 << (value >> 6 & 15)) - 1
        elif register == _DMA_TRIGGER:
            assert not self.busy, "DMA has not finished"
            self._left = value
        elif register == _DMA_CREDITS:
            self._room = _FIFO - self._level - len(self._flying)
        else:
            raise AssertionError(f"nobody writes register {register:#x} of DMA")

    def put(self, word: int) -> None:
        """Put a word into the FIFO; if that is full, it is lost, and TXOVER is set."""
        self.look()
        self._level += not self._fifo.full
        self._chip.mcu.write_uint32(self._put_at, word)

    def look(self) -> None:
        """Update the count for words taken out."""
        level = self._fifo.item_count
        if level != self._level:
            self._room += self._level - level
            self._level = level

    def advance(self) -> None:
        """Advance one tick."""
        self.look()
        now = self._chip.now
        while self._flying and self._flying[0][0] <= now:
            self.put(self._flying.popleft()[1])
        if not self.counted:
            self._room = _FIFO - self._level - len(self._flying)
        if self._left and self._room > 0:
            self._flying.append((now + self.flight, self._chip.mcu.read_uint32(self._at)))
            self._at = self._at & ~self._mask | self._at + 4 & self._mask
            self._left -= 1
            self._room -= 1


class PioChip(_Chip):
    """A chip with a PioEngine that runs on it. patch: the engine is on this chip until it ends.

    The engine's own interrupt comes `latency` ticks late. Each access of the engine to a register
    takes a tick; the rest of its code takes no time. Therefore machines of PIO 0 and PIO 1,
    started a
    few cycles apart on a chip, start a tick apart here.
    """

    def __init__(
        self,
        patch: pytest.MonkeyPatch,
        step: "tuple[int, ...]",
        direction: "tuple[int, ...]",
        *timing_us: int,
    ) -> None:
        super().__init__()
        self.is_rp2350 = len(step) > MOST_OF_RP2040
        self.busy_bit = _BUSY_2350 if self.is_rp2350 else _BUSY
        self.pios = list(self.mcu.pio)
        if self.is_rp2350:
            self.pios.append(type(self.pios[1])(self.mcu, "PIO2", IRQ.PIO1_IRQ0, 1))
            self.mcu.peripherals[_PIO[2] >> 12] = self.pios[2]
        self.latency = 0
        self.interrupts: list[int] = []
        self.accesses = 0  # to registers and memory, by interruptible code
        self._due: int | None = None
        self._inside = False
        self._pins_may = True
        self._preempt: tuple[int, Callable[[], None]] | None = None
        self._ram = memoryview(self.mcu.sram).cast("B").cast("i")
        self._used = 0
        self._addresses: dict[int, tuple[int, object]] = {}
        self.channels = [Channel(self, number) for number in range(len(step))]
        self._take_place(patch)
        self.engine = engine.PioEngine(step, direction, *timing_us)
        # By address, so that every access to it is seen here.
        self.engine._engine_state = engine.ptr32(self._address(self.engine._engine_state))
        self._connect()

    def _take_place(self, patch: pytest.MonkeyPatch) -> None:
        plain = builtins.ptr32  # type: ignore[attr-defined]
        chip = self

        class Pointer(int):
            """An address, as in viper."""

            def __getitem__(self, i: int) -> int:
                return chip._load(self + 4 * i)

            def __setitem__(self, i: int, value: int) -> None:
                chip._store(self + 4 * i, value)

        def ptr32(memory: Any) -> Any:
            return Pointer(memory) if isinstance(memory, int) else plain(memory)

        for module in (engine, engine_state, memory, pulses, stops, refill, slice_kernel):
            patch.setattr(module, "ptr32", ptr32, raising=False)
        patch.setattr(memory, "_make_array", self._array)
        patch.setattr(memory, "address_of", self._address)
        patch.setattr(engine, "address_of", self._address)
        patch.setattr(machine, "mem32", _Registers(self))
        patch.setattr(rp2.StateMachine, "machines", {})
        patch.setattr(rp2.PIO, "handlers", {})
        patch.setattr(rp2.DMA, "claimed", 0)
        name = f"a board with {'RP2350' if self.is_rp2350 else 'RP2040'}"
        patch.setattr(sys.implementation, "_machine", name, raising=False)

    def _connect(self) -> None:
        self._clocks = self.pios[self.clock_block]
        for number, made in rp2.StateMachine.machines.items():
            block = number // 4
            at = made.program[1 + block]
            self.load(block, made.program, at)
            pins = (made.set_base.id, made.out_base.id) if made.set_base else ()
            self.set_up(block, number % 4, made.program, at, pins)
        for axis, (made, channel) in enumerate(self.engine._machines):
            block, own = divmod(axis, _MACHINES)
            request = 8 * block + own  # DREQ_PIO0_TX0, DREQ_PIO1_TX0 and the following ones
            assert channel.channel == axis
            assert channel.configured["ctrl"] >> 15 & 63 == request
            assert channel.configured["write"] is made is rp2.StateMachine.machines[axis]
            self.channels[axis].write(_DMA_READ, channel.configured["read"])
            self.channels[axis].write(_DMA_CONTROL, channel.configured["ctrl"])

    # Memory and registers

    def _allocate(self, size: int) -> int:
        at = self._used
        self._used += -(-size // 8) * 8
        return at

    def _array(self, length: int) -> memoryview:
        at = self._allocate(4 * length)
        made = memoryview(self.mcu.sram)[at : at + 4 * length].cast("i")
        self._addresses[id(made)] = (_RAM + at, made)
        return made

    def _address(self, memory: Any) -> int:
        if id(memory) not in self._addresses:
            self._addresses[id(memory)] = (_RAM + self._allocate(len(memory)), memory)
        return self._addresses[id(memory)][0]

    def _load(self, address: int) -> int:
        self._touch()
        if _RAM <= address < _RAM_END:
            return int(self._ram[(address - _RAM) >> 2])
        self._tick()
        value = self.read(address & 0xFFFFFFFF)
        return value - (value >> 31 << 32)

    def _store(self, address: int, value: int) -> None:
        self._touch()
        if _RAM <= address < _RAM_END:
            self._ram[(address - _RAM) >> 2] = value
            return
        self._tick()
        address &= 0xFFFFFFFF
        if address in (_NVIC_ENABLE, _NVIC_DISABLE):
            self._pins_may = address == _NVIC_ENABLE
        self.write(address, value)
        # An instruction may be forced into a stopped machine: the model updates pins only in a
        # tick.
        for block in self.pios:
            block.check_changed_pins()

    def read(self, address: int) -> int:
        """Return a register."""
        if _DMA <= address < _DMA_END:
            return self.channels[(address & 0x7FF) // _DMA_STRIDE].read(address & 0x83F)
        return int(self.mcu.read_uint32(self._place(address)))

    def write(self, address: int, value: int) -> None:
        address &= 0xFFFFFFFF
        if _DMA <= address < _DMA_END:
            self.channels[(address & 0x7FF) // _DMA_STRIDE].write(address & 0x83F, value)
        elif channel := self._of_fifo(address):
            channel.put(value & 0xFFFFFFFF)
        else:
            super().write(self._place(address), value)

    def _place(self, address: int) -> int:
        """Return the model's address of a register."""
        if self.is_rp2350 and address >> 12 in _MOVED:
            return _MOVED[address >> 12] << 12 | address & 0xFFF
        return address

    def _of_fifo(self, address: int) -> "Channel | None":
        for channel in self.channels:
            if channel._put_at == address:
                return channel
        return None

    def lost(self) -> int:
        """Return a mask of lanes whose machine's full FIFO received a word."""
        first, second = (self.read(at + _FDEBUG) >> _TXOVER & 15 for at in _PIO[:2])
        return (first | second << _MACHINES) & (1 << len(self.channels)) - 1

    # Time and interrupts

    def run(self, ticks: int) -> None:
        """Advance this many ticks."""
        end = self.now + ticks
        while self.now < end:
            if self._due is not None and self._due <= self.now:
                self._due = None
                self.interruptible(self.interrupt)
            self._tick()

    @property
    def clock_block(self) -> int:
        """Return the PIO whose last machine is the clock's."""
        return max(rp2.StateMachine.machines) // _MACHINES

    def interrupt(self) -> None:
        """Run the engine's own interrupt."""
        block = self.clock_block
        rp2.PIO.handlers[block][0](rp2.PIO(block))

    def run_until_idle(self, limit: int = 20_000_000) -> None:
        """Run until the engine has made all its segments."""
        end = self.now + limit
        self.run(self.latency + 1000)
        while not self.engine.idle() or self._due is not None:
            assert self.now < end, "motion does not end"
            self.run(2000)
        self.run(4000)  # the last pulse

    def interruptible(self, work: "Callable[[], object]") -> None:
        """Run a function of the engine that a pin's interrupt may interrupt."""
        self._inside = True
        work()
        self._inside = False

    def preempt(self, after: int, action: "Callable[[], None]") -> None:
        """Interrupt by a pin after this many accesses of such work, or when the engine allows
        it."""
        self._preempt = (self.accesses + after, action)

    def _touch(self) -> None:
        if not self._inside:
            return
        self.accesses += 1
        if self._preempt and self._pins_may and self.accesses >= self._preempt[0]:
            action = self._preempt[1]
            self._preempt = None
            action()

    def _tick(self) -> None:
        for block in self.pios:
            block.advance(1)
        self.now += 1
        for channel in self.channels:
            channel.advance()
        self.mcu.clock.tick(_TICK_NS)
        clocks = self._clocks
        if clocks.irq & _CLOCK_FLAG:
            clocks.irq &= ~_CLOCK_FLAG
            self.interrupts.append(self.now)
            if self._due is None:
                self._due = self.now + self.latency


class _Registers:
    """machine.mem32 of the chip."""

    def __init__(self, chip: PioChip) -> None:
        self._chip = chip

    def __getitem__(self, address: int) -> int:
        return self._chip.read(address)

    def __setitem__(self, address: int, value: int) -> None:
        self._chip.write(address, value)
