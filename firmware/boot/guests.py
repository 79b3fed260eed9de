"""Guests: the modules of extras that a board file asks for.

Imported at start and forgotten again.
"""

import gc
import sys

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType

    from interfaces import Extra

# Words that ask for an extra of ours, and its module; the first of each asks for none.
_DIALECTS = {
    "1.1": "",
    "0.9": "dialect_09",
    "0.9i": "dialect_09",
    "0.9j": "dialect_09",
    "hal": "dialect_hal",
}
_NETWORKS = ("wifi", "uart_wifi")  # links
_TOOLS = {"spindle": "", "laser": "laser", "punch": "punch"}


def names(board: "ModuleType", with_custom: bool) -> "list[str]":
    """Modules by their names; with_custom: the user has modules of his own. Raises ValueError
    where a word asks for none there is."""
    option = board.__dict__.get  # getattr() would keep the names for good
    dialect = _known("DIALECT", option("DIALECT", "1.1"), _DIALECTS)
    tool = _known("TOOL", option("TOOL", "spindle"), _TOOLS)
    ganged = "ganged" if option("MOTORS", "") else ""
    home_order = "home_order" if option("HOMING", ()) else ""
    network = "net_access" if option("LINK", "usb") in _NETWORKS else ""
    drains = "drains" if option("COUNT_DRAINS", False) else ""
    limits = [pin for pin in option("LIMIT", ()) if pin is not None]
    shared_limits = "shared_limits" if len(set(limits)) < len(limits) else ""
    backlash = "backlash" if option("BACKLASH", False) else ""
    nonlinear = "nonlinear" if option("KINEMATICS", "") else ""
    own: "tuple[str, ...]" = option("EXTRAS", ())
    custom = "custom" if with_custom else ""
    # Those that have their option's name.
    moves, skew, rotary, jerk, clusters, jobs, tmc2209, lenient = [
        word.lower() if option(word) else ""
        for word in ("MOVES", "SKEW", "ROTARY", "JERK", "CLUSTERS", "JOBS", "TMC2209", "LENIENT")
    ]
    # In this order: the network is told of lines before others are; second motors go with what the
    # first do; which axes are homed comes before when, that before who shares an input, and all
    # before what drivers feel of it; a laser's part in each row is behind that of jerk; and what
    # the user's own take is theirs.
    axes = nonlinear, moves, ganged, backlash, skew, rotary, home_order, shared_limits
    ours = (network, dialect) + axes + (tmc2209, jerk, tool, clusters, drains, jobs)
    return _ours(ours) + list(own) + _ours((custom, lenient))


def _ours(names: "tuple[str, ...]") -> "list[str]":
    return ["extras." + name for name in names if name]


def _known(option: str, word: str, known: "dict[str, str]") -> str:
    if word not in known:
        words = list(known)
        last = words.pop()
        raise ValueError("%s is %s or %s, not %s" % (option, ", ".join(words), last, word))
    return known[word]


def customs(board: "ModuleType") -> "tuple[str, ...]":
    """The user's own modules that are there: a file of that name, or those of a folder."""
    from ports import user_files

    return user_files.modules(board.__dict__.get("CUSTOM", "custom"))


def modules(asked: "list[str]") -> "list[Extra]":
    """The modules themselves, by their names."""
    if [name for name in asked if name not in sys.modules]:
        gc.collect()  # else what they leave for good is spread over all of memory
    return [__import__(name, None, None, ("install",)) for name in asked]


def pins(board: "ModuleType") -> "tuple[str, ...]":
    """What they call pins in the board file."""
    found: "tuple[str, ...]" = ()
    for module in modules(names(board, False)):
        found += getattr(module, "PINS", ())
    return found
