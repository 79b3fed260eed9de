"""The board's `rp2` module for CPython: the assembler, and state machines that store their
configuration.

Our own assembler, for the instructions our programs use; the binary form is that of the RP2040's
data sheet, 3.4. Nothing here executes a program: host_tests/support/pio_model.py does.
"""

from array import array
from collections.abc import Callable
from types import FunctionType
from typing import Any

from machine import Pin, _is_rp2350

_SIZE = 32  # instructions of a PIO
# Indices of a program in MicroPython's format.
_DATA, _OFFSETS, _EXECCTRL, _SHIFTCTRL, _OUT, _SET, _SIDE = 0, 1, 4, 5, 6, 7, 8

# Instructions, by their upper bits.
_WORD_JMP, _WORD_OUT, _WORD_PUSH, _WORD_PULL = 0x0000, 0x6000, 0x8000, 0x8080
_WORD_MOV, _WORD_IRQ, _WORD_SET = 0xA000, 0xC000, 0xE000
_PLACES = {"pins": 0, "x": 1, "y": 2, "null": 3, "pindirs": 4, "isr": 6, "osr": 7}
_CONDITIONS = {"not_x": 1, "x_dec": 2, "not_y": 3, "y_dec": 4, "x_not_y": 5, "pin": 6}
_BLOCK = 0x20  # bit of push and pull: wait while the FIFO is full or empty
_REL = 0x10  # bit of irq: the flag's number depends on the state machine


class PIOASMError(Exception):
    """The program cannot be assembled."""


class _Assembler:
    """One pass over a program. labels: by name, the indices of instructions; filled by the first
    pass, and used by the second one, the final one."""

    def __init__(self, labels: dict[str, int], final: bool) -> None:
        self.words = array("H")
        self.labels = labels
        self._final = final

    def names(self) -> dict[str, object]:
        """Return the globals of a program: each instruction is a call of a method."""
        methods = (self.label, self.jmp, self.out, self.pull, self.push, self.mov, self.irq)
        names: dict[str, object] = {method.__name__: method for method in methods}
        places = {**_PLACES, **_CONDITIONS, "block": _BLOCK, "noblock": 0}
        return {**names, **places, "set": self.set, "rel": lambda index: index | _REL}

    def __getitem__(self, delay: int) -> None:
        """Delay the last instruction: `set(pins, 1)[5]`."""
        if not 0 < delay < _SIZE:
            raise PIOASMError("delay too large")
        self.words[-1] |= delay << 8

    def _emit(self, word: int) -> "_Assembler":
        """Append an instruction. Returns the assembler, so that a delay may follow in brackets."""
        self.words.append(word)
        return self

    def label(self, name: str) -> None:
        if not self._final and name in self.labels:  # the final pass meets all again
            raise PIOASMError(f"duplicate label {name}")
        self.labels[name] = len(self.words)

    def jmp(self, condition: "int | str", label: str = "") -> "_Assembler":
        """Append a jump. The condition, one of _CONDITIONS, may be missing: jmp("label")."""
        number = 0 if isinstance(condition, str) else condition  # 0: always
        target = label or str(condition)
        if self._final and target not in self.labels:
            raise PIOASMError(f"unknown label {target}")
        return self._emit(_WORD_JMP | number << 5 | self.labels.get(target, 0))

    def out(self, place: int, bits: int) -> "_Assembler":
        if not 0 < bits <= _SIZE:
            raise PIOASMError(f"invalid bit count {bits}")
        return self._emit(_WORD_OUT | place << 5 | bits & 0x1F)  # 32 is encoded as 0

    def push(self, block: int = _BLOCK) -> "_Assembler":
        return self._emit(_WORD_PUSH | block)

    def pull(self, block: int = _BLOCK) -> "_Assembler":
        return self._emit(_WORD_PULL | block)

    def mov(self, place: int, source: int) -> "_Assembler":
        return self._emit(_WORD_MOV | place << 5 | source)

    def irq(self, index: int) -> "_Assembler":
        return self._emit(_WORD_IRQ | index)

    def set(self, place: int, value: int) -> "_Assembler":
        if not 0 <= value < _SIZE:
            raise PIOASMError(f"{value} does not fit")
        return self._emit(_WORD_SET | place << 5 | value)


def asm_pio(
    *,
    out_init: "int | None" = None,
    set_init: "int | None" = None,
    out_shiftdir: int = 0,
    in_shiftdir: int = 0,
) -> Callable[[Callable[[], None]], list[Any]]:
    """Assemble the decorated function; it becomes a program in MicroPython's format."""

    def assemble(function: Callable[[], None]) -> list[Any]:
        assert isinstance(function, FunctionType)
        labels: dict[str, int] = {}
        for final in (False, True):
            assembler = _Assembler(labels, final)
            # Runs the function, with the assembler's names as its globals.
            FunctionType(function.__code__, assembler.names())()
        words = assembler.words
        if len(words) > _SIZE:
            raise PIOASMError("program too long")
        not_loaded = [-1, -1, -1]  # offsets in the blocks
        execctrl = (len(words) - 1) << 12  # after the last instruction, the first one follows
        shiftctrl = out_shiftdir << 19 | in_shiftdir << 18
        return [words, *not_loaded, execctrl, shiftctrl, out_init, set_init, None]

    return assemble


def _blocks() -> int:
    """Return the number of PIO blocks of this chip."""
    return 3 if _is_rp2350() else 2


class PIO:
    """A block of four state machines. Its interrupts are stored in `handlers`."""

    IN_LOW, IN_HIGH, OUT_LOW, OUT_HIGH = range(4)
    SHIFT_LEFT, SHIFT_RIGHT = 0, 1
    JOIN_NONE, JOIN_TX, JOIN_RX = range(3)
    IRQ_SM0, IRQ_SM1, IRQ_SM2, IRQ_SM3 = 0x100, 0x200, 0x400, 0x800

    handlers: dict[int, tuple[Callable[["PIO"], object], int, bool]] = {}

    def __init__(self, id: int, /) -> None:
        if id not in range(_blocks()):
            raise ValueError("invalid PIO")
        self._id = id

    def irq(
        self, handler: Callable[["PIO"], object], trigger: int = 0xF00, hard: bool = False
    ) -> None:
        PIO.handlers[self._id] = (handler, trigger, hard)


class StateMachine:
    """A state machine's configuration; it does not run."""

    machines: dict[int, "StateMachine"] = {}
    used: dict[int, int] = {}  # instructions per PIO

    def __init__(
        self,
        id: int,
        program: list[Any],
        freq: int = -1,
        *,
        set_base: "Pin | None" = None,
        out_base: "Pin | None" = None,
    ) -> None:
        if not 0 <= id < 4 * _blocks():
            raise ValueError("invalid StateMachine")
        for pin, init in ((set_base, program[_SET]), (out_base, program[_OUT])):
            if (pin is None) != (init is None):
                raise ValueError("the pins given are not those that the program sets")
        pio = id // 4
        if program[_OFFSETS + pio] < 0:  # not loaded into this block yet
            offset = StateMachine.used.get(pio, 0)
            if offset + len(program[_DATA]) > _SIZE:
                raise OSError(12)  # ENOMEM
            program[_OFFSETS + pio] = offset
            StateMachine.used[pio] = offset + len(program[_DATA])
        self.program = program
        self.freq = freq
        self.set_base = set_base
        self.out_base = out_base
        StateMachine.machines[id] = self


class DMA:
    """A channel's configuration; it moves nothing."""

    claimed = 0

    def __init__(self) -> None:
        if DMA.claimed == (16 if _is_rp2350() else 12):  # all channels
            raise OSError(16)  # EBUSY
        self.channel = DMA.claimed
        DMA.claimed += 1
        self.configured: dict[str, object] = {}

    def pack_ctrl(
        self,
        *,
        size: int = 2,
        inc_read: bool = True,
        inc_write: bool = True,
        ring_size: int = 0,
        ring_sel: bool = False,
        treq_sel: int = 63,  # unpaced
        chain_to: int = -1,
        irq_quiet: bool = True,
    ) -> int:
        chain_to = self.channel if chain_to < 0 else chain_to  # itself: to none
        for value, limit in ((size, 4), (ring_size, 16), (treq_sel, 64), (chain_to, 16)):
            if not 0 <= value < limit:
                raise ValueError("bad field value")
        is_enabled = 1
        flags = (
            int(irq_quiet) << 21
            | int(ring_sel) << 10
            | int(inc_write) << 5
            | int(inc_read) << 4
            | is_enabled
        )
        return flags | treq_sel << 15 | chain_to << 11 | ring_size << 6 | size << 2

    def config(self, *, read: object, write: object, ctrl: int = 0, count: int = 0) -> None:
        self.configured = {"read": read, "write": write, "count": count, "ctrl": ctrl}
