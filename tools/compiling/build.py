"""Firmware for one board: which modules it needs, and what the compilers make of them.

For a processor the firmware is compiled once, each module into a file of its own; a board gets
those that it needs.
"""

import ast
import hashlib
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from .. import paths
from ..boardfile import engines, hal_texts, options
from ..boardfile.board_check import own_modules
from ..boardfile.chips import CHIPS
from ..boardfile.files import load_for_build
from . import compilers, kernel_module, machine_code, page_files, prebuilt
from .cache import cached
from .for_chip import for_chip
from .inline import inline, pruned
from .kernel_module import Apart

# MicroPython runs main.py at start, and never main.mpy: this one stays as it is.
START = "main.py"
KERNELS = f"{kernel_module.PACKAGE}/"  # what else may be on a board
BOARD = "board.py"

# Is told path and bytes of each file.
Progress = Callable[[str, int], None]

# Where engines and links are made, a function for each, which bears its name.
_PARTS = ("boot.parts", "boot.parts_esp")
# Modules that one of these options asks for by a value; True: by any that is not nothing. All
# others go on a board if one that goes there imports them, where it makes an engine or link: the
# board's.
_SWITCHED: dict[str, tuple[tuple[str, ...], object]] = {
    "motion.kinematics": (("BACKLASH", "COREXY", "MOTORS", "MOVES", "SKEW"), True),
    "ports.storage.job_files": (("JOBS",), True),
    "ports.storage.sd_card": (("SD_CARD",), True),
    "ports.driver_wire": (("TMC2209",), True),
    "ports.net.page_link": (("PAGE",), True),
    "pio.beam": (("TOOL",), "laser"),
}
# What extras are handed; who has none has no use for it.
_EXTRAS_API = "extras.api"
# What base/errors.py has for an id; what is compiled has its own in this place.
_OF_SOURCES = '"--------"'
_DIGITS = 8


class BuildError(Exception):
    """What is wrong, a text for each thing."""

    def __init__(self, *problems: str) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


class Firmware(NamedTuple):
    """All modules for a processor, compiled, by name; id: what tells them from others."""

    id: str
    modules: dict[str, bytes]


@dataclass
class Build:
    """Files by their path on the board. engine: the board file's; "" where it is for none.

    id: of the firmware. own: files that are none of it.
    """

    arch: str
    files: dict[str, bytes] = field(default_factory=dict)
    engine: str = ""
    id: str = ""
    own: tuple[str, ...] = ()

    @property
    def bytes(self) -> int:
        """All of them together."""
        return sum(map(len, self.files.values()))


# Sources


def sources() -> list[str]:
    """Every module of the firmware: `main.py`, `pio/engine.py`.

    What makes a folder a package on a desktop only says what the folder is for: a board has no
    use for it.
    """
    found = (path for path in paths.FIRMWARE.rglob("*.py") if path.name != "__init__.py")
    return sorted(path.relative_to(paths.FIRMWARE).as_posix() for path in found)


def texts() -> dict[str, str]:
    """Every module of the firmware as it is written, by its name."""
    return {module(source): _text(source) for source in sources()}


def module(source: str) -> str:
    """`pio/engine.py` is `pio.engine`."""
    return source.removesuffix(".py").replace("/", ".")


def path_of(name: str) -> str:
    """Where a module is on a board."""
    return START if name == module(START) else f"{name.replace('.', '/')}.mpy"


def _text(source: str) -> str:
    return (paths.FIRMWARE / source).read_text(encoding="utf-8")


def id_of(arch: str) -> str:
    """What tells the firmware that is here from others, by its sources: not from what other passes
    have made of the same ones."""
    return _id(_written(arch))


def in_place(arch: str) -> dict[str, str]:
    """The modules for a processor, by name, after the first pass, and with their id."""
    return _in_place(_written(arch))


def prepared(arch: str) -> Apart:
    """The modules as they are compiled, and the kernels, where there is machine code."""
    texts = in_place(arch)
    if arch not in machine_code.PROCESSORS:
        return Apart(texts, "", {})
    return _apart(tuple(texts.items()), tuple(_reached(texts, _plain(arch))))


def _written(arch: str) -> tuple[tuple[str, str], ...]:
    return tuple(for_chip(texts(), arch).items())


def _id(written: tuple[tuple[str, str], ...]) -> str:
    return hashlib.sha256(repr(written).encode()).hexdigest()[:_DIGITS]


@lru_cache(4)
@cached
def _in_place(written: tuple[tuple[str, str], ...]) -> dict[str, str]:
    stamped = f'"{_id(written)}"'
    return {
        name: text.replace(_OF_SOURCES, stamped)
        for name, text in pruned(inline(dict(written))).items()
    }


@lru_cache(4)
@cached
def _apart(written: tuple[tuple[str, str], ...], core: tuple[str, ...]) -> Apart:
    return kernel_module.taken_apart(dict(written), core)


# Which a board needs


def modules_of(board: ModuleType) -> list[str]:
    """The modules, by name, that a board has a use for."""
    return _reached(in_place(getattr(board, "MPY_ARCH", "")), board)


def _plain(arch: str) -> ModuleType:
    """A board that has what every board with that processor has."""
    chip = next(chip for chip in CHIPS.values() if chip.mpy_arch == arch)
    board = ModuleType("board")
    vars(board).update(ENGINE=chip.engine, LINK=chip.link, CUSTOM="")
    return board


def _reached(there: Mapping[str, str], board: ModuleType) -> list[str]:
    """Of these texts, those that are imported on a board, one by another."""
    extras = _extras(board)
    found: set[str] = set()
    left = [module(START), *extras]
    while left:
        name = left.pop()
        off = _is_off(board, name) or (name == _EXTRAS_API and not extras)
        if name in there and name not in found and not off:
            found.add(name)
            without = _others(board) if name in _PARTS else set()
            left += imported(there[name], frozenset(without))
    return sorted(found)


def _is_off(board: ModuleType, name: str) -> bool:
    asking, wanted = _SWITCHED.get(name, ((), None))
    values = [getattr(board, option, None) for option in asking]
    found = [bool(value) if wanted is True else value for value in values]
    return name in _SWITCHED and wanted not in found


def _extras(board: ModuleType) -> list[str]:
    paths.use_firmware()
    from boot import select_extras

    own = getattr(board, "CUSTOM", options.BY_NAME["CUSTOM"].default)
    return select_extras.extra_names(board, bool(own))


def _others(board: ModuleType) -> set[str]:
    """The engines and links which this board has not."""
    link = getattr(board, "LINK", options.BY_NAME["LINK"].default)
    return {*engines.engines(), *engines.links()} - {board.ENGINE, link}


@lru_cache(400)
def imported(text: str, without: frozenset[str] = frozenset()) -> tuple[str, ...]:
    """What may be a module in the imports of a text, but not what only mypy reads, nor what
    those functions import."""
    return tuple(_imported(ast.parse(text), without))


def _imported(node: ast.AST, without: Collection[str]) -> Iterator[str]:
    if isinstance(node, ast.FunctionDef) and node.name in without:
        return
    if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
        return
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module:
        yield node.module
        yield from (f"{node.module}.{alias.name}" for alias in node.names)
    for child in ast.iter_child_nodes(node):
        yield from _imported(child, without)


# Compiled


def firmware(arch: str) -> Firmware:
    """All modules, compiled; out of the package where there are no compilers. BuildError."""
    if compilers.are_there(arch):
        return Firmware(id_of(arch), compiled(arch, prepared(arch)))
    try:
        return Firmware(id_of(arch), prebuilt.find(texts(), arch))
    except prebuilt.NotThere as why:
        raise BuildError(compilers.missing(str(why))) from why


def compiled(arch: str, made: Apart, told: Callable[[str], str] = str) -> dict[str, bytes]:
    """What the compilers make of each module. told: what tracebacks call it, by its name."""
    code = {name: _compile(told(name), text, arch) for name, text in made.texts.items()}
    try:
        for name in made.pieces:
            code[name] = kernel_module.with_code(code[name], name, made, arch)
    except machine_code.CompilerError as error:
        raise BuildError(f"kernels cannot be compiled: {error}") from error
    return code


@lru_cache(1000)
@cached
def _compile(name: str, text: str, arch: str) -> bytes:
    """A module in MicroPython's own format."""
    try:
        return compilers.compiled(name, text, arch)
    except compilers.CompilerError as error:
        raise BuildError(str(error)) from error


def compile_all(
    arch: str, board: ModuleType | None = None, progress: Progress = lambda name, size: None
) -> Build:
    """Every module, or those a board needs. Without compilers it comes out of the package.
    BuildError where it is not there."""
    whole = firmware(arch)
    wanted = _reached(prepared(arch).texts, board) if board else [*whole.modules]
    files = {path_of(name): whole.modules[name] for name in wanted}
    files[START] = _text(START).encode()
    for path, content in sorted(files.items()):
        progress(path, len(content))
    return Build(arch, files, id=whole.id)


def for_board(file: Path, progress: Progress = lambda name, size: None) -> Build:
    """What belongs on the board of that file. BoardFileError before anything is compiled."""
    board: Any = load_for_build(file)
    made = compile_all(board.MPY_ARCH, board, progress)
    made.engine = board.ENGINE
    own = [f"{name}.py" for name in own_modules(board)]
    for path, source in ((BOARD, file), *((name, file.parent / name) for name in own)):
        made.files[path] = source.read_bytes()
        progress(path, len(made.files[path]))
    data = page_files.made() if getattr(board, "PAGE", False) else {}
    data |= hal_texts.made(board)
    for path, content in data.items():
        made.files[path] = content
        progress(path, len(content))
    made.own = (BOARD, *own, *data)
    return made


def signature(made: Build) -> int:
    """Version and processor of compiled code, as the board's sys.implementation._mpy has them.

    Most files are for every processor; this is from one that is not.
    """
    heads = (content[:4] for path, content in made.files.items() if path.endswith(".mpy"))
    return max(head[1] | head[2] << 8 for head in heads)


def digest(content: bytes) -> str:
    """What tells two files apart."""
    return hashlib.sha256(content).hexdigest()
