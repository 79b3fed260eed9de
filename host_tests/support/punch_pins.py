"""A punch connected to the pins of a board. Runs under both Pythons."""

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

_STROKE_US = 30_000


class Punch:
    """A punch that moves for 30 ms, and is sensed at both ends. turn() updates its position.

    Pin: the stand-in's class. now_us: returns the time.
    """

    def __init__(self, board: "Any", Pin: "Any", now_us: "Callable[[], int]") -> None:
        self._actuators = (Pin(board.PUNCH_DOWN), Pin(board.PUNCH_UP))
        self._sensors = (Pin(board.PUNCH_DOWN_SENSOR), Pin(board.PUNCH_UP_SENSOR))
        self._now_us = now_us
        self._place = 0
        self._since = now_us()
        self.strokes = 0

    def turn(self) -> None:
        now = self._now_us()
        down, up = self._actuators
        way = (down.value() - up.value()) * (now - self._since)
        was = self._place
        self._place = min(max(was + way, 0), _STROKE_US)
        self._since = now
        self.strokes += was < _STROKE_US == self._place
        self._sensors[0].drive(int(self._place == _STROKE_US))
        self._sensors[1].drive(int(self._place == 0))
