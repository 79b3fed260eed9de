"""Test jobs on an SD card at an SPI bus of the emulated Pico."""

from collections.abc import Callable
from pathlib import Path

import pytest
from emulated import BOARD_FILE, DIR, SPINDLE_PWM, STEP, Board, Odometer, firmware
from micropython_runner import needs_micropython, run_micropython
from sd_model import SdCard
from test_pico_jobs import push
from test_pico_stack import STACK_BYTES, Stack
from ugrbl.compiling import build

pytestmark = [pytest.mark.xdist_group("pico card"), needs_micropython]

_SCRIPT = Path(__file__).parents[1] / "support" / "fat_image.py"
_BLOCKS = 8192  # of 512 bytes
_BUS, _PINS = 1, (26, 27, 28, 21)  # SPI 1: SCK, MOSI, MISO, CS
_SETTINGS = ("$100=100", "$101=100", "$110=6000", "$111=6000", "$120=500", "$121=500")
_LINES = 150
# Stack reserve in bytes. MicroPython's FAT goes deeper than the 2 kB limit allows, and the number
# and depth of interrupts on top of it depend on their phase.
_RESERVE_BYTES = 1536
_TEXT = "".join(f"G1X{i % 7 * 0.3:.2f}Y{i % 5 * 0.4:.2f}F3000 (line {i})\n" for i in range(_LINES))
_JOB = f"M3S500\n{_TEXT}M5\n".encode()


def card_with(tmp_path: Path, files: "dict[str, bytes]") -> SdCard:
    """Return a card with these files, as a computer formats it."""
    folder, image = tmp_path / "files", tmp_path / "card"
    folder.mkdir()
    for name, data in files.items():
        (folder / name).write_bytes(data)
    run_micropython(_SCRIPT, image, "make", _BLOCKS, folder, heapsize="32M")
    return SdCard(bytearray(image.read_bytes()))


def files_on(tmp_path: Path, card: SdCard) -> "dict[str, bytes]":
    """Return the files that a computer finds on the card."""
    folder, image = tmp_path / "found", tmp_path / "card"
    folder.mkdir()
    image.write_bytes(card.image)
    run_micropython(_SCRIPT, image, "read", folder, heapsize="32M")
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def start_with_card(uf2: Path, tmp_path: Path, card: SdCard) -> Board:
    """Start a Pico with a card holder and this card; a byte takes the time of the bus clock."""
    file = tmp_path / "my.py"
    text = BOARD_FILE.read_text()
    file.write_text(f'{text}\nJOBS = "jobs"\nSD_CARD = {_PINS}\n')
    # fromkeys(): None instead of each file of the common board.
    machine = Board(uf2, {**dict.fromkeys(firmware()), **build.for_board(file).files})
    machine.pico.record([*STEP, *DIR, SPINDLE_PWM])
    bus, clock = machine.pico.mcu.spi[_BUS], machine.pico.clock
    received: list[int] = []  # the byte in transit from the card
    done = clock.create_alarm(lambda: bus.complete_transmit(received.pop()))

    def transmit(byte: int) -> None:
        """Exchange a byte with the card; it is complete after 8 bits, in ns."""
        received.append(card.exchange(byte))
        done.schedule(8e9 / bus.clock_frequency)

    bus.on_transmit = transmit
    machine.pico.mcu.gpio[_PINS[-1]].add_listener(chip_select_listener(card))
    machine.boot().settled()
    for setting in _SETTINGS:
        machine.ask(setting)
    return machine


def chip_select_listener(card: SdCard) -> "Callable[[object, object], None]":
    """Return a listener of the chip select pin: low selects the card."""

    def on_change(new: object, _old: object) -> None:
        card.select(new.name == "LOW")

    return on_change


def test_job_runs_from_a_card(uf2: Path, tmp_path: Path) -> None:
    """The list has only G-code files whose names have no space. The job ends at its last target,
    at 100 steps/mm."""
    card = card_with(tmp_path, {"part.nc": _JOB, "a name.nc": b"", "other.txt": b"1"})
    machine = start_with_card(uf2, tmp_path, card)
    listing = machine.ask("$F")
    assert f"[FILE:/part.nc|SIZE:{len(_JOB)}]" in listing and "other.txt" in listing
    assert "a name" not in listing and "Free space: " in listing
    odometer, stack = Odometer(machine.pico), Stack(machine)
    stack.start_measuring()
    machine.clear_output()
    machine.send("$F=part.nc\n")
    machine.wait_for(f"Job PART.NC: done, {_LINES + 2} lines", 60_000_000)
    last_line = _TEXT.splitlines()[-1]
    x, y = (float(last_line.partition(axis)[2][:4]) for axis in "XY")  # mm
    assert odometer.read() == [round(100 * x), round(100 * y), 0]
    assert stack.most_used() <= STACK_BYTES - _RESERVE_BYTES


def test_removed_card_stops_the_job_and_another_card_runs(uf2: Path, tmp_path: Path) -> None:
    """Removed 300 ms after the start: motion ends and the spindle is off."""
    card = card_with(tmp_path, {"part.nc": _JOB})
    machine = start_with_card(uf2, tmp_path, card)
    machine.send("$F=part.nc\n")
    machine.wait_for("Job PART.NC: begins")
    machine.pico.run_us(300_000)
    card.is_in = False
    machine.wait_for("cannot be read", 20_000_000)
    assert machine.status()["state"] == "Idle"
    machine.pico.run_us(1_000)
    machine.pico.edges.clear()  # the spindle's PWM would make edges
    machine.pico.run_us(20_000)
    assert not machine.pico.edges, "the spindle is on"
    assert "SD card is missing" in machine.ask("$F", "error:3\r\n")
    card.power_off()
    card.is_in = True
    assert "/part.nc" in machine.ask("$F")


def test_file_sent_over_the_line_is_readable_by_a_computer(uf2: Path, tmp_path: Path) -> None:
    """It replaces one of the same name, at 15 kB/s or more. Then the board checks it ($C).

    Of the blocks that the board reads, two of three arrive damaged: it reads them again.
    """
    card = card_with(tmp_path, {"part.nc": b"G4P0\n"})
    machine = start_with_card(uf2, tmp_path, card)
    push_us = push(machine, "PART.NC", _JOB)
    kb_per_s = len(_JOB) / push_us * 1000
    assert kb_per_s >= 15
    card.damage = lambda block: bytes([block[0] ^ 16]) + block[1:] if card.read % 3 else block
    assert files_on(tmp_path, card) == {"part.nc": _JOB}  # the name keeps its case
    machine.clear_output()
    machine.send("$C\n$F=PART.NC\n")
    machine.wait_for(f"done, {_LINES + 2} lines", 20_000_000)
