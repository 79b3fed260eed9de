"""Firmware for one board: which modules it needs, and what mpy-cross makes of them."""

import ast
import hashlib
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any

from .. import paths
from ..boardfile import engines, hal_texts, options
from ..boardfile.board_check import own_modules
from ..boardfile.files import load_for_build
from . import (
    compilers,
    kernel_module,
    machine_code,
    page_files,
    prepared,
    put_together,
    stock,
    symbols,
)
from .assembled import assembled
from .built_in import built_in
from .bundle import Bundles
from .inline import inline
from .kept import kept
from .kernel_module import Apart
from .of_chip import of_chip
from .pairs import pairs
from .scopes import NotUnderstood
from .shorten import Shortened
from .singles import singles

_OF_DESKTOPS = "x64"  # whose MicroPython has floats of double precision
# MicroPython runs main.py at start, and never main.mpy: this one stays as it is.
START = "main.py"
BOARD = "board.py"
# The file of a package, in its folder.
PACKAGE = "__init__"

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
# Brings modules into memory one by one, in an order of its own: there they stay apart.
_IN_ORDER = "esp_chip.start"


class BuildError(Exception):
    """What is wrong, a text for each thing."""

    def __init__(self, *problems: str) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


@dataclass
class Build:
    """Files by their path on the board. engine: the board file's; "" where it is for none.

    map: what its names and places mean, see compiling/symbols.py; it stays on this computer.
    modules: those of the firmware that are in it; own: files that are none of it.
    """

    arch: str
    files: dict[str, bytes] = field(default_factory=dict)
    engine: str = ""
    map: dict[str, Any] = field(default_factory=dict)
    modules: frozenset[str] = frozenset()
    own: tuple[str, ...] = ()

    @property
    def bytes(self) -> int:
        """All of them together."""
        return sum(map(len, self.files.values()))


def sources() -> list[str]:
    """Every module of the firmware: `main.py`, `pio/engine.py`.

    What makes a folder a package on a desktop only says what the folder is for: a board has no
    use for it.
    """
    found = (path for path in paths.FIRMWARE.rglob("*.py") if path.name != "__init__.py")
    return sorted(path.relative_to(paths.FIRMWARE).as_posix() for path in found)


def packages() -> set[str]:
    """What each folder of modules may be one of: `pio/__init__`."""
    folders = {folder for source in sources() if (folder := source.rpartition("/")[0])}
    return {f"{folder}/{PACKAGE}" for folder in folders | {kernel_module.MODULE}}


def needed(board: ModuleType) -> list[str]:
    """The modules that a board has a use for, as sources() has them."""
    there = {module(source): source for source in sources()}
    # Without imports of constants: a module that has nothing else stays behind.
    written = _in_place(_of_chip(getattr(board, "MPY_ARCH", "")))
    found: dict[str, str] = {}
    extras = _extras(board)
    left = [module(START), *extras]
    while left:
        name = left.pop()
        off = _is_off(board, name) or (name == _EXTRAS_API and not extras)
        if name in there and name not in found and not off:
            found[name] = there[name]
            without = _others(board) if name in _PARTS else set()
            left += _asked(written[name], frozenset(without))
    return sorted(found.values())


def _is_off(board: ModuleType, name: str) -> bool:
    asking, wanted = _SWITCHED.get(name, ((), None))
    values = [getattr(board, option, None) for option in asking]
    found = [bool(value) if wanted is True else value for value in values]
    return name in _SWITCHED and wanted not in found


def modules_of(board: "ModuleType | None" = None) -> list[str]:
    """Those, or all there are, by their names."""
    return [module(source) for source in (sources() if board is None else needed(board))]


def _extras(board: ModuleType) -> list[str]:
    paths.use_firmware()
    from boot import guests

    own = getattr(board, "CUSTOM", options.BY_NAME["CUSTOM"].default)
    return guests.names(board, bool(own))


def module(source: str) -> str:
    """`pio/engine.py` is `pio.engine`."""
    return source.removesuffix(".py").replace("/", ".")


def _others(board: ModuleType) -> set[str]:
    """The engines and links which this board has not."""
    link = getattr(board, "LINK", options.BY_NAME["LINK"].default)
    return {*engines.engines(), *engines.links()} - {board.ENGINE, link}


@lru_cache(300)
def _asked(text: str, without: frozenset[str]) -> tuple[str, ...]:
    return tuple(_imported(ast.parse(text), without))


def _imported(node: ast.AST, without: Collection[str] = ()) -> Iterator[str]:
    """What may be a module in the imports below a node, but not what only mypy reads, nor what
    those functions import."""
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


def compile_all(
    arch: str,
    board: ModuleType | None = None,
    progress: Progress = lambda name, size: None,
    debug: bool = False,
) -> Build:
    """Every module, or those a board needs. debug: names and line numbers stay.

    Without compilers it comes out of the package. BuildError where it is not there.
    """
    wanted = modules_of(board)
    if not compilers.are_there(arch):
        made = _from_stock(arch, wanted, progress, debug)
    else:
        chosen, described = chosen_texts(arch, board, debug)
        made = compile_texts(arch, chosen, progress, debug)
        made.map = described
    made.modules = frozenset(wanted)
    return made


def chosen_texts(
    arch: str, board: ModuleType | None, debug: bool
) -> "tuple[Mapping[str, str], dict[str, Any]]":
    """The modules of a board, or all, as they are compiled; and their map. BuildError."""
    wanted = modules_of(board)
    firmware = prepared_firmware(debug, arch)
    with_code = arch in machine_code.PROCESSORS
    described = dict(_described(_of_chip(arch), debug, not with_code))
    there = kernels_apart(arch, debug).texts if with_code else firmware.texts
    chosen = {name: text for name, text in there.items() if name in wanted}
    if board is not None and not debug and not stay_apart(wanted):
        try:
            chosen, described["bundles"] = _put_together(tuple(chosen.items()))
        except NotUnderstood as error:
            raise BuildError(str(error)) from error
    if text := kernel_module.text(chosen.values()) if with_code else "":
        chosen[kernel_module.MODULE] = text
    return chosen, described


def stay_apart(modules: Collection[str]) -> bool:
    """Whether a board with these modules has each in a file of its own."""
    return _IN_ORDER in modules


def _from_stock(arch: str, wanted: list[str], progress: Progress, debug: bool) -> Build:
    """The same, as it is in the package already."""
    try:
        if debug:
            raise stock.NotThere("what is compiled already has no line numbers")
        apart = [path_of(name) for name in wanted] if stay_apart(wanted) else []
        found, described = stock.find(texts(), arch, wanted, apart)
    except stock.NotThere as why:
        raise BuildError(compilers.missing(str(why))) from why
    for path, content in found.items():
        progress(path, len(content))
    return Build(arch, found, map=described)


def compile_texts(
    arch: str,
    prepared_texts: Mapping[str, str],
    progress: Progress = lambda name, size: None,
    debug: bool = False,
) -> Build:
    """What has been prepared, without a map."""
    made = Build(arch)
    code = compiled(
        arch, {name: text for name, text in prepared_texts.items() if name != module(START)}, debug
    )
    for name in sorted(prepared_texts):
        path = path_of(name)
        made.files[path] = _text(START).encode() if path == START else code[name]
        progress(path, len(made.files[path]))
    return made


def compiled(
    arch: str,
    prepared_texts: Mapping[str, str],
    debug: bool = False,
    told: Callable[[str], str] = str,
) -> dict[str, bytes]:
    """What the compiler makes of each. told: what tracebacks call it, by its name."""
    made = {name: _compile(told(name), text, arch, debug) for name, text in prepared_texts.items()}
    if name := kernel_module.MODULE if kernel_module.MODULE in made else "":
        try:
            apart = kernels_apart(arch, debug)
            made[name] = kernel_module.with_code(made[name], prepared_texts[name], apart, arch)
        except machine_code.CompilerError as error:
            raise BuildError(f"kernels cannot be compiled: {error}") from error
    return made


def path_of(name: str) -> str:
    """Where a module is on a board; one without a folder is a package's."""
    folder, _, file = name.rpartition(".")
    if name == module(START):
        return START
    return f"{folder.replace('.', '/')}/{file}.mpy" if folder else f"{name}/{PACKAGE}.mpy"


def prepared_firmware(debug: bool = False, arch: str = "armv6m") -> Shortened:
    """All modules as they are compiled, with what tells this build from others in them."""
    return _prepared(_of_chip(arch), debug, arch not in machine_code.PROCESSORS)


def kernels_apart(arch: str, debug: bool = False) -> Apart:
    """The same for a processor of which there is machine code, kernels and all else."""
    return _apart(tuple(prepared_firmware(debug, arch).texts.items()))


def _of_chip(arch: str) -> tuple[tuple[str, str], ...]:
    return tuple(of_chip(assembled(texts()), arch).items())


@lru_cache(4)
@kept
def _in_place(modules: tuple[tuple[str, str], ...]) -> dict[str, str]:
    return inline(dict(modules))


@lru_cache(4)
@kept
def _prepared(modules: tuple[tuple[str, str], ...], debug: bool, with_leaves: bool) -> Shortened:
    written = dict(modules)
    made = prepared(written, debug, with_leaves, _in_place(modules))
    return symbols.stamped(written, made)


@lru_cache(4)
@kept
def _described(
    modules: tuple[tuple[str, str], ...], debug: bool, with_leaves: bool
) -> dict[str, Any]:
    return symbols.describe(dict(modules), _prepared(modules, debug, with_leaves), debug)


@lru_cache(2)
@kept
def _apart(modules: tuple[tuple[str, str], ...]) -> Apart:
    return kernel_module.taken_apart(dict(modules))


@lru_cache(32)
@kept
def _put_together(modules: tuple[tuple[str, str], ...]) -> Bundles:
    return put_together(dict(modules), dict(modules))


def _text(source: str) -> str:
    return (paths.FIRMWARE / source).read_text(encoding="utf-8")


def texts() -> dict[str, str]:
    """Every module of the firmware as it is written, by its name."""
    return {module(source): _text(source) for source in sources()}


def for_board(
    file: Path, progress: Progress = lambda name, size: None, debug: bool = False
) -> Build:
    """What belongs on the board of that file. BoardFileError before anything is compiled."""
    board: Any = load_for_build(file)
    made = compile_all(board.MPY_ARCH, board, progress, debug)
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


# Boards have most modules in common.
@lru_cache(300)
@kept
def _compile(name: str, text: str, arch: str, debug: bool) -> bytes:
    """A module in MicroPython's own format."""
    written = pairs(singles(built_in(text)) if arch != _OF_DESKTOPS else text)
    try:
        return compilers.compiled(name, written, arch, debug)
    except compilers.CompilerError as error:
        raise BuildError(str(error)) from error


def signature(made: Build) -> int:
    """Version and processor of compiled code, as the board's sys.implementation._mpy has them.

    Most files are for every processor; this is from one that is not.
    """
    heads = (content[:4] for path, content in made.files.items() if path.endswith(".mpy"))
    return max(head[1] | head[2] << 8 for head in heads)


def digest(content: bytes) -> str:
    """What tells two files apart."""
    return hashlib.sha256(content).hexdigest()
