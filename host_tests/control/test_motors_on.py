"""Test that motors stay powered at every stop with $1=255, so that a heavy Z does not fall.

bench.say(text, ms) sends a text, lets time pass (1.5 s by default) and returns the lines received.
"""

from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

import pytest
from rig_bench import Machine
from ugrbl.boardfile.files import load_board
from ugrbl.sim.engine import Switch

_ALWAYS = {1: 255, 110: 3000, 111: 3000, 112: 3000, 120: 300, 121: 300, 122: 300}
_HOMING = {22: 1, 24: 300, 25: 1000, 26: 5, 27: 0.2, 130: 5, 131: 5, 132: 5}
_MOVE = "G91 G1 X9 F600\n"
_AFTER_MS = 1500  # an alarm is silent for half a second, and the delay of $1 is shorter

Script = Iterator[Any]


class Bench(Machine):
    """A machine with an emergency stop that records each level of its enable pin."""

    def __init__(self, settings: "dict[int, float]") -> None:
        """settings: values by $-number, in addition to those of _ALWAYS."""
        board = ModuleType("board")
        vars(board).update(vars(load_board("sim")), ESTOP=28)
        super().__init__({**_ALWAYS, **settings}, board, watched=False)
        self.enable_levels: list[int] = []
        self._enable = self.rig.port.enable
        self.rig.port.enable = self._note  # type: ignore[method-assign]

    def _note(self, level: int) -> None:
        self.enable_levels.append(level)
        self._enable(level)

    def say(self, text: str, ms: float = _AFTER_MS) -> Script:
        """Send text and let so many ms pass; return the lines received meanwhile."""
        self.take()
        yield from self.sender.wait(f"ms {ms}", text)
        return self.take()

    def push(self, **pins: bool) -> Script:
        """Set inputs, and let time pass; return the lines received meanwhile."""
        self.rig.port.push(pins)
        return self.say("")

    def add_switches(self, steps: int, bounces: int = 0) -> None:
        """Add a limit switch to each axis that closes at this position in steps, on the way
        down."""
        for axis, letter in enumerate("xyz"):
            self.rig.engine.switches.append(Switch(f"limit_{letter}", axis, False, steps, bounces))


# Ways of stopping, and the last message of each.


def end_of_a_move(bench: Bench) -> Script:
    return bench.say(_MOVE)


def hold(bench: Bench) -> Script:
    yield from bench.say(_MOVE, 200)
    return (yield from bench.say("!"))


def door(bench: Bench) -> Script:
    yield from bench.say("M3 S500\n" + _MOVE, 200)
    return (yield from bench.say("\x84"))


def jog_cancel(bench: Bench) -> Script:
    yield from bench.say("$J=G91 X9 F600\n", 200)
    return (yield from bench.say("\x85"))


def reset_in_motion(bench: Bench) -> Script:
    yield from bench.say(_MOVE, 200)
    return (yield from bench.say("\x18"))


def reset_in_hold(bench: Bench) -> Script:
    yield from hold(bench)
    return (yield from bench.say("\x18"))


def reset_at_rest(bench: Bench) -> Script:
    return bench.say("\x18")


def reset_button(bench: Bench) -> Script:
    """Press it during a move, then release it."""
    yield from bench.say(_MOVE, 200)
    yield from bench.push(reset=True)
    return (yield from bench.push(reset=False))


def hard_limit(bench: Bench) -> Script:
    """A limit switch closes during a move."""
    yield from bench.say(_MOVE, 200)
    return (yield from bench.push(limit_x=True))


def hard_limit_at_rest(bench: Bench) -> Script:
    return bench.push(limit_x=True)


def soft_limit(bench: Bench) -> Script:
    return bench.say("G91 G1 X-1 F600\nG53 G0 X-500\n")


def probe_touches_already(bench: Bench) -> Script:
    yield from bench.push(probe=True)
    return (yield from bench.say("G38.2 Z-1 F300\n"))


def probe_finds_nothing(bench: Bench) -> Script:
    return bench.say("G38.2 Z-0.1 F300\n")


def homing_reset(bench: Bench) -> Script:
    yield from bench.say("$H\n", 100)
    return (yield from bench.say("\x18"))


def homing_door(bench: Bench) -> Script:
    yield from bench.say("$H\n", 100)
    return (yield from bench.say("\x84"))


def homing_pull_off(bench: Bench) -> Script:
    """The switches stay closed, so that homing cannot pull off from them."""
    for pin in ("limit_x", "limit_y", "limit_z"):
        bench.rig.port.push({pin: True})
    return bench.say("$H\n")


def homing_finds_nothing(bench: Bench) -> Script:
    """No switch is pushed: the search ends at the end of travel."""
    return bench.say("$H\n")


def emergency_stop(bench: Bench) -> Script:
    """Press it during a move, then release it: its contact is normally closed."""
    yield from bench.say(_MOVE, 200)
    output = yield from bench.push(estop=False)
    yield from bench.push(estop=True)
    return output


def pin_callback_fails(bench: Bench) -> Script:
    """Do as a port whose pin callback has raised an exception, during a move."""
    yield from bench.say(_MOVE, 200)
    bench.rig.port.kill()
    bench.rig.port._listener.on_fault()  # type: ignore[union-attr]
    return (yield from bench.say(""))


def end_of_program(bench: Bench) -> Script:
    return bench.say(_MOVE + "M30\n")


def check_mode(bench: Bench) -> Script:
    yield from bench.say("$C\n" + _MOVE)
    return (yield from bench.say("$C\n"))


@pytest.mark.sampled(10)
@pytest.mark.parametrize("inverted", [0, 1], ids=["", "$4=1"])
@pytest.mark.parametrize(
    ("stop", "settings", "last"),
    [
        (end_of_a_move, {}, "ok"),
        (hold, {}, "ok"),
        (door, {}, "[MSG:Check Door]"),
        (jog_cancel, {}, "ok"),
        (reset_in_motion, {}, "ALARM:3"),
        (reset_in_hold, {}, "Grbl"),
        (reset_at_rest, {}, "Grbl"),
        (reset_button, {}, "ALARM:3"),
        (hard_limit, {21: 1}, "ALARM:1"),
        (hard_limit_at_rest, {21: 1}, "ALARM:1"),
        (soft_limit, {20: 1, **_HOMING}, "ALARM:2"),
        (probe_touches_already, {}, "ALARM:4"),
        (probe_finds_nothing, {}, "ALARM:5"),
        (homing_reset, _HOMING, "ALARM:6"),
        (homing_door, _HOMING, "ALARM:7"),
        (homing_pull_off, _HOMING, "ALARM:8"),
        (homing_finds_nothing, {**_HOMING, 25: 3000}, "ALARM:9"),
        (emergency_stop, {}, "ALARM:17"),
        (pin_callback_fails, {}, "ALARM:16"),
        (end_of_program, {}, "[MSG:Pgm End]"),
        (check_mode, {}, "[MSG:Disabled]"),
    ],
    ids=lambda value: getattr(value, "__name__", "").replace("_", " "),
)
def test_motors_stay_on(
    stop: "Callable[[Bench], Script]", settings: "dict[int, float]", last: str, inverted: int
) -> None:
    """The enable pin never changes: not at the stop, in the alarm, after a reset, or at the next
    move. last: a message that shows that the stop has happened."""
    bench = Bench({**settings, 4: inverted})

    def script() -> Script:
        """Start, stop in this way, then reset, unlock and move again."""
        yield from bench.start()
        if 22 in settings:  # homing is enabled: the machine starts locked
            yield from bench.say("$X\n")
        yield from bench.say("G91 G0 X-1\n")
        yield from stop(bench)
        output = "".join(bench.received)
        assert last in output, output
        # Release all inputs, reset, unlock, and move.
        for pin in ("limit_x", "limit_y", "limit_z", "probe"):
            bench.rig.port.push({pin: False})
        yield from bench.say("")
        yield from bench.say("\x18")
        yield from bench.say("$X\n")
        assert (yield from bench.say("G91 G0 X0.1\n"))[-1] == "ok"

    bench.run(script())
    assert set(bench.enable_levels) == {inverted}, bench.enable_levels  # $4=1 inverts the level


@pytest.mark.parametrize("homing", [0, 1])
def test_motors_are_on_from_power_up(homing: int) -> None:
    bench = Bench({22: homing})

    def script() -> Script:
        """Start, switch power off and on. The levels are those of the enable pin."""
        yield from bench.start()
        yield from bench.say("")
        assert bench.enable_levels == [0]  # 0: powered
        bench.rig.cycle_power()
        yield from bench.say("")
        assert bench.enable_levels == [0, 0]  # set again after power-up

    bench.run(script())


def test_sleep_releases_motors_until_they_move_again() -> None:
    """Levels: 0 powered, 1 released. As in Grbl: a user who puts the machine to sleep wants the
    motors released."""
    bench = Bench({})

    def script() -> Script:
        """Move, sleep, reset, unlock, move. Levels of the enable pin: 0 powered, 1 released."""
        yield from bench.start()
        yield from bench.say(_MOVE + "$SLP\n", 5000)
        assert bench.enable_levels == [0, 1]
        yield from bench.say("\x18")
        yield from bench.say("$X\n")
        assert bench.enable_levels == [0, 1]
        yield from bench.say(_MOVE)
        assert bench.enable_levels == [0, 1, 0]

    bench.run(script())


@pytest.mark.parametrize("stop", [end_of_a_move, reset_in_motion, probe_finds_nothing])
def test_motors_with_a_delay_are_released(stop: "Callable[[Bench], Script]") -> None:
    """With $1=25 the motors are released (level 1): the other tests of the file can fail."""
    bench = Bench({1: 25})

    def script() -> Script:
        yield from bench.start()
        yield from stop(bench)
        assert bench.enable_levels[-1] == 1

    bench.run(script())
