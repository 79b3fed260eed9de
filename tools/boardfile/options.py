"""Board options: all options of a board file in one table: type, default, range and meaning.

The firmware has each default again where it reads the option (test_options.py compares), because
this table would make a board's start 20 ms longer. docs/reference.md is made from it.
"""

from collections.abc import Callable, Iterable
from keyword import iskeyword
from typing import Any, NamedTuple

from .. import paths
from . import engines
from .chips import ARCHS, BUILT_IN, CHIPS


class Kind(NamedTuple):
    """The type of an option. wants: the message for a value of another type; {} is the value."""

    title: str
    fits: Callable[[Any], bool]
    wants: str


def _is_pin(value: Any) -> bool:
    return value is None or type(value) is int


def _are_pins(value: Any) -> bool:
    return isinstance(value, tuple) and all(map(_is_pin, value))


def _are_numbers(value: Any) -> bool:
    return isinstance(value, tuple) and all(type(number) is int for number in value)


def _are_names(value: Any) -> bool:
    return isinstance(value, tuple) and all(isinstance(name, str) for name in value)


def _are_values(value: Any) -> bool:
    return isinstance(value, dict) and all(
        type(number) is int and isinstance(one, int | float) for number, one in value.items()
    )


def _are_named_pins(value: Any) -> bool:
    return isinstance(value, dict) and all(
        isinstance(name, str) and type(pin) is int for name, pin in value.items()
    )


def _is_module(value: Any) -> bool:
    """Return whether it is the name of a module of the user's own, or "" for none."""
    if not isinstance(value, str):
        return False
    return not value or (value.isidentifier() and not iskeyword(value) and value not in _taken())


def _taken() -> set[str]:
    """Return the names of other files on a board, and of modules that it imports."""
    ours = {file.stem for file in paths.FIRMWARE.iterdir()}
    return {"board", "ugrbl", "kernels", *BUILT_IN, *ours}


_PARENTHESES = "but needs parentheses and commas: (2, 3, 4)"
PIN = Kind("pin", _is_pin, ": pins are numbers")
PINS = Kind("pins", _are_pins, _PARENTHESES)
PIN_OR_PINS = Kind("pin, or pins", lambda value: _is_pin(value) or _are_pins(value), PIN.wants)
COUNT = Kind("whole number", lambda value: type(value) is int, ": it must be a whole number")
NUMBERS = Kind("numbers", _are_numbers, _PARENTHESES)
SWITCH = Kind("True or False", lambda value: type(value) is bool, ": it must be True or False")
WORD = Kind("word", lambda value: isinstance(value, str), 'but needs quotation marks: "{}"')
MODULE = Kind("name", _is_module, ": it must be a file's name without .py, not a firmware module")
NAMES = Kind("names", _are_names, 'but needs parentheses and a comma: ("FLOOD",)')
NAMED_PINS = Kind("{name: pin}", _are_named_pins, 'but must have the form {"vacuum": 20}')
VALUES = Kind("{number: value}", _are_values, "but must have the form {100: 800.0}")

# The default of an option without which there is no machine, or no such engine or tool.
NEEDED = object()


class Option(NamedTuple):
    """A row. low, high: range of a count. words: the values allowed for a word, or each name."""

    name: str
    kind: Kind
    default: object
    meaning: str
    low: int = 0
    high: int | None = None
    words: Callable[[], Iterable[str]] | None = None

    def problem(self, value: Any) -> str:
        """Return what is wrong with a value, or ""."""
        if not self.kind.fits(value):
            gap = "" if self.kind.wants[0] == ":" else " "
            return f"{self.name} is {value!r}{gap}{self.kind.wants.replace('{}', str(value))}"
        if self.kind is COUNT and value < self.low:
            return f"{self.name} is {value}: it is {self.low} at the least"
        if self.high is not None and value > self.high:
            return f"{self.name} is {value}: it is {self.high} at the most"
        return self._unknown_word(value if isinstance(value, tuple) else (value,))

    def _unknown_word(self, values: tuple[Any, ...]) -> str:
        words = list(self.words()) if self.words else values
        unknown = [value for value in values if value not in words]
        return f"{self.name}: {unknown[0]!r} is not one of {', '.join(words)}" if unknown else ""

    @property
    def type(self) -> str:
        """Return type, words and range for the documents."""
        if self.kind is WORD and self.words:
            return ", ".join(f'"{word}"' for word in self.words())
        if self.high is not None:
            return f"{self.kind.title}, {self.low} to {self.high}"
        return f"{self.kind.title}, {self.low} or more" if self.low else self.kind.title


# Outputs that may be on when low.
INVERTIBLE = ("SPINDLE_PWM", "SPINDLE_ON", "SPINDLE_DIR", "FLOOD", "MIST_PIN")

OPTIONS = (
    Option(
        *("CHIP", WORD, None),
        "Chip or module, read by the tools. Without it: the chip that MPY_ARCH is for.",
        words=lambda: CHIPS,
    ),
    Option("MPY_ARCH", WORD, NEEDED, "Processor to compile for.", words=lambda: ARCHS),
    Option(
        *("ENGINE", WORD, NEEDED),
        'Step engine: "pio" on RP2 chips, "rmt" or "i2s" on an ESP32, "sim" in the '
        "simulator. $I reports it.",
        words=lambda: (*engines.engines(), engines.SIMULATOR),
    ),
    Option(
        *("LINK", WORD, "usb"),
        "Where the sender is. uart: UART 0 of an ESP32, or its native USB. wifi: USB and network "
        "of a Pico W; uart_wifi: of an ESP32. See docs/network.md.",
        words=engines.links,
    ),
    Option("PAGE", SWITCH, False, "The network has the page, too: see docs/network.md."),
    # Motors.
    Option(
        *("STEP", PINS, NEEDED),
        "Step pins, one per motor. Their number is the number of axes.",
    ),
    Option("DIR", PINS, NEEDED, "Direction pins, one per motor."),
    Option(
        *("MOTORS", WORD, ""),
        'Axis of each motor, needed if an axis has two motors: "XYZY". See docs/motors.md.',
    ),
    Option(
        *("ENABLE", PIN_OR_PINS, None),
        'Enable of the motor drivers: one for all, or a tuple of them. ENGINE "i2s" needs it.',
    ),
    Option("DIR_HOLD_US", COUNT, 2, 'Direction stays so many us behind a step. ENGINE "pio".'),
    Option("DIR_SETUP_US", COUNT, 5, 'Direction is there so many us before a step. ENGINE "pio".'),
    Option("I2S", PINS, NEEDED, 'Pins of the shift register: BCK, WS, DATA. ENGINE "i2s".'),
    Option("I2S_RATE_HZ", COUNT, NEEDED, 'Frames per second of I2S. ENGINE "i2s".', low=1),
    Option(
        *("I2S_BUFFERS", COUNT, NEEDED),
        'Number of DMA buffers of 2 ms: motion prepared ahead. ENGINE "i2s".',
        low=8,  # five are made ahead at rest, two are left free
    ),
    Option(
        *("MAX_STEP_RATE_HZ", COUNT, 0),
        "Highest step rate; $100-$112 that ask for more are refused with error:12. 0: none.",
    ),
    Option(
        *("STEP_PULSE_MIN_US", COUNT, 3),
        "Least $0, if all motor drivers accept pulses below 3 us. See docs/motors.md.",
        low=1,
        high=3,
    ),
    Option("COREXY", SWITCH, False, "Motors A and B move X and Y together (CoreXY)."),
    Option(
        *("MOVES", NAMES, ()),
        'Axes that each motor moves: ("X+Z", "Y", "X-Z") for a CoreXZ. See docs/motors.md.',
    ),
    Option(
        *("TMC2209", NUMBERS, ()),
        "Addresses of TMC2209 drivers, one per motor, 0 to 3: see docs/drivers.md.",
    ),
    Option("TMC_UART", PINS, (), "Pins of the serial line to TMC2209 drivers: TX, RX."),
    Option(
        *("TMC_SENSE_MOHM", COUNT, 110),
        "Sense resistors of TMC2209 drivers, thousandths of an ohm.",
        low=10,
        high=1000,
    ),
    # Inputs.
    Option(
        "LIMIT",
        PINS,
        (),
        "Limit switches to ground, one pin per motor, or axis; axes may share one.",
    ),
    Option(
        *("LIMIT_DEBOUNCE_MS", COUNT, 0),
        "A limit switch counts if it is closed so many ms after an edge; a machine goes on "
        "meanwhile. 0: at the edge.",
        high=5,
    ),
    Option(
        *("DUAL_LIMIT_SWITCHES", SWITCH, False),
        "Both ends of an axis share its limit input: no homing from a closed switch.",
    ),
    Option("PROBE", PIN, None, "Probe pin; contact connects it to ground."),
    Option(
        *("CONTROL", PINS, ()),
        "Control inputs, switched to ground: reset, hold, start, door; None where not wired.",
    ),
    Option(
        *("CONTROL_INVERT", COUNT, 0),
        "Control inputs that are active when open, added up: reset 1, hold 2, start 4, door 8.",
        high=15,
    ),
    Option("CONTROL_DEBOUNCE_MS", COUNT, 0, "For so many ms a button's contacts may bounce."),
    Option(
        *("ESTOP", PIN, None),
        "Emergency stop: a contact to ground that opens when pressed, or when its cable is cut.",
    ),
    Option(
        *("NO_PULL_UP", PINS, ()),
        "Input-only pins without pull-ups inside the chip; the board has resistors for them.",
    ),
    Option(
        *("REPL_PIN", PIN, None),
        "Pin that, held to ground at power-up, starts MicroPython's prompt, not the machine.",
    ),
    # Outputs.
    Option("SPINDLE_PWM", PIN, None, "Pin for the power of spindle or laser (PWM)."),
    Option("PWM_HZ", COUNT, 5000, "Pulses a second of SPINDLE_PWM.", low=1),
    Option(
        *("PWM_MAX", COUNT, 1000),
        "Steps of SPINDLE_PWM from nothing to full power.",
        low=1,
        high=16383,  # times 65535 is still a small integer, which an interrupt needs
    ),
    Option("SPINDLE_ON", PIN, None, "Pin that switches the spindle on and off."),
    Option(
        *("SPINDLE_DIR", PIN, None),
        "Spindle direction pin: high is counterclockwise; with SPINDLE_ENABLE_PIN, high is on.",
    ),
    Option(
        *("SPINDLE_ENABLE_PIN", SWITCH, False),
        "The spindle direction pin says that the spindle is on.",
    ),
    Option("FLOOD", PIN, None, "Pin for flood coolant."),
    Option("MIST_PIN", PIN, None, "Pin for mist coolant; needs MIST."),
    Option("MIST", SWITCH, False, "Enables mist coolant: M7 and its override."),
    Option(
        *("INVERT", NAMES, ()),
        'Names of outputs that are on when low: ("SPINDLE_PWM", "FLOOD"). ENABLE has $4.',
        words=lambda: INVERTIBLE,
    ),
    # The machine.
    Option(
        *("DEFAULTS", VALUES, {}),
        "Default settings that differ from Grbl's, as {number: value}.",
    ),
    Option(
        *("PLANNER_BLOCKS", COUNT, 16),
        "Blocks the planner looks ahead. More of them, 100 bytes each, make tiny moves faster.",
        low=2,
    ),
    Option(
        *("RX_BYTES", COUNT, 128),
        "Receive buffer: what a sender that counts characters may have under way.",
        low=128,  # as Grbl, because senders that do not ask rely on it
    ),
    Option("SAFETY_DOOR", SWITCH, False, "A safety door is wired to the door input."),
    Option(
        *("PARKING", SWITCH, False),
        "Door and sleep move the tool up to -5 mm and back. Needs homing.",
    ),
    Option("OVERRIDE_CONTROL", SWITCH, False, "M56 switches parking off and on."),
    Option("LINE_NUMBERS", SWITCH, False, "N of the line being executed is in status reports."),
    Option(
        *("FORCE_SET_ORIGIN", SWITCH, False),
        "Homing sets 0 at the switch's pull-off; travel is positive where $23 is set.",
    ),
    Option(
        *("ROTARY", WORD, ""),
        'Rotary axes, "A" or "AC": degrees in place of mm. See docs/motors.md.',
    ),
    Option(
        *("XYUV", SWITCH, False),
        "A wire cutter: the four motors are X, Y, U and V. See docs/motors.md.",
    ),
    Option(
        *("HOMING", NAMES, ()),
        'What $H homes, in order: ("Z", "XY"). Brings $44 and more, see docs/motors.md.',
    ),
    Option("SINGLE_AXIS_HOMING", SWITCH, False, "$HX, $HY and $HZ home one axis."),
    Option("ECHO", SWITCH, False, "Every line is echoed as it was understood, for debugging."),
    Option(
        *("LOOP_MS", COUNT, 250),
        "A main loop that is away for longer is stopped: tools off, motors too.",
        low=100,  # a garbage collection takes 30
    ),
    Option(
        *("WATCHDOG_MS", COUNT, 5000),
        "A program that hangs for so many ms restarts the chip. 0: never.",
        high=8388,  # the most that the RP2040's watchdog counts
    ),
    # Extras.
    Option(
        *("DIALECT", WORD, "1.1"),
        "Whose words it uses: 0.9's for older senders, or grblHAL's, see docs/grblhal.md.",
        words=engines.dialects,
    ),
    Option(
        *("TOOL", WORD, "spindle"),
        "What works on the material: a spindle; or see docs/laser.md, or docs/punch.md.",
        words=engines.tools,
    ),
    Option(
        *("COUNT_DRAINS", SWITCH, False),
        "Counts how often a program was held up for want of lines: `$I+`, and `Dr:` in reports.",
    ),
    Option(
        *("LENIENT", SWITCH, False),
        "Takes words of other controllers, drilling cycles among them: see docs/lenient.md.",
    ),
    Option(
        *("JOBS", WORD, ""),
        'The folder of programs that live on the board, "jobs" say: see docs/jobs.md.',
    ),
    Option(
        *("SD_CARD", PINS, ()),
        "SPI pins of an SD card for programs: clock, to the card, from the card, select.",
    ),
    Option(
        *("POWER_FAIL", PIN, None),
        "A contact to ground that opens when the supply fails: see docs/jobs.md.",
    ),
    Option("POWER_FAIL_MS", COUNT, 100, "Milliseconds from POWER_FAIL to loss of power.", low=20),
    Option("POWER_FAIL_UP_MM", COUNT, 0, "Distance in mm that Z rises at POWER_FAIL, if homed."),
    Option(
        *("JERK", SWITCH, False),
        "Jerk can be limited while it runs, per axis: see docs/jerk.md.",
    ),
    Option(
        *("ARC_ACCELERATION", SWITCH, False),
        "Arcs are no faster than `$120` and on allow on their radius: see docs/motors.md.",
    ),
    Option(
        *("BACKLASH", SWITCH, False),
        "Slack is taken up where an axis turns round, by $160 and on: see docs/motors.md.",
    ),
    Option("SKEW", SWITCH, False, "Axes may lean, by $780, $781, $782: see docs/motors.md."),
    Option(
        *("CLUSTERS", SWITCH, False),
        "Lines may hold S0:0:875:0, up to 16 powers, and 160 characters: see docs/laser.md.",
    ),
    Option(
        *("KINEMATICS", MODULE, ""),
        "Name of a module with your own kinematics, in board.py's folder: see docs/kinematics.md.",
    ),
    Option(
        *("EXTRAS", NAMES, ()),
        "Names of your own modules in the folder of board.py: see docs/extending.md.",
    ),
    Option(
        *("CUSTOM", MODULE, "custom"),
        "The name of your own Python on the board, NAME.py or a folder: see docs/custom.md.",
    ),
    Option(*("OUTPUTS", NAMED_PINS, {}), "Outputs for custom.py, by name; off after a reset."),
    Option(*("INPUTS", NAMED_PINS, {}), "Inputs for custom.py, by name; they close to ground."),
    Option("PUNCH_DOWN", PIN, NEEDED, "Actuator that moves the punch down: see docs/punch.md."),
    Option("PUNCH_UP", PIN, NEEDED, "Actuator that moves the punch up."),
    Option("PUNCH_DOWN_SENSOR", PIN, NEEDED, "Sensor of the punch being down."),
    Option("PUNCH_UP_SENSOR", PIN, NEEDED, "Sensor of the punch being up."),
    Option(
        *("PUNCH_TIMEOUT_MS", COUNT, 1000),
        "Longest time of a stroke of the punch, one way, in ms.",
        low=1,
    ),
    Option(
        *("SEGMENT_QUEUE", COUNT, 5),
        "Simulator: number of segments that the step engine buffers.",
        low=1,
    ),
    Option("ANSWER_US", COUNT, 0, "Simulator: time to process a line, in us."),
    Option(
        *("LOOP_US", COUNT, 0),
        "Simulator: time of one turn of the main loop during motion, in us.",
    ),
    Option(
        *("START_US", COUNT, 0),
        "Simulator: time to compute the first segments of a motion, in us.",
    ),
    Option(
        *("PUNCH_STROKE_MS", COUNT, 40),
        "Simulator: time of a stroke of the punch, one way, in ms.",
        low=1,
    ),
)
BY_NAME = {option.name: option for option in OPTIONS}
