"""The wiring diagram: makes every object and says who gets whom. Start reading here.

Nothing here is used once the machine is built: a board forgets this module then.
"""

from base.axes import TOOL_LENGTH
from base.settings import Settings
from base.state import State
from control.canon import Canon
from control.coolant import Coolant
from control.coords import Coords
from control.drive import Drive
from control.inputs import Inputs
from control.modes import Modes
from control.overrides import Overrides
from control.realtime import Realtime
from control.saves import Saves
from control.seek import Seek
from control.spindle import Spindle
from control.suspension import Suspension
from language.block import Block
from language.interpreter import Interpreter
from micropython import const
from motion.planner import Planner
from motion.segments import Segments
from talk.commands import Commands
from talk.lines import LineReader
from talk.protocol import Protocol
from talk.report import Report

from boot.controller import Controller

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
        self.install: "Callable[[Controller], None] | None" = None
        if self.tool == "punch":
            from extras import punch

            self.install = punch.install

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
        return Spindle, Interpreter, Drive, reports.SETTINGS
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
    _make_motion(machine, options)
    _make_states(machine, options)
    _make_language(machine, options)
    _make_talk(machine, options, link)
    _connect(machine)
    if options.install:
        options.install(machine)
    return machine


def _make_basics(machine: Controller, options: Options) -> None:
    """What the machine is, what it has planned, what it switches."""
    axes, port, state = options.axes, machine.port, State()
    machine.state = state
    machine.settings = Settings(machine.saves, axes, options.defaults, *options.parts[3])
    machine.settings.max_step_hz = options.max_step_hz
    machine.coords = Coords(machine.saves, axes, TOOL_LENGTH)
    machine.modes = Modes(axes)
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


def _make_motion(machine: Controller, options: Options) -> None:
    """What sets the machine in motion, and what may be asked of it."""
    machine.drive = options.parts[2](
        machine.state,
        machine.settings,
        machine.engine,
        machine.planner,
        machine.segments,
        machine.spindle,
        machine.coolant,
        machine.port,
        machine.report,
    )
    machine.canon = Canon(
        machine.state,
        machine.settings,
        machine.planner,
        machine.spindle,
        machine.coolant,
        machine.drive,
        machine.port,
        options.zero_origin,
    )
    machine.seek = Seek(
        machine.state,
        machine.settings,
        machine.engine,
        machine.planner,
        machine.inputs,
        machine.port,
        machine.report,
        machine.canon,
        machine.drive,
        machine.position,
        machine.resync,
        options.zero_origin,
        options.shared_switches,
    )


def _make_states(machine: Controller, options: Options) -> None:
    """The run states and what moves the machine between them."""
    machine.overrides = Overrides(
        machine.state,
        machine.planner,
        machine.spindle,
        machine.coolant,
        machine.modes,
        options.mist,
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
        machine.port,
        machine.modes,
        machine.overrides,
        machine.drive,
        machine.report,
        machine.position,
        options.parking,
    )
    machine.realtime = Realtime(
        machine.state,
        machine.planner,
        machine.segments,
        machine.port,
        machine.drive,
        machine.overrides,
        machine.suspension,
        machine.report,
        machine.resync,
    )


def _make_language(machine: Controller, options: Options) -> None:
    """G-code."""
    machine.interpreter = options.parts[1](
        machine.modes,
        machine.state,
        machine.settings,
        machine.coords,
        machine.canon,
        machine.seek,
        machine.spindle,
        machine.report,
        Block(
            options.axes,
            options.mist,
            options.override_control,
            options.reports.HIGHEST_TOOL,
        ),
        options.line_numbers,
    )


def _make_talk(machine: Controller, options: Options, link: "Link") -> None:
    """The way of a byte to its answer."""
    machine.commands = Commands(
        machine.state,
        machine.settings,
        machine.coords,
        machine.saves,
        machine.report,
        machine.modes,
        machine.interpreter,
        machine.canon,
        machine.seek,
        machine.drive,
        machine.inputs,
        options.letters(),
        options.single_axis_homing,
        options.override_control,
    )
    machine.reader = LineReader(
        options.rx_bytes,
        _LINE_LENGTH,
        machine.realtime.post,
        options.reports.READS,
    )
    machine.protocol = Protocol(
        link,
        machine.state,
        machine.reader,
        machine.report,
        machine.saves,
        machine.realtime,
        machine.drive,
        machine.interpreter,
        machine.commands,
        machine.canon,
        machine.restart,
        options.echo,
    )


def _connect(machine: Controller) -> None:
    """Hand those above to those below who wait for them or report on them."""
    machine.report.connect(
        machine.engine,
        machine.planner,
        machine.segments,
        machine.inputs,
        machine.spindle,
        machine.coolant,
        machine.reader.free,
        machine.position,
    )
    machine.drive.connect(machine.protocol.pump)
    machine.canon.connect(machine.protocol.service)
    machine.commands.connect(machine.protocol.execute)
    for callback in (
        machine.configure,
        machine.inputs.configure,
        machine.canon.configure,
        machine.state.change,
    ):
        machine.settings.on_change(callback)
