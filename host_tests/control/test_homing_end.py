"""Test the last pause of $H ($26), in which a door no longer ends it by an alarm.

A script yields a condition, or the tick at which it is resumed; rig.ms(n) is n ms from now.
"""

from collections.abc import Iterator
from functools import cache
from typing import Any

import pytest
from rig_bench import Machine
from ugrbl.sim.engine import Switch

_HOMING = {22: 1, 24: 500, 25: 3000, 26: 20, 27: 1, 110: 3000, 111: 3000, 112: 3000}
_FIRST_SWITCH_STEPS = 500  # from the start
_ALL_AXES = 7  # their mask


def machine_with_switches() -> Machine:
    machine = Machine(_HOMING, watched=False)
    for axis, letter in enumerate("xyz"):
        switch = Switch(f"limit_{letter}", axis, above=True, steps=_FIRST_SWITCH_STEPS)
        machine.rig.engine.switches.append(switch)
    return machine


@cache
def duration() -> int:
    """Return the time from $H until all axes are homed, in ticks."""
    machine = machine_with_switches()
    rig, ticks = machine.rig, []

    def script() -> Iterator[Any]:
        yield from machine.start()
        started = rig.now
        rig.link.send(b"$H\n")
        while rig.controller.homing_probing.homed != _ALL_AXES:
            yield rig.ms(0.1)
        ticks.append(rig.now - started)

    machine.run(script())
    return ticks[0]


@pytest.mark.parametrize("opens", [b"\x84", b"!\x84"], ids=["door", "hold and door"])
@pytest.mark.parametrize("before_end_us", range(-1000, 23000, 1500))
def test_door_at_the_end_of_homing_can_be_closed(before_end_us: int, opens: bytes) -> None:
    """Either 0x84 (door) is in time for ALARM:7, or the machine waits for `~` and is homed."""
    machine = machine_with_switches()
    rig = machine.rig

    def script() -> Iterator[Any]:
        yield from machine.start()
        started = rig.now
        rig.link.send(b"$H\n")
        yield started + duration() - int(before_end_us * rig.ticks_per_ms / 1000)
        rig.link.send(opens)
        yield rig.ms(500)  # the door is handled, if it was in time
        rig.link.send(b"~")
        yield rig.ms(5000)  # also restores the spindle
        lines = machine.take()
        assert "ok" in lines or "ALARM:7" in lines, lines

    machine.run(script())
