"""Test a hold before a command that waits for motion to end: it also waits for `~`.

A motion is followed by such a command, and `!` comes in the last 200 ms of the motion. During the
hold no part of the command is executed; after `~` pins, reports, modes, position and stored data
are the same as without a hold. Each motion is tried with some commands at some instants;
UGRBL_TORTURE=1 tries each with all of them at every millisecond. A script yields a condition, or
the tick at which it is resumed; rig.ms(n) is the tick n ms from now.
"""

import os
import random
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

import pytest
from base import state as st
from rig_bench import Machine
from ugrbl.boardfile.files import load_board
from ugrbl.sim.engine import Switch

_EVERY = os.environ.get("UGRBL_TORTURE") is not None
_COMMANDS = 4  # tried with each motion
_LAST_MS = 200
_RISKY_MS = 60  # before the end of motion: its last segments are planned or sent
_AFTER_MS = 25  # $1: after this delay a stopped machine is idle
_FAST = {110: 6000, 111: 6000, 112: 6000, 120: 500, 121: 500, 122: 500, 22: 1, 23: 7}
_FAST |= {24: 600, 25: 3000, 26: 5, 27: 1}
_LASER = {32: 1}
_SWITCH_STEPS = -4000
_PATIENCE_MS = 20_000


class Motion(NamedTuple):
    """Lines that set the tool first, and lines that move."""

    before: Sequence[str]
    lines: Sequence[str]
    settings: "dict[int, float]" = {}
    options: "Mapping[str, Any]" = {}


MOTIONS = {
    "line": Motion((), ("G1X2F3000",)),
    "long line": Motion((), ("G1X20F6000",)),
    "slow line": Motion((), ("G1X0.5F150",)),
    "one step": Motion((), ("G1X0.004F100",)),
    "three axes": Motion((), ("G1X3Y-2Z1F2000",)),
    "many lines": Motion((), tuple(f"G1X{0.3 * i:.1f}Y{i % 2}F3000" for i in range(1, 11))),
    "corner": Motion((), ("G1X3F4000", "G1Y3")),
    "rapid": Motion((), ("G0X12Y4",)),
    "arc": Motion((), ("G2X4Y0I2J0F1500",)),
    "helix": Motion((), ("G3X0Y0Z-2I3J0F3000",)),
    "inverse time": Motion((), ("G93G1X3F120",)),
    "incremental inches": Motion((), ("G91G20G1X0.1F80",)),
    "machine coordinates": Motion((), ("G53G0X-6",)),
    "G28": Motion((), ("G28X3",)),
    "G30": Motion((), ("G30Z2",)),
    "tool": Motion((), ("T3G1X2F2000",)),
    "probing": Motion((), ("G38.3Z-1F900",)),
    "jog": Motion((), ("$J=G91X4F4000",)),
    "speed in motion": Motion(("M3S300",), ("G1X1F2000", "S600X2", "S900X3")),
    "laser M3": Motion(("M3S300",), ("G1X2F3000S500",), _LASER),
    "laser with an enable pin": Motion(
        ("M3S300",), ("G1X1F3000", "G0X2"), _LASER, {"SPINDLE_ENABLE_PIN": True}
    ),
    "laser M4": Motion(("M4S300",), ("G1X2F3000S500",), _LASER),
    "laser in the dark": Motion(("M3S300",), ("G1X1F3000", "G0X3"), _LASER),
    "laser arc": Motion(("M3S300",), ("G1F3000", "G2X4Y0I2J0S700"), _LASER),
    "backlash": Motion((), ("G1X1F3000", "G1X0"), {160: 0.5}, {"BACKLASH": True}),
    "laser off": Motion((), ("G1X2F3000S500",), _LASER),
}

COMMANDS = (
    "M3S700",
    "M4S200",
    "M5",
    "M5G1X3F3000",
    "S100",
    "M7",
    "M8",
    "M9",
    "M5M9",
    "M0",
    "M5\nM0",
    "M2",
    "M30",
    "G4P0.1",
    "$1=50",
    "$100=200",
    "$N0=G21",
    "$I=ABC",
    "$C",
    "$H",
    "G10L2P1X1",
    "G10L20P1Y3",
    "G28.1",
    "G28.1G2X5Y0I2J1F3000",
    "G30.1",
    "G92X7",
    "G92.1",
    "G43.1Z1",
    "G49",
    "G55",
    "M56P0",
    "G38.3Z-2F900",
)


# These change the coordinates or the unit of the position: reported and made steps may differ.
_NEW_PLACES = ("$H", "$100=200")

# The faults found first: the laser burned on, the spindle stopped, flash was written during
# motion.
KNOWN = (
    ("laser M3", "M5"),
    ("laser M3", "M2"),
    ("laser M3", "M5X3"),
    ("laser M3", "M0"),
    ("line", "M3S1000"),
    ("line", "$1=50"),
    ("line", "G28.1"),
    ("line", "G10L20P1Y3"),
    ("speed in motion", "M5"),
)


def _board(options: "Mapping[str, Any]") -> ModuleType:
    """Return the simulator's board with mist and M56, and these options."""
    board = ModuleType("board")
    vars(board).update(vars(load_board("sim")), MIST=True, OVERRIDE_CONTROL=True, **options)
    return board


class Trial:
    """A motion and a command after it.

    hold_ms: when `!` is sent, or None. held: bytes sent during the hold.
    """

    def __init__(
        self, motion: Motion, command: str, hold_ms: "float | None" = None, held: str = ""
    ) -> None:
        self._motion = motion
        self._command = command
        self._hold_ms = hold_ms
        self._held = held
        settings = {**_FAST, **motion.settings}
        self.machine = Machine(settings, _board(motion.options), watched=False)
        self.rig = self.machine.rig
        self.rig.engine.switches += [
            Switch(f"limit_{name}", axis, above=False, steps=_SWITCH_STEPS)
            for axis, name in enumerate("xyz")
        ]
        self.begun_ms = self.ended_ms = 0.0  # without a hold: when motion begins and ends
        self.before: "dict[str, Any]" = {}
        self.in_hold: "dict[str, Any]" = {}
        self.at_last: "dict[str, Any]" = {}

    def run(self) -> "Trial":
        """Run it to its end."""
        self.machine.run(self._script())
        return self

    def _script(self) -> Iterator[Any]:
        """Play the motion and the command, with or without a hold; record states."""
        machine, rig, sender = self.machine, self.machine.rig, self.machine.sender
        yield from machine.start()
        sender.allow(_PATIENCE_MS)
        for line in ("$X", "M8", *self._motion.before):
            yield from sender.wait("idle", line + "\n", settle=1)
        yield from self._record_state(self.before)
        sent_at = rig.now
        lines = [*self._motion.lines, *self._command.split("\n")]
        rig.link.send("".join(line + "\n" for line in lines).encode())
        if self._hold_ms is None:
            yield rig.moving
            self.begun_ms = (rig.now - sent_at) / rig.ticks_per_ms
            yield lambda: not rig.moving()
            self.ended_ms = (rig.now - sent_at) / rig.ticks_per_ms
        else:
            yield sent_at + int(self._hold_ms * rig.ticks_per_ms)
            yield from self._hold()
        yield from machine.rest()
        yield from self._record_state(self.at_last)

    def _hold(self) -> Iterator[Any]:
        """Hold, wait until the machine has stopped, record its state, send `held`, and resume."""
        rig, sender = self.rig, self.machine.sender
        rig.link.send(b"!")
        yield rig.ms(3)
        while not sender.at_rest():
            yield rig.ms(5)
            assert rig.now < sender.deadline
        yield rig.ms(2 * _AFTER_MS)
        yield from self._record_state(self.in_hold)
        rig.link.send(self._held.encode("latin-1"))
        yield rig.ms(_AFTER_MS)
        if "\x18" not in self._held:  # a reset ends the hold
            rig.link.send(b"~")

    def _record_state(self, state: "dict[str, Any]") -> Iterator[Any]:
        """Record in `state` the state of the machine, and its reports."""
        machine, port = self.rig.controller, self.rig.port
        state["stored"] = {name: list(lines) for name, lines in self.rig.store.files.items()}
        state["steps"] = self.machine.physical()
        state["modes"] = machine.commands.modes()
        state["pins"] = (port.spindle_on, port.spindle_pwm, port.flood, port.mist)
        state["direction"] = port.spindle_dir if port.spindle_on else None
        state["run"] = machine.state.run
        self.machine.take()
        yield from self.machine.sender.wait("report", "?")
        report = next(line for line in self.machine.take() if line.startswith("<"))
        fields = dict(field.split(":", 1) for field in report[1:-1].split("|") if ":" in field)
        per_mm = machine.settings.steps_per_mm
        place = zip(fields["MPos"].split(","), per_mm, strict=True)
        state["reported steps"] = [round(float(mm) * steps) for mm, steps in place]
        state["reported speed"] = fields["FS"].split(",")[1]
        state["reported tool"] = machine.spindle.direction(), machine.coolant.mask


@cache
def without_hold(name: str, command: str) -> Trial:
    """Return the trial without a hold: its end state is required of all others."""
    return Trial(MOTIONS[name], command).run()


def _tool(state: "dict[str, Any]") -> "list[str]":
    """Return the modes of spindle and coolant in `$G`."""
    return re.findall(r"\bM[345789]\b", state["modes"])


def check_agreement(state: "dict[str, Any]", is_laser: bool, where: str) -> None:
    """Check that modes, reports and pins in `state` agree; where: for the message."""
    on, pwm, flood, mist = state["pins"]
    modes = _tool(state)
    assert (flood, mist) == ("M8" in modes, "M7" in modes), f"coolant: {where}"
    assert on == (pwm > 0) == (state["reported speed"] != "0"), f"FS: {where}"
    if not is_laser:
        assert on == ("M5" not in modes and not state["modes"].endswith("S0")), f"spindle: {where}"
        assert state["direction"] in (None, "M4" in modes), f"direction: {where}"
    elif state["run"] == st.HOLD:
        assert not on, f"the laser burns: {where}"


def check_with_hold(name: str, command: str, hold_ms: float, held: str = "") -> None:
    """Run motion `name` and the command with a hold, and compare with the trial without one."""
    where = f"{name}, {command!r}, hold after {hold_ms:.1f} ms"
    trial = Trial(MOTIONS[name], command, hold_ms, held).run()
    without, is_laser = without_hold(name, command), 32 in MOTIONS[name].settings
    in_hold, at_last = trial.in_hold, trial.at_last
    if in_hold["run"] == st.HOLD:
        check_agreement(in_hold, is_laser, f"held: {where}")
        if in_hold["steps"] != without_hold(name, "").at_last["steps"]:  # not the end
            assert in_hold["stored"] == trial.before["stored"], f"stored in the hold: {where}"
            assert _tool(in_hold) == _tool(trial.before), f"done in the hold: {where}"
    for state in (in_hold, at_last):
        if command not in _NEW_PLACES and name != "backlash":  # its steps are not reported
            assert state["reported steps"] == state["steps"], f"place: {where}"
    check_agreement(at_last, is_laser, where)
    for item in at_last:
        if name != "jog" or "steps" not in item:  # a hold cancels a jog
            assert at_last[item] == without.at_last[item], f"{item} at last: {where}"


def hold_times_ms(name: str, rng: random.Random, count: int) -> "list[float]":
    """Return times of `!` in ms after the lines are sent: one in the last 200 ms, the rest in the
    last, risky part of it. With UGRBL_TORTURE: every ms of the last 200."""
    unheld = without_hold(name, "")
    idle_ms = unheld.ended_ms + _AFTER_MS
    before_end_ms: Sequence[float] = range(_LAST_MS)
    if not _EVERY:
        before_end_ms = [rng.random() * span for span in [_LAST_MS, *[_RISKY_MS] * (count - 1)]]
    return [max(unheld.begun_ms + 1, idle_ms - ms) for ms in before_end_ms]


@pytest.mark.sampled(8)
@pytest.mark.parametrize("name", MOTIONS)
def test_hold_before_a_waiting_command_changes_nothing(name: str) -> None:
    rng = random.Random(name)
    first = list(MOTIONS).index(name) * _COMMANDS
    # each motion its own share of the commands
    some_commands = [COMMANDS[(first + i) % len(COMMANDS)] for i in range(_COMMANDS)]
    for command in COMMANDS if _EVERY else some_commands:
        for hold_ms in hold_times_ms(name, rng, 1):
            check_with_hold(name, command, hold_ms)


@pytest.mark.parametrize(("name", "command"), KNOWN)
def test_hold_in_last_segments_lets_command_wait(name: str, command: str) -> None:
    """The cases that failed first, at four instants each."""
    for hold_ms in hold_times_ms(name, random.Random(command), 4):
        check_with_hold(name, command, hold_ms)


@pytest.mark.parametrize("command", ["M5", "M2", "M4S200", "S100"])
def test_spindle_stopped_in_hold_obeys_waiting_command(command: str) -> None:
    """0x9e, sent during the hold, stops the spindle until `~`; then the command is executed."""
    for hold_ms in hold_times_ms("speed in motion", random.Random(command), 3):
        check_with_hold("speed in motion", command, hold_ms, held="\x9e")


@pytest.mark.parametrize("command", ["M3S700", "$1=50", "G10L2P1X1", "$H", "G4P1"])
def test_reset_in_hold_aborts_waiting_command(command: str) -> None:
    end = without_hold("line", "").ended_ms
    # hold 20 ms before the motion would end; 0x18: reset
    trial = Trial(MOTIONS["line"], command, end - 20, held="\x18").run()
    assert trial.in_hold["run"] == st.HOLD
    assert trial.at_last["run"] == st.IDLE and trial.at_last["steps"] == trial.in_hold["steps"]
    assert trial.at_last["stored"] == trial.before["stored"]
    assert trial.at_last["pins"] == (False, 0, 0, 0)  # tool and coolant are off


def test_soft_limit_alarm_comes_after_slowing_down() -> None:
    """With $20, a line beyond the travel is refused during a move: it ends in a hold before
    ALARM:2 stops the motors."""
    machine = Machine({**_FAST, 20: 1}, watched=False)
    rig = machine.rig
    stopped_in_motion = []

    def script() -> Iterator[Any]:
        """Send a hold and a line beyond the travel during a move; note whether stops cut
        motion."""
        yield from machine.start()
        stop = rig.engine.stop

        def noted_stop() -> None:
            stopped_in_motion.append(rig.moving())
            stop()

        rig.engine.stop = noted_stop  # type: ignore[method-assign]
        yield from machine.sender.wait("ok", "$X\n")
        yield from machine.sender.wait("ms 300", "G1X-50F6000\n")
        rig.link.send(b"!G1X500\n")
        yield rig.ms(1000)  # long enough to slow down, and for the alarm
        machine.take()

    machine.run(script())
    assert "ALARM:2" in machine.received
    assert stopped_in_motion and not any(stopped_in_motion)


def test_store_written_in_motion_is_a_fault() -> None:
    machine = Machine(watched=False)

    def script() -> Iterator[Any]:
        """Save offsets during a move, as no command may."""
        yield from machine.start()
        yield from machine.sender.wait("ms 100", "G1X1F100\n")
        machine.rig.controller.saves.save("coords", [])
        # the main loop calls this only while the machine is idle
        machine.rig.controller.saves.write_due()

    with pytest.raises(RuntimeError, match="while the motors turn"):
        machine.run(script())
