"""Test TMC2209 drivers on the UART of an emulated SKR Pico: set-up, polling, no delay."""

from pathlib import Path

import pytest
from emulated import Board, Odometer, files_of
from pico import Pico
from test_pico_stack import RESERVE, SIZE, Stack
from test_pico_talk import MAIN, free
from ugrbl.boardfile.files import load_board
from ugrbl.sim import tmc2209 as model

pytestmark = pytest.mark.xdist_group("pico drivers")

_BOARD = load_board("btt_skr_pico")
_UART = 1  # the UART of TMC_UART's pins
_BIT_US = 1e6 / 115200
_DELAY_BITS = 24
_RECEIVED = 1 << 4  # in the UART's mask of interrupts
_SETTINGS = (
    *("$110=6000", "$111=6000", "$112=3000", "$120=500", "$121=500", "$122=200"),
    *("$22=1", "$23=0", "$24=300", "$25=1200", "$26=5", "$27=0.5", "$5=1"),
    *("$200=90", "$201=90", "$220=70", "$221=70", "$339=3"),
)
_HEAP = 58_000


class Wire:
    """Driver models at the UART; bytes take the time of a wire at 115200 baud."""

    def __init__(self, pico: Pico) -> None:
        self.bus = model.DriverBus(_BOARD.TMC2209, lambda: True)
        self._pico = pico
        self._uart = pico.mcu.uart[_UART]
        self._sent = bytearray()
        self._uart.on_byte = self._on_byte
        self._uart.check_interrupts = self._check_interrupts

    def _check_interrupts(self) -> None:
        """Mask the transmit interrupt, which never ends: the emulator's buffer is always empty."""
        uart = self._uart
        uart._interrupt_status &= _RECEIVED
        uart.rp2040.set_interrupt(uart.irq, bool(uart._interrupt_status & uart._interrupt_mask))

    def _on_byte(self, byte: int) -> None:
        self._sent.append(byte)
        if len(self._sent) > 2 and len(self._sent) == (8 if self._sent[2] & 0x80 else 4):
            sent = len(self._sent)
            back = self.bus.exchange(bytes(self._sent))
            self._sent.clear()
            self._bring(back[:sent], 10 * sent)
            if back[sent:]:
                self._bring(back[sent:], 10 * len(back) + _DELAY_BITS)

    def _bring(self, data: bytes, bits: float) -> None:
        def arrive() -> None:
            for byte in data:
                self._uart.feed_byte(byte)

        self._pico.at_us(bits * _BIT_US, arrive)


class Machine:
    """The board with its drivers."""

    def __init__(self, uf2: Path) -> None:
        self.board = Board(uf2, {**files_of("btt_skr_pico"), "main.py": MAIN})
        self.wire = Wire(self.board.pico)
        for pin in _BOARD.LIMIT:
            self.board.pico.drive(pin, 0)
        self.board.pico.record([*_BOARD.STEP, *_BOARD.DIR])
        self.board.boot().settled()
        self.odometer = Odometer(self.board.pico, _BOARD.STEP, _BOARD.DIR)
        for setting in _SETTINGS:
            assert self.board.ask(setting).endswith("ok\r\n"), setting

    def drivers(self) -> "list[model.Driver]":
        return self.wire.bus.drivers


@pytest.fixture(scope="module")
def machine(uf2: Path) -> Machine:
    return Machine(uf2)


def test_drivers_are_set_up_when_the_board_starts(machine: Machine) -> None:
    for driver in machine.drivers():
        assert driver.registers[model.GCONF] == 0x1C0
        assert driver.registers[model.CHOPCONF] >> 24 & 15 == 4


def test_report_has_the_values_of_the_models(machine: Machine) -> None:
    told = machine.board.ask("$TMC")
    assert told.count("|version:33|microsteps:16|mode:stealthChop|") == 3


def test_steps_are_made_within_the_stack(machine: Machine) -> None:
    stack = Stack(machine.board)
    stack.paint()
    machine.odometer.read()
    machine.board.ask("$X")
    machine.board.ask("G91 G1 X1 Y-2 Z.5 F3000")
    machine.board.ask("G4P.5")
    machine.board.ask("$140=600")
    machine.board.pico.run_us(500_000)
    assert machine.odometer.read() == [80, -160, 200]
    assert stack.used() <= SIZE - RESERVE


def test_silent_driver_is_an_alarm(machine: Machine) -> None:
    board = machine.board
    board.forget()
    machine.drivers()[1].has_supply = False
    board.wait_for("[MSG:Motor driver Y: no answer")
    board.wait_for("ALARM:35")
    board.wait_for("Grbl 1.1h")
    machine.drivers()[1].switch_on()
    board.pico.run_us(1_000_000)
    assert board.ask("$X").endswith("ok\r\n")
    assert board.status()["state"] == "Idle"


def test_status_report_is_sent_in_time_while_drivers_are_polled(machine: Machine) -> None:
    pico = machine.board.pico
    waits = []
    for _ in range(60):
        machine.board.forget()
        asked = pico.us
        machine.board.send("?")
        machine.board.wait_for(">")
        waits.append(pico.us - asked)
        pico.run_us(7_300)
    assert max(waits) < 15_000


def test_heap_is_free(machine: Machine) -> None:
    assert free(machine.board) >= _HEAP
