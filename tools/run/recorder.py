"""Counts what a simulated machine was told to do and what its motors did."""

import json
from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from . import wide_arcs

if TYPE_CHECKING:
    from ..sim.rig import Rig

_Value = TypeVar("_Value")


@dataclass
class Totals:
    """What a machine has done, ready for JSON."""

    time_s: float = 0.0
    distance_mm: float = 0.0
    steps_planned: dict[str, int] = field(default_factory=dict)
    steps_made: dict[str, int] = field(default_factory=dict)
    bounds_mm: dict[str, tuple[float, float]] = field(default_factory=dict)
    final_position_mm: dict[str, float] = field(default_factory=dict)
    steps_probed: dict[str, int] = field(default_factory=dict)  # left out, for the probe touched
    rotary: str = ""  # axes of which mm are degrees; the distance is that of the others

    @classmethod
    def load(cls, path: Path) -> "Totals":
        """Read a report of `ugrbl sim`."""
        return cls(**json.loads(path.read_text(encoding="utf-8")))


class Recorder:
    """Watches a rig. Make it before the rig runs.

    Steps count in either direction. Places are machine positions. Time counts from the first
    step to the last, or from start_clock() to stop_clock().
    """

    def __init__(self, rig: "Rig") -> None:
        from motion import layout

        from ..sim import motor_names

        self._rig = rig
        self._layout = layout
        self._motors = range(len(rig.board.STEP))
        self._names = motor_names.names(motor_names.letters(rig.board))
        self._axes = range(motor_names.axes_of(rig.board))
        self._rotary: str = getattr(rig.board, "ROTARY", "")
        self._linear = [i for i in self._axes if self._names[i] not in self._rotary]
        self._moves: Sequence[int] = ()  # as in motion/kinematics.py; empty: an axis each
        # Kinematics whose motors stand beside their axes: backlash.py and skew.py of extras.
        self._beside: Any = None
        self._nonlinear: Any = None  # or of the user's own: extras/kinematics/nonlinear.py
        self._planned = [0 for _ in self._motors]
        self._made = [0 for _ in self._motors]
        self._probed = [0 for _ in self._motors]  # planned, and not made behind a probe's contact
        self._before_probe: list[int] | None = None  # planned and not made, for other reasons
        self._is_probing = False
        self._distance_mm = 0.0
        self._place = [0 for _ in self._motors]  # steps per motor, as the firmware counts
        self._mm_per_step = [0.0 for _ in self._axes]
        self._low = [0.0 for _ in self._axes]
        self._high = [0.0 for _ in self._axes]
        self._begun: int | None = None
        self._ended = 0
        self.is_plain = False  # nobody stands in the way of lines that only move
        self.wide_arcs: list[tuple[int, str]] = []  # lines, and what is to be said of their arcs
        self.marks: list[Sequence[float]] = []  # where a punch has made a hole, in mm
        if hasattr(rig.port, "on_hole"):
            rig.port.on_hole = self._mark
        rig.on_built = self._attach
        rig.engine.trace = self._segment
        self._is_on = True
        self._set_position = replace_method(rig.engine, "set_position", self._rename)
        self._power_off = replace_method(rig.engine, "power_off", self._switch_off)

    def start_clock(self) -> None:
        """The work begins now."""
        self._begun = self._ended = self._rig.now

    def stop_clock(self, tick: int) -> None:
        """The work has taken until then, or until the last step if that came later."""
        self._ended = max(self._ended, tick)

    def totals(self) -> Totals:
        """Everything up to now."""
        bounds = list(zip(self._low, self._high, strict=True))
        ticks = 0 if self._begun is None else self._ended - self._begun
        return Totals(
            ticks / self._rig.engine.tick_hz,
            round(self._distance_mm, 4),
            self._by_letter(self._planned),
            self._by_letter(self._made),
            self._by_letter([(round(low, 4), round(high, 4)) for low, high in bounds]),
            self._by_letter([round(mm, 4) for mm in self._at()]),
            self._by_letter(self._probed),
            self._rotary,
        )

    def _attach(self) -> None:
        """Called by the rig once the controller is built: follow what is planned."""
        from language.block_layout import SPECIAL

        controller = self._rig.controller
        self._planner = controller.planner
        self._settings = controller.settings
        kinematics = controller.planner.kinematics
        self._moves = kinematics.moves if kinematics else ()
        self._nonlinear = kinematics if hasattr(kinematics, "place_of") else None
        self._beside = kinematics if hasattr(kinematics, "motor_of") else None
        interpreter, planner = controller.interpreter, self._planner
        is_usual = not (planner.move_hook or interpreter.watches() or self._rig.custom_module)
        self.is_plain = is_usual and not controller.protocol._echoes
        self._plan = planner.move_hook or planner.plan
        planner.move_hook = self._plan_line
        if self._nonlinear:  # which has no use for it
            self._line = replace_method(planner, "line", self._cut)
        self._chords = replace_method(self._planner, "chords", self._follow_arc)
        if hasattr(self._planner, "take_up"):
            self._take_up = replace_method(self._planner, "take_up", self._turn)
        self._probe = replace_method(controller.state.hooks, "probe", self._watch_probe)
        self._plan_arc = replace_method(controller.canon, "arc", self._look_at_arc)
        interpreter.watch(SPECIAL)  # or kernels would do some arcs by themselves

    def _look_at_arc(self, start: Any, target: Any, arc: Any, move: Any) -> None:
        """Stand in for Canon.arc."""
        if text := wide_arcs.warning(start, target, arc):
            self.wide_arcs.append((self._rig.link.now_at(), text))
        self._plan_arc(start, target, arc, move)

    def _watch_probe(self, *asked: Any) -> bool:
        """Stand in for Seek.probe, which comes to rest before it plans its motion."""
        self._is_probing, self._before_probe = True, None
        done: bool = self._probe(*asked)
        self._is_probing = False
        if self._before_probe is not None:
            left = zip(self._not_made(), self._before_probe, strict=True)
            self._probed = [n + a - b for n, (a, b) in zip(self._probed, left, strict=True)]
        return done

    def _not_made(self) -> list[int]:
        return [a - b for a, b in zip(self._planned, self._made, strict=True)]

    def _by_letter(self, values: Sequence[_Value]) -> dict[str, _Value]:
        return dict(zip(self._names, values, strict=False))

    def _plan_line(self, target: Any, flags: int, *asked: int) -> int:
        """Stand in for Planner.move_hook: what is added to the ring is what will be stepped."""
        row = self._row(flags)
        planned: int = self._plan(target, flags, *asked)
        if planned:
            self._note(row)
        return planned

    def _cut(self, target: Any, move: Any, power: int) -> bool:
        """Stand in for NonlinearPlanner.line."""
        row = self._row(move.flags)
        planned: bool = self._line(target, move, power)
        if planned:
            self._note(row)
        return planned

    def _row(self, flags: int) -> int:
        """Of the ring, where the next line will be."""
        layout, flow = self._layout, self._planner.flow
        return int(flow[layout.ROWS if flags & layout.SYSTEM_MOTION else layout.HEAD])

    def _turn(self, *asked: Any) -> bool:
        """Stand in for BacklashPlanner.take_up."""
        done: bool = self._take_up(*asked)
        distance = self._distance_mm
        if done:
            self._note(self._planner.flow[self._layout.ROWS])
        self._distance_mm = distance  # the tool has gone nowhere
        return done

    def _follow_arc(self, *asked: Any) -> int:
        """Stand in for Planner.chords."""
        row = self._planner.flow[self._layout.HEAD]
        found: int = self._chords(*asked)
        self._note_from(row)
        return found

    def _note_from(self, row: int) -> None:
        """The rows of the ring from that one on have been planned."""
        layout, flow = self._layout, self._planner.flow
        while row != flow[layout.HEAD]:
            self._note(row)
            row = (row + 1) % flow[layout.ROWS]

    def _note(self, row: int) -> None:
        """A row of the ring has been planned."""
        from motion import minifloat

        layout = self._layout
        at = row * self._planner.flow[layout.ROW_SIZE] + layout.STEPS
        steps = self._planner.ring[at : at + len(self._motors)]
        if self._is_probing and self._before_probe is None:
            self._before_probe = self._not_made()
        dirs = self._planner.ring[at - layout.STEPS + layout.DIRS]
        planned = self._planned
        for i, count in enumerate(steps):
            planned[i] += count
        self._mm_per_step = [1 / (resolution or 1.0) for resolution in self._settings.steps_per_mm]
        signed = [-n if dirs >> i & 1 else n for i, n in enumerate(steps)]
        if self._nonlinear:
            self._distance_mm += minifloat.value(
                self._planner.ring[at - layout.STEPS + layout.LENGTH]
            )
            return
        way = self._to_mm(signed)
        if hasattr(self._beside, "skew"):
            self._lean(way)
        self._distance_mm += hypot(*[way[axis] for axis in self._linear])

    def _lean(self, way: list[float]) -> None:
        """Of motors that are not at right angles, the way of the tool."""
        skew: Any = self._settings
        _, y, z = way[:3]
        way[0] += (skew.skew_xy * y + skew.skew_xz * z) / 1000
        way[1] += skew.skew_yz * z / 1000

    def _segment(self, start: int, row: "array[int]") -> None:
        """Called by the engine for every segment played, with the steps really made."""
        layout = self._layout
        if self._begun is None:
            self._begun = start
        self._ended = start + row[layout.ROW_TICKS]
        dirs = row[layout.ROW_DIRS] ^ self._rig.engine.dir_invert  # as the firmware means them
        made, place = self._made, self._place
        for i, count in enumerate(row[layout.ROW_AXES :: layout.ROW_STRIDE]):
            made[i] += count
            place[i] += -count if dirs >> i & 1 else count
        at = self._at()
        self._extend(at)
        self._moved(start, row, at)

    def _moved(self, start: int, row: "array[int]", at: Sequence[float]) -> None:
        """A segment has ended there, in mm: for those who want to know more."""

    def _mark(self) -> None:
        """The punch is down."""
        self.marks.append(self._at())

    def _rename(self, steps: "array[int]") -> None:
        """Stand in for StepEngine.set_position: the same place has another number from now on."""
        self._set_position(steps)
        if self._is_on:
            self._place = list(steps)
            self._extend(self._at())

    def _switch_off(self) -> None:
        """Stand in for SimEngine.power_off: a count that begins at 0 again is no way to 0."""
        self._is_on = False
        self._power_off()
        self._is_on = True

    def _extend(self, at: Sequence[float]) -> None:
        low, high = self._low, self._high
        for i, mm in enumerate(at):
            if mm < low[i]:
                low[i] = mm
            elif mm > high[i]:
                high[i] = mm

    def _at(self) -> list[float]:
        """Where the axes are, in mm, wherever their motors stand beside that."""
        if not self._beside:
            return self._to_mm(self._place)
        steps = array("i", self._place)
        return [self._beside.axis_steps(steps, i) * mm for i, mm in enumerate(self._mm_per_step)]

    def _to_mm(self, motors: Sequence[float]) -> list[float]:
        """Axes in mm from steps of motors."""
        if self._nonlinear:
            place = array("f", bytes(4 * len(self._axes)))
            self._nonlinear.place_of(motors, place)
            return list(place)
        steps: Sequence[float] = motors
        if self._moves:
            steps = [self._axis_steps(motors, axis) for axis in range(len(self._mm_per_step))]
        return [n * mm for n, mm in zip(steps, self._mm_per_step, strict=False)]

    def _axis_steps(self, motors: Sequence[float], axis: int) -> float:
        """As motion/kinematics.py has it, and not in whole steps."""
        from motion.layout import REVERSE

        if self._moves[axis] == 1 << axis:
            return motors[axis]  # a second motor makes no way of its own
        ways = [(moves >> axis & 1) - (moves >> axis + REVERSE & 1) for moves in self._moves]
        made = sum(way * steps for way, steps in zip(ways, motors, strict=True))
        return made / sum(map(abs, ways))


def replace_method(owner: object, name: str, stand_in: object) -> Any:
    """Put something else in the place of one object's method; returns the method."""
    method = getattr(owner, name)
    setattr(owner, name, stand_in)
    return method
