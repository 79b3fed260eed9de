# mypy: disable-error-code=arg-type
"""Supervisor: stops the machine where the main loop does not turn any more.

Whatever waits reads the link, so a link that is not read is a main loop that hangs. A timer,
hard where the chip has such, counts for how long; past the limit tools go off and motors stop, at
every beat, until the loop is back, where an exception then tells of it. Where it never comes
back the watchdog ends it, which is fed here, as long as the link is read.

A write to flash, and one to a host that does not read, may take longer: they say so first.
"""

import sys

import micropython
from base.times import NEGATIVE
from machine import Timer
from micropython import const

from ports.link_memory import AWAY, STOPPED, TURNED

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import BoardLink, Port, StepEngine

# Beats of a hard timer, and of one that goes through MicroPython's queue of 8, not to fill it.
_HARD_MS = const(5)
_SOFT_MS = const(50)
_SOFT_TIMER = const(3)  # 0 is the engine's, 1 and 2 the port's

_FAILED = const(-1)
_CTRL_X = const(24)


class Supervisor:
    """Watches over a link, an engine and a port. limit_ms: how long the main loop may be away."""

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
        self._last_ms = 0  # when a soft beat came
        self._timer = Timer(-1 if hard else _SOFT_TIMER)

    def start(self, feed: "Callable[[], None] | None", on_reset: "Callable[[int], None]") -> None:
        """Watch from now on. feed: the watchdog's; on_reset: hears of a Ctrl-X that came while the
        main loop does not listen, in the interrupt, when tool and motors have been stopped, with
        no alarm (0)."""
        self._feed = feed
        self._on_reset = on_reset
        self.allow(0)
        hard = self._beat_ms == _HARD_MS
        beat = self._beat if hard else self._soft_beat
        self._timer.init(period=self._beat_ms, callback=beat, hard=hard)

    def close(self) -> None:
        """Watch no more."""
        self._timer.deinit()

    def allow(self, ms: int) -> None:
        """The main loop may be away for so much longer, this time."""
        self._shared[AWAY] = -ms

    def _soft_beat(self, timer: object) -> None:
        """Those that have waited while flash was written come all at once, and are one."""
        if self._port.elapsed_ms(self._last_ms) >= _SOFT_MS // 2:
            self._last_ms = self._port.ticks_ms()
            self._beat(timer)

    @micropython.viper
    def _beat(self, _timer: object) -> int:
        """Interrupt. Catches all, for MicroPython would not call it again.

        Kernel and all: as bytecode it took twice the time, at every beat.
        """
        shared = ptr32(self._shared)
        stops = 0
        resets = 0
        try:
            if shared[TURNED]:
                shared[TURNED] = 0
                shared[AWAY] = 0
            else:
                shared[AWAY] += int(self._beat_ms)
                if shared[AWAY] == 0:
                    shared[AWAY] = 1  # it has been away for all of what it was allowed
            if shared[AWAY] & NEGATIVE == 0 and shared[AWAY] >= int(self._limit_ms):
                stops = 1
                shared[STOPPED] = shared[AWAY]
            else:
                if shared[AWAY] == 0 and self._feed:
                    self._feed()
                if self._poll_reset:
                    resets = int(self._poll_reset())
        except:  # noqa: E722
            stops = 1
            shared[STOPPED] = _FAILED
        if stops or resets:
            try:
                self._kill()
            except:  # noqa: E722
                shared[STOPPED] = _FAILED
            try:
                self._stop()
            except:  # noqa: E722
                shared[STOPPED] = _FAILED
        if resets:
            try:
                self._on_reset(0)
            except:  # noqa: E722
                shared[STOPPED] = _FAILED
        if stops:
            micropython.kbd_intr(_CTRL_X)  # which ends what does not come back by itself
        return 0

    def end_absence(self) -> int:
        """The main loop is back. Returns for how long it was away, in ms, if the machine has been
        stopped for that."""
        self._shared[TURNED] = 1
        micropython.kbd_intr(-1)
        away = self._shared[STOPPED]
        self._shared[STOPPED] = 0
        return away

    def raise_if_stopped(self) -> None:
        """The main loop is back. Raises RuntimeError, which says why the machine was stopped."""
        away = self.end_absence()
        if away == _FAILED:
            raise RuntimeError("the timer's interrupt has failed")
        raise RuntimeError("the main loop was away for %d ms" % away)
