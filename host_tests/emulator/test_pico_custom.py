"""Test custom.py on the emulated Pico: it is a file there, and it can never lose a step.

Its words: M100 reports, M101 fails, M102 loops, M103 takes all memory, M104 swallows exceptions,
M105 calls itself, M106 allocates 8000 bytes.
"""

import re
import sys
from pathlib import Path

import pytest
from emulated import BOARD_FILE, DIR, SPINDLE_PWM, STEP, Board, Odometer, firmware
from ugrbl.compiling import build

sys.path.append(str(Path(__file__).resolve().parents[1] / "bench"))

from bench_setup import set_up
from streaming import idle, short_moves, stream
from wire import EmulatedWire, Talk

pytestmark = pytest.mark.xdist_group("pico custom")

CUSTOM = b"""
import time
from ugrbl import mcode, on, every, Refuse

seen = []

@mcode(100, "Pq")
def vacuum(m, P, Q=0):
    if P > 1:
        raise Refuse("P is 0 or 1")
    m.message("P%g Q%g at %s" % (P, Q, m.position()))

@mcode(101)
def fails(m):
    m.g("G91 G0 X0.4")
    return 1 // 0

@mcode(102)
def loops(m):
    while True:
        pass

@mcode(103)
def takes_memory(m):
    kept = []
    while True:
        kept.append(bytearray(10000))

@mcode(104)
def swallows(m):
    while True:
        try:
            m.wait(0.01)
        except Exception:
            pass

@mcode(105)
def calls_itself(m):
    calls_itself(m)

@mcode(106)
def reads_a_table(m):
    m.message("%d bytes" % len(bytearray(8000)))

@on.tool_change
def change(m, tool):
    with m.saved():
        m.g("G91 G0 Z0.4")
        m.keep["tool"] = tool

@on.state_change
def tell(m, old, new):
    seen.append(new)
    if len(seen) > 8:
        seen.pop(0)

@every(20)
def look(m):
    [n for n in range(40)]

@on.report
def field(m):
    return "Tc:%d" % m.keep.get("tool", 0)
"""


def board(uf2: Path) -> Board:
    return Board(uf2, {"custom.py": CUSTOM}).boot().settled()


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
    """Return a board with CUSTOM, its pins recorded."""
    made = board(uf2)
    made.pico.record([*STEP, *DIR, SPINDLE_PWM])
    return made


@pytest.fixture
def ready(machine: Board) -> "Board":
    """Reset and unlock the machine, whatever its state was."""
    machine.clear_output()
    machine.send("\x18")
    machine.wait_for("Grbl 1.1h")
    machine.ask("$X")
    return machine


def test_custom_file_is_read_at_start_and_leaves_memory_free(machine: Board) -> None:
    """M106 allocates 8000 bytes at once."""
    said = machine.ask("$I")
    assert "[MSG:Custom: M100, M101, M102" in said and "on.report]" in said
    assert "[MSG:8000 bytes]" in machine.ask("M106"), "a large block is free"


def test_words_are_called_with_their_numbers_after_motion_has_ended(ready: Board) -> None:
    """M100 has P and an optional Q: it reports both and the position, and refuses P over 1."""
    ready.ask("G91 G1 X0.8 F600")
    said = ready.ask("M100 P1")
    assert re.search(r"\[MSG:P1 Q0 at \([\d.-]+, [\d.-]+, [\d.-]+\)\]\r\nok", said)
    assert ready.status()["state"] == "Idle"
    assert "[MSG:P is 0 or 1]\r\nerror:3" in ready.ask("M100 P2", "error:3\r\n")
    assert ready.ask("M100 X1", "error:36\r\n")


def test_tool_change_is_stored_over_a_power_cut_and_reported(ready: Board, uf2: Path) -> None:
    """The file's tool change moves Z by 0.4 mm, restores the modes and stores the tool's number,
    which a second board with a copy of the flash reports as Tc."""
    before_mm = [float(mm) for mm in ready.status()["MPos"].split(",")]
    ready.ask("G90")
    ready.ask("T7 M6")
    ready.until_idle()
    after_mm = [float(mm) for mm in ready.status()["MPos"].split(",")]
    assert after_mm[2] - before_mm[2] == pytest.approx(0.4) and "G90" in ready.ask("$G")
    ready.pico.run_us(600_000)  # the number is written to flash
    ready.status()  # the field is computed for the next report
    assert ready.status()["Tc"] == "7"
    second = Board(uf2)
    second.pico.put_file_system(ready.pico.flash_image())
    second.boot()
    second.status()
    second.pico.run_us(50_000)
    assert second.status()["Tc"] == "7"


def test_failing_word_loses_no_step_and_names_file_and_line(ready: Board) -> None:
    """M101 moves X by 0.4 mm, 100 steps, and divides by 0: alarm 34, a reset, and a report."""
    odometer = Odometer(ready.pico)
    steps_before = odometer.read()
    said = ready.ask("M101", "Grbl 1.1h")
    message = re.search(r"\[MSG:(M101: custom.py, line \d+, in fails: ZeroDivisionErr.*)\]", said)
    assert message and "ALARM:34" in said
    assert [b - a for a, b in zip(steps_before, odometer.read())] == [100, 0, 0]
    assert message[1] in ready.ask("$I+")  # the last fault


@pytest.mark.parametrize(("line", "name"), [("M103", "takes_memory"), ("M105", "calls_itself")])
def test_exhausted_memory_or_stack_is_a_failure_like_others(
    ready: Board, line: str, name: str
) -> None:
    """It is reported with its line; then other words work. name: the function of the word."""
    said = ready.ask(line, "Grbl 1.1h", 20_000_000)
    is_reported = re.search(rf"\[MSG:{line}: custom.py, line \d+, in {name}: \w+", said)
    # An interrupt may have hit the full stack. MicroPython hangs while it reports that, and the
    # watchdog restarts the chip.
    assert is_reported or (line == "M105" and "Uncaught exception in IRQ" in said)
    ready.ask("$X")
    assert "P1 Q0" in ready.ask("M100 P1")


def test_reset_ends_a_handler_that_swallows_it(ready: Board) -> None:
    """M104 waits for ever, and catches every Exception."""
    ready.clear_output()
    ready.send("M104\n")
    ready.pico.run_us(200_000)
    ready.send("\x18")
    ready.wait_for("Grbl 1.1h")


def test_endless_loop_is_stopped_ended_by_a_reset_and_reported(ready: Board) -> None:
    """M102 loops for ever. After some 0.3 s the main loop counts as blocked, and the spindle is
    switched off; the first reset ends the loop, the second one the alarm."""
    ready.ask("M3 S500")
    ready.clear_output()
    ready.send("M102\n")
    ready.pico.run_us(400_000)
    ready.pico.edges.clear()  # the spindle's PWM would make edges
    ready.send("\x18")
    ready.wait_for("ALARM:16")
    ready.wait_for("in loops")
    assert not ready.pico.edges, "the spindle was off long before"
    ready.clear_output()
    ready.send("\x18")
    ready.wait_for("Grbl 1.1h")


def test_failure_during_streamed_arcs_stops_smoothly_and_loses_no_step(
    uf2: Path,
) -> None:
    """A handler that runs every 5 ms fails when Z is above 0.3 mm: the machine decelerates, and
    reports the position that follows from the steps."""
    failing_code = b"""
@every(5)
def fails_above(m):
    if m.position().z > 0.3:
        return [1][1]
"""
    machine = Board(uf2, {"custom.py": CUSTOM + failing_code}).boot().settled()
    machine.pico.record([*STEP, *DIR])
    for line in ("$0=3", "$120=4000", "$121=4000", "$122=4000", "$110=3000", "$111=3000"):
        machine.ask(line)
    odometer = Odometer(machine.pico)
    machine.ask("G91")
    machine.clear_output()
    machine.send("G2X1Y0I0.5J0Z0.2F3000\nG3X-1Y0I-0.5J0Z0.2\n" * 2)
    said = machine.wait_for("Grbl 1.1h", 5_000_000)
    assert re.search(r"\[MSG:every 5: custom.py, line \d+, in fails_above: IndexErr", said)
    assert "ALARM:34" in said and "ALARM:16" not in said
    steps = odometer.read()
    assert 0.3 * 250 < steps[2] < 0.6 * 250  # 250 steps/mm
    machine.ask("$X")
    reported_steps = [float(mm) * 250 for mm in machine.status()["MPos"].split(",")]
    assert reported_steps == pytest.approx(steps, abs=0.3)
    stack = re.search(r"Stack: (\d+) of", machine.ask("$I+"))
    assert stack and int(stack[1]) <= 8192 - 1024  # bytes; a reserve of 1 kB


def test_outputs_switch_and_make_pulses_until_a_reset(uf2: Path, tmp_path: Path) -> None:
    """There are as many outputs as a stack light has; a reset forces all of them off.

    M110 switches two of them. M111 makes pulses of 5000 Hz with the duty P at a third one.
    """
    pins = {"red": 20, "lamp": 21, "fan": 26, "horn": 27}
    file = tmp_path / "light.py"
    file.write_text(BOARD_FILE.read_text() + f"\nOUTPUTS = {pins}\n")
    words = b"""
from ugrbl import mcode

@mcode(110, "P")
def switch(m, P):
    m.out("red", P)
    m.out("horn", P)

@mcode(111, "P")
def share(m, P):
    m.pwm("fan", P, 5000)
"""
    # fromkeys(): None instead of each file of the common board.
    files = {**dict.fromkeys(firmware()), **build.for_board(file).files, "custom.py": words}
    machine = Board(uf2, files).boot().settled()
    machine.pico.record(list(pins.values()))
    machine.ask("M110 P1")
    machine.ask("M111 P0.25")
    machine.pico.run_us(1000)
    assert {edge.pin for edge in machine.pico.edges if edge.level} == {20, 26, 27}
    machine.pico.edges.clear()
    machine.pico.run_us(2000)
    ups = [edge.ns for edge in machine.pico.edges if edge.level]
    downs = [edge.ns for edge in machine.pico.edges if not edge.level]
    assert len(ups) == pytest.approx(10, abs=1)  # 2 ms of 5000 Hz
    # The first falling edge may end a pulse that had begun before.
    lengths_ns = [down - up for up, down in zip(ups, downs[downs[0] < ups[0] :])]
    # A quarter of 200 us.
    assert lengths_ns == pytest.approx([50_000] * len(lengths_ns), abs=100)
    machine.clear_output()
    machine.send("\x18")
    machine.wait_for("Grbl 1.1h")
    machine.pico.edges.clear()
    machine.pico.run_us(2000)
    assert not machine.pico.edges, "all are off"
    machine.ask("M110 P1")  # they work again after the reset
    machine.ask("M111 P1")
    machine.pico.run_us(1000)
    assert {edge.pin for edge in machine.pico.edges if edge.level} == {20, 26, 27}


_WORD = b"from ugrbl import mcode\n@mcode(100)\ndef f(m): pass\n"
_TIMER = b"""
import time
from ugrbl import every, mcode
calls = [0]
@every(50)
def f(m):
    calls[0] += 1
    time.sleep_us(1000)
@mcode(100)
def told(m):
    m.message("%d calls" % calls[0])
"""


def start_and_measure(uf2: Path, words: "bytes | None") -> "tuple[Talk, float]":
    """Start a board with this custom.py, or none; return it and its rate of short moves, 1/s."""
    talk = Talk(EmulatedWire(Board(uf2, {"custom.py": words}).boot().settled()))
    set_up(talk)
    # 63 blocks are in the planner. Objects that are created once exist afterwards.
    stream(talk, list(short_moves(300)), blocks=63)
    idle(talk)
    for line in ("G90", "G0X10Y10"):
        talk.ask(line)
    idle(talk)
    return talk, stream(talk, list(short_moves(800)), blocks=63).lines_s


def test_unused_word_costs_little_and_a_timer_its_own_time(uf2: Path) -> None:
    """Measured by the highest rate of streamed lines: without a custom.py, with a word, and with a
    function that is called every 50 ms and takes 1 ms."""
    _, plain_lines_s = start_and_measure(uf2, None)
    _, word_lines_s = start_and_measure(uf2, _WORD)
    assert word_lines_s > 0.98 * plain_lines_s
    talk, timer_lines_s = start_and_measure(uf2, _TIMER)
    assert timer_lines_s > 0.9 * word_lines_s  # 20 calls a second of 1 ms, and the overhead
    before = timer_calls(talk)
    stream(talk, list(short_moves(800)), blocks=63)
    ms = 800 / timer_lines_s * 1000
    assert timer_calls(talk) - before >= 0.8 * ms / 50, "the timer runs during an endless stream"


def timer_calls(talk: Talk) -> int:
    return int(talk.ask("M100").partition("MSG:")[2].split()[0])
