"""Tests on an emulated Pico want MicroPython's image for it: UGRBL_UF2 says where that is."""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

# What compile_emulator.py has made is three times as fast.
_COMPILED = Path(sys.prefix) / "emulator"
_IS_COMPILED = (_COMPILED / "rp2040py").is_dir()
if _IS_COMPILED:
    sys.path.insert(0, str(_COMPILED))

_HAS_EMULATOR = find_spec("rp2040py") is not None


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """These run when asked for by name (`make test-emulator`), and cannot even be imported
    without the emulator."""
    asked = any("emulator" in argument for argument in config.args)
    return None if asked and _HAS_EMULATOR else True


def pytest_report_header() -> str:
    """Why there is nothing to see, or why it takes so long."""
    if not _HAS_EMULATOR:
        return "emulated Pico: left out, rp2040py is not installed"
    return "" if _IS_COMPILED else "emulated Pico: slow; `make compiled-emulator` makes it faster"


def pytest_collection_modifyitems(items: "list[pytest.Item]") -> None:
    """A second of the board's takes a minute here, and some tests want many."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.timeout(0))


@pytest.fixture(scope="session")
def uf2() -> Path:
    """MicroPython for the Pico."""
    named = os.environ.get("UGRBL_UF2", "")
    if not named:
        pytest.skip(
            "UGRBL_UF2 names no image: RPI_PICO-….uf2 of micropython.org/download/RPI_PICO"
        )
    if not Path(named).is_file():
        pytest.skip(f"UGRBL_UF2: there is no file {named}")
    return Path(named)
