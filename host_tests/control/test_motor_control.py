"""Test the motor control: every stop switches the tool off first, then stops the motors."""

from types import SimpleNamespace
from typing import Any

import pytest
from base import errors
from base import state as st
from base.controls import EMERGENCY_STOP, RESET
from base.state import State
from control.coolant import Coolant
from control.motor_control import MotorControl
from fakes import Asked, FakeEngine, FakePort, FakeVoice

_STOPPED = ["kill", "stop"]  # calls of a stop: tool off (port), motors stopped (engine)


class Bench:
    """A motor control between fakes that append their calls to one list, `calls`; fails: see
    FakePort."""

    def __init__(self, fails: str = "") -> None:
        self.calls: Asked = []
        self.state = State()
        self.port, self.engine = FakePort(self.calls, fails), FakeEngine(self.calls)
        self.voice = FakeVoice(self.calls)
        self.settings: Any = SimpleNamespace(hard_limits=1, idle_lock_ms=25, enable_invert=0)
        machine: Any = SimpleNamespace(
            state=self.state,
            settings=self.settings,
            engine=self.engine,
            planner=SimpleNamespace(empty=lambda: True),
            segments=SimpleNamespace(hold=lambda on: None),
            spindle=SimpleNamespace(stop=lambda: self.calls.append("spindle stop")),
            coolant=Coolant(self.port, self.state),
            port=self.port,
            report=self.voice,
        )
        self.motor_control = MotorControl(machine)


@pytest.mark.parametrize(
    ("stop", "alarm", "by_pin"),
    [
        (lambda control: control.reset(), 0, False),
        (lambda control: control.on_limits(), errors.ALARM_HARD_LIMIT, True),
        (lambda control: control.on_controls(RESET), 0, True),
        (
            lambda control: control.on_controls(EMERGENCY_STOP),
            errors.ALARM_EMERGENCY_STOP,
            True,
        ),
        (lambda control: control.emergency(), errors.ALARM_EMERGENCY_STOP, False),
        (lambda control: control.on_fault(), errors.ALARM_INTERNAL, False),
    ],
    ids=["reset", "limit", "reset button", "emergency stop", "emergency, seen late", "fault"],
)
def test_tool_is_switched_off_before_motors_stop(stop: Any, alarm: int, by_pin: bool) -> None:
    """by_pin: the reset came from an input, not from the link; bytes sent before it are dropped
    then."""
    bench = Bench()
    stop(bench.motor_control)
    assert bench.calls == _STOPPED
    assert bench.state.pending[st.RESET] and bench.state.pending[st.ANY]
    assert (bench.state.alarm, bench.motor_control.by_pin) == (alarm, by_pin)


def test_motors_stop_even_when_switching_the_tool_off_fails() -> None:
    bench = Bench(fails="kill")
    with pytest.raises(OSError):
        bench.motor_control.reset()
    assert bench.calls == _STOPPED


def test_disabled_limit_stops_nothing() -> None:
    bench = Bench()
    bench.settings.hard_limits = 0
    bench.motor_control.on_limits()
    assert bench.calls == [] and not bench.state.pending[st.ANY]


def test_stop_stays_in_effect_when_the_machine_is_armed_again() -> None:
    """arm() enables motors and tool; if a reset waits to be executed, it stops them again."""
    bench = Bench()
    bench.motor_control.arm()
    assert bench.calls == ["arm", "revive"]
    bench.motor_control.on_controls(RESET)
    bench.calls.clear()
    bench.motor_control.arm()
    assert bench.calls == ["arm", "revive", *_STOPPED]


def test_motors_are_powered_before_they_move_and_released_later() -> None:
    """Released after the idle delay, 25 ms here; the clock of FakePort advances by 1 ms per
    reading. `enable 0`: powered."""
    bench = Bench()
    bench.motor_control.start(st.RUN)
    assert bench.calls == ["enable 0", "start"] and bench.state.run == st.RUN
    bench.motor_control.poll_motors()
    assert bench.motor_control.moving
    bench.engine.runs = False
    polls = 0
    while bench.motor_control.moving or bench.motor_control.in_idle_delay:
        bench.motor_control.poll_motors()
        polls += 1
    assert polls > 5 and bench.calls[-1] == "enable 1"
    assert bench.state.pending[st.CYCLE_STOP]


def test_engine_fault_is_raised_and_port_fault_is_reported() -> None:
    bench = Bench()
    bench.motor_control.start(st.RUN)
    bench.engine.told_fault = "motion is late"
    with pytest.raises(RuntimeError, match="motion is late"):
        bench.motor_control.poll_motors()
    bench.port.fault = "A pin's callback has failed"
    bench.motor_control.on_fault()
    report_cause = bench.motor_control.enter_alarm()  # the report is left to the caller
    assert bench.calls[-2:] == ["spindle stop", "coolant 0"] and report_cause
    report_cause()
    assert bench.calls[-1] == "message A pin's callback has failed"
