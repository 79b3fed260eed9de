"""The board's `esp32` module: RMT, in virtual time.

As ports/esp32/esp32_rmt.c of MicroPython does it: write_pulses() waits for the last train inside
C code, and only then begins to convert; it takes lists and tuples; what is aborted stays counted
as under way for ever. Durations that the hardware would cut off, or take for an end, are
refused. Runs under both Pythons. What is not modelled does not exist.
"""

from esp_clock import clock

# What a call takes, in us: to begin with, per duration, and at the most besides (a flash cache
# has its moods). The hardware starts shortly before the call returns.
CALL_US = 90
DURATION_US = 0.2
MOOD_US = 30
RETURN_US = 8


class RMT:
    """A transmitting channel. `trains` gets [start in us, first level, durations, end in us]."""

    PULSE_MAX = 32767
    channels: "list[RMT]" = []
    available = 8  # ESP32; the S3 has 4

    def __init__(
        self,
        id: int = -1,
        *,
        pin: object,
        resolution_hz: "int | None" = None,
        idle_level: bool = False,
        num_symbols: int = 64,
    ) -> None:
        if resolution_hz != 1_000_000:
            raise NotImplementedError("only what our engine uses is modelled")
        if num_symbols < 64 or num_symbols % 2:
            raise ValueError("num_symbols must be even and at least 64")
        if len(RMT.channels) == RMT.available:
            raise OSError(261)  # ESP_ERR_NOT_FOUND
        self.pin = pin
        self.idle_level = idle_level
        self.trains: "list[tuple[int, int, list[int], int]]" = []
        self._enabled = False
        self._end = 0
        self._aborted = 0
        self._mood = id + 1
        RMT.channels.append(self)

    def write_pulses(self, duration: "list[int] | tuple[int, ...]", data: object = True) -> None:
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
            clock.work(max(0, self._end - clock.us))
        self._enabled = True
        self._mood = (self._mood * 75 + 74) % 65537
        clock.work(CALL_US + int(len(duration) * DURATION_US) + self._mood % (MOOD_US + 1))
        start = clock.us
        self._end = start + sum(duration)
        self.trains.append((start, 1 if data else 0, list(duration), self._end))
        clock.work(RETURN_US)

    def active(self, value: "bool | None" = None) -> bool:
        if value is None:
            return self._enabled and (clock.us < self._end or self._aborted > 0)
        if value:
            raise ValueError("activate by calling write_pulses()")
        if self._enabled and clock.us < self._end:
            self._aborted += 1
            start, level, duration, _ = self.trains[-1]
            self.trains[-1] = (start, level, duration, clock.us)
            self._end = clock.us
        self._enabled = False
        clock.work(20)
        return False

    def wait_done(self, *, timeout: int = 0) -> bool:
        if not self._enabled:
            return True
        if timeout:
            raise NotImplementedError("only what our engine uses is modelled")
        return clock.us >= self._end and self._aborted == 0

    def deinit(self) -> None:
        if self in RMT.channels:
            self.active(False)
            RMT.channels.remove(self)
