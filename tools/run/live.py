"""The simulator's link to the world outside: the clock is the wall's, or runs ahead of it.

A wire is a pty or a pair of pipes, see tools/run/pty_link.py: read(limit) gives
what is there at once, write(data) loses what nobody takes, wait(seconds)
returns when bytes have come or the time is over, `closed` says that no more
will ever come.
"""

from collections.abc import Callable
from time import monotonic
from typing import TYPE_CHECKING, Protocol

from .machine import UntimedLink

if TYPE_CHECKING:
    from ..sim.rig import Rig

# Reads that may find nothing before the firmware is taken to wait for the machine. It looks at
# the line more than once between two blocks, and none of these looks takes time.
_LOOKS = 3
_PIECE = 64
_RESET = 0x18  # it greets by itself
_PIECES = 16  # hold all that a board would have taken
# How long, by the wall's clock, the machine waits for a sender that could keep it busy.
_PATIENCE_S = 0.01
_AT_REST_S = 0.02
_MOVING_S = 0.001
# Motion goes no further between two looks of the firmware at its inputs, however long the computer
# was busy with something else: homing finds its switches where a board does.
_UNSEEN_S = 0.002


def _nothing() -> None:
    """Where nobody has to be told."""


class Wire(Protocol):
    """Where the sender is."""

    closed: bool
    on_open: Callable[[], None]  # called in read(), where a sender has come

    def read(self, limit: int) -> bytes:
        """What has come, perhaps nothing."""

    def write(self, data: bytes) -> None:
        """Send, or lose what cannot be sent."""

    def wait(self, seconds: float) -> None:
        """Sleep until something comes, so long at the most."""


class LiveLink(UntimedLink):
    """A Link on a wire. fast: virtual time leaps ahead wherever the machine works or waits.

    With nothing to do the clock follows the wall's, so that a machine at rest rests in real time.
    """

    def __init__(self, rig: "Rig", wire: Wire, fast: bool) -> None:
        self._rig = rig
        self._wire = wire
        self._fast = fast
        self.turn: Callable[[], None] = _nothing  # called whenever the firmware reads
        self.stopping = False  # set, from a signal handler too, to end the simulation
        self._greeted = False  # with the first banner; nothing is heard before
        self._has_opened = False  # a sender, that has not been greeted yet
        wire.on_open = self._open
        self._looks = 0
        self._open_lines = 0  # received, and not yet answered
        self._heard = monotonic()  # when the sender or we have last said something
        self._wall = self._heard
        self._late = False  # motion is behind the wall's clock

    # The Link seam

    def read_into(self, buf: bytearray) -> int:
        """What has come; time passes where nothing has."""
        if self.stopping:
            self._rig.power_off()
        self.turn()
        if self._rig.inputs:
            self._rig.inputs.advance()
        if not self._fast:
            self._follow_wall()
        data = self._wire.read(len(buf)) if self._greeted else b""
        if self._has_opened and _RESET not in data:
            self._has_opened = False
            open_lines = self._open_lines  # of the sender before: no reset has dropped them
            self._rig.controller.welcome()
            self._open_lines = open_lines
        if not data:
            if self._wire.closed and not self.busy():
                self._rig.power_off()
            self._pass_time()
            return 0
        buf[: len(data)] = data
        self._open_lines += data.count(b"\n") + data.count(b"\r")
        self._touch()
        return len(data)

    def discard(self) -> None:
        """Drop what has come; a sender may go on sending."""
        for _ in range(_PIECES):
            self._wire.read(_PIECE)

    def write(self, data: "bytes | bytearray | memoryview") -> None:
        """Send to whoever is there."""
        out = bytes(data)
        answers = out.count(b"ok\r\n") + out.count(b"error:")
        self._open_lines = max(self._open_lines - answers, 0)
        if b"\nGrbl" in out:
            self._greeted, self._has_opened = True, False
            self._open_lines = 0
        self._wire.write(out)
        self._touch()

    def _open(self) -> None:
        self._has_opened = True

    # Time

    def busy(self) -> bool:
        """The machine is at work, or will be without a further word from its sender."""
        from base import state

        if self._rig.moving():
            return True
        present = self._rig.controller.state
        if present.run & (state.HOLD | state.DOOR | state.ALARM | state.SLEEP):
            return False
        return self._open_lines > 0 or not self._rig.controller.planner.empty()

    def _touch(self) -> None:
        self._looks = 0
        self._heard = monotonic()

    def _pass_time(self) -> None:
        if self._late:
            return
        busy = self.busy()
        if not self._fast:
            self._wire.wait(_MOVING_S if busy else _AT_REST_S)
        elif not busy:
            self._wire.wait(_AT_REST_S)
            self._follow_wall()
        else:
            self._leap()

    def _leap(self) -> None:
        """Motion goes on, once the firmware has had its looks and the sender its chance."""
        self._looks += 1
        if self._looks <= _LOOKS:
            return
        left = self._heard + _PATIENCE_S - monotonic()
        if self._open_lines == 0 and not self._wire.closed and left > 0:
            self._wire.wait(left)
            return
        self._rig.skip()
        self._wall = monotonic()

    def _follow_wall(self) -> None:
        now = monotonic()
        if self._rig.moving():
            passed = min(now - self._wall, _UNSEEN_S)
            self._wall += passed
            self._late = self._wall < now
        else:  # what a motion has not caught up with is not made good
            passed = 0.0 if self._late else now - self._wall
            self._wall = now
            self._late = False
        self._rig.engine.advance(self._rig.ms(passed * 1000))
