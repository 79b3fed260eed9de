"""The command `ugrbl build`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from ..boardfile.board_check import notes
from ..boardfile.files import board_file, load_for_build
from ..compiling import build, freeze, motion_package
from ..compiling.build import Build, BuildError
from ..compiling.folder import PACKAGE_LIST, save
from ..device.deploy import ARCHS
from ..run import stubs
from .outputs import check_outputs, examples, save_json, words

EXAMPLES = examples(
    "ugrbl build --board rpi_pico",
    "ugrbl build --arch armv7emsp --json -",
)
_ARCH = "armv6m"
_FOLDER = Path("build")
Out = Annotated[
    Path | None,
    typer.Option(
        "--out",
        "-o",
        metavar="FOLDER",
        help="Folder to write. [default: build/BOARD or build/ARCH]",
    ),
]


def command(
    board: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Board: a file of boards/, or a path."),
    ] = None,
    arch: Annotated[
        str, typer.Option(metavar="ARCH", help="Processor, if no board is given.")
    ] = _ARCH,
    out: Out = None,
    frozen: Annotated[
        bool,
        typer.Option(
            "--frozen", help="Build all modules, for manifest.py to freeze: build/frozen/."
        ),
    ] = False,
    motion: Annotated[
        bool,
        typer.Option("--motion", help="Build the package ugrbl_motion: build/motion/."),
    ] = False,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the sizes to this file; - is stdout."),
    ] = None,
) -> None:
    """Compile the firmware for a board; show each module's bytes.

    With --board it compiles what `ugrbl deploy` would put on that board; without it, all modules.
    manifest.py uses --frozen when MicroPython is built with this firmware, for every board of this
    chip. --motion compiles ugrbl_motion instead, the engine without G-code.

    The board file is checked first, and nothing is built for a bad one: every problem has a line,
    and the exit code is 1.
    """
    console = Console(stderr=str(json_file) == "-")

    kind = "frozen" if frozen else "motion" if motion else ""
    folder = out or _FOLDER / kind / (Path(board).stem if board else arch)
    try:
        _check(folder, is_named=out is not None)
        described = load_for_build(board_file(board)) if board else None
        check_outputs(json_file, folder / "main.mpy", given=locals())
        made = _make(board, getattr(described, "MPY_ARCH", arch), kind)
        save(made, folder, for_mip=not frozen)
        if motion:
            stubs.save(stubs.motion(), folder)
    except (BuildError, OSError, ValueError) as error:
        raise failed(error) from error
    for name, content in sorted(made.files.items()):
        console.print(f"{len(content):7} {name}", highlight=False)
    for text in notes(described) if described else ():
        console.print(f"[yellow]note[/]: {escape(text)}", highlight=False, soft_wrap=True)
    text = f"{made.bytes:7} bytes in all, in {folder}; build {made.id}"
    console.print(text, highlight=False, soft_wrap=True)
    if json_file:
        sizes = {name: len(content) for name, content in made.files.items()}
        save_json({"arch": made.arch, "bytes": made.bytes, "files": sizes}, json_file)


def _check(folder: Path, is_named: bool) -> None:
    """Raise BuildError if this is no folder or, if the user has named it, if a build in it would
    write over other files than a build's."""
    if folder.exists() and not folder.is_dir():
        raise BuildError(f"{folder} is no folder")
    if is_named and folder.exists() and any(folder.iterdir()):
        # A build has one of them: a list for mip, or with --frozen this module.
        in_every_build = (PACKAGE_LIST, "boot/power_up.mpy")
        if not any((folder / name).is_file() for name in in_every_build):
            raise BuildError(f"{folder} has other files: name a new folder, or an empty one")


def _make(board: str | None, arch: str, kind: str) -> Build:
    """Compile the firmware for a board, else for a processor. kind: "frozen", "motion" or "", from
    the options; BuildError if they do not fit."""
    if arch not in ARCHS[1:]:  # the first one is no machine code
        raise BuildError(f"{arch} is no processor: choose one of {', '.join(ARCHS[1:])}")
    if kind == "frozen" and not board:
        raise BuildError("--frozen needs a board: --board NAME")
    if kind == "motion":
        return motion_package.compile_for(arch)
    if not board:
        return build.compile_all(arch)
    compile_for = freeze.for_board if kind == "frozen" else build.for_board
    return compile_for(board_file(board))


def failed(why: Exception) -> typer.Exit:
    """Show a failure on stderr, a problem per line; returns the exception to raise."""
    for line in words(why).splitlines():
        Console(stderr=True).print(f"[red]{escape(line)}", highlight=False, soft_wrap=True)
    return typer.Exit(1)
