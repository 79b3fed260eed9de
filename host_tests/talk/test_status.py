"""Status reports: digits, single precision and segment rate against plain arithmetic; no memory is
allocated."""

import struct
from array import array

import pytest
from base.float32 import f32, vector
from base.float32_math import MINUS, add, divide
from base.state import State
from hypothesis import example, given
from hypothesis import strategies as some
from micropython_runner import needs_micropython, run_micropython
from motion import layout, minifloat
from motion.planner import Planner
from motion.segments import Segments
from talk.digits import END, VALUES, scaled, write
from test_float32 import printed
from ugrbl.paths import FIRMWARE

steps = some.integers(1 - 2**30, 2**30 - 1)
resolutions = some.floats(2.0**-20, 1e8, width=32)
# Below 2**-125 a number has no sign of its own.
places = some.floats(-1e9, 1e9, width=32).map(lambda x: x if abs(x) > 1e-37 else 0.0)


def bits(x: float) -> int:
    """Return a float's bits as a word."""
    word: int = struct.unpack("i", struct.pack("f", x))[0]
    return word


def write_form(form: bytes, values: "list[int]", singles: "list[float]") -> str:
    """Return write()'s output for these values, after an `a`."""
    out = bytearray(b"a" + bytes(200))
    ints = array("i", [1, *values, 0])  # ints[END]: length so far, 1 for the `a`
    end = write(form, out, ints, array("f", [*singles, 0.0]))
    assert end == ints[END]
    return out[1:end].decode()


# Positions


@given(steps, resolutions)
@example(2**24 + 1, 1.0)
@example(2**24 + 3, 1.0)
@example(2**25 - 1, 2.0)
@example(2**30 - 1, 2.0**-20)
@example(1 - 2**30, 250.0)
@example(-1, 1e8)
@example(0, 250.0)
def test_steps_are_divided_like_floats(number: int, resolution: float) -> None:
    """The steps are rounded to single precision, then the quotient."""
    quotients = vector(2)
    # divisors from index 1 on: 7 / 1, and number / resolution
    divide(array("i", [7, number]), array("f", [9, 1, resolution]), 1, quotients, 2)
    assert list(quotients) == [7, f32(f32(number) / resolution)]


def test_a_quotient_too_large_for_a_float_is_infinite() -> None:
    quotients = vector(1)
    divide(array("i", [1 - 2**30]), array("f", [1e-37]), 0, quotients, 1)
    assert quotients[0] == float("-inf")


@given(some.lists(some.tuples(places, places), min_size=1, max_size=4))
def test_offsets_are_added_and_subtracted(pairs: "list[tuple[float, float]]") -> None:
    """add() adds a to b, or subtracts it (MINUS), in single precision."""
    a, b = (array("f", column) for column in zip(*pairs, strict=True))
    add(a, 0, b, len(pairs))
    assert list(b) == [f32(x + y) for x, y in pairs]
    add(a, MINUS, b, len(pairs))
    assert list(b) == [f32(f32(x + y) - x) for x, y in pairs]


def test_infinity_stays_infinite() -> None:
    total = array("f", [float("inf")])
    add(array("f", [float("inf")]), 0, total, 1)
    add(array("f", [1.0]), MINUS, total, 1)
    assert total[0] == float("inf")


# Texts


@given(places, some.integers(0, 4))
def test_a_single_is_written_like_grbl(x: float, decimals: int) -> None:
    assert write_form(b"#%d\0" % decimals, [], [x]) == printed(x, decimals)


@pytest.mark.parametrize(
    ("x", "text"),
    [
        (-0.0, "0.000"),
        (-0.0001, "-0.000"),
        (1e30, "2147483.648"),
        (float("-inf"), "-2147483.648"),
        (2147483.5, "2147483.520"),
        (1.5, "1.500"),
    ],
)
def test_limits_of_the_number_format(x: float, text: str) -> None:
    assert write_form(b"#3\0", [], [x]) == text


def test_a_value_beyond_31_bits_is_reported() -> None:
    assert scaled(array("f", [2147483648.0]), 0, 0) == -1
    assert scaled(array("f", [2147483520.0]), 0, 0) == 2147483520


@given(some.integers(0, 2**31 - 1), some.integers(0, 1000))
def test_integers_are_written_in_order(first: int, second: int) -> None:
    assert write_form(b"|Bf:%,%\0", [first, second], []) == f"|Bf:{first},{second}"


@given(some.integers(0, 15))
def test_letters_are_written_for_set_bits(mask: int) -> None:
    letters = "".join(c for i, c in enumerate("SCFM") if mask >> i & 1)
    assert write_form(b"|A:?S?C?F?M\0", [mask], []) == "|A:" + letters


def test_a_form_may_contain_all_kinds_of_fields() -> None:
    assert VALUES == 1
    text = write_form(b"<Door:%|#3,#0|?P?X>\r\n\0", [3, 2], [-1.25, 999.5])
    assert text == "<Door:3|-1.250,1000|X>\r\n"


# Rates


@given(some.integers(0, 2**30 - 1), some.integers(1, 2**15))
@example(0, 1)
@example(minifloat.real(1e17), 1)
def test_a_rate_is_rounded_like_printed_floats(join_speed: int, row_speed: int) -> None:
    """mm/min in a report: without a block from the speed between blocks, then from the speed of
    the block's row."""
    # a valid minifloat: exponent below 100, highest bit of the mantissa set
    join_speed = join_speed % (100 << 15) | 0x4000 if join_speed else 0
    planner = Planner(axes=3, blocks=4, kinematics=None, state=State())
    segments = Segments(planner)
    planner.flow[layout.JOIN_SPEED] = join_speed
    rate = 60 * minifloat.value(segments.rate())
    if rate < 60 * 2**24:  # mm/min: the limit of per_minute()
        assert str(minifloat.per_minute(segments.rate())) == printed(rate, 0)
    planner.flow[layout.LOADED] = 1
    planner.flow[layout.ROW_SPEED] = row_speed
    planner.ring[layout.FACTOR] = minifloat.real(1 / 7)
    assert str(minifloat.per_minute(segments.rate())) == printed(
        60 * minifloat.value(segments.rate()), 0
    )


# Memory

_BENCH = """
import gc
import micropython
from array import array
from control.coords import Coords
from control.inputs import Inputs
from motion.planner import Planner
from talk.report import Report
from motion.segments import Segments
from base import state as st

class Store:
    load = save = lambda *_: None
class Settings:
    report_mask = 3
    report_inches = 0
    limit_invert = 0
    probe_invert = 0
    laser_mode = 0
    steps_per_mm = array("f", [250.0, 80.0, 4000.0])
    max_rate = array("f", [3000.0, 5000.0, 500.0])
    acceleration = array("f", [360000.0, 3600000.0, 36000.0])
    junction_deviation_mm = 0.01
class Machine:
    mask = 0
    text = bytearray(200)
    length = 0
    def write(self, data):
        self.length = len(data)
        self.text[:self.length] = data
    def position(self, steps):
        steps[0] = 1234
        steps[1] = -56790
    def levels(self):
        return 5 << 6 | 1 << 5 | 5
    def direction(self):
        return 16

machine = Machine()
state = st.State()
state.run = st.RUN
state.override_control = True
settings = Settings()
coords = Coords(Store(), 3, 2)
coords.systems[0][0] = 10.5
planner = Planner(3, 16, None, state)
planner.configure(settings, 13107200, 17, 90909)
segments = Segments(planner)
class Reader:
    def memory(self):
        return None, array("i", (256, 0, 0, 0, 0, 0, 0, 255))
class Parts:
    pass

planner.flow[9] = 56 << 15 | 0x4321
report = Report(machine, state, settings, coords, 3, False)
inputs = Inputs(machine, settings, 3, False)
parts = Parts()
parts.engine = parts.spindle = parts.coolant = machine
parts.planner, parts.segments, parts.inputs, parts.reader = planner, segments, inputs, Reader()
report.connect(parts)
report.configure()

def taken(wco, ov):
    state.wco_countdown, state.override_countdown = wco, ov
    machine.write(report.status())
    gc.collect()
    state.wco_countdown, state.override_countdown = wco, ov
    before = gc.mem_alloc()
    report.status()
    after = gc.mem_alloc()
    return after - before

gc.collect()
gc.disable()
print(taken(5, 5), bytes(machine.text[:machine.length]).decode().strip())
print(taken(5, 0), bytes(machine.text[:machine.length]).decode().strip())
print(taken(0, 5), bytes(machine.text[:machine.length]).decode().strip())
settings.report_mask = 2
report.configure()
print(taken(5, 5), bytes(machine.text[:machine.length]).decode().strip())
"""


@needs_micropython
def test_a_report_allocates_no_memory() -> None:
    """Each line: bytes allocated, and the report; the script asks for all, with Ov, with WCO, and
    with WPos."""
    lines = run_micropython(_BENCH, paths=[FIRMWARE]).splitlines()
    rate = round(0x4321 / 2**8 * 60)  # mm/min of flow[9] (JOIN_SPEED): 0x4321 * 2**(56 - 64) mm/s
    position = "MPos:4.936,-709.875,0.000"
    common = f"|Bf:15,255|FS:{rate},0|Pn:PXZRS"
    assert lines == [
        f"0 <Run|{position}{common}>",
        f"0 <Run|{position}{common}|Ov:100,100,100|A:S>",
        f"0 <Run|{position}{common}|WCO:10.500,0.000,0.000>",
        f"0 <Run|WPos:-5.564,-709.875,0.000{common}>",
    ]
