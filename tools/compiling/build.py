"""Firmware for one board: the modules it needs, compiled.

The firmware is compiled once per processor, each module into its own file. A board gets only the
modules it needs.
"""

import ast
import hashlib
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
_CREATORS = ("boot.parts", "boot.parts_esp")
# Modules that are on a board only if one of these options has this value; True stands for any true
# value. Every other module is on a board if a module there imports it. Imports inside the
# functions of _CREATORS count only for the board's own engine and link.
_SWITCHED: dict[str, tuple[tuple[str, ...], object]] = {
    "motion.kinematics": (("BACKLASH", "COREXY", "MOTORS", "MOVES", "SKEW"), True),
    "ports.storage.job_files": (("JOBS",), True),
    "ports.storage.sd_card": (("SD_CARD",), True),
    "ports.driver_wire": (("TMC2209",), True),
    "ports.power_input": (("POWER_FAIL",), True),
    "ports.net.page_link": (("PAGE",), True),
    "pio.beam": (("TOOL",), "laser"),
}
# The placeholder for the id in base/errors.py; compiled firmware has its own id here.
_OF_SOURCES = '"--------"'
_DIGITS = 8
# The module whose constant says that the chip may be an RP2350.
_LAYOUT = "pio.state_layout"
_CHIP = "RP2350"
_CHIP_LINE = f"\n{_CHIP} = const(1)\n"


class BuildError(Exception):
    """The build is not possible, for this reason."""


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
    result = dict(sources)
    if _CHIP not in processors(arch):
        if result[_LAYOUT].count(_CHIP_LINE) != 1:
            raise ValueError(f"{_LAYOUT} lacks the line {_CHIP_LINE.strip()}, or has it twice")
        result[_LAYOUT] = result[_LAYOUT].replace(_CHIP_LINE, f"\n{_CHIP} = const(0)\n")
    return result


def id_of(arch: str) -> str:
    """Return the id of this firmware. It depends on the sources and the processor, not on what the
    passes make of them."""
    return _id(for_chip(texts(), arch))


def in_place(arch: str, more: Mapping[str, str] = MappingProxyType({})) -> dict[str, str]:
    """Return the modules for a processor, by name, with constants inlined (inline.py) and the
    firmware's id in base/errors.py.

    more: modules that are not the firmware's, by name.
    """
    return _inlined_with_id({**for_chip(texts(), arch), **more})


def prepared(arch: str) -> Apart:
    """Return the modules as they are compiled. Where LLVM compiles kernels for the processor, they
    are taken out of the modules, and the result has them as C text."""
    texts = in_place(arch)
    if arch not in compilers.PROCESSORS:
        return Apart(texts, c="", pieces={})
    on_every_board = _needed_modules(texts, _plain_board(arch))
    return _taken_apart(texts, on_every_board)


def _id(written: dict[str, str]) -> str:
    return hashlib.sha256(repr(written).encode()).hexdigest()[:_DIGITS]


@cached
def _inlined_with_id(written: dict[str, str]) -> dict[str, str]:
    stamped = f'"{_id(written)}"'
    return {name: text.replace(_OF_SOURCES, stamped) for name, text in inline(written).items()}


_taken_apart = cached(kernel_module.taken_apart)


# Modules that a board needs


def modules_of(board: ModuleType) -> list[str]:
    """Return the names of the modules that a board needs."""
    return _needed_modules(in_place(getattr(board, "MPY_ARCH", "")), board)


def _plain_board(arch: str) -> ModuleType:
    """Return a board with only the options that every board with that processor has."""
    chip = next(chip for chip in CHIPS.values() if chip.mpy_arch == arch)
    board = ModuleType("board")
    vars(board).update(ENGINE=chip.engine, LINK=chip.link, CUSTOM="")
    return board


def _needed_modules(texts: Mapping[str, str], board: ModuleType) -> list[str]:
    """Return the names of the modules that a board needs: main, its extras, and all modules that
    these import, directly or by another one. texts: of all modules, by name."""
    extras = _extras(board)
    allowed = {name: text for name, text in texts.items() if not _is_switched_off(board, name)}
    if not extras:
        allowed.pop("extras.api", None)  # nothing uses it
    unused = _unused_engines_and_links(board)
    return sorted(imported_by(allowed, [module(START), *extras], unused))


def of_other_chips(texts: Mapping[str, str], arch: str) -> set[str]:
    """Return the names of modules that only engines of chips with another processor import.
    texts: of all modules, by name."""
    here = processors(arch)
    other_engines = {
        name
        for name, engine in engines.engines().items()
        if not any(engine.runs_on(processor) for processor in here)
    }
    extras = [name for name in texts if name.startswith("extras.")]
    roots = [module(START), *extras]
    with_all_engines = imported_by(texts, roots, ())
    return with_all_engines - imported_by(texts, roots, other_engines)


def imported_by(
    texts: Mapping[str, str],
    roots: Iterable[str],
    unused: Collection[str],
    creators: Collection[str] = _CREATORS,
) -> set[str]:
    """Return the names of the modules `roots` and of all that they import, directly or by another
    one.

    texts: of all modules, by name. unused: engines and links; imports inside the functions with
    these names are left out, in the modules `creators`, which create engines and links.
    """
    found: set[str] = set()
    to_visit = list(roots)
    while to_visit:
        name = to_visit.pop()
        if name in texts and name not in found:  # else it is MicroPython's, or a name in a module
            found.add(name)
            skipped = frozenset(unused if name in creators else ())
            to_visit += imported(texts[name], skipped)
    return found


def _is_switched_off(board: ModuleType, name: str) -> bool:
    """Return whether no option of the board has the value that this module needs (_SWITCHED)."""
    asking, wanted = _SWITCHED.get(name, ((), None))
    values = [getattr(board, option, None) for option in asking]
    found = [_is_given(value) if wanted is True else value for value in values]
    return name in _SWITCHED and wanted not in found


def _is_given(value: object) -> bool:
    """Return whether an option's value selects something; pin 0 does."""
    return bool(value) or type(value) is int


def _extras(board: ModuleType) -> list[str]:
    """Return the names of the extras' modules that a board's options select."""
    paths.use_firmware()
    from boot import select_extras

    custom = getattr(board, "CUSTOM", options.BY_NAME["CUSTOM"].default)
    return select_extras.extra_names(board, bool(custom))


def _unused_engines_and_links(board: ModuleType) -> set[str]:
    """Return the engines and links that this board does not use."""
    link = getattr(board, "LINK", options.BY_NAME["LINK"].default)
    return {*engines.engines(), *engines.links()} - {board.ENGINE, link}


@lru_cache(400)
def imported(text: str, without: frozenset[str] = frozenset()) -> tuple[str, ...]:
    """Return the names that a text imports and that may be modules. Imports for type checking
    only, and imports inside the functions `without`, are left out."""
    return tuple(_imported(ast.parse(text), without))


def _imported(node: ast.AST, without: Collection[str]) -> Iterator[str]:
    """Yield the names that a node of the syntax tree imports, as imported() does."""
    if isinstance(node, ast.FunctionDef) and node.name in without:
        return
    condition = ast.unparse(node.test) if isinstance(node, ast.If) else ""
    if condition == "False" or condition.endswith("TYPE_CHECKING"):  # "False": inlined
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
    BuildError if it does not have them either."""
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


def compiled(
    arch: str, apart: Apart, traceback_name: Callable[[str], str] = str
) -> dict[str, bytes]:
    """Compile each module, and put the kernels' machine code into the modules of kernels.

    traceback_name: returns the file name that tracebacks show, from the module name.
    """
    try:
        code = {
            name: compilers.compiled(traceback_name(name), text, arch)
            for name, text in apart.texts.items()
        }
        for name in apart.pieces:
            code[name] = kernel_module.with_code(code[name], name, apart, arch)
    except compilers.CompilerError as error:
        raise BuildError(str(error)) from error
    return code


def compile_all(arch: str, board: ModuleType | None = None) -> Build:
    """Compile every module, or those a board needs. Without compilers they come from the package.

    Raises BuildError if the package does not have them either.
    """
    all_modules = firmware(arch)
    wanted = _needed_modules(prepared(arch).texts, board) if board else all_modules
    files = {path_of(name): all_modules[name] for name in wanted}
    files[START] = _text(START).encode()  # as source text: MicroPython runs no main.mpy
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
