"""Lines done by kernels alone give the same result as by the interpreter, bit by bit."""

from itertools import product
from types import SimpleNamespace
from typing import Any

import pytest
from base.errors import INVALID_JOG_COMMAND, GrblError
from base.state import CHECK, IDLE, RPM
from boot import wiring
from control import modes as modal
from hypothesis import example, given
from hypothesis import strategies as st
from language import line as ln
from language.block_layout import MOVE
from laws import some
from motion import layout
from ugrbl.run import machine
from ugrbl.run.program import ProgramLink


class Bench:
    """A machine that gets lines and never moves: what it plans is inspected and discarded.

    by_kernels: kernels do the lines that they can; else the interpreter does all. max_rpm,
    min_rpm: $30, $31.
    """

    def __init__(
        self,
        laser: bool,
        by_kernels: bool,
        max_rpm: float = 1000.0,
        min_rpm: float = 0.0,
        mist: bool = False,
    ) -> None:
        rig = machine.build("sim", lambda rig: ProgramLink(rig, lambda _link: iter(())))
        board = SimpleNamespace(**{**vars(rig.board), "LINE_NUMBERS": True, "MIST": mist})
        self.machine = wiring.build(board, rig.link, rig.port, rig.engine, rig.store)
        self.machine.settings.load()
        settings = self.machine.settings
        settings.laser_mode, settings.max_rpm, settings.min_rpm = int(laser), max_rpm, min_rpm
        self.machine.configure()
        self.machine.planner.override()  # sets its factors, 100 %
        self.machine.canon.service = self.machine.planner.clear  # a waiting caller finds space
        self.machine.motor_control.start = self.machine.state.enter  # type: ignore[method-assign]
        if not by_kernels:
            self.machine.interpreter.watch(MOVE)
        self.modal, self.counts, self.memory = self.machine.interpreter.memory()

    def done_by_kernels(self, text: str, line: "bytearray | None" = None) -> int:
        """Return 1 if the kernels have done the line, 0 if the interpreter must."""
        line = line or bytearray(text.encode() + b"\0")
        return ln.execute(line, len(text), self.modal, self.counts, self.memory)

    def effect_of(self, text: str) -> "tuple[Any, ...]":
        """Run a line; return its whole effect: error, modes, planned block, and what follows from
        them."""
        gcode, planner = self.machine.interpreter, self.machine.planner
        gcode.line = line = bytearray(text.encode() + b"\0")
        fault = 0
        try:
            if text.startswith("$J="):
                gcode.jog(line, len(text))
            elif not self.done_by_kernels(text, line):
                gcode.execute(line, len(text))
        except GrblError as refusal:
            fault = refusal.code
        row = [] if planner.empty() else list(planner.row() or ())
        modes = self.machine.modes
        effect = (fault, list(modes.position), list(modes.rates), modes.tool, row)
        speed = planner.speeds[planner.flow[layout.TAIL]] if row else 0
        more_effects = (
            self.machine.commands.modes(),
            list(planner.position),
            speed,
            self.machine.state.spindle[RPM],
            self.machine.state.run,
        )
        planner.clear()
        self.machine.state.enter(IDLE)
        return effect, more_effects


PLANES = ["G17", "G18", "G19"]
modal_words = "G90 G91 G20 G21 G93 G94 G54 G49 G40 G61 M5 M9 M3 M7 M8".split() + PLANES
repeated = st.one_of(
    st.just(""), st.lists(st.sampled_from(modal_words), min_size=1, max_size=3).map("".join)
)
simple = st.from_regex(r"(G[01])?(X-?[0-9]{1,2}\.[0-9]{0,3})?(Y-?[0-9]\.[0-9])?", fullmatch=True)
jog = st.from_regex(
    r"\$J=(G2[01]|G9[01]|G53|G1[789]?|M8|){0,2}(X-?[0-9]{0,3}\.?[0-9]?)?(Y1|Z-2\.5)?(N7|S5)?(F[0-9]{0,4})?G?",
    fullmatch=True,
)
other_lines = st.sampled_from(
    "G91 G90 G20 G21 G92X1.1Y-3 G92.1 F300 S500 M3S200 M4 M5 T2 G43.1Z0.3 G49 G55 G54 G10L2P2X0.7 "
    "G93 G94 G2X1Y1R5 G3X2Z1R5 G2Y1Z2R5 G80 X1X2 M7 M8 M9 M7M8 M8M9 G18 G19 G17 "
    "G91G2X0.1R5 G3X-0.01Y0.02R9 G3I0.0001".split()
)
last_words = st.sampled_from(
    ["", "", "", "F200", "F700", "S100", "N12", "S0", "Z1", "F0", "Z-0.0001"]
)
program = st.lists(
    st.one_of(
        *[st.tuples(repeated, simple, last_words, repeated).map("".join)] * 4, other_lines, jog
    ),
    min_size=4,
    max_size=25,
)


@some(150)
@given(program, st.booleans(), st.booleans())
@example(["F300", "G1X1", "X2", "X3S5", "G91", "X1", "X1", "X1"], True, False)
@example(["M4S100F300", "G1X1", "X2", "X2", "X3S5", "G0X4", "X5", "G1X6"], True, False)
@example(
    ["G20", "G1X1F20", "X2", "X-2.3F508", "X1Y0.333F20", "G0X4", "G91", "X-0.1"], False, False
)
@example(["G20", "G92X0.3", "G1X1F20", "X2", "X-2.3", "X0.1", "Y-0.0625", "Y0"], False, False)
@example(
    ["F300", "G1X1", "G90X2", "G90M5X3", "G90G90X4", "G17G21", "M5M9", "G91", "G91X1"],
    False,
    False,
)
@example(
    ["F300", "G1X1", "M3S5", "M3X2", "M3S6X2", "M5X3", "M3M3", "G93", "G90", "G1X4F2"], True, False
)
@example(["M3S100F300", "G1X1", "X2", "X2", "X3", "T3", "X4", "X5", "X6", "X7"], False, False)
@example(["F300", "G1X1", "X2", "G91G20X1", "G20", "X1F3", "G21G90X2F300", "G90G91"], False, False)
@example(
    ["G92X1", "$J=X1F50", "$J=G91X1F50", "G20", "$J=G21X2F5", "$J=X1F5", "$J=X1"], False, False
)
@example(
    ["F300", "G2X1Y1R5", "X2", "Y2R5", "G1X3", "G3X1R5", "G0X0", "G3X2R5", "G90G18"], False, False
)
@example(["M4S9F5", "G2X1Y1R5", "G1X2S5", "G2X1R5", "S7", "G0X0", "G1X1", "M5"], True, False)
@example(["M4S9F5", "G1X1", "X1", "$J=X2F9", "X3S5", "$J=G20X1F9", "$J=X1F9S2", "M5"], True, False)
@example(
    ["$J=G1X1F9", "$J=X1F0", "$J=G20X1F0", "$J=G54X1F9", "$J=G90F9", "G93", "$J=X4F9"],
    False,
    False,
)
@example(
    ["F300", "M8", "G1X1", "M8X2", "M8", "M7X1", "X2", "M8X3", "M9", "M7", "M7X1"], False, True
)
@example(
    ["F300", "G1X1", "G18", "G2X1Z1R5", "G1X1", "G19X2", "G17G18", "G18G2X0Z0R5"], False, False
)
@example(
    [
        "F300",
        "G91",
        "G2X0.1R5",
        "G3X0.1R5S5",
        "G2X.1Y.1R900",
        "G18G2X.05R4",
        "G3I.001",
        "G2I.0001",
    ],
    False,
    False,
)
@example(["M4S9F5G91", "G2X0.1R5", "G3X0.1R5S5", "G93G2X0.1R5F3", "M3", "G2I0.001S7"], True, False)
@example(["G93", "G1X1F9", "X2F9", "X3", "G20", "X4F5", "G0X0", "G0X1F3", "G94"], False, True)
@example(["M3S9F5", "G1X1", "X1S5", "X1.0001", "M4X1S7", "M5X1.0002S8", "X2"], True, False)
@example(["F9", "G1X1", "G93X2F3", "X3F3", "G93X4F4", "G94X5", "G94X5F5", "X6"], True, True)
def test_kernels_and_interpreter_give_the_same_result(
    lines: "list[str]", laser: bool, mist: bool
) -> None:
    compare(lines, laser, mist)


@pytest.mark.parametrize("plane", PLANES)
def test_plane_words_in_every_combination(plane: str) -> None:
    words = ["", *PLANES, "G91", "M8", "G4"]
    lines = [
        line
        for word_1, word_2 in product(words, words)
        for move in ("", "X1", "X", "G2X1Y0Z0R9")  # done, refused, and an arc of that plane
        for line in (f"{word_1}{word_2}{move}", "X1")
    ]
    compare(["F300", "G1X1", "M8", plane, *lines])
    # A jog may have no plane word, not even the current plane's.
    compare([plane, *[f"$J={word}G91X1F50" for word in PLANES], *[f"$J=X1{plane}F50"], "X1"])
    # [0][0]: the error
    assert (
        Bench(laser=False, by_kernels=True).effect_of(f"$J={plane}G91X1F50")[0][0]
        == INVALID_JOG_COMMAND
    )


@pytest.mark.parametrize("mist", [True, False])
def test_coolant_words_in_every_combination(mist: bool) -> None:
    """Pairs of lines, alone and with motion. mist: the board has M7; else it is an error."""
    words = ["M7", "M8", "M9", "M7M8", "M8M7", "M8M8", "M9M8"]
    lines = [
        line
        for before, after in product(words, words)
        for line in ("M9", before, "X1", after, f"{after}X2", f"X1{after}G18", "X2")
    ]
    compare(["F300", "G1X1", *lines], mist=mist)


def compare(lines: "list[str]", laser: bool = False, mist: bool = False) -> None:
    """Check that kernels and interpreter answer and plan the same."""
    by_kernels, by_interpreter = (
        Bench(laser, by_kernels=True, mist=mist),
        Bench(laser, by_kernels=False, mist=mist),
    )
    for line in lines:
        assert by_kernels.effect_of(line) == by_interpreter.effect_of(line), line


@pytest.mark.parametrize("override", [100, 50])
@pytest.mark.parametrize("beam", ["M3", "M4"])
def test_kernels_do_lines_with_a_changed_laser_power(beam: str, override: int) -> None:
    """override: of the spindle, in percent. A new S in a motion line needs no interpreter."""
    bench = Bench(laser=True, by_kernels=True)
    bench.machine.state.override_spindle(override)
    for text in (f"{beam}S100F300", "G1X1", "X2"):
        bench.effect_of(text)
    for text in ("X3S50", "X4S0", "X5S1000"):
        assert bench.done_by_kernels(text)
    assert bench.machine.modes.rates[modal.RPM] == 1000


speeds = st.decimals(0, 13000, places=3).map(lambda x: format(x, "f"))


@some(60)
@given(
    st.sampled_from((1000.0, 255.0, 12000.0, 1.0)),
    st.sampled_from((0.0, 1.0, 30.5, 1000.0)),
    st.integers(10, 200),
    st.booleans(),
    st.lists(st.one_of(speeds, st.just("0")), min_size=1, max_size=6),
)
def test_kernels_set_the_same_laser_power_as_the_spindle(
    max_rpm: float, min_rpm: float, override: int, is_dynamic: bool, powers: "list[str]"
) -> None:
    """The power in the planned block is that of Spindle.block_power(). is_dynamic: M4."""
    bench = Bench(laser=True, by_kernels=True, max_rpm=max_rpm, min_rpm=min_rpm)
    machine, planner = bench.machine, bench.machine.planner
    machine.state.override_spindle(override)
    for text in (f"{'M4' if is_dynamic else 'M3'}S1F300", "G1X1", "X2"):
        bench.effect_of(text)
    for i, power in enumerate(powers):
        assert bench.done_by_kernels(f"X{3 + i}S{power}")
        row, speed_before = list(planner.row() or ()), machine.state.spindle[RPM]
        rpm = machine.modes.rates[modal.RPM]
        assert rpm == pytest.approx(float(power), rel=1e-6)
        assert planner.speeds[planner.flow[layout.TAIL]] == rpm
        expected = machine.spindle.block_power(row[layout.FLAGS], rpm)
        assert row[layout.POWER] == expected
        assert machine.state.spindle[RPM] == speed_before  # set only when the block is executed
        planner.clear()


def test_kernels_do_lines_that_need_no_wait() -> None:
    bench = Bench(laser=False, by_kernels=True)
    for text in ("G1X1F500", "X2", "X3Y1N5", "X4F501", "G0X5", "G1X7F502", "T1", ""):
        assert bench.done_by_kernels(text), text
    for text in ("G90G21X9", "G90G94", "M5M9", "G91X1", "G20G90", "G21", "G18", "G19X7G91", "S9"):
        assert bench.done_by_kernels(text), text
    assert bench.machine.modes.rates[modal.FEED] == 502  # of F502, the last F


def test_kernels_do_lines_without_steps_except_of_a_beam_in_m3() -> None:
    """CAM software rounds to digits finer than a step. In M3 the beam takes the S of such a line
    at once, which the interpreter does."""
    for laser, modes, expected in (
        (False, "M3", 1),
        (True, "M5", 1),
        (True, "M4", 1),
        (True, "M3", 0),
    ):
        bench = Bench(laser, by_kernels=True)
        for text in (f"{modes}S100F300", "G1X1", "X2"):
            bench.effect_of(text)
        for text in ("X2", "X2.0001"):
            assert bench.done_by_kernels(text) == expected, (laser, modes, text)
            assert bench.machine.planner.empty()
        if expected:
            assert bench.machine.modes.position[0] == pytest.approx(2.0001)


def test_kernels_do_an_arc_of_a_single_chord() -> None:
    bench = Bench(laser=False, by_kernels=True)
    bench.effect_of("G91F500")
    for text in ("G2X0.1R5", "X0.1R5N3", "G3X-0.2Y0.1R900", "G2X0.1I0.05J-5F501"):
        assert bench.done_by_kernels(text), text
    for text in ("X1R5", "I0.5", "G93X0.1R5F3", "X0.1R0.04"):  # more chords, or errors
        assert not bench.done_by_kernels(text), text


def test_kernels_do_any_arc_in_check_mode_without_soft_limits() -> None:
    """Without soft limits no chord needs a check; with them the interpreter checks each."""
    bench = Bench(laser=False, by_kernels=True)
    bench.machine.state.enter(CHECK)
    assert bench.done_by_kernels("G2X100R90F500") and bench.done_by_kernels("G3X100I50Z3")
    bench.machine.settings.soft_limits = 1
    bench.machine.canon.configure()
    assert not bench.done_by_kernels("I-5")


def test_kernels_refuse_lines_that_wait_or_fail_and_change_nothing() -> None:
    bench = Bench(laser=False, by_kernels=True)
    bench.effect_of("G1X1F500")
    before = list(bench.machine.modes.modal), list(bench.machine.modes.position)
    left_to_interpreter = (
        "M3 G55 M8 M7 G4P1 G92X0 G28 M0 G2X2R5 X1X2 G18G19 G91G20X0Y1X2 S-1 Q1".split()
    )
    for text in left_to_interpreter:
        assert not bench.done_by_kernels(text), text
        assert (list(bench.machine.modes.modal), list(bench.machine.modes.position)) == before
