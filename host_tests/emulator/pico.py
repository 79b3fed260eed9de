"""Run a real MicroPython image on a Raspberry Pi Pico in the emulator rp2040py.

Synchronous and deterministic: the chip runs only in run_us() and run_until(), and time is the
emulated chip's. Four faults of rp2040py 0.3.6 are corrected here: see _Usb, _Pio, _read_back() and
_override_interrupts(). The README says how exact its times are.
"""

import ctypes
import struct
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import xip
from chips import BLOCK, CHIPS, Bench, Edge, file_system
from rp2040py.boards import BOARDS, FlashLayout
from rp2040py.device import MicroPythonDevice
from rp2040py.execute_batch import execute_batch
from rp2040py.memory_map import FLASH_START_ADDRESS
from rp2040py.native import _pio as compiled_pio
from rp2040py.native import _rp2040 as chip
from rp2040py.peripherals.pio import RPPIO
from rp2040py.peripherals.pwm import CHN_CC, RPPWM

_CHIP = CHIPS["rp2040"]
_LAYOUT = FlashLayout(_CHIP.file_system, _CHIP.blocks, BLOCK)

_NS_PER_US = 1000
_NS_PER_CYCLE = 8
_OUT_PACKET_US = 1  # the host sends a byte so long after it was queued
_NAP_NS = 80  # a tick of our pulse engine
_BEAT_NS = 4_000
_PIO_STEP = 8  # processor cycles

# Commands of a flash chip, and the busy bit of its status.
_READ_STATUS = 0x05
_ERASES = (b"\x20", b"\xd8")
_WRITES = (b"\x02", *_ERASES)
_BUSY = 1

# Control registers of the pins; IRQOVER in them; IRQTOPROC of their status; edge bits.
_IO_BANK0 = 0x40014000
_LAST_CONTROL = 0xEC
_OVERRIDE_SHIFT = 28
_OVERRIDE = 3 << _OVERRIDE_SHIFT
_TO_PROCESSOR = 1 << 26
_EDGE_LOW, _EDGE_HIGH = 4, 8


class _Usb:
    """The host's end of the serial line over USB.

    rp2040py answers every empty OUT poll with a zero-length packet at once, which costs the chip
    two thirds of its time; a real host stays silent. So polls wait here until there are bytes.
    """

    def __init__(self, pico: "Pico") -> None:
        self.received = bytearray()
        self.connected = 0  # how often the chip has been enumerated
        self._cdc = pico.device.cdc
        self._pending = bytearray()
        self._polled: tuple[int, int] | None = None
        self._answer = pico.device.mcu.usb_ctrl.on_endpoint_read
        self._alarm = pico.clock.create_alarm(self._push)
        self._reads = True
        self._unread: list[int] = []
        self._tell_sent = pico.device.mcu.usb_ctrl._indicate_buffer_ready
        pico.device.mcu.usb_ctrl._indicate_buffer_ready = self._sent
        self._cdc.on_serial_data = self.received.extend
        self._cdc.on_device_connected = self._on_connected
        pico.device.mcu.usb_ctrl.on_endpoint_read = self._on_poll
        on_reset = pico.device.mcu.usb_ctrl.on_reset
        pico.device.mcu.usb_ctrl.on_reset = lambda: (self._forget(), on_reset())

    def send(self, data: bytes) -> None:
        self._pending += data
        self._alarm.schedule(_OUT_PACKET_US * _NS_PER_US)

    def open_port(self, is_open: bool) -> None:
        """Open or close the port as a program does, which sets DTR."""
        self._cdc._cdc_set_control_line_state(3 if is_open else 0)

    def ask(self, line_state: int | None) -> None:
        """Send a control request: SET_CONTROL_LINE_STATE (1: DTR, 2: RTS), or SET_LINE_CODING."""
        if line_state is None:
            self._cdc.set_line_coding(115200)
        else:
            self._cdc._cdc_set_control_line_state(line_state)

    def read(self, on: bool) -> None:
        """Let the host read the chip's output, or leave it unread."""
        self._reads = on
        if on:
            sent, self._unread = self._unread, []
            for endpoint in sent:
                self._tell_sent(endpoint, False)

    def _sent(self, endpoint: int, out: bool) -> None:
        """Signal a buffer to the chip: received bytes, or space for output if the host reads."""
        if out or self._reads or endpoint != self._cdc._in_endpoint:
            self._tell_sent(endpoint, out)
        else:
            self._unread.append(endpoint)

    def waiting(self) -> int:
        """Return the number of bytes that the chip has not read yet."""
        return len(self._pending) + self._cdc.tx_fifo.item_count

    def _on_connected(self) -> None:
        self.connected += 1

    def _forget(self) -> None:
        self._polled = None
        self._unread = []

    def _on_poll(self, endpoint: int, size: int) -> None:
        if endpoint != self._cdc._out_endpoint or endpoint <= 0:
            self._answer(endpoint, size)
            return
        self._polled = (endpoint, size)
        if self._pending:
            self._alarm.schedule(_OUT_PACKET_US * _NS_PER_US)

    def _push(self) -> None:
        if self._polled is None or not self._pending:
            return
        polled, self._polled = self._polled, None
        for byte in self._pending[: polled[1]]:
            self._cdc.send_serial_byte(byte)
        del self._pending[: polled[1]]
        self._answer(*polled)


class _Pio(RPPIO):
    """A PIO block that keeps its time.

    rp2040py lets each machine take one step per processor instruction. After a long instruction
    the missed time is dropped, and the waveform drifts. Here long instructions are cut up.
    """

    def advance(self, cycles: int) -> None:
        while cycles > _PIO_STEP:
            super().advance(_PIO_STEP)
            cycles -= _PIO_STEP
        super().advance(cycles)


def _never_write_off() -> bool:
    """Get the same at half the cost: raise the limit beyond which missed time is dropped.

    The limit is a static variable of the compiled module, found by its neighbour. Returns False if
    it is not found. A machine then catches up later, so the processor must not sleep.
    """
    limit, neighbour = struct.pack("<q", 8 << 8), struct.pack("<q", 1 << 62)
    try:
        maps = Path("/proc/self/maps").read_text().splitlines()
    except OSError:
        return False
    for line, following in zip(maps, [*maps[1:], ""]):
        if not line.endswith(Path(compiled_pio.__file__).name) or " rw" not in line:
            continue
        for part in (line, following):
            start, end = (int(x, 16) for x in part.split(" ")[0].split("-"))
            found = ctypes.string_at(start, end - start).find(limit + neighbour)
            if found >= 0:
                ctypes.c_longlong.from_address(start + found).value = 1 << 60
                return True
    return False


def _make_device(uf2: Path, cache: bool) -> MicroPythonDevice:
    theirs = chip.RPPIO
    if not _never_write_off():
        chip.RPPIO = _Pio
    try:
        board = replace(BOARDS["pico"], image=uf2, layout=_LAYOUT)
        return MicroPythonDevice(board=replace(board, mcu=xip.chip()) if cache else board)
    finally:
        chip.RPPIO = theirs


class Pico(Bench):
    """An emulated Pico.

    files: its file system at first power-up, by path. cache: flash that is not in the chip's cache
    takes time (xip.py).
    """

    def __init__(
        self, uf2: Path, files: Mapping[str, bytes] | None = None, cache: bool = False
    ) -> None:
        self.device = _make_device(uf2, cache)
        self.simulator = self.device.simulator
        self.mcu = self.device.mcu
        self.clock = self.simulator.clock
        self.usb = _Usb(self)
        self.edges: list[Edge] = []
        self.on_erase: Callable[[], None] = lambda: None  # a sector of flash
        self.on_program: Callable[[], None] = lambda: None  # a page of flash
        self._erase_ns = self._busy_until = 0.0
        self._written_in_motion: list[float] = []  # times, in us
        self._watch_flash()
        self._stop = self.clock.create_alarm(self._on_stop)
        self._beat = self.clock.create_alarm(self._on_beat)
        if files is not None:
            self.put_file_system(file_system(files))
        for pin in self.mcu.gpio:
            _read_back(pin)
        _override_interrupts(self.mcu)
        self.mcu.core.pc = FLASH_START_ADDRESS

    # Time

    @property
    def us(self) -> float:
        """Return the emulated microseconds since power-up."""
        return float(self.clock.nanos) / _NS_PER_US

    def run_us(self, us: float) -> None:
        """Let the chip run for this time."""
        self._stop.schedule(us * _NS_PER_US)
        self.simulator.stopped = False
        while not self.simulator.stopped:
            execute_batch(self.simulator, 1)
        assert not self._written_in_motion, "flash is written while motors turn"

    def at_us(self, delay_us: float, action: Callable[[], None]) -> None:
        """Call action after this time."""
        self.clock.create_alarm(action).schedule(delay_us * _NS_PER_US)

    def _on_stop(self) -> None:
        self.simulator.stopped = True

    def pio_lag_ns(self) -> float:
        """Return by how much the PIO blocks lag the clock: edges may be late by this time."""
        due = (
            (pio.cycle_fp - machine.next_due_fp) / 256
            for pio in self.mcu.pio
            for machine in pio.machines
            if machine.enabled and not machine.waiting
        )
        return max(due, default=0) * _NS_PER_CYCLE

    # Pins

    def record(self, pins: list[int]) -> None:
        """Log the edges of these pins from now on in self.edges."""
        for pin in pins:
            self.mcu.gpio[pin].add_listener(self._listener(pin))
        self._on_beat()

    def _listener(self, pin: int) -> Callable[[object, object], None]:
        edges, clock = self.edges, self.clock

        def on_change(new: object, old: object) -> None:
            if old.name in ("LOW", "HIGH"):  # otherwise the pin has only become an output
                edges.append(Edge(clock.nanos, pin, 1 if new.name == "HIGH" else 0))

        return on_change

    def _on_beat(self) -> None:
        """Keep naps short: PIO advances once per instruction, or once per nap of the processor."""
        moving = any(not pio.stopped for pio in self.mcu.pio)
        self._beat.schedule(_NAP_NS if moving and self.mcu.core.waiting else _BEAT_NS)

    def drive(self, pin: int, level: int | None) -> None:
        """Drive an input from outside; None lets it float."""
        gpio = self.mcu.gpio[pin]
        if level is None:
            gpio.release_input()
        elif gpio.input_value != bool(level):
            gpio.set_input_value(bool(level))

    def level(self, pin: int) -> int | None:
        """Return the level of an output; None if the pin is not an output."""
        return {"LOW": 0, "HIGH": 1}.get(self.mcu.gpio[pin].value.name)

    def watch_power(self, pin: int) -> list[tuple[float, int]]:
        """Return a list that collects (us, level) of writes to the pin's PWM compare register."""
        written: list[tuple[float, int]] = []
        (pwm,) = (part for part in vars(self.mcu).values() if isinstance(part, RPPWM))
        channel = pwm.channels[pin // 2 & 7]
        usual = channel.write_register

        def write_register(offset: int, value: int) -> None:
            if offset == CHN_CC:
                written.append((self.us, value >> 16 * (pin & 1) & 0xFFFF))
            usual(offset, value)

        channel.write_register = write_register
        return written

    # Flash

    def erase_takes_us(self, us: float) -> None:
        """Let every later erasure of a sector take this time: rp2040py takes none."""
        self._erase_ns = us * _NS_PER_US

    def _watch_flash(self) -> None:
        """Let erasing take time, and find flash written while motors turn; run_us() raises then.

        The processor stands still during a write, and would be late for the next segment.
        """
        ssi, clock = self.mcu.ssi, self.clock
        shift, apply = type(ssi)._shift_byte, type(ssi)._apply_command

        def shift_byte(byte: int) -> int:
            answer = int(shift(ssi, byte))
            asked = len(ssi._tx_buffer) > 1 and ssi._tx_buffer[0] == _READ_STATUS
            return answer | _BUSY if asked and clock.nanos < self._busy_until else answer

        def apply_command() -> None:
            command = bytes(ssi._tx_buffer[:1])
            if command in _WRITES and ssi._write_enabled:
                if self.moving():
                    self._written_in_motion.append(self.us)
                if command in _ERASES:
                    self._busy_until = clock.nanos + self._erase_ns
                    self.on_erase()
                else:
                    self.on_program()
            apply(ssi)

        ssi._shift_byte, ssi._apply_command = shift_byte, apply_command

    def moving(self) -> bool:
        """Return whether a PIO machine is busy: all of ours wait for a word while motors stand."""
        machines = [machine for pio in self.mcu.pio for machine in pio.machines]
        return any(machine.enabled and not machine.waiting for machine in machines)

    # Memory

    def read_flash(self, at: int, size: int) -> bytes:
        """Return the content of flash."""
        return bytes(self.mcu.flash[at : at + size])

    def write_flash(self, at: int, data: bytes) -> None:
        """Write flash as a programmer does, without the chip."""
        self.mcu.flash[at : at + len(data)] = data

    def read_word(self, address: int) -> int:
        """Read a word of the chip's memory or registers."""
        return int(self.mcu.read_uint32(address))

    def write_word(self, address: int, value: int) -> None:
        """Write a word of the chip's memory or registers."""
        self.mcu.write_uint32(address, value)

    def stack(self) -> tuple[int, int]:
        """Return the stack pointer, and the number of the running interrupt, or 0."""
        return self.mcu.core.sp, self.mcu.core.ipsr


def _read_back(pin: object) -> None:
    """Let an output pin read as its own level: rp2040py keeps the two apart."""

    def on_change(new: object, _old: object) -> None:
        if new.name in ("LOW", "HIGH"):
            pin.set_input_value(new.name == "HIGH")
        else:
            pin.release_input()

    pin.add_listener(on_change)


def _override_interrupts(mcu: object) -> None:
    """Let IRQOVER act between a pad and its edge detection.

    So the data sheet's STATUS says (IRQFROMPAD, IRQTOPROC). rp2040py inverts the final interrupt
    instead, and does not signal the change.
    """
    io = mcu.find_peripheral(_IO_BANK0)
    overrides: dict[int, int] = {}
    read, write = io.read_uint32, io.write_uint32

    def seen(pin: int) -> bool:
        level = bool(mcu.gpio[pin].input_value)
        return (level, not level, False, True)[overrides.get(pin, 0)]

    def read_uint32(offset: int) -> int:
        if offset > _LAST_CONTROL:
            return int(read(offset))
        pin, is_control = offset >> 3, offset & 4
        if is_control:
            return int(read(offset)) | overrides.get(pin, 0) << _OVERRIDE_SHIFT
        return int(read(offset)) & ~_TO_PROCESSOR | (_TO_PROCESSOR if seen(pin) else 0)

    def write_uint32(offset: int, value: int) -> None:
        if offset > _LAST_CONTROL or not offset & 4:
            write(offset, value)
            return
        pin = offset >> 3
        before = seen(pin)
        overrides[pin] = value >> _OVERRIDE_SHIFT & 3
        write(offset, value & ~_OVERRIDE)
        if seen(pin) != before:
            mcu.gpio[pin].irq_status |= _EDGE_LOW if before else _EDGE_HIGH
            mcu.update_io_interrupt()

    io.read_uint32, io.write_uint32 = read_uint32, write_uint32
