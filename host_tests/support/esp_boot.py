"""The whole firmware of an ESP32 board on stand-ins: under either Python, in virtual time.

python esp_boot.py BOARD FOLDER [LINE ...] runs main.py with boards/BOARD.py. Each LINE
(`ENGINE = "i2s"`) replaces the line for the same name, or is appended; RUN = "FILE" runs that file
instead of main.py, until the watchdog ends it. Settings are stored in FOLDER. Its talk.json lists
what the sender sends and waits for, beginning with nothing and the welcome:
[["", "Grbl"], ["$X\\n", "ok"], ...]. Some texts are commands to the environment: "pin 5 0" sets a
pin; "ms 100" waits; "deaf 5 0" sets the pin during a collection, so that its interrupt is lost;
"hang 400" keeps the main loop away for 400 ms; "fail" makes the engine's next turn raise; "duty 5"
prints the duty of a pin. Prints the conversation, and the bytes left for the prompt.
"""

import json
import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any


def set_path() -> str:
    """Find the firmware and the stand-ins; return the folder of the tree."""
    here = sys.argv[0].rsplit("/", 1)[0] if "/" in sys.argv[0] else "."
    root = here + "/../.."
    standins = root + "/tools/sim/standins"
    if sys.implementation.name == "cpython":
        sys.path.insert(0, standins)
    sys.path.insert(0, os.getenv("UGRBL_FIRMWARE") or root + "/firmware")
    sys.path += [here, standins]
    return root


ROOT = set_path()

import esp32  # noqa: E402
import esp_clock  # noqa: E402
import esp_machine  # noqa: E402
import esp_stdio  # noqa: E402
import punch_pins  # noqa: E402

clock = esp_clock.clock
_PATIENCE_US = 60_000_000
_THINKING_US = 2_000


def load(modules: "dict[str, object]", *names: str) -> None:
    """Import the firmware's modules of these names with stand-ins for some of their imports."""
    hidden = {name: sys.modules.get(name) for name in modules}
    for name, stand_in in modules.items():
        sys.modules[name] = stand_in  # type: ignore[assignment]
    for name in names:
        __import__(name)
    for name, module in hidden.items():
        if module:
            sys.modules[name] = module
        else:
            del sys.modules[name]


class Time:
    """The ESP32's time module."""

    ticks_us = clock.ticks_us
    ticks_ms = clock.ticks_ms
    ticks_diff = clock.ticks_diff


class Namespace:
    """A module made from a dictionary."""

    def __init__(self, names: "dict[str, object]") -> None:
        for name, value in names.items():
            setattr(self, name, value)


class Unanswered(BaseException):
    """The expected answer does not come. Not an Exception, because the firmware catches those."""


def deaf(pin: "esp_machine.Pin", level: int) -> None:
    """Change a pin after 40 ms of C code: a timer has taken all places for callbacks."""
    clock.work(40_000)
    lost = clock.lost
    clock.busy = True
    pin.drive(level)
    clock.busy = False
    assert clock.lost > lost or not clock.timers, "the edge must be lost"


def fail() -> None:
    """Make the engine's next turn raise."""
    for module, name in (("esp_chip.i2s", "I2sEngine"), ("esp_chip.rmt", "RmtEngine")):
        if module in sys.modules:
            kind: "Any" = getattr(sys.modules[module], name)
            kind._advance = failing(kind, kind._advance)


def failing(kind: "Any", go_on: "Any") -> "Any":
    """Return a turn that raises once."""

    def turn(_: object) -> None:
        kind._advance = go_on
        raise ValueError("an error that is ok")

    return turn


def flash_write() -> None:
    """Block interrupts as while a sector is erased."""
    for channel in esp32.RMT.channels:
        channel.flash_write(45_000)
    streams = list(esp_machine.I2S.open_streams.values())
    if streams:
        streams[0].flash_write(45_000)
    else:
        clock.work(45_000)


class Sender:
    """Send a text, wait for its answer, and so on."""

    def __init__(self, wire: "esp_stdio.Wire", talk: "list[tuple[str, str]]") -> None:
        self._wire = wire
        self._talk = talk
        self._got = ""
        self._until = talk.pop(0)[1]
        self._deadline = _PATIENCE_US
        self._heard_us = 0
        self._waits_until_us = 0
        wire.on_read = self.turn
        wire.on_write = self.hear
        self.punch: "punch_pins.Punch | None" = None

    def hear(self, text: str) -> None:
        self._got += text
        self._heard_us = clock.us
        print(text.replace("\r", ""), end="")

    def turn(self) -> None:
        """Act when the firmware looks for bytes and there are none."""
        if self.punch:
            self.punch.turn()
        if clock.us > self._deadline:
            raise Unanswered("no " + self._until + " in " + self._got)
        heard = not self._until or (self._until in self._got and self._got.endswith("\n"))
        if not heard or not self._talk or clock.us < self._heard_us + _THINKING_US:
            return
        if clock.us < self._waits_until_us:
            return
        self._got = ""
        text, self._until = self._talk.pop(0)
        self._deadline = clock.us + _PATIENCE_US
        if text.startswith("pin "):
            _, pin, level = text.split()
            esp_machine.Pin.pins[int(pin)].drive(int(level))
        elif text.startswith("deaf "):
            _, pin, level = text.split()
            deaf(esp_machine.Pin.pins[int(pin)], int(level))
        elif text.startswith("hang "):
            clock.advance(clock.us + int(text[5:]) * 1000)
        elif text == "fail":
            fail()
        elif text.startswith("duty "):
            print("duty", esp_machine.Pin.pins[int(text[5:])].log[-1][1])
        elif text.startswith("ms "):
            self._waits_until_us = clock.us + int(text[3:]) * 1000
        else:
            if " " <= text[0]:
                print("> " + text.strip())
            self._wire.arrive(text.encode())


def board(name: str, lines: "list[str]") -> "Namespace":
    """Return the board file with its changed lines."""
    with open(ROOT + "/boards/" + name + ".py") as file:
        source = file.read().split("\n")
    for line in lines:
        named = line.split("=")[0]
        at = [k for k in range(len(source)) if source[k].startswith(named)]
        if at:
            source[at[0]] = line
        else:
            source.append(line)
    names: "dict[str, object]" = {}
    exec("\n".join(source), names)
    return Namespace(names)


def chip(board: str) -> "Namespace":
    """Return the board's `sys` with the name of its chip."""
    s3 = board == "esp32_s3"
    if s3:
        esp_machine.mem32.first = 0x60004554
        esp32.RMT.available, esp32.RMT.block, esp32.RMT.first_signal = 4, 48, 81
    name = "ESP32S3" if s3 else "ESP32"
    return Namespace({"implementation": Namespace({"_machine": "A board with " + name})})


class Restart(BaseException):
    """The watchdog's reset. Not an Exception, because the firmware catches those."""


class BusyTime(Time):
    """Time that advances with each query, as in a loop that does nothing else."""

    @staticmethod
    def ticks_ms() -> int:
        watchdog = esp_machine.WDT
        if watchdog.fed and clock.us - watchdog.fed > 1000 * watchdog.timeout_ms:
            raise Restart
        BusyTime.sleep_us(200)
        return clock.ticks_ms()

    @staticmethod
    def ticks_us() -> int:
        BusyTime.sleep_us(6)
        return clock.us & 0x3FFFFFFF

    @staticmethod
    def sleep_us(us: int) -> None:
        if clock._in_callback:
            clock.work(us)
        else:
            clock.advance(clock.us + us)

    @staticmethod
    def sleep_ms(ms: int) -> None:
        BusyTime.sleep_us(1000 * ms)


def run(path: str) -> None:
    """Run a program as from the prompt."""
    sys.modules["machine"] = esp_machine  # type: ignore[assignment]
    sys.modules["time"] = BusyTime  # type: ignore[assignment]
    with open(path) as file:
        source = file.read()
    try:
        exec(compile(source, path, "exec"), {"__name__": "__main__"})
    except Restart:
        print("the watchdog starts the chip anew")


def main() -> None:
    name, folder, *lines = sys.argv[1:]
    made: "Any" = board(name, lines)
    wire = esp_stdio.Wire()
    load(
        {"machine": esp_machine, "time": Time},
        "esp_chip.pins",
        "ports.pin_check",
        "esp_chip.start",
    )
    modules = {"machine": esp_machine, "time": Time, "sys": chip(name)}
    if made.ENGINE in ("rmt", "i2s"):
        load(modules, "esp_chip." + made.ENGINE)
    load({"os": wire.os()}, "ports.escape")
    load({"sys": wire.sys(), "select": wire.select()}, "ports.uart_link")
    load({"sys": wire.sys(), "machine": esp_machine}, "ports.supervisor")
    from ports.storage import flash_store

    real_store = flash_store.FlashStore

    class Store(real_store):  # type: ignore[misc, valid-type]
        """Flash whose writes take time and block interrupts."""

        def _write(self, path: str, kept: "list[str]") -> None:
            super()._write(path, kept)
            flash_write()

    flash_store.FlashStore = lambda: Store(folder + "/")  # type: ignore[misc, assignment]
    sys.modules["board"] = made  # type: ignore[assignment]
    with open(folder + "/talk.json") as file:
        sender = Sender(wire, json.load(file))
    for pin in made.LIMIT + made.NO_PULL_UP:  # external resistors
        if pin is not None:
            esp_machine.Pin(pin, esp_machine.Pin.IN).drive(1)
    if getattr(made, "PUNCH_UP", None):
        sender.punch = punch_pins.Punch(made, esp_machine.Pin, lambda: clock.us)
    if getattr(made, "RUN", None):
        run(made.RUN)
        return
    # The start imports it, as other modules do on a board.
    sys.modules.setdefault("machine", esp_machine)  # type: ignore[arg-type]
    __import__("main")
    print("the prompt reads", list(wire.left()))
    if sender.punch:
        print(sender.punch.strokes, "strokes")


main()
