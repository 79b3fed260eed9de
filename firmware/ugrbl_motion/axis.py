"""Axis and Output: what a group consists of."""

from micropython import const

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from ugrbl_motion.group import Group
    from ugrbl_motion.homing import Search


class Output:
    """A pin that changes as a move begins. level: at the start, 0 or 1."""

    def __init__(self, pin: int, level: int = 0) -> None:
        self.pin = pin
        self.level = level


class Axis:
    """One motor with STEP and DIR. Units are the program's own; times are in seconds.

    step, direction: pin numbers. steps_per_unit: resolution. speed: highest, units/s. acceleration:
    units/s2. invert: DIR is low for positive moves if False, high if True. Raises ValueError for
    numbers that are not above 0.
    """

    def __init__(
        self,
        step: int,
        direction: int,
        steps_per_unit: float,
        speed: float,
        acceleration: float,
        invert: bool = False,
    ) -> None:
        if min(steps_per_unit, speed, acceleration) <= 0:
            raise ValueError("steps_per_unit, speed and acceleration have to be above 0")
        self.step = step
        self.direction = direction
        self.steps_per_unit = steps_per_unit
        self.speed = speed
        self.acceleration = acceleration
        self.invert = invert
        self._group: "Group | None" = None
        self.name = ""
        self._index = 0

    def join(self, group: "Group", name: str, index: int) -> None:
        """Become part of a group; called by Group. Raises ValueError if it is part of one."""
        if self._group is not None:
            raise ValueError("axis %s is in two groups: make an Axis for each" % name)
        self._group, self.name, self._index = group, name, index

    @property
    def group(self) -> "Group":
        """Return the group of this axis. Raises ValueError if it has none."""
        if self._group is None:
            raise ValueError("this axis is in no group: Group(x=axis) first")
        return self._group

    @property
    def steps(self) -> int:
        """Return the steps executed, the motor's position at this moment."""
        return self.group.steps(self._index)

    @property
    def position(self) -> float:
        """Return the position at this moment, in units."""
        return self.steps / self.steps_per_unit

    @property
    def target(self) -> float:
        """Return the position at the end of the queued moves, in units."""
        return self.group.end(self._index) / self.steps_per_unit

    def move(self, to: float, speed: "float | None" = None) -> int:
        """Queue a move of this axis alone, to a position. See Group.move()."""
        return self.group.move(speed, **{self.name: to})

    def move_by(self, distance: float, speed: "float | None" = None) -> int:
        """Queue a move of this axis alone, by a distance. See Group.move_by()."""
        return self.group.move_by(speed, **{self.name: distance})

    def run(self, speed: float) -> int:
        """Queue a move without an end at a speed, negative for backwards, until Group.stop().

        The mean rate is exact to 1e-6 of the processor's clock. It can be changed by
        Group.pace(). Returns the number of the move.
        """
        return self.group.run(self._index, speed)

    def place(self, position: float) -> None:
        """Declare the present position, without motion. Raises GroupError while anything
        moves."""
        self.group.place(self._index, position)

    def home(self, search: "Search") -> None:
        """Find the axis' switch; see homing.Search. Waits until it is done."""
        for _ in search.steps(self):
            self.group.sleep()

    async def homing(self, search: "Search") -> None:
        """Find the axis' switch, while other tasks run."""
        for _ in search.steps(self):
            await self.group.sleep_task()

    async def moved(self, move: "int | None" = None) -> None:
        """Wait for the end of a move, or of all moves. See Group.moved()."""
        await self.group.moved(move)
