"""asyncio in virtual time: where all tasks wait, time passes in the simulator instead.

For both Pythons; each has its own event loop.
"""

import asyncio
import sys

from .group_hardware import SimHardware

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any


def install(made: "list[SimHardware]") -> None:
    """Make asyncio.run() use the clock of this hardware, of the last one in the list; it may be
    added later."""
    if sys.implementation.name == "micropython":
        _install_in_micropython(made)
    else:
        _install_in_cpython(made)


def _pass_s(made: "list[SimHardware]", seconds: float) -> None:
    for hardware in made:
        hardware.pass_s(seconds)


def _install_in_cpython(made: "list[SimHardware]") -> None:
    import selectors

    class Selector(selectors.SelectSelector):
        """Lets virtual time pass instead of waiting: an event loop waits in select()."""

        def select(self, timeout: "float | None" = None) -> "Any":
            if timeout is None:  # without a limit
                raise RuntimeError("deadlock: every task waits, and nothing will wake one")
            if timeout > 0:
                _pass_s(made, timeout)
            return super().select(0)

    class Loop(asyncio.SelectorEventLoop):
        """An event loop with the simulator's clock."""

        def __init__(self) -> None:
            super().__init__(Selector())

        def time(self) -> float:
            return made[-1].now_s if made else 0.0

    class Policy(asyncio.DefaultEventLoopPolicy):
        """Makes these loops."""

        def new_event_loop(self) -> asyncio.AbstractEventLoop:
            return Loop()

    asyncio.set_event_loop_policy(Policy())


def _install_in_micropython(made: "list[SimHardware]") -> None:
    """MicroPython's loop has no clock of its own: its functions are replaced.

    Its queue, which is in C, takes the real time for tasks that may run at once. So the virtual
    time is the sum of the real one and all time that has passed in waits: it is never earlier than
    the real one, so those tasks are always due.
    """
    core: "Any" = asyncio.core  # type: ignore[attr-defined]
    real_ticks = core.ticks
    waited_ms = [0]  # in a list, because both functions below use it

    def ticks() -> int:
        return int(core.ticks_add(real_ticks(), waited_ms[0]))

    def wait(milliseconds: int) -> None:
        if milliseconds < 0:  # without a limit
            raise RuntimeError("deadlock: every task waits, and nothing will wake one")
        if milliseconds:
            waited_ms[0] += milliseconds
            _pass_s(made, milliseconds / 1000)

    core.ticks = ticks
    core._io_queue.wait_io_event = wait
