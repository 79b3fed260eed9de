"""The wiring diagram: makes every object and says who gets whom. Start reading here."""

from array import array

import errors
import spindle as sp
import state as st
from axes import TOOL_LENGTH
from block import Block
from commands import Commands
from coolant import Coolant
from coords import Coords
from cycles import Cycles
from errors import Abort
from gcode import Gcode
from inputs import Inputs
from lines import LineReader
from micropython import const
from motion import Motion
from planner import Planner
from protocol import Protocol
from realtime import Realtime
from report import Report
from segments import Segments
from settings import Settings
from spindle import Spindle
from state import State
from suspension import Suspension
from words import Words

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import ModuleType
    from typing import Any

    from interfaces import Link, Port, StepEngine, Store

_DEFAULT_BLOCKS = const(16)
_DEFAULT_RX_BYTES = const(128)
_LINE_LENGTH = const(79)


class Options:
    """What a board file may say, with what holds where it says nothing.

    The comment above an option is its documentation.
    """

    def __init__(self, board: "ModuleType") -> None:
        def option(name: str, default: "Any") -> "Any":
            return getattr(board, name, default)

        # Step pins, one per axis: how many there are is how many axes the machine has.
        self.axes: int = len(option("STEP", ()))
        # Blocks the planner looks ahead.
        self.blocks: int = option("PLANNER_BLOCKS", _DEFAULT_BLOCKS)
        # Receive buffer: what a sender that counts characters may have under way.
        self.rx_bytes: int = option("RX_BYTES", _DEFAULT_RX_BYTES)
        # Default settings that differ from Grbl's, as {number: value}.
        self.defaults: "dict[int, float]" = option("DEFAULTS", {})
        # Motors A and B move X and Y together (CoreXY).
        self.corexy: bool = option("COREXY", False)
        # A safety door is wired to the door input.
        self.door: bool = option("SAFETY_DOOR", False)
        # Door and sleep move the tool up to -5 mm and back. Needs homing.
        self.parking: bool = option("PARKING", False)
        # M56 switches parking off and on.
        self.override_control: bool = option("OVERRIDE_CONTROL", False)
        # N of the line being executed is in status reports.
        self.line_numbers: bool = option("LINE_NUMBERS", False)
        # A mist output: M7 and its override.
        self.mist: bool = option("MIST", False)
        # Homing sets 0 at the switch's pull-off; travel is positive where $23 is set.
        self.zero_origin: bool = option("FORCE_SET_ORIGIN", False)
        # $HX, $HY and $HZ home one axis.
        self.single_axis_homing: bool = option("SINGLE_AXIS_HOMING", False)
        # The spindle direction pin says that the spindle is on.
        self.enable_pin: bool = option("SPINDLE_ENABLE_PIN", False)
        # Both ends of an axis share its limit input: no homing from a closed switch.
        self.shared_switches: bool = option("DUAL_LIMIT_SWITCHES", False)
        # Highest step rate; $100-$112 that ask for more are refused with error:12.
        self.max_step_hz: int = option("MAX_STEP_RATE_HZ", 0)
        # Every line is echoed as it was understood, for debugging.
        self.echo: bool = option("ECHO", False)
        # Whose words it uses: "1.1", or "0.9", "0.9i" and "0.9j" for senders older than that.
        self.dialect: str = option("DIALECT", "1.1")
        # What works on the material: "spindle", a laser too, or "punch", see docs/punch.md.
        self.tool: str = option("TOOL", "spindle")
        self.reports = _reports(self.dialect)
        self.parts = _parts(self.tool, board, self.reports)

    def letters(self) -> str:
        """The text of [OPT:…]: Grbl's letters for what is on, planner blocks, receive bytes."""
        text = "V"
        for on, letter in (
            (self.line_numbers, "N"),
            (self.mist, "M"),
            (self.corexy, "C"),
            (self.parking, "P"),
            (self.zero_origin, "Z"),
            (self.single_axis_homing, "H"),
            (self.shared_switches, "T"),
            (self.override_control, "R"),
            (self.enable_pin, "D"),
            (self.door, "+"),
        ):
            if on:
                text += letter
        return "%s,%d,%d" % (text, self.blocks - 1, self.rx_bytes)


def _reports(dialect: str) -> "type[Report]":
    """What speaks that dialect. Raises ValueError where nothing does."""
    if dialect == "1.1":
        return Report
    import report_09

    return report_09.find(dialect)


def _parts(tool: str, board: "ModuleType", reports: "type[Report]") -> "Any":
    """What that tool is made of. Raises ValueError where it cannot be."""
    if tool == "spindle":
        return Spindle, Gcode, Realtime, reports.SETTINGS
    import punch

    return punch.find(tool, board, reports)


class Controller:
    """The machine. Made by build()."""

    def __init__(
        self, options: Options, link: "Link", port: "Port", engine: "StepEngine", store: "Store"
    ) -> None:
        axes = options.axes
        self.options = options
        self.port = port
        self.engine = engine
        self.state = State()
        self.settings = Settings(store, axes, options.defaults, *options.parts[3])
        self.settings.max_step_hz = options.max_step_hz
        self.coords = Coords(store, axes, TOOL_LENGTH)
        self.planner = Planner(axes, options.blocks, options.corexy, self.state)
        self.segments = Segments(self.planner)
        self.spindle = options.parts[0](port, self.state, options.enable_pin)
        self.coolant = Coolant(port, self.state)
        self.inputs = Inputs(port, axes, options.door)
        self.report = options.reports(
            link, self.state, self.settings, self.coords, axes, options.line_numbers
        )
        self._make_language()
        self._make_states()
        self._make_commands(store)
        self.reader = LineReader(
            options.rx_bytes,
            _LINE_LENGTH,
            self.realtime.post,
            options.reports.READS,
        )
        self.protocol = Protocol(link, self.state, self.reader, self.report, options.echo)
        self._steps = array("i", (0 for _ in range(axes)))
        self._connect()

    def _make_language(self) -> None:
        """G-code, and what it may ask of the machine."""
        options = self.options
        self.motion = Motion(
            self.state,
            self.settings,
            self.planner,
            self.spindle,
            self.coolant,
            self.port,
            options.zero_origin,
        )
        self.cycles = Cycles(
            self.state,
            self.settings,
            self.engine,
            self.planner,
            self.inputs,
            self.port,
            self.report,
            options.zero_origin,
            options.shared_switches,
        )
        self.gcode = options.parts[1](
            options.axes,
            self.state,
            self.settings,
            self.coords,
            self.motion,
            self.cycles,
            self.spindle,
            self.report,
            Block(
                options.axes,
                options.mist,
                options.override_control,
                options.reports.HIGHEST_TOOL,
            ),
            options.line_numbers,
            options.override_control,
        )

    def _make_states(self) -> None:
        """The run states and what moves the machine between them."""
        self.realtime = self.options.parts[2](
            self.state,
            self.settings,
            self.engine,
            self.planner,
            self.segments,
            self.spindle,
            self.coolant,
            self.inputs,
            self.report,
            self.options.mist,
        )
        self.suspension = Suspension(
            self.state,
            self.settings,
            self.engine,
            self.planner,
            self.segments,
            self.spindle,
            self.coolant,
            self.inputs,
            self.report,
            self.options.parking,
        )

    def _make_commands(self, store: "Store") -> None:
        self.commands = Commands(
            self.state,
            self.settings,
            self.coords,
            store,
            self.report,
            self.gcode,
            self.cycles,
            self.inputs,
            Words(),
            self.options.letters(),
            self.options.single_axis_homing,
        )

    def _connect(self) -> None:
        """Hand those above to those below who wait for them or report on them."""
        pump = self.protocol.pump
        self.report.connect(
            self.engine,
            self.planner,
            self.segments,
            self.inputs,
            self.spindle,
            self.coolant,
            self.reader.free,
            self.position,
        )
        self.motion.connect(self.protocol.service, self.realtime)
        self.cycles.connect(self.motion, self.realtime, pump, self.position, self.resync)
        self.realtime.connect(self.port, pump, self.gcode, self.resync, self.suspension)
        self.suspension.connect(self.realtime, self.gcode, self.pause_ms, self.position)
        self.commands.connect(self.realtime, self.motion, self.configure, self.protocol.execute)
        self.protocol.connect(self.realtime, self.gcode, self.commands, self.motion)

    # Positions: machine (steps really made) -> planner -> parser

    def position(self, mm: "array[float]") -> None:
        """Copy the machine position, in mm."""
        self.engine.position(self._steps)
        self.planner.to_mm(self._steps, mm)

    def resync(self) -> None:
        """Plan and interpret from where the machine really is."""
        self.engine.position(self._steps)
        self.planner.sync_motors(self._steps)
        self.planner.to_mm(self._steps, self.gcode.position)

    def pause_ms(self, milliseconds: int, until: "Callable[[], bool]") -> None:
        """Wait in a suspension: real-time commands act, lines do not."""
        since = self.port.ticks_ms()
        while self.port.elapsed_ms(since) < milliseconds and not until():
            self.protocol.pump()
            self.realtime.events()

    # Settings

    def configure(self, number: int) -> None:
        """A setting has changed: tell those who have worked something out from it."""
        settings = self.settings
        engine = self.engine
        engine.configure(settings.step_pulse_us, settings.step_invert, settings.dir_invert)
        self.inputs.configure(settings)
        self.planner.configure(
            settings,
            engine.tick_hz,
            engine.segment_log2,
            engine.max_step_hz(settings.step_pulse_us),
        )
        self.spindle.configure(settings, self.planner.machine)
        if number in (30, 31):
            self.spindle.stop()
        if number in (10, 13):
            self.state.wco_countdown = 0

    # Life

    def run(self) -> None:
        """From power up, for ever."""
        self._power_up()
        while True:
            self._reset()
            self.realtime.settle()
            try:
                self._greet()
                self.protocol.run()
            except Abort:
                continue

    def _power_up(self) -> None:
        self.engine.attach(self.segments.next, self.spindle.set_power)
        if not self.settings.load():
            # As Grbl: say so, show what holds now.
            self.report.error(errors.SETTING_READ_FAIL)
            self.coords.restore()
            self.commands.show_settings()
        self.commands.load()
        self.coords.load()
        self.configure(0)
        self.port.attach(self.realtime.on_limits, self.realtime.on_controls)
        if self.settings.homing:
            self.state.run = st.ALARM
        self.realtime.power(True)

    def _reset(self) -> None:
        state = self.state
        state.clear()
        state.pending[:] = bytes(len(state.pending))
        state.alarm = 0
        self.engine.stop()
        self.reader.clear()
        self.coords.clear()
        self.gcode.reset()
        self.planner.clear()
        self.planner.override()
        self.segments.clear()
        self.spindle.turn(sp.OFF, 0.0)
        self.coolant.set(0)
        self.port.watch_probe(None, False)
        self.cycles.forget_probe()
        self.realtime.release()
        self.resync()
        state.override_countdown = 0

    def _greet(self) -> None:
        state = self.state
        self.report.banner()
        if self.settings.hard_limits and self.inputs.limits():
            state.run = st.ALARM
            self.report.message(errors.MSG_CHECK_LIMITS)
        if state.run & (st.ALARM | st.SLEEP):
            self.report.message(errors.MSG_ALARM_LOCK)
            state.run = st.ALARM
            return
        state.run = st.IDLE
        if self.inputs.door_open():
            state.post(st.SAFETY_DOOR)
            self.realtime.run()
        self.commands.run_startup()


def build(
    board: "ModuleType", link: "Link", port: "Port", engine: "StepEngine", store: "Store"
) -> Controller:
    """Make a machine of a board file and its hardware."""
    return Controller(Options(board), link, port, engine, store)
