"""Virtual time of the ESP32's stand-ins, and its `time` module.

Functions that take time advance the clock. Callbacks of timers and pins are soft, as on the board:
they wait for a place between two bytecodes, here in advance(), and run one at a time. Eight may
wait; further ones are lost without a notice. A periodic timer takes a place each time. Runs under
CPython and MicroPython.
"""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from esp_machine import Timer

_PLACES = 8  # MICROPY_SCHEDULER_DEPTH
_NEVER = 1 << 60
_WRAP = 1 << 30  # ticks count up to this


class Clock:
    """Virtual microseconds. Functions that take time advance it; callbacks run in advance()
    only."""

    def __init__(self) -> None:
        self.us = 0
        self.timers: "list[Timer]" = []
        self.call_us = 2  # duration of reading the time, so that a loop that waits for it ends
        self.lost = 0  # number of callbacks that found no place
        self.in_c_code = False  # C code runs: callbacks must wait
        self._due = _NEVER  # when the next timer expires
        self._in_callback = False  # one runs: the others must wait
        self._waiting: "list[tuple[Any, object]]" = []  # callbacks with their arguments

    def ticks_us(self) -> int:
        """Stand in for time.ticks_us: wraps at 2**30."""
        self.work(self.call_us)
        return self.us % _WRAP

    def ticks_ms(self) -> int:
        """Stand in for time.ticks_ms."""
        return self.us // 1000 % _WRAP

    def ticks_diff(self, end: int, start: int) -> int:
        """Stand in for time.ticks_diff."""
        return (end - start + _WRAP // 2) % _WRAP - _WRAP // 2

    def reset(self) -> None:
        """Restore the state after power-up, except the time."""
        self.timers.clear()
        self._waiting.clear()
        self.lost = 0
        self.rearmed()

    def call(self, callback: "Any", argument: object) -> None:
        """Schedule a callback from an interrupt: it runs now, or as soon as possible, or is lost
        if too many wait."""
        if len(self._waiting) < _PLACES:
            self._waiting.append((callback, argument))
        else:
            self.lost += 1
        self._run()

    def _run(self) -> None:
        """Run the callbacks that wait, one at a time."""
        while self._waiting and not self._in_callback and not self.in_c_code:
            callback, argument = self._waiting.pop(0)
            self._in_callback = True
            try:
                callback(argument)
            finally:
                self._in_callback = False

    def work(self, us: int) -> None:
        """Let time pass inside C code: timers schedule their callbacks, but none can run."""
        self.us += us
        if self.us >= self._due:
            was_in_c_code, self.in_c_code = self.in_c_code, True
            self._call_timers()
            self.in_c_code = was_in_c_code

    def rearmed(self) -> None:
        """Note that a timer was started or stopped."""
        self._due = min([timer.due for timer in self.timers], default=_NEVER)

    def _call_timers(self) -> None:
        """Schedule the callbacks of all timers that are due, the earliest first."""
        while self._due <= self.us:
            timer = min(self.timers, key=_due)
            callback = timer.callback
            timer.rearm()
            self.rearmed()
            self.call(callback, timer)

    def advance(self, to: int) -> None:
        """Let time pass in Python code, until `to` in us: callbacks of timers run when they are
        due, or late."""
        assert not self._in_callback, "a callback may not wait for callbacks"
        self._run()
        while self._due <= to:
            self.us = max(self.us, self._due)
            self._call_timers()
        self.us = max(self.us, to)


def _due(timer: "Timer") -> int:
    """Return when a timer is due, in us."""
    return timer.due


clock = Clock()
