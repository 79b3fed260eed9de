"""Check a board file from its data, before anything is sent to a board."""

import ast
import difflib
import importlib.util
import re
from collections.abc import Iterator
from math import inf
from pathlib import Path
from types import ModuleType
from typing import Any

from .. import paths
from ..grbl.settings_file import SIGNED, zeros
from ..sim import motor_names
from .chips import CHIPS, Chip, on_their_own
from .engines import SIMULATOR, WIRELESS, engines
from .new_board import (
    CONTROLS,
    FEWEST_AXES,
    ITEMS,
    NO_PAGE,
    TOO_SMALL,
    Board,
    BoardError,
    check_axes,
    check_item,
)
from .options import BY_NAME, INVERTIBLE, PIN, PIN_OR_PINS
from .setting_tables import tables_of

# How a user's extra reads a name of the board file.
_READ = re.compile(r"""\b(?:option\(|getattr\(\s*board,\s*)"([A-Z]\w*)"|\bboard\.([A-Z]\w*)""")

# Pins that new_board does not ask for.
_OTHERS = {
    "REPL_PIN": "the button for MicroPython's prompt",
    "OUTPUTS": "outputs for custom.py",
    "INPUTS": "inputs for custom.py",
}

# On an RP2350, which can step one motor more without a laser.
MOST_MOTORS_WITH_LASER = 7

# SPI pins of RP2040 and RP2350.
_SPI_REMAINDERS = (2, 3, 0)  # of GPIO numbers modulo 4: SCK, TX, RX
_SPI_PINS_LOG2 = 3  # pins 0 to 7 are SPI0's, 8 to 15 SPI1's, and so on in turn


def problems(board: ModuleType) -> list[str]:
    """Return every problem in words, with its cause; an empty list for a correct board."""
    values = [*_values(board), *_unknown(board), *_network(board)]
    if is_simulated(board):
        return values or list(_firmware(board))
    basic = list(_missing(board)) or list(_parts(board)) or list(_types(board))
    if basic:  # the other checks rely on these
        return basic
    check = _pins_beside_registers if _has_registers(board) else _pins_of_chip
    # Without CHIP the board may have one of several: report the one whose pins fit best.
    pins = min((list(check(board, chip)) for chip in chips_of(board)), key=len)
    others = values or (() if pins else _firmware(board))  # it relies on correct pins
    return [*pins, *_wires(board), *_card(board), *others, *_defaults(board)]


def notes(board: ModuleType) -> list[str]:
    """Return hints about the pins and defaults of a correct board."""
    if is_simulated(board):
        return []
    check = _pins_beside_registers if _has_registers(board) else _pins_of_chip
    # The chip whose pins fit best, as in problems().
    chip = min(chips_of(board), key=lambda chip: len(list(check(board, chip))))
    # With shift registers these are outputs of the registers, and not pins of the chip.
    not_pins = ("STEP", "DIR", "ENABLE") if _has_registers(board) else ()
    used = [
        (name, pin) for name, pins in _pins_by_name(board) for pin in pins if name not in not_pins
    ]
    hints = [f"{name}: pin {pin} {chip.odd[pin]}" for name, pin in used if pin in chip.odd]
    settings = (f"${number}={value:g}" for number, value in getattr(board, "DEFAULTS", {}).items())
    return hints + [f"DEFAULTS: {words}" for words in zeros(settings)]


def imports(text: str) -> Iterator[str]:
    """Yield the modules that a Python file imports, as written. Raises SyntaxError."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield "." * node.level + (node.module or "")


def is_simulated(board: ModuleType) -> bool:
    """Return whether the board is a machine of the simulator, without pins."""
    return getattr(board, "ENGINE", "") == SIMULATOR


def _has_registers(board: ModuleType) -> bool:
    """Return whether the motors use shift registers instead of pins of the chip."""
    return "STEP" not in engines()[board.ENGINE].pins


def chips_of(board: ModuleType) -> list[Chip]:
    """Return the chip that the board names, or else the chips that it may run on."""
    return [CHIPS[board.CHIP]] if hasattr(board, "CHIP") else on_their_own(board.MPY_ARCH)


def _missing(board: ModuleType) -> Iterator[str]:
    """Report the first required option that is missing; which ones are, depends on the engine."""
    engine = engines().get(getattr(board, "ENGINE", ""))
    for name in ("ENGINE", "MPY_ARCH", *(engine.needed if engine else ())):
        if not hasattr(board, name):
            yield f"{name} is missing"
            return


def _parts(board: ModuleType) -> Iterator[str]:
    """Check that ENGINE, LINK, MPY_ARCH and CHIP are known words and fit together."""
    unknown = [_problem(board, name) for name in ("ENGINE", "LINK", "MPY_ARCH", "CHIP")]
    yield from filter(None, unknown)
    if any(unknown):
        return
    engine = engines()[board.ENGINE]
    if not any(engine.runs_on(chip.processor) for chip in on_their_own(board.MPY_ARCH)):
        yield f"ENGINE {board.ENGINE!r} does not run on MPY_ARCH {board.MPY_ARCH!r}"
    elif board.MPY_ARCH != chips_of(board)[0].mpy_arch:
        yield f"CHIP {board.CHIP!r} has MPY_ARCH {chips_of(board)[0].mpy_arch!r}"


def _problem(board: ModuleType, name: str) -> str:
    """Return what is wrong with an option's value; "" if nothing, or if the option is absent."""
    return BY_NAME[name].problem(getattr(board, name)) if hasattr(board, name) else ""


def _values(board: ModuleType) -> Iterator[str]:
    """Check the type, range and word of every option."""
    yield from filter(None, (_problem(board, name) for name in BY_NAME))


def _types(board: ModuleType) -> Iterator[str]:
    """Check the types alone; with a wrong type nothing else can be checked."""
    for name, option in BY_NAME.items():
        if hasattr(board, name) and not option.kind.fits(getattr(board, name)):
            yield _problem(board, name)
    for name in _pins_of_extras(board):
        value = getattr(board, name, None)
        if name not in BY_NAME and not PIN_OR_PINS.fits(value):
            yield f"{name} is {value!r}{PIN.wants}"


def _unknown(board: ModuleType) -> Iterator[str]:
    """Report names in capitals that nothing reads, with a similar known name."""
    known = set(BY_NAME) | _names_of_extras(board)
    for name in (name for name in vars(board) if name.isupper() and name not in known):
        similar = difflib.get_close_matches(name, known, 1)
        yield f"{name}: no such option" + "".join(f"; did you mean {guess}?" for guess in similar)


def _pins_of_extras(board: ModuleType) -> tuple[str, ...]:
    """Return the options with pins that the board's extras have; () if an extra fails."""
    paths.use_firmware()
    from boot import select_extras

    try:
        return select_extras.pin_options(board)
    except Exception:  # a user's module may raise anything
        return ()  # _values() and _firmware() report it


def _others(board: ModuleType) -> dict[str, str]:
    """Return the other options that hold pins, with their purpose; those of extras, too."""
    names = _pins_of_extras(board)
    return {**_OTHERS, **{name: name.lower().replace("_", " ") for name in names}}


def _as_tuple(value: Any) -> tuple[Any, ...]:
    """Return the pins of an option: one pin, a tuple, or a dict of pins by name."""
    if isinstance(value, dict):  # pins by name
        return tuple(value.values())
    return value if isinstance(value, tuple) else (value,)


def _pins_by_name(board: ModuleType) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Yield names in the board file with their pins, without those that are not wired. CONTROL is
    a pin each for RESET, HOLD, START and DOOR, which appear under these names."""
    for item in ITEMS:
        if item.name not in CONTROLS and getattr(board, item.name, None) is not None:
            yield item.name, _as_tuple(getattr(board, item.name))
    for name, pin in zip(CONTROLS, getattr(board, "CONTROL", ()), strict=False):
        if pin is not None:
            yield name, (pin,)
    for name in _others(board):
        if getattr(board, name, None) is not None:
            yield name, _as_tuple(getattr(board, name))


def _pins_of_chip(board: ModuleType, chip: Chip) -> Iterator[str]:
    """Check that pins exist, are used once, and are as many as the engine needs."""
    if motor_names.axes_of(board) < FEWEST_AXES:
        yield f"STEP needs {FEWEST_AXES} pins, for {motor_names.AXIS_LETTERS[:FEWEST_AXES]}"
    if len(getattr(board, "CONTROL", (None,) * 4)) != len(CONTROLS):
        yield "CONTROL needs four entries, for reset, hold, start and door; None where not wired"
    items = {item.name: item for item in ITEMS}
    checked = Board(title=board.__name__, chip=chip, motors=getattr(board, "MOTORS", ""))
    for name, pins in _pins_by_name(board):
        # One enable pin per driver is allowed as well as one for all.
        if name in items and not (name == "ENABLE" and len(pins) > 1):
            try:
                check_item(checked, items[name], pins)
            except BoardError as error:
                yield str(error)
                continue
        else:
            yield from _check_pins_exist(checked, name, pins)
        checked.pins[name] = pins  # later pins must differ from these
        if name == "STEP":
            try:
                check_axes(checked)
            except BoardError as error:
                yield str(error)


def _check_pins_exist(checked: Board, name: str, pins: tuple[int, ...]) -> Iterator[str]:
    """Yield a problem for each pin that does not exist or is in use. Axes may share a limit pin.

    checked: the board with the pins checked so far.
    """
    used = {pin: other for other, others in checked.pins.items() for pin in others}
    for index, pin in enumerate(pins):
        if pin is None:
            continue
        if pin not in checked.chip.pins:
            yield f"{name}: {checked.chip.title} has no pin {pin} to connect to"
        elif pin in used:
            yield f"{name}: pin {pin} is {used[pin]} already"
        elif pin in pins[:index] and name != "LIMIT":
            yield f"{name} names pin {pin} twice"


def _pins_beside_registers(board: ModuleType, chip: Chip) -> Iterator[str]:
    """Check a board whose motors use shift registers: STEP, DIR and ENABLE are outputs of these,
    numbered apart from the pins of the chip."""
    outputs = (*board.STEP, *board.DIR, *_as_tuple(getattr(board, "ENABLE", ())))
    for pin in sorted(set(outputs)):
        if outputs.count(pin) > 1:
            yield f"output {pin} of the shift registers has two uses"
    motors = len(board.STEP)
    for name in ("DIR", "LIMIT"):  # LIMIT may have fewer: a second motor needs no switch
        count = len(getattr(board, name, ()))
        if count and (count > motors or (name == "DIR" and count < motors)):
            yield f"{name} needs {motors} pins, not {count}"
    checked = Board(title=board.__name__, chip=chip, pins={"I2S": board.I2S})
    for name, pins in _pins_by_name(board):
        if name not in ("STEP", "DIR", "ENABLE"):
            yield from _check_pins_exist(checked, name, pins)
            checked.pins[name] = pins


def _names_of_extras(board: ModuleType) -> set[str]:
    """Return the names that the user's modules read from the board file."""
    # Each match has a name for each of the two forms of _READ, one of them empty.
    matches = [match for text in _own_extras(board).values() for match in _READ.findall(text)]
    return {by_option or by_attribute for by_option, by_attribute in matches}


def own_modules(board: Any) -> tuple[str, ...]:
    """Return the names of the user's modules that are stored in the board file's folder."""
    kinematics = getattr(board, "KINEMATICS", "")
    own = (kinematics,) if kinematics and isinstance(kinematics, str) else ()
    return (*getattr(board, "EXTRAS", ()), *own)


def _own_extras(board: ModuleType) -> dict[str, str]:
    """Return the source text of the user's modules, by name."""
    specs = {name: importlib.util.find_spec(name) for name in own_modules(board)}
    files = {name: Path(spec.origin) for name, spec in specs.items() if spec and spec.origin}
    return {name: file.read_text(encoding="utf-8") for name, file in files.items()}


def _name_of_custom(board: ModuleType) -> Iterator[str]:
    """Check that the user's custom module does not have the name of an extra."""
    name = getattr(board, "CUSTOM", "")
    if name and name in own_modules(board):
        yield f"CUSTOM is {name!r}: EXTRAS has a module of that name; choose another name"


def _imports_of_extras(board: ModuleType) -> Iterator[str]:
    """Report imports of firmware modules in the user's modules: a board may lack such a module,
    and its constants are inlined there."""
    packages = {path.name for path in paths.FIRMWARE.iterdir() if path.is_dir()} - {"extras"}
    for name, text in _own_extras(board).items():
        for module in imports(text):
            if module.partition(".")[0] in packages:
                yield (
                    f"EXTRAS: {name} imports {module}, which boards may not "
                    "have: use only `cnc` and what boards have"
                )


def _wires(board: ModuleType) -> Iterator[str]:
    """Check that everything switched on or inverted has a pin."""
    for option, name in (("SAFETY_DOOR", "door"), ("MIST", "mist")):
        if getattr(board, option, False) and not _wired(board, name):
            yield f"{option} is set and there is no pin for the {name}"
    has_power = getattr(board, "SPINDLE_PWM", None) is not None
    is_laser = getattr(board, "TOOL", "spindle") == "laser"
    if is_laser and not has_power:
        yield "TOOL = laser: there is no pin for SPINDLE_PWM"
    if is_laser and len(board.STEP) > MOST_MOTORS_WITH_LASER:
        most = MOST_MOTORS_WITH_LASER
        yield f"TOOL = laser: its beam takes what a motor takes, and leaves {most}"
    for name in getattr(board, "INVERT", ()):
        if name in INVERTIBLE and getattr(board, name, None) is None:
            yield f"INVERT: there is no pin for {name}"
    inverted, controls = getattr(board, "CONTROL_INVERT", 0), getattr(board, "CONTROL", ())
    for bit, name in enumerate(CONTROLS):
        is_missing = controls[bit : bit + 1] in ((), (None,))  # CONTROL is too short, or has None
        if inverted >> bit & 1 and is_missing:
            yield f"CONTROL_INVERT: there is no pin for {name}, so it would always be active"


def _network(board: ModuleType) -> Iterator[str]:
    """Check that the board can serve the page and that its network exists."""
    chip, link = CHIPS.get(getattr(board, "CHIP", "")), getattr(board, "LINK", "")
    page = getattr(board, "PAGE", None) is True
    if page and getattr(board, "MPY_ARCH", "") == TOO_SMALL:
        yield NO_PAGE
    elif page and link not in WIRELESS.values():
        yield 'PAGE: it needs a network, LINK = "wifi", or "uart_wifi" on an ESP32'
    elif chip and not chip.radio and link in WIRELESS.values():
        yield f"LINK: {chip.title} has no radio"


def _card(board: ModuleType) -> Iterator[str]:
    """Check the pins of an SD card: RP2040 and RP2350 have two SPIs, each with fixed pins."""
    pins = getattr(board, "SD_CARD", ())
    if not pins:
        return
    if not getattr(board, "JOBS", ""):
        yield 'SD_CARD is for jobs: add JOBS = "jobs"'
    if len(pins) != len(_SPI_REMAINDERS) + 1 or None in pins:
        yield "SD_CARD needs four pins: clock, to the card, from the card, select"
    elif board.ENGINE == "pio":
        bus_pins = pins[: len(_SPI_REMAINDERS)]  # without the last one, select
        spis = {(pin >> _SPI_PINS_LOG2) % 2 for pin in bus_pins}
        roles = zip(bus_pins, _SPI_REMAINDERS, strict=True)
        if len(spis) > 1 or any(pin % 4 != remainder for pin, remainder in roles):
            numbers = ", ".join(map(str, bus_pins))
            yield f"SD_CARD: {numbers} are not SCK, TX and RX of one SPI, as 10, 11, 12 are"


def _wired(board: ModuleType, name: str) -> bool:
    """Return whether there is a pin for the "mist" or the "door", the last control input."""
    if name == "mist":
        return getattr(board, "MIST_PIN", None) is not None
    return len(getattr(board, "CONTROL", ())) == len(CONTROLS) and board.CONTROL[-1] is not None


def _firmware(board: ModuleType) -> Iterator[str]:
    """Report what the firmware itself refuses: an extra, or a missing module."""
    paths.use_firmware()
    from boot.options import Options

    try:
        Options(board)
    except ValueError as error:
        yield str(error)
    except ImportError as error:
        yield f"EXTRAS: {error}: put it in the folder of the board file"
    except Exception as error:
        yield f"EXTRAS: a module fails: {type(error).__name__}: {error}"
    else:
        yield from _imports_of_extras(board)
        yield from _name_of_custom(board)


def _defaults(board: ModuleType) -> Iterator[str]:
    """Report defaults of settings that the firmware would refuse."""
    paths.use_firmware()
    from base.errors import GrblError
    from base.settings import Settings

    from ..grbl.messages import meaning
    from ..sim.rig import MemoryStore

    settings = Settings(MemoryStore(), motor_names.axes_of(board), defaults={})
    try:
        tables = tables_of(board)
    except ValueError:  # _firmware() reports it
        return
    for rows in tables.values():
        settings.rows = (*(row for row in settings.rows if row not in rows), *rows)
    settings.signed = dict.fromkeys(SIGNED, inf)  # the extra itself checks the range
    settings.load()
    for number, value in getattr(board, "DEFAULTS", {}).items():
        try:
            settings.set(number, value)
        except GrblError as error:
            line = f"${number}={value:g}"
            why = meaning(f"error:{error.args[0]}", line)
            yield f"DEFAULTS: {line} is refused: {why}"
