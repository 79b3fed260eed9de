"""Select the extras that a board file asks for, and import them.

Imported at start and forgotten again.
"""

import gc
import sys

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from interfaces import Extra

# The options that ask for an extra of ours, and its module, in the order in which they come in:
# base/hooks.py says what comes of that.
_ORDER = (
    ("LINK", "net.net_access"),  # hears of lines before others do
    ("DIALECT", ""),  # adds to what is said, and others to that
    # Which motor moves what.
    ("KINEMATICS", "kinematics.nonlinear"),
    ("MOVES", "kinematics.motor_matrix"),
    ("MOTORS", "motors.ganged"),  # second motors go with what the first do
    ("BACKLASH", "motors.backlash"),
    ("SKEW", "kinematics.skew"),
    ("ROTARY", "kinematics.rotary"),
    # Homing, from the inside out: which axes, when, and whether their input is free.
    ("HOMING", "motors.home_order"),
    ("LIMIT", "motors.shared_limits"),
    ("TMC2209", "motors.tmc2209"),  # after all that moves: what drivers feel of it
    ("JERK", "motors.jerk"),
    ("ARC_ACCELERATION", "motors.arc_limit"),
    ("TOOL", ""),  # a laser's part in each segment comes after that of jerk
    ("CLUSTERS", "tools.clusters"),
    ("COUNT_DRAINS", "underruns"),
    ("JOBS", "jobs.job_commands"),
)
# Options whose words ask for one module or another; the first of each asks for none.
WORDS = {
    "DIALECT": {
        "1.1": "",
        "0.9": "dialects.dialect_09",
        "0.9i": "dialects.dialect_09",
        "0.9j": "dialects.dialect_09",
        "hal": "dialects.dialect_hal",
    },
    "TOOL": {"spindle": "", "laser": "tools.laser", "punch": "tools.punch"},
}
_NETWORKS = ("wifi", "uart_wifi")  # links


def extra_names(board: "ModuleType", with_custom: bool) -> "list[str]":
    """Modules by their names; with_custom: the user has modules of his own. Raises ValueError
    where a word asks for none there is."""
    option = board.__dict__.get  # getattr() would keep the names for good
    found = [_module(word, option(word), module) for word, module in _ORDER]
    own: "tuple[str, ...]" = option("EXTRAS", ())
    # Last those whose words are only what nobody else takes.
    last = [
        "custom.user_modules" if with_custom else "",
        "dialects.lenient" if option("LENIENT") else "",
    ]
    return _ours(found) + list(own) + _ours(last)


def _module(word: str, value: "Any", module: str) -> str:
    """The module that an option asks for, or ""."""
    if word in WORDS:
        return "" if value is None else _known(word, value, WORDS[word])
    if word == "LINK":
        return module if value in _NETWORKS else ""
    if word == "LIMIT":
        pins = [pin for pin in value or () if pin is not None]
        return module if len(set(pins)) < len(pins) else ""
    return module if value else ""


def _ours(names: "list[str]") -> "list[str]":
    return ["extras." + name for name in names if name]


def _known(option: str, word: str, known: "dict[str, str]") -> str:
    if word not in known:
        words = list(known)
        last = words.pop()
        raise ValueError("%s is %s or %s, not %s" % (option, ", ".join(words), last, word))
    return known[word]


def custom_modules(board: "ModuleType") -> "tuple[str, ...]":
    """The user's own modules that are there: a file of that name, or those of a folder."""
    from ports.storage import user_files

    return user_files.modules(board.__dict__.get("CUSTOM", "custom"))


def import_extras(asked: "list[str]") -> "list[Extra]":
    """The modules themselves, by their names."""
    if [name for name in asked if name not in sys.modules]:
        gc.collect()  # else what they leave for good is spread over all of memory
    return [__import__(name, None, None, ("install",)) for name in asked]


def pin_options(board: "ModuleType") -> "tuple[str, ...]":
    """What they call pins in the board file."""
    found: "tuple[str, ...]" = ()
    for module in import_extras(extra_names(board, False)):
        found += getattr(module, "PINS", ())
    return found
