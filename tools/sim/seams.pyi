"""What the parts of a rig want of it, for mypy only: rig.py makes the parts, and imports them."""

from array import array
from typing import Protocol

from .engine import SimEngine

class Clock(Protocol):
    """Virtual time, and the engine that keeps it."""

    scratch: array[int]  # a place for each motor, for who looks where they are
    ticks_per_ms: float
    loop_ticks: int
    answer_ticks: int

    @property
    def engine(self) -> SimEngine: ...
    @property
    def now(self) -> int: ...
    def ms(self, milliseconds: float) -> int: ...
    def moving(self) -> bool: ...
    def wait(self) -> None: ...
    def pass_time(self, to: int, or_arrival: bool = False) -> None: ...
