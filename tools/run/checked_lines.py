"""Fast check mode: the firmware's own kernels check many move-only lines in one call."""

from array import array
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ..grbl.gcode_file import has_realtime

if TYPE_CHECKING:
    from ..sim.rig import Rig

_BYTES = 1 << 16  # capacity of the buffer: lines of a larger batch are sent one by one


class CheckedLines:
    """Lines of a program that a machine in check mode checks without receiving them.

    This does what the firmware's loop does with move-only lines: two kernels read, check and
    answer them, and nothing else can happen because nothing moves. All other lines must be sent.
    """

    def __init__(self, rig: "Rig") -> None:
        from base.state import ANY, CHECK
        from talk import lines

        from ..sim.check_kernel import check_lines

        controller = rig.controller
        # The kernel gets a copy of the reader's indices, so that the reader does not change.
        _, indices, text, kinds = controller.reader.memory()
        self._state, self._drive = controller.state, controller.motor_control
        self._in_check_mode, self._any = CHECK, ANY
        self._check_lines = check_lines
        self._layout = lines  # names of the indices: HEAD, TAIL, …
        # One buffer for all lines, because the kernels keep its address.
        self._received = bytearray(_BYTES)
        self._indices = array("i", indices)
        self._indices[lines._SIZE] = _BYTES
        modal, counts, memory = controller.interpreter.memory()
        self._kernel_arguments = (
            *(self._received, self._indices, bytearray(len(text)), kinds),
            *(modal, counts, memory),
        )

    def load(self, lines: Sequence[bytes]) -> bool:
        """Load the next lines. Returns False if they cannot be checked here: they must be sent."""
        data = b"\n".join(lines) + b"\n"
        if not self._is_checking() or len(data) >= _BYTES or has_realtime(data):
            return False
        self._received[: len(data)] = data
        self._indices[self._layout.HEAD] = len(data)
        self._begin_at(0)
        return True

    def check(self) -> int:
        """Check lines up to one that is not move-only. Returns how many; the next call continues
        after that line."""
        indices, layout = self._indices, self._layout
        if not self._is_checking():  # all further lines must be sent
            self._begin_at(indices[layout.HEAD])
            return 0
        count = int(self._check_lines(*self._kernel_arguments))
        # TAIL is after the line at which the kernels have stopped; or within it, if it is too long
        # for the firmware.
        self._begin_at(self._received.find(b"\n", indices[layout.TAIL] - 1) + 1)
        return count

    def _is_checking(self) -> bool:
        """Return whether the machine is in check mode, and stays in it."""
        # After a $C, check mode stays active until the reset that it requests is complete.
        is_over = self._state.pending[self._any] or self._drive.in_idle_delay
        return self._state.run == self._in_check_mode and not is_over

    def _begin_at(self, index: int) -> None:
        """Continue at a byte of the buffer, with an empty line."""
        indices, layout = self._indices, self._layout
        indices[layout.TAIL], indices[layout.LENGTH] = index, 0
        indices[layout.SKIPPING] = layout.COMPLETE
