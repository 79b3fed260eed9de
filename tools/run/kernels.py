"""Kernels compiled on this computer, if it has a C compiler: stored, and used by the simulator.

The C text (native.py) follows from the sources, and so does the file name of its library in the
user's folder, so a library is never out of date. If the library cannot be made, the stand-in for
`micropython` runs the same functions as Python.
"""

import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import typer

from .. import paths
from ..compiling import build, c_text
from . import native

_FLAGS = ("-O2", "-fwrapv", "-fPIC", "-shared", "-w")
_ON_A_MAC = ("-Wl,-undefined,dynamic_lookup",)  # these are functions of Python itself
_TRANSLATOR = ("run/native", "compiling/c_text", "compiling/viper", "compiling/inline")
_PATIENCE_S = 120
_MOST_LIBRARIES = 10  # of 80 kB each
_MOST_KEPT = 1000

# A kernel that is on no board.
_OURS = f"{native.OURS}.sim.check_kernel"

Kernel = Callable[..., int]


def use() -> None:
    """Make later imports of firmware modules use compiled kernels.

    If UGRBL_VIPER is in the environment, they stay Python.
    """
    if "UGRBL_VIPER" in os.environ:
        return
    import micropython

    try:
        library = find()
        found = _bound(library) if library else {}
    except OSError:  # the folder is not writable, or the library cannot be loaded from there
        found = {}
    micropython.compiled = lambda module, name: found.get((module, name))


def find() -> Path | None:
    """Return the library of the kernels; make it if necessary. None if that is not possible."""
    compiler = shlex.split(os.environ.get("CC", "cc"))
    if os.name != "posix" or not compiler:
        return None
    library = _folder() / f"{_digest(compiler)}.so"
    failure_log = library.with_suffix(".log")
    if not library.exists() and not failure_log.exists() and shutil.which(compiler[0]):
        library.parent.mkdir(parents=True, exist_ok=True)
        if why := _make(compiler, library):
            failure_log.write_text(why, encoding="utf-8")  # so that it is not tried again
        _tidy(library.parent)
    return library if library.exists() else None


def _folder() -> Path:
    """Return this user's folder, or the one that UGRBL_KERNELS in the environment names."""
    return Path(os.environ.get("UGRBL_KERNELS") or Path(typer.get_app_dir("ugrbl")) / "kernels")


def _tidy(folder: Path) -> None:
    """Remove the oldest libraries."""
    files = sorted(folder.glob("*.*"), key=lambda file: file.stat().st_mtime)
    for old in files[:-_MOST_LIBRARIES]:
        old.unlink(missing_ok=True)


def _digest(compiler: list[str]) -> str:
    """Return the library's name: a digest of all that its content depends on."""
    digest = hashlib.sha256(f"{compiler} {_FLAGS} {platform.machine()} {sys.version}".encode())
    for name in _TRANSLATOR:
        digest.update((paths.TOOLS / f"{name}.py").read_bytes())
    for source in build.sources():
        digest.update((paths.FIRMWARE / source).read_bytes())
    digest.update(_ours().read_bytes())  # the simulator's own kernels
    return digest.hexdigest()[:16]


def _ours() -> Path:
    return paths.TOOLS.joinpath(*_OURS.split(".")[1:]).with_suffix(".py")


def _make(compiler: list[str], library: Path) -> str:
    """Compile the library. Returns "" or the cause of the failure."""
    with TemporaryDirectory(dir=library.parent) as folder:
        source, made = Path(folder, "kernels.c"), Path(folder, "kernels.so")
        try:
            texts = {**build.texts(), _OURS: _ours().read_text(encoding="utf-8")}
            source.write_text(native.in_c(texts), encoding="utf-8")
        except c_text.NotForC as form:
            return f"the translator does not know {form}\n"
        flags = (*_FLAGS, *(_ON_A_MAC if sys.platform == "darwin" else ()))
        command = [*compiler, *flags, "-o", str(made), str(source)]
        try:
            done = subprocess.run(command, capture_output=True, timeout=_PATIENCE_S, check=False)
        except (OSError, subprocess.SubprocessError) as error:
            return f"{shlex.join(command)}\n{error}\n"
        if done.returncode or not made.exists():
            return f"{shlex.join(command)}\n{done.stderr.decode(errors='replace')}"
        made.replace(library)  # at once, because others may look for it
        return ""


@lru_cache(1)
def _bound(library: Path) -> dict[tuple[str, str], Kernel]:
    """Return the kernels, by module and name, as Python callables."""
    # PyDLL keeps Python's lock, and raises the exception that a kernel has set.
    handle = ctypes.PyDLL(str(library))
    table = ctypes.string_at(ctypes.addressof(ctypes.c_char.in_dll(handle, "kernels"))).decode()
    found = {}
    for line in table.splitlines():
        module, name, *types = line.split()
        function = getattr(handle, f"use_{c_text.c_name(module, name)}")
        found[module, name] = _kernel(function, types)
    return found


class _Memory(ctypes.Structure):
    """A pointer in the C text."""

    _fields_ = (("at", ctypes.c_void_p), ("length", ctypes.c_int64))


class _Pointer:
    """Converts buffers to pointers to items of `size` bytes.

    known: the address of a buffer's _Memory, by the buffer's id. It has only buffers that are kept
    alive, because another object may get the id of a freed one.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self.known: dict[int, int] = {}
        self._kept: list[object] = []
        self._kept_before: list[object] = []

    def __call__(self, memory: Any) -> Any:
        """Return a buffer that is not in `known` as an argument of a C function, and add it to
        `known`, unless it is a memoryview that micropython.kept_views does not hold."""
        from micropython import kept_views

        bytes_long = memoryview(memory).nbytes
        try:
            start = ctypes.c_char.from_buffer(memory)
        except TypeError:  # read-only memory: a copy serves as well
            start = ctypes.c_char.from_buffer(bytearray(memory))
        pointer = _Memory(ctypes.addressof(start), bytes_long // self._size)
        pointer.start = start  # keeps the buffer alive; a copy has no other reference
        if not isinstance(memory, memoryview) or kept_views.get(id(memory)) is memory:
            if len(self._kept) >= _MOST_KEPT:
                # Not freed yet: another argument of this call may be one of them.
                self._kept_before, self._kept = self._kept, []
                self.known.clear()
            self._kept.append((memory, start, pointer))
            self.known[id(memory)] = ctypes.addressof(pointer)
        return ctypes.byref(pointer)


_POINTERS = {"ptr8": _Pointer(1), "ptr16": _Pointer(2), "ptr32": _Pointer(4)}
_TYPES = {"object": ctypes.py_object, **dict.fromkeys(_POINTERS, ctypes.c_void_p)}


def _kernel(function: Any, types: list[str]) -> Kernel:
    """Return the callable for Python. It converts buffers to pointers. types: of the parameters.

    For `a0: ptr32, a1: int` it is, without a loop because it is called very often:
    lambda a0, a1: function(known_ptr32(id(a0)) or ptr32(a0), a1)
    """
    function.restype = ctypes.c_int64
    function.argtypes = [_TYPES.get(type, ctypes.c_int64) for type in types]
    names = [f"a{i}" for i in range(len(types))]
    arguments = ", ".join(
        f"known_{type}(id({name})) or {type}({name})" if type in _POINTERS else name
        for name, type in zip(names, types, strict=True)
    )
    helpers: dict[str, Any] = {"function": function, "id": id, **_POINTERS}
    helpers.update({f"known_{type}": pointer.known.get for type, pointer in _POINTERS.items()})
    text = f"lambda {', '.join(helpers)}: lambda {', '.join(names)}: function({arguments})"
    made: Kernel = eval(text)(**helpers)
    return made
