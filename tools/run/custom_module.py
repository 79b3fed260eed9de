"""The user's own Python as a module of one simulated machine: imported, and watched as it runs.

The firmware's extras/custom/ does the work. This module adds what a board has no space for: the
paths of its files, which handlers have run, what they wait for, and how each has failed. Import it
only when the firmware is importable.
"""

import sys
import traceback
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec
from importlib.util import spec_from_loader
from types import ModuleType
from typing import Any

from base.text import sanitize
from boot import select_extras
from extras.custom import handlers, user_modules
from extras.custom.machine_api import MachineApi
from extras.custom.runner import Runner
from extras.custom.user_modules import Custom

from . import board_modules
from .own_python import LackError, OwnPython, OwnPythonError

_PREFIX = "Custom: "  # of the line in $I
_MODULE = "_module"  # the board's attribute for the module


class CustomModule:
    """The state of the user's module. examine: called with the registered handlers, before they
    are accepted."""

    def __init__(self, own: OwnPython) -> None:
        self.own = own
        self.files = {str(module.file): module for module in own.modules.values()}
        self.notes: list[Any] = []  # the registered handlers
        self.examine: "Callable[[Any, list[Any]], None] | None" = None
        self.running: list[str] = []  # handlers, innermost last
        self.ran: list[str] = []  # handlers that have ended or failed
        self.faults: list[str] = []
        # faults caused by something that boards have and the simulator does not
        self.lacks: list[str] = []
        self.interrupted = ""  # the handler that Ctrl-C has ended
        self.inputs: Any = None
        # Called for a wait that nothing can end.
        self.on_endless_wait: "Callable[[str], None] | None" = None
        # called for a wait for a person
        self.on_person_wait: "Callable[[str], None] | None" = None
        # called when an output is switched
        self.on_switched: "Callable[[str, bool], None] | None" = None

    def handler_names(self) -> str:
        """Return its handlers, as $I lists them after `Custom: `."""
        names = [user_modules.title(note[0], note[1]) for note in self.notes]
        # With the prefix, because the firmware limits the length of the whole line.
        return sanitize(_PREFIX + ", ".join(names))[len(_PREFIX) :]

    def describe(self, fault: BaseException) -> str:
        """Return a fault in words, with the last line of the user's own code before it."""
        return f"{self.place(fault)}{type(fault).__name__}: {fault}".removesuffix(": ")

    def place(self, fault: BaseException) -> str:
        """Return the innermost of the user's lines in a fault's traceback as `FILE, line N: `; ""
        if there is none."""
        place = ""
        for frame in traceback.extract_tb(fault.__traceback__):
            if frame.filename in self.files:
                place = f"{frame.filename}, line {frame.lineno}: "
        return place

    def note_wait(self, name: str, closed: bool, seconds: "float | None", has_level: bool) -> None:
        """Note that a handler waits for an input, and report a wait that may never end.

        closed: the level that it waits for. seconds: its time limit, if any. has_level: the input
        has that level already.
        """
        can_change = self.inputs.await_(name, closed)
        if has_level or seconds is not None:
            return  # the wait ends
        handler, change = self.running[-1], "close" if closed else "open"
        if self.on_person_wait:
            self.on_person_wait(f"{handler} waits for the input {name} to {change}")
        elif self.on_endless_wait and not can_change:
            level = "on" if closed else "off"
            self.on_endless_wait(
                f"{handler} waits for the input {name} to {change}, which nothing does here: "
                f"add --input {name}={level}, or {name}=2s for two seconds later"
            )


class _Importer:
    """Finds and loads a module's files for import. No compiled files are stored."""

    module: "CustomModule | None" = None

    def find_spec(
        self, name: str, path: "Sequence[str] | None" = None, target: "ModuleType | None" = None
    ) -> "ModuleSpec | None":
        """Return the spec of a user's file; these take precedence over other modules of the same
        name."""
        if self.module is None:
            return None
        modules = self.module.own.modules
        if name in modules:
            return spec_from_loader(name, self, origin=str(modules[name].file))  # type: ignore[arg-type]
        if any(module_name.startswith(name + ".") for module_name in modules):  # the folder
            return spec_from_loader(name, self, is_package=True)  # type: ignore[arg-type]
        return None

    def create_module(self, spec: ModuleSpec) -> None:
        """Use the default module."""

    def exec_module(self, module: ModuleType) -> None:
        """Compile and run the file, without a __pycache__."""
        assert self.module
        own_file = self.module.own.modules.get(module.__name__)
        if own_file:
            module.__file__ = str(own_file.file)
            code = compile(own_file.source, str(own_file.file), "exec", dont_inherit=True)
            exec(code, vars(module))


class WatchedApi(MachineApi):
    """Reports to its module what handlers wait for."""

    module: CustomModule

    def out(self, name: str, on: Any) -> None:
        """Switch an output as on the board, and report it."""
        super().out(name, on)
        if self.module.on_switched:
            self.module.on_switched(name, bool(on))

    def pwm(self, name: str, share: float, hz: float = 1000) -> None:
        """Set a PWM output as on the board, and report it."""
        super().pwm(name, share, hz)
        if self.module.on_switched:
            self.module.on_switched(name, share > 0)

    def wait_for(self, name: str, closed: bool = True, seconds: "float | None" = None) -> bool:
        """Wait for an input as on the board, and report it."""
        self.module.note_wait(name, closed, seconds, self.pin(name) == closed)
        try:
            return super().wait_for(name, closed, seconds)
        finally:
            self.module.inputs.end_wait()


class WatchedRunner(Runner):
    """Reports to its module which handlers run, and how they fail."""

    module: CustomModule

    def run(
        self,
        what: str,
        function: "Callable[..., Any]",
        may_move: bool,
        values: "tuple[Any, ...]" = (),
        given: "dict[str, Any] | None" = None,
    ) -> Any:
        """Run a handler, and record it. what: its name, such as `M100`. may_move: it may command
        motion. values, given: its arguments. Returns its result."""
        module = self.module
        module.running.append(what)
        try:
            returned = super().run(what, function, may_move, values, given)
            if what == "on.report" and not isinstance(returned, str | None):
                module.faults.append(f"{what}: it must return a text or None, not {returned!r}")
            return returned
        except KeyboardInterrupt as stop:
            module.interrupted = f"{what}: {module.place(stop)}".removesuffix(": ")
            raise
        finally:
            module.running.pop()
            module.ran.append(what)

    def _fail(self, what: str, fault: BaseException, may_move: bool) -> None:
        """Record a handler's failure, then react to it as on the board."""
        self.module.faults.append(f"{what}: {self.module.describe(fault)}")
        if board_modules.is_lacking(fault):
            self.module.lacks.append(self.module.faults[-1])
        super()._fail(what, fault, may_move)

    def _is_own(self, file: str) -> bool:
        """Return whether a file is of the user's own Python."""
        return file in self.module.files


class WatchedCustom(Custom):
    """Passes the handlers to its module for examination before it accepts them. Instead of leaving
    faulty code out it raises OwnPythonError, because a simulation without it would be useless."""

    def __init__(self, cnc: Any, runner: Runner, events: Any) -> None:
        module = _importer.module
        assert module and isinstance(runner, WatchedRunner)
        assert isinstance(runner.machine_api, WatchedApi)
        self._module = runner.module = runner.machine_api.module = module
        super().__init__(cnc, runner, events)

    def register(self, notes: list[Any]) -> None:
        """Examine the handlers, then register them."""
        self._module.notes = notes
        if self._module.examine:
            self._module.examine(self._cnc, notes)
        super().register(notes)

    def leave_out(self, fault: BaseException) -> None:
        """Raise OwnPythonError, with the place of the fault if it is known."""
        handlers.take_notes()  # drops what it has registered
        if isinstance(fault, OwnPythonError):
            raise fault
        text = self._module.describe(fault)
        place = "" if ", line " in text else f"{self._module.own.path}: "
        if board_modules.is_lacking(fault):
            raise LackError(f"{place}{text}: boards have it, the simulator does not") from fault
        raise OwnPythonError(place + text) from fault


_importer = _Importer()
_PLAIN = Custom, MachineApi, Runner
_WATCHING = WatchedCustom, WatchedApi, WatchedRunner
_usual_customs = select_extras.custom_modules


def _customs(board: ModuleType) -> "tuple[str, ...]":
    """Replace select_extras.custom_modules: return the names of the user's modules for a board.
    Those of load_custom() are on this computer, and are watched."""
    module: "CustomModule | None" = board.__dict__.get(_MODULE)
    _importer.module = module
    names = ("Custom", "MachineApi", "Runner")
    vars(user_modules).update(zip(names, _PLAIN if module is None else _WATCHING, strict=True))
    if module is None:
        return _usual_customs(board)
    for name in (module.own.name, *module.own.modules):
        sys.modules.pop(name, None)  # so that they are imported again for each machine
    return tuple(module.own.modules)


def _prepare() -> None:
    """Redirect the firmware's search for custom modules to this module, once, and add the board's
    modules."""
    board_modules.complete()
    if _importer not in sys.meta_path:
        sys.meta_path.insert(0, _importer)
        select_extras.custom_modules = _customs


def load_custom(board: ModuleType, own: OwnPython) -> CustomModule:
    """Make a machine of that board load the user's Python. The board is changed, so pass a
    copy."""
    _prepare()
    module = CustomModule(own)
    vars(board)[_MODULE] = module
    return module
