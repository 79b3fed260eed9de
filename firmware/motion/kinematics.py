"""Kinematics: which motor moves which axes, and in which direction.

In and out: whole steps. The planner counts those of axes up to where a block begins; blocks,
segments and engines know motors only. What a motor does is a number (layout.MOVES): bit n, its
steps go up with those of axis n; bit n + REVERSE, they go down. The first motors, one per axis,
have the settings of that axis; each further one does what one of the first does, or the reverse.
Where each motor moves the axis of its own number, a board has no need of this module.
"""

from array import array

from micropython import const

from motion.layout import REVERSE
from motion.steps import motor_steps

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Sequence

# What the first motors do; the others, up to one per axis, move the axis of their own number.
COREXY = (0x003, 0x201)  # A makes x + y, B makes x - y


class Kinematics:
    """A machine's table. moves: what its first motors do; alone: those (a mask) that stop at a
    switch of their own, each of the motor's number."""

    def __init__(self, axes: int, moves: "Sequence[int]", alone: int = 0) -> None:
        self.moves = list(moves) + [1 << i for i in range(len(moves), axes)]
        self.alone = alone
        self._axes = range(axes)
        self._motors = range(len(self.moves))
        self._places = array("i", bytes(8 * axes))  # behind the axes' stand zeros

    def axis_steps(self, motors: "array[int]", axis: int) -> int:
        """Steps of an axis: the mean of what its motors have made, towards 0. Of several that only
        move this axis, the first says it."""
        if self.moves[axis] == 1 << axis:
            return motors[axis]
        total = count = 0
        for i in self._motors:
            moves = self.moves[i] >> axis
            if moves & 1:
                total += motors[i]
                count += 1
            elif moves >> REVERSE & 1:
                total -= motors[i]
                count += 1
        return total // count if total >= 0 else -(-total // count)

    def to_axes(self, motors: "array[int]") -> None:
        """Put the steps of the axes where those of the first motors are. Takes no memory."""
        self._find(motors)
        for i in self._axes:
            motors[i] = self._places[i]

    def set_axis(self, motors: "array[int]", axis: int, steps: int) -> None:
        """Change the steps of an axis' motors so that it stands there, and no other axis moves."""
        self._find(motors)
        self._places[axis] = steps
        changed = self.motors_of(1 << axis)
        for i in self._motors:
            if changed >> i & 1:
                motors[i] = motor_steps(self._places, 0, len(self._axes), self.moves[i])

    def motors_of(self, axes: int) -> int:
        """The motors (a mask) that move any of these axes (a mask)."""
        mask = 0
        for i in self._motors:
            if (self.moves[i] | self.moves[i] >> REVERSE) & axes:
                mask |= 1 << i
        return mask

    def stopped_by(self, switches: int) -> int:
        """The motors (a mask) that stop at these switches (a mask): an axis', where they have none
        of their own."""
        return self.motors_of(switches & ~self.alone) | switches & self.alone

    def _find(self, motors: "array[int]") -> None:
        """Where the axes are, into places."""
        for i in self._axes:
            self._places[i] = self.axis_steps(motors, i)
