"""Test a MicroPython with frozen firmware: UGRBL_FROZEN_UF2 names its image.

It is built with manifest.py (docs/boards.md) for boards/rpi_pico.py, from these sources.
"""

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest
import uf2_model
from chips import CHIP
from emulated import BOARD_FILE, Board, firmware, frozen_in
from test_deploy_emulated import deploy, grbl, pico
from ugrbl.compiling import build
from ugrbl.compiling.build import for_board

pytestmark = pytest.mark.xdist_group("frozen")

_FREE = "import gc\ngc.collect()\nprint(gc.mem_free())"
# Names of modules that this chip does not use begin with these.
_ELSEWHERE = ("esp_chip", "boot.parts_esp", "main")
_IMPORT = """
NETWORK = "no module named 'socket'", "no module named 'network'"  # a Pico W has them
import builtins, gc, sys
before = {name: getattr(builtins, name) for name in dir(builtins)}
for name in NAMES:
    try:
        __import__(name)
    except ImportError as why:
        if str(why) not in NETWORK:
            raise
    gc.collect()
print([name for name in before if getattr(builtins, name) is not before[name]])
"""
_CUSTOM = b"""
from ugrbl import mcode
@mcode(100)
def hello(m):
    m.message("hello")
"""


@pytest.fixture(scope="module")
def frozen_uf2() -> Path:
    """Return the image with our firmware frozen in it; skip unless it has the current sources."""
    named = os.environ.get("UGRBL_FROZEN_UF2", "")
    if not named:
        pytest.skip("UGRBL_FROZEN_UF2 names no image: docs/boards.md says how to build it")
    frozen, here = frozen_in(Path(named)), for_board(BOARD_FILE).id
    if frozen != here:
        pytest.skip(f"UGRBL_FROZEN_UF2 contains the build {frozen or 'none'}, and here is {here}")
    return Path(named)


def reported_build(board: Board) -> str:
    """Return the build that the firmware reports."""
    return board.ask("$I+").partition("[MSG:Build: ")[2].partition("]")[0]


def test_firmware_starts_with_the_board_file_alone_and_moves(frozen_uf2: Path) -> None:
    board = Board(frozen_uf2).boot().settled()
    assert reported_build(board).endswith(", frozen")
    board.pico.record([2, 5])  # STEP and DIR of X
    board.ask("$120=1000")
    for k in range(20):
        board.ask(f"G1X{k % 2}F6000")
    board.ask("G0X4.5")
    board.until_idle()
    assert board.status()["MPos"] == "4.500,0.000,0.000"
    # 20 lines: 19 moves of 1 mm (the first one goes nowhere), then 3.5 mm, at 250 steps/mm.
    assert sum(edge.pin == 2 and edge.level for edge in board.pico.edges) == 250 * (19 + 3.5)
    assert int(board.python(_FREE)) > 150_000


def test_every_module_of_every_board_can_be_imported(frozen_uf2: Path) -> None:
    """And none replaces a builtin: the code at the prompt prints the names of such."""
    names = [name for name in build.texts() if not name.startswith(_ELSEWHERE)]
    assert len(names) > 100
    board = Board(frozen_uf2).boot().settled()
    assert board.python(f"NAMES = {names}\n{_IMPORT}").strip() == "[]"


def test_limit_switch_stops_the_machine(frozen_uf2: Path) -> None:
    board = Board(frozen_uf2).boot().settled()
    board.ask("$21=1")
    board.ask("G1X50F1200")
    board.pico.run_us(200_000)
    board.pico.drive(9, 0)  # the limit switch of X closes
    board.wait_for("ALARM:1")


def test_stored_data_survives_an_update(frozen_uf2: Path, tmp_path: Path) -> None:
    """A setting, an offset and custom.py.

    The update is the file of `ugrbl uf2 --keep`, loaded over flash that is marked as having an
    older build.
    """
    old = Board(frozen_uf2, {"custom.py": _CUSTOM}).boot().settled()
    old.ask("$110=4321")
    old.ask("G10L2P1X7")
    out = tmp_path / "update.uf2"
    command = [sys.executable, "-m", "ugrbl.cli", "uf2", "--board", CHIP.board, "--keep"]
    command += ["--micropython", str(frozen_uf2), "-o", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    flash = bytearray(old.pico.read_flash(0, 2 << 20))
    begin = flash.index(b"ugrbl frozen: ")
    flash[begin : begin + 64] = bytes(64)  # the id of an older build
    uf2_model.load(flash, out.read_bytes())
    new = Board(frozen_uf2)
    new.pico.write_flash(0, flash)
    new.boot()
    assert "First start" not in new.output
    assert "$110=4321" in new.ask("$$") and "[G54:7.000," in new.ask("$#")
    assert "[MSG:hello]" in new.ask("M100")


def test_deployment_removes_firmware_files_from_the_file_system(
    frozen_uf2: Path, tmp_path: Path
) -> None:
    """All except the board file: the frozen modules take the place of compiled files."""
    made = for_board(BOARD_FILE)
    with pico(frozen_uf2, tmp_path, made) as port:
        with grbl(port):
            pass  # it reads nothing while it starts
        code, done = deploy(port)
    assert code == 0, done
    assert done["runs_frozen"] and done["copied"] == []
    assert sorted(done["removed"]) == sorted(made.files.keys() - {"board.py"})
    assert done["free_bytes"] > 150_000


@pytest.mark.parametrize(
    ("files", "is_frozen"), [(firmware(), False), ({"motion/planner.mpy": b"half"}, True)]
)
def test_files_run_instead_of_frozen_firmware_after_a_complete_deployment(
    frozen_uf2: Path, files: "Mapping[str, bytes]", is_frozen: bool
) -> None:
    """files: those on the board, all or, as after an interrupted deployment, one in part."""
    board = Board(frozen_uf2, files).boot().settled()
    assert reported_build(board).endswith(", frozen") == is_frozen
