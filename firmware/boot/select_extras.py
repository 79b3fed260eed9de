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

# The options that select one of our extras, and its module, in the order of installation. For the
# effect of the order see base/hooks.py.
_ORDER = (
    ("LINK", "net.net_access"),  # first: it receives lines before the others
    ("DIALECT", ""),  # changes replies, to which later extras add
    # Which motors an axis moves.
    ("KINEMATICS", "kinematics.nonlinear"),
    ("MOVES", "kinematics.motor_matrix"),
    ("MOTORS", "motors.ganged"),  # second motors repeat the steps of the first
    ("BACKLASH", "motors.backlash"),
    ("SKEW", "kinematics.skew"),
    ("ROTARY", "kinematics.rotary"),
    ("XYUV", "kinematics.wire"),
    # Homing, from the inside out: which axes, when, and whether their input is free.
    ("HOMING", "motors.home_order"),
    ("LIMIT", "motors.shared_limits"),
    ("TMC2209", "motors.tmc2209"),  # after all that changes motion, because it senses stalls
    ("JERK", "motors.jerk"),
    ("ARC_ACCELERATION", "motors.arc_limit"),
    ("TOOL", ""),  # a laser changes a segment after jerk has
    ("CLUSTERS", "tools.clusters"),
    ("COUNT_DRAINS", "underruns"),
    ("JOBS", "jobs.job_commands"),
    ("POWER_FAIL", "power_fail"),
)
# Options whose value selects one of several modules; "" is no module.
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
_NETWORKS = ("wifi", "uart_wifi")  # values of LINK with a network
# With extras, garbage is collected each time so many bytes were allocated, until the machine is
# built. With a custom.py the largest free block is 18 kB then, and 2.7 kB by the rule for a plain
# board (power_up.py).
_COLLECT_BYTES = const(8192)  # garbage is collected after so many


def extra_names(board: "ModuleType", with_custom: bool) -> "list[str]":
    """Return the names of the modules of all extras that the board file selects, in the order of
    installation. with_custom: the user has custom modules. Raises ValueError if an option has an
    unknown value."""
    option = board.__dict__.get  # getattr() would intern the names for good
    # _ORDER: pairs of an option and the module that it selects, "" for one of WORDS.
    selected = [_module(word, option(word), module) for word, module in _ORDER]
    own: "tuple[str, ...]" = option("EXTRAS", ())  # modules of the user
    # Last, because they handle only words that nothing else accepts.
    last = [
        "custom.user_modules" if with_custom else "",
        "dialects.lenient" if option("LENIENT") else "",
    ]
    return _ours(selected) + list(own) + _ours(last)


def _module(option: str, value: "Any", module: str) -> str:
    """Return the module that the option selects, or "". value: the board file's, None if it is
    not set; module: that of _ORDER."""
    if option in WORDS:  # the value is a word, which selects one of several modules
        return "" if value is None else known(option, value, WORDS[option])
    if option == "LINK":
        return module if value in _NETWORKS else ""
    if option == "LIMIT":  # only if two axes share a pin
        pins = [pin for pin in value or () if pin is not None]
        return module if len(set(pins)) < len(pins) else ""
    if option == "POWER_FAIL":
        return "" if value is None else module  # pin 0 is one
    return module if value else ""


def _ours(names: "list[str]") -> "list[str]":
    """Return the full names of our extras; "" is none."""
    return ["extras." + name for name in names if name]


def known(option: str, word: str, rows: "dict[str, Any]") -> "Any":
    """Return rows[word]. Raises ValueError, which names the option and the possible words, for
    another one."""
    if word not in rows:
        words = sorted(rows)  # MicroPython's dict has no order
        last = words.pop()
        raise ValueError("%s must be %s or %s, not %s" % (option, ", ".join(words), last, word))
    return rows[word]


def custom_modules(board: "ModuleType") -> "tuple[str, ...]":
    """Return the names of the user's own modules that exist: a file named by CUSTOM, or those of a
    folder of that name."""
    from ports.storage import user_files

    return user_files.modules(board.__dict__.get("CUSTOM", "custom"))


def import_extras(asked: "list[str]") -> "list[Extra]":
    """Import the modules with these names (asked), and return them."""
    if [name for name in asked if name not in sys.modules]:
        # Else the objects that they leave for good are spread over all of memory.
        gc.threshold(_COLLECT_BYTES)
        gc.collect()
    # With a name to import from it, __import__() returns the module, not its outermost package.
    return [__import__(name, None, None, ("install",)) for name in asked]


def check_excluded(extra: "Extra", board: "ModuleType") -> None:
    """Raise ValueError if the board file sets an option that the extra excludes. EXCLUDED of an
    extra: its own option, then those excluded."""
    excluded: "tuple[str, ...]" = getattr(extra, "EXCLUDED", ())
    for word in excluded[1:]:
        if board.__dict__.get(word):
            raise ValueError("%s and %s cannot be combined" % (excluded[0], word))


def pin_options(board: "ModuleType") -> "tuple[str, ...]":
    """Return the names of the board file's entries with pins of the selected extras; custom
    modules have none."""
    options: "tuple[str, ...]" = ()
    for module in import_extras(extra_names(board, with_custom=False)):
        options += getattr(module, "PINS", ())
    return options
