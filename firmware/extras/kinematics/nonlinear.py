"""Kinematics of the user's own: KINEMATICS = "scara" in the board file, and scara.py beside it.

For machines whose motors follow no sum of axes: arms, polar plotters. Programs, reports, offsets,
probing and soft limits are of the place of the tool, in mm. What motors move are joints, one each,
in units of their own, and so are steps ($100), rates ($110), acceleration ($120) and homing. Ways
are cut into chords (segmenter.py) within the arc tolerance, $12, each a block of the planner
(joint_planner.py): its length is the tool's, and its limits are those of the joints, which it may
not bend faster than they can follow. What is out of reach is refused before anything of its line
is done.
"""

from language.block_layout import MOVE
from micropython import const

from extras.kinematics.joint_planner import NonlinearKinematics, NonlinearPlanner
from extras.kinematics.nonlinear_canon import NonlinearCanon, NonlinearHoming

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from types import ModuleType
    from typing import Any

    from interfaces import Geometry, Options

    from extras.api import Cnc

_WORDS = ("COREXY", "MOVES", "MOTORS", "ROTARY", "JERK", "CLUSTERS")
_ASKED = ("inverse", "forward", "START", "HOME", "TRAVEL", "CENTRED", "FASTEST")


def _geometry(name: str, axes: int) -> "Geometry":
    """The module of that name. ValueError where it has not what it takes."""
    geometry: "Any" = __import__(name)
    for word in _ASKED:
        if not hasattr(geometry, word):
            raise ValueError("KINEMATICS: %s.py has no %s" % (name, word))
    for word in ("START", "HOME", "TRAVEL"):
        count = len(getattr(geometry, word, ()))
        if count != axes:
            raise ValueError("KINEMATICS: %s has %d numbers, STEP %d pins" % (word, count, axes))
    return geometry  # type: ignore[no-any-return]


def prepare(options: "Options", board: "ModuleType") -> None:
    """What such a machine is made of. ValueError where that cannot be."""
    option = board.__dict__.get
    for word in _WORDS:
        if option(word):
            raise ValueError("KINEMATICS and %s are not for the same machine" % word)
    geometry = _geometry(option("KINEMATICS", ""), options.axes)
    options.kinematics = NonlinearKinematics(options.axes, geometry)
    options.planner = NonlinearPlanner
    options.canon, options.homing_probing = NonlinearCanon, NonlinearHoming


def install(cnc: "Cnc") -> None:
    """Have lines checked before anything of them is done. None takes the short way."""
    machine: "Any" = cnc.machine
    canon, interpreter = machine.canon, machine.interpreter
    canon.pump, canon.tell = machine.protocol.pump, cnc.message
    canon.modes, canon.block = machine.modes, interpreter.block
    machine.state.hooks.checked += (canon.check_block,)
    interpreter.is_open = False
    interpreter.watch(MOVE)
