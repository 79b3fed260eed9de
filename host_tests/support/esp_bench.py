"""The ESP32's engines on the desktop: their output to hardware, turned back into steps.

EspEngine is an engine of firmware/esp_chip on the stand-ins, with the simulator's interface of a
SimEngine, so that a Rig accepts it. Steps are those that a motor's driver would see at the pins: a
rising edge of STEP counts, with the level that DIR has then.
"""

import sys
from array import array
from collections import deque
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import esp32
import esp_machine
from esp_clock import clock
from motion.layout import ROW_AXES, ROW_STRIDE, row_length
from ugrbl.sim import engine as sim_engine
from ugrbl.sim.engine import Switch

CHIP = SimpleNamespace(_machine="Generic ESP32 module with ESP32")


def _load() -> "tuple[Any, Any, Any, Any, Any]":
    """Import engines and pins with the ESP32's own modules instead of others of the same name."""
    stand_ins: dict[str, Any] = {
        "machine": esp_machine,
        "sys": SimpleNamespace(implementation=CHIP, modules=sys.modules),
        "time": SimpleNamespace(
            ticks_us=clock.ticks_us, ticks_ms=clock.ticks_ms, ticks_diff=clock.ticks_diff
        ),
    }
    pins = ("ports.input_pins", "ports.port", "esp_chip.pins")
    hidden = {name: sys.modules.pop(name, None) for name in (*stand_ins, *pins)}
    sys.modules.update(stand_ins)
    try:
        from esp_chip import i2s, rmt, start
        from esp_chip import pins as gpio_esp
        from ports import port as gpio_port
    finally:
        for name, module in hidden.items():
            if module is None:
                sys.modules.pop(name, None)
            else:
                sys.modules[name] = module
    return i2s, rmt, start, gpio_esp, gpio_port


i2s, rmt, esp_start, gpio_esp, gpio_port = _load()
esp_machine.I2S.recording = True

# As on the boards: outputs of the shift registers, pins.
# Six motors; a machine uses the first ones.
I2S_STEP, I2S_DIR, I2S_ENABLE = (1, 5, 3, 7, 9, 11), (2, 6, 4, 8, 10, 12), (0, 13)
RMT_STEP, RMT_DIR = (26, 25, 17, 18, 19, 21), (16, 27, 14, 22, 23, 13)

Step = tuple[int, int, int]  # us, axis, +1 or -1


class Levels:
    """Levels of one axis' two pins: finds steps, and measures the times that a driver needs."""

    def __init__(self, axis: int) -> None:
        self.axis = axis
        self.step = self.direction = 0
        self.rose = self.fell = self.turned = -1_000_000
        self.last = 0
        self.shortest_pulse = self.shortest_pause = 1_000_000
        self.shortest_setup = self.shortest_hold = 1_000_000
        self.invert = 0

    def set_direction(self, us: int, level: int) -> None:
        """Set the direction pin's level from now on."""
        if level != self.direction:
            self.direction = level
            self.turned = us
            self.shortest_hold = min(self.shortest_hold, us - self.rose)

    def set_step(self, us: int, level: int) -> "Step | None":
        """Set the step pin's level from now on; return the step, if this makes one."""
        if level == self.step:
            return None
        self.step = level
        if not level:
            self.fell = us
            self.shortest_pulse = min(self.shortest_pulse, us - self.rose)
            return None
        self.rose = us
        self.shortest_pause = min(self.shortest_pause, us - self.fell)
        self.shortest_setup = min(self.shortest_setup, us - self.turned)
        return us, self.axis, -1 if self.direction != self.invert else 1


class I2sPins:
    """Shift registers connected to machine.I2S in the Philips format."""

    def __init__(self, axes: int) -> None:
        self.levels = [Levels(i) for i in range(axes)]
        self._stream: Any = None
        self._seen = 0
        self._word = 0
        self._events: deque[tuple[int, int]] = deque()

    def make(self) -> Any:
        """Make the engine."""
        motors = len(self.levels)
        return i2s.I2sEngine(I2S_STEP[:motors], I2S_DIR[:motors], I2S_ENABLE, (16, 17, 21))

    def outputs(self) -> int:
        """Return all outputs."""
        return self._shown

    def run(self, until: int) -> "list[Step]":
        """Return the steps up to a time."""
        stream = esp_machine.I2S.open_streams[0]
        steps: list[Step] = []
        if stream is not self._stream:
            if self._stream is not None:
                self._play(steps, self._stream.closed_us)
            self._events.clear()
            self._stream, self._seen = stream, 0
        if stream.size:
            stream.run()
        frame_us = stream.buffer_us // 256
        while self._seen < len(stream.played):
            start, data = stream.played[self._seen]
            stream.played[self._seen] = None
            self._seen += 1
            if data == self._word.to_bytes(4, "little") * 256:
                continue
            for k, word in enumerate(memoryview(data).cast("I")):
                if word != self._word:
                    self._word = word
                    self._events.append((start + k * frame_us, word))
        self._play(steps, until)
        return steps

    _shown = 0

    def _play(self, steps: "list[Step]", until: int) -> None:
        while self._events and self._events[0][0] <= until:
            us, word = self._events.popleft()
            # WS rises when the registers hold all bits of the word except the last.
            shown = self._shown = word >> 1
            for axis, levels in enumerate(self.levels):
                levels.set_direction(us, shown >> I2S_DIR[axis] & 1)
                step = levels.set_step(us, shown >> I2S_STEP[axis] & 1)
                if step:
                    steps.append(step)


class RmtPins:
    """Drivers connected to RMT channels, as far as the pins are routed to them, and direction
    pins."""

    def __init__(self, axes: int) -> None:
        self.levels = [Levels(i) for i in range(axes)]
        self._trains = [0] * axes
        # Future edges (us, level, train), and the read positions in the logs of the pins.
        self._edges: list[deque[tuple[int, int, int]]] = [deque() for _ in range(axes)]
        self._turns = [0] * axes
        self._words = [0] * axes
        self._rmt = [0] * axes
        self._shows = [False] * axes

    def make(self) -> Any:
        """Make the engine."""
        motors = len(self.levels)
        return rmt.RmtEngine(RMT_STEP[:motors], RMT_DIR[:motors])

    def run(self, until: int) -> "list[Step]":
        """Return the steps up to a time."""
        steps: list[Step] = []
        for axis, levels in enumerate(self.levels):
            self._take_trains(axis)
            turns = esp_machine.Pin.pins[RMT_DIR[axis]].log
            while True:
                us = self._next(axis, until)
                if us is None:
                    break
                while self._turns[axis] < len(turns) and turns[self._turns[axis]][0] <= us:
                    levels.set_direction(*turns[self._turns[axis]])
                    self._turns[axis] += 1
                step = levels.set_step(us, self._rmt[axis] if self._shows[axis] else 0)
                if step:
                    steps.append(step)
        return sorted(steps)

    def _take_trains(self, axis: int) -> None:
        channel = esp32.RMT.channels[axis]
        while self._trains[axis] < len(channel.trains):
            number = self._trains[axis]
            us, level, durations, _ = channel.trains[number]
            self._trains[axis] += 1
            for ticks in durations:
                self._edges[axis].append((us, level, number))
                us += ticks
                level = 1 - level
            self._edges[axis].append((us, 0, number))

    def _next(self, axis: int, until: int) -> "int | None":
        """Return the time of the next change of RMT's output, or of the pin's routing to it."""
        edges = self._edges[axis]
        words = esp_machine.mem32.log[RMT_STEP[axis]]
        word_us = words[self._words[axis]][0] if self._words[axis] < len(words) else until + 1
        edge_us = edges[0][0] if edges else until + 1
        if min(word_us, edge_us) > until:
            return None
        if word_us <= edge_us:
            word = words[self._words[axis]][1]
            self._shows[axis] = word & 0x1FF != esp_machine.mem32.register
            self._words[axis] += 1
            return word_us
        us, self._rmt[axis], number = edges.popleft()
        end = esp32.RMT.channels[axis].trains[number][3]
        if us > end:  # the train was cut off, and the channel is idle from there on
            us, self._rmt[axis] = end, 0
        return us


PINS: "dict[str, Any]" = {"i2s": I2sPins, "rmt": RmtPins, "rmt_s3": RmtPins}


CHIPS = {
    "esp32": ("Generic ESP32 module with ESP32", 8, 64, 87, 0x3FF44530),
    "esp32s3": ("Generic ESP32S3 module with ESP32S3", 4, 48, 81, 0x60004554),
}


def reset_stand_ins(chip: str = "esp32") -> None:
    """Restore the state after power-up."""
    RMT = esp32.RMT
    CHIP._machine, RMT.available, RMT.block, RMT.first_signal, first_pad = CHIPS[chip]
    esp_machine.mem32.first = first_pad
    esp_machine.mem32.log.clear()
    clock.reset()
    esp_machine.I2S.open_streams.clear()
    esp_machine.Pin.pins.clear()
    esp_machine.PWM.outputs.clear()
    esp32.RMT.channels.clear()
    esp32.PCNT.units.clear()
    esp32.PCNT.pads.clear()
    esp32.PCNT.lose = 0
    esp32.PCNT.most_units = 4 if chip == "esp32s3" else 8


class EspEngine:
    """An engine of the ESP32 in virtual time, with the interface of the simulated engine."""

    def __init__(self, name: str, axes: int = 3) -> None:
        reset_stand_ins("esp32s3" if name == "rmt_s3" else "esp32")
        self.pins = PINS[name](axes)
        self.real = self.pins.make()
        self.tick_hz = self.real.tick_hz
        self.segment_log2 = self.real.segment_log2
        self.switches: list[Switch] = []
        self.pins_changed: Callable[[], None] | None = None
        self.trace: Callable[[int, array[int]], None] | None = None
        self.prepare: Callable[[], None] | None = None
        self.starts = 0
        self.steps: list[Step] = []  # all steps made so far
        self._axes = axes
        self._per_us = self.tick_hz // 1_000_000
        self._place = [0] * axes
        self._row = array("i", [0] * row_length(axes))
        self.max_step_hz = self.real.max_step_hz
        self.attach = self.real.attach
        self.arm = self.real.arm
        self.fault = self.real.fault
        self.configure = self.real.configure
        self.stop = self.real.stop
        self.lock = self.real.lock
        self.idle = self.real.idle
        self.position = self.real.position
        self.set_position = self.real.set_position

    def start(self) -> None:
        self.starts += 1
        self.real.start()

    # The simulator's interface

    @property
    def now(self) -> int:
        return clock.us * self._per_us

    @now.setter
    def now(self, to: int) -> None:
        self.advance(to)

    def physical(self, steps: "array[int]") -> None:
        """Set steps to those since power-up, whatever position the firmware reports."""
        steps[:] = array("i", self._place)

    def power_off(self) -> None:
        """Release the machine."""

    def next_event(self) -> int:
        """Return the tick up to which nothing changes by itself."""
        if self.real.idle():
            return sim_engine._NEVER
        return self.now + 250 * self._per_us

    def advance(self, to: int) -> None:
        """Advance the time."""
        end = -(-to // self._per_us)
        while True:
            moving = not self.real.idle()
            # In small pieces, so that a switch closes at its place.
            piece = 20 if self.switches else 500
            clock.advance(min(clock.us + piece, end) if moving else end)
            made = self.pins.run(clock.us)
            for us, axis, sign in made:
                self._place[axis] += sign
                if self.trace:
                    self._tell(us, axis, sign)
            self.steps += made
            if made and self.switches and self.pins_changed:
                self.pins_changed()
            if clock.us >= end:
                return

    def _tell(self, us: int, axis: int, sign: int) -> None:
        row = self._row
        for i in range(len(row)):
            row[i] = 0
        row[0] = 1
        row[1] = 1 << axis if sign < 0 else 0
        row[ROW_AXES + ROW_STRIDE * axis] = 1
        if self.trace:
            self.trace(us * self._per_us, row)
