"""Test TMC2209 drivers on the UART of an emulated SKR Pico: set-up, polling, no delay."""

from pathlib import Path

import pytest
from emulated import Board, Odometer, files_of
from pico import Pico
from test_pico_stack import RESERVE_BYTES, STACK_BYTES, Stack
from test_pico_talk import MAIN, free_heap_bytes
from ugrbl.boardfile.files import load_board
from ugrbl.sim import tmc2209 as model

pytestmark = pytest.mark.xdist_group("pico drivers")

_BOARD = load_board("btt_skr_pico")
_UART = 1  # the UART of TMC_UART's pins
_BIT_US = 1e6 / 115200
_DELAY_BITS = 24  # from a request to a driver's answer
_RECEIVED = 1 << 4  # in the UART's mask of interrupts
_SETTINGS = (
    *("$110=6000", "$111=6000", "$112=3000", "$120=500", "$121=500", "$122=200"),
    *("$22=1", "$23=0", "$24=300", "$25=1200", "$26=5", "$27=0.5", "$5=1"),
    *("$200=90", "$201=90", "$220=70", "$221=70", "$339=3"),
)
_HEAP_BYTES = 58_000


class Wire:
    """Driver models at the UART; bytes take the time of a wire at 115200 baud."""

    def __init__(self, pico: Pico) -> None:
        self.bus = model.DriverBus(_BOARD.TMC2209, is_idle=lambda: True)  # in_motion is not used
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
        """Collect a request, of 8 bytes to write and 4 to read a register, and pass it on.

        On the single wire the chip receives its own bytes, and then the answer of a driver.
        """
        self._sent.append(byte)
        if len(self._sent) > 2 and len(self._sent) == (8 if self._sent[2] & 0x80 else 4):
            sent = len(self._sent)
            received = self.bus.exchange(bytes(self._sent))
            self._sent.clear()
            self._deliver(received[:sent], 10 * sent)
            if received[sent:]:
                self._deliver(received[sent:], 10 * len(received) + _DELAY_BITS)

    def _deliver(self, data: bytes, bits: float) -> None:
        """Let the chip receive data after the time of so many bits; a byte has 10."""

        def arrive() -> None:
            for byte in data:
                self._uart.feed_byte(byte)

        self._pico.at_us(bits * _BIT_US, arrive)


class Machine:
    """The board with its drivers."""

    def __init__(self, uf2: Path) -> None:
        self.board = Board(uf2, {**files_of("btt_skr_pico"), "main.py": MAIN})
        self.wire = Wire(self.board.pico)
        for pin in _BOARD.LIMIT:  # open, with $5=1
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
        # pdn_disable, mstep_reg_select, multistep_filt; MRES 4: 16 microsteps.
        assert driver.registers[model.GCONF] == 0x1C0
        assert driver.registers[model.CHOPCONF] >> 24 & 15 == 4


def test_report_has_the_values_of_the_models(machine: Machine) -> None:
    report = machine.board.ask("$TMC")
    assert report.count("|version:33|microsteps:16|mode:stealthChop|") == 3


def test_steps_are_made_within_the_stack(machine: Machine) -> None:
    """While drivers are polled, and after a change of a current ($140), which is sent to one."""
    stack = Stack(machine.board)
    stack.start_measuring()  # shows later how deep the stack was
    machine.board.ask("$X")
    machine.board.ask("G91 G1 X1 Y-2 Z.5 F3000")
    machine.board.ask("G4P.5")
    machine.board.ask("$140=600")
    machine.board.pico.run_us(500_000)
    assert machine.odometer.read() == [80, -160, 200]  # 80, 80 and 400 steps/mm
    assert stack.most_used() <= STACK_BYTES - RESERVE_BYTES


def test_silent_driver_is_an_alarm(machine: Machine) -> None:
    """Y's driver has no supply. When it answers again the machine can be unlocked."""
    board = machine.board
    board.clear_output()
    machine.drivers()[1].has_supply = False  # it does not answer
    board.wait_for("[MSG:Motor driver Y: no answer")
    board.wait_for("ALARM:35")
    board.wait_for("Grbl 1.1h")
    machine.drivers()[1].switch_on()
    board.pico.run_us(1_000_000)  # it is set up again
    assert board.ask("$X").endswith("ok\r\n")
    assert board.status()["state"] == "Idle"


def test_status_report_is_sent_in_time_while_drivers_are_polled(machine: Machine) -> None:
    """Asked 60 times, at changing phases of the polling."""
    pico = machine.board.pico
    waits_us = []
    for _ in range(60):
        machine.board.clear_output()
        asked_us = pico.us
        machine.board.send("?")
        machine.board.wait_for(">")
        waits_us.append(pico.us - asked_us)
        pico.run_us(7_300)
    assert max(waits_us) < 15_000


def test_heap_is_free(machine: Machine) -> None:
    assert free_heap_bytes(machine.board) >= _HEAP_BYTES
