"""Settings of a Grbl as a file: `$n=v` lines, each with its meaning and unit as a comment.

The file is a program that any sender can stream to a Grbl: comments begin with `;` and contain
nothing that acts in real time. Its first lines name the firmware it came from.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from .. import paths
from .comments import setting_comments
from .gcode_file import is_text, is_utf8, name_of, read_utf8

if TYPE_CHECKING:
    from base.settings import Row, Rows

AXES = "XYZABC"
SIGNED = {*range(170, 180), 780, 781, 782}  # may be negative: squaring offsets, skew
# Meaning of 0, which Grbl accepts, by the number without the axis.
_ZEROS = {
    "10": "0 steps/mm for",
    "11": "a highest rate of 0 for",
    "12": "an acceleration of 0 for",
}
# $10x to $12x of 0: the number without the axis, and the axis.
_ZERO = re.compile(r"\$(1[012])([0-5])=(?:0+\.?0*|\.0+)")

# A setting, also with a comment: number and value.
SETTING = re.compile(r"\$(\d+)\s*=\s*([^;( ]*)\s*(?:[;(].*)?")
# Ignored lines of consoles and senders' files: comments, answers, requests, empty startup lines.
_IGNORED = re.compile(r"(?:[;(\[#>].*|ok|%|\$\$|\$N\d=)?", re.IGNORECASE)
_VERSION = re.compile(r"\[(?:VER:)?(\d+\.\d+)(\w*)\.(\d+):([^\]]*)\]")
_OPTIONS = re.compile(r"\[OPT:([^\]]*)\]")
# Bytes that act even in a comment are replaced in texts about settings.
_WITHOUT_REALTIME = str.maketrans({"?": ".", "!": ".", "~": "-", "`": None})
_MARK = "\ufeff"  # the mark with which some editors begin a file in UTF-8
_SAME_RATIO = 1e-6  # a greater difference is one in single precision, in which Grbl computes
_SAME_DECIMALS = 0.0006  # a greater difference is one in the three decimals that Grbl prints


class SettingsError(Exception):
    """A file that cannot be used, or not for this machine; the text has cause and next step."""


class Meaning(NamedTuple):
    """The meaning of a setting. name is short, text has the rest; limits: allowed values."""

    name: str
    text: str
    unit: str
    limits: str = ""


@dataclass
class Firmware:
    """The identity of a firmware, from $I."""

    version: str = ""  # 1.1
    letter: str = ""  # h
    build: str = ""  # 20190830
    name: str = ""
    options: str = ""  # V,15,128

    @classmethod
    def read(cls, lines: Iterable[str]) -> "Firmware":
        """Find it in lines, those of $I or of a file; what is not there stays ""."""
        found = cls()
        for line in lines:
            if match := _VERSION.search(line):
                found.version, found.letter, found.build, found.name = match.groups()
            elif match := _OPTIONS.search(line):
                found.options = match[1]
        return found

    def lines(self) -> list[str]:
        """Return the lines as $I has them."""
        return [
            f"[VER:{self.version}{self.letter}.{self.build}:{self.name}]",
            f"[OPT:{self.options}]",
        ]

    def __str__(self) -> str:
        return f"Grbl {self.version}{self.letter} ({self.build})"


@dataclass
class Settings:
    """The settings of one machine by number, with values as it prints them."""

    firmware: Firmware = field(default_factory=Firmware)
    values: dict[int, str] = field(default_factory=dict)

    @classmethod
    def read(cls, text: str) -> "Settings":
        """Read a file, or the answers to $I and $$. SettingsError names an invalid line."""
        text = text.removeprefix(_MARK)
        settings = cls(Firmware.read(text.splitlines()))
        for number, line in enumerate(text.splitlines(), 1):
            match = SETTING.fullmatch(line.strip())
            if match:
                _store(settings.values, number, int(match[1]), match[2])
            elif not _IGNORED.fullmatch(line.strip()):
                raise SettingsError(f"line {number} is no setting: {line.strip()}")
        return settings

    def lines(self) -> list[str]:
        """Return lines such as `$110=500.000`, sorted by number."""
        return [f"${number}={value}" for number, value in sorted(self.values.items())]

    def text(self, origin: str = "") -> str:
        """Return the text of the file."""
        lines = [f"; Settings of a Grbl{', ' + origin if origin else ''}"]
        lines += [f"; {line}" for line in self.firmware.lines()]
        width = max((len(f"${n}={v}") for n, v in self.values.items()), default=0)
        for number, value in sorted(self.values.items()):
            lines.append(f"{f'${number}={value}':{width}} {_comment(number)}".rstrip())
        return "\n".join(lines) + "\n"


def read_settings(file: Path) -> Settings:
    """Return the settings in a file, `-` is stdin, in UTF-8, UTF-16 or Latin-1. SettingsError has
    the cause."""
    name = name_of(file)
    try:
        data = read_utf8(file)
        if not is_text(data):
            raise ValueError(f"{name} cannot be read: it is no text")
        settings = Settings.read(data.decode("utf-8" if is_utf8(data) else "latin-1"))
    except (OSError, ValueError) as error:
        raise SettingsError(str(error)) from error
    except SettingsError as error:
        raise SettingsError(f"{name}: {error}") from error
    if not settings.values:
        raise SettingsError(f"{name} has no settings (lines of the form $n=v)")
    return settings


class Change(NamedTuple):
    """A change of a setting."""

    number: int
    before: str
    after: str

    def as_json(self) -> dict[str, object]:
        """Return the change with the setting's meaning."""
        said = meaning(self.number)
        return {**self._asdict(), "name": said.name, "unit": said.unit}


def _store(values: dict[int, str], line: int, number: int, value: str) -> None:
    """Add a setting to values. SettingsError names its line if it is invalid or repeated."""
    try:
        is_valid = isfinite(float(value)) and (float(value) >= 0 or number in SIGNED)
    except ValueError:
        is_valid = False
    if not is_valid:
        raise SettingsError(f"line {line}: ${number} cannot be {value or 'nothing'}")
    if number in values:
        raise SettingsError(f"line {line}: ${number} is there twice; remove one")
    values[number] = value


@cache
def tables() -> dict[str, "Rows"]:
    """Return the firmware's tables of settings by module, including those of extras whose numbers
    no other module has."""
    paths.use_firmware()
    from base import settings
    from extras.kinematics import skew
    from extras.motors import backlash, ganged, home_order, jerk, tmc2209

    return {
        "base/settings": settings._TABLE,
        "extras/motors/backlash": backlash._SETTINGS,
        "extras/motors/ganged": (*ganged._INVERT, *ganged._SQUARING, *ganged._OFFSETS),
        "extras/motors/home_order": home_order._CYCLES + home_order._RATES,
        "extras/motors/jerk": jerk._SETTINGS,
        "extras/kinematics/skew": skew._SETTINGS,
        "extras/motors/tmc2209": tmc2209._SETTINGS,
    }


def of_tool(name: str) -> "Rows":
    """Return the rows of a "punch" or "laser" that replaces the spindle; other modules use the
    same numbers."""
    paths.use_firmware()
    from extras.tools import laser, punch

    return {"laser": laser._SETTINGS, "punch": punch._SETTINGS}[name]


def row_meaning(module: str, row: "Row") -> Meaning:
    """Return the meaning of a row of a module's table; for all axes if it has a value per axis."""
    number, _, kind, _, unit = row
    comment = setting_comments(module)[number].translate(_WITHOUT_REALTIME)
    name, _, text = comment.partition(". ")  # its first sentence, and the rest
    if is_per_axis(row):
        name, _, more = name.partition(", one value per axis")  # true of the row only
        more = more.strip(",. ").capitalize()  # such as: from the homing switch
        text = " ".join(part for part in (more and f"{more}.", text) if part)
    return Meaning(
        name.rstrip("."), text, unit, "any number" if number in SIGNED else _limits(kind)
    )


def is_per_axis(row: "Row") -> bool:
    """Return whether it has a number for each axis."""
    from base import settings

    return row[2] == settings.AXIS


def _limits(kind: int) -> str:
    """Return which values a setting of this kind may have, in words."""
    from base import settings

    return {settings.INT: "0 to 255", settings.BOOL: "0 or 1"}.get(kind, "0 or more")


@cache
def _table() -> dict[int, Meaning]:
    """Return the meaning of every setting of the firmware, per axis, including extras whose
    numbers no other module has."""
    table = {}
    for module, rows in tables().items():
        for row in rows:
            number, text = row[0], row_meaning(module, row)
            if is_per_axis(row):  # $100 for X, $101 for Y
                for axis, letter in enumerate(AXES):
                    table[number + axis] = text._replace(name=f"{text.name} {letter}")
            else:
                table[number] = text
    return table


def meaning(number: int) -> Meaning:
    """Return the meaning of a setting; empty if there is none of that number."""
    return _table().get(number, Meaning("", "", ""))


def as_line(text: str) -> str:
    """Return `120=500` or `$120=500` as a line. ValueError if it is neither, or one of zeros()."""
    number, _, value = text.strip().lstrip("$").partition("=")
    if not number.isdigit() or not value:
        raise ValueError(f"{text} is no setting; write it as 120=500")
    line = f"${number}={value}"
    if found := zeros([line]):
        raise ValueError(found[0])
    return line


def zeros(lines: Iterable[str]) -> list[str]:
    """Return in words which settings are 0, `$100=0`, so that an axis does not move as it
    should."""
    matches = filter(None, map(_ZERO.fullmatch, lines))
    return [
        f"{match[0]} means {_ZEROS[match[1]]} {AXES[int(match[2])]}: it will not move as it should"
        for match in matches
    ]


def _comment(number: int) -> str:
    """Return the comment for a setting's line in a file; "" for an unknown setting."""
    text = meaning(number)
    if not text.name:
        return ""
    return f"; {text.name}, {text.unit}. {text.text}".strip()


def same(one: str, other: str) -> bool:
    """Return whether a Grbl would print both values alike."""
    try:
        a, b = float(one), float(other)
    except ValueError:
        return one == other
    return abs(a - b) <= max(_SAME_DECIMALS, _SAME_RATIO * max(abs(a), abs(b)))


def changes(machine: Mapping[int, str], wanted: Mapping[int, str]) -> list[Change]:
    """Return the changes that the wanted settings make on a machine."""
    return [
        Change(number, machine[number], value)
        for number, value in sorted(wanted.items())
        if number in machine and not same(machine[number], value)
    ]


def check_known(numbers: Iterable[int], known: Iterable[int]) -> None:
    """Raise SettingsError if there are unknown numbers."""
    if unknown := sorted({*numbers} - {*known}):
        names = ", ".join(f"${number}" for number in unknown)
        raise SettingsError(f"the machine has no {names}; remove that from the file")


def check_fit(file: Settings, machine: Settings, any_version: bool, complete: bool) -> None:
    """Raise SettingsError if a file is not for this machine. any_version: it may be from another
    version of Grbl. complete: it must have all settings that the machine has."""
    of_file, of_machine = file.firmware, machine.firmware
    if not any_version:
        if not of_file.version:
            raise SettingsError(
                "the file does not say which Grbl it is for; if it fits "
                f"{of_machine}, say so with --any-version"
            )
        if of_file.version != of_machine.version:
            raise SettingsError(
                f"the file is for {of_file}, but the machine runs {of_machine}; if it fits, say "
                "so with --any-version"
            )
    check_known(file.values, machine.values)
    missing = sorted(machine.values.keys() - file.values.keys())
    if complete and missing:
        names = ", ".join(f"${number}" for number in missing)
        raise SettingsError(f"the file has no {names}; push it instead of restoring it")
