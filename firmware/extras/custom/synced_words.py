"""Synced words: words of custom.py that run when the blocks planned before them are executed.

The engine reads a block's last segment long before its steps are generated. So the block's end
position is watched: it has been reached when the machine moves away from it, or stands still.
"""

from base import state as st
from base.float32 import vector
from micropython import const
from motion.layout import HEAD, ROWS, TAIL

from extras.custom.runner import MAY_MOVE

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from typing import Any

    from talk.controller import Controller

    from extras.custom.handlers import Function
    from extras.custom.runner import Runner

_FAR_MM = const(1_000_000)  # outside of every machine: no distance has been measured yet


# Indices of a waiting word's fields.
_BLOCKS_BEFORE = const(0)  # number of blocks before it that the engine has not read to the end
_END_MM = const(1)  # the end position of the blocks before it, mm per axis
_LAST_DISTANCE_MM = const(2)  # distance to that position at the last look
_FIRST_OF_CALL = const(3)  # from here on: its name in messages, function and parameters


class SyncedWords:
    """The words that wait for motion. waiting: for each a list, see _BLOCKS_BEFORE and so on.
    _position: scratch for the present position, mm. _counted_tail: the planner's TAIL (index of
    the block that the engine reads) when _subtract_read_blocks() ran last."""

    def __init__(self, machine: "Controller", runner: "Runner") -> None:
        self._machine = machine
        self._runner = runner
        self.waiting: "list[list[Any]]" = []
        self._position = vector(len(machine.modes.position))
        self._counted_tail = 0

    def add(self, what: str, function: "Function", given: "dict[str, Any]") -> None:
        """Add a word after all planned blocks, and start motion if it has not started.

        what: the handler's name in messages. given: the word's parameters, by letter.
        """
        machine, flow = self._machine, self._machine.planner.flow
        machine.canon.finish()  # plan the move that is only requested yet
        machine.canon.auto_start()
        self._subtract_read_blocks()
        blocks_before = (flow[HEAD] - flow[TAIL]) % flow[ROWS]
        end_mm = tuple(machine.modes.position)
        self.waiting.append([blocks_before, end_mm, _FAR_MM, what, function, given])

    def run_reached(self) -> None:
        """Run the words whose position has been reached, in their order. Called at each turn of
        the main loop while words wait."""
        self._subtract_read_blocks()
        self._machine.state.pending[st.ANY] = 1  # the loop calls this again after the next line
        waiting = self.waiting
        while waiting and waiting[0][_BLOCKS_BEFORE] == 0 and self._is_reached(waiting[0]):
            what, function, given = waiting.pop(0)[_FIRST_OF_CALL:]
            self._runner.run(what, function, not MAY_MOVE, given=given)

    def _subtract_read_blocks(self) -> None:
        """Subtract from each word's blocks those that the engine has read since the last call."""
        flow = self._machine.planner.flow
        read_blocks = (flow[TAIL] - self._counted_tail) % flow[ROWS]  # of a ring of ROWS blocks
        self._counted_tail = flow[TAIL]
        for word in self.waiting:
            word[_BLOCKS_BEFORE] = max(0, word[_BLOCKS_BEFORE] - read_blocks)

    def _is_reached(self, word: "list[Any]") -> bool:
        """Return whether a word's position has been reached: the machine stands, or is farther
        from it than at the last look. All blocks before it must have been read."""
        machine, mm = self._machine, self._position
        machine.position(mm)
        distance = max([abs(end - now) for end, now in zip(word[_END_MM], mm)])  # farthest axis
        last_distance, word[_LAST_DISTANCE_MM] = word[_LAST_DISTANCE_MM], distance
        return distance > last_distance or machine.engine.idle()
