"""The sender at the cable or on the network: one client is in control, the others watch.

It is put around the cable's link, and keeps that link's way to the prompt. Bytes of the client in
control pass unchecked; each byte of the other clients is checked.

| client | lines | `!`, Ctrl-X, door, jog cancel | `~`, overrides | place, if another needs it |
| --- | --- | --- | --- | --- |
| at the cable, or with the key | take control, if it is free | act | as lines | 10 min |
| without the key | read-only, while idle, if no client is in control | none | none | 0.25 s |

Control is free if no client has it; if its client has gone (a network client silent for 3 s); or
while idle if its client has sent no line for 5 s. Read-only lines neither take nor keep control:
they borrow it. `?` is answered to the client that sends it. The key is sent as `$NET/KEY=...` on
each connection. client.py limits the memory that clients use.
"""

import time

import micropython
from base import errors
from micropython import const

from ports.link_memory import DISCARD_PIECES
from ports.net.access import OK, READ_ONLY_LINES, REFUSED, TAKEN, Access, is_browser, plain
from ports.net.client import Client, Memory, is_for_all, slot_for
from ports.net.in_control import Control

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import BoardLink, Connection, Incoming, Radio

_MOST_CLIENTS = const(3)  # clients on the network at once
_PIECE = const(64)  # bytes of one read whose bytes are checked
_URGENT = const(16)  # real-time bytes that may wait
_SERVE_MS = const(10)  # between two rounds of the clients
_RADIO_MS = const(1000)  # between two checks of the radio
_UPPER = const(0x80)  # bytes from here on are real-time commands

_JOG_CANCEL = const(0x85)  # a real-time byte
_FIRST_OF_ANSWER = b"oe"  # the first letters of ok and error:
_FIRST_OF_REPORT = const(0x3C)  # < of a status report


class NetLink:
    """A Link. cable: the cable's link. calls: new connections, None without a network. memory: of
    lwIP, for all clients. on_poll: as UartLink's. _cable_client: the client at the cable;
    _clients: the places of network clients, free if conn is None; _all: both. control.owner is the
    client in control, control.driver the one whose lines are executed. _is_plain: only the cable
    is used, its bytes pass unchecked; _cable_client.asked then says that some did since the last
    _serve_clients(). _cable_never_used: they never did, so a network client need not wait for
    control. _piece: bytes just read, unchecked. _urgent: real-time bytes that pass before all
    lines, _urgent_count of them. _serve_ms, _radio_ms: when clients and radio were served last."""

    def __init__(
        self, cable: "BoardLink", calls: "Incoming | None", memory: "Memory | None" = None
    ) -> None:
        self._cable = cable
        self._calls = calls
        self.shared = cable.shared
        self.poll_reset = cable.poll_reset
        self.is_slow = cable.is_slow
        self.check_supervisor: "Callable[[], None]" = lambda: None
        self.on_poll: "Callable[[], None] | None" = None
        # The greeting; bytes that ask for a report; real-time bytes below 0x80; stops.
        self.welcome = b"\r\nGrbl 1.1h ['$' for help]\r\n"
        self.questions = b"?"
        self.realtime = b"\x18!~"  # Ctrl-X, feed hold, cycle start
        self.stops = b"\x18!\x84\x85"  # Ctrl-X, feed hold, door, jog cancel
        self.access = Access()
        # radio: polled once a second; status: returns its state.
        self.radio: "Radio | None" = None
        self.status: "Callable[[], str]" = lambda: "no network is set up"
        self._at_rest: "Callable[[], bool]" = lambda: True
        self._read_cable = cable.read_into
        self._write_to_cable = cable.write
        self._memory = memory or Memory()
        self._cable_client = Client(self._memory, 0)  # its output is not queued
        self._cable_client.trusted = True
        self._clients = [Client(self._memory) for _ in range(_MOST_CLIENTS)]
        self._all = [self._cable_client] + self._clients
        self.control = Control(self._cable_client)
        self._is_plain = True
        self._cable_never_used = True
        self._piece = bytearray(_PIECE)
        self._urgent = bytearray(_URGENT)
        self._urgent_count = 0
        self._serve_ms = self._radio_ms = time.ticks_ms()

    # The Link interface

    def attach(self, at_rest: "Callable[[], bool]", on_open: "Callable[[], None]") -> None:
        """Set when the prompt may be requested, and what greets a sender at the cable."""
        self._at_rest = at_rest
        cable = self._cable
        cable.check_supervisor = self.check_supervisor
        if self.on_poll:
            cable.on_poll = self.on_poll  # type: ignore[attr-defined]  # UartLink's

        def greet() -> None:
            is_plain, self._is_plain = self._is_plain, True  # greet only the cable's client
            on_open()
            self._is_plain = is_plain

        cable.attach(at_rest, greet)

    @micropython.native
    def read_into(self, buf: bytearray) -> int:
        """Move the bytes received into buf; return how many."""
        if self._is_plain:
            count = self._read_cable(buf)
            if count:
                self._cable_client.asked = True
                return count
        now_ms = time.ticks_ms()
        if time.ticks_diff(now_ms, self._serve_ms) >= _SERVE_MS:
            self._serve_ms = now_ms
            self._serve_clients(now_ms)
        return 0 if self._is_plain else self._fill_for_machine(buf, now_ms)

    def write(self, data: "bytes | bytearray | memoryview") -> None:
        """Send output to the clients it is for: see _distribute()."""
        if self._is_plain:
            self._write_to_cable(data)
        elif len(data):
            self._distribute(data)

    def discard(self) -> None:
        """Drop the bytes received before a reset, also those still in the connection."""
        self._cable.discard()
        self.forget_lines()
        driver = self.control.driver
        if driver:
            for _ in range(DISCARD_PIECES if driver.conn else 0):
                driver.read(self._piece)
        self._urgent_count = 0

    def close(self) -> None:
        """Leave the cable to MicroPython's prompt; end all network connections."""
        for client in self._clients:
            client.end()
        if self._calls:
            self._calls.close()
            self._calls = None
        self.control.set(self._cable_client)
        self._is_plain = True
        self._cable.close()

    # For extras/net/net_access.py

    def forget_lines(self) -> None:
        """Drop what was received before a reset and waits here, as the machine drops what it was
        passed. A loan of the machine ends: the borrower's lines are never answered."""
        self.control.give_back()
        for client in self._all:
            client.forget()

    def expel(self) -> None:
        """Close all network connections, because the key has changed."""
        for client in self._clients:
            if client.conn:
                self._drop(client)

    def by_cable(self) -> bool:
        """Return whether the client whose lines are executed is at the cable."""
        return self.control.driver is self._cable_client and not self.control.ending

    def answer(self, data: bytes) -> None:
        """Send output only to the client whose line is executed, unlike _distribute()."""
        if self.control.receiver:
            self._send(self.control.receiver, data)

    def write_cable(self, data: bytes) -> None:
        """Send output that only the cable's client may read."""
        self._write_to_cable(data)

    def client_count(self) -> int:
        """Return how many network clients are connected."""
        return len([1 for client in self._clients if client.conn])

    def _restore_plain(self) -> None:
        """Let the cable's bytes pass unchecked again (_is_plain), if no network client is left. If
        none is in control then, the cable's client is."""
        control, cable_client = self.control, self._cable_client
        if not control.ending and not self.client_count():
            if control.driver is None:
                control.set(cable_client)
                self._cable_never_used = True  # as at the start
            if self._passes_unchecked(cable_client) and not self._urgent_count:
                self._is_plain = True
                cable_client.asked = False  # it has its other meaning now: see NetLink

    def _passes_unchecked(self, client: Client) -> bool:
        """Return whether a client's bytes pass to the machine unchecked."""
        control = self.control
        is_owner = client is control.driver is control.owner
        return is_owner and client.trusted and not (control.ending or client.length)

    def _fill_for_machine(self, buf: bytearray, now_ms: int) -> int:
        """Fill buf for the machine, and return how many bytes: queued real-time commands; else
        what the client in control sends unchecked; else stored lines of control.driver."""
        count, self._urgent_count = self._urgent_count, 0
        if count:
            buf[:count] = self._urgent[:count]
            return count
        control, cable_client = self.control, self._cable_client
        count = self._read_cable(buf)
        driver = control.driver
        if count:
            if self._passes_unchecked(cable_client):
                return control.note_unchecked(cable_client, buf, count, now_ms)
            self._filter_bytes(cable_client, buf, count, now_ms)
        elif driver and driver.conn:
            count = self._read_driver(driver, buf, now_ms)
            if count:
                return count
        driver = control.driver  # it may be another one now
        if driver and not (control.ending or self._urgent_count):
            if driver is control.owner and not driver.is_too_long:
                driver.ready = driver.length  # its bytes need not wait for a line's end
            if driver.ready:
                return driver.move_lines(buf)
        return 0

    def _read_driver(self, driver: Client, buf: bytearray, now_ms: int) -> int:
        """Read the network client whose lines are executed. Returns how many bytes were put into
        buf; 0 if there are none, or if each is checked and stored first."""
        unchecked = self._passes_unchecked(driver)
        if not unchecked and not driver.may_read():
            return 0
        piece = buf if unchecked else self._piece
        count = driver.read(piece)
        if count < 0:
            self._drop(driver)
        elif count:
            driver.note_received(now_ms)
            if unchecked:
                return self.control.note_unchecked(driver, buf, count, now_ms)
            self._filter_bytes(driver, piece, count, now_ms)
        elif not driver.send():  # its connection has failed
            self._drop(driver)
        return 0

    def _serve_clients(self, now_ms: int) -> None:
        """Serve the network clients (control.driver is read elsewhere); accept a connection."""
        self._memory.forget(now_ms)
        if self._is_plain and self._cable_client.asked:  # the cable has sent something
            self._cable_client.asked = self._cable_never_used = False
            self._cable_client.last_line_ms = now_ms
        for client in self._clients:
            if not client.conn:
                continue
            if client is not self.control.driver:
                count = client.read(self._piece)
                if count < 0:
                    self._drop(client)
                    continue
                if count:
                    client.note_received(now_ms)
                    self._filter_bytes(client, self._piece, count, now_ms)
            if not client.send():
                self._drop(client)
        new = self._calls.next() if self._calls else None
        if new:
            conn, address = new
            self._accept(conn, address, now_ms)
        if self.radio and time.ticks_diff(now_ms, self._radio_ms) >= _RADIO_MS:
            self._radio_ms = now_ms
            self.radio.poll_radio(self._at_rest())
        if not self._is_plain:
            self._restore_plain()

    def _accept(self, conn: "Connection", address: str, now_ms: int) -> None:
        """Give a new connection a place, which may be another's, and greet it; or close it."""
        place = slot_for(address, self._clients, self._at_rest(), now_ms)
        if place is None:
            conn.close()
            return
        if place.conn:
            self._drop(place)
        if self._is_plain:  # the first network client
            self._is_plain = False
            control = self.control
            is_silent = control.is_silent(self._cable_client, now_ms)
            is_unused = is_silent and not control.has_partial_line() and self._at_rest()
            if self._cable_never_used or is_unused:
                control.set(None)  # the cable's client is no longer in control
        place.begin(conn, address, now_ms)
        place.put(self.welcome)
        if not place.send():
            self._drop(place)

    def _drop(self, client: Client) -> None:
        """Close a connection. If the client was in control, a jog ends and an unfinished line is
        dropped."""
        client.end()
        if self.control.on_client_gone(client):
            self._queue_realtime(_JOG_CANCEL)

    def _filter_bytes(self, client: Client, data: bytearray, count: int, now_ms: int) -> None:
        """Check each byte: queue real-time commands, store lines, close a browser's connection."""
        for i in range(count):
            byte = data[i]
            if byte in self.questions:
                if client.trusted or client.can_be_answered():
                    client.asked = True
                    self._queue_realtime(byte)
            elif byte >= _UPPER or byte in self.realtime:
                if self._may_act(client, byte, now_ms):
                    self._queue_realtime(byte)
            elif byte in b"\r\n":
                self._end_line(client, byte, now_ms)
            else:
                client.keep(byte)
                if client is not self.control.owner and is_browser(client.received, client.length):
                    self._drop(client)
            if not client.conn and client is not self._cable_client:  # it was dropped
                return

    def _may_act(self, client: Client, byte: int, now_ms: int) -> bool:
        """Return whether a client's real-time command acts: a stop from any client with the key,
        others only in control, which the client gets here if that is allowed."""
        if not client.trusted:
            return False
        acts = client is self.control.owner or byte in self.stops
        return acts or self._request_control(client, reads=False, now_ms=now_ms)

    def _request_control(self, client: Client, reads: bool, now_ms: int) -> bool:
        """Give the machine to a client, if allowed; return whether. reads: its line only reads."""
        return self.control.request(client, self._at_rest(), reads, now_ms)

    def _queue_realtime(self, byte: int) -> None:
        """Queue a real-time byte, to be passed before all lines. A stop always finds space."""
        count = self._urgent_count
        if byte in bytes(self._urgent[:count]):  # queued already
            return
        if count == _URGENT and byte in self.stops:
            count -= 1  # it replaces the last one
        if count < _URGENT:
            self._urgent[count] = byte
            self._urgent_count = count + 1

    def _end_line(self, client: Client, byte: int, now_ms: int) -> None:
        """End a client's line by CR or LF (byte). A line not for the machine is answered here: by
        ok if empty, by the key's check, or by a refusal, as one whose bytes did not all fit."""
        if client is self.control.owner and not client.is_too_long:
            client.end_line(byte, now_ms)
            return
        start = client.ready  # of this line; those before it wait already
        line = plain(client.received[start : client.length])
        reads = line in READ_ONLY_LINES
        answer = b""
        if client.is_too_long:
            answer = REFUSED % errors.OVERFLOW
        elif client is not self._cable_client:
            answer = self.access.answer(client, line)
        if not answer and not line:
            answer = OK
        elif not answer and not self._request_control(client, reads, now_ms):
            answer = TAKEN
        if not answer:
            client.end_line(byte, now_ms)
            return
        client.length = start  # drop the line, which is answered here
        client.is_too_long = False
        self._send(client, answer)
        if not client.tries:
            self._drop(client)

    def _distribute(self, data: "bytes | bytearray | memoryview") -> None:
        """Send a report to those that asked; alarms, messages, banner to all; an answer to one."""
        control, first = self.control, data[0]
        if first == _FIRST_OF_REPORT:
            self._report(data)
        elif is_for_all(data):
            self._write_to_cable(data)
            for client in self._clients:
                if client.conn:
                    self._send(client, data)
        elif control.receiver:
            self._send(control.receiver, data)
            if first in _FIRST_OF_ANSWER:
                control.answered()

    def _report(self, data: "bytes | bytearray | memoryview") -> None:
        """Send a report to the clients that requested one; to the one in control if none did."""
        asking = [client for client in self._all if client.asked]
        if not asking and self.control.owner:
            asking.append(self.control.owner)
        for client in asking:
            client.asked = False
            self._send(client, data)

    def _send(self, client: Client, data: "bytes | bytearray | memoryview") -> None:
        """Send to one client; one on the network that reads too slowly is dropped."""
        if client is self._cable_client:
            self._write_to_cable(data)
        elif client.conn and not client.put(data):
            self._drop(client)
