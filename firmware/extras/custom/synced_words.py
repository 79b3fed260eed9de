"""Synced words: words of custom.py that run when the blocks planned before them are executed.

The engine reads a block's last segment long before its steps are generated. So the block's end
position is watched: it has been reached when the machine moves away from it, or stands still.
"""

from base import state as st
from base.float32 import vector
from micropython import const
from motion.layout import HEAD, ROWS, TAIL

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from talk.controller import Controller

    from extras.custom.handlers import Function
    from extras.custom.runner import Runner

_FAR = const(1_000_000)  # mm: outside of every machine

# Indices of a waiting word's fields.
_BLOCKS = const(0)  # number of blocks still before it
_END = const(1)  # their end position, mm
_DISTANCE = const(2)  # mm to that position at the last look
_CALL = const(3)  # from here on: name, function and parameters


class SyncedWords:
    """The words that wait for motion: waiting has a list of fields for each. _mm: the present
    position. _tail: index of the planner's next block to read, at the last count."""

    def __init__(self, machine: "Controller", runner: "Runner") -> None:
        self._machine = machine
        self._runner = runner
        self.waiting: "list[list[Any]]" = []
        self._mm = vector(len(machine.modes.position))
        self._tail = 0

    def add(self, what: str, function: "Function", given: "dict[str, Any]") -> None:
        """Add a word after all planned blocks, and start motion if it has not started.

        what: the handler's name in messages. given: the word's parameters, by letter.
        """
        machine, flow = self._machine, self._machine.planner.flow
        machine.canon.finish()
        machine.canon.auto_start()
        self._count_passed()
        blocks = (flow[HEAD] - flow[TAIL]) % flow[ROWS]
        end = tuple(machine.modes.position)
        self.waiting.append([blocks, end, _FAR, what, function, given])

    def run_reached(self) -> None:
        """Run the words whose position has been reached, in their order. Called at each turn of
        the main loop while words wait."""
        self._count_passed()
        self._machine.state.pending[st.ANY] = 1  # check again after the next line
        waiting = self.waiting
        while waiting and waiting[0][_BLOCKS] == 0 and self._is_reached(waiting[0]):
            what, function, given = waiting.pop(0)[_CALL:]
            self._runner.run(what, function, False, (), given)

    def _count_passed(self) -> None:
        """Subtract from each word's blocks those that the engine has read since the last call."""
        flow = self._machine.planner.flow
        passed = (flow[TAIL] - self._tail) % flow[ROWS]
        self._tail = flow[TAIL]
        for word in self.waiting:
            word[_BLOCKS] = max(0, word[_BLOCKS] - passed)

    def _is_reached(self, word: "list[Any]") -> bool:
        """Return whether a word's position has been reached: the machine stands, or is farther
        from it than at the last look. All blocks before it must have been read."""
        machine, mm = self._machine, self._mm
        machine.position(mm)
        distance = max([abs(end - now) for end, now in zip(word[_END], mm)])  # of the worst axis
        last, word[_DISTANCE] = word[_DISTANCE], distance
        return distance > last or machine.engine.idle()
