"""The wiring diagram: makes every object and says who gets whom. Start reading here.

Nothing here is used once the machine is built: a board forgets this module then.
"""

from base.axes import TOOL_LENGTH
from base.settings import Settings
from base.state import State
from boot.controller import Controller
from control.canon import Motion
from control.coolant import Coolant
from control.coords import Coords
from control.inputs import Inputs
from control.overrides import Overrides
from control.realtime import Realtime
from control.saves import Saves
from control.seek import Cycles
from control.spindle import Spindle
from control.suspension import Suspension
from language.block import Block
from language.interpreter import Gcode
from micropython import const
from motion.planner import Planner
from motion.segments import Segments
from talk.commands import Commands
from talk.lines import LineReader
from talk.protocol import Protocol
from talk.report import Report

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
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
        option = board.__dict__.get  # getattr() would keep the names for good

        # Step pins, one per axis: how many there are is how many axes the machine has.
        self.axes: int = len(option("STEP", ()))
        # Who makes the pulses: "pio" (RP2040, RP2350), "rmt" or "i2s" (ESP32). $I says so.
        self.engine: str = option("ENGINE", "")
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

    def identity(self) -> str:
        """What [VER:…] says of us: "Grbl" for senders, the rest for `ugrbl doctor`."""
        rate = "%dHz" % self.max_step_hz if self.max_step_hz else ""
        return " ".join([word for word in ("Grbl", self.engine, rate) if word])

    def letters(self) -> str:
        """The text of [OPT:…]: Grbl's letters for what is on, planner blocks, receive bytes."""
        text = bytearray(b"V")  # a text of one letter would be kept for good
        for on, letter in zip(
            (
                self.line_numbers,
                self.mist,
                self.corexy,
                self.parking,
                self.zero_origin,
                self.single_axis_homing,
                self.shared_switches,
                self.override_control,
                self.enable_pin,
                self.door,
            ),
            b"NMCPZHTRD+",
        ):
            if on:
                text.append(letter)
        return "%s,%d,%d" % (text.decode(), self.blocks - 1, self.rx_bytes)


def _reports(dialect: str) -> "type[Report]":
    """What speaks that dialect. Raises ValueError where nothing does."""
    if dialect == "1.1":
        return Report
    from extras import dialect_09 as report_09

    return report_09.find(dialect)


def _parts(tool: str, board: "ModuleType", reports: "type[Report]") -> "Any":
    """What that tool is made of. Raises ValueError where it cannot be."""
    if tool == "spindle":
        return Spindle, Gcode, Realtime, reports.SETTINGS
    from extras import punch

    return punch.find(tool, board, reports)


def build(
    board: "ModuleType", link: "Link", port: "Port", engine: "StepEngine", store: "Store"
) -> Controller:
    """Make a machine of a board file and its hardware."""
    options = Options(board)
    machine = Controller(options.axes)
    machine.port = port
    machine.engine = engine
    machine.saves = Saves(store)
    _make_basics(machine, options)
    _make_reports(machine, options, link)
    _make_language(machine, options)
    _make_states(machine, options)
    _make_commands(machine, options)
    _make_protocol(machine, options, link)
    _connect(machine)
    return machine


def _make_basics(machine: Controller, options: Options) -> None:
    """What the machine is, what it has planned, what it switches."""
    axes, port, state = options.axes, machine.port, State()
    machine.state = state
    machine.settings = Settings(machine.saves, axes, options.defaults, *options.parts[3])
    machine.settings.max_step_hz = options.max_step_hz
    machine.coords = Coords(machine.saves, axes, TOOL_LENGTH)
    machine.planner = Planner(axes, options.blocks, options.corexy, state)
    machine.segments = Segments(machine.planner)
    machine.spindle = options.parts[0](port, state, options.enable_pin)
    machine.coolant = Coolant(port, state)
    machine.inputs = Inputs(port, machine.settings, axes, options.door)


def _make_reports(machine: Controller, options: Options, link: "Link") -> None:
    """Whatever is said."""
    machine.report = options.reports(
        link,
        machine.state,
        machine.settings,
        machine.coords,
        options.axes,
        options.line_numbers,
    )
    machine.report.identity = options.identity()


def _make_language(machine: Controller, options: Options) -> None:
    """G-code, and what it may ask of the machine."""
    machine.motion = Motion(
        machine.state,
        machine.settings,
        machine.planner,
        machine.spindle,
        machine.coolant,
        machine.port,
        options.zero_origin,
    )
    machine.cycles = Cycles(
        machine.state,
        machine.settings,
        machine.engine,
        machine.planner,
        machine.inputs,
        machine.port,
        machine.report,
        options.zero_origin,
        options.shared_switches,
    )
    machine.gcode = options.parts[1](
        options.axes,
        machine.state,
        machine.settings,
        machine.coords,
        machine.motion,
        machine.cycles,
        machine.spindle,
        machine.report,
        Block(
            options.axes,
            options.mist,
            options.override_control,
            options.reports.HIGHEST_TOOL,
        ),
        options.line_numbers,
        options.override_control,
    )


def _make_states(machine: Controller, options: Options) -> None:
    """The run states and what moves the machine between them."""
    overrides = Overrides(
        machine.state,
        machine.planner,
        machine.spindle,
        machine.coolant,
        machine.gcode,
        options.mist,
    )
    machine.overrides = overrides
    machine.realtime = options.parts[2](
        machine.state,
        machine.settings,
        machine.engine,
        machine.planner,
        machine.segments,
        machine.spindle,
        machine.coolant,
        machine.report,
        overrides,
    )
    machine.suspension = Suspension(
        machine.state,
        machine.settings,
        machine.engine,
        machine.planner,
        machine.segments,
        machine.spindle,
        machine.coolant,
        machine.inputs,
        machine.report,
        options.parking,
    )


def _make_commands(machine: Controller, options: Options) -> None:
    machine.commands = Commands(
        machine.state,
        machine.settings,
        machine.coords,
        machine.saves,
        machine.report,
        machine.gcode,
        machine.cycles,
        machine.inputs,
        options.letters(),
        options.single_axis_homing,
    )


def _make_protocol(machine: Controller, options: Options, link: "Link") -> None:
    """The way of a byte to its answer."""
    machine.reader = LineReader(
        options.rx_bytes,
        _LINE_LENGTH,
        machine.realtime.post,
        options.reports.READS,
    )
    machine.protocol = Protocol(
        link, machine.state, machine.reader, machine.report, machine.saves, options.echo
    )


def _connect(machine: Controller) -> None:
    """Hand those above to those below who wait for them or report on them."""
    pump = machine.protocol.pump
    gcode, motion, realtime = machine.gcode, machine.motion, machine.realtime
    position, resync = machine.position, machine.resync
    machine.report.connect(
        machine.engine,
        machine.planner,
        machine.segments,
        machine.inputs,
        machine.spindle,
        machine.coolant,
        machine.reader.free,
        position,
    )
    motion.connect(machine.protocol.service, realtime)
    machine.cycles.connect(motion, realtime, pump, position, resync)
    realtime.connect(machine.port, pump, resync, machine.suspension)
    machine.suspension.connect(realtime, machine.overrides, gcode, machine.port, position)
    machine.commands.connect(realtime, motion, machine.protocol.execute)
    machine.protocol.connect(realtime, gcode, machine.commands, motion, machine.restart)
    for callback in (
        machine.configure,
        machine.inputs.configure,
        motion.configure,
        gcode.plain.forget,
    ):
        machine.settings.on_change(callback)
