"""Virtual time of the ESP32's stand-ins, and its `time` module.

What takes time says so. Callbacks of timers and pins are soft, as on the board: they wait for a
place between two bytecodes, here in advance(), and come one at a time. Eight may wait; what comes
on top is lost, and nobody is told. A timer that ticks takes a place each time. Runs under both
Pythons.
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from esp_machine import Timer

_PLACES = 8  # MICROPY_SCHEDULER_DEPTH
_NEVER = 1 << 60


class Clock:
    """Virtual microseconds. What takes time says so; callbacks come in advance() only."""

    def __init__(self) -> None:
        self.us = 0
        self.timers: "list[Timer]" = []
        self.call_us = 2  # what asking for the time takes, so that waiting for it ends
        self.lost = 0  # callbacks that found no place
        self.busy = False  # C code is at work, and no callback comes
        self._due = _NEVER
        self._inside = False
        self._waiting: "list[tuple[Any, object]]" = []

    def ticks_us(self) -> int:
        """Stands in for time.ticks_us: wraps at 2**30."""
        self.work(self.call_us)
        return self.us & 0x3FFFFFFF

    def ticks_ms(self) -> int:
        """Stands in for time.ticks_ms."""
        return self.us // 1000 & 0x3FFFFFFF

    def ticks_diff(self, end: int, start: int) -> int:
        """Stands in for time.ticks_diff."""
        return ((end - start + 0x20000000) & 0x3FFFFFFF) - 0x20000000

    def reset(self) -> None:
        """As after power-up, but for the time."""
        self.timers.clear()
        self._waiting.clear()
        self.lost = 0
        self.rearmed()

    def call(self, callback: "Any", argument: object) -> None:
        """An interrupt wants a callback: now, or as soon as one can come."""
        if len(self._waiting) < _PLACES:
            self._waiting.append((callback, argument))
        else:
            self.lost += 1
        self._run()

    def _run(self) -> None:
        while self._waiting and not self._inside and not self.busy:
            callback, argument = self._waiting.pop(0)
            self._inside = True
            try:
                callback(argument)
            finally:
                self._inside = False

    def work(self, us: int) -> None:
        """Time passes inside C code: timers tick, but no callback can run."""
        self.us += us
        if self.us >= self._due:
            busy, self.busy = self.busy, True
            self._tick()
            self.busy = busy

    def rearmed(self) -> None:
        """A timer has been started, or stopped."""
        self._due = min([timer.due for timer in self.timers], default=_NEVER)

    def _tick(self) -> None:
        while self._due <= self.us:
            timer = min(self.timers, key=_due)
            callback = timer.callback
            timer.rearm()
            self.rearmed()
            self.call(callback, timer)

    def advance(self, to: int) -> None:
        """Time passes in Python code: timers call back as they fall due, or late."""
        assert not self._inside, "a callback may not wait for callbacks"
        self._run()
        while self._due <= to:
            self.us = max(self.us, self._due)
            self._tick()
        self.us = max(self.us, to)


def _due(timer: "Timer") -> int:
    return timer.due


clock = Clock()
