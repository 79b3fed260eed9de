"""A laser's power in integers: the exact product of speed and power per rpm, cut."""

from array import array
from fractions import Fraction

from base.f32 import copy
from control.spindle import dynamic_power
from hypothesis import example, given
from hypothesis import strategies as st
from laws import Bench, Limits
from motion.layout import POWER_PER_RPM, RPM_MAX

speeds = st.floats(0, 100_000, width=32)


@given(speeds, st.floats(0.125, 100_000, width=32), st.sampled_from([255, 1000, 65535]))
@example(0.0, 1000.0, 255)
@example(2**-149, 1000.0, 255)
@example(1000.0, 1000.0, 65535)
def test_power_follows_the_programmed_speed(rpm: float, most: float, full: int) -> None:
    table = Bench(Limits()).planner.table
    slope = array("f", [64 * full / most])
    copy(array("f", [most]), memoryview(table)[RPM_MAX:], 1)
    copy(slope, memoryview(table)[POWER_PER_RPM:], 1)
    exact = Fraction(min(rpm, most)) * Fraction(slope[0])
    tiny = exact < Fraction(1, 1 << 20)  # less than anything can show
    assert dynamic_power(array("f", [7, rpm]), 1, table) == (0 if tiny else int(exact))
