"""The board's `esp32` module: RMT, and the free memory of the heaps, in virtual time.

Modelled on ports/esp32/esp32_rmt.c of MicroPython and rmt_tx.c of ESP-IDF 5.5.1. write_pulses()
waits for the last train inside C code, and only then begins to convert; it accepts lists and
tuples; an aborted train counts as in progress for ever. On the ESP32, active(False) waits for the
end of the train, whose pulses continue. An interrupt refills a train that is longer than the
channel's memory; if the interrupt is late, during a write to flash, old symbols are played again.
Durations that the hardware would truncate, or treat as an end, are refused. Runs under CPython and
MicroPython. What is not modelled does not exist.
"""

import esp_machine
from esp_clock import clock
from esp_pcnt import PCNT

__all__ = ["HEAP_DATA", "PCNT", "RMT", "idf_heap_info"]

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

# Duration of a call of write_pulses(), in us.
CALL_US = 90  # fixed
DURATION_US = 0.2  # for each duration of the train
JITTER_US = 30  # at most in addition, for flash cache misses
RETURN_US = 8  # from the start of the train to the return of the call
ABORT_US = 20  # duration of active(False)
# A generator of pseudo-random numbers for the jitter: x * 75 + 74, modulo 65537.
_RANDOM_FACTOR, _RANDOM_OFFSET, _RANDOM_MODULUS = 75, 74, 65537
_BLOCK_ESP32 = 64  # symbols; this block size identifies the ESP32, the S3 has another

HEAP_DATA = 4
psram = 4_134_464  # free at first; 0 without PSRAM


def idf_heap_info(capabilities: int) -> "list[tuple[int, int, int, int]]":
    """Return size, free, largest free block and minimum free of each heap. With PSRAM."""
    if capabilities != HEAP_DATA:
        raise NotImplementedError("only what our start asks for is modelled")
    inside = [(100_000, 60_000, 40_000, 50_000), (20_000, 3000, 2000, 2500)]
    return [(4_194_304, psram, psram, psram)] + inside


class RMT:
    """A transmitting channel. `trains` gets [start in us, first level, durations, end in us]."""

    PULSE_MAX = 32767
    channels: "list[RMT]" = []
    available = 8  # blocks of memory on the ESP32; the S3 has 4 for transmitting
    block = _BLOCK_ESP32  # symbols; the S3's have 48
    first_signal = 87  # S3: 81

    def __init__(
        self,
        id: int = -1,
        *,
        pin: "Any",
        resolution_hz: "int | None" = None,
        idle_level: bool = False,
        num_symbols: int = 0,
    ) -> None:
        if resolution_hz != 1_000_000 or idle_level:
            raise NotImplementedError("the model has no timeout: it has only what the engine uses")
        self.symbols = num_symbols or self.block
        if self.symbols < self.block or self.symbols % 2:
            raise ValueError("num_symbols must be even and at least %d" % self.block)
        blocks = -(-self.symbols // self.block)  # rounded up
        # Blocks are assigned in sequence; a channel has the number of its first one.
        self._number = RMT.channels[-1]._end_block if RMT.channels else 0
        self._end_block: int = self._number + blocks
        if self._end_block > self.available:
            raise OSError(261)  # ESP_ERR_NOT_FOUND
        self.pin = pin
        self.trains: "list[tuple[int, int, list[int], int]]" = []
        self._enabled = False
        self._end = 0  # of the last train, in us
        self._aborted = 0  # number of trains: they count as in progress for ever
        self._random = id + 1  # state of the generator
        esp_machine.mem32.connect(pin.id, self.first_signal + self._number)
        RMT.channels.append(self)

    def write_pulses(self, duration: "list[int] | tuple[int, ...]", data: object = True) -> None:
        """Send a train of levels, with their durations in us; data: the first level."""
        if self not in RMT.channels:
            raise OSError("already deinitialized")
        if isinstance(data, (list, tuple)) or not isinstance(duration, (list, tuple)):
            raise TypeError("object isn't a tuple or list")
        if not duration:
            raise ValueError("No pulses")
        for ticks in duration:
            if not isinstance(ticks, int):
                raise TypeError("can't convert to int")
            if not 0 < ticks <= self.PULSE_MAX:
                raise ValueError("a duration that the hardware does not have")
        if self._enabled:
            clock.work(max(0, self._end - clock.us))  # wait for the last train
        self._enabled = True
        self._random = (self._random * _RANDOM_FACTOR + _RANDOM_OFFSET) % _RANDOM_MODULUS
        jitter_us = self._random % (JITTER_US + 1)
        clock.work(CALL_US + int(len(duration) * DURATION_US) + jitter_us)
        start = clock.us
        self._end = start + sum(duration)
        self.trains.append((start, 1 if data else 0, list(duration), self._end))
        clock.work(RETURN_US)

    def flash_write(self, us: int) -> None:
        """Delay the interrupt that refills the memory for so long, from now on. If the memory runs
        empty meanwhile, the train is rewritten as it is then played: old durations are repeated,
        and it becomes longer."""
        if clock.us >= self._end:
            return
        start, level, durations, _ = self.trains[-1]
        remaining = list(durations)
        played = []
        end = start  # of the durations played
        filled = 2 * self.symbols  # number of durations that were in memory; a symbol has two
        while remaining and end < clock.us:  # played before now
            played.append(remaining.pop(0))
            end += played[-1]
            if len(played) % self.symbols == 0:  # half of the memory is free again
                filled += self.symbols
        while remaining and len(played) < filled:  # in memory already
            played.append(remaining.pop(0))
            end += played[-1]
        while remaining and end < clock.us + us:  # until the refill: the memory once more
            played.append(played[-2 * self.symbols])
            end += played[-1]
        played += remaining
        self._end = start + sum(played)
        self.trains[-1] = (start, level, played, self._end)

    def active(self, value: "bool | None" = None) -> bool:
        """Return whether a train is in progress, or abort it with False."""
        if value is None:
            return self._enabled and (clock.us < self._end or self._aborted > 0)
        if value:
            raise ValueError("activate by calling write_pulses()")
        if self._enabled and clock.us < self._end:
            self._aborted += 1
            if self.block == _BLOCK_ESP32:  # there, this waits for the end of the train
                clock.work(self._end - clock.us)
            start, level, duration, _ = self.trains[-1]
            self.trains[-1] = (start, level, duration, clock.us)
            self._end = clock.us
        self._enabled = False
        clock.work(ABORT_US)
        return False

    def wait_done(self, *, timeout: int = 0) -> bool:
        """Return whether all trains have ended; an aborted one never does."""
        if not self._enabled:
            return True
        if timeout:
            raise NotImplementedError("the model has no timeout: it has only what the engine uses")
        return clock.us >= self._end and self._aborted == 0

    def deinit(self) -> None:
        if self in RMT.channels:
            self.active(False)
            RMT.channels.remove(self)
