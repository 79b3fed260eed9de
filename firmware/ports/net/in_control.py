"""Control: the client whose lines the machine executes, and the client that gets the answers.

A read-only line neither takes nor keeps control. Its client borrows the machine once the owner's
lines are executed, and returns it after the answer.
"""

import time

from micropython import const

from ports.net.access import MSG_TAKEN, READ_ONLY_LINES, plain
from ports.net.client import asks

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from ports.net.client import Client

_LONGEST_READ_ONLY = const(8)  # longest read-only line, in bytes
_SILENT_MS = const(5000)  # without a line that does more than read


class Control:
    """Who controls the machine. owner: the client in control; driver: the client whose lines are
    passed to the machine; they differ while a client borrows it; None: no client. receiver: the
    client that gets the answers. ending: lines of the previous driver are not all executed
    yet, and this one's wait. _unanswered_reads: lines of the borrower that have no answer yet.
    user: the client at the cable, which is in control at first."""

    def __init__(self, user: "Client") -> None:
        self.owner: "Client | None" = user
        self.driver: "Client | None" = user
        self.receiver: "Client | None" = user
        self.ending = False
        # Drop the driver's unfinished line in the reader; and whether there is one.
        self.drop_partial_line: "Callable[[], None]" = lambda: None
        self.has_partial_line: "Callable[[], bool]" = lambda: False
        self._unanswered_reads = 0

    def is_borrowed(self) -> bool:
        """Return whether the owner's lines wait for a borrower's."""
        return self.driver is not self.owner

    def set(self, owner: "Client | None") -> None:
        """Set the client in control; no lines are being executed."""
        self.owner = self.driver = owner
        self.receiver = owner or self.receiver

    def request(self, client: "Client", at_rest: bool, reads: bool, now_ms: int) -> bool:
        """Give the machine to a client that is not in control, if that is allowed. Returns
        whether. at_rest: the machine is idle. reads: its line only reads, so the machine is only
        lent: not while another borrows it, nor in the middle of a line."""
        if reads and client is self.driver:  # it borrows the machine already: its next line
            self._unanswered_reads += 1
            return True
        if not self._is_free(client, at_rest, now_ms):
            return False
        if not reads:
            self._transfer_control(client)
        elif self.is_borrowed() or self.has_partial_line():
            return False
        else:
            self.driver, self._unanswered_reads = client, 1  # lend the machine
            self.ending = True  # the owner's lines are executed first: see done()
        return True

    def _is_free(self, client: "Client", at_rest: bool, now_ms: int) -> bool:
        """Return whether this client may get the machine. at_rest: the machine is idle.

        Without the key: while idle, if no client is in control, and if there is memory to answer
        it. With it: if no client is in control, or that one has gone, or it is silent while idle.
        """
        owner = self.owner
        if not client.trusted:
            nobody_drives = owner is None and self.driver is None
            return nobody_drives and at_rest and client.can_be_answered()
        if owner is None or owner.is_gone(now_ms):
            return True
        return at_rest and self.is_silent(owner, now_ms)

    @staticmethod
    def note_unchecked(driver: "Client", buf: bytearray, count: int, now_ms: int) -> int:
        """Note two things about input (`count` bytes of buf) that then passes unchecked: a request
        for a report (?); and the time (last_line_ms), by which its client keeps control, if it is
        more than one read-only line. Returns count, for the caller to return."""
        if asks(buf, count):
            driver.asked = True
        # plain() drops ? and line ends: a lone ? becomes b"", which READ_ONLY_LINES contains.
        if count > _LONGEST_READ_ONLY or plain(buf[:count]) not in READ_ONLY_LINES:
            driver.last_line_ms = now_ms
        return count

    @staticmethod
    def is_silent(client: "Client", now_ms: int) -> bool:
        """Return whether the client has sent no line but read-only ones for _SILENT_MS."""
        return time.ticks_diff(now_ms, client.last_line_ms) >= _SILENT_MS

    def _transfer_control(self, owner: "Client | None") -> None:
        """Give control to another client, or to none, and notify the one that loses it. While the
        machine is borrowed, the borrower's lines are finished first."""
        old_owner = self.owner
        if not self.is_borrowed():
            self._hand_over(owner)
        self.owner = owner
        if old_owner:
            old_owner.forget()  # its lines that wait
            if old_owner.conn:
                old_owner.put(MSG_TAKEN)

    def _hand_over(self, driver: "Client | None") -> None:
        """Switch to another client's lines. Those before are still executed (ending, until
        done()); their answers have no receiver."""
        self.driver, self.receiver = driver, None
        self.ending = True
        self.drop_partial_line()

    def on_client_gone(self, client: "Client") -> bool:
        """Handle that a client has gone. Returns whether it was in control."""
        was_owner = client is self.owner
        if was_owner:
            self._transfer_control(None)
        elif client is self.driver:  # a borrower: control returns to its owner
            self._hand_over(self.owner)
        if client is self.receiver:
            self.receiver = None
        return was_owner

    def done(self) -> None:
        """Note that the previous driver's lines are all executed and answered."""
        self.ending = False
        self.receiver = self.driver

    def answered(self) -> None:
        """Note that a line was answered by ok or error. After the answer to a borrower's last line
        the machine returns to the owner."""
        if self.is_borrowed() and not self.ending:
            self._unanswered_reads -= 1
            if self._unanswered_reads == 0:
                self.give_back()

    def give_back(self) -> None:
        """End a loan: the owner's lines are executed again, and it gets the answers."""
        self.driver = self.receiver = self.owner
