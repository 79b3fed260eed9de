"""Test the memory of an emulated RP2350: 256 blocks, eight motors, jobs and the page.

All of them fit at once. docs/speed.md has the figures that are printed here. The board has no
radio, so the network is that of test_pico_network.py.
"""

from pathlib import Path

import pytest
from chips import CHIP
from emulated import BOARD_FILE, Board, Odometer, firmware
from test_pico2_motors import DIR, PINS, STEP
from test_pico_network import ASKS, free_bytes, started
from ugrbl.compiling import build

pytestmark = [
    pytest.mark.xdist_group("pico2 memory"),
    pytest.mark.skipif(CHIP.name != "rp2350", reason="an RP2040 has half as much memory"),
]

_BLOCKS = 256
_HEAP_PLAIN, _HEAP_BLOCKS, _HEAP_ALL = 330_000, 310_000, 210_000
_MORE = f"PLANNER_BLOCKS = {_BLOCKS}\n"
_PAGE = 'CHIP, LINK, PAGE, JOBS = "pico2_w", "wifi", True, "jobs"\n'
_PER_MM = 250  # Grbl's default
_TENTHS = (3, 2, 4, 5, 3, 2)  # n of each axis: line k of _JOB moves it to (k % n) / 10 mm
_JOB = "".join(
    "G1" + "".join(f"{axis}.{k % n}" for axis, n in zip("XYZABC", _TENTHS, strict=True)) + "F500\n"
    for k in range(1, 30)
)


def machine(uf2: Path, folder: Path, more: str, says: str = "") -> Board:
    """Return the common board, started with these further lines in its file and a job.

    says: Python code that scripts the clients of a stand-in for the network.
    """
    file = folder / "pico2_more.py"
    file.write_text(BOARD_FILE.read_text("utf-8") + more, "utf-8")
    # fromkeys(): None instead of each file of the common board.
    files = {**dict.fromkeys(firmware()), **build.for_board(file).files}
    return started(uf2, {**files, "jobs/EIGHT.NC": _JOB.encode()}, says)


def test_plain_board_leaves_two_thirds_of_its_memory_free(uf2: Path, tmp_path: Path) -> None:
    assert free_bytes(machine(uf2, tmp_path, "")) >= _HEAP_PLAIN


def test_256_blocks_are_planned_ahead(uf2: Path, tmp_path: Path) -> None:
    """A slow move runs meanwhile, so that the others wait in the planner."""
    board = machine(uf2, tmp_path, _MORE)
    assert f"[OPT:V,{_BLOCKS - 1}," in board.ask("$I")
    assert free_bytes(board) >= _HEAP_BLOCKS
    board.ask("$10=3")  # reports have "Bf": free blocks
    board.ask("G91 G1 X.2 F10")  # takes 1.2 s
    for _ in range(_BLOCKS - 2):
        board.ask("X.02 F500")
    assert board.status()["Bf"].startswith("0,")
    board.until_idle()
    assert board.status()["MPos"] == f"{0.2 + (_BLOCKS - 2) * 0.02:.3f},0.000,0.000"


def test_eight_motors_jobs_and_the_page_fit_together(uf2: Path, tmp_path: Path) -> None:
    """Six axes, X and Y with two motors. A client of the page moves X (ASKS), then a job runs from
    the serial line, while free memory is checked."""
    motors = "XYZABCXY"
    limit = (19, 20, 21, 0, 1, 28)
    pins = PINS.format(motors=motors, step=STEP, dir=DIR, limit=limit)
    board = machine(uf2, tmp_path, pins + _MORE + _PAGE, f"socket.asks += {ASKS}")
    for pin in (*limit, 22):  # open switches; REPL_PIN is 22
        board.pico.drive(pin, 1)
    board.pico.record([*STEP, *DIR])
    odometer = Odometer(board.pico, STEP, DIR)
    board.pico.run_us(2_500_000)  # the client's requests are served
    board.clear_output()
    board.send("?")
    assert "MPos:3.000,0.000,0.000,0.000,0.000,0.000" in board.wait_for(">")  # moved by the page
    board.pico.run_us(3_000_000)  # the page is silent: the cable may take control
    assert free_bytes(board) >= _HEAP_ALL
    board.ask("G90")
    board.clear_output()
    board.send("$F=eight.nc\n")
    board.wait_for("Job EIGHT.NC: done, 29 lines", 60_000_000)
    board.until_idle()
    ends = [_PER_MM * (29 % n) // 10 for n in _TENTHS]  # steps; the job's last line has k = 29
    assert odometer.read() == [*ends, *ends[:2]]
    # $U repeats the network's last messages: the page was sent it, too.
    assert "Job EIGHT.NC: done" in board.ask("$U")
