"""Replay recordings of real Grbl on the rig, in virtual time, and record what is observed.

For each step, a transcript case gives the lines received, the steps moved and the outputs changed;
a motion record gives replies, step counts, times and samples. Nothing is judged here: see
tools/replay/conformance.py. Runs under CPython and MicroPython.

For a transcript, result["setup"] and result["steps"] have an observation for each step: "lines"
received, "partial": the unfinished one, "moved": steps by motor, "out": outputs that have changed,
"moving", "unpowered", "off_step". A replay that fails has "error", one that takes too long
"too_long".
"""

import sys
from array import array

from motion.layout import PARTIAL_STEP, ROW_AXES, ROW_DIRS, ROW_STRIDE, ROW_TICKS

from .engine import Switch, step_tick, steps_until
from .rig import MemoryStore, Rig
from .sender import WINDOW, Sender, TooLong, to_bytes

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Generator
    from types import ModuleType
    from typing import Any

    Json = dict[str, Any]
    Script = Generator[int | Callable[[], bool], None, None]

_OUTPUTS = ("enable_pin", "spindle_on", "spindle_pwm", "spindle_dir", "flood", "mist")
_AXES = "XYZABC"
_PEAK_INTERVALS = 16  # consecutive intervals between steps whose mean is a peak rate
_PARTIAL_STEP = 1 << 18  # a step in the units of PARTIAL_STEP
# Time limits: for the banner or a setting, and in addition to the time of a step.
_START_MS = 20_000
_SPARE_MS = 20_000
_SLOWER = 3  # a step may take so many times as long as in the recording


def describe(error: Exception) -> str:
    """Return the traceback of an exception as text."""
    if hasattr(sys, "print_exception"):
        import io

        out = io.StringIO()
        sys.print_exception(error, out)
        return out.getvalue()
    import traceback

    return "".join(traceback.format_exception(type(error), error, error.__traceback__))


# The files of each store, by the board's options, because two boards may have the same name.
_factory: "dict[str, dict[str, list[str]]]" = {}


def factory_store(board: "ModuleType") -> MemoryStore:
    """Return a new store as the firmware leaves it after its very first start on this board. That
    start is simulated once per board, and its files are copied."""
    names = [name for name in dir(board) if name.isupper()]
    options = repr([(name, board.__dict__[name]) for name in names])
    if options not in _factory:
        rig = Rig(board, MemoryStore())
        sender = Sender(rig)

        def script() -> "Script":
            sender.allow(_START_MS)
            yield from sender.wait("banner", "", settle=500)

        rig.run(script())
        _factory[options] = rig.store.files
    store = MemoryStore()
    for name, lines in _factory[options].items():
        store.files[name] = list(lines)
    return store


class _Case:
    """Replay of one transcript case."""

    def __init__(self, case: "Json", board: "ModuleType") -> None:
        self.case = case
        self.blank = case["init"] == "blank"  # the memory is erased, and the power still off
        self.rig = Rig(board, MemoryStore() if self.blank else factory_store(board), full=True)
        self.rig.engine.trace = self.note_lost_steps
        self.sender = Sender(self.rig)
        self.place = array("i", self.rig.scratch)  # steps of the motors when the step began
        self.unpowered = False  # in this step, steps were lost because motors had no power
        self.result: "Json" = {"setup": [], "steps": []}

    def run(self) -> "Json":
        """Return what was observed; an exception is part of it."""
        try:
            self.rig.run(self.script())
        except Exception as error:
            self.result["error"] = describe(error)
        return self.result

    def script(self) -> "Script":
        """Do all steps of the case, and note what each one has changed."""
        sender = self.sender
        current = None  # observations of the step that is being done
        try:
            sender.allow(_START_MS)
            if not self.blank:
                yield from sender.wait("banner", "")
            sender.take()  # drops the banner: it belongs to no step
            for part, items in (("setup", self.case["setup"]), ("steps", self.case["steps"])):
                for item in items:
                    step = item
                    if not isinstance(item, dict):  # the short form: [line, its answer]
                        step = {"send": item[0] + "\n", "wait": "ok", "t_ms": 0}
                    current = self.begin(part)
                    yield from self.step(step)
                    self.end(current)
        except TooLong:
            self.result["too_long"] = True
            self.end(current)
        except Exception as error:
            self.result["error"] = describe(error)

    def note_lost_steps(self, _start: int, row: "array[int]") -> None:
        """Note steps that are lost because motors have no power. Called by the engine for every
        segment."""
        level_without_power = 1 ^ self.rig.controller.settings.enable_invert
        if self.rig.port.enable_pin == level_without_power:
            steps = [row[ROW_AXES + ROW_STRIDE * motor] for motor in range(len(self.place))]
            self.unpowered = self.unpowered or any(steps)

    def begin(self, part: str) -> "Json":
        """Return the observations of a new step, with its initial values. part: setup or steps."""
        observed = {"lines": [], "moved": [], "out": self.outputs()}
        self.unpowered = False
        self.result[part].append(observed)
        self.rig.engine.physical(self.place)
        return observed

    def end(self, observed: "Json | None") -> None:
        """Replace the initial values in `observed` by what has changed since. None: no step has
        begun."""
        if observed is None:
            return
        observed["lines"] = self.sender.take()
        observed["partial"] = self.sender.partial()
        before = list(self.place)
        self.rig.engine.physical(self.place)  # stores the steps now
        observed["moved"] = [self.place[i] - before[i] for i in range(len(before))]
        # The exact position's distance from the closest whole step of the longest axis, in steps.
        since_step = self.rig.controller.planner.flow[PARTIAL_STEP] / _PARTIAL_STEP
        observed["off_step"] = min(since_step, 1 - since_step)
        observed["unpowered"] = self.unpowered
        observed["moving"] = self.rig.moving()
        levels = self.outputs()
        initial = observed["out"]
        changed = [name for name in _OUTPUTS if levels[name] != initial[name]]
        observed["out"] = {name: levels[name] for name in changed}

    def outputs(self) -> "dict[str, int]":
        """Return the levels of the outputs now, by name."""
        port = self.rig.port
        levels = [port.enable_pin, port.spindle_on, port.spindle_pwm, port.spindle_dir]
        levels += [port.flood, port.mist]
        return {name: int(level) for name, level in zip(_OUTPUTS, levels)}

    def step(self, step: "Json") -> "Script":
        """Do a step: switches, inputs, power, and then the bytes, until its wait has ended.

        Its keys: "send" and "wait" as for Sender.wait(), "settle_ms": silence that ends it,
        "t_ms": how long it took in the recording, "switches", "pins", "power".
        """
        rig = self.rig
        limit_ms = step.get("t_ms", 0) * _SLOWER + step.get("settle_ms", 0) + _SPARE_MS
        self.sender.allow(limit_ms)
        for row in step.get("switches", ()):
            _attach(rig, row)
        pins = step.get("pins", {})
        rig.port.push({pin: level == "closed" for pin, level in pins.items()})
        if step.get("power") == "cycle":
            if self.blank:
                self.blank = False  # the power has just come on
            else:
                rig.cycle_power()
                yield rig.now  # the rig restarts the firmware here
        yield from self.sender.wait(step["wait"], step["send"], step.get("settle_ms"))


def _attach(rig: Rig, row: "Any") -> None:
    """Give the rig a switch of a recording: pin, axis, `ge` or `le` for closed from that many
    steps on upwards or downwards, steps."""
    pin, axis, relation, steps = row
    rig.engine.switches.append(Switch(pin, _AXES.index(axis), relation == "ge", steps))
    rig.port.push({pin: False})  # it is no longer pushed by hand


class _Trace:
    """Follows the segments from the first step on: counts, times, peak rates and samples.

    dt_ms: time between two samples; each has net_steps at that moment.
    """

    def __init__(self, axes: int, tick_hz: int, dt_ms: float) -> None:
        self.first_step: "int | None" = None  # its tick; None: no step was made
        self.last_step = 0  # its tick
        self.net_steps = [0] * axes  # steps forward minus steps backward
        self.pulses = [0] * axes  # steps in both directions
        self.samples: "list[list[int]]" = []
        self._hz = tick_hz
        self._sample_ticks = int(dt_ms * tick_hz // 1000)  # between samples
        # By axis: the ticks of the last steps, and the shortest time of _PEAK_INTERVALS intervals.
        self._recent: "list[list[int]]" = [[] for _ in range(axes)]
        self._shortest: "list[int | None]" = [None] * axes

    def segment(self, start: int, row: "array[int]") -> None:
        """Follow a segment that begins at tick `start`. Called by the engine for every segment
        that has been played."""
        axes = range(len(self.net_steps))
        if self.first_step is None:
            bases = [ROW_AXES + ROW_STRIDE * i for i in axes]
            first_steps = [start + row[base + 1] for base in bases if row[base]]
            if not first_steps:
                return
            self.first_step = min(first_steps)
        self.sample_until(start + row[ROW_TICKS], start, row)
        for i in axes:
            base = ROW_AXES + ROW_STRIDE * i
            count = row[base]
            if count:
                self.net_steps[i] += -count if row[ROW_DIRS] >> i & 1 else count
                self.pulses[i] += count
                self.last_step = max(self.last_step, start + row[base + 2])
                self._follow_rate(i, start, row, base)

    def sample_until(self, tick: int, start: int = 0, row: "array[int] | None" = None) -> None:
        """Take the samples due before a tick. row: the segment that began at `start` and is not
        in net_steps yet; None: nothing moves."""
        if self.first_step is None:
            return
        due = self.first_step + len(self.samples) * self._sample_ticks
        while due < tick:
            sample = list(self.net_steps)
            if row is not None and due >= start:
                for i in range(len(sample)):
                    steps = steps_until(row, ROW_AXES + ROW_STRIDE * i, due - start)
                    sample[i] += -steps if row[ROW_DIRS] >> i & 1 else steps
            self.samples.append(sample)
            due += self._sample_ticks

    def peaks(self) -> "dict[str, float]":
        """Return the highest step rate of each axis in Hz, by letter."""
        return {
            _AXES[i]: _PEAK_INTERVALS * self._hz / ticks
            for i, ticks in enumerate(self._shortest)
            if ticks
        }

    def _follow_rate(self, axis: int, start: int, row: "array[int]", base: int) -> None:
        """Follow the peak rate of an axis through its steps in a segment, row[base] of them."""
        recent = self._recent[axis]
        shortest = self._shortest[axis]
        for index in range(row[base]):
            tick = start + step_tick(row, base, index)
            recent.append(tick)
            if len(recent) > _PEAK_INTERVALS:
                span = tick - recent.pop(0)  # of _PEAK_INTERVALS intervals
                if shortest is None or span < shortest:
                    shortest = span
        self._shortest[axis] = shortest


def _by_letter(values: "list[int]") -> "dict[str, int]":
    """Return values of axes by their letters."""
    return {_AXES[i]: value for i, value in enumerate(values)}


class _Motion:
    """Replay of one motion record."""

    def __init__(self, record: "Json", board: "ModuleType") -> None:
        self.record = record
        self.rig = Rig(board, factory_store(board), full=True)
        self.sender = Sender(self.rig)
        axes = len(self.rig.scratch)
        self.trace = _Trace(axes, self.rig.engine.tick_hz, record["samples"]["dt_ms"])
        self.result: "Json" = {"settings": [], "replies": [], "final_report": ""}

    def run(self) -> "Json":
        """Return what was observed; an exception is part of it."""
        try:
            self.rig.run(self.script())
        except Exception as error:
            self.result["error"] = describe(error)
        self.summary()
        return self.result

    def script(self) -> "Script":
        """Set the settings, run the program, ask for a report."""
        record = self.record
        sender = self.sender
        rig = self.rig
        try:
            sender.allow(_START_MS)
            yield from sender.wait("banner", "")
            sender.take()
            for row in record.get("switches", ()):
                _attach(rig, row)
            rig.port.update()
            for line in record["settings"]:
                sender.allow(_START_MS)
                yield from sender.wait("ok", line + "\n")
                self.result["settings"].extend(sender.take())
            rig.engine.trace = self.trace.segment
            sender.allow(record["duration_s"] * 1000 * _SLOWER + _SPARE_MS)
            yield from self.program()
            self.result["replies"] = sender.take()
            yield from sender.wait("report", "?")
            self.result["final_report"] = "\n".join(sender.take())
        except TooLong:
            self.result["too_long"] = True
            self.result["replies"].extend(sender.take())
        except Exception as error:
            self.result["error"] = describe(error)

    def program(self) -> "Script":
        """Stream the program by character counting, send the events at their times, wait for the
        end of motion."""
        rig = self.rig
        sender = self.sender
        lines = [line + "\n" for line in self.record["program"]]
        # (ms after the first step, text to send), in order.
        events = list(self.record.get("events_ms_after_first_step", ()))
        sent = 0  # number of lines
        unanswered: "list[int]" = []  # lengths of the lines sent and not answered
        answered = 0  # number of lines
        while sent < len(lines) or unanswered or events:
            sender.poll()
            while answered < sender.answers and unanswered:
                unanswered.pop(0)
                answered += 1
            while sent < len(lines) and sum(unanswered) + len(lines[sent]) <= WINDOW:
                rig.link.send(to_bytes(lines[sent]))
                unanswered.append(len(lines[sent]))
                sent += 1
            wake = rig.ms(1)  # tick of the next turn of this loop
            if events and self.trace.first_step is not None:
                due = self.trace.first_step + int(events[0][0] * rig.ticks_per_ms)
                if due <= rig.now:
                    rig.link.send(to_bytes(events.pop(0)[1]))
                    continue
                wake = min(wake, due)
            if rig.now >= sender.deadline:
                raise TooLong()
            yield wake
        yield from sender.wait("idle", "", settle=100)

    def summary(self) -> None:
        """Put the counts, samples and rates of the motion into the result."""
        trace = self.trace
        result = self.result
        trace.sample_until(self.rig.now)
        result["net_steps"] = _by_letter(trace.net_steps)
        result["pulses"] = _by_letter(trace.pulses)
        result["samples"] = trace.samples
        result["peak_step_rate_hz"] = trace.peaks()
        result["duration_s"] = 0
        if trace.first_step is not None:
            result["duration_s"] = (trace.last_step - trace.first_step) / self.rig.engine.tick_hz


def replay(case: "Json", board: "ModuleType") -> "Json":
    """Replay a transcript case or a motion record; the board is a module as in boards/."""
    if "program" in case:
        return _Motion(case, board).run()
    return _Case(case, board).run()
