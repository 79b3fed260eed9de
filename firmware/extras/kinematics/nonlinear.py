"""User-defined kinematics: KINEMATICS = "scara" in the board file, and scara.py next to it.

It is for machines whose motor positions are no sums of axes: arms, polar plotters. Programs,
reports, offsets, probing and soft limits use the tool's position in mm. Each motor moves one
joint. Steps ($100), rates ($110), accelerations ($120) and homing are in the joints' own units.
Paths are cut into chords (segmenter.py) within the arc tolerance, $12. Each chord is a block of
the planner (joint_planner.py). Its length is that of the tool's path, its limits are those of the
joints, including the acceleration that bends need. A target out of reach is refused before
anything of its line is executed.
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

# KINEMATICS, and the options not allowed with it.
EXCLUDED = ("KINEMATICS", "COREXY", "MOVES", "MOTORS", "ROTARY", "JERK", "CLUSTERS")
# Names that the geometry module must have.
_REQUIRED = ("inverse", "forward", "START", "HOME", "TRAVEL", "CENTRED", "FASTEST")


def _geometry(name: str, axes: int) -> "Geometry":
    """Import the geometry module of that name. ValueError if it lacks a name of _REQUIRED, or if
    one of its tuples has not one number per axis."""
    geometry: "Any" = __import__(name)
    for word in _REQUIRED:
        if not hasattr(geometry, word):
            raise ValueError("KINEMATICS: %s.py has no %s" % (name, word))
    for word in ("START", "HOME", "TRAVEL"):
        count = len(getattr(geometry, word, ()))
        if count != axes:
            raise ValueError(
                "KINEMATICS: %s has %d numbers, but STEP has %d pins" % (word, count, axes)
            )
    return geometry  # type: ignore[no-any-return]


def prepare(options: "Options", board: "ModuleType") -> None:
    """Select kinematics, planner, canon and homing. ValueError if the board file is wrong."""
    geometry = _geometry(board.__dict__.get("KINEMATICS", ""), options.axes)
    options.kinematics = NonlinearKinematics(options.axes, geometry)
    options.planner = NonlinearPlanner
    options.canon, options.homing_probing = NonlinearCanon, NonlinearHoming


def install(cnc: "Cnc") -> None:
    """Hook the check of reach into lines. Kernels execute no moves, because they plan a line as
    one block."""
    machine: "Any" = cnc.machine
    canon, interpreter = machine.canon, machine.interpreter
    canon.tell = cnc.message
    canon.modes, canon.block = machine.modes, interpreter.block
    machine.state.hooks.checked += (canon.check_block,)
    interpreter.is_open = False  # the stream kernel leaves all lines to execute(),
    interpreter.watch(MOVE)  # which then lets no kernel execute a move
