"""Record what a simulated machine was commanded to do and what its motors did."""

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
    """Totals of a machine's motion, ready for JSON."""

    time_s: float = 0.0
    distance_mm: float = 0.0
    steps_planned: dict[str, int] = field(default_factory=dict)
    steps_made: dict[str, int] = field(default_factory=dict)
    bounds_mm: dict[str, tuple[float, float]] = field(default_factory=dict)
    final_position_mm: dict[str, float] = field(default_factory=dict)
    # planned but not made, because the probe touched
    steps_probed: dict[str, int] = field(default_factory=dict)
    rotary: str = ""  # axes whose mm are degrees; the distance is that of the others

    @classmethod
    def load(cls, path: Path) -> "Totals":
        """Read a report of `ugrbl sim`."""
        return cls(**json.loads(path.read_text(encoding="utf-8")))


class Recorder:
    """Observes a rig. Create it before the rig runs.

    Steps count in both directions. Positions are machine positions. Time counts from the first
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
        # Per motor: bits of the axes that move it forward and, from REVERSE on, backward, as in
        # motion/kinematics.py; empty: one motor per axis.
        self._axes_of_motor: Sequence[int] = ()
        # Kinematics whose motors deviate from their axes: backlash.py and skew.py of extras.
        self._deviating: Any = None
        self._nonlinear: Any = None  # or of the user's own: extras/kinematics/nonlinear.py
        # Steps of each motor, in both directions together.
        self._planned = [0 for _ in self._motors]
        self._executed = [0 for _ in self._motors]
        self._probed = [0 for _ in self._motors]  # planned, but not made after a probe's contact
        self._before_probe: list[int] | None = None  # planned and not made, for other reasons
        self._is_probing = False
        self._distance_mm = 0.0
        self._motor_steps = [0 for _ in self._motors]  # steps per motor, as the firmware counts
        self._mm_per_step = [0.0 for _ in self._axes]
        # The lowest and the highest position of each axis, in mm.
        self._low = [0.0 for _ in self._axes]
        self._high = [0.0 for _ in self._axes]
        self._begun: int | None = None  # the first and the last tick of the time counted
        self._ended = 0
        self.is_plain = False  # nothing intercepts move-only lines
        self.wide_arcs: list[tuple[int, str]] = []  # line number and warning of unusual arcs
        self.marks: list[Sequence[float]] = []  # positions of a punch's holes, in mm
        if hasattr(rig.port, "on_hole"):
            rig.port.on_hole = self._mark
        rig.on_built = self._attach
        rig.engine.trace = self._record_segment
        self._is_on = True  # the machine's power
        self._set_position = replace_method(rig.engine, "set_position", self._renumber)
        self._power_off = replace_method(rig.engine, "power_off", self._switch_off)

    def start_clock(self) -> None:
        """Start the clock at the beginning of the program."""
        self._begun = self._ended = self._rig.now

    def stop_clock(self, tick: int) -> None:
        """Stop the clock at that tick, or at the last step if that came later."""
        self._ended = max(self._ended, tick)

    def totals(self) -> Totals:
        """Return the totals up to now."""
        bounds = list(zip(self._low, self._high, strict=True))
        ticks = 0 if self._begun is None else self._ended - self._begun
        return Totals(
            time_s=ticks / self._rig.engine.tick_hz,
            distance_mm=round(self._distance_mm, 4),
            steps_planned=self._by_letter(self._planned),
            steps_made=self._by_letter(self._executed),
            bounds_mm=self._by_letter([(round(low, 4), round(high, 4)) for low, high in bounds]),
            final_position_mm=self._by_letter([round(mm, 4) for mm in self._position()]),
            steps_probed=self._by_letter(self._probed),
            rotary=self._rotary,
        )

    def _attach(self) -> None:
        """Observe the planner. Called by the rig when the controller is built."""
        from language.block_layout import NOT_STRAIGHT

        controller = self._rig.controller
        self._planner = controller.planner
        self._settings = controller.settings
        kinematics = controller.planner.kinematics
        self._axes_of_motor = kinematics.moves if kinematics else ()
        self._nonlinear = kinematics if hasattr(kinematics, "place_of") else None
        self._deviating = kinematics if hasattr(kinematics, "motor_of") else None
        interpreter, planner = controller.interpreter, self._planner
        is_intercepted = planner.move_hook or interpreter.watches() or self._rig.custom_module
        self.is_plain = not is_intercepted and not controller.protocol._echoes
        self._plan = planner.move_hook or planner.plan  # plans a line, as it would without us
        planner.move_hook = self._plan_line
        if self._nonlinear:  # it does not use move_hook
            self._line = replace_method(planner, "line", self._plan_nonlinear_line)
        self._chords = replace_method(self._planner, "chords", self._note_arc)
        if hasattr(self._planner, "take_up"):
            self._take_up = replace_method(self._planner, "take_up", self._note_take_up)
        self._probe = replace_method(controller.state.hooks, "probe", self._watch_probe)
        self._plan_arc = replace_method(controller.canon, "arc", self._check_arc)
        interpreter.watch(NOT_STRAIGHT)  # else kernels would plan some arcs by themselves

    def _check_arc(self, start: Any, target: Any, arc: Any, move: Any) -> None:
        """Replace Canon.arc."""
        if text := wide_arcs.warning(start, target, arc):
            self.wide_arcs.append((self._rig.link.now_at(), text))
        self._plan_arc(start, target, arc, move)

    def _watch_probe(self, *asked: Any) -> bool:
        """Replace Seek.probe: count the steps that a contact has cancelled.

        Seek.probe waits for standstill before it plans its motion. _note() then sets
        _before_probe.
        """
        self._is_probing, self._before_probe = True, None
        done: bool = self._probe(*asked)
        self._is_probing = False
        if self._before_probe is not None:
            steps = zip(self._probed, self._not_made(), self._before_probe, strict=True)
            self._probed = [count + now - before for count, now, before in steps]
        return done

    def _not_made(self) -> list[int]:
        """Return how many steps of each motor are planned and not made."""
        return [
            planned - made for planned, made in zip(self._planned, self._executed, strict=True)
        ]

    def _by_letter(self, values: Sequence[_Value]) -> dict[str, _Value]:
        """Return values of motors or axes by their names."""
        return dict(zip(self._names, values, strict=False))

    def _plan_line(self, target: Any, flags: int, *asked: int) -> int:
        """Replace Planner.move_hook: all steps added to the ring will be made."""
        row = self._row(flags)  # where it will be planned
        planned: int = self._plan(target, flags, *asked)
        if planned:
            self._note(row)
        return planned

    def _plan_nonlinear_line(self, target: Any, move: Any, power: int) -> bool:
        """Replace NonlinearPlanner.line: note what it plans."""
        row = self._row(move.flags)  # where it will be planned
        planned: bool = self._line(target, move, power)
        if planned:
            self._note(row)
        return planned

    def _row(self, flags: int) -> int:
        """Return the row of the ring for the next line."""
        layout, flow = self._layout, self._planner.flow
        return int(flow[layout.ROWS if flags & layout.SYSTEM_MOTION else layout.HEAD])

    def _note_take_up(self, *asked: Any) -> bool:
        """Replace BacklashPlanner.take_up: note the motors' steps that it plans."""
        done: bool = self._take_up(*asked)
        distance = self._distance_mm
        if done:  # it plans them in the spare row, which follows the ring
            spare_row = self._planner.flow[self._layout.ROWS]
            self._note(spare_row)
        self._distance_mm = distance  # the tool does not move
        return done

    def _note_arc(self, *asked: Any) -> int:
        """Replace Planner.chords, which plans the chords of an arc: note these."""
        first_row = self._planner.flow[self._layout.HEAD]
        returned: int = self._chords(*asked)
        self._note_from(first_row)
        return returned

    def _note_from(self, row: int) -> None:
        """Note the rows of the ring from that one on, which have been planned."""
        layout, flow = self._layout, self._planner.flow
        while row != flow[layout.HEAD]:
            self._note(row)
            row = (row + 1) % flow[layout.ROWS]

    def _note(self, row: int) -> None:
        """Note a row of the ring that has been planned: its steps and the tool's distance."""
        from motion import minifloat

        layout, ring = self._layout, self._planner.ring
        first = row * self._planner.flow[layout.ROW_SIZE]  # index of the row's first word
        steps = ring[first + layout.STEPS : first + layout.STEPS + len(self._motors)]
        if self._is_probing and self._before_probe is None:  # the first row of the probing
            self._before_probe = self._not_made()
        dirs = ring[first + layout.DIRS]  # bit i set: motor i moves backward
        planned = self._planned
        for motor, count in enumerate(steps):
            planned[motor] += count
        self._mm_per_step = [1 / (resolution or 1.0) for resolution in self._settings.steps_per_mm]
        if self._nonlinear:  # the row has the length of the tool's path
            self._distance_mm += minifloat.value(ring[first + layout.LENGTH])
            return
        moved = [-count if dirs >> motor & 1 else count for motor, count in enumerate(steps)]
        displacement = self._to_mm(moved)
        if hasattr(self._deviating, "skew"):
            self._correct_skew(displacement)
        self._distance_mm += hypot(*[displacement[axis] for axis in self._linear])

    def _correct_skew(self, displacement: list[float]) -> None:
        """Correct the tool's displacement, in mm, for axes that are not at right angles."""
        skew: Any = self._settings  # its skew_xy and so on, in mm per m
        _, y, z = displacement[:3]
        displacement[0] += (skew.skew_xy * y + skew.skew_xz * z) / 1000
        displacement[1] += skew.skew_yz * z / 1000

    def _record_segment(self, start: int, row: "array[int]") -> None:
        """Record a segment. Called by the engine for each one played: its first tick, and its row
        with the steps really made."""
        layout = self._layout
        if self._begun is None:
            self._begun = start
        self._ended = start + row[layout.ROW_TICKS]
        # Bit i set: motor i moves backward, as the firmware counts.
        dirs = row[layout.ROW_DIRS] ^ self._rig.engine.dir_invert
        executed, motor_steps = self._executed, self._motor_steps
        for motor, count in enumerate(row[layout.ROW_AXES :: layout.ROW_STRIDE]):
            executed[motor] += count
            motor_steps[motor] += -count if dirs >> motor & 1 else count
        position = self._position()
        self._extend_bounds(position)
        self._moved(start, row, position)

    def _moved(self, start: int, row: "array[int]", at: Sequence[float]) -> None:
        """Receive the end of a segment, in mm; for subclasses."""

    def _mark(self) -> None:
        """Note a hole: the punch is down."""
        self.marks.append(self._position())

    def _renumber(self, steps: "array[int]") -> None:
        """Replace StepEngine.set_position: the same place gets new numbers, in steps."""
        self._set_position(steps)
        if self._is_on:
            self._motor_steps = list(steps)
            self._extend_bounds(self._position())

    def _switch_off(self) -> None:
        """Replace SimEngine.power_off: a count that restarts at 0 is no motion."""
        self._is_on = False
        self._power_off()
        self._is_on = True

    def _extend_bounds(self, position: Sequence[float]) -> None:
        """Extend the bounds to a position of the axes, in mm."""
        low, high = self._low, self._high
        for axis, mm in enumerate(position):
            if mm < low[axis]:
                low[axis] = mm
            elif mm > high[axis]:
                high[axis] = mm

    def _position(self) -> list[float]:
        """Return the position of the axes in mm, without the deviation of their motors."""
        if not self._deviating:
            return self._to_mm(self._motor_steps)
        steps = array("i", self._motor_steps)
        return [
            self._deviating.axis_steps(steps, axis) * mm
            for axis, mm in enumerate(self._mm_per_step)
        ]

    def _to_mm(self, motors: Sequence[float]) -> list[float]:
        """Convert steps of motors to mm of axes."""
        if self._nonlinear:
            position = array("f", bytes(4 * len(self._axes)))
            self._nonlinear.place_of(motors, position)  # fills it
            return list(position)
        steps: Sequence[float] = motors
        if self._axes_of_motor:
            steps = [self._axis_steps(motors, axis) for axis in range(len(self._mm_per_step))]
        return [count * mm for count, mm in zip(steps, self._mm_per_step, strict=False)]

    def _axis_steps(self, motors: Sequence[float], axis: int) -> float:
        """Return the steps of an axis, as in motion/kinematics.py, but as a float."""
        from motion.layout import REVERSE

        if self._axes_of_motor[axis] == 1 << axis:  # the motor moves this axis alone
            return motors[axis]  # a second motor of an axis adds no displacement
        # Of each motor: 1 if the axis moves it forward, -1 backward, 0 if it does not move it.
        signs = [
            (moves >> axis & 1) - (moves >> axis + REVERSE & 1) for moves in self._axes_of_motor
        ]
        total = sum(sign * steps for sign, steps in zip(signs, motors, strict=True))
        return total / sum(map(abs, signs))


def replace_method(owner: object, name: str, stand_in: object) -> Any:
    """Replace a method of one object; returns the method."""
    method = getattr(owner, name)
    setattr(owner, name, stand_in)
    return method
