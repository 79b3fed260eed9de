"""A simulated machine for the commands: its board by name, its storage for settings."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from .. import paths
from ..boardfile import hal_texts
from ..boardfile.board_check import is_simulated
from ..boardfile.files import load_board
from ..grbl.messages import meaning
from ..grbl.settings_file import Firmware, SettingsError, check_known, read_settings
from . import kernels
from .file_store import FileStore
from .inputs import Inputs, Rule
from .own_python import NAME, OwnPython, read

if TYPE_CHECKING:
    from base.settings import Settings
    from talk.controller import Controller

    from ..sim.rig import MemoryStore, Rig

DEFAULT_BOARD = "sim"
DEFAULT_AXES = 3
# Options that decide which words a program may use and where it may move, by their letters in $I.
_OPTIONS = {"M": "MIST", "R": "OVERRIDE_CONTROL", "C": "COREXY", "Z": "FORCE_SET_ORIGIN"}


@dataclass(frozen=True)
class Around:
    """The surroundings of a machine. custom: the user's own Python. rules: for its inputs.
    others_ms: inputs without a rule change after being waited for so long. lenient: accept words
    of other controllers, whatever the board file says."""

    custom: "OwnPython | None" = None
    rules: "tuple[Rule, ...]" = ()
    others_ms: "int | None" = None
    lenient: bool = False


NOTHING = Around()


def around(board: str, custom: Path | None, rules: "Iterable[Rule]" = ()) -> Around:
    """Return the surroundings with the user's own Python, if any, under the name it has on that
    board. OwnPythonError."""
    if custom is None:
        return Around(rules=tuple(rules))
    name = getattr(load_board(board), "CUSTOM", "") or NAME
    return Around(read(custom, name), tuple(rules))


class UntimedLink:
    """The interface that a rig needs of a Link without a script, whose bytes take no time."""

    def discard(self) -> None:
        """Do nothing: bytes arrive only when they are read."""

    def next_event(self) -> None:
        """Return None: no byte is in transit."""

    def advance(self) -> None:
        """Do nothing: time delivers no bytes."""

    def power_off(self) -> None:
        """Do nothing: no byte is in transit."""

    def now_at(self) -> int:
        """Return 0: there is no program, so no line of it."""
        return 0


def build(
    board: str,
    link: "Callable[[Rig], UntimedLink]",
    settings: Path | None = None,
    *,
    blank: bool = False,
    coarse: int = 1,
    letters: str = "",
    axes: int = DEFAULT_AXES,
    around: Around = NOTHING,
    keeps_jobs: bool = False,
) -> "Rig":
    """Build a rig with that board, and the settings that a new machine has after its first start.

    link: makes the Link. settings: the file that stores them, if any. blank: start with erased
    memory instead. coarse: factor by which the engine's ticks are longer, which is faster and less
    exact. letters, axes: of a real machine to imitate. keeps_jobs: store jobs in the folder that
    the board names; otherwise they are lost. ValueError for a settings file that cannot be used.
    """
    paths.use_firmware()
    kernels.use()
    from ..sim.replay import factory_store
    from ..sim.rig import MemoryStore, Rig

    adapted = _imitate(load_board(board), letters, axes)
    if getattr(adapted, "CUSTOM", ""):  # do not import a custom.py that is on the path by chance
        adapted = _copy(adapted, adapted.__name__, CUSTOM="")
    if getattr(adapted, "JOBS", "") and not keeps_jobs:
        from .job_memory import keep_in_memory

        adapted = _copy(adapted, adapted.__name__)
        keep_in_memory(adapted)
    if getattr(adapted, "POWER_FAIL", None) is not None:  # nothing here closes that contact
        adapted = _copy(adapted, adapted.__name__, POWER_FAIL=None)
    if around.lenient:
        adapted = _copy(adapted, adapted.__name__, LENIENT=True)
    for content in hal_texts.made(adapted).values():  # none, or one
        _provide_hal_texts(content)
    store: Any = MemoryStore() if blank else factory_store(adapted)
    if settings is not None:
        try:
            file_store = FileStore(settings, store.files, firmware(adapted))
            _check_values(adapted, file_store.load("settings") or ())
        except SettingsError as error:
            raise ValueError(f"{settings} was not changed: {error}") from error
        store = file_store
    return _make_rig(around, adapted, lambda board: Rig(board, store, link, coarse))


def _provide_hal_texts(texts: bytes) -> None:
    """Give a machine with the grblHAL dialect its texts, which a deployment stores on a board."""
    from extras.dialects import dialect_hal

    dialect_hal.texts = lambda: BytesIO(texts)


def _make_rig(around: Around, board: Any, make: "Callable[[Any], Rig]") -> "Rig":
    """Return a rig with these surroundings, made by make(board), which gets a copy of the board if
    that must be changed."""
    if around.custom is None:
        rig = make(board)
        rig.inputs = Inputs(rig, around.rules, around.others_ms)
        return rig
    from .custom_module import load_custom

    copy = _copy(board, board.__name__, **assumed_pins(board, around.custom))
    custom_module = load_custom(copy, around.custom)
    rig = make(copy)
    custom_module.inputs = rig.inputs = Inputs(rig, around.rules, around.others_ms)
    rig.custom_module = custom_module
    return rig


def assumed_pins(board: Any, custom: OwnPython) -> dict[str, dict[str, int]]:
    """Return OUTPUTS and INPUTS for a simulated board that defines none: those that the user's
    Python uses."""
    if not is_simulated(board) or hasattr(board, "OUTPUTS") or hasattr(board, "INPUTS"):
        return {}
    outputs = sorted({name for _, _, name in custom.outputs()})
    inputs = sorted({name for _, _, name in custom.inputs()})
    return {
        "OUTPUTS": {name: pin for pin, name in enumerate(outputs)},
        "INPUTS": {name: pin for pin, name in enumerate(inputs, len(outputs))},
    }


def _imitate(board: Any, letters: str, axes: int) -> Any:
    """Return a board with options of another machine, by their letters in $I, and as many axes."""
    options = {name: True for letter, name in _OPTIONS.items() if letter in letters}
    if not options and axes == DEFAULT_AXES:
        return board
    name = f"{board.__name__}+{letters}{axes}"
    return _copy(board, name, **options, STEP=tuple(range(axes)))


def _copy(board: Any, name: str, **options: Any) -> Any:
    """Return a copy of a board with another name and other options."""
    copied = ModuleType(name)
    vars(copied).update({name: value for name, value in vars(board).items() if name[:2] != "__"})
    vars(copied).update(options)
    return copied


def _check_values(board: Any, lines: Iterable[str]) -> None:
    """Raise SettingsError if the machine would refuse a setting, in whatever order they are set.

    The machine does not check what it reads from its own memory. Settings that it does not have
    are kept.
    """
    _set_all(_controller(board)[0].settings, lines)


def kept_settings(board: str, file: Path) -> tuple[str, list[str]]:
    """Return what the machine of that board stores if its settings are those of a file: the name
    under which they are stored, and lines. SettingsError for a file that is no settings file, or
    has values that the machine refuses."""
    paths.use_firmware()
    values = read_settings(file).values
    controller, store = _controller(_copy(load_board(board), board, CUSTOM=""))
    lines = {number: f"${number}={value}" for number, value in values.items()}
    try:
        accepted = _set_all(controller.settings, lines.values())
        check_known(values, [number for number, line in lines.items() if line in accepted])
    except SettingsError as error:
        raise SettingsError(f"{file}: {error}") from error
    controller.saves.write_due()  # into its memory
    return controller.settings.file, store.files[controller.settings.file]


def _controller(board: Any) -> "tuple[Controller, MemoryStore]":
    """Return a machine with new memory that has not been started, and its store."""
    from boot import wiring

    from ..sim.rig import Rig

    rig = Rig(board)
    controller = wiring.build(board, rig.link, rig.port, rig.engine, rig.store)
    controller.settings.load()
    return controller, rig.store


def taken(board: str, lines: Iterable[str]) -> list[str]:
    """Return the settings, lines such as `$110=6000`, that the machine of that board accepts, in
    an order in which it accepts them."""
    paths.use_firmware()
    controller, _ = _controller(_copy(load_board(board), board, CUSTOM=""))
    accepted, _refused = _set(controller.settings, lines)
    return accepted


def _set_all(settings: "Settings", lines: Iterable[str]) -> list[str]:
    """Set the lines, in any order that works. SettingsError if some are refused. Returns those
    that the machine has."""
    accepted, refused = _set(settings, lines)
    if refused:
        raise SettingsError(
            "; ".join(f"{line}: {answer}: {meaning(answer, line)}" for line, answer in refused)
        )
    return accepted


def _set(settings: "Settings", lines: Iterable[str]) -> tuple[list[str], list[tuple[str, str]]]:
    """Set the lines. Returns those accepted, in their order, and those refused with the answer.
    Settings that the machine does not have are in neither list."""
    from base import errors
    from base.errors import GrblError

    accepted: list[str] = []
    remaining = list(lines)
    # Again while some become possible: a setting may need another one first.
    while remaining:
        refused = []
        for line in remaining:
            number, _, value = line[1:].partition("=")
            try:
                settings.set(int(number), float(value))
                accepted.append(line)
            except GrblError as error:
                if error.args[0] != errors.INVALID_STATEMENT:  # that: there is no such setting
                    refused.append((line, f"error:{error.args[0]}"))
        if len(refused) == len(remaining):  # nothing has become possible
            return accepted, refused
        remaining = [line for line, _ in refused]
    return accepted, []


def firmware(board: Any) -> Firmware:
    """Return what $I reports with that board."""
    from boot.options import Options
    from talk import report

    options = Options(board)
    version = getattr(options.report, "VERSION", report.VERSION)
    number, letter = version[:-1], version[-1]
    return Firmware(number, letter, report.BUILD, options.identity(), options.letters())


def run(rig: "Rig") -> None:
    """Power the machine up and run it until its link switches it off."""
    rig.run(iter([lambda: False]))
