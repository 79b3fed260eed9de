"""Test the model of the flash cache with short Thumb programs, and with a whole board."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import xip
from emulated import Board
from rp2040py.execute_batch import execute_batch
from rp2040py.simulator import Simulator

pytestmark = pytest.mark.skipif(
    not xip.is_there(), reason="no model of the flash cache: make compiled-emulator"
)

_FLASH, _NO_ALLOCATE, _NO_CACHE, _NEITHER = 0x10000000, 0x11000000, 0x12000000, 0x13000000
_RAM = 0x20000000
_XIP_CTRL = 0x14000000
_CTRL, _FLUSH, _CTR_HIT, _CTR_ACC = (_XIP_CTRL + x for x in (0, 4, 0xC, 0x10))
_WAY = 8192  # addresses at this distance are in the same set
_FLUSH_CYCLES = 1024
_STEP = 8  # cycles
_NS_PER_CYCLE = 8

_NOP = 0xBF00
_LOAD = 0x6808  # LDR R0, [R1]
_LOAD_CYCLES = 2


class _Chip:
    """A chip, run instruction by instruction."""

    def __init__(self) -> None:
        self.mcu: Any = xip.chip()(None)  # with the model of the cache
        self.cache = self.mcu.cache
        self.core = self.mcu.core

    def run(self, address: int, opcodes: "list[int]") -> int:
        """Store instructions at an address and execute them; return the cycles they took."""
        code = b"".join(opcode.to_bytes(2, "little") for opcode in opcodes)
        memory = self.mcu.sram if address >= _RAM else self.mcu.flash
        offset = address & 0xFFFFFF
        memory[offset : offset + len(code)] = code
        self.core.pc = address
        return sum(self.step() for _ in opcodes)

    def step(self) -> int:
        """Execute an instruction; return its cycles, with those spent waiting."""
        cycles = self.core.execute_instruction()
        while self.cache.due:
            cycles += self.core.execute_instruction()
        return int(cycles)

    def load(self, *addresses: int) -> int:
        """Read data at addresses by instructions in RAM; return the number of misses."""
        before = self.cache.misses
        for address in addresses:
            self.core.registers[1] = address
            self.run(_RAM, [_LOAD])
        return int(self.cache.misses - before)


@pytest.fixture
def chip() -> "Iterator[_Chip]":
    yield _Chip()


def test_sequential_code_misses_once_in_four_bytes(chip: _Chip) -> None:
    """Two instructions of 16 bits are fetched at once."""
    cycles = chip.run(_FLASH, [_NOP] * 16)
    assert (chip.cache.misses, chip.cache.hits) == (8, 0)
    assert cycles == 16 + 8 * xip.MISS_CYCLES
    assert (chip.cache.stalled_cycles, chip.cache.cycles) == (8 * xip.MISS_CYCLES, cycles)


def test_executed_code_is_in_the_cache(chip: _Chip) -> None:
    chip.run(_FLASH, [_NOP] * 16)
    assert chip.run(_FLASH, [_NOP] * 16) == 16
    assert (chip.cache.misses, chip.cache.hits) == (8, 8)


def test_both_halves_of_a_long_instruction_are_fetched(chip: _Chip) -> None:
    """An instruction of 32 bits that begins in the middle of a word: two words are missed."""
    barrier = [0xF3BF, 0x8F5F]  # DMB
    chip.mcu.flash[2:6] = b"".join(half.to_bytes(2, "little") for half in barrier)
    chip.core.pc = _FLASH + 2
    chip.step()
    assert chip.cache.misses == 2


def test_core_counts_the_cycles_of_waiting(chip: _Chip) -> None:
    chip.run(_FLASH, [_NOP])
    assert chip.core.cycles == 1 + xip.MISS_CYCLES


def test_two_lines_of_a_set_stay(chip: _Chip) -> None:
    assert chip.load(_FLASH, _FLASH + _WAY) == 2
    assert chip.load(_FLASH, _FLASH + _WAY) == 0


def test_third_line_replaces_the_least_recently_used_one(chip: _Chip) -> None:
    chip.load(_FLASH, _FLASH + _WAY, _FLASH, _FLASH + 2 * _WAY)
    assert chip.load(_FLASH, _FLASH + 2 * _WAY) == 0
    assert chip.load(_FLASH + _WAY) == 1


def test_cache_size_is_16_kb(chip: _Chip) -> None:
    words = range(_FLASH, _FLASH + 2 * _WAY, 4)
    assert chip.load(*words) == len(words)
    assert chip.load(*words) == 0


def test_replaced_line_loses_both_halves(chip: _Chip) -> None:
    chip.load(_FLASH, _FLASH + 4, _FLASH + _WAY, _FLASH + 2 * _WAY)
    assert chip.load(_FLASH, _FLASH + 4) == 2


def test_data_of_any_size_counts_like_code(chip: _Chip) -> None:
    """Three loads from one word: a miss and two hits."""
    chip.core.registers[1] = _FLASH + 4
    load_byte, load_half, load_word = 0x7808, 0x8808, _LOAD
    for opcode in (load_byte, load_half, load_word):
        chip.run(_RAM, [opcode])
    assert (chip.cache.misses, chip.cache.hits) == (1, 2)


def test_ram_is_not_cached(chip: _Chip) -> None:
    chip.core.registers[1] = _RAM + 256
    assert chip.run(_RAM, [_NOP, _LOAD, _NOP]) == 2 + _LOAD_CYCLES
    assert (chip.cache.misses, chip.cache.hits) == (0, 0)


def test_read_from_outside_changes_nothing(chip: _Chip) -> None:
    chip.mcu.read_uint32(_FLASH)
    chip.mcu.read_uint16(_FLASH)
    chip.mcu.read_uint8(_FLASH)
    assert (chip.cache.misses, chip.cache.hits) == (0, 0)


@pytest.mark.parametrize(
    ("alias", "again", "by_flash"),
    [(_FLASH, 0, 0), (_NO_ALLOCATE, 1, 1), (_NO_CACHE, 1, 0), (_NEITHER, 1, 1)],
)
def test_aliases_of_uncached_flash(chip: _Chip, alias: int, again: int, by_flash: int) -> None:
    """An alias is the same flash at another address. Read there, _NO_ALLOCATE uses a line of the
    cache but stores none, _NO_CACHE stores a line but uses none, _NEITHER does neither.

    again, by_flash: misses of a second read by the alias, and of a read by the normal address.
    """
    assert chip.load(alias) == 1
    assert chip.load(alias) == again
    assert chip.load(_FLASH) == by_flash


@pytest.mark.parametrize(("alias", "misses"), [(_NO_ALLOCATE, 0), (_NO_CACHE, 1), (_NEITHER, 1)])
def test_aliases_of_cached_flash(chip: _Chip, alias: int, misses: int) -> None:
    """After a read by the normal address."""
    chip.load(_FLASH)
    assert chip.load(alias) == misses


def test_all_aliases_read_the_same(chip: _Chip) -> None:
    chip.mcu.flash[8:12] = b"\x78\x56\x34\x12"
    for alias in (_FLASH, _NO_ALLOCATE, _NO_CACHE, _NEITHER):
        chip.load(alias + 8)
        assert chip.core.registers[0] == 0x12345678


def test_flush_empties_the_cache_and_takes_its_time(chip: _Chip) -> None:
    """The next instruction waits for it; then the code is missed again."""
    chip.run(_FLASH, [_NOP] * 2)
    chip.mcu.write_uint32(_FLUSH, 1)
    assert chip.step() == _FLUSH_CYCLES
    assert chip.run(_FLASH, [_NOP] * 2) == 2 + xip.MISS_CYCLES


def test_disabled_cache_never_hits(chip: _Chip) -> None:
    """Its content stays, and is used when it is enabled again."""
    chip.load(_FLASH)
    chip.mcu.write_uint32(_CTRL, 0)
    assert chip.load(_FLASH, _FLASH) == 2
    chip.mcu.write_uint32(_CTRL, 1)
    assert chip.load(_FLASH) == 0


def test_program_can_read_the_chips_counters(chip: _Chip) -> None:
    """One counts hits, one all accesses; a write sets one to 0."""
    chip.load(_FLASH, _FLASH, _FLASH)
    assert [chip.mcu.read_uint32(x) for x in (_CTR_HIT, _CTR_ACC)] == [2, 3]
    chip.mcu.write_uint32(_CTR_HIT, 0)
    chip.load(_FLASH)
    assert [chip.mcu.read_uint32(x) for x in (_CTR_HIT, _CTR_ACC)] == [1, 4]


def test_clock_and_pio_advance_in_small_steps_while_the_core_waits(chip: _Chip) -> None:
    """An alarm in the middle of a miss stops the simulator after a whole number of steps of 8
    cycles; the rest of the wait is still due."""
    simulator = Simulator(rp2040=chip.mcu)
    simulator.clock.create_alarm(lambda: setattr(simulator, "stopped", True)).schedule(
        _NS_PER_CYCLE * (2 * _STEP + 1)
    )
    chip.mcu.flash[0:2] = _NOP.to_bytes(2, "little")
    chip.core.pc = _FLASH
    simulator.stopped = False
    execute_batch(simulator, 1)
    assert simulator.clock.nanos == _NS_PER_CYCLE * (1 + 2 * _STEP)
    assert chip.cache.due == xip.MISS_CYCLES - 2 * _STEP


def test_board_with_the_cache_starts_and_waits_for_flash(uf2: Path) -> None:
    """Fewer than one in 20 fetches is a miss; the start takes 5 % longer than without a cache
    model."""
    board = Board(uf2, cache=True).boot()
    cache = board.pico.mcu.cache
    assert 0 < 20 * cache.misses < cache.hits
    assert board.pico.us > 1.05 * Board(uf2).boot().pico.us
