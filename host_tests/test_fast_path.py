"""The short path of lines that only move: the same as the long one, and only for such lines."""

from array import array
from itertools import product
from types import SimpleNamespace
from typing import Any

import pytest
from base.errors import INVALID_JOG_COMMAND, GrblError
from base.state import IDLE, RPM
from boot import wiring
from control import modes as modal
from hypothesis import example, given
from hypothesis import strategies as st
from language.fast_kernel import (
    AXES,
    CHANGED,
    FEED,
    HAS_G0,
    HAS_G1,
    LASER,
    LINE_INCHES,
    LINE_PLANE,
    MODE,
    OFFSETS,
    SAME,
    VALUES,
    read,
    set_in_force,
)
from language.fast_path import FastPath
from laws import some
from motion import layout
from oracle import read_words
from test_words import bits, pieces
from ugrbl.run import machine
from ugrbl.run.program import ProgramLink

# Words of how numbers are meant, by their group.
GROUPS = {**dict.fromkeys((17, 18, 19), 2), 90: 3, 91: 3, 20: 6, 21: 6}
IN_FORCE = (modal.PLANE, modal.RELATIVE, modal.INCHES, modal.COOLANT)
METRIC = (0, 0, 0, 0)
in_force = st.tuples(*[st.integers(0, most) for most in (2, 1, 1, 3)])
said = st.sampled_from("G17 G18 G19 G20 G21 G90 G91 M5 M7 M8 M9 G94 G1 X1 F500".split())
modes = st.tuples(st.sampled_from([HAS_G0, HAS_G1]), st.booleans(), st.sampled_from([0.0, 500.0]))


def words_in_force(plane: int, relative: int, inches: int, coolant: int) -> "set[str]":
    """Those that set_in_force() is to find, of a spindle that stands still."""
    meant = {f"G{17 + plane}", f"G{90 + relative}", f"G{21 - inches}"}
    return meant | set("G40 G54 G61 G94 M5".split()) | {("M9", "M8", "M7", "")[coolant]}


@given(st.lists(st.one_of(pieces, said), max_size=6).map("".join), modes, in_force)
@example("N10000000X1", (HAS_G0, False, 0.0), METRIC)
@example("N9999999X1", (HAS_G0, False, 0.0), METRIC)
@example("G1X1F-1", (HAS_G1, False, 500.0), METRIC)
@example("G1X1F500", (HAS_G1, False, 500.0), METRIC)
@example("X1F0", (HAS_G1, False, 500.0), METRIC)
@example("G1X1S5", (HAS_G0, True, 500.0), METRIC)
@example("G1X1S5", (HAS_G1, False, 500.0), METRIC)
@example("G00X-0F-0", (HAS_G0, False, 0.0), METRIC)
@example("[1", (HAS_G0, False, 0.0), METRIC)
@example("G20G1X1F500G91", (HAS_G1, False, 500.0), METRIC)
@example("G90G91X1", (HAS_G0, False, 0.0), METRIC)
@example("G21G90.1", (HAS_G0, False, 0.0), METRIC)
@example("G91G21", (HAS_G0, False, 0.0), METRIC)
@example("G18G91M8X1", (HAS_G0, False, 0.0), (2, 1, 0, 1))
@example("M7M8", (HAS_G0, False, 0.0), (0, 0, 0, 3))
@example("G17G18", (HAS_G0, False, 0.0), METRIC)
@example("G21X1F500", (HAS_G1, False, 500.0), (0, 0, 1, 0))
def test_a_plain_line_holds_nothing_that_could_be_wrong(
    text: str, modes: "tuple[int, bool, float]", in_force: "tuple[int, int, int, int]"
) -> None:
    mode, laser, feed = modes
    known = array("i", [0] * (OFFSETS + 6))
    known[AXES], known[MODE], known[LASER], known[FEED] = 6, mode, laser, bits(feed)
    modal_state = array("i", [0] * modal.MODAL_ROOM)
    for place, value in zip(IN_FORCE, in_force):
        modal_state[place] = value
    set_in_force(known, modal_state)
    seen = read(bytearray(text.encode() + b"\0"), 0, len(text), known)
    if seen <= 0:
        return
    words, fault = read_words(text)
    same = [word for word in words if f"{word[0]}{word[1]:g}" in words_in_force(*in_force)]
    meant = [v for letter, v in words if letter == "G" and v in GROUPS and (letter, v) not in same]
    assert bool(seen & CHANGED) == bool(meant)
    groups = [GROUPS[v] for letter, v in words if letter == "G" and v in GROUPS]
    assert len(set(groups)) == len(groups) and len(set(same)) == len(same)
    assert known[LINE_PLANE] == ([v for v in meant if GROUPS[v] == 2] or [17 + in_force[0]])[0]
    in_inches = ([21 - v for v in meant if GROUPS[v] == 6] or [in_force[2]])[0]
    assert known[LINE_INCHES] == in_inches
    found = [
        word for word in words if word not in same and (word[0] != "G" or word[1] not in meant)
    ]
    letters = [letter for letter, _ in found]
    assert not fault
    if seen & SAME:
        assert not letters
        return
    assert set(letters) & set("XYZABC")
    assert len(set(letters)) == len(letters)
    assert set(letters) <= set("GXYZABCFNS")
    for letter, value in found:
        bit = {"F": 0, "S": 1, "N": 2, "G": 3 + int(value)}.get(letter)
        assert letter != "G" or value in (0, 1)
        assert letter not in "FNS" or value >= 0
        assert letter != "N" or value < 10_000_000
        bit = "XYZABC".index(letter) + 5 if bit is None else bit
        other_feed = value != feed or in_inches
        is_new = {"F": other_feed, "G": bit and 1 << bit != mode}.get(letter, True)
        assert seen >> bit & 1 == is_new
        assert letter == "G" or known[VALUES + bit] & 0xFFFFFFFF == bits(value)
    values = dict(found)
    cuts = values.get("G", mode == HAS_G1) == 1
    assert values.get("F", feed) or not cuts
    assert "S" not in values or (laser and cuts)


class Bench:
    """A machine that is told lines and never moves: what it plans is looked at, and forgotten."""

    def __init__(
        self,
        laser: bool,
        short: bool,
        most: float = 1000.0,
        least: float = 0.0,
        mist: bool = False,
    ) -> None:
        self._short = short

        rig = machine.build("sim", lambda rig: ProgramLink(rig, lambda _link: iter(())))
        board = SimpleNamespace(**{**vars(rig.board), "LINE_NUMBERS": True, "MIST": mist})
        self.machine = wiring.build(board, rig.link, rig.port, rig.engine, rig.store)
        self.machine.settings.load()
        settings = self.machine.settings
        settings.laser_mode, settings.max_rpm, settings.min_rpm = int(laser), most, least
        self.machine.configure()
        self.machine.planner.override()
        self.machine.canon.service = self.machine.planner.clear  # whoever waits finds room
        self.machine.drive.start = self.machine.state.enter  # type: ignore[method-assign]
        if not short:
            fast = vars(self.machine.interpreter.fast)
            fast["execute"] = fast["jog"] = lambda _line, _length: False
            fast["go"] = lambda _block: 0

    def tell(self, text: str) -> "tuple[Any, ...]":
        """Everything that comes of a line."""
        gcode, planner = self.machine.interpreter, self.machine.planner
        line = bytearray(text.encode() + b"\0")
        fault = 0
        try:
            if text.startswith("$J="):
                gcode.jog(line, len(text))
            elif not (self._short and gcode.fast.follow(line, len(text))):
                if text:  # of an empty line no interpreter hears
                    gcode.execute(line, len(text))
        except GrblError as refusal:
            fault = refusal.code
        row = [] if planner.empty() else list(planner.row() or ())
        modes = self.machine.modes
        found = (fault, list(modes.position), list(modes.rates), modes.tool, row)
        speed = planner.speeds[planner.flow[layout.TAIL]] if row else 0
        rest = (
            self.machine.commands.modes(),
            list(planner.position),
            speed,
            self.machine.state.spindle[RPM],
            self.machine.state.run,
        )
        planner.clear()
        self.machine.state.enter(IDLE)
        return found, rest


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
other = st.sampled_from(
    "G91 G90 G20 G21 G92X1.1Y-3 G92.1 F300 S500 M3S200 M4 M5 T2 G43.1Z0.3 G49 G55 G54 G10L2P2X0.7 "
    "G93 G94 G2X1Y1R5 G3X2Z1R5 G2Y1Z2R5 G80 X1X2 M7 M8 M9 M7M8 M8M9 G18 G19 G17".split()
)
tail = st.sampled_from(["", "", "", "F200", "F700", "S100", "N12", "S0", "Z1", "F0", "Z-0.0001"])
program = st.lists(
    st.one_of(*[st.tuples(repeated, simple, tail, repeated).map("".join)] * 4, other, jog),
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
@example(["G93", "G1X1F9", "X2F9", "X3", "G20", "X4F5", "G0X0", "G0X1F3", "G94"], False, True)
@example(["F9", "G1X1", "G93X2F3", "X3F3", "G93X4F4", "G94X5", "G94X5F5", "X6"], True, True)
def test_the_short_path_does_what_the_long_one_does(
    lines: "list[str]", laser: bool, mist: bool
) -> None:
    compare(lines, laser, mist)


@pytest.mark.parametrize("plane", PLANES)
def test_words_of_planes_in_every_combination(plane: str) -> None:
    words = ["", *PLANES, "G91", "M8", "G4"]
    lines = [
        line
        for one, other in product(words, words)
        for move in ("", "X1", "X", "G2X1Y0Z0R9")  # done, refused, and an arc of that plane
        for line in (f"{one}{other}{move}", "X1")
    ]
    compare(["F300", "G1X1", "M8", plane, *lines])
    # A jog may have none, not even that which is in force.
    compare([plane, *[f"$J={word}G91X1F50" for word in PLANES], *[f"$J=X1{plane}F50"], "X1"])
    assert Bench(False, True).tell(f"$J={plane}G91X1F50")[0][0] == INVALID_JOG_COMMAND


@pytest.mark.parametrize("mist", [True, False])
def test_words_of_coolant_in_every_combination(mist: bool) -> None:
    words = ["M7", "M8", "M9", "M7M8", "M8M7", "M8M8", "M9M8"]
    lines = [
        line
        for before, now in product(words, words)
        for line in ("M9", before, "X1", now, f"{now}X2", f"X1{now}G18", "X2")
    ]
    compare(["F300", "G1X1", *lines], mist=mist)


def compare(lines: "list[str]", laser: bool = False, mist: bool = False) -> None:
    """Both paths say and do the same."""
    short, long = Bench(laser, True, mist=mist), Bench(laser, False, mist=mist)
    for line in lines:
        assert short.tell(line) == long.tell(line), line


@pytest.mark.parametrize("override", [100, 50])
@pytest.mark.parametrize("beam", ["M3", "M4"])
def test_another_power_of_the_beam_takes_the_short_path(beam: str, override: int) -> None:
    bench = Bench(True, True)
    bench.machine.state.override_spindle(override)
    for text in (f"{beam}S100F300", "G1X1", "X2"):
        bench.tell(text)
    plain = bench.machine.interpreter.fast
    for text in (b"X3S50", b"X4S0", b"X5S1000"):
        assert plain.follow(bytearray(text + b"\0"), len(text)) == 1
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
def test_the_short_path_gives_the_beam_the_power_that_the_spindle_says(
    most: float, least: float, override: int, follows: bool, powers: "list[str]"
) -> None:
    bench = Bench(True, True, most, least)
    machine, planner = bench.machine, bench.machine.planner
    machine.state.override_spindle(override)
    for text in (f"{'M4' if follows else 'M3'}S1F300", "G1X1", "X2"):
        bench.tell(text)
    for i, power in enumerate(powers):
        text = f"X{3 + i}S{power}".encode()
        assert machine.interpreter.fast.follow(bytearray(text + b"\0"), len(text)) == 1
        row, speed = list(planner.row() or ()), machine.state.spindle[RPM]
        rpm = machine.modes.rates[modal.RPM]
        assert rpm == pytest.approx(float(power), rel=1e-6)
        assert planner.speeds[planner.flow[layout.TAIL]] == rpm
        due = machine.spindle.block_power(row[layout.FLAGS], rpm)
        assert row[layout.POWER] == due
        assert machine.state.spindle[RPM] == speed
        planner.clear()


def test_lines_after_the_second_of_their_kind_take_the_short_path() -> None:
    bench = Bench(False, True)
    for text in ("G1X1F500", "X2"):
        bench.tell(text)
    plain = bench.machine.interpreter.fast
    assert isinstance(plain, FastPath)
    assert plain.follow(bytearray(b"X3Y1N5\0"), 6) == 1
    for text in (b"X4F501", b"G0X5", b"X6", b"G1X7F502", b"X8F503N6"):
        assert plain.follow(bytearray(text + b"\0"), len(text)) == 1
    assert bench.machine.modes.rates[modal.FEED] == 503
    planned = bench.machine.planner.free()
    assert plain.follow(bytearray(b"\0"), 0) == 1 and bench.machine.planner.free() == planned
    for text in (b"G90G21X9", b"G90G94", b"M5M9", b"G91X1", b"G20G90", b"G21"):
        assert plain.follow(bytearray(text + b"\0"), len(text)) == 1
    bench.machine.planner.clear()
    for text in (b"G18", b"G19X7G91", b"G18X1", b"G17G90", b"G17"):
        assert plain.follow(bytearray(text + b"\0"), len(text)) == 1
    assert bench.machine.modes.modal[modal.PLANE] == 0
    for text in (b"G91G20X0", b"G90G90X1", b"M3", b"G55", b"G18G19", b"G17G17", b"M8", b"M7"):
        assert plain.follow(bytearray(text + b"\0"), len(text)) == 0
    bench.machine.state.change()
    assert plain.follow(bytearray(b"X9\0"), 2) == 0
    bench.machine.state.change()
    for text in ("M8", "X9", "X8"):
        bench.tell(text)
    for text in (b"M8", b"M8X7", b"G18M8"):
        assert plain.follow(bytearray(text + b"\0"), len(text)) == 1
