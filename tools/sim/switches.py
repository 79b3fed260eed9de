"""Switches of a simulated machine: at both ends of each axis' travel, for homing, and at any other
position."""

from . import motor_names
from .engine import Switch

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .rig import Rig

# The distance between the switches exceeds the travel by this much, so that soft limits act first.
_SPARE_MM = 1.0


class EndSwitch(Switch):
    """The switch at one end. Its position follows from the current settings.

    The machine begins in the middle of its travel.
    """

    def __init__(self, rig: "Rig", motor: int, above: bool) -> None:
        super().__init__(rig.port.limit_names[motor], motor, above, steps=0)
        self._rig = rig
        # The axis that the motor moves: the index of its settings.
        self._axis_number = motor_names.AXIS_LETTERS.index(motor_names.letters(rig.board)[motor])

    @property
    def steps(self) -> int:
        settings = self._rig.controller.settings
        half_mm = (settings.max_travel[self._axis_number] + _SPARE_MM) / 2
        steps = int(half_mm * settings.steps_per_mm[self._axis_number])
        return steps if self.above else -steps

    @steps.setter
    def steps(self, steps: int) -> None:
        """Ignore it: the position follows from the settings."""


class PlaceSwitch(Switch):
    """A switch that is closed above a position, or below it. mm: relative to where the machine
    begins. axis: the motor, from 0, which is also the number of its axis; but the limit switch of
    the axis' second motor follows that one."""

    def __init__(self, rig: "Rig", pin: str, axis: int, above: bool, mm: float) -> None:
        names, letters = rig.port.limit_names, motor_names.letters(rig.board)
        limit_motor = names.index(pin) if pin in names else axis
        is_same_axis = letters[limit_motor] == letters[axis]
        motor = limit_motor if is_same_axis else axis
        super().__init__(pin, motor, above, steps=0)
        self._rig = rig
        self._number = axis  # the axis whose settings give the length of a step
        self._mm = mm

    @property
    def steps(self) -> int:
        return int(self._mm * self._rig.controller.settings.steps_per_mm[self._number])

    @steps.setter
    def steps(self, steps: int) -> None:
        """Ignore it: the position follows from the settings."""


def fit(rig: "Rig") -> None:
    """Give a machine an EndSwitch at both ends of each motor's travel, if the motor has a limit
    input. ValueError if its motors do not move one axis each."""
    together = motor_names.shared(rig.board)
    if together:
        raise ValueError("no switches here: motors move %s together" % " and ".join(together))
    for motor in range(len(rig.board.STEP)):
        if rig.port.limit_names[motor]:
            rig.engine.switches += [EndSwitch(rig, motor, True), EndSwitch(rig, motor, False)]
