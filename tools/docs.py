"""`python -m ugrbl.docs`: makes the README's tables out of the firmware's own, and package.json.

A table stands between the lines `<!-- begin: NAME -->` and `<!-- end: NAME -->`; TABLES says
who makes it. What a table says of a row is the comment beside it in the firmware, or the words
below, which docs refuses to do without. --picture also keeps what `make run` has drawn.
"""

import ast
import json
import re
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Annotated

import typer

from . import __version__, build, differences, excuses, messages, paths

README = paths.FIRMWARE.parent / "README.md"
PAGES = (README, README.parent / "docs" / "conformance.md")  # those with tables
PACKAGE = README.with_name("package.json")
PICTURE = paths.EXAMPLES / "badge.png"
_DRAWN = Path("build/badge.png")
_COLOURS = 256

_MARKED = re.compile(r"(<!-- begin: ([\w-]+) -->\n).*?(<!-- end: \2 -->)", re.DOTALL)
_GROUP = re.compile(r"^GROUP_\w+ = const\((0x\w+)\)  # (.*)$", re.MULTILINE)
_COMMAND = re.compile(r"^ +\d+: self\.\w+,  # (\$\S+)$", re.MULTILINE)
_DOLLAR = re.compile(r"'?(\$[\w$=]*)'?")

_G_MEANINGS = {
    "G0": "Go to the target as fast as the axes can (rapid).",
    "G1": "Go to the target in a straight line at the feed rate.",
    "G2": "Arc, clockwise, to the target: centre I J K, or radius R.",
    "G3": "Arc, counterclockwise, to the target: centre I J K, or radius R.",
    "G4": "Dwell for P seconds.",
    "G10": "L2: set the offset of coordinate system P (1 to 6; 0: the active one). "
    "L20: set it so that the present place reads as the axis words say.",
    "G17": "Arcs lie in the XY plane.",
    "G18": "Arcs lie in the ZX plane.",
    "G19": "Arcs lie in the YZ plane.",
    "G20": "Lengths are in inches.",
    "G21": "Lengths are in millimetres.",
    "G28": "Rapid to the place kept by G28.1; with axis words by way of the target, "
    "and only those axes.",
    "G28.1": "Keep the present place for G28.",
    "G30": "Rapid to the place kept by G30.1; with axis words by way of the target, "
    "and only those axes.",
    "G30.1": "Keep the present place for G30.",
    "G38.2": "Probe towards the workpiece until contact; none is ALARM:5.",
    "G38.3": "Probe towards the workpiece until contact; none is no alarm.",
    "G38.4": "Probe away from the workpiece until contact is lost; if it is not, ALARM:5.",
    "G38.5": "Probe away from the workpiece until contact is lost; if it is not, no alarm.",
    "G40": "Cutter compensation off: the only mode there is.",
    "G43.1": "Set the tool length offset (Z).",
    "G49": "No tool length offset.",
    "G53": "In this block, with G0 or G1: the target is in machine coordinates.",
    "G54": "Coordinate system 1.",
    "G55": "Coordinate system 2.",
    "G56": "Coordinate system 3.",
    "G57": "Coordinate system 4.",
    "G58": "Coordinate system 5.",
    "G59": "Coordinate system 6.",
    "G61": "Path control, exact path: the only mode there is.",
    "G80": "No motion mode: axis words without a command are refused.",
    "G90": "Targets are absolute.",
    "G91": "Targets are relative to the present place.",
    "G91.1": "Arc centres are relative to where the arc begins: the only mode there is.",
    "G92": "Shift all coordinate systems so that the present place reads as the axis words say.",
    "G92.1": "Take that shift back.",
    "G93": "F is the inverse of the time a block takes: F2 is half a minute.",
    "G94": "F is in units per minute.",
}
_M_MEANINGS = {
    "M0": "Pause until cycle start.",
    "M1": "Optional pause: accepted; there is no switch for it, so nothing happens.",
    "M2": "End of program: spindle and coolant off; G1 G17 G54 G90 G94; overrides at 100 %.",
    "M30": "The same as M2.",
    "M3": "Spindle clockwise at S. Laser mode: beam on at the power of S. Punch: armed.",
    "M4": "Spindle counterclockwise at S. Laser mode: beam follows the speed. Punch: armed.",
    "M5": "Spindle or laser off. Punch: disarmed.",
    "M7": "Mist coolant on. Board option `MIST`.",
    "M8": "Flood coolant on.",
    "M9": "All coolant off.",
    "M56": "Parking in action; with P0: not. Board option `OVERRIDE_CONTROL`.",
}
_COMMANDS = {
    "$$": "Show all settings.",
    "$G": "Show the modes in force.",
    "$C": "Check mode on: programs are checked, nothing moves. Again: off, with a reset.",
    "$X": "Unlock: leave the alarm.",
    "$#": "Show offsets and the last probing.",
    "$H": "Home. `$HX`, `$HY`, `$HZ`: one axis; board option `SINGLE_AXIS_HOMING`.",
    "$SLP": "Sleep: spindle, coolant and motors off until a reset.",
    "$I": "Show version and build options. `$I=text`: keep a text, shown with them.",
    "$RST=": "`$`: restore settings. `#`: clear offsets. `*`: both, startup lines and `$I` text.",
    "$N": "Show the startup lines. `$N0=line`, `$N1=line`: keep one; it runs after every start.",
}
_EVENTS = {
    0x3F: "Status report.",
    0x7E: "Cycle start: begin, or go on after a hold, a pause or a closed door.",
    0x21: "Feed hold: come to rest, keeping the position.",
    0x40: "With `DIALECT` 0.9: safety door, as 0x84. A character like others in 1.1.",
    0x84: "Safety door: hold, then spindle and coolant off.",
    0x85: "Jog cancel: end the jog and forget those that wait. Ignored otherwise.",
}
_RESET = "Soft reset: stop at once, start anew. While it moves steps are lost: ALARM:3."

Row = tuple[str, ...]


def _source(module: str) -> str:
    return (paths.FIRMWARE / f"{module}.py").read_text(encoding="utf-8")


def _above(module: str, line: int, what: str) -> str:
    """The comment that ends above a line; where an empty one parts it, what follows."""
    words: list[str] = []
    for text in reversed(_source(module).splitlines()[: line - 1]):
        comment = text.strip()
        if not comment.startswith("# "):
            break
        words.insert(0, comment[2:])
    if not words:
        raise ValueError(f"{what} has no comment above it in {module}.py")
    return _as_code(" ".join(words))


def _as_code(text: str) -> str:
    """The text with what begins with $ as code."""
    return _DOLLAR.sub(r"`\1`", text)


def _table(header: Row, rows: Iterable[Row]) -> str:
    lines = [header, ("---",) * len(header), *rows]
    return "\n".join(
        f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines
    )


# G and M words


@cache
def _group_names() -> dict[int, str]:
    return {int(bit, 16): name for bit, name in _GROUP.findall(_source("language/block"))}


def _group(word: str) -> str:
    """The modal group that the interpreter puts a word in."""
    from control.modes import Modal
    from language.block import Block
    from language.words import Words

    words = Words()
    words.read(bytearray(word.encode() + b"\0"), 0, len(word))
    block = Block(3, has_mist=True, has_override_control=True)
    block.begin(Modal())
    block.take(words)
    return _group_names()[block.commands]


def g_words() -> list[str]:
    """Every G word that the interpreter knows, in order."""
    paths.use_firmware()
    from language import block

    found = []
    for number in block._G_WORDS:
        if number not in block._WANTS_DECIMALS:
            found.append(f"G{number}")
        found += [f"G{number}.{part // 10}" for part in block._G_DECIMALS.get(number, ())]
    return found


def m_words() -> list[str]:
    """Every M word that the interpreter knows, options of the board included."""
    paths.use_firmware()
    from language import block

    return [f"M{number}" for number in block._M_WORDS]


def _at_start(word: str) -> bool:
    """A mode that a reset puts in force."""
    from control.modes import Modal
    from language.block import _G_WORDS, _M_WORDS, GROUP_M4

    if "." in word:
        return False
    table = _G_WORDS if word[0] == "G" else _M_WORDS
    group, name, value, *_ = table[int(word[1:])]
    return bool(name) and group != GROUP_M4 and getattr(Modal(), str(name)) == value


def _words_table(words: list[str], meanings: dict[str, str]) -> str:
    rows = []
    for word in words:
        start = " In force at start." if _at_start(word) else ""
        rows.append((f"`{word}`", _group(word), meanings[word] + start))
    return _table(("Word", "Group", "Meaning"), rows)


# Commands and bytes


def _commands() -> str:
    rows = [("`$`", "Show this list, in short."), ("`$n=value`", "Change setting n.")]
    rows.append(("`$J=words`", "Jog: a motion that a hold or jog cancel ends for good."))
    found = _COMMAND.findall(_source("talk/commands"))
    rows += [(f"`{command}`", _COMMANDS[command]) for command in found]
    return _table(("Command", "What it does"), rows)


def _byte(number: int) -> str:
    return f"`0x{number:02X}`" + (f" `{chr(number)}`" if 0x20 < number < 0x7F else "")


def _realtime() -> str:
    paths.use_firmware()
    from base import state
    from control import overrides, realtime

    rows = [(f"{_byte(realtime._SOFT_RESET)} Ctrl-X", _RESET)]
    rows += [(_byte(number), _EVENTS[number]) for number in (*state.EVENTS,)]
    names = {
        overrides._FEED: "Feed rate",
        overrides._RAPID: "Rapids",
        overrides._SPINDLE: "Spindle speed",
    }
    for number, (which, change) in overrides._OVERRIDES.items():
        sets = which == overrides._RAPID or change == 0
        amount = f"{change or 100} % of normal" if sets else f"{change:+d} %"
        rows.append((_byte(number), f"{names[which]}: {amount}."))
    rows.append((_byte(overrides._SPINDLE_STOP), "Spindle stop, on and off; in a hold only."))
    rows.append((_byte(overrides._FLOOD_TOGGLE), "Flood coolant on and off."))
    mist = "Mist coolant on and off. Board option `MIST`."
    rows.append((_byte(overrides._MIST_TOGGLE), mist))
    return _table(("Byte", "What it does"), rows)


# Settings, errors, alarms


def setting_comments() -> dict[int, str]:
    """What is said above each row of the settings' table; ValueError if one has no comment."""
    for node in ast.parse(_source("base/settings")).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "_TABLE":
            rows = [(ast.literal_eval(row.elts[0]), row.lineno) for row in _tuples(node.value)]
            return {number: _above("base/settings", at, f"${number}") for number, at in rows}
    raise ValueError("settings.py has no _TABLE")


def _tuples(table: ast.expr) -> list[ast.Tuple]:
    assert isinstance(table, ast.Tuple)
    return [row for row in table.elts if isinstance(row, ast.Tuple)]


def _settings() -> str:
    paths.use_firmware()
    from base import settings

    comments = setting_comments()
    rows = []
    for number, _, kind, default, unit in settings._TABLE:
        axes = range(3 if kind == settings._AXIS else 1)
        names = " ".join(f"`${number + axis}`" for axis in axes)
        rows.append((names, f"{default:g}", unit, comments[number]))
    return _table(("Setting", "Default", "Unit", "Meaning"), rows)


def _numbers(kind: str, table: dict[int, str]) -> str:
    rows = [(f"`{kind}:{number}`", _as_code(words)) for number, words in table.items()]
    return _table(("Reply", "Meaning"), rows)


# Boards


def board_options() -> dict[str, tuple[str, str]]:
    """Options of a board file by name: default and meaning; ValueError if one has no comment."""
    found: dict[str, tuple[str, str]] = {}
    for module in ("boot/wiring", "ports/input_pins", "ports/port"):
        nodes = ast.walk(ast.parse(_source(module)))
        calls = [node for node in nodes if isinstance(node, ast.Call)]
        for call in sorted(calls, key=lambda call: call.lineno):
            if ast.unparse(call.func) == "option":
                name = ast.literal_eval(call.args[0])
                if name not in found:  # the first who reads it says what it is
                    words = _above(module, call.lineno, f"option {name}")
                    found[name] = (ast.unparse(call.args[1]), words)
    return found


def _default(text: str) -> str:
    """A default as a board file would say it."""
    from boot import wiring

    return f"`{getattr(wiring, text, text)}`"


def _options() -> str:
    paths.use_firmware()
    rows = [
        (f"`{name}`", _default(text), words) for name, (text, words) in board_options().items()
    ]
    return _table(("Option", "Default", "Meaning"), rows)


def boards() -> dict[str, str]:
    """Every board file with the first line of what it says it is."""
    found = {}
    for path in sorted(paths.BOARDS.glob("[!_]*.py")):
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
        if not text:
            raise ValueError(f"{path} does not say what it is")
        found[path.name] = text.splitlines()[0]
    return found


def _boards() -> str:
    return _table(("File", "Machine"), [(f"`{name}`", text) for name, text in boards().items()])


# Differences from Grbl


def _differences() -> str:
    rows = [(row.name, "replies", row.reason) for row in differences.DIFFERENCES]
    rows += [(row.name, "one case", row.reason) for row in differences.QUIRKS]
    rows += [(name, "motion", reason) for name, reason in differences.MOTION]
    rows += [
        (row.name, "whole cases", row.reason) for row in (*excuses.CASES, *excuses.MOTIONS[1:])
    ]
    rows = [(name, where, _as_code(reason)) for name, where, reason in rows]
    return _table(("Name", "Where", "What and why"), rows)


TABLES: dict[str, Callable[[], str]] = {
    "g-words": lambda: _words_table(g_words(), _G_MEANINGS),
    "m-words": lambda: _words_table(m_words(), _M_MEANINGS),
    "commands": _commands,
    "realtime": _realtime,
    "settings": _settings,
    "errors": lambda: _numbers("error", messages.errors()),
    "alarms": lambda: _numbers("ALARM", messages.alarms()),
    "options": _options,
    "boards": _boards,
    "differences": _differences,
}


def update(text: str) -> str:
    """The text with all its tables as they are now."""
    return _MARKED.sub(lambda found: f"{found[1]}{TABLES[found[2]]()}\n{found[3]}", text)


def package() -> str:
    """What `mip install` reads: every file of the firmware, and where it is beside this text."""
    rows = ",\n".join(f"    {json.dumps([name, f'firmware/{name}'])}" for name in build.sources())
    return f'{{\n  "urls": [\n{rows}\n  ],\n  "version": {json.dumps(__version__)}\n}}\n'


def _keep_picture() -> None:
    """Keep the picture that `make run` has drawn, in fewer colours and so in fewer bytes."""
    from PIL import Image

    with Image.open(_DRAWN) as drawn:
        few = drawn.convert("RGB").quantize(_COLOURS, method=Image.Quantize.MAXCOVERAGE)
    few.save(PICTURE, optimize=True)


def _renew(file: Path, new: str) -> None:
    old = file.read_text(encoding="utf-8") if file.exists() else ""
    if new != old:
        file.write_text(new, encoding="utf-8")
    print(file.name, "has been brought up to date" if new != old else "is up to date")


def main(
    picture: Annotated[bool, typer.Option("--picture", help=f"Keep {_DRAWN} as well.")] = False,
) -> None:
    """Bring the tables in README and docs/, and package.json, up to date."""
    for page in PAGES:
        _renew(page, update(page.read_text(encoding="utf-8")))
    _renew(PACKAGE, package())
    if picture:
        _keep_picture()


if __name__ == "__main__":
    typer.run(main)
