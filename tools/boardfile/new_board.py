"""Make a board file from answers: the pins that exist, the rules for their use, the text."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from .. import paths
from ..sim import motor_names
from . import engines
from .chips import CHIPS, Chip

FEWEST_AXES = 3

Pins = tuple[int | None, ...]  # None: not connected


class Item(NamedTuple):
    """A line of a board file that holds pins."""

    name: str
    question: str
    per_axis: bool = False
    needed: bool = False
    output: bool = False


# In the order of the file and of the questions.
ITEMS = (
    Item("STEP", "step pulses, a pin per motor", per_axis=True, needed=True, output=True),
    Item("DIR", "directions, a pin per motor", per_axis=True, needed=True, output=True),
    Item("ENABLE", "enable of the motor drivers, all together", output=True),
    Item("LIMIT", "limit switches, a pin per axis or motor", per_axis=True),
    Item("PROBE", "probe"),
    Item("RESET", "reset button"),
    Item("HOLD", "hold button"),
    Item("START", "start button"),
    Item("DOOR", "safety door"),
    Item("ESTOP", "emergency stop, a contact that opens when pressed"),
    Item("SPINDLE_PWM", "spindle or laser power (PWM)", output=True),
    Item("SPINDLE_DIR", "spindle direction", output=True),
    Item("SPINDLE_ON", "spindle on and off", output=True),
    Item("FLOOD", "flood coolant", output=True),
    Item("MIST_PIN", "mist coolant", output=True),
)
# One tuple holds all of these in the file, with None for a missing input.
CONTROLS = ("RESET", "HOLD", "START", "DOOR")
# Steps and directions, and inputs that are read all at once, need pins up to Chip.last_quick.
FAST_PINS = ("STEP", "DIR", "LIMIT", "PROBE", *CONTROLS)
# Options that a pin switches on.
SWITCHED_ON = {"DOOR": "SAFETY_DOOR", "MIST_PIN": "MIST"}
BY_NAME = {item.name: item for item in ITEMS}


# MPY_ARCH of a Pico W; for its remaining memory see docs/boards.md.
TOO_SMALL = "armv6m"
NO_PAGE = (
    "PAGE: a Pico W has less than 40 kB of memory left with it: take the page from `ugrbl web`, "
    "or a Pico 2 W or an ESP32"
)


class BoardError(Exception):
    """Raised for answers that a board file cannot express; the text gives the cause."""


@dataclass
class Board:
    """The answers from which a board file is made."""

    title: str
    chip: Chip
    motors: str = ""  # the axis of each motor, if an axis has two
    rotary: str = ""  # rotary axes
    pins: dict[str, Pins] = field(default_factory=dict)
    defaults: dict[int, float] = field(default_factory=dict)
    network: bool = False
    page: bool = False  # served over the network

    @property
    def axes(self) -> int:
        """Return the number of axes; 0 before step pins are known."""
        return motor_names.count_axes(self.motors) or len(self.pins.get("STEP", ()))

    def as_json(self) -> dict[str, object]:
        """Return the answers without title and chip."""
        return {
            "pins": self.pins,
            "motors": self.motors,
            "rotary": self.rotary,
            "defaults": self.defaults,
        }

    def text(self) -> str:
        """Return the text of the board file."""
        lines = [f'"""{self.title}: {self.chip.title}."""', ""]
        lines += [f'CHIP = "{name}"' for name, chip in CHIPS.items() if chip is self.chip]
        lines += [f'MPY_ARCH = "{self.chip.mpy_arch}"', f'ENGINE = "{self.chip.engine}"']
        link = engines.WIRELESS[self.chip.link] if self.network else self.chip.link
        lines += [f'LINK = "{link}"', *(["PAGE = True"] if self.page else []), ""]
        if self.motors:
            lines.append(f'MOTORS = "{self.motors}"  # the axis of each motor')
        if self.rotary:
            lines.append(f'ROTARY = "{self.rotary}"  # axes that turn, in degrees')
        for item in ITEMS:
            if item.name == CONTROLS[0]:  # one line for all of them
                lines += self._controls()
            elif item.name not in CONTROLS and (pins := self.pins.get(item.name)):
                value = _tuple(pins) if item.per_axis else str(pins[0])
                lines.append(f"{item.name} = {value}  # {item.question}")
        lines += [
            f"{option} = True" for name, option in SWITCHED_ON.items() if self.pins.get(name)
        ]
        # Pins that are inputs only have no pull-up resistor.
        if bare := sorted(pin for pin, _ in self.wiring() if pin in self.chip.inputs_only):
            lines.append(f"NO_PULL_UP = {_tuple(bare)}  # resistors to 3.3 V do it")
        if self.chip.engine == "rmt":
            most_hz = engines.engines()["rmt"].most_hz
            lines += ["", "# See esp32_devkit.py.", f"MAX_STEP_RATE_HZ = {most_hz}"]
        lines += ["", "PWM_MAX = 1000"]
        if self.defaults:
            lines += ["", "# Settings of this machine from the factory."]
            lines.append("DEFAULTS = {")
            lines += [
                f"    {number}: {value:g}," for number, value in sorted(self.defaults.items())
            ]
            lines.append("}")
        return "\n".join(lines) + "\n"

    def _controls(self) -> list[str]:
        """Return the line of the control inputs; no line if none is wired."""
        pins_of_each = [self.pins.get(name, ()) for name in CONTROLS]
        if not any(pins_of_each):
            return []
        values = ", ".join(str(pins[0]) if pins else "None" for pins in pins_of_each)
        return [f"CONTROL = ({values})  # reset, hold, start, door"]

    def wiring(self) -> Iterator[tuple[int, str]]:
        """Yield every pin in use and what is connected to it."""
        names = motor_names.names(self.motors or motor_names.AXIS_LETTERS)
        for item in ITEMS:
            for motor, pin in enumerate(self.pins.get(item.name, ())):
                what = item.question.partition(",")[0]
                if pin is None:
                    continue
                yield pin, f"{what} {names[motor]}" if item.per_axis else what


def _tuple(pins: Sequence[int | None]) -> str:
    """Return pins as the text of a tuple, with a comma after a single one."""
    return f"({', '.join(map(str, pins))}{',' if len(pins) == 1 else ''})"


def read_pins(text: str) -> Pins:
    """Parse `2 3 4`, `2,3,4` or `GP2 GP3 GP4`; `None` stands for a missing input."""
    pins: list[int | None] = []
    for word in text.replace(",", " ").split():
        if word.lower() == "none":
            pins.append(None)
            continue
        digits = word.upper().removeprefix("GPIO").removeprefix("GP").removeprefix("IO")
        if not digits.isdigit():
            raise BoardError(f"{word} is no pin: write its GPIO number")
        pins.append(int(digits))
    return tuple(pins)


def check_item(board: Board, item: Item, pins: Pins) -> None:
    """Raise BoardError if the pins do not suit the item, or conflict with the pins already set."""
    if not pins:
        if item.needed:
            raise BoardError(f"{item.name} is needed: --pin {item.name.lower()}=2,3,4")
        return
    count = len(board.pins.get("STEP", pins)) if item.per_axis else 1  # STEP itself: any number
    # Limit switches are one per motor or, because a second motor needs none, one per axis.
    wanted = {count, board.axes or count} if item.name == "LIMIT" else {count}
    if item.name == "STEP" and len(pins) > board.chip.most_motors:
        raise BoardError(
            f"{board.chip.engine} drives {board.chip.most_motors} motors at most: name fewer pins"
        )
    if len(pins) not in wanted:
        many = " or ".join(map(str, sorted(wanted)))
        raise BoardError(f"{item.name} needs {many} pin{'s' * (many != '1')}, not {len(pins)}")
    used = {pin: name for name, held in board.pins.items() if name != item.name for pin in held}
    for index, pin in enumerate(pins):
        if pin is None:
            if item.name != "LIMIT":
                raise BoardError(f"{item.name}: only LIMIT may have None: name a pin")
            continue
        if pin not in board.chip.pins:
            raise BoardError(f"{item.name}: {board.chip.title} has no pin {pin} to connect to")
        if item.name in FAST_PINS and pin > board.chip.last_quick:
            raise BoardError(
                f"{item.name}: pin {pin} cannot do it: steps, directions, limits, probe and "
                f"buttons have to be pins up to {board.chip.last_quick}"
            )
        if item.output and pin in board.chip.inputs_only:
            raise BoardError(
                f"{item.name}: pin {pin} of {board.chip.title} is an input only: choose another"
            )
        if pin in used:
            raise BoardError(f"{item.name}: pin {pin} is {used[pin]} already")
        if pin in pins[:index] and item.name != "LIMIT":  # limit switches may share a pin
            raise BoardError(f"{item.name} names pin {pin} twice")


def check_motors(board: Board, letters: str) -> None:
    """Raise BoardError if the letters cannot be the axes of the motors with step pins."""
    paths.use_firmware()
    from extras.motors.ganged import count_axes

    try:
        count_axes(letters, len(board.pins["STEP"]))
    except ValueError as error:
        raise BoardError(str(error)) from error


def check_axes(board: Board) -> None:
    """Raise BoardError if there are more motors than axes and MOTORS is not given."""
    motors, most = len(board.pins["STEP"]), len(motor_names.AXIS_LETTERS)
    if not board.motors and motors > most:
        raise BoardError(
            f"STEP has {motors} pins, but there are {most} axes: name the axis of each in MOTORS, "
            f'as in "{(motor_names.AXIS_LETTERS * 2)[:motors]}"'
        )


def check_rotary(board: Board, letters: str) -> None:
    """Raise BoardError if the letters cannot be rotary axes."""
    paths.use_firmware()
    from extras.kinematics.rotary import mask_of

    try:
        mask_of(letters, board.axes)
    except ValueError as error:
        raise BoardError(str(error)) from error


def check(board: Board) -> None:
    """Raise BoardError for the first fault of the whole board."""
    if not board.title.isprintable() or set(board.title) & set('"\\'):
        raise BoardError("the title is one line without quotation marks and backslashes")
    for item in ITEMS:
        check_item(board, item, board.pins.get(item.name, ()))
    check_axes(board)
    if board.motors:
        check_motors(board, board.motors)
    check_rotary(board, board.rotary)
    if board.network and not board.chip.radio:
        raise BoardError(
            f"{board.chip.title} has no radio: choose another --chip, for example pico_w"
        )
    if board.page and board.chip.mpy_arch == TOO_SMALL:
        raise BoardError(NO_PAGE)
    _check_defaults(board)


def _check_defaults(board: Board) -> None:
    """Raise BoardError for a default that the firmware would refuse."""
    paths.use_firmware()
    from base.errors import GrblError
    from base.settings import Settings

    from ..sim.rig import MemoryStore

    settings = Settings(MemoryStore(), board.axes, defaults={})
    settings.load()
    for number, value in board.defaults.items():
        try:
            settings.set(number, value)
        except GrblError as error:
            from ..grbl.messages import meaning

            line = f"${number}={value:g}"
            why = meaning(f"error:{error.args[0]}", line)
            raise BoardError(f"{line} is refused: {why}") from error


def oddities(board: Board) -> list[str]:
    """Return hints about the chosen pins."""
    return [
        f"pin {pin} ({what}) {board.chip.odd[pin]}"
        for pin, what in board.wiring()
        if pin in board.chip.odd
    ]
