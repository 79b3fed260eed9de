"""Test TMC2209 drivers: their settings and reports; nothing moves while one has a fault.

The model (tools/sim/tmc2209.py) has a Driver with registers for each motor; driver(machine, motor)
is one of them. run_script() sends lines, waits seconds (numbers) and calls functions, in order; it
returns the output. add_walls() puts an obstacle at each axis, which acts as its limit switch only
during stall detection, and returns the stall thresholds in use there. Machine.received is all
output, physical() the motors' steps, reported() the last position.
"""

from collections.abc import Callable, Iterator, Sequence
from types import ModuleType
from typing import Any

import pytest
from extras.motors.tmc2209_chip import checksum
from hypothesis import given
from hypothesis import strategies as st
from ports.driver_wire import DriverWire
from rig_bench import Machine
from ugrbl.boardfile import board_check
from ugrbl.boardfile.files import load_board
from ugrbl.sim import tmc2209 as model
from ugrbl.sim.engine import Switch

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(2)

# Stall detection of three axes ($339), with the thresholds of the fast and the slow approach.
_STALL_DETECTION = {
    339: 7.0,
    **dict.fromkeys((200, 201, 202), 90.0),
    **dict.fromkeys((220, 221, 222), 70.0),
}
_HOMING = {22: 1, 24: 300, 25: 1500, 26: 5, 27: 1, **{110 + i: 3000.0 for i in range(3)}}


def board(name: str = "sim_drivers", **options: Any) -> ModuleType:
    """Return a board file with other options."""
    module = ModuleType("board")
    module.__dict__.update({**vars(load_board(name)), **options})
    return module


def make_machine(settings: "dict[int, float] | None" = None, **options: Any) -> Machine:
    return Machine(settings or {}, board(**options))


def driver(machine: Machine, motor: int = 0) -> model.Driver:
    return machine.rig.drivers.drivers[motor]


def run_script(machine: Machine, script: "Sequence[object]") -> "list[str]":
    """Send lines, let seconds pass and call functions, in order; return the output.

    script: text: a line, then 300 ms; float: seconds to wait; function: called with the machine.
    """
    output: "list[str]" = []

    def play() -> "Iterator[Any]":
        """Go through the script."""
        yield from machine.start()
        for each in script:
            if isinstance(each, str):
                machine.rig.link.send(f"{each}\n".encode())
                yield machine.rig.ms(300)
            elif isinstance(each, float):
                yield machine.rig.ms(each * 1000)
            elif callable(each):
                each(machine)
        machine.sender.poll()
        output.extend(machine.take())

    machine.run(play())
    return output


# Set-up


def test_each_driver_is_set_up_before_anything_moves() -> None:
    """Compare registers with settings: current, microsteps, hold current, spreadCycle.

    scale, hold: of a full scale of 32; microsteps: the register's code, 4 for 16 and 2 for 64.
    """
    # Y: 800 mA, 25 % of it in hold; Z: 64 microsteps, spreadCycle (bit 2). Defaults: 500 mA, 50 %.
    machine = make_machine({141: 800.0, 152: 64.0, 211: 25.0, 810: 4.0})
    machine.play(["G1X1Y1Z1F100"])
    assert machine.reported() == [1, 1, 1]
    for motor, scale, hold, microsteps, spread in (
        (0, 16, 8, 4, 0),  # full scale 979 mA: 500 / 979 * 32 = 16
        (1, 26, 7, 4, 0),
        (2, 16, 8, 2, 4),
    ):
        registers = driver(machine, motor).registers
        assert registers[model.IHOLD_IRUN] & 0xFFFF == (scale - 1) << 8 | hold - 1, motor
        assert registers[model.CHOPCONF] >> 24 & 15 == microsteps
        # The chopper's times are the manufacturer's.
        assert registers[model.CHOPCONF] & 0xFFFF == 0x53
        # 0x1C0: settings by serial line, step pulses filtered.
        assert registers[model.GCONF] == 0x1C0 | spread
        assert registers[model.GSTAT] == 0  # its fault flags have been cleared


@given(st.floats(50, 1700), st.integers(0, 100))
def test_current_is_within_a_step_of_the_setting(milliamps: float, hold: int) -> None:
    """The current register has 32 steps; bit 17 of CHOPCONF selects one of two full scales.

    hold: percent of the run current, $210.
    """
    machine = make_machine({140: milliamps, 210: float(hold)})
    machine.play([])
    registers = driver(machine).registers
    full_scale_v = 0.18 if registers[model.CHOPCONF] >> 17 & 1 else 0.325
    # The data sheet's formula for RMS current: 0.11 ohm and 0.02 ohm within the chip.
    step_ma = full_scale_v / 0.13 / 2**0.5 / 32 * 1000
    run = registers[model.IHOLD_IRUN] >> 8 & 31
    assert abs((run + 1) * step_ma - milliamps) <= step_ma / 2 + 1
    assert abs((registers[model.IHOLD_IRUN] & 31) + 1 - (run + 1) * hold / 100) <= 1


def test_driver_off_by_default_is_switched_on() -> None:
    machine = make_machine()
    driver(machine).registers[model.CHOPCONF] &= ~15  # TOFF: 0 is off
    machine.play(["G1X1F100"])
    assert driver(machine).registers[model.CHOPCONF] & 15 == 3 and machine.reported()[0] == 1


def test_changed_setting_reaches_its_driver() -> None:
    machine = make_machine()
    machine.play(["$150=32", "G1X1F100"])
    assert driver(machine).registers[model.CHOPCONF] >> 24 & 15 == 3


def test_impossible_setting_is_refused_and_nothing_changes() -> None:
    """Currents, microsteps, hold percent and stall threshold out of range; $155 has no motor."""
    lines = ["$140=0", "$141=1800", "$150=10", "$152=512", "$210=101", "$200=256", "$155=3"]
    machine = make_machine()
    machine.play([*lines, "$$"])
    assert machine.received.count("error:3") == len(lines)
    assert {"$141=500.000", "$152=16.000", "$210=50.000"} <= set(machine.received)


def test_reported_settings_are_accepted_again() -> None:
    """The reply to $$ is sent back line by line, as senders do to restore settings."""
    machine = make_machine({140: 700.0, 150: 64.0})
    machine.play(["$$"])
    lines = [line for line in machine.received if line.startswith("$")]
    machine.play(lines)
    assert not any("error" in line for line in machine.received)


def test_excluded_driver_is_not_addressed() -> None:
    """$338 is the mask of motors with a driver to set up: 5 excludes Y, which has no supply."""
    machine = make_machine({338: 5.0})
    driver(machine, 1).has_supply = False
    machine.play(["G1Y2F600"])
    assert machine.reported() == [0, 2, 0]
    assert model.IHOLD_IRUN not in driver(machine, 1).registers


def test_wire_is_silent_during_motion() -> None:
    """Datagrams are sent while idle only, because they take time and interrupt step pulses."""
    machine = make_machine({**_HOMING, **_STALL_DETECTION})
    add_walls(machine)
    moves = ["G1X-5F900", "G4P0.2", "G2X-10I-2.5", 3.0, "$J=G91X-3F600", 1.0, "G1Y-5", 2.0]
    output = run_script(machine, ["$H", 30.0, *moves, "$TMC"])
    assert not [line for line in output if "error" in line or "ALARM" in line]
    # X-13 and Y-5, 250 steps/mm; the walls, at 700 steps, are 0. Z is 1 mm away from its wall.
    assert machine.physical() == [700 - 13 * 250, 700 - 5 * 250, 700 - 250]
    assert machine.rig.drivers.datagrams > 50
    assert machine.rig.drivers.in_motion == 0  # datagrams during motion


# Faults


def _without_supply(machine: Machine) -> None:
    driver(machine, 1).has_supply = False


def _cut_wire(machine: Machine) -> None:
    machine.rig.drivers.is_broken = True


def _wrong_checksum(machine: Machine) -> None:
    machine.rig.drivers.spoil = lambda answer: answer[:-1] + bytes((answer[-1] ^ 1,))


def _short_answer(machine: Machine) -> None:
    machine.rig.drivers.spoil = lambda answer: answer[:5]


def _wrong_register(machine: Machine) -> None:
    machine.rig.drivers.spoil = lambda answer: answer[:2] + b"\x7f" + answer[3:]


def _hot(machine: Machine) -> None:
    driver(machine, 1).registers[model.DRV_STATUS] |= 3


def _grounded(machine: Machine) -> None:
    driver(machine, 1).registers[model.DRV_STATUS] |= 8


def _shorted(machine: Machine) -> None:
    driver(machine, 1).registers[model.DRV_STATUS] |= 0x20


def _low_voltage(machine: Machine) -> None:
    driver(machine, 1).registers[model.GSTAT] |= 4
    driver(machine, 1).stuck = 4


def _supply_failure(machine: Machine) -> None:
    driver(machine, 1).switch_on()


_FAULTS: "list[tuple[Callable[[Machine], None], str]]" = [
    (_without_supply, "Y: no answer"),
    (_cut_wire, "no echo: its serial wire is cut"),
    (_wrong_checksum, "a corrupted answer"),
    (_short_answer, "no answer"),
    (_wrong_register, "a corrupted answer"),
    (_hot, "Y: too hot"),
    (_grounded, "Y: short circuit to ground"),
    (_shorted, "Y: short circuit to supply"),
    (_low_voltage, "Y: its supply voltage is too low"),
    (_supply_failure, "Y: its supply has failed"),
]


@pytest.mark.parametrize(("cause_fault", "words"), _FAULTS)
def test_fault_while_idle_is_an_alarm_reported_once(
    cause_fault: "Callable[[Machine], None]", words: str
) -> None:
    """cause_fault: causes it at Y's driver, or on the wire to all; words: of its message."""
    machine = make_machine()
    output = run_script(machine, ["G1X1F600", 1.0, cause_fault, 2.0])
    assert output[0] == "ok"
    assert any(words in line for line in output), output
    assert output.count("ALARM:35") == 1
    assert sum(words in line for line in output) <= 3  # once for each driver that has it


@pytest.mark.parametrize(("cause_fault", "words"), _FAULTS[:-1])  # the last is none at power-up
def test_nothing_moves_during_a_fault(
    cause_fault: "Callable[[Machine], None]", words: str
) -> None:
    """The fault exists from power-up. Neither a move, a jog, probing nor homing starts."""
    machine = make_machine(_HOMING)
    cause_fault(machine)
    for line in ("G1X1F600", "$J=G91X1F600", "G38.3X2F100", "$H"):
        output = run_script(machine, ["$X", 0.5, line, 1.0])
        assert any(words in message for message in output), (line, output)
        assert "ALARM:35" in output, line
        assert machine.physical() == [0, 0, 0]


def test_reset_is_answered_after_a_fault_has_refused_the_take_up_of_backlash() -> None:
    """The new setting lets the driver of Y be read before X takes up its slack."""
    machine = make_machine({160: 0.5}, BACKLASH=True)
    send_reset = lambda machine: machine.rig.link.send(b"\x18")  # noqa: E731
    script = ["G1X1F600", 1.0, _without_supply, "$161=0.4\nG1X0F600", 1.0, send_reset, 1.0]
    output = run_script(machine, script)
    assert "ALARM:35" in output and machine.physical() == [250, 0, 0]
    assert output[-2].startswith("Grbl"), output


def test_supply_switched_on_later_is_no_alarm() -> None:
    """Drivers do not answer without the motors' supply. At power-up that is only a message."""
    machine = make_machine()
    for chip in machine.rig.drivers.drivers:
        chip.has_supply = False

    def supply(machine: Machine) -> None:
        for chip in machine.rig.drivers.drivers:
            chip.switch_on()

    output = run_script(machine, [1.0, supply, 0.5, "G1X1F600", 0.5])
    assert [line for line in output if "Motor" in line] == [
        f"[MSG:Motor driver {name}: no answer: is the motors' supply on?]" for name in "XYZ"
    ]
    assert output[-1] == "ok"
    assert driver(machine).registers[model.GCONF] == 0x1C0


def test_recovered_driver_is_set_up_again_after_an_alarm() -> None:
    machine = make_machine()
    output = run_script(
        machine, ["G1X1F600", 1.0, _supply_failure, 1.0, "$X", 0.5, "G1X2F600", 1.0]
    )
    assert output[-1] == "ok"
    assert driver(machine, 1).registers[model.IHOLD_IRUN] > 0


def test_damaged_answer_is_requested_again() -> None:
    """The next two answers are damaged: the driver is asked again, without an alarm."""
    machine = make_machine()
    damaged_left = [2]

    def spoil(answer: bytes) -> bytes:
        damaged_left[0] -= 1
        return answer if damaged_left[0] < 0 else b"\0" * 8

    def begin(machine: Machine) -> None:
        machine.rig.drivers.spoil = spoil

    assert not any("ALARM" in line for line in run_script(machine, [0.5, begin, 2.0]))
    assert damaged_left[0] < 0  # more answers than these two were requested


def test_warm_driver_is_reported_once_and_continues() -> None:
    machine = make_machine()

    def warm(machine: Machine) -> None:
        driver(machine).registers[model.DRV_STATUS] |= 1  # overtemperature warning

    output = run_script(machine, [0.5, warm, 2.0, "G1X1F600", 0.5])
    assert output.count("[MSG:Motor driver X: warm]") == 1
    assert output[-1] == "ok"


# Homing without switches


class Stall(Switch):
    """DIAG of a driver: high beyond a place, while the driver's stall detection is on."""

    driver: model.Driver
    thresholds_used: "list[int]"

    def closed(self, steps: int) -> bool:
        """Return whether DIAG is high at this position; record the threshold (0: off)."""
        threshold = self.driver.registers.get(model.SGTHRS, 0)
        is_high = super().closed(steps) and threshold > 0
        if is_high:
            self.thresholds_used.append(threshold)
        return is_high


def add_walls(machine: Machine, above: int = 700) -> "list[int]":
    """Put a wall above so many steps of each axis; return the thresholds in use there, a list
    that grows as walls are touched."""
    thresholds_used: "list[int]" = []
    for motor, letter in enumerate("xyz"):
        wall = Stall(f"limit_{letter}", motor, True, above)
        wall.driver, wall.thresholds_used = driver(machine, motor), thresholds_used
        machine.rig.engine.switches.append(wall)
    return thresholds_used


def test_axes_home_by_stall_detection() -> None:
    """Afterwards stall detection is off."""
    machine = make_machine({**_HOMING, **_STALL_DETECTION})
    used_thresholds = add_walls(machine)
    machine.play(["$H", "G1X-1F600"])
    assert machine.reported() == [-1, -1, -1]
    assert set(used_thresholds) == {90, 70}
    for motor in range(3):
        assert driver(machine, motor).registers[model.SGTHRS] == 0
        assert driver(machine, motor).registers[model.TCOOLTHRS] == 0


def test_axis_in_spreadcycle_uses_stealthchop_during_stall_detection() -> None:
    """Stall detection needs stealthChop. $339 and $810 are 7: both for all axes."""
    machine = make_machine({**_HOMING, 339: 7.0, 810: 7.0, 200: 9.0, 201: 9.0, 202: 9.0})
    add_walls(machine)
    spread_bits: "set[int]" = set()  # bit 2 of GCONF, spreadCycle, whenever a stall is detected
    original = Stall.closed

    def closed(self: Stall, steps: int) -> bool:
        is_closed = original(self, steps)
        if is_closed:
            spread_bits.add(self.driver.registers[model.GCONF] & 4)
        return is_closed

    Stall.closed = closed  # type: ignore[method-assign]
    try:
        machine.play(["$H", "G4P0.5"])
    finally:
        Stall.closed = original  # type: ignore[method-assign]
    assert spread_bits == {0}
    assert driver(machine).registers[model.GCONF] & 4  # afterwards it is on again


def test_axis_without_stall_detection_does_not_use_it() -> None:
    """$339=2: only Y. Z is homed first, and finds no switch."""
    machine = make_machine({**_HOMING, 200: 90.0, 339: 2.0})
    thresholds = add_walls(machine)
    machine.play(["$H"])
    assert "ALARM:9" in machine.received
    assert thresholds == []


# The report


def test_report_has_the_status_of_each_driver() -> None:
    """$TMC: first with Y too hot, then with the serial wire cut. $TMCX is an error."""
    machine = make_machine({152: 64.0, 810: 2.0})
    output = run_script(machine, [1.0, _hot, "$TMC", 1.0, _cut_wire, 1.0, "$TMC", "$TMCX"])
    reports = [line for line in output if line.startswith("[TMC:")]
    assert reports[0] == "[TMC:X|version:33|microsteps:16|mode:stealthChop|scale:1/32|state:good]"
    assert "mode:spreadCycle" in reports[1]
    assert reports[1].endswith("state:too hot]")
    assert "microsteps:64" in reports[2]
    assert reports[3:] == [f"[TMC:{name}|state:no echo: its serial wire is cut]" for name in "XYZ"]
    assert "error:3" in output


# Messages and numbers


@given(st.binary(min_size=1, max_size=12))
def test_checksum_is_that_of_the_data_sheet(data: bytes) -> None:
    assert checksum(data) == model.crc(data)


def test_checksum_of_a_known_datagram() -> None:
    assert checksum(bytes((5, 0, 0))) == 0x48  # as other drivers of this chip send it


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"TMC2209": (0, 1)}, "TMC2209 has 2 addresses, but STEP has 3 pins"),
        ({"TMC2209": (0, 1, 4)}, "TMC2209: addresses must be 0 to 3, each only once"),
        ({"TMC2209": (0, 1, 1)}, "TMC2209: addresses must be 0 to 3, each only once"),
        ({"TMC_UART": (8,)}, "TMC_UART needs two pins: TX and RX"),
        ({"DEFAULTS": {140: 9000.0}}, "DEFAULTS: $140=9000 is beyond what a driver can do"),
    ],
)
def test_impossible_board_file_is_reported_with_the_cause(
    options: "dict[str, Any]", why: str
) -> None:
    assert board_check.problems(board(**options)) == [why]


def test_second_motor_has_its_axis_settings_and_a_name() -> None:
    """Motor 3 is the second of Y: its current is Y's ($141), and its name is Y2."""
    machine = Machine(
        {141: 900.0},
        board("sim_ganged", TMC2209=(0, 1, 2, 3), TMC_UART=(8, 9)),
    )
    machine.play(["G1X1F600", "$TMC"])
    first, second = (driver(machine, motor).registers[model.IHOLD_IRUN] for motor in (1, 3))
    assert first == second
    assert any(line.startswith("[TMC:Y2|") for line in machine.received)


class _Echo:
    """A UART that receives what it sends, until its wire is cut."""

    is_cut = False

    def __init__(self) -> None:
        self._sent = b""

    def any(self) -> int:
        return 0

    def write(self, data: "bytes | bytearray") -> None:
        self._sent = b"" if self.is_cut else bytes(data)

    def readinto(self, buf: "Any") -> "int | None":
        buf[: len(self._sent)] = self._sent
        return len(self._sent) or None


def test_cut_wire_is_found_by_a_repeated_request() -> None:
    """The first exchange leaves the same bytes in the buffer that the second expects as echo."""
    uart = _Echo()
    wire = DriverWire(uart)
    assert wire.exchange(b"\x05\x00\x06\x6f", 8) == b""  # no driver answers
    uart.is_cut = True
    assert wire.exchange(b"\x05\x00\x06\x6f", 8) is None
