"""The firmware as boards get it, in a folder where simulator and tests find it.

The sources of all modules go through the first pass. Simulator and tests, which use the firmware's
constants, are copied and get the constants inlined, too. For MicroPython the files are also
compiled by mpy-cross, as for a board; only the processor is this computer's.
"""

import shutil
from collections.abc import Callable
from pathlib import Path

from ugrbl import paths
from ugrbl.compiling import build
from ugrbl.compiling.build import Build
from ugrbl.compiling.folder import save
from ugrbl.compiling.inline import inline
from ugrbl.compiling.kernel_module import Apart

# This computer's processor, as MicroPython names it.
ARCH = "x64"
_ROOT = Path(__file__).resolve().parents[2]
# Tests run against prepared sources, and their imports.
_TESTS = (
    "conftest.py",
    *(f"support/{name}.py" for name in ("rings", "laws", "rig_bench")),
    *(f"whole/{name}.py" for name in ("test_laws", "test_torture")),
)
_DATA = ("boards", "tools")
# CPython has no const(); MicroPython's compiler handles it.
_CONST = "import builtins\nbuiltins.const = lambda value: value\n"

# Writes a tree of sources under root.
Compile = Callable[[Path, dict[str, str]], None]


def write_sources(root: Path, made: "dict[str, str]") -> None:
    """Write the firmware as CPython can run it."""
    for source in build.sources():
        file = root / "firmware" / source
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(made[build.module(source)], "utf-8")


def write_compiled(root: Path, made: "dict[str, str]") -> None:
    """Write the firmware as MicroPython on this computer runs it: only the processor differs."""
    code = build.compiled(ARCH, Apart(made, "", {}))
    files = {build.path_of(name): content for name, content in code.items()}
    files[build.START] = made[build.module(build.START)].encode()
    save(Build(ARCH, files), root / "firmware")


def write_tree(root: Path, made: "dict[str, str]", write: Compile) -> Path:
    """Write everything that simulator and tests need under root. Return the simulator's
    program."""
    write(root, made)
    for folder in _DATA:
        shutil.copytree(
            _ROOT / folder, root / folder, ignore=shutil.ignore_patterns("__pycache__")
        )
    for name, text in guests().items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text, "utf-8")
    (root / "site").mkdir()
    (root / "site" / "ugrbl").symlink_to(root / "tools")
    (root / "site" / "sitecustomize.py").write_text(_CONST)
    return root / "tools" / "sim" / "replay_main.py"


def guests() -> "dict[str, str]":
    """Return simulator and tests by path, with the firmware's constants inlined."""
    files = [*(paths.TOOLS / "sim").glob("*.py"), *(_ROOT / "host_tests" / t for t in _TESTS)]
    texts = {str(file.relative_to(_ROOT)): file.read_text("utf-8") for file in files}
    placed = inline({**build.texts(), **texts})
    return {name: placed[name] for name in texts}
