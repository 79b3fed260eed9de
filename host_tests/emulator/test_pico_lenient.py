"""Test a lenient board on the emulated Pico: tool change and drilling, to the last step."""

from itertools import accumulate
from pathlib import Path

import pytest
from emulated import BOARD_FILE, DIR, STEP, Board, firmware, steps
from ugrbl.compiling import build

pytestmark = pytest.mark.xdist_group("pico lenient")

_FAST = {100: 100, 110: 6000, 120: 1000}
_BEFORE = ("%", "O0001", "G21 G90 G64 P.01", "T328 M6", "G0 Z2")
_HOLES = ("G98 G83 X1 Y1 Z-1 R1 Q.8 F1200", "X2", "X3Y2", "G80", "X.5")
_SETTINGS = [f"${first + axis}={value}" for first, value in _FAST.items() for axis in range(3)]


def test_program_for_another_controller_is_drilled(uf2: Path, tmp_path: Path) -> None:
    """The program waits for the tool change, then drills three holes 1 mm deep, at 100
    steps/mm."""
    file = tmp_path / "lenient.py"
    file.write_text(BOARD_FILE.read_text() + "\nLENIENT = True\n")
    # fromkeys(): None instead of each file of the common board.
    machine = Board(uf2, {**dict.fromkeys(firmware()), **build.for_board(file).files}).boot()
    machine.settled()
    for line in _SETTINGS:
        machine.ask(line)
    machine.pico.record([*STEP, *DIR])
    machine.clear_output()
    machine.send("\n".join((*_BEFORE[:4], "")))
    machine.wait_for("[MSG:Insert tool 328, then send ~]")
    machine.pico.run_us(300_000)
    assert machine.status()["state"] == "Hold:0"
    machine.send("~")
    for line in (*_BEFORE[4:], *_HOLES):
        machine.ask(line, limit_us=20_000_000)
    machine.until_idle(60_000_000)
    tracks = [  # positions after each step, per axis
        list(accumulate(sign for _, sign in steps(machine.pico.edges, axis))) for axis in range(3)
    ]
    assert [track[-1] for track in tracks] == [50, 200, 200]  # X.5 Y2 Z2
    assert [min(track) for track in tracks] == [1, 1, -100]
    assert sum(z == -100 for z in tracks[2]) == 3  # the bottom of each hole
    assert "error" not in machine.output
    assert machine.ask("$G").startswith("[GC:G0 ")
