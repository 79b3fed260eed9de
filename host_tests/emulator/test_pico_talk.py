"""Test a sender at the emulated Pico: welcome, lines, settings, the prompt and back."""

from pathlib import Path
from statistics import median

import pytest
from emulated import Board

pytestmark = pytest.mark.xdist_group("pico talk")

_BOOT_US = 1_500_000  # with stored settings, which make the root of its file system longer
_HEAP_BYTES = 85_000


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Board:
    return Board(uf2, {"main.py": MAIN}).boot().settled()


# A user's command in main.py that reports the free memory.
MAIN = b"""
import gc

from boot import power_up

from talk import commands
usual = commands.Commands.find_command


def find_command(self, line, length):
    if line[1] == 77:
        gc.collect()
        self._report.message("free %d." % gc.mem_free())
    else:
        return usual(self, line, length)
    return lambda line, length: None


commands.Commands.find_command = find_command
rp2 = None  # as the firmware's own main.py
machine = power_up.run_machine(power_up.build())
"""


def test_eighty_five_kilobytes_of_heap_are_free(machine: Board) -> None:
    assert free_heap_bytes(machine) >= _HEAP_BYTES


def free_heap_bytes(machine: Board) -> int:
    """Return the free bytes of its heap."""
    return int(machine.ask("$M").partition("free ")[2].partition(".")[0])


def test_build_info_names_the_firmware(machine: Board) -> None:
    said = machine.ask("$I")
    assert "[VER:1.1h." in said and "[OPT:V," in said
    assert "Grbl" in said and "grblHAL" not in said


def test_every_setting_is_shown(machine: Board) -> None:
    said = machine.ask("$$")
    assert said.startswith("$0=10\r\n$1=25\r\n") and "$132=200.000\r\n" in said


def test_lines_are_answered_in_order(machine: Board) -> None:
    machine.clear_output()
    machine.send("G21\nG99\nG1 X1\n$G\nT1\n")
    said = machine.wait_for("[GC:")
    assert said.split("[GC:")[0] == "ok\r\nerror:20\r\nerror:22\r\n"


def test_status_report_while_idle_takes_at_most_five_milliseconds(machine: Board) -> None:
    """In most cases; 20 ms at the worst. Asked at changing phases of the firmware's timers."""
    took_us = []
    for k in range(9):
        machine.pico.run_us(7_300 + 410 * k)
        machine.clear_output()
        asked_us = machine.pico.us
        machine.send("?")
        machine.pico.run_until(lambda: ">\r\n" in machine.output, 50_000, step_us=50)
        assert machine.output.startswith("<Idle|MPos:0.000,0.000,0.000|FS:0,0")
        took_us.append(machine.pico.us - asked_us)
    assert median(took_us) <= 5_000 and max(took_us) <= 20_000


def test_ctrl_c_in_the_stream_stops_nothing(machine: Board) -> None:
    assert machine.ask("G90\x03") == "ok\r\n"
    machine.ask("G91 G1 X1 F600", limit_us=100_000)
    machine.send("\x03\x03\x03\x03")  # in motion the prompt is refused
    machine.until_idle()
    assert machine.status()["MPos"] == "1.000,0.000,0.000"


def test_sender_that_opens_the_port_again_is_welcomed(machine: Board) -> None:
    """Once, between 250 and 350 ms after it has opened the port."""
    machine.clear_output()
    machine.pico.usb.open_port(False)
    machine.pico.run_us(20_000)
    assert machine.output == ""
    machine.pico.usb.open_port(True)
    machine.pico.run_us(250_000)
    assert machine.output == ""  # senders need time to get ready
    machine.wait_for("Grbl 1.1h ['$' for help]\r\n", 100_000)
    machine.pico.run_us(50_000)
    assert machine.output.count("Grbl") == 1
    assert machine.ask("G90") == "ok\r\n"


def test_sender_that_sends_at_once_is_welcomed_before_its_answer(
    machine: Board,
) -> None:
    """The delay of the welcome ends with the first line."""
    machine.clear_output()
    machine.pico.usb.open_port(False)
    machine.pico.run_us(20_000)
    machine.pico.usb.open_port(True)
    machine.pico.run_us(20_000)
    said = machine.ask("G90")
    assert said.index("Grbl 1.1h") < said.index("ok\r\n")


def test_settings_survive_a_power_cut_and_the_start_is_fast(machine: Board, uf2: Path) -> None:
    """A setting, an offset, a startup line and a name: a second board starts with the first one's
    files."""
    for line in ("$110=1234.5", "G10 L2 P2 X-3.25", "$N0=G20", "$I=shed"):
        assert machine.ask(line) == "ok\r\n"
    second = Board(uf2)
    second.pico.put_file_system(machine.pico.flash_image())
    second.boot()
    assert second.pico.us < _BOOT_US
    assert second.output.startswith("\r\nGrbl 1.1h ['$' for help]\r\n")
    second.wait_for(">G20:ok\r\n")  # the startup line
    assert "$110=1234.500" in second.ask("$$")
    assert "[G55:-3.250,0.000,0.000]" in second.ask("$#")
    assert "SHED" in second.ask("$I")
    _prompt_and_back(second)


def _prompt_and_back(machine: Board) -> None:
    """Check that the watchdog (5 s) does not act at the prompt, and that the machine is
    unchanged."""
    printed = machine.python("print(machine.state.run, machine.planner.empty())")
    assert printed == "0 True\r\n"
    printed = machine.python_again("import time\ntime.sleep_ms(5500)\nprint(1 + 1)")
    assert printed == "2\r\n"
    machine.clear_output()
    machine.send("\x02\x04")  # leave the raw prompt; a soft reset runs main.py
    machine.wait_for(">G20:ok\r\n", 3_000_000)  # the startup line, after the welcome
    assert machine.ask("G90") == "ok\r\n"
