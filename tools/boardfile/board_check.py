"""What is wrong with a board file: judged from its data, before anything is on a board."""

import difflib
import importlib.util
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from .. import paths
from .new_board import AXES, CHIPS, CONTROLS, ITEMS, Board, BoardError, Chip, check_item

# Which chip it may be where a board file does not say.
_BY_ARCH = {
    "armv6m": ("rp2040",),
    "armv7emsp": ("rp2350",),
    "xtensawin": ("esp32", "esp32s3"),
}
_RP2350 = CHIPS["rp2040"]._replace(title="RP2350 on a board of its own", mpy_arch="armv7emsp")
_CHIPS = {**CHIPS, "rp2350": _RP2350}
_ENGINES = {"pio": ("armv6m", "armv7emsp"), "rmt": ("xtensawin",), "i2s": ("xtensawin",)}
_LINKS = ("usb", "uart")
_I2S_NEEDS = ("ENABLE", "I2S", "I2S_RATE_HZ", "I2S_BUFFERS")
# How the firmware reads a name of the board file, and what these tools do.
_READ = re.compile(r"""\b(?:option\(|getattr\(\s*board,\s*)"([A-Z]\w*)"|\bboard\.([A-Z]\w*)""")
_READ_HERE = {"CHIP", "MPY_ARCH"}

# Pins that new_board does not ask for.
_OTHERS = {"REPL_PIN": "the button for MicroPython's prompt"}
# What has a pin for each axis, or each of the controls.
_TUPLES = {item.name for item in ITEMS if item.per_axis} | {"CONTROL"}
# Outputs that may be on when low.
_INVERTIBLE = ("SPINDLE_PWM", "SPINDLE_ON", "SPINDLE_DIR", "FLOOD", "MIST_PIN")
_MOST_PWM = 16383  # times 65535 is still a small integer, which an interrupt needs
_NEEDED_AXES = 3
_MOST_DEBOUNCE_MS = 5
_LEAST_LOOP_MS = 100


def problems(board: ModuleType) -> list[str]:
    """Every problem in words: what and why. None for a good board."""
    if is_simulated(board):
        return list(_firmware(board))
    found = list(_parts(board)) or list(_kinds(board))
    if found:
        return found
    check = _inputs if board.ENGINE == "i2s" else _pins
    found = min((list(check(board, chip)) for chip in _chips(board)), key=len)
    return [*found, *_options(board), *_firmware(board), *_defaults(board)]


def notes(board: ModuleType) -> list[str]:
    """What is worth to know about the pins of a good board."""
    if is_simulated(board):
        return []
    check = _inputs if board.ENGINE == "i2s" else _pins
    chip = min(_chips(board), key=lambda chip: len(list(check(board, chip))))
    behind = ("STEP", "DIR", "ENABLE") if board.ENGINE == "i2s" else ()
    held = [(name, pin) for name, pins in _held(board) for pin in pins if name not in behind]
    return [f"{name}: pin {pin} {chip.odd[pin]}" for name, pin in held if pin in chip.odd]


def is_simulated(board: ModuleType) -> bool:
    """A machine of the simulator, without pins."""
    return getattr(board, "ENGINE", "") == "sim"


def _chips(board: ModuleType) -> list[Chip]:
    names = (board.CHIP,) if hasattr(board, "CHIP") else _BY_ARCH[board.MPY_ARCH]
    return [_CHIPS[name] for name in names if name in _CHIPS]


def _parts(board: ModuleType) -> Iterator[str]:
    more = _I2S_NEEDS if getattr(board, "ENGINE", "") == "i2s" else ()
    for name in ("ENGINE", "MPY_ARCH", "STEP", "DIR", *more):
        if not hasattr(board, name):
            yield f"{name} is missing"
            return
    if board.ENGINE not in _ENGINES:
        yield f"ENGINE {board.ENGINE!r} is not one of {', '.join(_ENGINES)}"
    elif board.MPY_ARCH not in _ENGINES[board.ENGINE]:
        yield f"ENGINE {board.ENGINE!r} does not run on MPY_ARCH {board.MPY_ARCH!r}"
    elif not _chips(board):
        yield f"CHIP is not one of {', '.join(_CHIPS)}"
    elif getattr(board, "LINK", "usb") not in _LINKS:
        yield f"LINK {board.LINK!r} is not one of {', '.join(_LINKS)}"


def _kinds(board: ModuleType) -> Iterator[str]:
    """Numbers where numbers have to be, and what has one for each axis in parentheses."""
    names = [*(item.name for item in ITEMS), *_others(board), "CONTROL"]
    for name in names:
        value = getattr(board, name, None)
        if name in _TUPLES and value is not None and not isinstance(value, tuple):
            yield f"{name} is {value!r} and wants parentheses and commas: (2, 3, 4)"
        elif not all(pin is None or type(pin) is int for pin in _as_tuple(value)):
            yield f"{name} is {value!r}: pins are numbers"
    for name in ("PWM_MAX", "WATCHDOG_MS", "LOOP_MS", "LIMIT_DEBOUNCE_MS", "CONTROL_INVERT"):
        if type(getattr(board, name, 0)) is not int:
            yield f"{name} is {getattr(board, name)!r}: it is a whole number"
    if not isinstance(getattr(board, "INVERT", ()), tuple):
        yield f'INVERT is {board.INVERT!r} and wants parentheses and a comma: ("FLOOD",)'
    if not isinstance(getattr(board, "DEFAULTS", {}), dict):
        yield "DEFAULTS is not of the form {100: 800.0}"


def _others(board: ModuleType) -> dict[str, str]:
    """What else is a pin, those of extras included, and what it is for."""
    paths.use_firmware()
    from boot import guests

    try:
        names = guests.pins(board)
    except (ImportError, ValueError):
        names = ()  # _firmware() says it
    return {**_OTHERS, **{name: name.lower().replace("_", " ") for name in names}}


def _as_tuple(value: Any) -> tuple[Any, ...]:
    return value if isinstance(value, tuple) else (value,)


def _held(board: ModuleType) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Names in the board file with their pins, controls by their own names."""
    for item in ITEMS:
        if item.name not in CONTROLS and getattr(board, item.name, None) is not None:
            yield item.name, _as_tuple(getattr(board, item.name))
    for name, pin in zip(CONTROLS, getattr(board, "CONTROL", ()), strict=False):
        if pin is not None:
            yield name, (pin,)
    for name in _others(board):
        if getattr(board, name, None) is not None:
            yield name, _as_tuple(getattr(board, name))


def _pins(board: ModuleType, chip: Chip) -> Iterator[str]:
    """No pin twice, pins that exist, as many as the engine needs."""
    if len(board.STEP) < _NEEDED_AXES:
        yield f"STEP wants {_NEEDED_AXES} pins, for {AXES[:_NEEDED_AXES]}"
    if len(getattr(board, "CONTROL", (None,) * 4)) != len(CONTROLS):
        yield "CONTROL wants four entries, for reset, hold, start and door; None where not wired"
    items = {item.name: item for item in ITEMS}
    known = Board(board.__name__, chip)
    for name, pins in _held(board):
        # An enable per driver is as good as one for all.
        if name in items and not (name == "ENABLE" and len(pins) > 1):
            try:
                check_item(known, items[name], pins)
            except BoardError as error:
                yield str(error)
                continue
        else:
            yield from _loose(known, name, pins)
        known.pins[name] = pins


def _loose(known: Board, name: str, pins: tuple[int, ...]) -> Iterator[str]:
    used = {pin: other for other, held in known.pins.items() for pin in held}
    for count, pin in enumerate(pins):
        if pin not in known.chip.pins:
            yield f"{name}: {known.chip.title} has no pin {pin} to connect to"
        elif pin in used:
            yield f"{name}: pin {pin} is {used[pin]} already"
        elif pin in pins[:count]:
            yield f"{name} names pin {pin} twice"


def _inputs(board: ModuleType, chip: Chip) -> Iterator[str]:
    """Of a board whose outputs are behind shift registers: those apart, pins of the chip apart."""
    outputs = (*board.STEP, *board.DIR, *_as_tuple(getattr(board, "ENABLE", ())))
    for pin in sorted(set(outputs)):
        if outputs.count(pin) > 1:
            yield f"output {pin} of the shift registers has two uses"
    known = Board(board.__name__, chip, {"I2S": board.I2S})
    for name, pins in _held(board):
        if name not in ("STEP", "DIR", "ENABLE"):
            yield from _loose(known, name, pins)
            known.pins[name] = pins


@cache
def names() -> set[str]:
    """All that a board file can say."""
    found = set(_READ_HERE)
    for file in paths.FIRMWARE.rglob("*.py"):
        matches = _READ.findall(file.read_text(encoding="utf-8"))
        found.update(one or other for one, other in matches)
    return found


def _names_of_extras(board: ModuleType) -> set[str]:
    """What modules of the user's own read."""
    found: set[str] = set()
    for name in getattr(board, "EXTRAS", ()):
        spec = importlib.util.find_spec(name)
        if spec and spec.origin:
            matches = _READ.findall(Path(spec.origin).read_text(encoding="utf-8"))
            found.update(one or other for one, other in matches)
    return found


def _options(board: ModuleType) -> Iterator[str]:
    known = names() | _names_of_extras(board)
    for name in (name for name in vars(board) if name.isupper() and name not in known):
        meant = difflib.get_close_matches(name, known, 1)
        yield f"{name}: nothing reads it" + "".join(f"; is {one} meant?" for one in meant)
    if not 0 < getattr(board, "PWM_MAX", 1000) <= _MOST_PWM:
        yield f"PWM_MAX is from 1 to {_MOST_PWM}"
    if getattr(board, "WATCHDOG_MS", 0) > 8388:
        yield "WATCHDOG_MS is 8388 at the most: the watchdog counts no further"
    if getattr(board, "LOOP_MS", _LEAST_LOOP_MS) < _LEAST_LOOP_MS:
        yield f"LOOP_MS is {_LEAST_LOOP_MS} at the least: a collection of memory takes 30"
    for option, name in (("SAFETY_DOOR", "door"), ("MIST", "mist")):
        if getattr(board, option, False) and not _wired(board, name):
            yield f"{option} is set and there is no pin for the {name}"
    yield from _polarity(board)


def _polarity(board: ModuleType) -> Iterator[str]:
    """What is to be the other way round, and when a limit switch counts."""
    for name in getattr(board, "INVERT", ()):
        if name not in _INVERTIBLE:
            yield f"INVERT: {name} is not one of {', '.join(_INVERTIBLE)}"
        elif getattr(board, name, None) is None:
            yield f"INVERT: there is no pin for {name}"
    inverted, held = getattr(board, "CONTROL_INVERT", 0), getattr(board, "CONTROL", ())
    if not 0 <= inverted < 1 << len(CONTROLS):
        yield f"CONTROL_INVERT is a sum of 1, 2, 4 and 8, for {', '.join(CONTROLS)}"
    for bit, name in enumerate(CONTROLS):
        if inverted >> bit & 1 and held[bit : bit + 1] in ((), (None,)):
            yield f"CONTROL_INVERT: there is no pin for {name}, and open means pressed"
    if not 0 <= getattr(board, "LIMIT_DEBOUNCE_MS", 0) <= _MOST_DEBOUNCE_MS:
        yield f"LIMIT_DEBOUNCE_MS is {_MOST_DEBOUNCE_MS} at the most: a machine goes on meanwhile"


def _wired(board: ModuleType, name: str) -> bool:
    if name == "mist":
        return getattr(board, "MIST_PIN", None) is not None
    return len(getattr(board, "CONTROL", ())) == len(CONTROLS) and board.CONTROL[-1] is not None


def _firmware(board: ModuleType) -> Iterator[str]:
    """What the firmware itself would refuse: a dialect, a tool or its pins."""
    paths.use_firmware()
    from boot.options import Options

    words = {name: getattr(board, name, "") for name in ("TOOL", "DIALECT")}
    wrong = [name for name, value in words.items() if not isinstance(value, str)]
    yield from (
        f'{name} = {words[name]!r} wants quotation marks: "{words[name]}"' for name in wrong
    )
    if not wrong:
        try:
            Options(board)
        except ValueError as error:
            yield str(error)
        except ImportError as error:
            yield f"EXTRAS: {error}: it is to lie beside the board file"


def _defaults(board: ModuleType) -> Iterator[str]:
    paths.use_firmware()
    from base.errors import GrblError
    from base.settings import Settings

    from ..grbl.messages import meaning
    from ..sim.rig import MemoryStore

    settings = Settings(MemoryStore(), len(board.STEP), {})
    settings.load()
    for number, value in getattr(board, "DEFAULTS", {}).items():
        try:
            settings.set(number, value)
        except GrblError as error:
            yield f"DEFAULTS: ${number}={value:g} is refused: {meaning(f'error:{error.args[0]}')}"
