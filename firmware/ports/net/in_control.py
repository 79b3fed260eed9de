"""Who is in control: whose lines the machine does, and who hears what it answers.

A read-only line neither takes nor keeps control. Its client borrows the machine after the owner's
lines are done, and gives it back after the answer.
"""

import time

from micropython import const

from ports.net.access import MSG_TAKEN

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from ports.net.client import Client

_SILENT_MS = const(5000)


class Control:
    """owner: the client in control, driver: whose lines the machine is handed. They differ while
    one borrows it; None: nobody. hears: who gets the answers. ending: lines of another driver are
    not done yet, and this one's wait."""

    def __init__(self, user: "Client") -> None:
        self.owner: "Client | None" = user
        self.driver: "Client | None" = user
        self.receiver: "Client | None" = user
        self.ending = False
        # Forget the line that has begun; and whether there is one.
        self.drop_half: "Callable[[], None]" = lambda: None
        self.has_half: "Callable[[], bool]" = lambda: False
        self._reads = 0  # lines of the borrower without an answer yet

    def is_borrowed(self) -> bool:
        """The owner's lines wait."""
        return self.driver is not self.owner

    def set(self, owner: "Client | None") -> None:
        """Nobody's lines are under way."""
        self.owner = self.driver = owner
        self.receiver = owner or self.receiver

    def request(self, client: "Client", at_rest: bool, reads: bool, now_ms: int) -> bool:
        """Let a client that is not in control have the machine, if that may be; reads: for a line
        that only reads."""
        if reads and client is self.driver:
            self._reads += 1
            return True
        if not self._is_free(client, at_rest, now_ms):
            return False
        if not reads:
            self._transfer_control(client)
        elif self.is_borrowed() or self.has_half():
            return False
        else:
            self.driver, self._reads = client, 1
            self.ending = True
        return True

    def _is_free(self, client: "Client", at_rest: bool, now_ms: int) -> bool:
        owner = self.owner
        if not client.trusted:
            return owner is self.driver is None and at_rest and client.may_hear()
        if owner is None or owner.is_gone(now_ms):
            return True
        return at_rest and self.is_silent(owner, now_ms)

    @staticmethod
    def is_silent(client: "Client", now_ms: int) -> bool:
        """It has sent nothing for a while that does more than read."""
        return time.ticks_diff(now_ms, client.spoke_ms) >= _SILENT_MS

    def _transfer_control(self, owner: "Client | None") -> None:
        """Another is in control from now on, or nobody."""
        before = self.owner
        if not self.is_borrowed():
            self._hand_over(owner)
        self.owner = owner
        if before and before.conn:
            before.forget()
            before.put(MSG_TAKEN)

    def _hand_over(self, driver: "Client | None") -> None:
        """Lines of another come now, and those before it are nobody's."""
        self.driver, self.receiver = driver, None
        self.ending = True
        self.drop_half()

    def on_client_gone(self, client: "Client") -> bool:
        """A client has gone. Returns whether it was in control."""
        was_owner = client is self.owner
        if was_owner:
            self._transfer_control(None)
        elif client is self.driver:
            self._hand_over(self.owner)
        if client is self.receiver:
            self.receiver = None
        return was_owner

    def done(self) -> None:
        """Lines of the driver before are all done and answered."""
        self.ending = False
        self.receiver = self.driver

    def answered(self) -> None:
        """A line has got its ok or its error."""
        if self.is_borrowed() and not self.ending:
            self._reads -= 1
            if self._reads == 0:
                self.give_back()

    def give_back(self) -> None:
        """The owner's lines are the machine's again."""
        self.driver = self.receiver = self.owner
