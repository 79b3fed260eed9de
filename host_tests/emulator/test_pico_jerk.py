"""Test the limit of jerk on the emulated Pico: the simulator's steps, at their times."""

from pathlib import Path

import emulated
import pytest
from emulated import BOARD_FILE, STEP, Board, steps
from test_pico_motion import PROGRAM, SETTINGS, run_lines
from ugrbl.compiling import build

pytestmark = pytest.mark.xdist_group("pico jerk")

_LIMITS = (*SETTINGS, "$800=20000", "$801=20000", "$802=8000")


@pytest.fixture(scope="module")
def board_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("boards") / "pico_jerk.py"
    file.write_text(BOARD_FILE.read_text() + "JERK = True\n")
    return file


@pytest.fixture(scope="module")
def machine(uf2: Path, board_file: Path) -> Board:
    """Return a board with a limit of jerk ($800 to $802, in mm/s3), its motor pins recorded."""
    files = build.for_board(board_file).files
    # fromkeys(): None instead of each file of the common board.
    made = Board(uf2, {**dict.fromkeys(emulated.firmware()), **files}).boot().settled()
    for setting in _LIMITS:
        assert made.ask(setting).endswith("ok\r\n")
    made.pico.record([*STEP, *emulated.DIR])
    return made


def test_steps_are_those_planned(machine: Board, board_file: Path) -> None:
    """The same steps as in the simulator; the time of the whole program may differ by 6 %.

    The simulator's segments are shorter by a twentieth, and its filter averages the same number of
    them. So each stop is shorter by that part, too.
    """
    made = run_lines(machine, [*PROGRAM, "G4P.01"])  # waits for the end of motion
    planned = emulated.planned(PROGRAM, _LIMITS, str(board_file))
    for real, due in zip(made, planned, strict=True):
        assert [sign for _, sign in real] == [sign for _, sign in due]
    took_us, due_us = (
        max(axis[-1][0] for axis in tracks) - min(axis[0][0] for axis in tracks)
        for tracks in (made, planned)
    )
    assert took_us == pytest.approx(due_us, rel=0.06)


def test_move_starts_within_the_limit_of_jerk(machine: Board) -> None:
    """In the first 50 ms jerk is half of the limit, 10000 mm/s3 (docs/jerk.md), later less.

    So the distance is at most jerk * time**3 / 6, plus 10 %.
    """
    (track, _, _) = run_lines(machine, ["G91 G0 X20", "G4P.01"])
    start = track[0][0]
    for number, (us, _) in enumerate(track[:60]):
        if us - start < 45_000:
            seconds = (us - start) / 1e6 + 0.016  # from rest to the first step, and one segment
            assert (number + 0.5) / 80 <= 10_000 * seconds**3 / 6 * 1.1  # mm, 80 steps/mm


def test_position_matches_the_steps_after_a_hold_and_a_reset(machine: Board) -> None:
    """Held in the middle of a move, then reset: nothing is lost, because the motors stand."""
    machine.until_idle()
    before_mm = [float(x) for x in machine.status()["MPos"].split(",")]
    machine.pico.edges.clear()
    machine.ask("G91 G1 X20 Y3 F3000")
    machine.pico.run_us(150_000)
    machine.send(b"!")
    machine.pico.run_us(400_000)
    assert machine.status()["state"] == "Hold:0"
    machine.send(b"\x18")
    machine.pico.run_us(200_000)
    step_sums = [sum(sign for _, sign in steps(machine.pico.edges, axis)) for axis in range(3)]
    after_mm = [float(x) for x in machine.status()["MPos"].split(",")]
    assert step_sums[0] > 100
    for axis, per_mm in enumerate((80, 80, 400)):
        assert after_mm[axis] - before_mm[axis] == pytest.approx(
            step_sums[axis] / per_mm, abs=0.002
        )
