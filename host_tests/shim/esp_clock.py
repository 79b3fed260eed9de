"""Virtual time of the ESP32's stand-ins, and its `time` module.

What takes time says so. Callbacks of timers and pins are soft, as on the board: they come between
bytecodes, here in advance(), and one at a time. Runs under both Pythons.
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from esp_machine import Timer


class Clock:
    """Virtual microseconds. What takes time says so; callbacks come in advance() only."""

    def __init__(self) -> None:
        self.us = 0
        self.timers: "list[Timer]" = []
        self.call_us = 2  # what asking for the time takes, so that waiting for it ends
        self._inside = False
        self._waiting: "list[tuple[Any, object]]" = []

    def ticks_us(self) -> int:
        """Stands in for time.ticks_us: wraps at 2**30."""
        self.us += self.call_us
        return self.us & 0x3FFFFFFF

    def ticks_ms(self) -> int:
        """Stands in for time.ticks_ms."""
        return self.us // 1000 & 0x3FFFFFFF

    def ticks_diff(self, end: int, start: int) -> int:
        """Stands in for time.ticks_diff."""
        return ((end - start + 0x20000000) & 0x3FFFFFFF) - 0x20000000

    def call(self, callback: "Any", argument: object) -> None:
        """An interrupt's callback: now, or behind the one that is running."""
        self._waiting.append((callback, argument))
        while self._waiting and not self._inside:
            callback, argument = self._waiting.pop(0)
            self._inside = True
            try:
                callback(argument)
            finally:
                self._inside = False

    def work(self, us: int) -> None:
        """Time passes inside C code: no callback can run."""
        self.us += us

    def next_event(self) -> "int | None":
        """When the next timer is due."""
        return min([timer.due for timer in self.timers], default=None)

    def advance(self, to: int) -> None:
        """Time passes in Python code: timers call back as they fall due, or late."""
        assert not self._inside, "a callback may not wait for callbacks"
        while True:
            due = sorted([timer for timer in self.timers if timer.due <= to], key=_due)
            if not due:
                break
            timer = due[0]
            self.us = max(self.us, timer.due)
            timer.rearm()
            self.call(timer.callback, timer)
        self.us = max(self.us, to)


def _due(timer: "Timer") -> int:
    return timer.due


clock = Clock()
