"""Where the firmware and its data are: in this folder if installed, else in the checkout.

Also writes files completely or not at all, and says in words why a file is not accessible.
"""

import errno
import os
import shutil
import sys
from pathlib import Path

_HERE = Path(__file__).resolve().parent
_INSTALLED = (_HERE / "firmware").is_dir()
_ROOT = _HERE if _INSTALLED else _HERE.parent

TOOLS = _HERE
FIRMWARE = _ROOT / "firmware"
BOARDS = _ROOT / "boards"
CACHE = None if _INSTALLED else _ROOT / "build" / "cache"  # see compiling/cache.py
EXAMPLES = _ROOT / "examples"
CONVERSATIONS = (_HERE if _INSTALLED else _ROOT / "host_tests") / "conversations"
COMPILED = _HERE / "compiled"  # the compiled firmware, in an installed package only
STANDINS = _HERE / "sim" / "standins"  # stand-ins for modules that only a board has

# Cause and next step by errno.
_WHY = {
    errno.ENOENT: "there is no such file; is it written right?",
    errno.EISDIR: "it is a folder; name a file",
    errno.ENOTDIR: "a folder in its path is a file; is it written right?",
    errno.ENAMETOOLONG: "its name is too long; take a shorter one",
    errno.ELOOP: "its links lead round in a circle; name the file itself",
    errno.EACCES: "permission denied; change its permissions, or name another place",
    errno.EPERM: "permission denied; change its permissions, or name another place",
    errno.EROFS: "the disk is read-only; name another place",
    errno.ENOSPC: "the disk is full; free some space, or name another place",
    errno.EDQUOT: "your quota of the disk is full; free some space, or name another place",
    errno.EIO: "the disk does not answer as it should; is it still connected?",
}


def why(error: OSError) -> str:
    """Return in words why a file operation failed."""
    return _WHY.get(error.errno or 0) or error.strerror or str(error)


def check_writable(file: Path) -> None:
    """Raise OSError, with the text of write(), if the file cannot be written. Leaves no file
    behind."""
    try:
        real = Path(os.path.realpath(file))
        if real.exists() and not os.access(real, os.W_OK):
            raise PermissionError(errno.EACCES, "")
        if real.exists() and not real.is_file():  # a device, a pipe
            return
        folder_above = next(folder for folder in real.parents if folder.exists())
        if not folder_above.is_dir():
            raise NotADirectoryError(f"{folder_above} is no folder")
        trial = _new(folder_above / real.name)
        trial.open("xb").close()
        trial.unlink()
    except OSError as error:
        raise _unwritable(file, error) from error


def write(file: Path, data: bytes) -> None:
    """Replace a file completely, or leave the old one. Missing folders are created. OSError says
    in words why it cannot be written."""
    try:
        if file.exists() and not file.is_file():  # a device, a pipe
            file.write_bytes(data)
        else:
            _replace(Path(os.path.realpath(file)), data)  # a link stays a link
    except OSError as error:
        raise _unwritable(file, error) from error


def _unwritable(file: Path, error: OSError) -> OSError:
    """Return the error with its cause in words."""
    is_missing = error.errno == errno.ENOENT  # ENOENT on writing: in /proc, for example
    words = "no file can be created there; name another place" if is_missing else why(error)
    return OSError(f"{file} cannot be written: {words}")


def _new(file: Path) -> Path:
    """Return the path for the new content until it is complete."""
    return file.with_name(f".{file.name}.{os.getpid()}.new")


def _replace(file: Path, data: bytes) -> None:
    """Write the data to a new file next to it, then rename that over it."""
    file.parent.mkdir(parents=True, exist_ok=True)
    new = _new(file)
    try:
        with new.open("wb") as out:
            out.write(data)
            out.flush()
            os.fsync(out.fileno())
        if file.exists():
            shutil.copymode(file, new)
        new.replace(file)
    finally:
        new.unlink(missing_ok=True)


def use_firmware(fast: bool = True) -> None:
    """Make the firmware importable here. Call it before the first import of a firmware module.

    fast: leave out the checks of viper arithmetic. UGRBL_VIPER in the environment overrules it.
    """
    for folder in (str(FIRMWARE), str(STANDINS)):
        if folder in sys.path:
            sys.path.remove(folder)
        sys.path.insert(0, folder)

    import micropython

    if "UGRBL_VIPER" not in os.environ:
        micropython.VIPER = "fast" if fast else "checked"
