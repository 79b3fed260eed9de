"""The simulator's link to a real sender: its clock follows wall time, or runs ahead of it.

A wire is a pty or a pair of pipes, see tools/run/pty_link.py: read(limit) returns what is
available at once, write(data) loses what is not accepted, wait(seconds) returns when bytes have
arrived or the time is over, and `closed` means that no more bytes will arrive.
"""

from collections.abc import Callable
from time import monotonic
from typing import TYPE_CHECKING, Protocol

from .machine import UntimedLink

if TYPE_CHECKING:
    from ..sim.rig import Rig

# Reads without data before the firmware is assumed to wait for the machine. It reads the line more
# than once between two blocks, and these reads take no time.
_IDLE_READS = 3
_RESET = 0x18  # the reset itself causes a welcome
# Bytes and number of pieces to drop: enough to hold all that a board would have received.
_PIECE = 64
_PIECES = 16
# How long the machine waits, in wall time, for a sender that could keep it busy.
_PATIENCE_S = 0.01
_IDLE_S = 0.02  # wait for the sender while the machine is idle
_MOVING_S = 0.001  # and while it works
# Between two turns of the firmware's loop motion never advances further, however long the computer
# was busy: homing finds its switches where a board does.
_LONGEST_ADVANCE_S = 0.002


def _nothing() -> None:
    """Do nothing."""


class Wire(Protocol):
    """The connection to the sender."""

    closed: bool
    on_open: Callable[[], None]  # called in read() when a sender has connected

    def read(self, limit: int) -> bytes:
        """Return received bytes; b"" if there are none."""

    def write(self, data: bytes) -> None:
        """Send bytes; those that cannot be sent are lost."""

    def wait(self, seconds: float) -> None:
        """Wait until bytes arrive, at most for that time."""


class LiveLink(UntimedLink):
    """A Link on a wire. fast: virtual time jumps ahead while the machine works or waits.

    When there is nothing to do, the clock follows wall time, so an idle machine does not run
    ahead.
    """

    def __init__(self, rig: "Rig", wire: Wire, fast: bool) -> None:
        self._rig = rig
        self._wire = wire
        self._fast = fast
        self.turn: Callable[[], None] = _nothing  # called whenever the firmware reads
        self.stopping = False  # set, also by a signal handler, to end the simulation
        self._greeted = False  # the first banner was sent; nothing is read before
        self._is_new_sender = False  # a sender has connected and has not been greeted
        wire.on_open = self._open
        self._idle_reads = 0  # reads without data since the last byte
        self._open_lines = 0  # received lines that have not been answered
        # Wall time of the last byte in either direction, and up to which the machine has followed.
        self._last_byte_s = monotonic()
        self._followed_s = self._last_byte_s
        self._lags = False  # motion is later than wall time

    # The Link interface

    def read_into(self, buf: bytearray) -> int:
        """Return received bytes; if there are none, time passes."""
        if self.stopping:
            self._rig.power_off()
        self.turn()
        if self._rig.inputs:
            self._rig.inputs.advance()
        if not self._fast:
            self._follow_wall()
        data = self._wire.read(len(buf)) if self._greeted else b""
        if self._is_new_sender and _RESET not in data:
            self._is_new_sender = False
            # The lines of the sender before are still to be answered, because this is no reset;
            # but write() forgets them when it sends a welcome.
            open_lines = self._open_lines
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
        """Drop what was received; a sender may continue to send."""
        for _ in range(_PIECES):
            self._wire.read(_PIECE)

    def write(self, data: "bytes | bytearray | memoryview") -> None:
        """Send to the connected sender."""
        out = bytes(data)
        answers = out.count(b"ok\r\n") + out.count(b"error:")
        self._open_lines = max(self._open_lines - answers, 0)
        if b"\nGrbl" in out:  # the welcome
            self._greeted, self._is_new_sender = True, False
            self._open_lines = 0
        self._wire.write(out)
        self._touch()

    def _open(self) -> None:
        self._is_new_sender = True

    # Time

    def busy(self) -> bool:
        """Return whether the machine works, or will continue without further bytes from its
        sender."""
        from base import state

        if self._rig.moving():
            return True
        machine = self._rig.controller.state
        if machine.run & (state.HOLD | state.DOOR | state.ALARM | state.SLEEP):
            return False
        return self._open_lines > 0 or not self._rig.controller.planner.empty()

    def _touch(self) -> None:
        """Note that bytes were sent or received now."""
        self._idle_reads = 0
        self._last_byte_s = monotonic()

    def _pass_time(self) -> None:
        """Wait for the sender, or let virtual time jump ahead."""
        if self._lags:
            return  # there is no time to wait
        busy = self.busy()
        if not self._fast:
            self._wire.wait(_MOVING_S if busy else _IDLE_S)
        elif not busy:
            self._wire.wait(_IDLE_S)
            self._follow_wall()
        else:
            self._jump_ahead()

    def _jump_ahead(self) -> None:
        """Let virtual time jump to the next event of motion, after some reads of the firmware and
        a chance for the sender to send."""
        self._idle_reads += 1
        if self._idle_reads <= _IDLE_READS:
            return
        patience_s = self._last_byte_s + _PATIENCE_S - monotonic()
        if self._open_lines == 0 and not self._wire.closed and patience_s > 0:
            self._wire.wait(patience_s)
            return
        self._rig.skip()
        self._followed_s = monotonic()

    def _follow_wall(self) -> None:
        """Advance the machine's time to wall time; during motion by _LONGEST_ADVANCE_S at most,
        and then it lags."""
        now = monotonic()
        if self._rig.moving():
            passed_s = min(now - self._followed_s, _LONGEST_ADVANCE_S)
            self._followed_s += passed_s
            self._lags = self._followed_s < now
        else:  # motion that lags behind does not catch up
            passed_s = 0.0 if self._lags else now - self._followed_s
            self._followed_s = now
            self._lags = False
        self._rig.engine.advance(self._rig.ms(passed_s * 1000))
