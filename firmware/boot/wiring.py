"""The wiring diagram: creates every object and connects them. Start reading here.

This module is not used once the machine is built: a board forgets it then.
"""

from base.axes import TOOL_LENGTH
from base.state import State
from control.coolant import Coolant
from control.coords import Coords
from control.modes import Modes
from control.motor_control import MotorControl
from control.overrides import Overrides
from control.realtime import Realtime
from control.saves import Saves
from control.suspension import Suspension
from language.block import Block
from language.interpreter import Interpreter
from micropython import const
from motion.segments import Segments
from talk.commands import Commands
from talk.controller import Controller
from talk.lines import LineReader
from talk.protocol import Protocol

from boot.options import Options

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array
    from types import ModuleType

    from interfaces import Link, Port, StepEngine, Store

# cncjs 1.11 counts each resume as an answer, and sends up to 198 bytes for 128.
_MISCOUNTED = const(128)  # bytes that may be received beyond those advertised


def build(
    board: "ModuleType",
    link: "Link",
    port: "Port",
    engine: "StepEngine",
    store: "Store",
    ring: "array[int] | None" = None,
) -> Controller:
    """Build a machine from a board file and its hardware, with its extras. link: to the sender;
    port: pins other than the motors'; engine: generates steps; store: saves to flash; ring: the
    planner's memory, if it is allocated already. ValueError if an option or an extra is
    impossible."""
    options = Options(board)
    machine = Controller(options.motors)
    machine.port = port
    machine.engine = engine
    machine.saves = Saves(store)
    _make_basics(machine, options, ring)
    _make_reports(machine, options, link)
    _make_motion(machine, options)
    _make_states(machine, options)
    _make_language(machine, options)
    _make_talk(machine, options, link)
    _connect(machine)
    # These write flash themselves, and call the store's before() and after().
    if options.job_files:
        options.job_files.connect(store, link)
    if options.power_input:
        options.power_input.pages.connect(store)
    if options.extras:
        from extras.api import Cnc

        cnc = Cnc(machine)
        for extra in options.extras:
            extra.install(cnc)
    return machine


def _make_basics(machine: Controller, options: Options, ring: "array[int] | None") -> None:
    """Create settings, coordinates, planner, spindle, coolant and inputs."""
    axes, port, state = options.axes, machine.port, State()
    machine.state = state
    machine.settings = options.settings(machine.saves, axes, options.defaults)
    machine.settings.max_step_hz = options.max_step_hz
    machine.settings.step_pulse_min_us = options.step_pulse_min_us
    machine.coords = Coords(machine.saves, axes, TOOL_LENGTH)
    machine.modes = Modes(axes)
    machine.planner = options.planner(axes, options.blocks, options.kinematics, state, ring)
    machine.segments = Segments(machine.planner)
    machine.spindle = options.spindle(port, state, options.enable_pin)
    machine.coolant = Coolant(port, state)
    machine.inputs = options.inputs(port, machine.settings, axes, options.door)


def _make_reports(machine: Controller, options: Options, link: "Link") -> None:
    """Create the reports."""
    machine.report = options.report(
        link,
        machine.state,
        machine.settings,
        machine.coords,
        options.axes,
        options.line_numbers,
    )
    machine.report.identity = options.identity()


def _make_motion(machine: Controller, options: Options) -> None:
    """Create what executes motion: motor control, canon, homing and probing."""
    machine.motor_control = MotorControl(machine)
    machine.canon = options.canon(machine, options.zero_origin)
    machine.homing_probing = options.homing_probing(
        machine, options.zero_origin, options.shared_switches
    )


def _make_states(machine: Controller, options: Options) -> None:
    """Create the run states: overrides, suspension and real-time commands."""
    machine.overrides = Overrides(
        machine.state,
        machine.planner,
        machine.spindle,
        machine.coolant,
        machine.modes,
        options.mist,
    )
    machine.suspension = Suspension(machine, options.parking)
    machine.realtime = Realtime(machine)


def _make_language(machine: Controller, options: Options) -> None:
    """Create the G-code parser and interpreter."""
    block = Block(
        options.axis_letters[: options.axes],
        options.mist,
        options.override_control,
        options.highest_tool,
        options.line_length,
    )
    machine.interpreter = Interpreter(machine, block, options.line_numbers)


def _make_talk(machine: Controller, options: Options, link: "Link") -> None:
    """Create the path of a byte to its answer: commands, line reader, protocol."""
    machine.commands = Commands(
        machine,
        options.letters(),  # of [OPT:…]
        options.single_axis_homing,
        options.override_control,
    )
    machine.reader = LineReader(
        options.rx_bytes,
        options.line_length,
        machine.realtime.post,
        options.reads,  # which bytes are real-time ones: see lines.READS
        _MISCOUNTED,
    )
    machine.protocol = Protocol(machine, link, options.echo)


def _connect(machine: Controller) -> None:
    """Connect lower modules to the higher ones that they wait for or report to."""
    machine.report.connect(machine)
    # The machine's own functions, which an extra may replace later.
    hooks = machine.state.hooks
    hooks.execute, hooks.find_command = machine.interpreter.execute, machine.commands.find_command
    hooks.refuse, hooks.alarm = machine.report.error, machine.report.alarm
    hooks.write_offsets = machine.coords.write
    cycles = machine.homing_probing
    hooks.probe, hooks.probed_at = cycles.probe, cycles.probe_position
    hooks.forget = cycles.forget_probe
    hooks.home, hooks.find_switches, hooks.home_phase = (
        cycles.home,
        cycles.find_switches,
        cycles.home_phase,
    )
    hooks.next_segment = machine.segments.next
    machine.motor_control.connect(machine.protocol.pump)
    machine.canon.connect(machine.protocol.service)
    machine.commands.connect(machine.protocol.execute)
    # Called in this order after a change of settings.
    for callback in (
        machine.configure,
        machine.inputs.configure,
        machine.canon.configure,
        machine.report.configure,
        machine.state.invalidate_lines,
    ):
        machine.settings.on_change(callback)
