"""Kinematics: which motor moves which axes, and in which direction.

Everything is in whole steps. The planner counts steps of axes up to the start of a block; blocks,
segments and engines count steps of motors. A number describes a motor (layout.MOVES): with bit n
its steps increase with those of axis n, with bit n + REVERSE they decrease. The first motors, one
per axis, have the settings of that axis; each further motor does as one of the first, or the
reverse. A board does not need this module if each motor moves the axis of its own number.
"""

from array import array

from micropython import const

from motion.layout import REVERSE
from motion.steps import motor_steps

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Sequence

# The first motors; the others, up to one per axis, move the axis of their own number.
COREXY = (0x003, 0x201)  # A makes x + y, B makes x - y


class Kinematics:
    """Which motors a machine's axes move. moves: a number for each of its first motors (see
    above); alone: a mask of motors that stop at a switch of their own, which has the motor's
    number."""

    def __init__(self, axes: int, moves: "Sequence[int]", alone: int = 0) -> None:
        self.moves = list(moves) + [1 << i for i in range(len(moves), axes)]
        self.alone = alone
        self._axes = range(axes)
        self._motors = range(len(self.moves))
        # Two positions in steps, one per axis each: the first is set by _find(), the second is all
        # zeros, because set_axis() counts from there.
        self._places = array("i", bytes(8 * axes))

    def axis_steps(self, motors: "array[int]", axis: int) -> int:
        """Return the steps of an axis, from those of all motors: the mean of the steps of its
        motors, rounded towards 0. If the motor of its number moves no other axis: the steps of
        that motor."""
        if self.moves[axis] == 1 << axis:
            return motors[axis]
        total = count = 0  # of the motors that this axis turns
        for i in self._motors:
            moves = self.moves[i] >> axis  # bit 0: forwards; bit REVERSE: backwards
            if moves & 1:
                total += motors[i]
                count += 1
            elif moves >> REVERSE & 1:
                total -= motors[i]
                count += 1
        return total // count if total >= 0 else -(-total // count)

    def to_axes(self, motors: "array[int]") -> None:
        """Replace the steps of the first motors by the steps of the axes, computed from those of
        all motors. Takes no memory."""
        self._find(motors)
        for i in self._axes:
            motors[i] = self._places[i]

    def set_axis(self, motors: "array[int]", axis: int, steps: int) -> None:
        """Change motors, the steps of all motors, so that the axis is at `steps`, and all other
        axes stay where they are."""
        self._find(motors)
        self._places[axis] = steps
        changed = self.motors_of(1 << axis)
        # motor_steps() counts from a second position, which is all zeros here.
        for i in self._motors:
            if changed >> i & 1:
                motors[i] = motor_steps(self._places, 0, len(self._axes), self.moves[i])

    def motors_of(self, axes: int) -> int:
        """Return the motors (a mask) that move any of these axes (a mask)."""
        mask = 0
        for i in self._motors:
            if (self.moves[i] | self.moves[i] >> REVERSE) & axes:
                mask |= 1 << i
        return mask

    def stopped_by(self, switches: int) -> int:
        """Return the motors (a mask) that stop at these switches (a mask). A switch stops the
        motor that has it alone, or all motors that move the axis of its number."""
        return self.motors_of(switches & ~self.alone) | switches & self.alone

    def _find(self, motors: "array[int]") -> None:
        """Compute the steps of the axes, from those of the motors, into _places."""
        for i in self._axes:
            self._places[i] = self.axis_steps(motors, i)
