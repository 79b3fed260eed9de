"""PIO programs run cycle by cycle: rp2040py's model of a PIO block, without a processor."""

from collections.abc import Sequence
from typing import Any

from rp2040py.rp2040 import RP2040

_PIO = 0x50200000
_CTRL, _FDEBUG, _FLEVEL, _TXF, _INSTR_MEM = 0x00, 0x08, 0x0C, 0x10, 0x48
_SM, _SM_STRIDE = 0xC8, 0x18
_CLKDIV, _EXECCTRL, _SHIFTCTRL, _ADDR, _INSTR, _PINCTRL = range(0, 0x18, 4)
_FUNCTION = 0x40014004  # of a pin: GPIO0_CTRL
_OUT_ENABLE = 0xE081  # set(pindirs, 1)
_PULL, _LOAD_ISR = 0x8080, 0xA0C7  # pull(noblock), mov(isr, osr)
_FIFO = 4


class PioModel:
    """One PIO block: a program in every machine, words fed as a DMA would, edges logged.

    machines: per machine its step and direction pins, none for a program without pins.
    """

    def __init__(self, program: list[Any], machines: "Sequence[tuple[int, int] | None]") -> None:
        self.now = 0
        self.edges: list[tuple[int, int, int]] = []  # tick, pin, level
        self.interrupts: list[int] = []
        self.waiting: list[list[int]] = [[] for _ in machines]
        self._mcu = RP2040()
        self._mcu.simulator = self  # or the block would run by itself
        self._pio = self._mcu.pio[0]
        self._count = len(machines)
        for i, word in enumerate(program[0]):
            self.write(_INSTR_MEM + 4 * i, word)
        for machine, pins in enumerate(machines):
            self._write_sm(machine, _CLKDIV, 1 << 16)
            self._write_sm(machine, _EXECCTRL, program[4])
            self._write_sm(machine, _SHIFTCTRL, program[5])
            if pins:
                self._connect(machine, *pins)

    def read(self, register: int) -> int:
        return int(self._mcu.read_uint32(_PIO + register))

    def write(self, register: int, value: int) -> None:
        self._mcu.write_uint32(_PIO + register, value)

    def _write_sm(self, machine: int, register: int, value: int) -> None:
        self.write(_SM + _SM_STRIDE * machine + register, value)

    def _connect(self, machine: int, step: int, direction: int) -> None:
        for pin in (step, direction):
            self._mcu.write_uint32(_FUNCTION + 8 * pin, 6)
            self._write_sm(machine, _PINCTRL, 1 << 26 | pin << 5)
            self.execute(machine, _OUT_ENABLE)
            self._mcu.gpio[pin].add_listener(self._listener(pin))
        self._write_sm(machine, _PINCTRL, 1 << 26 | 1 << 20 | step << 5 | direction)

    def _listener(self, pin: int) -> Any:
        def on_change(new: Any, old: Any) -> None:
            if old.name in ("LOW", "HIGH"):  # else it has only become an output
                self.edges.append((self.now, pin, int(new.name == "HIGH")))

        return on_change

    def execute(self, machine: int, instruction: int) -> None:
        """Force an instruction into a machine."""
        self._write_sm(machine, _INSTR, instruction)

    def load_isr(self, machine: int, value: int) -> None:
        """What the engine does before it starts a machine."""
        self.write(_TXF + 4 * machine, value)
        self.execute(machine, _PULL)
        self.execute(machine, _LOAD_ISR)

    def start(self) -> None:
        """Enable all machines at once, their clocks in phase."""
        self._feed()
        machines = (1 << self._count) - 1
        self.write(_CTRL, machines << 8 | machines)

    def stop(self) -> None:
        """Disable all machines at once."""
        self.write(_CTRL, 0)

    def run(self, ticks: int) -> None:
        """Advance so many ticks."""
        pio = self._pio
        for _ in range(ticks):
            pio.advance(1)
            self.now += 1
            if pio.irq:
                self.interrupts.append(self.now)
                pio.irq = 0
            self._feed()

    def _feed(self) -> None:
        for machine, words in enumerate(self.waiting):
            while words and not self._pio.machines[machine].tx_fifo.full:
                self.write(_TXF + 4 * machine, words.pop(0))

    def at(self, machine: int) -> int:
        """Where a machine stands."""
        return self.read(_SM + _SM_STRIDE * machine + _ADDR)

    def x(self, machine: int) -> int:
        """Its X register."""
        return int(self._pio.machines[machine].x)

    def unread(self, machine: int) -> int:
        """Words it has not fetched."""
        return int(self._pio.machines[machine].tx_fifo.item_count) + len(self.waiting[machine])
