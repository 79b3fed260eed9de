"""Serial line of the simulator: bytes take their time on the wire, both ways, in virtual time."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .seams import Clock

# An Arduino Uno at "115200": the sender is exact, the AVR's divider gives 117647 baud.
RX_BAUD = 115200
TX_BAUD = 117647
# Bytes the answering side may queue before write() waits.
_TX_QUEUE = 104
_OK = b"ok\r\n"


class SimLink:
    """A Link with two virtual wires. `received` is what the sender has got, whole bytes only."""

    def __init__(self, rig: "Clock", rx_baud: int = RX_BAUD, tx_baud: int = TX_BAUD) -> None:
        self.received = bytearray()
        self.last_arrival = 0
        self.wire_free = 0
        self._rig = rig
        self._rx_ticks = rig.engine.tick_hz * 10 // rx_baud
        self._tx_ticks = rig.engine.tick_hz * 10 // tx_baud
        self._turn = 0
        self._rx = bytearray()
        self._rx_due = 0  # when the first byte of _rx has arrived
        self._tx = bytearray()
        self._tx_due = 0  # when the first byte of _tx has been sent

    # The Link seam

    def read_into(self, buf: bytearray) -> int:
        """What has arrived; where nothing has, time passes until the next event."""
        turn = self._turn + self._rig.loop_ticks
        if turn > self._rig.now and self._rig.moving():
            self._rig.pass_time(turn)
        count = self._arrived(len(buf))
        if count == 0:
            self._rig.wait()
            count = self._arrived(len(buf))
        self._turn = self._rig.now
        buf[:count] = self._rx[:count]
        self._rx = self._rx[count:]
        self._rx_due += count * self._rx_ticks
        return count

    def discard(self) -> None:
        """Drop what has arrived by now."""
        count = self._arrived(len(self._rx))
        self._rx = self._rx[count:]
        self._rx_due += count * self._rx_ticks

    def write(self, data: "bytes | bytearray | memoryview") -> None:
        rig = self._rig
        # Lines that have been done one behind the other are answered at once.
        rig.pass_time(rig.now + rig.answer_ticks * max(1, bytes(data).count(_OK)))
        if not self._tx:
            self._tx_due = rig.now + self._tx_ticks
        self._tx.extend(data)
        if len(self._tx) > _TX_QUEUE:
            rig.pass_time(self._tx_due + (len(self._tx) - _TX_QUEUE - 1) * self._tx_ticks)

    # The simulator's side

    def send(self, data: "bytes | bytearray | memoryview") -> int:
        """The sender begins to transmit; returns the tick at which the last byte has arrived."""
        now = self._rig.now
        if not self._rx:
            self._rx_due = max(now, self.wire_free) + self._rx_ticks
        self._rx.extend(data)
        if data:
            self.wire_free = self._rx_due + (len(self._rx) - 1) * self._rx_ticks
        return max(now, self.wire_free)

    def next_event(self) -> "int | None":
        """When the next byte arrives at the device, or None."""
        return self._rx_due if self._rx else None

    def answered(self) -> int:
        """When everything written so far has reached the sender."""
        return self._tx_due + (len(self._tx) - 1) * self._tx_ticks if self._tx else self._rig.now

    def advance(self) -> None:
        """Deliver the bytes whose time on the wire has passed."""
        now = self._rig.now
        if self._tx and self._tx_due <= now:
            count = min(len(self._tx), (now - self._tx_due) // self._tx_ticks + 1)
            self.received.extend(self._tx[:count])
            self._tx = self._tx[count:]
            self.last_arrival = self._tx_due + (count - 1) * self._tx_ticks
            self._tx_due += count * self._tx_ticks

    def power_off(self) -> None:
        """What was on its way is lost."""
        self._rx = bytearray()
        self._tx = bytearray()

    def _arrived(self, limit: int) -> int:
        if not self._rx or self._rx_due > self._rig.now:
            return 0
        return min(limit, len(self._rx), (self._rig.now - self._rx_due) // self._rx_ticks + 1)
