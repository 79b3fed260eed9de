"""Fills the stock of compiled firmware while the package is made: setup.py runs it there.

For each processor it has the firmware with each board option alone, and with those of each file in
boards/, a simulated machine's too. Where modules stay apart all of them are there, and any board
has what it needs.
"""

from collections.abc import Iterable, Iterator
from types import ModuleType

from ..boardfile.chips import CHIPS, Chip
from ..boardfile.engines import WIRELESS
from ..boardfile.files import boards, load_board
from ..boardfile.options import MODULE, OPTIONS, SWITCH, WORD, Option
from . import build, stock


def main() -> None:
    """Compile, and write."""
    stock.save(build.texts(), _cuts())


def _cuts() -> Iterator[stock.Cut]:
    done = []
    for wanted in _wanted():
        for arch, chip in {chip.mpy_arch: chip for chip in CHIPS.values()}.items():
            board: ModuleType | None = _on(chip, wanted)
            modules = build.modules_of(board)
            if build.stay_apart(modules):
                board, modules = None, build.modules_of()
            if (arch, modules) not in done:
                done.append((arch, modules))
                made = build.compile_all(arch, board)
                yield stock.Cut(arch, modules, made.files, made.map)


def _wanted() -> Iterator[dict[str, object]]:
    """Options of boards."""
    for name in boards():
        yield vars(load_board(name))
    for option in OPTIONS:
        for value in _others(option):
            yield {option.name: value}


def _others(option: Option) -> Iterable[object]:
    """What else it may be, where modules can depend on it."""
    if option.kind is SWITCH:
        return [not option.default]
    if option.kind is MODULE:
        return [""]
    return option.words() if option.kind is WORD and option.words else []


def _on(chip: Chip, wanted: dict[str, object]) -> ModuleType:
    """A board with these options and that chip, whose network is beside its own cable."""
    found = ModuleType("board")
    link = WIRELESS[chip.link] if wanted.get("LINK") in WIRELESS.values() else chip.link
    vars(found).update(wanted, ENGINE=chip.engine, LINK=link)
    return found


if __name__ == "__main__":
    main()
