"""Targets too far to count in steps are refused on every path of a line; endless axes continue.

An axis counts 2**29 steps in each direction. Beyond it, a line is treated as beyond a soft limit:
ALARM:2, for a jog error:15, and no motor moves.
"""

from collections.abc import Iterator
from typing import Any

import pytest
from extras.kinematics import rotary
from hypothesis import example, given
from hypothesis import strategies as st
from laws import some
from rig_bench import Machine

FARTHEST = 2**29
SETTINGS = {110: 3000.0, 111: 3000.0, 112: 3000.0}
# The paths of a line: by the kernels (after another move), by the interpreter, and others. {} is
# in mm.
FORMS = {
    "quick": "G1X{}",
    "rapid": "G0X{}",
    "long": "T1G1X{}F500",
    "relative": "G91G1X{}F500",
    "inverse time": "G93G1X{}F.01",
    "inches": "G20G1X{}F20",
    "machine": "G53G0X{}",
    "probe": "G38.2X{}F500",
    "probe without alarm": "G38.3X{}F500",
    "offset": "G92X-{}\nG0X0",
    "system": "G10L2P1X{}\nG0X0",
    "jog": "$J=X{}F500",
    "relative jog": "$J=G91X{}F500",
    "jog with a word": "$J=G90G21G53X{}F500",
    "check": "$C\nG1X{}F500",
}
_INCH_MM = 25.4


def last_answer(machine: Machine, lines: "list[str]") -> str:
    """Return the answer to the last line: "ok", an error or an alarm. The machine stops there."""
    replies: list[str] = []

    def script() -> Iterator[Any]:
        """Send line by line, each after an answer."""
        yield from machine.start()
        for line in lines:
            replies.clear()
            machine.rig.link.send(line.encode() + b"\n")
            while not replies:
                yield lambda: machine.sender.poll() or bool(machine.sender.lines)
                ends = ("ok", "error:", "ALARM:")
                replies.extend(text for text in machine.take() if text.startswith(ends))

    machine.run(script())
    return replies[0]


def answer_and_motors(
    form: str, mm: float, steps_per_mm: float, board: str = "sim"
) -> "tuple[str, Any]":
    """Send a line of this form to an idle machine; return the answer, and the motors' position."""
    machine = Machine({**SETTINGS, 100: steps_per_mm}, board, watched=False)
    amount = f"{mm / _INCH_MM if form == 'inches' else mm:.4f}"
    line = FORMS[form].format(amount).replace("--", "")  # "X-{}" of a negative amount
    return last_answer(machine, ["G1F500", "G1X0", *line.split("\n")]), machine.physical()


@pytest.mark.parametrize("form", FORMS)
@some(4)
@given(
    st.floats(0.3, 0.99) | st.floats(1.01, 50.0),
    st.sampled_from([1, -1]),
    st.sampled_from([40.0, 250.0, 1600.0]),
)
@example(1.001, 1, 250.0)
@example(0.999, 1, 250.0)
def test_a_target_is_refused_if_its_steps_cannot_be_counted(
    form: str, reach_fraction: float, sign: int, steps_per_mm: float
) -> None:
    """form: a way to write the line, see FORMS; reach_fraction: of the farthest position that can
    be counted, 2**29 steps."""
    if form.startswith("probe"):
        reach_fraction += 1  # a probe within reach would take hours
    reply, motors = answer_and_motors(
        form, sign * reach_fraction * FARTHEST / steps_per_mm, steps_per_mm
    )
    if reach_fraction < 1:
        assert reply == "ok"
    else:
        assert reply == ("error:15" if "jog" in form else "ALARM:2")
        assert motors == [0, 0, 0]


def test_axes_that_share_motors_reach_half_as_far() -> None:
    """CoreXY: a motor makes the steps of X and Y together."""
    board = "sim_corexy"
    assert answer_and_motors("long", 0.6 * FARTHEST / 250, 250.0, board)[0] == "ALARM:2"
    assert answer_and_motors("long", 0.4 * FARTHEST / 250, 250.0, board)[0] == "ok"


@pytest.mark.parametrize("text", ["1e", "99999999", "-99999999"])
def test_a_refused_huge_arc_moves_no_motor(text: str) -> None:
    machine = Machine(SETTINGS, watched=False)
    lines = ["G1F500", f"G2X{text.replace('e', '')}9999999Y0R99999999"]
    assert last_answer(machine, lines) in ("ALARM:2", "error:34", "error:33")
    assert machine.physical() == [0, 0, 0]


def test_a_target_is_refused_if_a_changed_resolution_puts_it_out_of_reach() -> None:
    """$100: from 250 to 1600 steps/mm; the target, at 1000 m after G10, is 2.5e8 steps away first,
    then 1.6e9: more than 2**29."""
    machine = Machine(SETTINGS, watched=False)
    lines = ["G1F500", "G10L20P1X-2000000", "$100=1600", "G1X-1000000F500"]
    assert last_answer(machine, lines) == "ALARM:2"
    assert machine.physical() == [0, 0, 0]


# Endless axes


def run_rotary(lines: "list[str]") -> Machine:
    """Run lines on a machine whose A is endless and has 20 steps per degree."""
    machine = Machine({103: 20.0, 113: 200_000.0, 123: 50_000.0}, "sim_rotary")
    machine.play(lines)
    return machine


@pytest.fixture
def early_unwinding(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make an endless axis unwind beyond 819 degrees: 16384 steps, at 20 per degree."""
    monkeypatch.setattr(rotary, "_EXACT_STEPS", 16384.0)


def a_positions(machine: Machine) -> "tuple[float, float]":
    """Return A's machine and work position from the last report."""
    report = next(line for line in reversed(machine.received) if "WCO:" in line)
    mpos, wco = (
        float(report.split(name)[1].split("|")[0].strip(">").split(",")[3])
        for name in ("MPos:", "WCO:")
    )
    return mpos, mpos - wco


@pytest.mark.usefixtures("early_unwinding")
@pytest.mark.parametrize("line", ["G91G1A330F200000", "T1G91G1A330F200000", "$J=G91A330F200000"])
def test_an_endless_axis_keeps_turning_and_keeps_its_angle(line: str) -> None:
    """early_unwinding: whole turns are subtracted from positions beyond 819 degrees."""
    machine = run_rotary([line] * 12 + ["G4P0.1"])
    assert machine.physical()[3] == 12 * 6600  # 330 degrees are 6600 steps
    mpos, work = a_positions(machine)
    assert work == 12 * 330.0
    assert abs(mpos) <= 820 and (work - mpos) % 360 == 0


@pytest.mark.usefixtures("early_unwinding")
def test_program_coordinates_continue_after_an_endless_axis_is_unwound() -> None:
    machine = run_rotary(
        [*(f"G1A{a}F200000" for a in range(0, 3000, 250)), "G2X2I1A3000F200000", "G1A-90"]
    )
    assert machine.physical()[3] == -1800  # -90 degrees, 20 steps each
    assert a_positions(machine)[1] == -90


@pytest.mark.usefixtures("early_unwinding")
def test_a_line_beyond_the_exact_range_of_an_endless_axis_moves_its_full_distance() -> None:
    machine = run_rotary(["G1A2000F200000", "A0", "A1000"])
    assert machine.physical()[3] == 20_000  # 1000 degrees


def test_a_target_that_an_endless_axis_cannot_count_is_refused() -> None:
    machine = Machine({103: 100.0}, "sim_rotary", watched=False)
    assert last_answer(machine, ["G1A6000000F3600"]) == "ALARM:2"
