"""The files of a release, except images and wheel: `make release-files VERSION=v0.1.0`.

They are made from the checkout: the page, the firmware of every board as a zip (with the
package.json for `mpremote mip install`), ugrbl_motion for every processor, notes from
CHANGELOG.md, and checksums of all files in the folder, including images and wheel. `make
release-dry` makes them without a tag.
"""

import hashlib
import io
import re
import sys
import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

from .. import __version__, paths
from ..boardfile import page_files
from ..boardfile.chips import ARCHS
from ..boardfile.files import board_file, boards
from ..compiling import build, folder, motion_package
from ..run import stubs

CHECKSUMS = "SHA256SUMS"
UNRELEASED = "Unreleased"
# A zip has the times of its files; a fixed time makes equal files an equal zip.
_FIXED_TIME = (2020, 1, 1, 0, 0, 0)  # of all files, so that the same content is the same zip


class ReleaseError(Exception):
    """The release is not possible; the text has cause and next step."""


def check_version(tag: str) -> None:
    """Raise ReleaseError if a tag is not the package's own version; "" is a dry run."""
    if tag and tag != f"v{__version__}":
        raise ReleaseError(
            f"the tag is {tag} and tools/__init__.py says {__version__}: make them one"
        )


def notes(changelog: str, tag: str) -> str:
    """Return the changelog's section of that version, without its heading; in a dry run (tag ""),
    the unreleased one."""
    wanted = tag.removeprefix("v") or UNRELEASED
    found = re.search(
        rf"^## \[{re.escape(wanted)}\][^\n]*\n(.*?)(?=^## \[|\Z)",
        changelog,
        re.DOTALL | re.MULTILINE,
    )
    if not found or not found[1].strip():
        raise ReleaseError(f"CHANGELOG.md has nothing under [{wanted}]: write its section first")
    return found[1].strip() + "\n"


def board_zip(name: str) -> bytes:
    """Return the compiled firmware of a board as a zip, in a folder of its name."""
    made = build.for_board(board_file(name))
    return _zip(name, lambda place: folder.save(made, place))


def motion_zip(arch: str) -> bytes:
    """Return the package ugrbl_motion for a processor as a zip, in a folder of that name."""
    compiled = motion_package.compile_for(arch)

    def save(place: Path) -> None:
        folder.save(compiled, place)
        stubs.save(stubs.motion(), place)

    return _zip(build.LIBRARY, save)


def _zip(name: str, save: Callable[[Path], None]) -> bytes:
    """Return the files that save() writes into a folder as a zip, in a folder of that name."""
    data = io.BytesIO()
    with TemporaryDirectory() as place, zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as file:
        save(Path(place))
        for path in sorted(path for path in Path(place).rglob("*") if path.is_file()):
            entry = zipfile.ZipInfo(f"{name}/{path.relative_to(place).as_posix()}", _FIXED_TIME)
            entry.compress_type = zipfile.ZIP_DEFLATED
            file.writestr(entry, path.read_bytes())
    return data.getvalue()


def checksums(files: Iterable[Path]) -> str:
    """Return checksums in the format of sha256sum."""
    rows = (f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n" for file in files)
    return "".join(rows)


def make(tag: str, place: Path, names: Iterable[str]) -> None:
    """Write all files of the release into a folder. names: of the boards; tag: "" for a dry run.
    Raises ReleaseError before anything is written."""
    check_version(tag)
    text = notes((paths.BOARDS.parent / "CHANGELOG.md").read_text(encoding="utf-8"), tag)
    paths.write(place / "ugrbl.html", page_files.page().encode())
    for name in names:
        paths.write(place / f"ugrbl-{tag or 'dry'}-{name}.zip", board_zip(name))
    for arch in ARCHS:
        paths.write(place / f"{build.LIBRARY}-{tag or 'dry'}-{arch}.zip", motion_zip(arch))
    files = sorted(file for file in place.iterdir() if file.is_file() and file.name != CHECKSUMS)
    paths.write(place / CHECKSUMS, checksums(files).encode())
    paths.write(place / "notes" / "notes.md", text.encode())


def main() -> None:
    """Run `python -m ugrbl.image.release FOLDER [TAG]`."""
    place, *tags = sys.argv[1:]
    try:
        make("".join(tags), Path(place), [name for name in boards() if not name.startswith("sim")])
    except ReleaseError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
