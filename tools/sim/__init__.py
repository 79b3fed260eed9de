"""The simulator: one more board, in virtual time. standins/ has the modules that only boards have.

Its modules run under CPython and under the desktop MicroPython, so they use only what both
support. The stand-ins are `machine`, `rp2` and others, for CPython: their folder is put on the
path, and is not a package.

Imports no other folder of tools; it runs only the firmware. For tests of other projects: `from
ugrbl.sim import Machine` (docs/extending.md).
"""

import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from .machine import Machine as Machine

if sys.implementation.name == "cpython":  # MicroPython would ask it for modules, too

    def __getattr__(name: str) -> object:
        """Return Machine on first use."""
        if name != "Machine":
            raise AttributeError(name)
        from . import machine

        return machine.Machine
