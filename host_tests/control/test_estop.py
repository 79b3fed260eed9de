"""Test the emergency stop: it stops everything, and prevents unlocking while it is pressed.

machine.send_and_wait(line, until) discards earlier output, sends a line and waits for a text in
the output, which received_text() returns. push() sets inputs. A script yields a condition, or the
tick at which it is resumed; machine.ms(n) is the tick n ms from now.
"""

from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

import pytest
from ugrbl.boardfile.files import load_board
from ugrbl.sim.replay import factory_store
from ugrbl.sim.rig import Rig

PRESSED, RELEASED = {"estop": False}, {"estop": True}  # level of the pin: normally closed


class Machine(Rig):
    """A simulated machine with an emergency stop. settings: _22=1 is $22=1."""

    def __init__(self, **settings: float) -> None:
        module = ModuleType("board")
        vars(module).update(vars(load_board("sim")), ESTOP=28)
        store = factory_store(module)
        store.files["settings"] += [f"${name[1:]}={value}" for name, value in settings.items()]
        super().__init__(module, store)

    def received_text(self) -> str:
        return bytes(self.link.received).decode()

    def send_and_wait(self, line: str, until: str = "\r\n") -> Iterator[Any]:
        """Send a line and wait for its answer; earlier output is discarded."""
        yield self.ms(20)  # so that pending output arrives first
        self.link.received.clear()
        self.link.send(line.encode("latin-1"))
        yield lambda: until.encode() in self.link.received

    def tools_are_off(self) -> bool:
        """Return whether spindle and coolant are off at the pins."""
        port = self.port
        return not (port.spindle_on or port.spindle_pwm or port.flood or port.mist)

    def motor_steps(self) -> "list[int]":
        """Return the motors' position in steps."""
        self.engine.physical(self.scratch)
        return list(self.scratch)

    def play(self, script: "Callable[[], Iterator[Any]]") -> None:
        """Run the script after the banner."""
        failed: list[Exception] = []

        def guarded() -> Iterator[Any]:
            """Wait for the banner, play the script, and note its exception."""
            try:
                yield lambda: b"Grbl " in self.link.received
                yield from script()
            except Exception as fault:
                failed.append(fault)

        self.run(guarded())
        if failed:
            raise failed[0]


LOCKED = "[MSG:Emergency stop]\r\nerror:9\r\n"  # the answer to $X while it is pressed


def test_motion_and_tool_stop_at_once_and_nothing_unlocks() -> None:
    """Press during a move: until the switch is released, neither `$X` nor a reset unlocks."""
    machine = Machine()

    def script() -> Iterator[Any]:
        """Move with the spindle on; press, try to unlock in several ways, release, and move
        again."""
        yield from machine.send_and_wait("M3 S1000 M8\n", "ok\r\n")
        yield from machine.send_and_wait("G1 X100 F500\n", "ok\r\n")
        yield machine.ms(300)  # in motion
        assert machine.moving() and not machine.tools_are_off()
        machine.link.received.clear()
        machine.port.push(PRESSED)
        # at once: its interrupt stops both
        assert machine.tools_are_off() and not machine.moving()
        stopped_at_steps = machine.motor_steps()
        yield lambda: b"unlock]\r\n" in machine.link.received
        assert machine.received_text().startswith("ALARM:17\r\n\r\nGrbl 1.1h")
        assert "[MSG:Emergency stop]\r\n[MSG:'$H'|'$X' to unlock]" in machine.received_text()
        yield from machine.send_and_wait("$X\n", "error:9\r\n")
        assert machine.received_text() == LOCKED
        yield from machine.send_and_wait("\x18", "unlock]\r\n")
        assert "ALARM" not in machine.received_text()  # reported once
        yield from machine.send_and_wait("$X\n", "error:9\r\n")
        assert machine.received_text() == LOCKED
        yield from machine.send_and_wait("G1 X1\n")
        assert machine.received_text() == "error:9\r\n"
        yield machine.ms(500)  # refused lines would have moved it
        assert machine.tools_are_off()
        assert machine.motor_steps() == stopped_at_steps  # the refused lines moved nothing
        # From here: released, the machine unlocks as after any alarm.
        machine.port.push(RELEASED)
        yield machine.ms(100)  # the release is read
        yield from machine.send_and_wait("?")
        assert machine.received_text().startswith("<Alarm")
        yield from machine.send_and_wait("$X\n", "ok\r\n")
        yield from machine.send_and_wait("M3 S1000 G1 X1 F500\n", "ok\r\n")
        yield machine.ms(50)  # in motion
        assert machine.moving() and not machine.tools_are_off()

    machine.play(script)


def test_machine_unlocks_normally_after_estop_in_an_alarm_is_released() -> None:
    """With homing enabled ($22) the machine starts in alarm, where a press causes no new reset.

    `$X` must enable motors and tool again, which otherwise the reset does."""
    machine = Machine(_22=1)

    def script() -> Iterator[Any]:
        """Press and release while the machine is locked; then unlock and move."""
        yield lambda: b"unlock]\r\n" in machine.link.received
        machine.port.push(PRESSED)
        yield machine.ms(50)  # the press is read
        machine.port.push(RELEASED)
        yield from machine.send_and_wait("$X\n", "ok\r\n")
        yield from machine.send_and_wait("M3 S1000 G1 X1 F500\n", "ok\r\n")
        yield machine.ms(50)  # in motion
        assert machine.moving() and not machine.tools_are_off()

    machine.play(script)


def test_machine_that_starts_with_estop_pressed_is_locked() -> None:
    """It starts in alarm, shows the message, and refuses `$X`."""
    machine = Machine()
    machine.port.push(PRESSED)

    def script() -> Iterator[Any]:
        yield lambda: b"unlock]\r\n" in machine.link.received
        assert "[MSG:Emergency stop]" in machine.received_text()
        yield from machine.send_and_wait("$X\n", "error:9\r\n")
        assert machine.received_text() == LOCKED

    machine.play(script)


def test_homing_is_refused_while_estop_is_pressed() -> None:
    machine = Machine(_22=1)  # homing is enabled
    machine.port.push(PRESSED)

    def script() -> Iterator[Any]:
        yield from machine.send_and_wait("$H\n", "error:9\r\n")
        assert machine.received_text() == LOCKED

    machine.play(script)


def hold(machine: Machine) -> Iterator[Any]:
    """Start a move, and stop in a feed hold."""
    yield from machine.send_and_wait("G1 X100 F500\n", "ok\r\n")
    machine.link.send(b"!")
    yield machine.ms(2000)  # until it has stopped


def jog(machine: Machine) -> Iterator[Any]:
    """Start a jog."""
    yield from machine.send_and_wait("$J=G91 X100 F500\n", "ok\r\n")
    yield machine.ms(100)  # in motion


def home(machine: Machine) -> Iterator[Any]:
    """Start homing."""
    machine.link.send(b"$H\n")
    yield machine.ms(300)  # in the first approach


def check(machine: Machine) -> Iterator[Any]:
    """Switch check mode on."""
    yield from machine.send_and_wait("$C\n", "ok\r\n")


def sleep(machine: Machine) -> Iterator[Any]:
    """Put the machine to sleep."""
    machine.link.send(b"$SLP\n")
    yield machine.ms(500)  # asleep


def dwell(machine: Machine) -> Iterator[Any]:
    """Start a dwell of 5 s."""
    machine.link.send(b"G4 P5\n")
    yield machine.ms(200)  # in the dwell


@pytest.mark.parametrize("has_interrupt", [True, False], ids=["interrupt", "level"])
@pytest.mark.parametrize("prepare", [hold, jog, home, check, sleep, dwell])
def test_estop_works_in_every_state(
    prepare: "Callable[[Machine], Iterator[Any]]", has_interrupt: bool
) -> None:
    """Also when its interrupt is lost ("level"): the main loop polls the level of the pin."""
    machine = Machine(_22=1)  # homing enabled: it starts in alarm

    def script() -> Iterator[Any]:
        """Bring the machine into a state, press, and read the alarm."""
        yield from machine.send_and_wait("$X\n", "ok\r\n")
        yield from prepare(machine)
        machine.link.received.clear()
        if not has_interrupt:
            machine.port._listener = None
        machine.port.push(PRESSED)
        yield lambda: b"unlock]\r\n" in machine.link.received
        assert "ALARM:17\r\n" in machine.received_text()
        assert machine.received_text().count("ALARM") == 1
        assert not machine.moving() and machine.tools_are_off()

    machine.play(script)


@pytest.mark.parametrize("touches", [False, True])
def test_tool_that_a_failed_probing_leaves_on_is_switched_off(touches: bool) -> None:
    """As with Grbl, ALARM:4 and ALARM:5 leave the tool on."""
    machine = Machine()

    def script() -> Iterator[Any]:
        """Probe in vain with the spindle on, then press twice."""
        yield from machine.send_and_wait("M3 S1000 M8\n", "ok\r\n")
        # touching already: ALARM:4; no contact at all: ALARM:5
        machine.port.push({"probe": touches})
        yield from machine.send_and_wait("G38.2 Z-0.1 F100\n", "ALARM:4" if touches else "ALARM:5")
        yield machine.ms(800)  # until the alarm is over
        assert not machine.tools_are_off()
        machine.link.received.clear()
        machine.port.push(PRESSED)
        assert machine.tools_are_off()
        yield machine.ms(800)
        machine.port.push(PRESSED)  # a contact that bounces is not reported again
        yield machine.ms(800)  # a second alarm would be reported
        assert machine.tools_are_off() and machine.received_text().count("ALARM:17") == 1
        yield from machine.send_and_wait("$X\n", "error:9\r\n")

    machine.play(script)


@pytest.mark.parametrize(
    ("pushed", "said"), [({"limit_x": True}, "ALARM:1\r\n"), (PRESSED, "ALARM:17\r\n")]
)
def test_alarm_after_the_check_for_one_is_reported(pushed: "dict[str, bool]", said: str) -> None:
    """An input is pushed between the main loop's check for alarms and its check for faults."""
    machine = Machine(_21=1)  # hard limits are on
    fault = machine.engine.fault

    def script() -> Iterator[Any]:
        """Start a move; push the input in the middle of a pass of the main loop."""
        yield from machine.send_and_wait("G1 X100 F500\n", "ok\r\n")
        yield machine.ms(300)  # in motion
        machine.link.received.clear()

        def push_during_check() -> str:
            """Push the input while the main loop looks for a fault, after its look for alarms."""
            # once only
            machine.engine.fault = fault  # type: ignore[method-assign]
            machine.port.push(pushed)
            return fault()

        machine.engine.fault = push_during_check  # type: ignore[method-assign]
        yield machine.ms(300)  # the alarm is reported
        assert machine.received_text().startswith(said)

    machine.play(script)


def test_failing_callback_is_an_alarm_with_its_cause() -> None:
    """A port that catches an exception in a callback kills the tool and calls on_fault()."""
    machine = Machine()

    def script() -> Iterator[Any]:
        """Do during a move what a port does whose callback has failed."""
        yield from machine.send_and_wait("M3 S1000 G1 X100 F500\n", "ok\r\n")
        yield machine.ms(300)  # in motion
        machine.link.received.clear()
        machine.port.fault = "A pin's callback has failed"
        machine.port.kill()
        machine.port._listener.on_fault()
        assert machine.tools_are_off() and not machine.moving()
        yield lambda: b"unlock]\r\n" in machine.link.received
        assert "ALARM:16\r\n[MSG:A pin's callback has failed]" in machine.received_text()
        yield from machine.send_and_wait("$X\n", "ok\r\n")

    machine.play(script)
