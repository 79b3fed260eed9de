"""The content of one file for a board: MicroPython, and the file system as after a deployment."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from ..boardfile import chips
from ..compiling import freeze
from ..compiling.build import Build
from ..device.checkup import NEW_MICROPYTHON, release, too_old
from ..device.deploy import LIST, SAVED, listing
from ..paths import use_firmware
from ..run.machine import kept_settings
from . import binary_info, file_system, uf2
from .binary_info import About
from .uf2 import Flash, Uf2Error


class MicroPython(NamedTuple):
    """A MicroPython in a file."""

    file: Path
    flash: Flash
    about: About

    @property
    def chip(self) -> str:
        """Return the chip it is for."""
        return uf2.CHIPS[self.flash.family]

    @property
    def frozen(self) -> str:
        """Return the id of our firmware, if it is frozen into it, or ""."""
        program = self.flash.read(self.flash.start, self.flash.end - self.flash.start)
        return freeze.read(program.decode("latin-1"))


def read(file: Path) -> MicroPython:
    """Read a file. Uf2Error, with its name, if it is not a MicroPython; OSError."""
    try:
        flash = uf2.read(file.read_bytes())
        return MicroPython(file, flash, binary_info.about(flash))
    except Uf2Error as error:
        raise Uf2Error(f"{file}: {error}") from error


def check_fit(micropython: MicroPython, arch: str, engine: str) -> None:
    """Raise Uf2Error if a board with this architecture and engine cannot run with it."""
    if why := _misfit(micropython, arch, engine):
        raise Uf2Error(f"{micropython.file}: {why}")


def _misfit(micropython: MicroPython, arch: str, engine: str) -> str:
    """Return why a board file with this architecture (armv6m, …) and engine cannot be used with
    this MicroPython; "" if it can."""
    chip, version = micropython.chip, micropython.about.version
    wanted = chips.processors(arch)
    if chip not in wanted:
        return f"it is for {chip}; the board file is for {' or '.join(wanted)}"
    if len(release(version)) < 2:
        return f"it does not contain its version number: {NEW_MICROPYTHON}"
    why = too_old(engine, chip, version)
    return f"{why}: {NEW_MICROPYTHON}" if why else ""


def frozen_only(micropython: MicroPython, build: Build) -> bytes:
    """Return MicroPython unchanged, as a UF2 file. Uf2Error if the firmware of this build is not
    frozen into it."""
    if why := _wrong_frozen(micropython.frozen, build):
        raise Uf2Error(f"{micropython.file}: {why}")
    return uf2.write(micropython.flash)


def _wrong_frozen(frozen: str, build: Build) -> str:
    """Return why the frozen firmware (its id) is not that of this build; "" if it is."""
    if not frozen:
        return (
            "the firmware is not frozen into it, so it would be written where settings are kept: "
            "update the board with `ugrbl deploy`, which keeps them; docs/boards.md tells how to "
            "freeze the firmware"
        )
    if frozen == build.id:
        return ""
    return (
        f"build {frozen} is frozen into it, but this computer has build {build.id}: "
        "build MicroPython again, with this firmware"
    )


def files(build: Build, own: Mapping[str, bytes], frozen: str = "") -> dict[str, bytes]:
    """Return the files by path. own: the user's. frozen: id of the firmware in its MicroPython."""
    rest = freeze.not_frozen(build, frozen)
    return {**rest.files, LIST: listing(rest), **own}


def join(micropython: MicroPython, files: Mapping[str, bytes]) -> bytes:
    """Return MicroPython with a file system that has these files, by path, as a UF2 file. Uf2Error
    if they do not fit."""
    _, flash, about = micropython
    whole = Flash(flash.family, dict(flash.pages), flash.others)  # a copy
    for offset, sector in file_system.make(files, about.size).items():
        whole.put(about.start + offset, sector)
    return uf2.write(whole)


def settings_files(board: str, settings: Path) -> dict[str, bytes]:
    """Return the files in which the board's own store keeps these settings, by path. settings: a
    file of `ugrbl settings pull`. SettingsError if the machine would refuse them."""
    name, lines = kept_settings(board, settings)
    use_firmware()
    from ports.storage.flash_store import FlashStore

    with tempfile.TemporaryDirectory() as folder:
        FlashStore(f"{folder}/").save(name, lines)
        return {f"{SAVED}/{path.name}": path.read_bytes() for path in Path(folder).iterdir()}
