"""Set up tests on an emulated board, which need an emulator and MicroPython's image.

See chips.py for the images.
"""

import os
import sys
from importlib.util import find_spec
from pathlib import Path

import pico2
import pytest
import qemu_esp32
from chips import CHIP, CHIPS, NAME

# The output of compile_emulator.py, which is three times as fast.
_COMPILED = Path(sys.prefix) / "emulator"
_IS_COMPILED = (_COMPILED / "rp2040py").is_dir()
if _IS_COMPILED:
    sys.path.insert(0, str(_COMPILED))

_HAS_EMULATOR = find_spec("rp2040py") is not None
# Tests of one chip or of its emulator only.
_OF_ESP32 = "test_esp32_emulated.py"
_OF_RP2040 = (
    *("test_pico_card.py", "test_pico_drivers.py", "test_pico_power.py", "test_pico_speed.py"),
    "test_xip.py",
)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Collect these tests only when named (`make test-emulator`).

    Without the emulator they cannot even be imported.
    """
    asked = any("emulator" in argument for argument in config.args)
    if NAME not in (*CHIPS, "esp32"):
        raise pytest.UsageError(f"CHIP={NAME}: the chips are {', '.join(CHIPS)} and esp32")
    if (NAME == "esp32") != (collection_path.name == _OF_ESP32) and collection_path.is_file():
        return True
    if NAME != "rp2040":
        return None if asked and collection_path.name not in _OF_RP2040 else True
    return None if asked and _HAS_EMULATOR else True


def pytest_report_header() -> str:
    """Return why the tests are left out, or why they are slow."""
    if NAME == "esp32":
        return f"emulated ESP32: {qemu_esp32.lacks() or 'QEMU'}"
    if NAME == "rp2350":
        return f"emulated RP2350: {pico2.lacks() or 'rp2350js'}"
    if not _HAS_EMULATOR:
        return "emulated Pico: left out, rp2040py is not installed"
    return "" if _IS_COMPILED else "emulated Pico: slow; `make compiled-emulator` makes it faster"


def pytest_collection_modifyitems(items: "list[pytest.Item]") -> None:
    """Remove the time limit: a second of the board's time takes a minute here."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.timeout(0))


@pytest.fixture(scope="session")
def uf2() -> Path:
    """Return the MicroPython image for the chip."""
    why = pico2.lacks() if CHIP.name == "rp2350" else ""
    if why:
        pytest.skip(why)
    named = os.environ.get(CHIP.image, "")
    if not named:
        file = f"{CHIP.download}-….uf2 of micropython.org/download/{CHIP.download}"
        pytest.skip(f"{CHIP.image} names no image: {file}")
    if not Path(named).is_file():
        pytest.skip(f"{CHIP.image}: there is no file {named}")
    return Path(named)
