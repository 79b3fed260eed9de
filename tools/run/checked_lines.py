"""Check mode, quickly: the firmware's own kernels judge many lines that only move in one call."""

from array import array
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..grbl.gcode_file import has_realtime

if TYPE_CHECKING:
    from ..sim.rig import Rig

_BYTES = 1 << 16


class CheckedLines:
    """Lines of a program that a machine in check mode judges without having been sent them.

    What the firmware's loop does with lines that only move is done here: it reads, checks and
    answers them by two kernels, and has nothing else to do while nothing can move. Any other
    line is to be sent.
    """

    def __init__(self, rig: "Rig") -> None:
        from base.state import ANY, CHECK
        from talk import lines

        from ..sim.check_kernel import check_lines

        controller = rig.controller
        _, at, text, kinds = controller.reader.memory()
        self._state, self._drive = controller.state, controller.motor_control
        self._in_check_mode, self._any = CHECK, ANY
        self._check_lines = check_lines
        self._places = lines
        # One buffer for all of them: the kernels remember where it lies.
        self._heard = bytearray(_BYTES)
        self._at = array("i", at)
        self._at[lines._SIZE] = _BYTES
        modal, counts, memory = controller.interpreter.memory()
        self._memory = (
            *(self._heard, self._at, bytearray(len(text)), kinds),
            *(modal, counts, memory),
        )

    def load(self, lines: Sequence[bytes]) -> bool:
        """Take lines as the next ones. Returns whether they can be judged here."""
        data = b"\n".join(lines) + b"\n"
        if not self._is_checking() or len(data) >= _BYTES or has_realtime(data):
            return False
        self._heard[: len(data)] = data
        self._at[self._places.HEAD] = len(data)
        self._begin_at(0)
        return True

    def check(self) -> int:
        """Check lines up to one that does more than move. Returns how many; the next call
        continues after that one."""
        at, places = self._at, self._places
        if not self._is_checking():  # the lines from here on are all to be sent
            self._begin_at(at[places.HEAD])
            return 0
        count = int(self._check_lines(*self._memory))
        # A line may be too long for the firmware, which may have left its end.
        self._begin_at(self._heard.find(b"\n", at[places.TAIL] - 1) + 1)
        return count

    def _is_checking(self) -> bool:
        # Behind a $C it is so until the reset that this asks for has come to its end.
        is_over = self._state.pending[self._any] or self._drive.in_idle_delay
        return self._state.run == self._in_check_mode and not is_over

    def _begin_at(self, index: int) -> None:
        at, places = self._at, self._places
        at[places.TAIL], at[places.LENGTH], at[places.SKIPPING] = index, 0, places.COMPLETE
