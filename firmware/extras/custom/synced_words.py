"""Synced words: words of custom.py that run when the blocks planned before them are executed.

The engine takes its last piece of a block long before that has been made. So the place where the
block ends is looked at: motion has come there when it moves away again, or not at all.
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

_FAR = const(1_000_000)  # mm: nowhere a machine may be


class SyncedWords:
    """The words that wait."""

    def __init__(self, machine: "Controller", runner: "Runner") -> None:
        self._machine = machine
        self._runner = runner
        # For how many blocks, where they end, how far that was at the last look; what to run.
        self.waiting: "list[list[Any]]" = []
        self._mm = vector(len(machine.modes.position))
        self._tail = 0

    def add(self, what: str, function: "Function", given: "dict[str, Any]") -> None:
        """One more. What is planned begins to move."""
        machine, flow = self._machine, self._machine.planner.flow
        machine.canon.finish()
        machine.canon.auto_start()
        self._count_passed()
        blocks = (flow[HEAD] - flow[TAIL]) % flow[ROWS]
        place = tuple(machine.modes.position)
        self.waiting.append([blocks, place, _FAR, what, function, given])

    def run_reached(self) -> None:
        """Run those that have come to their place."""
        self._count_passed()
        self._machine.state.pending[st.ANY] = 1  # look again behind the next line, whatever it is
        waiting = self.waiting
        while waiting and waiting[0][0] == 0 and self._is_reached(waiting[0]):
            what, function, given = waiting.pop(0)[3:]
            self._runner.run(what, function, False, (), given)

    def _count_passed(self) -> None:
        """The engine has taken blocks since: so many fewer are waited for."""
        flow = self._machine.planner.flow
        passed = (flow[TAIL] - self._tail) % flow[ROWS]
        self._tail = flow[TAIL]
        for mark in self.waiting:
            mark[0] = max(0, mark[0] - passed)

    def _is_reached(self, mark: "list[Any]") -> bool:
        machine, mm = self._machine, self._mm
        machine.position(mm)
        away = max([abs(a - b) for a, b in zip(mark[1], mm)])
        before, mark[2] = mark[2], away
        return away > before or machine.engine.idle()
