"""A simulated machine for the commands: its board by name, its place to keep settings."""

from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from .. import paths
from ..boardfile.files import load_board
from ..compiling import kernels
from ..grbl.messages import meaning
from ..grbl.settings_file import Firmware, SettingsError
from .file_store import FileStore

if TYPE_CHECKING:
    from ..sim.rig import Rig

DEFAULT_BOARD = "sim"
DEFAULT_AXES = 3
# Options that decide what a program may say and where it may go, by their letters in $I.
_OPTIONS = {"M": "MIST", "R": "OVERRIDE_CONTROL", "C": "COREXY", "Z": "FORCE_SET_ORIGIN"}


class UntimedLink:
    """What the rig wants of a Link without a script, whose bytes take no time on a wire."""

    def discard(self) -> None:
        """Nothing has arrived before it is read."""

    def next_event(self) -> None:
        """Nothing is on its way."""

    def advance(self) -> None:
        """Nothing arrives by time alone."""

    def power_off(self) -> None:
        """Nothing is lost."""

    def now_at(self) -> int:
        """No program is known, and so no line of it."""
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
) -> "Rig":
    """A rig with that board, with the settings of a new machine that has once been started.

    link: makes the Link; settings: the file that keeps them, if any; blank: with an erased
    memory instead; coarse: see Rig; letters, axes: of a machine that it is to be like.
    ValueError for a file that cannot be one.
    """
    paths.use_firmware()
    kernels.use()
    from ..sim.replay import factory_store
    from ..sim.rig import MemoryStore, Rig

    module = _like(load_board(board), letters, axes)
    store = MemoryStore() if blank else factory_store(module)
    if settings is None:
        return Rig(module, store, link, coarse)
    try:
        kept = FileStore(settings, store.files, firmware(module))
        _check_values(module, kept.load("settings") or ())
    except SettingsError as error:
        raise ValueError(f"{settings} is left as it is: {error}") from error
    return Rig(module, kept, link, coarse)


def _like(board: Any, letters: str, axes: int) -> Any:
    """A board with options of another machine, by their letters in $I, and as many axes."""
    options = {name: True for letter, name in _OPTIONS.items() if letter in letters}
    if not options and axes == DEFAULT_AXES:
        return board
    made = ModuleType(f"{board.__name__}+{letters}{axes}")
    vars(made).update({name: value for name, value in vars(board).items() if name[:2] != "__"})
    vars(made).update(options, STEP=tuple(range(axes)))
    return made


def _check_values(board: Any, lines: Iterable[str]) -> None:
    """SettingsError where the machine would not take a setting, in whatever order they come.

    What it reads from its own memory it takes unseen. Settings that it does not have are kept.
    """
    from base import errors
    from base.errors import GrblError
    from boot import wiring

    from ..sim.rig import Rig

    rig = Rig(board)
    settings = wiring.build(board, rig.link, rig.port, rig.engine, rig.store).settings
    settings.load()
    left = list(lines)
    while left:
        refused = []
        for line in left:
            number, _, value = line[1:].partition("=")
            try:
                settings.set(int(number), float(value))
            except GrblError as error:
                if error.args[0] != errors.INVALID_STATEMENT:
                    refused.append((line, f"error:{error.args[0]}"))
        if len(refused) == len(left):
            raise SettingsError(
                "; ".join(f"{line}: {why}: {meaning(why)}" for line, why in refused)
            )
        left = [line for line, _ in refused]


def firmware(board: Any) -> Firmware:
    """What $I says with that board."""
    from boot.options import Options
    from talk import report

    options = Options(board)
    version = getattr(options.report, "VERSION", report.VERSION)
    number, letter = version[:-1], version[-1]
    return Firmware(number, letter, report.BUILD, options.identity(), options.letters())


def run(rig: "Rig") -> None:
    """Power it up and let it run until its link switches it off."""
    rig.run(iter([lambda: False]))
