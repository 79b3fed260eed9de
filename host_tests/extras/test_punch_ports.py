"""Test the punch on the ports of real boards: stand-ins for pins, the simulator for pulses.

M3 arms the punch: each motion then ends with a stroke. Without its sensors, nothing moves.

Machine.talk() sends lines, each after the answer to the one before, and returns the whole output.
"""

from collections.abc import Callable, Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

import esp_bench
import machine
import pytest
from pio import pins as gpio
from punch_pins import Punch
from ugrbl.boardfile.files import load_board
from ugrbl.sim.rig import Rig


def board() -> ModuleType:
    """Return the simulator's board with a punch, and the pins that a real port needs."""
    module = ModuleType("board")
    vars(module).update(vars(load_board("sim_punch")), ENABLE=8, STEP=(0, 1, 2))
    return module


class Machine(Rig):
    """A simulated machine with a real board's port, and a punch on stand-ins for its pins."""

    def __init__(self, make_port: "Callable[[ModuleType], Any]", pin_class: Any) -> None:
        """make_port: returns the port of a board module. pin_class: that of stand-ins for pins."""
        module = board()
        super().__init__(module)
        self.port = make_port(module)
        self.port.power_off = lambda: None
        # Its clock is in us.
        self.punch = Punch(module, pin_class, lambda: self.now * 1000 // int(self.ticks_per_ms))
        ticks = SimpleNamespace(ticks_ms=self._ticks_ms, ticks_diff=lambda a, b: a - b)
        # The port's time is that of the simulator; each reading also moves the punch.
        type(self.port).ticks_ms.__globals__["time"] = ticks

    def _ticks_ms(self) -> int:
        self.punch.turn()
        return int(self.now / self.ticks_per_ms)

    def talk(self, *lines: str, until: str = "ok") -> str:
        """Send lines; wait for the text `until` in the output after each; return all output."""

        def script() -> "Iterator[Any]":
            """Wait for the welcome; send each line after the answer to the one before."""
            self.punch.turn()
            yield lambda: b"Grbl " in self.link.received
            for line in lines:
                before = len(self.link.received)
                self.link.send(line.encode() + b"\n")
                yield lambda before=before: until.encode() in self.link.received[before:]
            yield self.ms(500)  # until the last motion and its stroke are over

        self.run(script())
        return bytes(self.link.received).decode()


@pytest.fixture(params=["pio", "esp"])
def rig(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Machine:
    """Return the machine with the port of RP2 boards (pio), or of the ESP32 (esp)."""
    if request.param == "pio":
        monkeypatch.setattr(gpio, "_is_rp2350", lambda: False)
        monkeypatch.setattr(machine.Pin, "pins", {})
        # Machine() replaces `time` in the module of the class, which other tests may have loaded
        # once more. Set here too, it is restored after the test.
        monkeypatch.setitem(gpio.GpioPort.ticks_ms.__globals__, "time", None)
        monkeypatch.setattr(gpio, "time", SimpleNamespace(sleep_us=lambda us: None))
        return Machine(gpio.GpioPort, machine.Pin)
    esp_bench.reset_stand_ins()
    monkeypatch.setitem(esp_bench.gpio_esp.EspPort.ticks_ms.__globals__, "time", None)
    return Machine(esp_bench.gpio_esp.EspPort, esp_bench.esp_machine.Pin)


def test_each_motion_ends_with_a_stroke(rig: Machine) -> None:
    """Seven lines have seven answers; the two moves between M3 and M5 make strokes."""
    output = rig.talk("$X", "G91 M3", "G0 X1", "G0 X1 Y1", "M5", "G0 X1", "G4 P0")
    assert "ALARM" not in output and output.endswith(7 * "ok\r\n")
    assert rig.punch.strokes == 2
    rig.engine.physical(rig.scratch)
    assert list(rig.scratch) == [750, 250, 0]  # 3 mm and 1 mm, 250 steps/mm


def test_silent_sensor_is_an_alarm(rig: Machine) -> None:
    """The punch is never moved by its actuators, and its sensors stay off."""
    rig.punch.turn = lambda: None  # type: ignore[method-assign]
    output = rig.talk("$X", "M3", "G0 X1", until="\n")
    assert "[MSG:Punch not up]" in output
    assert rig.punch.strokes == 0
    rig.engine.physical(rig.scratch)
    assert list(rig.scratch) == [0, 0, 0]
