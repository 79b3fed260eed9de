"""Homing by a pin: Search, and its course."""

from micropython import const

from ugrbl_motion.group import GroupError

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from ugrbl_motion.axis import Axis


class Search:
    """How an axis finds its switch: fast towards it, back, slowly towards it, back.

    pin: its number; a pull-up is on. speed: of the first approach, units/s, negative towards
    smaller positions. slow: of everything after it. back_off: units from the place where the
    switch closes to the end of the search. travel: longest way to the switch. position: of the
    axis where the switch closes. level: of the pin while it is closed. Motion stops in the pin's
    interrupt, without a ramp: the first approach may lose steps, the second must be slow enough.
    """

    def __init__(
        self,
        pin: int,
        speed: float,
        slow: float,
        back_off: float,
        travel: float,
        position: float = 0.0,
        level: int = 0,
    ) -> None:
        if speed == 0 or min(slow, back_off, travel) <= 0:
            raise ValueError("speed must not be 0; slow, back_off and travel have to be above 0")
        self.pin = pin
        self.speed = speed
        self.slow = slow
        self.back_off = back_off
        self.travel = travel
        self.position = position
        self.level = level
        self._watching = False
        self._closed: "Callable[[], bool]"

    def steps(self, axis: "Axis") -> "Iterator[None]":
        """Find the switch; yield while motion goes on. Raises GroupError if it is not found, or
        does not open again; nothing moves then."""
        group, way = axis.group, 1 if self.speed > 0 else -1
        yield from group.until_done()
        self._watching = False

        def on_change() -> None:  # in an interrupt
            if self._watching:
                group.halt()

        self._closed = group.hardware.watch(self.pin, self.level, on_change)
        yield from self._approach(axis, way * self.travel, abs(self.speed))
        yield from self._leave(axis, -way * self.back_off)
        yield from self._approach(axis, 2 * way * self.back_off, self.slow)
        axis.place(self.position)
        yield from self._leave(axis, -way * self.back_off)

    def _approach(self, axis: "Axis", distance: float, speed: float) -> "Iterator[None]":
        """Move until the switch closes."""
        self._watching = True
        try:
            if not self._closed():
                axis.move_by(distance, speed)
                if self._closed():  # between the look at it and the start
                    axis.group.halt()
            yield from axis.group.until_done()
        finally:
            self._watching = False
        if not self._closed():
            raise GroupError("the switch at pin %d was not found: longer travel?" % self.pin)

    def _leave(self, axis: "Axis", distance: float) -> "Iterator[None]":
        """Move off the switch."""
        axis.move_by(distance, self.slow)
        yield from axis.group.until_done()
        if self._closed():
            raise GroupError("the switch at pin %d stays closed: longer back_off?" % self.pin)
