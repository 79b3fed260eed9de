"""Fakes of the interfaces (firmware/interfaces.pyi): calls are recorded in `asked`.

`make types` checks each of them against its interface, at the end of this file. Several fakes may
share one list, which shows the order of their calls. Real motion is simulated in tools/sim/.
"""

from array import array
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from base.controls import LIMITS_AT, PROBE_AT
from base.state import State
from motion import arcs
from motion.layout import RAPID_MOTION
from motion.planner import Move, Planner

if TYPE_CHECKING:
    from collections.abc import Callable

    from interfaces import (
        Canon,
        InputListener,
        Kinematics,
        Link,
        NextSegment,
        Port,
        StepEngine,
        Store,
        Voice,
    )
    from motion.arc_geometry import Arc

Asked = list[str]


def place(target: "array[float]") -> str:
    return " ".join(f"{mm:g}" for mm in target)


class FakeCanon:
    """A machine that only records: the canonical calls of a program, a line of text each."""

    def __init__(self, axes: int = 3) -> None:
        self.asked: Asked = []
        self.planner = Planner(axes, 4, None, State())
        self.travel = array("i", [axes, 0, *(0 for _ in range(axes))])
        self.course = array("i", [0] * arcs.course_length(axes))
        self.too_far = 1000.0

    def line(self, target: "array[float]", move: Move) -> None:
        how = "rapid" if move.flags & RAPID_MOTION else f"line F{move.feed:g}"
        self.asked.append(f"{how} {place(target)}")

    def arc(self, start: "array[float]", target: "array[float]", arc: "Arc", move: Move) -> None:
        self.asked.append(f"arc F{move.feed:g} {place(start)} to {place(target)}")

    def jog(self, target: "array[float]", move: Move) -> None:
        self.asked.append(f"jog F{move.feed:g} {place(target)}")

    def finish(self) -> None:
        """Do nothing: every line ends with this call, so it is not recorded."""

    def make_room(self) -> None:
        self.asked.append("room")

    def synchronise(self) -> None:
        self.asked.append("synchronise")

    def dwell(self, seconds: float) -> None:
        self.asked.append(f"dwell {seconds:g}")

    def spin(self, direction: int, rpm: float) -> None:
        self.asked.append(f"spin {direction} {rpm:g}")

    def cool(self, mask: int) -> None:
        self.asked.append(f"cool {mask}")

    def control_overrides(self, parking: bool) -> None:
        self.asked.append(f"parking {parking}")

    def pause_program(self) -> None:
        self.asked.append("pause")

    def end_program(self) -> None:
        self.asked.append("end")

    def outside(self, target: "array[float]") -> bool:
        return max(map(abs, target)) > self.too_far


class FakeEngine:
    """An engine without pulses. Idle unless started; it runs until stop() or `runs` is cleared."""

    tick_hz = 1_000_000
    segment_log2 = 13

    def __init__(self, asked: "Asked | None" = None, motors: int = 3) -> None:
        self.asked: Asked = [] if asked is None else asked
        self.runs = False
        self.told_fault = ""
        self.steps = array("i", [0] * motors)

    def max_step_hz(self, pulse_us: int) -> int:
        return self.tick_hz // (2 * pulse_us)

    def attach(
        self,
        next_segment: "NextSegment",
        on_power: "Callable[[int], None]",
        on_rest: "Callable[[], None]",
    ) -> None:
        self.asked.append("attach")

    def configure(self, pulse_us: int, step_invert: int, dir_invert: int) -> None:
        self.asked.append(f"configure {pulse_us}")

    def arm(self) -> None:
        self.asked.append("arm")

    def start(self) -> None:
        self.asked.append("start")
        self.runs = True

    def stop(self) -> object:
        self.asked.append("stop")
        self.runs = False
        return None

    def fault(self) -> str:
        return self.told_fault

    def lock(self, motors: int) -> None:
        self.asked.append(f"lock {motors}")

    def idle(self) -> bool:
        return not self.runs

    def position(self, steps: "array[int]") -> None:
        steps[:] = self.steps

    def set_position(self, steps: "array[int]") -> None:
        self.steps[:] = steps


class FakeKinematics:
    """The motor of X moves Y, and that of Y moves X."""

    moves: Sequence[int] = (0b010, 0b001, 0b100)
    _motor = (1, 0, 2)

    def axis_steps(self, motors: "array[int]", axis: int) -> int:
        return motors[self._motor[axis]]

    def to_axes(self, motors: "array[int]") -> None:
        motors[0], motors[1] = motors[1], motors[0]

    def set_axis(self, motors: "array[int]", axis: int, steps: int) -> None:
        motors[self._motor[axis]] = steps

    def stopped_by(self, switches: int) -> int:
        return sum(1 << motor for axis, motor in enumerate(self._motor) if switches >> axis & 1)


class FakePort:
    """Pins as attributes, and a clock that advances by a ms with each reading. fails: the name
    that
    raises when it is read."""

    pwm_max = 1000
    pwm = None

    def __init__(self, asked: "Asked | None" = None, fails: str = "") -> None:
        self.asked: Asked = [] if asked is None else asked
        self.limit_invert = 0
        self.estop: "Callable[[], bool] | None" = None
        self.fault = ""
        self.after_controls: "Callable[[int], object] | None" = None
        self.closed_limits = self.active_controls = self.sensed = 0
        self.touches = False
        self._fails = fails
        self._ms = 0

    def _note(self, what: str) -> None:
        self.asked.append(what)
        if what == self._fails:
            raise OSError(what)

    def attach(self, listener: "InputListener") -> None:
        self._note("attach")

    def enable_limits(self, on: bool) -> None:
        self._note(f"hear_limits {on}")

    def safe(self) -> None:
        self._note("outputs off")

    def kill(self) -> object:
        self._note("kill")
        return None

    def revive(self) -> None:
        self._note("revive")

    def watch_probe(self, on_contact: "Callable[[], None] | None", closed: bool) -> None:
        self._note(f"watch_probe {closed}")

    def limits(self) -> int:
        return self.closed_limits

    def controls(self) -> int:
        return self.active_controls

    def probe(self) -> bool:
        return self.touches

    def levels(self) -> int:
        limits = self.closed_limits << LIMITS_AT
        return self.active_controls | self.touches << PROBE_AT | limits

    def enable(self, level: int) -> None:
        self._note(f"enable {level}")

    def direction(self, level: int) -> None:
        self._note(f"direction {level}")

    def spindle(self, on: bool, power: int) -> None:
        self._note(f"spindle {on:d} {power}")

    def coolant(self, mask: int) -> None:
        self._note(f"coolant {mask}")

    def add_pins(self, outputs: "tuple[int, ...]", inputs: "tuple[int, ...]") -> None:
        self._note(f"add_pins {outputs} {inputs}")

    def drive(self, levels: int) -> None:
        self._note(f"drive {levels}")

    def pulse(self, index: int, hz: int, duty: int) -> None:
        self._note(f"pulse {index} {hz} {duty}")

    def rest(self, levels: int) -> None:
        self._note(f"rest {levels}")

    def sense(self) -> int:
        return self.sensed

    def watch_pins(self, on_change: "Callable[[], None]") -> None:
        self._note("watch_pins")

    def ticks_ms(self) -> int:
        self._ms += 1
        return self._ms

    def elapsed_ms(self, since: int) -> int:
        return self.ticks_ms() - since


class FakeVoice:
    """Record messages as words and numbers."""

    def __init__(self, asked: "Asked | None" = None) -> None:
        self.asked: Asked = [] if asked is None else asked
        self.send: "Callable[[bytes | bytearray | memoryview], None]" = self._send

    def _send(self, data: "bytes | bytearray | memoryview") -> None:
        self.asked.append(bytes(data).decode())

    def message(self, text: str) -> None:
        self.asked.append(f"message {text}")

    def alarm(self, code: int) -> None:
        self.asked.append(f"alarm {code}")

    def status(self) -> memoryview:
        return memoryview(b"<status>")

    def probe(self, probe: "array[float]") -> None:
        self.asked.append(f"probe {place(probe)}")


class FakeLink:
    """A link with bytes to be read, and a record of those sent."""

    def __init__(self, unread: bytes = b"") -> None:
        self.unread = unread
        self.sent = b""

    def read_into(self, buf: bytearray) -> int:
        count = min(len(buf), len(self.unread))
        buf[:count], self.unread = self.unread[:count], self.unread[count:]
        return count

    def write(self, data: "bytes | bytearray | memoryview") -> None:
        self.sent += bytes(data)

    def discard(self) -> None:
        self.unread = b""


class FakeStore:
    """Stored text by name. full: names for which no space is left."""

    def __init__(self, *full: str) -> None:
        self.files: "dict[str, list[str]]" = {}
        self.damaged: "dict[str, bool]" = {}
        self._full = full

    def load(self, name: str) -> "list[str] | None":
        return self.files.get(name, [])

    def save(self, name: str, lines: "Iterable[str]") -> None:
        if name in self._full:
            raise OSError(28)
        self.files[name] = list(lines)


if TYPE_CHECKING:
    _canon: Canon = FakeCanon()
    _engine: StepEngine = FakeEngine()
    _kinematics: Kinematics = FakeKinematics()
    _port: Port = FakePort()
    _voice: Voice = FakeVoice()
    _link: Link = FakeLink()
    _store: Store = FakeStore()
