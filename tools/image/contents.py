"""What one file for a board holds: MicroPython, and the file system as a deployment leaves it."""

import re
import tempfile
from collections.abc import Mapping
from pathlib import Path

from ..boardfile import chips
from ..compiling.build import Build
from ..device.checkup import NEW_MICROPYTHON, too_old
from ..device.deploy import LIST, listing
from ..paths import use_firmware
from ..run.machine import kept_settings
from . import binary_info, file_system, uf2
from .binary_info import About
from .uf2 import Flash, Uf2Error

# Compiled modules of the kind that mpy-cross makes are read from here on.
_OLDEST = (1, 23)


def read(file: Path) -> Flash:
    """The flash of a file. Uf2Error, with its name, where it is none; OSError."""
    try:
        return uf2.read(file.read_bytes())
    except Uf2Error as error:
        raise Uf2Error(f"{file}: {error}") from error


def micropython(flash: Flash, made: Build) -> About:
    """What the MicroPython says of itself. Uf2Error where the board cannot run with it."""
    chip = uf2.CHIPS[flash.family]
    wanted = chips.processors(made.arch)
    if chip not in wanted:
        raise Uf2Error(f"it is for {chip}; the board file is for {' or '.join(wanted)}")
    about = binary_info.about(flash)
    numbers = tuple(int(number) for number in re.findall(r"\d+", about.version)[:2])
    if numbers < _OLDEST:
        raise Uf2Error(f"MicroPython {about.version} is too old: {NEW_MICROPYTHON}")
    if why := too_old(made.engine, chip, about.version):
        raise Uf2Error(f"{why}: {NEW_MICROPYTHON}")
    return about


def files(
    made: Build, board: str, settings: Path | None, custom: Mapping[str, bytes]
) -> dict[str, bytes]:
    """The file system, by path. SettingsError where the machine would not take them."""
    found = {**made.files, **custom, LIST: listing(made)}
    if settings:
        name, lines = kept_settings(board, settings)
        found.update(_as_kept(name, lines))
    return found


def join(flash: Flash, about: About, files: Mapping[str, bytes]) -> bytes:
    """MicroPython with that file system, as a UF2 file. Uf2Error where it does not fit."""
    whole = Flash(flash.family, dict(flash.pages), flash.others)
    for place, sector in file_system.make(files, about.size).items():
        whole.put(about.start + place, sector)
    return uf2.write(whole)


def _as_kept(name: str, lines: list[str]) -> dict[str, bytes]:
    """Files as the board's own store writes them."""
    use_firmware()
    from ports.flash_store import FlashStore

    with tempfile.TemporaryDirectory() as folder:
        FlashStore(f"{folder}/").save(name, lines)
        return {path.name: path.read_bytes() for path in Path(folder).iterdir()}
