"""The simulator: one more board, in virtual time. standins/ has what only boards have.

Its modules run under CPython and under the desktop MicroPython alike, so they keep to what both
understand. The stand-ins are `machine`, `rp2` and others, for CPython: their folder is put on the
path, and is no package.

Imports nothing of the other rooms; the firmware is the one thing that it runs. For others, in
tests of theirs: `from ugrbl.sim import Machine` (docs/extending.md).
"""

import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .machine import Machine as Machine

if sys.implementation.name == "cpython":  # MicroPython would ask it for modules, too

    def __getattr__(name: str) -> object:
        """Machine, where somebody asks for it."""
        if name != "Machine":
            raise AttributeError(name)
        from . import machine

        return machine.Machine
