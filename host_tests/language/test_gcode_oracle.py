"""Random lines get the error number that an independent implementation of the rules gives."""

from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from laws import some
from motion import layout
from oracle import Oracle
from rig_bench import Machine

# Words


def word(letters: str, *numbers: str) -> st.SearchStrategy:
    return st.tuples(st.sampled_from(letters), st.sampled_from(numbers)).map("".join)


G_CODES = (
    "0 1 2 3 4 10 17 18 19 20 21 28 28.1 30 30.1 38.2 38.3 38.4 38.5 40 43.1 49 53 54 55 56 57 58 "
    "59 61 80 90 91 91.1 92 92.1 93 94"
).split()
ODD_CODES = (
    "5 0.004 0.005 4.1 17.5 28.2 38 38.6 43 43.2 49.1 59.1 61.1 90.1 91.2 92.3 256 -1"
).split()
M_CODES = "0 1 2 3 4 5 8 9 30".split()
lengths = ("0", "1", "-2", "0.5", "-.25", "2.5", "3", "-1.125")
geometry = st.one_of(
    word("XYZ", *lengths), word("XYZ", *lengths), word("IJK", *lengths), word("R", *lengths)
)
values = st.one_of(
    word("F", "0", "100", "2000.5", "-1"),
    word("S", "0", "500", "-2"),
    word("T", "1", "255", "256", "-1"),
    word("N", "1", "10000000", "10000001", "-5"),
    word("P", "0", "1", "2", "6", "7", "1.9", "257", "-1"),
    word("L", "2", "20", "0", "21", "276"),
)
g_words = st.one_of(
    st.sampled_from(G_CODES).map("G{}".format),
    st.sampled_from(["G0", "G1", "G2", "G3", "G10L2P1", "G10L20P2", "G28", "G53", "G43.1", "G92"]),
)
odd_words = st.one_of(
    st.sampled_from(ODD_CODES).map("G{}".format),
    st.sampled_from(
        ["M6", "M7", "M3.1", "M256", "A1", "E2", "H0", "U1", "X", "Y-", "=", "$", "1"]
    ),
    st.sampled_from(["X1X2", "G1G2", "M3M4", "F1F2", "G", "Z.", "X1.2.3", "Q1"]),
)
usual_lines = st.tuples(
    st.lists(g_words, max_size=2),
    st.lists(geometry, max_size=3),
    st.lists(values, max_size=1),
).map(lambda parts: [*parts[0], *parts[1], *parts[2]])
any_lines = st.lists(
    st.one_of(
        g_words, geometry, geometry, values, odd_words, st.sampled_from(M_CODES).map("M{}".format)
    ),
    min_size=1,
    max_size=7,
)
arcs = st.tuples(
    st.sampled_from(["G2", "G3"]),
    st.sampled_from(["X2", "Y-1", "X1Y1", "X-2Z1", "Y2Z-2", "Z1"]),
    st.sampled_from(["I1", "J-.5", "I.5J.5", "K1", "R1", "R-2", "R.5", "I-1K.5", ""]),
).map(list)
lines = (
    st.one_of(usual_lines, usual_lines, any_lines, arcs)
    .map("".join)
    .filter(lambda line: not line.startswith("$"))  # that would be a command
)
jogs = st.tuples(
    st.lists(st.sampled_from(["G20", "G21", "G90", "G91", "G53"]), max_size=2),
    st.lists(geometry, max_size=2),
    st.sampled_from(["F3000", "F3000", "F100", ""]),
    st.lists(st.one_of(g_words, values, odd_words), max_size=1),
).map(lambda parts: "$J=" + "".join([*parts[0], *parts[1], parts[2], *parts[3]]))


# The machine's side


def whole_state(machine: Machine) -> "dict[str, Any]":
    """Return all state that a refused line must not change."""
    controller: Any = machine.rig.controller
    modes, coords, planner = controller.modes, controller.coords, controller.planner
    state: dict[str, Any] = {
        "modes": list(modes.modal),
        "rates": list(modes.rates),
        "tool": modes.tool,
        "position": list(modes.position),
        "systems": [list(system) for system in coords.systems],
        "g92": list(coords.g92),
        "length": (coords.tool_length, coords.active),
        "settings": [(number, value) for number, value, _ in controller.settings.each()],
        "planned": (list(planner.position), planner.flow[layout.HEAD]),
        "kept": {name: list(kept) for name, kept in machine.rig.store.files.items()},
        "state": controller.state.run,
        "pins": {n: v for n, v in vars(machine.rig.port).items() if not n.startswith("_")},
    }
    return state


def check_equal(machine: Machine, oracle: Oracle) -> None:
    """Check that the firmware and the oracle are in the same state."""
    controller: Any = machine.rig.controller
    modes, coords = controller.modes, controller.coords
    modes_text = controller.commands.modes()
    assert modes_text[: modes_text.index(" F")] == oracle.modes()
    assert list(modes.rates)[:2] == [oracle.feed, oracle.speed]
    assert list(modes.position) == list(oracle.position.values())
    numbers = (54, 55, 56, 57, 58, 59, 28, 30)
    assert [list(s) for s in coords.systems] == [
        list(oracle.systems[number].values()) for number in numbers
    ]
    assert list(coords.g92) == list(oracle.g92.values())
    assert coords.tool_length == oracle.length


def compare(machine: Machine, oracle: Oracle, program: "list[str]", first: str) -> None:
    """Play the program after the line `first`; check that every answer and the state after it
    match the oracle's."""
    before: dict[str, Any] = {}

    def check_answer(line: str, replies: "list[str]") -> None:
        """Check the answer to a line, and that a refused line has changed nothing."""
        if line == first:
            assert replies[-1] == "ok"
        else:
            expected = oracle.judge(line)
            answer = [reply for reply in replies if not reply.startswith("[MSG:")]
            assert answer == [f"error:{expected}" if expected else "ok"], line
            if expected:
                assert whole_state(machine) == before, f"{line} was refused, yet left a trace"
            check_equal(machine, oracle)
        before.clear()
        before.update(whole_state(machine))

    machine.converse([first, *(line for line in program if line)], check_answer)


@some(60)
@given(st.lists(lines, min_size=4, max_size=16))
@example(["G38.2Z-1F10", "G38.2Z-1F10", "G91G38.5X1"])
@example(["G10L2P2X1", "G55", "M2", "G0X0", "G54X0"])
@example(["G20F10", "G93G1X1F2", "G94G1X2", "G94F3", "X3"])
@example(["G43.1Z1", "G0Z0", "G92Z0", "G10L20P0Z0", "G49", "Z0"])
def test_random_lines_get_the_error_of_the_rules(program: "list[str]") -> None:
    """After $C: in check mode nothing moves."""
    compare(Machine(), Oracle(), program, first="$C")


@some(15)
@given(st.lists(st.one_of(jogs, jogs, st.sampled_from(["G20", "G91", "G92X1"])), max_size=8))
@example(["$J=", "$J=X1", "$J=G1X1F100", "$J=G53X1F1000", "$J=M3X1F100", "$J=X1F100S2"])
def test_random_jogs_get_the_error_of_the_rules(program: "list[str]") -> None:
    # fast, so that jogs end soon
    rates = {110 + i: 30_000.0 for i in range(3)} | {120 + i: 5000.0 for i in range(3)}
    compare(Machine(rates), Oracle(), program, first="G21")


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("G38X1", 20),
        ("G59.1", 23),
        ("G0G1", 24),
        ("G256", 23),
        ("X1X1", 25),
        ("G1X1", 22),
        ("G10X1", 28),
        ("G10L2P7X1", 29),
        ("G53G2X1I1F1", 30),
        ("G80X1", 31),
        ("G2Z1I1F1", 32),
        ("G2X1R.1F1", 34),
        ("G2X1F1", 35),
        ("X1P1", 36),
        ("G43.1X1", 37),
        ("T256", 38),
    ],
)
def test_the_oracle_gives_the_recorded_errors(line: str, code: int) -> None:
    assert Oracle().judge(line) == code


# Bytes that are not lines

any_bytes = st.one_of(
    st.binary(max_size=60),
    st.text("GMXYZFSTNP$JIR=.-+0123456789 ()%;/~!?\x18\n\r", max_size=80).map(str.encode),
    st.lists(lines, max_size=4).map("\n".join).map(str.encode),
)


def play(machine: Machine, data: bytes) -> bool:
    """Send bytes, 100 at a time, whatever comes back; return whether the machine is idle at the
    end."""
    rig = machine.rig

    def script() -> Any:
        """Send 100 bytes at a time; wait up to 3 s after each for an idle machine."""
        yield from machine.start()
        for start in range(0, len(data), 100):
            rig.link.send(data[start : start + 100])
            deadline = rig.ms(3000)
            yield rig.ms(40)
            while not machine.idle() and rig.now < deadline:
                yield rig.ms(40)
        yield rig.ms(1500)  # after an alarm nothing is sent for half a second
        is_idle.append(machine.idle())

    is_idle: list[bool] = []
    machine.run(script())
    machine.take()
    return is_idle[0]


def count_answers(machine: Machine) -> int:
    return sum(line == "ok" or line.startswith("error:") for line in machine.received)


@some(40)
@given(any_bytes)
@example(b"$RST=*\n\x18?$$\n")
@example(b"$RST=#\n")
@example(b"G21G17G38.2X1F100")
@example(b"$N0=G0X1\n\x18\n")
@example(b"$SLP\n?\x18\n")
@example(b"(" + bytes(range(128, 256)) + b")\n")
@example(b"$I=" + b"\xc3" * 60 + b"\n$I\n")
def test_random_bytes_are_answered_line_by_line(data: bytes) -> None:
    data += b"\n"
    machine = Machine()
    is_idle = play(machine, data)
    ends = sum(data.count(c) for c in (b"\n", b"\r"))
    assert count_answers(machine) <= ends
    # without the welcome at the start
    resets = sum(line.startswith("Grbl ") for line in machine.received) - 1
    if is_idle and not resets:  # a reset discards the waiting lines
        assert count_answers(machine) == ends


# Beyond single precision

_HUGE = 45 * "9"


@pytest.mark.parametrize("line", ["G", "M", "N", "L", "G10L2X1P", "$0=", "$4=", "$N", "$J=F1X1N"])
def test_a_code_beyond_single_precision_is_answered(line: str) -> None:
    machine = Machine()
    play(machine, f"{line}{_HUGE}{'=' if line == '$N' else ''}\n".encode())
    assert count_answers(machine) == 1


@pytest.mark.parametrize("check_mode", [False, True])
@pytest.mark.parametrize(
    "line",
    [
        *("G0X", "G1F9X", "G1X1F", "M3S", "G92X", "G10L2P1X", "G43.1Z", "G20G0X", "G91X", "T"),
        *("$100=", "$110=", "$120=", "$11=", "$12=", "$30=", "$", "$J=F1X", "$J=X1F"),
        *("G2I1F9X", "G2F9I1Z", "G93G1X1F", "G38.2F9X"),
        "G2X1F9I",
        "G2F9X1R",
    ],
)
def test_a_value_beyond_single_precision_is_answered(line: str, check_mode: bool) -> None:
    """A huge value is an error or not: the firmware must survive it, and report afterwards."""
    machine = Machine()
    lines_after = "G1X1F99\nG91X1\nG2I1\n$#\n$G\n?"
    play(machine, f"{'$C' * check_mode}\n{line}{_HUGE}\n{lines_after}".encode())
    assert machine.received
