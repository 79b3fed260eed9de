"""The ESP32 without one: its stand-ins are as strict as its modules, and the firmware boots."""

import subprocess
import sys
from array import array
from collections.abc import Callable
from pathlib import Path

import pytest
from esp_bench import EspEngine, clock, esp32, esp_machine
from micropython_runner import needs_micropython, run_micropython

_BOOT = Path(__file__).parent / "esp_boot.py"
_BOARDS = ("mks_dlc32", "esp32_devkit", "esp32_s3")

_TALK = """\
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
> $21=1
ok
> G1 X20 F1200
ok
ALARM:1
[MSG:Reset to continue]
"""


def boot(*arguments: str) -> str:
    """What the firmware says under CPython."""
    command = [sys.executable, str(_BOOT), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("board", _BOARDS)
def test_the_firmware_boots_moves_and_stops_at_a_limit(board: str) -> None:
    said = boot(board)
    assert "Grbl 1.1h ['$' for help]" in said
    assert _TALK in said


@needs_micropython
@pytest.mark.parametrize("board", _BOARDS)
def test_it_does_so_under_micropython(board: str) -> None:
    assert _TALK in run_micropython(_BOOT, board)


def test_a_board_file_chooses_its_engine_in_one_line() -> None:
    assert _TALK in boot("mks_dlc32", "rmt")


# A buffer is filled in the timer's turn with the heap locked: what allocates would raise.
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
from esp import i2s

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

engine.attach(next_segment, print)
engine.start()
def fill():
    for _ in range(10):
        engine._make()
fill()
gc.collect()
micropython.heap_lock()
fill()
micropython.heap_unlock()
print("filled", rows > 4)
"""


@needs_micropython
def test_buffers_of_frames_are_filled_without_allocation() -> None:
    here = _BOOT.parent
    folders = (str(here.parent / "firmware"), str(here.parent), str(here / "shim"))
    assert "filled True" in run_micropython(_NO_ALLOCATION % folders)


# The stand-ins refuse what the hardware's modules refuse


def refused(what: "Callable[[], object]") -> bool:
    try:
        what()
    except (TypeError, ValueError):
        return True
    return False


def test_rmt_takes_lists_of_durations_that_the_hardware_has() -> None:
    channel = esp32.RMT(0, pin=esp_machine.Pin(4), resolution_hz=1_000_000)
    assert refused(lambda: channel.write_pulses(array("i", [5, 5])))  # type: ignore[arg-type]
    assert refused(lambda: channel.write_pulses([]))
    assert refused(lambda: channel.write_pulses([5, 32768]))
    assert refused(lambda: channel.write_pulses([5, 0, 5]))
    assert refused(lambda: channel.active(True))


def test_rmt_blocks_while_it_is_busy_and_miscounts_after_an_abort() -> None:
    channel = esp32.RMT(1, pin=esp_machine.Pin(5), resolution_hz=1_000_000)
    channel.write_pulses((10_000, 10), False)
    begun = clock.us
    channel.write_pulses((10, 10), False)
    assert clock.us - begun >= 9_900
    channel.write_pulses((10_000, 10), False)
    channel.active(False)
    channel.write_pulses((10, 10), False)
    clock.work(1000)
    assert not channel.wait_done()


def test_i2s_waits_unless_it_has_been_polled_and_timers_are_soft() -> None:
    engine = EspEngine("i2s")
    assert engine.idle()
    assert refused(lambda: esp_machine.Timer(1).init(period=1, hard=True))
    assert refused(lambda: esp_machine.Timer(7))
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
    begun = clock.us
    assert stream.write(bytearray(1024)) == 1024
    assert clock.us - begun >= 2000
    stream.fileno()
    assert [stream.write(bytearray(1024)) for _ in range(2)] == [0, 0]


def test_inputs_without_pull_ups_are_known() -> None:
    assert refused(lambda: esp_machine.Pin(36, esp_machine.Pin.IN, esp_machine.Pin.PULL_UP))
    assert refused(lambda: esp_machine.Pin(34, esp_machine.Pin.OUT))
