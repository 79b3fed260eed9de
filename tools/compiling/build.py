"""Firmware for one board: the modules it needs, compiled.

The firmware is compiled once per processor, each module into its own file. A board gets only the
modules it needs.
"""

import ast
import hashlib
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType, ModuleType
from typing import Any

from .. import paths
from ..boardfile import engines, hal_texts, options, page_files
from ..boardfile.board_check import own_modules
from ..boardfile.chips import CHIPS, processors
from ..boardfile.files import load_for_build
from . import compilers, kernel_module
from .cache import cached
from .inline import inline
from .kernel_module import Apart

# MicroPython runs main.py at start, but never main.mpy, so this file is not compiled.
START = "main.py"
LIBRARY = "ugrbl_motion"
KERNELS = f"{kernel_module.PACKAGE}/"  # files on a board without a source file
BOARD = "board.py"

# These modules create engines and links. The function that creates one has its name.
_PARTS = ("boot.parts", "boot.parts_esp")
# Modules that are on a board only if one of these options has this value; True stands for any true
# value. Every other module is on a board if a module there imports it. Imports inside the
# functions of _PARTS count only for the board's own engine and link.
_SWITCHED: dict[str, tuple[tuple[str, ...], object]] = {
    "motion.kinematics": (("BACKLASH", "COREXY", "MOTORS", "MOVES", "SKEW"), True),
    "ports.storage.job_files": (("JOBS",), True),
    "ports.storage.sd_card": (("SD_CARD",), True),
    "ports.driver_wire": (("TMC2209",), True),
    "ports.power_input": (("POWER_FAIL",), True),
    "ports.net.page_link": (("PAGE",), True),
    "pio.beam": (("TOOL",), "laser"),
}
# The API for extras; left out of a board without extras.
_EXTRAS_API = "extras.api"
# The placeholder for the id in base/errors.py; compiled firmware has its own id here.
_OF_SOURCES = '"--------"'
_DIGITS = 8
# The module whose constant says that the chip may be an RP2350.
_LAYOUT = "pio.state_layout"
_CHIP = "RP2350"
_MAY_BE = re.compile(rf"^{_CHIP} = const\(1\)$", re.MULTILINE)


class BuildError(Exception):
    """The build is not possible; `problems` has a text for each cause."""

    def __init__(self, *problems: str) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


@dataclass
class Build:
    """Files by their path on the board. engine: of the board file; "" for a build without one.

    id: of the firmware. own: the paths that are not part of the firmware.
    """

    arch: str
    files: dict[str, bytes] = field(default_factory=dict)
    engine: str = ""
    id: str = ""
    own: tuple[str, ...] = ()

    @property
    def bytes(self) -> int:
        """Return the size of all files together."""
        return sum(map(len, self.files.values()))


# Sources


def sources() -> list[str]:
    """Return the path of every module of the firmware: `main.py`, `pio/engine.py`.

    __init__.py files are left out, because they only document a folder and a board does not need
    them; ugrbl_motion is a package of its own (motion_package.py).
    """
    found = (path.relative_to(paths.FIRMWARE) for path in paths.FIRMWARE.rglob("*.py"))
    kept = (path for path in found if path.name != "__init__.py" and path.parts[0] != LIBRARY)
    return sorted(path.as_posix() for path in kept)


def texts() -> dict[str, str]:
    """Return the source text of every module of the firmware, by module name."""
    return {module(source): _text(source) for source in sources()}


def module(source: str) -> str:
    """Return the module name of a path: `pio/engine.py` is `pio.engine`."""
    return source.removesuffix(".py").replace("/", ".")


def path_of(name: str) -> str:
    """Return the path of a module on a board."""
    return START if name == module(START) else f"{name.replace('.', '/')}.mpy"


def _text(source: str) -> str:
    return (paths.FIRMWARE / source).read_text(encoding="utf-8")


def for_chip(sources: Mapping[str, str], arch: str) -> dict[str, str]:
    """Return the modules, by name, for the chips with this processor.

    If no RP2350 has it, the constant of that chip becomes 0, and the compilers drop the code that
    depends on it. ValueError if the line with the constant is missing.
    """
    made = dict(sources)
    if _CHIP not in processors(arch):
        made[_LAYOUT], count = _MAY_BE.subn(f"{_CHIP} = const(0)", made[_LAYOUT])
        if count != 1:
            raise ValueError(
                f"{_LAYOUT} does not say whether the chip may be an {_CHIP}: "
                f"it needs a line {_CHIP} = const(1)"
            )
    return made


def id_of(arch: str) -> str:
    """Return the id of this firmware. It depends on the sources and the processor, not on what the
    passes make of them."""
    return _id(for_chip(texts(), arch))


def in_place(arch: str, more: Mapping[str, str] = MappingProxyType({})) -> dict[str, str]:
    """Return the modules for a processor, by name, after the first pass and with their id.

    more: modules that are not the firmware's, by name.
    """
    return _in_place({**for_chip(texts(), arch), **more})


def prepared(arch: str) -> Apart:
    """Return the texts that are compiled: if there is machine code for the processor, with kernels
    taken out, as C."""
    texts = in_place(arch)
    if arch not in compilers.PROCESSORS:
        return Apart(texts, c="", pieces={})
    return _apart(texts, _reached(texts, _plain(arch)))


def _id(written: dict[str, str]) -> str:
    return hashlib.sha256(repr(written).encode()).hexdigest()[:_DIGITS]


@cached
def _in_place(written: dict[str, str]) -> dict[str, str]:
    stamped = f'"{_id(written)}"'
    return {name: text.replace(_OF_SOURCES, stamped) for name, text in inline(written).items()}


_apart = cached(kernel_module.taken_apart)


# Modules that a board needs


def modules_of(board: ModuleType) -> list[str]:
    """Return the names of the modules that a board needs."""
    return _reached(in_place(getattr(board, "MPY_ARCH", "")), board)


def _plain(arch: str) -> ModuleType:
    """Return a board with only the options that every board with that processor has."""
    chip = next(chip for chip in CHIPS.values() if chip.mpy_arch == arch)
    board = ModuleType("board")
    vars(board).update(ENGINE=chip.engine, LINK=chip.link, CUSTOM="")
    return board


def _reached(there: Mapping[str, str], board: ModuleType) -> list[str]:
    """Return the names of the modules that are imported on a board, directly or by another one."""
    extras = _extras(board)
    on = {name: text for name, text in there.items() if not _is_off(board, name)}
    if not extras:
        on.pop(_EXTRAS_API, None)
    return sorted(imported_by(on, [module(START), *extras], _others(board)))


def of_other_chips(there: Mapping[str, str], arch: str) -> set[str]:
    """Return the names of modules that only engines of chips with another processor import."""
    here = processors(arch)
    others = {
        name
        for name, engine in engines.engines().items()
        if not any(engine.runs_on(processor) for processor in here)
    }
    extras = [name for name in there if name.startswith("extras.")]
    start = [module(START), *extras]
    return imported_by(there, start, ()) - imported_by(there, start, others)


def imported_by(
    there: Mapping[str, str],
    names: Iterable[str],
    without: Collection[str],
    parts: Collection[str] = _PARTS,
) -> set[str]:
    """Return these modules and all that they import, except what only functions `without` of the
    modules `parts` import."""
    found: set[str] = set()
    left = list(names)
    while left:
        name = left.pop()
        if name in there and name not in found:
            found.add(name)
            left += imported(there[name], frozenset(without if name in parts else ()))
    return found


def _is_off(board: ModuleType, name: str) -> bool:
    asking, wanted = _SWITCHED.get(name, ((), None))
    values = [getattr(board, option, None) for option in asking]
    found = [_is_given(value) if wanted is True else value for value in values]
    return name in _SWITCHED and wanted not in found


def _is_given(value: object) -> bool:
    """Return whether an option's value selects something; pin 0 does."""
    return bool(value) or type(value) is int


def _extras(board: ModuleType) -> list[str]:
    paths.use_firmware()
    from boot import select_extras

    own = getattr(board, "CUSTOM", options.BY_NAME["CUSTOM"].default)
    return select_extras.extra_names(board, bool(own))


def _others(board: ModuleType) -> set[str]:
    """Return the engines and links that this board does not use."""
    link = getattr(board, "LINK", options.BY_NAME["LINK"].default)
    return {*engines.engines(), *engines.links()} - {board.ENGINE, link}


@lru_cache(400)
def imported(text: str, without: frozenset[str] = frozenset()) -> tuple[str, ...]:
    """Return the names that a text imports and that may be modules. Imports for type checking
    only, and imports inside the functions `without`, are left out."""
    return tuple(_imported(ast.parse(text), without))


def _imported(node: ast.AST, without: Collection[str]) -> Iterator[str]:
    if isinstance(node, ast.FunctionDef) and node.name in without:
        return
    condition = ast.unparse(node.test) if isinstance(node, ast.If) else ""
    if condition == "False" or condition.endswith("TYPE_CHECKING"):  # before the first pass
        return
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names)
    elif isinstance(node, ast.ImportFrom) and node.module:
        yield node.module
        yield from (f"{node.module}.{alias.name}" for alias in node.names)
    for child in ast.iter_child_nodes(node):
        yield from _imported(child, without)


# Compiling


def firmware(arch: str) -> dict[str, bytes]:
    """Return all modules, by name, compiled; from the package if the compilers are missing.
    BuildError."""
    if compilers.are_there(arch):
        return compiled(arch, prepared(arch))
    if found := {file.name: file.read_bytes() for file in _in_package(arch).glob("*")}:
        return found
    changed = "the firmware has changed since it was compiled" if paths.COMPILED.is_dir() else ""
    raise BuildError(compilers.missing(changed))


def fill_package() -> None:
    """Compile the firmware for every processor into the package, for users without compilers."""
    for arch in {chip.mpy_arch for chip in CHIPS.values()}:
        for name, content in firmware(arch).items():
            paths.write(_in_package(arch) / name, content)


def _in_package(arch: str) -> Path:
    """Return the folder for the compiled modules of these sources, a file each, by name."""
    return paths.COMPILED / arch / id_of(arch)


def compiled(arch: str, made: Apart, told: Callable[[str], str] = str) -> dict[str, bytes]:
    """Compile each module. told: returns the file name for tracebacks, from the module name."""
    try:
        code = {
            name: compilers.compiled(told(name), text, arch) for name, text in made.texts.items()
        }
        for name in made.pieces:
            code[name] = kernel_module.with_code(code[name], name, made, arch)
    except compilers.CompilerError as error:
        raise BuildError(str(error)) from error
    return code


def compile_all(arch: str, board: ModuleType | None = None) -> Build:
    """Compile every module, or those a board needs. Without compilers they come from the package.

    Raises BuildError if the package does not have them either.
    """
    whole = firmware(arch)
    wanted = _reached(prepared(arch).texts, board) if board else whole
    files = {path_of(name): whole[name] for name in wanted}
    files[START] = _text(START).encode()
    return Build(arch, files, id=id_of(arch))


def for_board(file: Path) -> Build:
    """Return all files for the board of that board file. Raises BoardFileError before it
    compiles."""
    board: Any = load_for_build(file)
    made = compile_all(board.MPY_ARCH, board)
    made.engine = board.ENGINE
    own = {BOARD: file.read_bytes()}
    own |= {f"{name}.py": file.with_name(f"{name}.py").read_bytes() for name in own_modules(board)}
    own |= page_files.made() if getattr(board, "PAGE", False) else {}
    own |= hal_texts.made(board)
    made.files |= own
    made.own = tuple(own)
    return made


def signature(made: Build) -> int:
    """Return version and processor of the compiled code, encoded as in the board's
    sys.implementation._mpy.

    Most files run on every processor; the result is from a file with native code.
    """
    heads = (content[:4] for path, content in made.files.items() if path.endswith(".mpy"))
    return max(head[1] | head[2] << 8 for head in heads)


def digest(content: bytes) -> str:
    """Return a hash of a file's content; it differs for different contents."""
    return hashlib.sha256(content).hexdigest()
