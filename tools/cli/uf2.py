"""The command `ugrbl uf2`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from .. import paths
from ..boardfile.files import board_file, load_for_build
from ..compiling import build
from ..compiling.build import START, BuildError
from ..grbl.settings_file import SettingsError, read_settings
from ..image import contents
from ..image.contents import MicroPython
from ..image.uf2 import Uf2Error
from .custom import judge
from .custom_options import CustomFile, around
from .outputs import check_output, examples, failed
from .screen import show_zeros, summary

EXAMPLES = examples(
    "ugrbl uf2 --board rpi_pico --micropython RPI_PICO-20260406-v1.28.0.uf2",
    "ugrbl uf2 --board my_router.py --micropython RPI_PICO.uf2 -o router.uf2",
)
_DOWNLOAD = "micropython.org/download has it for each board, as a .uf2 file"
_STAYS = (
    " Files on the board stay; so does deployed firmware, which takes priority over what is"
    " frozen: `ugrbl deploy` removes it."
)
_DRIVES = {"RP2040": "RPI-RP2", "RP2350": "RP2350"}
Out = Annotated[
    Path | None,
    typer.Option("--out", "-o", metavar="FILE", help="File to write. [default: build/BOARD.uf2]"),
]


def command(
    board: Annotated[
        str,
        typer.Option(metavar="NAME", help="Board: a file of boards/, or a path: my_router.py."),
    ],
    micropython: Annotated[
        Path,
        typer.Option(metavar="FILE", readable=False, help=f"MicroPython image: {_DOWNLOAD}."),
    ],
    settings: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            readable=False,
            help="A settings file, as `ugrbl settings pull` writes it.",
        ),
    ] = None,
    custom: CustomFile = None,
    keep: Annotated[
        bool,
        typer.Option("--keep", help="Leave out the file system: the board keeps its files."),
    ] = False,
    out: Out = None,
) -> None:
    """Make one file to be dragged onto an RP2040 or RP2350 board.

    It contains MicroPython, the firmware, the board file, and, if given, settings
    and your own Python. The board needs nothing before, and starts from scratch:
    settings and files stored on it are lost. Later, `ugrbl deploy` updates it
    without touching those.

    A file made with --keep does not touch them either. It needs a MicroPython
    that has this firmware frozen in (docs/boards.md), and contains nothing else.
    """
    console = Console()
    file = out or Path("build") / f"{Path(board).stem}.uf2"
    try:
        check_output(file, given=locals())
        if file.suffix.lower() != ".uf2":
            raise Uf2Error(f"{file}: the name of an image for a board must end in .uf2")
        micropython_image = contents.read(micropython)
        described = load_for_build(board_file(board))
        contents.check_fit(micropython_image, described.MPY_ARCH, described.ENGINE)
        if keep:
            _check_nothing_else(settings or custom)
        own = _own(console, board, settings, custom)
        compiled = build.for_board(board_file(board))
        files: dict[str, bytes] = {}
        if keep:
            data = contents.frozen_only(micropython_image, compiled)
        else:
            files = contents.files(compiled, own, micropython_image.frozen)
            data = contents.join(micropython_image, files)
        paths.write(file, data)
    except (BuildError, ValueError, SettingsError, OSError) as error:
        raise failed(error) from error
    _show(console, file, micropython_image, files)


def _check_nothing_else(wanted: Path | None) -> None:
    if wanted:
        raise Uf2Error(f"{wanted} cannot be added with --keep: the board keeps its files")


def _own(
    console: Console, board: str, settings: Path | None, custom: Path | None
) -> dict[str, bytes]:
    """Return the files of the user's settings and Python by their paths on the board. Ends the
    command if the Python fails its check."""
    settings_files = contents.settings_files(board, settings) if settings else {}
    if settings:
        show_zeros(console, read_settings(settings).lines())
    if custom is None:
        return settings_files
    surroundings = around(board, custom, None)
    if not judge(console, board, surroundings).is_good:
        raise failed("no file was written")
    assert surroundings.custom
    return {**surroundings.custom.files, **settings_files}


def _show(console: Console, file: Path, micropython: MicroPython, files: dict[str, bytes]) -> None:
    """Show what the file has, and what to do with it. files: those that it puts on the board."""
    about, chip = micropython.about, micropython.chip
    size = sum(map(len, files.values()))
    console.print(
        summary(
            [
                ("file", f"{file}, {file.stat().st_size // 1024} kB"),
                ("MicroPython", f"{about.version}, for {chip}"),
                *_frozen(micropython, files),
                ("files", f"{len(files)}, {size} bytes of {about.size}" if files else "none"),
            ]
        )
    )
    warning = " All files stored on the board are lost." if files else _STAYS
    todo = f"Hold BOOTSEL while you plug the board in, and drag the file onto {_DRIVES[chip]}."
    console.print(
        todo + warning,
        highlight=False,
        soft_wrap=True,
    )


def _frozen(micropython: MicroPython, files: dict[str, bytes]) -> list[tuple[str, str]]:
    """Return a row that says which firmware runs, if one is frozen."""
    if not (frozen := micropython.frozen):
        return []
    # With a main.py among its files, a board runs those instead.
    which = "; files on the board take priority" if START in files else ", which runs"
    return [("frozen", f"build {frozen}{which}")]
