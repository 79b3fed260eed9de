"""Blocks of an SD card: despite faults on the wire they are right, or a fault is reported in
time."""

import errno
from array import array
from collections.abc import Iterator
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from laws import some
from ports.link_memory import STATE_LENGTH
from ports.storage import sd_blocks
from ports.storage.sd_blocks import SdBlocks
from sd_model import BLOCK, SdCard

# Many cases of each: the first ring runs a sample.
pytestmark = pytest.mark.sampled(2)

_PINS = (10, 11, 12, 13)
_BLOCKS = 1024
_LOOP_MS = 250  # the supervisor's limit for the main loop in motion


class Bench:
    """A card on a bus whose bytes take time.

    us: the time; hz: bus clock set by the driver; bytes: exchanged so far; out_at: the card is
    removed at that byte (-1: never). pin, bus: stand for MicroPython's Pin and SPI. The card's
    `read` and `written` count blocks; card.damage changes a block on its way to the reader."""

    def __init__(self, is_large: bool = True) -> None:
        """Fill the card with random bytes. is_large: addresses count blocks, not bytes."""
        content = Random(1).randbytes(_BLOCKS * BLOCK)
        self.card = SdCard(bytearray(content), is_large)
        self.us = 0.0
        self.hz = 0
        self.bytes = 0
        self.out_at = -1
        bench = self

        class Pin:
            IN, OUT, PULL_UP = range(3)

            def __init__(self, id: int, *_: object, **__: object) -> None:
                self.id = id

            def __call__(self, level: int) -> None:
                assert self.id == _PINS[-1]  # chip select, active low
                bench.card.select(not level)

        class Bus:
            def __init__(self, number: int, *, sck: Pin, mosi: Pin, miso: Pin) -> None:
                assert number == 1 and (sck.id, mosi.id, miso.id) == _PINS[:3]

            def init(self, *, baudrate: int) -> None:
                bench.hz = baudrate

            def write(self, data: bytes) -> None:
                for byte in bytes(data):
                    bench.exchange(byte)

            def readinto(self, into: bytearray, byte: int) -> None:
                for i in range(len(into)):
                    into[i] = bench.exchange(byte)

            def read(self, count: int, byte: int) -> bytes:
                return bytes(bench.exchange(byte) for _ in range(count))

        self.pin, self.bus = Pin, Bus

    def exchange(self, byte: int) -> int:
        """Send a byte and return the one received; it takes 8 bits, and 1 us more."""
        self.us += 8e6 / self.hz + 1
        self.bytes += 1
        if self.bytes == self.out_at:
            self.card.is_in = False
        return self.card.exchange(byte)

    def driver(self) -> SdBlocks:
        made = SdBlocks(_PINS, array("i", [0] * STATE_LENGTH))
        made.begin()
        return made


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    yield from wire_up(Bench(), monkeypatch)


@pytest.fixture
def byte_addressed(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    yield from wire_up(Bench(is_large=False), monkeypatch)


def wire_up(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    """Let the driver use this bench's bus and clock."""
    monkeypatch.setattr(sd_blocks, "SPI", bench.bus)
    monkeypatch.setattr(sd_blocks, "Pin", bench.pin)
    monkeypatch.setattr(sd_blocks.time, "ticks_ms", lambda: int(bench.us / 1000), raising=False)
    monkeypatch.setattr(sd_blocks.time, "ticks_diff", lambda a, b: a - b, raising=False)
    yield bench


def block_of(bench: Bench, number: int, bytes_before: int = 1) -> bytes:
    return bytes(bench.card.image[number * BLOCK : (number + bytes_before) * BLOCK])


@pytest.mark.parametrize("kind", ["bench", "byte_addressed"])
def test_written_blocks_are_read_back(kind: str, request: pytest.FixtureRequest) -> None:
    """byte_addressed: an old card, whose addresses count bytes, not blocks."""
    bench: Bench = request.getfixturevalue(kind)
    driver = bench.driver()
    # 4: number of blocks, 5: their size
    assert driver.ioctl(4, 0) == _BLOCKS and driver.ioctl(5, 0) == BLOCK
    data = Random(2).randbytes(3 * BLOCK)
    driver.writeblocks(7, data)
    assert block_of(bench, 7, 3) == data
    buffer = bytearray(5 * BLOCK)
    driver.readblocks(6, buffer)  # the three written, and one on each side
    assert buffer == block_of(bench, 6, 5)
    assert bench.card.written == 3


def test_the_bus_starts_slowly_and_continues_fast(bench: Bench) -> None:
    """The specification allows 400 kHz until the card is identified."""
    speeds: list[int] = []
    exchange = bench.exchange
    bench.exchange = lambda byte: speeds.append(bench.hz) or exchange(byte)  # type: ignore
    driver = bench.driver()
    assert set(speeds) == {400_000}
    speeds.clear()
    driver.readblocks(0, bytearray(BLOCK))
    assert set(speeds) == {12_000_000}


@given(bit=st.integers(0, BLOCK * 8 - 1), number=st.integers(0, _BLOCKS - 1))
@some(50)
def test_a_block_with_a_wrong_bit_is_read_again(bit: int, number: int) -> None:
    with pytest.MonkeyPatch.context() as patch:
        for bench in wire_up(Bench(), patch):
            driver = bench.driver()
            bench.card.damage = flip_bit_once(bench, bit)
            buffer = bytearray(BLOCK)
            driver.readblocks(number, buffer)
            assert buffer == block_of(bench, number)
            assert bench.card.read == 2


def flip_bit_once(bench: Bench, bit: int) -> Any:
    """Return a function that inverts this bit of the next block read, and of no other."""

    def damage(block: bytes) -> bytes:
        bench.card.damage = lambda block_read: block_read
        damaged = bytearray(block)
        damaged[bit >> 3] ^= 1 << (bit & 7)
        return bytes(damaged)

    return damage


def test_a_block_that_is_always_read_wrong_is_a_fault(bench: Bench) -> None:
    """One bit is inverted at each read. After the fault the card is right again, but is not
    used (bench.bytes: exchanged so far)."""
    driver = bench.driver()
    bench.card.damage = lambda block: bytes([block[0] ^ 1]) + block[1:]
    assert driver.readblocks(0, bytearray(BLOCK)) == -errno.EIO
    # The file system's state is incomplete by then: nothing works until it is mounted again.
    bench.card.damage = lambda block: block
    assert driver.is_faulty and not driver.is_there()
    bytes_before = bench.bytes
    assert driver.readblocks(0, bytearray(BLOCK)) == -errno.EIO
    assert driver.writeblocks(0, bytes(BLOCK)) == -errno.EIO
    assert bench.bytes == bytes_before


def test_a_refused_block_is_written_again(bench: Bench) -> None:
    """Three times in all; then it is a fault."""
    driver = bench.driver()
    bench.card.refuse = 2  # how many blocks the card refuses as damaged
    driver.writeblocks(3, bytes(BLOCK))
    assert block_of(bench, 3) == bytes(BLOCK)
    bench.card.refuse = 3
    assert driver.writeblocks(4, bytes(BLOCK)) == -errno.EIO


def test_a_block_after_the_last_is_a_fault(bench: Bench) -> None:
    assert bench.driver().readblocks(_BLOCKS, bytearray(BLOCK)) == -errno.EIO


def test_an_ignored_command_is_repeated(bench: Bench) -> None:
    """For example a restarted board finds the card in the middle of a block. The card seems to
    ignore bytes 11 to 29 of the start."""
    exchange, byte_count = bench.exchange, 0

    def silent_at_first(byte: int) -> int:
        nonlocal byte_count
        byte_count += 1
        return exchange(byte) if not 10 < byte_count < 30 else ignored(exchange, byte)

    def ignored(exchange: Any, byte: int) -> int:
        exchange(0xFF)  # the card does not get the byte
        return 0xFF

    bench.exchange = silent_at_first  # type: ignore[method-assign]
    assert bench.driver().is_there()


def test_a_card_without_checksums_is_refused(bench: Bench) -> None:
    bench.card.has_no_sums = True
    with pytest.raises(OSError):
        bench.driver()


def test_an_empty_holder_is_reported_in_time(bench: Bench) -> None:
    bench.card.is_in = False
    with pytest.raises(OSError):
        bench.driver()
    assert bench.us < _LOOP_MS * 1000


@pytest.mark.parametrize("out_at", range(0, 560, 7))
def test_a_card_removed_at_any_byte_is_a_fault_and_gives_no_wrong_block(
    bench: Bench, out_at: int
) -> None:
    """It is removed out_at bytes after the start of a read."""
    driver = bench.driver()
    bench.bytes, bench.out_at = 0, out_at + 1
    begun_us = bench.us
    buffer = bytearray(BLOCK)
    if driver.readblocks(9, buffer) == 0:  # the block had been read already
        # Fewer than 20 bytes were exchanged without the card.
        assert buffer == block_of(bench, 9) and bench.bytes < out_at + 20
    assert bench.us - begun_us < _LOOP_MS * 1000
    bench.card.is_in = False
    assert not driver.is_there()


def test_another_card_is_not_taken_for_the_one_before(bench: Bench) -> None:
    """A card that was without power is not initialised: the driver must begin again."""
    driver = bench.driver()
    assert driver.is_there()
    bench.card.power_off()
    assert not driver.is_there()
    driver.begin()
    assert driver.is_there()


def test_after_end_nothing_is_written_or_raised(bench: Bench) -> None:
    """An open file writes when it is collected: it must not write to another card."""
    driver = bench.driver()
    driver.end()
    image_before, bytes_before = bytes(bench.card.image), bench.bytes
    driver.writeblocks(0, bytes(BLOCK))
    driver.readblocks(0, bytearray(BLOCK))
    assert bytes(bench.card.image) == image_before and bench.bytes == bytes_before
    driver.begin()
    driver.writeblocks(0, bytes(BLOCK))
    assert block_of(bench, 0) == bytes(BLOCK)


def test_a_missing_block_takes_a_tenth_of_a_second(bench: Bench) -> None:
    driver = bench.driver()
    bench.card.damage = lambda block: None
    begun_us = bench.us
    assert driver.readblocks(0, bytearray(BLOCK)) == -errno.EIO
    assert 100_000 <= bench.us - begun_us < 150_000


def test_a_card_that_holds_the_line_low_takes_a_tenth_of_a_second(bench: Bench) -> None:
    driver = bench.driver()
    bench.card.exchange = lambda byte: 0  # type: ignore[method-assign]
    begun_us = bench.us
    assert driver.readblocks(0, bytearray(BLOCK)) == -errno.EIO
    assert bench.us - begun_us < 150_000


def test_a_card_that_stays_busy_is_a_fault(bench: Bench) -> None:
    driver = bench.driver()
    bench.card.busy = 1_000_000  # bytes: much longer than the driver waits
    begun_us = bench.us
    assert driver.writeblocks(0, bytes(BLOCK)) == -errno.EIO
    assert 500_000 <= bench.us - begun_us < 600_000  # it waits for half a second
