"""The simulator as a fixture in other projects' tests."""

import subprocess
import sys
from pathlib import Path

import pytest
from as_users import as_users
from ugrbl.sim import Machine


def test_a_line_is_answered_and_motion_takes_simulated_time(grbl: Machine) -> None:
    """grbl: the fixture that the package provides. rest() waits for the end of motion and returns
    further output."""
    assert grbl.welcome[-1] == "Grbl 1.1h ['$' for help]"
    assert grbl.ask("G1 X2 F600") == ["ok"]
    assert grbl.status().startswith("<Run|MPos:0.")
    begun = grbl.now_ms
    assert grbl.rest() == [] and grbl.now_ms > begun
    # 2 mm, 250 steps/mm
    assert grbl.steps() == [500, 0, 0] and grbl.status().startswith("<Idle|MPos:2.000,")


def test_time_stands_still_between_calls(grbl: Machine) -> None:
    grbl.ask("G1 X100 F600")
    before = grbl.now_ms, grbl.steps()
    assert (grbl.now_ms, grbl.steps()) == before
    # ms; no output
    assert grbl.run(1000) == [] and grbl.now_ms == pytest.approx(before[0] + 1000, abs=2)
    grbl.send("!")
    grbl.rest()
    assert grbl.status().startswith("<Hold:0|")


def test_a_program_is_streamed_and_fully_answered(grbl: Machine) -> None:
    lines = [f"G1 X{k % 3} F1200" for k in range(60)]
    assert grbl.program([*lines, "G64"]) == ["ok"] * 60 + ["error:20"]


def test_inputs_can_be_set_and_outputs_read() -> None:
    with Machine("sim", {21: 1, 30: 1000}) as machine:  # hard limits; 1000 rpm at full power
        machine.ask("M3 S500")
        assert machine.outputs()["spindle_pwm"] == 128  # of 255
        machine.push(probe=True)
        assert "|Pn:P" in machine.status()
        machine.switch("limit_x", 0, 1000)  # a switch of axis 0, X, that closes at step 1000
        machine.ask("G1 X20 F600")
        assert machine.rest()[0] == "ALARM:1" and abs(machine.steps()[0] - 1000) <= 2


def test_settings_returns_the_machines_settings(grbl: Machine) -> None:
    grbl.ask("$110=750")
    assert grbl.settings()[110] == "750.000" and len(grbl.settings()) == 34


def test_a_timeout_and_a_closed_machine_raise() -> None:
    machine = Machine(settings={110: 6000})
    with pytest.raises(TimeoutError, match="not end within 500 ms"):
        machine.ask("G4 P10", 500)  # a dwell of 10 s, and a limit of 500 ms
    machine.close()
    machine.close()  # does no harm
    with pytest.raises(RuntimeError, match="switched off"):
        machine.ask("?")
    with pytest.raises(ValueError, match="no board 'toaster'"):
        Machine("toaster")


def test_two_machines_are_independent(grbl: Machine) -> None:
    with Machine("sim_xyza") as second:
        second.ask("G1 A1 F600")
        second.rest()
        assert second.steps() == [0, 0, 0, 250] and grbl.steps() == [0, 0, 0]


def test_the_example_of_the_docs_passes(tmp_path: Path) -> None:
    """Run in an empty folder, with the fixture that the package provides."""
    docs_text = (Path(__file__).parents[2] / "docs" / "extending.md").read_text(encoding="utf-8")
    text = docs_text.partition("```python test_my_program.py\n")[2].partition("```")[0]
    (tmp_path / "test_my_program.py").write_text(text)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    process = subprocess.run(
        command, cwd=tmp_path, env=as_users(), capture_output=True, text=True, check=False
    )
    # the example has two tests
    assert "2 passed" in process.stdout, process.stdout + process.stderr
