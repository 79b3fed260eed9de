"""Homing by a pin: an axis finds its switch."""

from micropython import const

from ugrbl_motion.group import GroupError

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from ugrbl_motion.group import Axis


class Switch:
    """A switch that closes at a position. level: of its pin then; a pull-up is on."""

    def __init__(self, pin: int, position: float = 0.0, level: int = 0) -> None:
        self.pin = pin
        self.position = position
        self.level = level


class Homing:
    """How an axis finds its switch: fast towards it, back, slowly towards it, back.

    speed: of the first approach, units/s, negative towards smaller positions. slow: of the rest.
    back_off: units from where the switch closes to where the axis ends. travel: longest way to the
    switch. Motion stops in the pin's interrupt, without a ramp: the first approach may lose steps;
    `slow` has to be a speed from which the motor stops at once. Raises ValueError.
    """

    def __init__(
        self, switch: Switch, speed: float, slow: float, back_off: float, travel: float
    ) -> None:
        if speed == 0 or min(slow, back_off, travel) <= 0:
            raise ValueError("speed must not be 0; slow, back_off and travel must be above 0")
        self._switch = switch
        self._speed = speed
        self._slow = slow
        self._back_off = back_off
        self._travel = travel
        self._stops_at_switch = False  # True during an approach
        self._is_closed: "Callable[[], bool]"  # set by _search()

    def find(self, axis: "Axis") -> None:
        """Find the switch, and set the position. Waits for all earlier moves, and for its own.

        Raises GroupError if the switch is not found, or does not open again; nothing moves then.
        """
        for _ in self._search(axis):
            axis.group.sleep()

    async def found(self, axis: "Axis") -> None:
        """Find the switch as find() does, while other tasks run."""
        for _ in self._search(axis):
            await axis.group.sleep_task()

    def _search(self, axis: "Axis") -> "Iterator[None]":
        """Find the switch of an axis, and set the position; yield while motion goes on.

        Fast towards it, back, slowly towards it, where the position is set, and back.
        """
        group = axis.group
        away = -self._back_off if self._speed > 0 else self._back_off  # a distance, signed
        yield from group.until_done()

        def on_change() -> None:
            """Stop motion in the pin's interrupt, if it goes towards the switch."""
            if self._stops_at_switch:
                group.halt()

        switch = self._switch
        self._is_closed = group.hardware.watch(switch.pin, switch.level, on_change)
        far = self._travel if self._speed > 0 else -self._travel
        yield from self._approach(axis, far, abs(self._speed))
        yield from self._leave(axis, away)
        yield from self._approach(axis, -2 * away, self._slow)  # twice as far: it must close
        axis.place(switch.position)
        yield from self._leave(axis, away)

    def _approach(self, axis: "Axis", distance: float, speed: float) -> "Iterator[None]":
        """Move until the switch closes, by at most `distance`, units; speed: units/s. Yields while
        motion goes on. Raises GroupError if the switch does not close."""
        self._stops_at_switch = True
        try:
            if not self._is_closed():
                axis.move_by(distance, speed)
                if self._is_closed():  # it closed before the start
                    axis.group.halt()
            yield from axis.group.until_done()
        finally:
            self._stops_at_switch = False
        if not self._is_closed():
            raise GroupError(
                "the switch at pin %d was not reached: increase travel" % self._switch.pin
            )

    def _leave(self, axis: "Axis", distance: float) -> "Iterator[None]":
        """Move off the switch by `distance`, units, slowly. Yields while motion goes on. Raises
        GroupError if the switch stays closed."""
        axis.move_by(distance, self._slow)
        yield from axis.group.until_done()
        if self._is_closed():
            raise GroupError("the switch at pin %d stays closed after back_off" % self._switch.pin)
