"""Serial line of the simulator: bytes take time on the wire, in both directions, in virtual
time."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .seams import Clock

# An Arduino Uno at "115200": the sender is exact, the AVR's divider gives 117647 baud.
RX_BAUD = 115200
TX_BAUD = 117647
# Bytes that the device may queue before write() waits.
_TX_QUEUE = 104
_OK = b"ok\r\n"
_BITS = 10  # of a byte on the wire, with its start and stop bits


class SimLink:
    """A Link with two virtual wires. `received` has the complete bytes that have reached the
    sender."""

    def __init__(self, rig: "Clock", rx_baud: int = RX_BAUD, tx_baud: int = TX_BAUD) -> None:
        self.received = bytearray()
        self.last_arrival = 0  # tick at which the last byte reached the sender
        self.wire_free = 0  # tick at which the last byte to the device arrives
        self._rig = rig
        self._rx_ticks = rig.engine.tick_hz * _BITS // rx_baud  # per byte
        self._tx_ticks = rig.engine.tick_hz * _BITS // tx_baud
        self._last_read = 0  # tick of the firmware's last read_into()
        # In each direction (rx: to the device) the bytes on the wire, or arrived and not read yet,
        # and the tick when the first of them arrives. The others follow, one each _rx_ticks.
        self._rx = bytearray()
        self._rx_due = 0
        self._tx = bytearray()
        self._tx_due = 0

    # The Link interface

    def read_into(self, buf: bytearray) -> int:
        """Read bytes into the buffer; return their number. If there are none, time passes until
        the next event.

        In motion, the firmware's loop takes at least loop_ticks between two reads.
        """
        loop_end = self._last_read + self._rig.loop_ticks
        if loop_end > self._rig.now and self._rig.moving():
            self._rig.pass_time(loop_end)
        count = self._arrived(len(buf))
        if count == 0:
            self._rig.wait()
            count = self._arrived(len(buf))
        self._last_read = self._rig.now
        buf[:count] = self._rx[:count]
        self._rx = self._rx[count:]
        self._rx_due += count * self._rx_ticks
        return count

    def discard(self) -> None:
        """Drop the bytes that have arrived."""
        count = self._arrived(len(self._rx))
        self._rx = self._rx[count:]
        self._rx_due += count * self._rx_ticks

    def write(self, data: "bytes | bytearray | memoryview") -> None:
        """Queue bytes to the sender; while the queue is full, time passes."""
        rig = self._rig
        # Answers to several lines may come in one call: each takes the time of an answer.
        rig.pass_time(rig.now + rig.answer_ticks * max(1, bytes(data).count(_OK)))
        if not self._tx:
            self._tx_due = rig.now + self._tx_ticks
        self._tx.extend(data)
        too_many = len(self._tx) - _TX_QUEUE
        if too_many > 0:  # until that many have been sent
            rig.pass_time(self._tx_due + (too_many - 1) * self._tx_ticks)

    # Interface for the simulator

    def send(self, data: "bytes | bytearray | memoryview") -> int:
        """Start transmitting to the device, after the bytes that are on the wire; returns the tick
        at which the last byte arrives."""
        now = self._rig.now
        if not self._rx:  # else the bytes follow these
            self._rx_due = max(now, self.wire_free) + self._rx_ticks
        self._rx.extend(data)
        if data:
            self.wire_free = self._rx_due + (len(self._rx) - 1) * self._rx_ticks
        return max(now, self.wire_free)

    def next_event(self) -> "int | None":
        """Return when the next byte arrives at the device, or None."""
        return self._rx_due if self._rx else None

    def answered(self) -> int:
        """Return when everything written so far has reached the sender."""
        return self._tx_due + (len(self._tx) - 1) * self._tx_ticks if self._tx else self._rig.now

    def advance(self) -> None:
        """Deliver to the sender the bytes whose time on the wire has passed."""
        now = self._rig.now
        if self._tx and self._tx_due <= now:
            # The first byte arrives at _tx_due, each further one _tx_ticks later.
            count = min(len(self._tx), (now - self._tx_due) // self._tx_ticks + 1)
            self.received.extend(self._tx[:count])
            self._tx = self._tx[count:]
            self.last_arrival = self._tx_due + (count - 1) * self._tx_ticks
            self._tx_due += count * self._tx_ticks

    def power_off(self) -> None:
        """Lose the bytes in transit, in both directions."""
        self._rx = bytearray()
        self._tx = bytearray()

    def _arrived(self, limit: int) -> int:
        """Return the number of bytes that have arrived at the device; at most `limit`."""
        if not self._rx or self._rx_due > self._rig.now:
            return 0
        return min(limit, len(self._rx), (self._rig.now - self._rx_due) // self._rx_ticks + 1)
