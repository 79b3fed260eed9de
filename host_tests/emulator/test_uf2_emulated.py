"""Test that one file dragged onto an emulated Pico with other data makes it a controller."""

import subprocess
import sys
from pathlib import Path

import pytest
import uf2_model
from chips import CHIP
from emulated import BOARD_FILE, Board
from test_uf2 import garbage, read_back
from ugrbl.compiling.build import for_board

pytestmark = pytest.mark.xdist_group("uf2 emulated")

_CUSTOM = """
from ugrbl import mcode
@mcode(100)
def hello(m):
    m.message("hello")
"""


def test_dragged_file_starts_with_firmware_settings_and_custom_module(
    uf2: Path, tmp_path: Path
) -> None:
    """The file of `ugrbl uf2` is loaded over flash with other data (garbage); it is complete: the
    start is not a first one, and the machine moves."""
    settings, custom, file = (tmp_path / name for name in ("my.settings", "custom.py", "all.uf2"))
    settings.write_text("$110=4321\n")
    custom.write_text(_CUSTOM)
    command = [sys.executable, "-m", "ugrbl.cli", "uf2", "--board", CHIP.board, "-o", str(file)]
    command += ["--micropython", str(uf2), "--settings", str(settings), "--custom", str(custom)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    board = Board(uf2)
    flash = garbage(CHIP.flash)
    uf2_model.load(flash, file.read_bytes(), CHIP.family)
    board.pico.write_flash(0, flash)
    files = read_back(board.pico.flash_image())
    firmware = for_board(BOARD_FILE).files
    assert {name: files[name] for name in firmware} == firmware
    board.boot()
    assert "First start" not in board.output
    assert "$110=4321" in board.ask("$$")
    assert "[MSG:hello]" in board.ask("M100")
    board.ask("G91G1X1F1000")
    board.until_idle()
    assert board.status()["MPos"] == "1.000,0.000,0.000"
