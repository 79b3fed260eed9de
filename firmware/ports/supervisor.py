# mypy: disable-error-code=arg-type
"""Supervisor: stop the machine if the main loop no longer runs.

All code that waits reads the link, so a link that is not read means that the main loop hangs. A
timer, hard if the chip has hard timers, measures for how long. Past the limit it switches tools
off and stops motors, at every beat, until the loop is back; an exception then reports the cause.
If the loop never comes back, the watchdog resets the chip: it is fed here, as long as the link is
read.

A write to flash, and one to a host that does not read, may take longer: they announce it first.
"""

import sys

import micropython
from base.times import NEGATIVE
from machine import Timer
from micropython import const

from ports.link_memory import AWAY_MS, LOOP_HAS_READ, STOP_CAUSE

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import BoardLink, Port, StepEngine

# Beat of a hard timer, and of one that goes through MicroPython's queue of 8, which must not fill
# up.
_HARD_MS = const(5)  # between two beats of a hard timer
_SOFT_MS = const(50)  # and of a soft one
_SOFT_TIMER = const(3)  # its number: 0 is the engine's, 1 and 2 the port's

_FAILED = const(-1)  # in shared[STOP_CAUSE]: the interrupt has raised
_CTRL_X = const(24)


class Supervisor:
    """Watch a link, an engine and a port. limit_ms: how long the main loop may be away. _feed
    feeds the watchdog; _poll_reset looks for Ctrl-X in the link; None if that is impossible.

    _shared: the link's state. shared[LOOP_HAS_READ] is 1 if the link was read since the last beat;
    shared[AWAY_MS] the ms that the main loop has been away, from below 0 if more is allowed;
    shared[STOP_CAUSE] why the machine was stopped: ms away, _FAILED, or 0.
    """

    def __init__(
        self, link: "BoardLink", engine: "StepEngine", port: "Port", limit_ms: int
    ) -> None:
        self._shared = link.shared
        self._poll_reset = link.poll_reset
        link.check_supervisor = self.raise_if_stopped
        self._port = port
        self._kill = port.kill
        self._stop = engine.stop
        self._limit_ms = limit_ms
        hard = sys.platform == "rp2"
        self._beat_ms = _HARD_MS if hard else _SOFT_MS
        self._last_ms = 0  # time of the last soft beat
        self._timer = Timer(-1 if hard else _SOFT_TIMER)  # -1: RP2's have no numbers

    def start(self, feed: "Callable[[], None] | None", on_reset: "Callable[[int], None]") -> None:
        """Start watching. feed: feeds the watchdog. on_reset: called with 0 (no alarm), in the
        interrupt, if a Ctrl-X came while the main loop does not read; tool and motors have been
        stopped then."""
        self._feed = feed
        self._on_reset = on_reset
        self.allow(0)
        hard = self._beat_ms == _HARD_MS  # the chip has hard timers
        beat = self._beat if hard else self._soft_beat
        self._timer.init(period=self._beat_ms, callback=beat, hard=hard)

    def close(self) -> None:
        """Stop watching."""
        self._timer.deinit()

    def allow(self, ms: int) -> None:
        """Let the main loop's next turn take so many ms longer."""
        self._shared[AWAY_MS] = -ms

    def _soft_beat(self, timer: object) -> None:
        """Beat, called by a timer that is not hard: beats that were queued while flash was written
        come at once, and only the first of them counts."""
        if self._port.elapsed_ms(self._last_ms) >= _SOFT_MS // 2:
            self._last_ms = self._port.ticks_ms()
            self._beat(timer)

    @micropython.viper
    def _beat(self, _timer: object) -> int:
        """Measure the main loop's absence, feed the watchdog, look for Ctrl-X; stop tool and
        motors if the loop was away too long or Ctrl-X came. Interrupt.

        It catches all exceptions, because MicroPython would not call it again after one. It is one
        viper function: as bytecode it took twice the time, at every beat. Returns 0.
        """
        shared = ptr32(self._shared)
        stops = 0
        resets = 0
        try:
            if shared[LOOP_HAS_READ]:
                shared[LOOP_HAS_READ] = 0
                shared[AWAY_MS] = 0
            else:  # the main loop has not read the link since the last beat
                shared[AWAY_MS] += int(self._beat_ms)
                if shared[AWAY_MS] == 0:
                    shared[AWAY_MS] = 1  # the allowance is used up; 0 means not away
            # viper compares as unsigned here, so a value below 0, an absence that is allowed, is
            # excluded by its sign bit.
            if shared[AWAY_MS] & NEGATIVE == 0 and shared[AWAY_MS] >= int(self._limit_ms):
                stops = 1
                shared[STOP_CAUSE] = shared[AWAY_MS]
            else:
                if shared[AWAY_MS] == 0 and self._feed:
                    self._feed()
                if self._poll_reset:
                    resets = int(self._poll_reset())
        except:  # noqa: E722
            stops = 1
            shared[STOP_CAUSE] = _FAILED
        if stops or resets:
            try:
                self._kill()
            except:  # noqa: E722
                shared[STOP_CAUSE] = _FAILED
            try:
                self._stop()
            except:  # noqa: E722
                shared[STOP_CAUSE] = _FAILED
        if resets:
            try:
                self._on_reset(0)
            except:  # noqa: E722
                shared[STOP_CAUSE] = _FAILED
        if stops:
            micropython.kbd_intr(_CTRL_X)  # Ctrl-X received interrupts code that does not return
        return 0

    def end_absence(self) -> int:
        """Note that the main loop is back. Returns how long it was away, in ms, if the machine was
        stopped for that, _FAILED if the interrupt has raised, else 0."""
        self._shared[LOOP_HAS_READ] = 1
        micropython.kbd_intr(-1)  # no byte interrupts any longer
        away = self._shared[STOP_CAUSE]
        self._shared[STOP_CAUSE] = 0
        return away

    def raise_if_stopped(self) -> None:
        """Raise RuntimeError, which says why the machine was stopped; only after a stop, called by
        the link because the main loop reads it again."""
        away = self.end_absence()
        if away == _FAILED:
            raise RuntimeError("the timer's interrupt has failed")
        raise RuntimeError("the main loop was blocked for %d ms" % away)
