"""Network access: `$NET`, the key, and handover between cable and network clients.

LINK = "wifi" or "uart_wifi" in the board file selects this. Settings are accepted over the cable
only, and are written while idle. They take effect at the next start: ports/net/wifi.py reads them.
Names and passwords are written as hexadecimal digits, because a received line has neither
lower-case letters nor spaces. They are never reported. docs/network.md lists the words.
"""

import sys

from base import errors
from base import state as st
from base.errors import GrblError
from base.text import text_of
from micropython import const
from talk.lines import COMPLETE, END, HEAD, LENGTH, SKIPPING, TAIL

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array

    from interfaces import Job, NetworkLink
    from talk.lines import LineReader

    from extras.api import Cnc

_STORED_NAME = "network"  # of the values in flash
_KEY_LENGTH = const(8)  # characters
# Without letters that could form a word that senders take for an answer.
_KEY_CHARACTERS = "23456789ABCDFGHJKLMNPQRSTVWXYZ"


def has_partial_line(ring: bytearray, state: "array[int]", kinds: bytearray) -> bool:
    """Return whether the reader has an unfinished line.

    ring, state, kinds: as LineReader.memory() returns them. If the ring holds bytes, its last one
    shows it: it is no line end. If the ring is empty, a line may have been read out of it in part:
    state[LENGTH] is its length so far, and state[SKIPPING] a mask: why its bytes are dropped, or
    COMPLETE, because its end has been read.
    """
    head = state[HEAD]  # index after the last byte; ring[-1] is before index 0
    if head != state[TAIL]:
        return kinds[ring[head - 1]] != END
    return bool(state[LENGTH] or state[SKIPPING]) and not state[SKIPPING] & COMPLETE


def drop_partial_line(ring: bytearray, state: "array[int]", kinds: bytearray) -> None:
    """Drop the reader's unfinished line, and nothing before it. ring, state, kinds: as
    LineReader.memory() returns them. The bytes after the last line end are removed from the ring;
    if that leaves it empty, the part of a line that was read before is dropped, too: state[LENGTH]
    and state[SKIPPING] become 0, unless its end has been read (COMPLETE)."""
    head = state[HEAD]
    while head != state[TAIL] and kinds[ring[head - 1]] != END:
        head = (head or len(ring)) - 1  # one byte back in the ring
    state[HEAD] = head
    if head == state[TAIL] and not state[SKIPPING] & COMPLETE:
        state[LENGTH] = state[SKIPPING] = 0


class Network:
    """`$NET` and its stored values. link: None in a simulator without network. _values: by name,
    such as SSID, as text. _key_is_unsent: the key was just made, and is still to be reported.
    _previous_forget: what Hooks.forget(), called at each reset, did before."""

    def __init__(self, cnc: "Cnc", link: "NetworkLink | None") -> None:
        machine = cnc.machine
        self._cnc = cnc
        self._link = link
        self._saves = machine.saves
        self._reader: "LineReader" = machine.reader
        self._values: "dict[str, str]" = {}
        for line in machine.saves.load(_STORED_NAME) or []:
            name, _, value = line.partition("=")
            self._values[name] = value
        self._key_is_unsent = link is not None and "KEY" not in self._values
        if self._key_is_unsent:
            self._values["KEY"] = self._new_key()
            self._store()
        self._pass_key_to_link()
        if link:
            link.control.drop_partial_line = self._drop_partial_line
            link.control.has_partial_line = self._has_partial_line
            hooks = machine.state.hooks
            self._previous_forget, hooks.forget = hooks.forget, self._forget

    def _new_key(self) -> str:
        """Return a random key of _KEY_LENGTH characters: 39 bits from the chip's noise source."""
        noise = self._link.access.random_bytes(_KEY_LENGTH) if self._link else b""
        return "".join([_KEY_CHARACTERS[byte % len(_KEY_CHARACTERS)] for byte in noise])

    def _pass_key_to_link(self) -> None:
        """Pass the stored key to the link."""
        if self._link:
            self._link.access.secret = self._values["KEY"]

    def _store(self) -> None:
        """Store the values, as lines of NAME=VALUE."""
        self._saves.save(_STORED_NAME, ["%s=%s" % row for row in sorted(self._values.items())])

    # Hooks

    def _forget(self) -> None:
        """Forget the lines that wait in the link, as Hooks.forget()."""
        assert self._link
        self._link.forget_lines()
        self._previous_forget()

    def complete_handover(self) -> None:
        """Complete a requested handover of control once all lines of the client before are
        executed, or at once while a job runs. Called between two lines."""
        link = self._link
        if link and link.control.ending and (self._running_job() or not self._reader.has_line()):
            link.control.done()

    def send_new_key(self) -> None:
        """Send a new key after the welcome of the first start."""
        if self._key_is_unsent:
            self._key_is_unsent = False
            self._send_key()

    def _running_job(self) -> "Job | None":
        """Return the job that runs, or None. While it runs, the reader has its lines, and not a
        client's."""
        job = self._cnc.job  # of a board with JOBS, also while none runs
        return job if job and job.is_on() else None

    def _has_partial_line(self) -> bool:
        """Return whether the client in control has begun a line."""
        job = self._running_job()
        return job.has_partial_line() if job else has_partial_line(*self._reader_memory())

    def _drop_partial_line(self) -> None:
        """Drop the unfinished line of the client in control; in state Jog all its lines, because
        its jogs end with it."""
        job = self._running_job()
        if job:
            job.drop_partial_line()
        elif self._cnc.machine.state.run & st.JOG:
            self._reader.clear()
        else:
            drop_partial_line(*self._reader_memory())

    def _reader_memory(self) -> "tuple[bytearray, array[int], bytearray]":
        """Return the arguments of has_partial_line() and drop_partial_line()."""
        ring, state, _, kinds = self._reader.memory()
        return ring, state, kinds

    def _send_key(self) -> None:
        """Send the key over the cable only."""
        if self._link:
            line = b"[MSG:Network key: %s]\r\n" % self._values["KEY"].encode()
            self._link.write_cable(line)

    # The command

    def command(self, rest: bytes) -> None:
        """Execute $NET, or $NET/…: rest is the text after $NET; the reader drops the slash. Raises
        GrblError."""
        text, link = text_of(rest), self._link
        if not rest and link:
            # Only to the client that asks: it may be one without the key, which asks on and on.
            state = "[MSG:Network: %s; connected: %d]\r\n" % (link.status(), link.client_count())
            link.answer(state.encode())
        elif not rest:
            self._cnc.message("Network: no network is set up; connected: 0")
        elif link is None:
            self._refuse("There is no network here")
        elif not link.by_cable():
            # A network sender may send its key each time: it is ignored.
            if text != "KEY" and text[:4] != "KEY=":
                self._refuse("Network settings are changed only over the cable")
        elif text == "KEY":
            self._send_key()
        elif text == "KEY=NEW":
            self._values["KEY"] = self._new_key()
            self._pass_key_to_link()
            link.expel()  # clients that had the old one
            self._send_key()
            self._store()
        else:
            self._change(text)

    def _change(self, text: str) -> None:
        """Set a value by NAME=VALUE or a similar text; GrblError if it is wrong. The module for it
        takes 1.5 kB, so it is loaded only for this call."""
        from extras.net import net_setup

        problem = net_setup.change(self._values, text)
        del sys.modules["extras.net.net_setup"]
        sys.modules["extras.net"].__dict__.pop("net_setup", None)
        if problem:
            self._refuse(problem)
        self._store()
        self._cnc.message("Network: the change takes effect at the next start")

    def _refuse(self, why: str) -> None:
        """Send a message, and raise GrblError."""
        self._cnc.message(why)
        raise GrblError(errors.INVALID_STATEMENT)


def install(cnc: "Cnc") -> None:
    """Add `$NET` and its hooks."""
    link = cnc.machine.protocol.link
    network = Network(cnc, link if hasattr(link, "by_cable") else None)  # type: ignore[arg-type]
    cnc.before_lines(network.complete_handover)
    cnc.after_reset(network.send_new_key)
    cnc.add_command(b"NET", network.command)
