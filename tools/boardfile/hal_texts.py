"""The file from which a board with DIALECT = "hal" answers $ES, $ESH, $EG, $EA and $EE.

A row has a command, a number, and the line as grblHAL sends it. It is made from the firmware's own
tables; the firmware leaves out what its machine does not have.
"""

from collections.abc import Iterator
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

from .. import paths
from ..grbl.messages import alarms, errors
from ..grbl.settings_file import AXES, is_per_axis, row_meaning
from ..sim import motor_names
from .setting_tables import tables_of

if TYPE_CHECKING:
    from base.settings import Row

# Numbers of grblHAL's groups of settings.
_GROUPS = {
    0: "Root",
    1: "General",
    3: "Limits",
    6: "Spindle",
    11: "Homing",
    12: "Probing",
    35: "Stepper",
    36: "Stepper driver",
    42: "Axis",
    **{43 + axis: f"{letter}-axis" for axis, letter in enumerate(AXES)},
}
_AXIS_GROUP = 42  # parent of the groups of the axes, which have the next numbers
_GENERAL = 1  # a group
# Settings that are neither in the group of an axis nor general.
_MEMBERS = {
    3: (5, 20, 21),
    6: (30, 31, 33),
    11: (*range(22, 28), *range(44, 50), *range(170, 176), *range(347, 350)),
    12: (6,),
    35: (0, 1, 2, 3, 4, 8),
    36: (338, 339, 810),
}
_GROUP_OF = {number: group for group, numbers in _MEMBERS.items() for number in numbers}
_REPORT_MASK = 10  # the setting $10
_REPORT_MASK_BITS = "Machine position,Buffer state"  # names of its bits
# grblHAL's numbers for types of values
_BOOL = 0
_BITFIELD = 1
_AXIS_MASK = 4
_INTEGER = 5
_FLOAT = 6
_HEADER = "$-Code\tSetting\tUnits\tDatatype\tData format\tSetting Description\tMin\tMax"
# A board sends ASCII, and these characters separate values.
_PLAIN = str.maketrans({"…": "...", "|": "/", "[": "(", "]": ")", "`": None})
_IN_DEGREES = (("millimeters", "degrees"), ("millimetre", "degree"), ("mm", "deg"))


class _Kind(NamedTuple):
    """The type of a value: grblHAL's number and word for it, its format, its limits. form: of a
    bitfield, the names of its bits. least, most: "" for none."""

    number: int
    word: str
    form: str = ""
    least: str = ""
    most: str = ""


class _Setting(NamedTuple):
    """A setting and its texts."""

    number: int
    group: int
    name: str
    unit: str
    kind: _Kind
    text: str

    def row(self) -> str:
        """Return the row for programs ($ES). The two zeros: the machine need not restart after a
        change, and there may be no value."""
        type_number, _, form, least, most = self.kind
        unit = self.unit if type_number in (_INTEGER, _FLOAT) else ""
        head = f"{self.number}|{self.group}|{self.name}|{unit}"
        return f"ES {self.number} [SETTING:{head}|{type_number}|{form}|{least}|{most}|0|0]"

    def table_row(self) -> str:
        """Return the row for tables, with the description ($ESH)."""
        type_number, word, form, least, most = self.kind
        form = "axes" if type_number == _AXIS_MASK else form
        cells = self.name, self.unit, word, form, self.text, least, most, "0", "0"  # see row()
        return f"ESH {self.number} {self.number}\t" + "\t".join(cells)


def name() -> str:
    """Return the file's name on the board."""
    paths.use_firmware()
    from extras.dialects import dialect_hal

    return dialect_hal.FILE


def made(board: ModuleType) -> dict[str, bytes]:
    """Return the file by its path on that board; nothing for other dialects."""
    if getattr(board, "DIALECT", "") != "hal":
        return {}
    return {name(): "".join(f"{row}\r\n" for row in _rows(board)).encode("ascii")}


def _rows(board: ModuleType) -> Iterator[str]:
    """Yield the file's rows: settings twice, their groups, alarms and errors."""
    settings = _settings(board)
    yield from (setting.row() for setting in settings)
    yield f"ESH 0 {_HEADER}"
    yield from (setting.table_row() for setting in settings)
    for group, label in _GROUPS.items():
        if group <= _AXIS_GROUP + motor_names.axes_of(board):  # no groups of missing axes
            parent = _AXIS_GROUP if group > _AXIS_GROUP else 0
            yield f"EG {group} [SETTINGGROUP:{group}|{parent}|{label}]"
    for word, texts in (("ALARM", alarms()), ("ERROR", errors())):
        for number, text in sorted(texts.items()):
            yield f"E{word[0]} {number} [{word}CODE:{number}||{text.translate(_PLAIN)}]"


def _settings(board: ModuleType) -> list[_Setting]:
    """Return the board's settings, in the order of their numbers; those of its TOOL replace others
    with the same number."""
    by_number = {
        setting.number: setting
        for module, rows in tables_of(board).items()  # those of TOOL come last
        for row in rows
        for setting in _of_row(module, row, board)
    }
    return [by_number[number] for number in sorted(by_number)]


def _of_row(module: str, row: "Row", board: ModuleType) -> Iterator[_Setting]:
    """Yield the settings of a row of a module's table: one, or one per axis. Units of rotary axes
    are degrees."""
    meaning = row_meaning(module, row)
    text = meaning.text.translate(_PLAIN)
    kind = _kind(row, meaning.limits == "any number")
    if not is_per_axis(row):
        group = _GROUP_OF.get(row[0], _GENERAL)
        yield _Setting(row[0], group, meaning.name, meaning.unit, kind, text)
        return
    rotary = getattr(board, "ROTARY", "")
    for axis, letter in enumerate(AXES[: motor_names.axes_of(board)]):
        label, unit = f"{meaning.name} {letter}", meaning.unit
        for mm, degrees in _IN_DEGREES if letter in rotary else ():
            label, unit = label.replace(mm, degrees), unit.replace(mm, degrees)
        yield _Setting(row[0] + axis, _AXIS_GROUP + 1 + axis, label, unit, kind, text)


def _kind(row: "Row", is_signed: bool) -> _Kind:
    """Return the type of a setting's value, as grblHAL numbers and names it."""
    from base import settings

    number, _, kind, _, unit = row
    if kind == settings.BOOL:
        return _Kind(_BOOL, "bool")
    if kind == settings.INT and number == _REPORT_MASK:
        return _Kind(_BITFIELD, "bitfield", _REPORT_MASK_BITS)
    if kind == settings.INT and unit == "mask":
        return _Kind(_AXIS_MASK, "bitfield")
    if kind == settings.INT:
        return _Kind(_INTEGER, "integer", "##0", least="0", most="255")
    form = "#####0" if kind == settings.WHOLE else "#####0.000"
    return _Kind(_FLOAT, "float", "-" + form) if is_signed else _Kind(_FLOAT, "float", form, "0")
