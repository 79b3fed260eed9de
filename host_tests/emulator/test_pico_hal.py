"""Test a board that speaks as grblHAL on the emulated Pico: its texts are read from flash."""

from pathlib import Path

import pytest
from emulated import BOARD_FILE, Board, firmware
from ugrbl.compiling import build

pytestmark = pytest.mark.xdist_group("pico hal")

_FREE = "import gc;gc.collect();print(gc.mem_free())"
# Measured: 97.0 kB free, before and after texts are read; with Grbl's dialect 112.7.
_HEAP_BYTES = 66_000


def test_texts_are_read_from_flash_and_stay_there(uf2: Path, tmp_path: Path) -> None:
    """Axes, settings and alarms in grblHAL's form. Setting 103 would be of a fourth axis.

    Byte 0x87 asks for a complete status report.
    """
    file = tmp_path / "hal.py"
    file.write_text(BOARD_FILE.read_text() + '\nDIALECT = "hal"\n')
    # fromkeys(): None instead of each file of the common board.
    machine = Board(uf2, {**dict.fromkeys(firmware()), **build.for_board(file).files})
    machine.boot("GrblHAL 1.1f").settled()
    assert "[AXS:3:XYZ]" in machine.ask("$I")
    said = machine.ask("$ES", limit_us=5_000_000)
    assert "[SETTING:110|43|Maximum rate X|mm/min|6|#####0.000|0||0|0]" in said
    assert "[SETTING:103|" not in said
    assert "[ALARMCODE:1||" in machine.ask("$EA", limit_us=5_000_000)
    machine.send("\x87")
    machine.wait_for("|FW:grblHAL>")
    assert int(machine.python(_FREE)) > _HEAP_BYTES
