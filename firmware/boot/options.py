"""Options: what a board file may set, and the defaults.

tools/boardfile/options.py lists every option with its meaning. This module is not used once the
machine is built: a board forgets it then.
"""

from base.settings import Settings
from base.text import text_of
from control.canon import Canon
from control.homing_probing import HomingProbing
from control.inputs import Inputs
from control.spindle import Spindle
from language.block import VALUE_LETTERS
from language.block_layout import HIGHEST_TOOL
from language.words import LINE_LENGTH
from micropython import const
from motion.planner import Planner
from talk.lines import READS
from talk.report import Report

from boot import select_extras

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType

    from interfaces import DriverWire, Kinematics
    from ports.power_input import PowerInput
    from ports.storage.job_files import JobFiles


class Options:
    """The options that wiring.py reads. An extra's prepare() may replace any of them. Raises
    ValueError if an extra is impossible."""

    def __init__(self, board: "ModuleType") -> None:
        option = board.__dict__.get  # getattr() would intern the names for good

        self.axes: int = len(option("STEP", ()))
        self.axis_letters = VALUE_LETTERS  # the machine has the first ones
        self.motors = self.axes
        self.engine: str = option("ENGINE", "")
        self.blocks: int = option("PLANNER_BLOCKS", 16)
        self.rx_bytes: int = option("RX_BYTES", 128)
        self.defaults: "dict[int, float]" = option("DEFAULTS", {})
        self.corexy: bool = option("COREXY", False)
        self.kinematics: "Kinematics | None" = None
        if self.corexy:
            from motion import kinematics

            self.kinematics = kinematics.Kinematics(self.axes, kinematics.COREXY)
        self.door: bool = option("SAFETY_DOOR", False)
        self.parking: bool = option("PARKING", False)
        self.override_control: bool = option("OVERRIDE_CONTROL", False)
        self.line_numbers: bool = option("LINE_NUMBERS", False)
        self.mist: bool = option("MIST", False)
        self.zero_origin: bool = option("FORCE_SET_ORIGIN", False)
        self.single_axis_homing: bool = option("SINGLE_AXIS_HOMING", False)
        self.enable_pin: bool = option("SPINDLE_ENABLE_PIN", False)
        self.shared_switches: bool = option("DUAL_LIMIT_SWITCHES", False)
        self.max_step_hz: int = option("MAX_STEP_RATE_HZ", 0)
        self.step_pulse_min_us: int = option("STEP_PULSE_MIN_US", 3)
        self.echo: bool = option("ECHO", False)
        self.custom = select_extras.custom_modules(board)
        self.job_files: "JobFiles | None" = None
        self.driver_wire: "DriverWire | None" = None
        self.power_input: "PowerInput | None" = None
        self._hardware(board)
        self.extras = select_extras.import_extras(
            select_extras.extra_names(board, bool(self.custom))
        )
        self.settings: "type[Settings]" = Settings
        self.inputs: "type[Inputs]" = Inputs
        self.homing_probing: "type[HomingProbing]" = HomingProbing
        self.planner: "type[Planner]" = Planner
        self.canon: "type[Canon]" = Canon
        self.report: "type[Report]" = Report
        self.spindle: "type[Spindle]" = Spindle
        self.reads = READS  # real-time bytes, and what a line too long becomes
        self.highest_tool = HIGHEST_TOOL
        self.line_length = LINE_LENGTH
        for extra in self.extras:
            select_extras.check_excluded(extra, board)
            if hasattr(extra, "prepare"):
                extra.prepare(self, board)

    def _hardware(self, board: "ModuleType") -> None:
        """Create hardware that extras use: the files of jobs, the motor drivers' serial line, the
        input of the supply's monitor."""
        option = board.__dict__.get
        if option("JOBS", ""):
            from ports.storage import job_files

            self.job_files = job_files.of_board(board)
        if option("TMC2209", ()):
            from ports import driver_wire

            self.driver_wire = driver_wire.of_board(board)
        if option("POWER_FAIL", None) is not None:
            from ports import power_input

            self.power_input = power_input.of_board(board)

    def identity(self) -> str:
        """Return the name in the answer to $I: "Grbl" for senders, then engine and step rate for
        `ugrbl doctor`."""
        rate = "%dHz" % self.max_step_hz if self.max_step_hz else ""
        return " ".join([word for word in ("Grbl", self.engine, rate) if word])

    def letters(self) -> str:
        """Return the text of [OPT:…]: Grbl's letters of enabled options, planner blocks, receive
        bytes."""
        # Bytes, because texts of one letter would be interned for good. V is always reported.
        text = bytearray(b"V")
        for is_on, letter in zip(
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
            if is_on:
                text.append(letter)
        # Grbl reports one block less than its ring has, because one always stays free.
        return "%s,%d,%d" % (text_of(text), self.blocks - 1, self.rx_bytes)
