"""Options: what a board file may say, with what holds where it says nothing.

Nothing here is used once the machine is built: a board forgets this module then.
"""

from control.spindle import Spindle
from language.block import HIGHEST_TOOL
from micropython import const
from talk.lines import READS
from talk.report import Report

from boot import guests

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType

_DEFAULT_BLOCKS = const(16)
_DEFAULT_RX_BYTES = const(128)


class Options:
    """The comment above an option is its documentation. Raises ValueError where it cannot be."""

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
        # What an extra may have otherwise, before the machine is made: prepare().
        self.extras = guests.modules(board)
        self.report: "type[Report]" = Report
        self.spindle: "type[Spindle]" = Spindle
        self.reads = READS  # which bytes are taken off a line
        self.highest_tool = HIGHEST_TOOL
        for extra in self.extras:
            if hasattr(extra, "prepare"):
                extra.prepare(self, board)

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
