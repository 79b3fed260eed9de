"""Our stand-ins against the stubs of the MicroPython project's users: no name of our own.

The stubs come from PyPI into ~/.cache/ugrbl-stubs (UGRBL_STUBS names another folder); the tests
are skipped if they are not available.
"""

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

_STANDINS = Path(__file__).parents[2] / "tools" / "sim" / "standins"
_VERSION = "1.28.*"
_CACHE = Path(os.environ.get("UGRBL_STUBS") or Path.home() / ".cache" / "ugrbl-stubs")

# Names that tests and the virtual clock use, and the board's modules do not have.
_OURS = {
    "Pin": {"pins", "without_output", "drive"},
    "PWM": {"outputs"},
    "PCNT": {"units", "pads", "most_units", "lose"},
    "Timer": {"rearm"},
    "I2S": {"open_streams", "open_us", "recording", "run", "flash_write", "fileno", "ioctl"},
    "WDT": {"timeout_ms", "fed"},
    "RMT": {"channels", "available", "block", "first_signal", "flash_write"},
}
_CLASSES = [
    ("esp_machine.py", "machine.pyi", name) for name in ("Pin", "PWM", "Timer", "I2S", "WDT")
]
_CLASSES.append(("esp32.py", "esp32.pyi", "RMT"))
_CLASSES.append(("esp_pcnt.py", "esp32.pyi", "PCNT"))

Names = dict[str, set[str]]  # parameters by method; none for a constant


@pytest.fixture(scope="module")
def stubs() -> Path:
    """Return the folder of the stubs; install them there first if they are missing."""
    if not (_CACHE / "machine.pyi").exists():
        package = f"micropython-esp32-stubs=={_VERSION}"
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps"]
        try:
            process = subprocess.run(
                [*pip, "--target", str(_CACHE), package],
                capture_output=True,
                text=True,
                timeout=120,
                check=False,
            )
        except subprocess.TimeoutExpired:
            pytest.skip(f"{package}: no answer")
        if process.returncode:
            pytest.skip(f"{package}: {process.stderr.strip().splitlines()[-1]}")
    return _CACHE


def names(file: Path, name: str) -> Names:
    """Return the public names of a class in a file, each with its parameters; overloads are
    merged. **: takes any keyword."""
    tree = ast.parse(file.read_text())
    by_name: Names = {}
    node = next(n for n in tree.body if isinstance(n, ast.ClassDef) and n.name == name)
    for item in node.body:
        if isinstance(item, ast.FunctionDef):
            parameters = (*item.args.posonlyargs, *item.args.args, *item.args.kwonlyargs)
            arguments = by_name.setdefault(item.name, set())
            arguments.update(argument.arg for argument in parameters)
            arguments.update(["**"] if item.args.kwarg else [])
        elif isinstance(item, ast.AnnAssign) and isinstance(item.target, ast.Name):
            by_name.setdefault(item.target.id, set())
        elif isinstance(item, ast.Assign):
            targets = (t.elts if isinstance(t, ast.Tuple) else [t] for t in item.targets)
            for target in (one for several in targets for one in several):
                by_name.setdefault(ast.unparse(target), set())
    return {key: value for key, value in by_name.items() if key == "__init__" or key[0] != "_"}


@pytest.mark.parametrize(("module", "stub", "name"), _CLASSES, ids=[name for *_, name in _CLASSES])
def test_a_stand_in_has_only_the_boards_names(
    module: str, stub: str, name: str, stubs: Path
) -> None:
    """Each name and each keyword of a stand-in is in the stubs, apart from the names in _OURS."""
    ours, theirs = names(_STANDINS / module, name), names(stubs / stub, name)
    assert set(ours) - _OURS[name] <= set(theirs)
    for method in set(ours) & set(theirs):
        # Names of positional parameters do not matter.
        positional = {"level", "duty", "function"}
        assert "**" in theirs[method] or ours[method] - positional <= theirs[method], method
