"""The package ugrbl_motion: the engine without G-code, compiled for one processor.

It is made of the firmware's modules, the same texts, as far as firmware/ugrbl_motion imports them.
All of them become modules of that one package, because a program that uses it may have a `motion`
or a `base` of its own. Kernels are machine code in `ugrbl_motion.core`.
"""

import hashlib

from .. import paths
from ..boardfile import engines
from ..boardfile.chips import CHIPS
from . import build, compilers
from .build import LIBRARY, Build
from .inline import moved
from .kernel_module import Apart, taken_apart

_HARDWARE = f"{LIBRARY}.hardware"  # its functions that create engines are named after them


def texts() -> dict[str, str]:
    """Return the source texts of the package's own modules, by name."""
    folder = paths.FIRMWARE / LIBRARY
    found = {path.stem: path.read_text(encoding="utf-8") for path in sorted(folder.glob("*.py"))}
    return {
        LIBRARY if stem == "__init__" else f"{LIBRARY}.{stem}": text
        for stem, text in found.items()
    }


def compile_for(arch: str) -> Build:
    """Return the package's files for a processor. Raises BuildError."""
    apart = _in_one_package(arch)
    modules = build.compiled(arch, apart)
    made = Build(arch, {_path(name): content for name, content in sorted(modules.items())})
    made.id = hashlib.sha256(repr(sorted(made.files.items())).encode()).hexdigest()[:8]
    return made


def _in_one_package(arch: str) -> Apart:
    """Return the modules that the package consists of, kernels apart, with their new names."""
    all_texts = build.in_place(arch, texts())
    engine = next(chip.engine for chip in CHIPS.values() if chip.mpy_arch == arch)
    needed = {name: all_texts[name] for name in sorted(_needed_modules(all_texts, engine))}
    apart = Apart(needed, c="", pieces={})
    if arch in compilers.PROCESSORS:
        apart = taken_apart(needed, needed)  # all kernels go into the core
    left = _needed_modules(apart.texts, engine)  # without modules that were kernels only
    names = {name: _new_name(name) for name in left}
    names |= {name.partition(".")[0]: LIBRARY for name in left}  # for `from motion import …`
    return Apart(
        {names[name]: moved(apart.texts[name], names) for name in left},
        apart.c,
        {names[name]: keys for name, keys in apart.pieces.items()},
    )


def _needed_modules(all_texts: dict[str, str], engine: str) -> set[str]:
    """Return the names of the modules that the package imports, directly or by another one."""
    other_engines = {*engines.engines()} - {engine}
    return build.imported_by(all_texts, texts(), other_engines, creators=(_HARDWARE,))


def _new_name(name: str) -> str:
    """Return the name in the package: `motion.planner` is `ugrbl_motion.planner`."""
    return name if name == LIBRARY else f"{LIBRARY}.{name.rpartition('.')[2]}"


def _path(name: str) -> str:
    return f"{LIBRARY}/{'__init__' if name == LIBRARY else name.rpartition('.')[2]}.mpy"
