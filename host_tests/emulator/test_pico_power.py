"""POWER_FAIL on the emulated Pico: from the edge to the last byte in flash, and the next start.

`-s` prints the time. The emulator programs a page in no time; the data sheet says 3 ms at most.
"""

import re
from pathlib import Path

import pytest
from chips import CHIP
from test_pico_jobs import _JOB, _SETTINGS, dragged_flash, home, push, start_with_flash, xy_of

pytestmark = pytest.mark.xdist_group("pico jobs")

_PIN = 20
_PAGE_US = 3_000  # to program a page of flash
_LASTS_US = 100_000  # the supply, after the edge
_REPORT = re.compile(
    r"Job STAIRS.NC: power failed at line (\d+), position certain: "
    r"X(-?[\d.]+) Y(-?[\d.]+) Z(-?[\d.]+)\]"
)
# The emulator has no contact to hold this pin; without a pull-up it reads low, as if closed.
_OPTIONS = f"POWER_FAIL = {_PIN}\nNO_PULL_UP = ({_PIN},)"
_BRISK = tuple(line.replace("=500", "=1000") for line in _SETTINGS)  # acceleration, travel


def test_supply_that_fails_in_a_job_leaves_its_exact_line(uf2: Path, tmp_path: Path) -> None:
    """The pin POWER_FAIL reports the failure. A Pico that starts with that flash reports line and
    position, which match the steps made, at 100 steps/mm; the job continues there."""
    flash = dragged_flash(tmp_path, uf2, _OPTIONS, _BRISK)
    machine = start_with_flash(uf2, flash)
    pico = machine.pico
    machine.ask("$X")
    push(machine, "STAIRS.NC", "".join(f"{line}\n" for line in _JOB).encode())
    odometer = home(machine)
    machine.clear_output()
    machine.send("$F=stairs.nc\n")
    machine.wait_for("Job STAIRS.NC: begins")
    pico.run_us(600_000)
    assert machine.status()["state"] == "Run"
    programs: list[float] = []
    erasures: list[float] = []
    pico.on_program = lambda: programs.append(pico.us)
    pico.on_erase = lambda: erasures.append(pico.us)
    failed_us = pico.us
    pico.drive(_PIN, 1)
    pico.run_until(lambda: bool(programs), _LASTS_US, step_us=100)
    taken_us = programs[0] + _PAGE_US - failed_us
    print(f"{taken_us / 1000:.1f} ms from the edge to the last byte")
    assert taken_us < _LASTS_US and not erasures, "an erasure takes up to 0.4 s"
    made_steps, flash = odometer.read(), pico.read_flash(0, CHIP.flash)  # and the supply is gone

    machine = start_with_flash(uf2, flash)
    machine.wait_for("last recorded line: ")
    machine.wait_for("]\r\n")
    report = _REPORT.search(machine.output)
    assert report, machine.output
    line = int(report[1])
    assert f"last recorded line: {line}]" in machine.output
    # Machine zero is at the switches, 200 steps from the odometer's origin.
    reported_steps = [round(100 * float(word)) + 200 for word in report.groups()[1:]]
    assert reported_steps == made_steps
    # X and Y are between the ends of that line, within a step.
    for axis, ends in enumerate(zip(xy_of(_JOB[line - 2]), xy_of(_JOB[line - 1]))):
        assert min(ends) - 0.011 <= (made_steps[axis] - 200) / 100 <= max(ends) + 0.011
    home(machine)
    machine.clear_output()
    machine.send("$F=@\n")
    machine.wait_for(f"Job STAIRS.NC: continues at line {line}")
