"""How engines stop, rest and fail, and how the ESP32's handle slow hardware.

make(engine, move) returns an EngineRig, of test_engines: an engine and planned motion that is not
started yet. rig.steps: steps at the pins as (us, axis, sign); counted_steps(): their sums;
reported_steps(): the engine's own count. rig.run(ms) runs it, until it is idle if no time is
given; rig.tick_us is the length of a tick of engine.now. engine.real: the firmware's engine within
the rig. clock.work(us): the CPU is busy, and no timer is served. "diagonal" ends at the steps
[1500, 1075, -425]; "fast", there and back, at 0.
"""

import random
import sys
from array import array
from typing import Any

import pytest
from esp_bench import RMT_STEP, clock, esp32, esp_machine
from laws import Limits
from test_engines import _PULSE_US, ESP, WHOLE, EngineRig, make, planned, steps_of_axis

# Many cases of each: the first ring runs a sample.
pytestmark = pytest.mark.sampled(2)


@pytest.mark.parametrize("move", ["diagonal", "one step", "fast"])
@pytest.mark.parametrize("engine", WHOLE)
def test_rest_is_reported_once_and_after_the_last_power(engine: str, move: str) -> None:
    """The engine calls attach()'s third function once, when motion has ended."""
    rig = make(engine, move)
    ends: list[int] = []
    rig.engine.attach(rig.bench.segments.next, rig.powers.append, lambda: ends.append(1))
    rig.engine.start()
    while not rig.engine.idle():
        assert not ends, "reported while moving"
        rig.run(0.5)
    rig.engine.advance(rig.engine.now + int(50_000 / rig.tick_us))  # 50 ms more
    assert ends == [1]


@pytest.mark.parametrize("engine", WHOLE)
def test_rest_is_not_reported_after_a_stop(engine: str) -> None:
    """The engine reports the end of motion (ends_reported counts that) only if it ends by
    itself."""
    rig = make(engine, "fast")
    rig.engine.start()
    rig.run(100)  # ms: in the middle of the motion
    rig.engine.stop()
    rig.engine.advance(rig.engine.now + int(100_000 / rig.tick_us))  # 100 ms
    assert rig.ends_reported == 0


@pytest.mark.parametrize("engine", WHOLE)
def test_a_stopped_engine_stays_stopped_until_it_is_armed(engine: str) -> None:
    """start() is without effect after stop(), until arm() allows motion again."""
    rig = make(engine, "fast")
    rig.engine.stop()
    for _ in range(3):
        rig.engine.start()
        rig.engine.advance(rig.engine.now + int(50_000 / rig.tick_us))  # 50 ms
    assert rig.steps == [] and rig.engine.idle()
    rig.engine.arm()
    rig.run_to_end()
    # The planned motion, there and back, has been executed.
    assert rig.counted_steps() == rig.reported_steps() == [0, 0, 0] and rig.steps


def count_lines_of_start(rig: EngineRig) -> int:
    """Start the engine; return how many lines of its Python are executed for that."""
    return start_and_stop(rig, -1)


def start_and_stop(rig: EngineRig, at_line: int) -> int:
    """Start the engine, and stop it before executing a line of its Python code.

    at_line: the number of that line in the order of execution, from 0; -1: do not stop. Return the
    number of lines executed, without those of the stop.
    """
    count = 0

    def trace(frame: Any, event: str, _: Any) -> Any:
        """Count the lines of the ESP32's engine; call stop() before number at_line."""
        nonlocal count
        if "esp_chip" not in frame.f_code.co_filename:
            return None
        if event == "line":
            if count == at_line:
                sys.settrace(None)  # the lines of stop() are not to be counted
                rig.engine.stop()
                sys.settrace(trace)
            count += 1
        return trace

    # After a flash write the start has more to do. RMT has no such method: int() does nothing.
    getattr(rig.engine.real, "flash_written", int)()
    sys.settrace(trace)
    try:
        rig.engine.real.start()
    finally:
        sys.settrace(None)
    return count


@pytest.mark.thorough
@pytest.mark.parametrize("engine", ESP)
def test_a_stop_during_the_start_wins(engine: str) -> None:
    """An interrupt may stop the engine between any two lines of the start."""
    for line in range(count_lines_of_start(make(engine, "fast"))):
        rig = make(engine, "fast")
        start_and_stop(rig, line)
        rig.engine.advance(rig.engine.now + 100_000 * rig.engine._per_us)  # 100 ms
        assert rig.steps == [] and rig.engine.idle() and rig.engine.fault() == ""
        rig.engine.arm()
        rig.run_to_end()
        assert rig.steps and rig.counted_steps() == rig.reported_steps()


@pytest.mark.parametrize("after_ms", [3, 77, 180])
@pytest.mark.parametrize("engine", ESP)
def test_a_failing_turn_stops_the_tool_then_the_motors_and_is_reported(
    engine: str, after_ms: float
) -> None:
    """An exception in the engine's timer function, a "turn", which also calls on_poll."""
    rig = make(engine, "fast")
    real = rig.engine.real
    order: list[str] = []  # what has been stopped, in this order
    halt = real._halt  # stops the motors
    real._halt = lambda: (order.append("motors"), halt())
    real.on_fault = lambda: order.append("tool")
    rig.engine.start()
    rig.run(after_ms)

    def fail_once() -> None:
        if not order:
            raise ValueError("an error that is ok")

    real.on_poll = fail_once
    rig.run(20)  # ms
    stopped_us = rig.engine.now * rig.tick_us
    assert order == ["tool", "motors"] and not rig.engine.idle()  # until stop()
    message = rig.engine.fault().lower()
    # It names the exception, but not its text, which a sender might take for an answer.
    assert "value" in message and "error" not in message and "ok" not in message
    rig.engine.advance(rig.engine.now + 200_000 * rig.engine._per_us)  # 200 ms
    assert all(us <= stopped_us for us, *_ in rig.steps)
    rig.engine.stop()
    assert rig.engine.idle()
    differences = [
        abs(a - b) for a, b in zip(rig.reported_steps(), rig.counted_steps(), strict=True)
    ]
    assert max(differences) <= 1  # step: one may have been on its way
    rig.engine.arm()
    assert rig.engine.fault() == ""


@pytest.mark.parametrize("engine", ESP)
def test_the_engine_works_again_long_after_a_fault(engine: str) -> None:
    """700 s after the fault: more time than the engine can measure between two clock readings."""
    rig = make(engine, "diagonal")
    rig.engine.real._fail(ValueError())  # as if a turn had raised this
    rig.engine.real._timer.deinit()  # no turns in the meantime
    clock.work(700_000_000)  # 700 s; ticks_us() wraps after 2**30 us, differences after half
    rig.engine.stop()
    # The timer calls the turns each millisecond again.
    rig.engine.real._timer.init(period=1, callback=rig.engine.real._refill)
    rig.run(30)
    rig.engine.arm()
    rig.run_to_end()
    assert rig.engine.fault() == ""
    assert rig.counted_steps() == rig.reported_steps() == [1500, 1075, -425]


@pytest.mark.parametrize("what_fails", ["on_fault", "_halt"])
@pytest.mark.parametrize("engine", ESP)
def test_a_failure_during_fault_handling_does_not_prevent_the_stop(
    engine: str, what_fails: str
) -> None:
    """The turn fails, and so does one of the two functions that then stop tool and motors."""
    rig = make(engine, "fast")
    real = rig.engine.real
    called: list[str] = []

    def fail() -> None:
        called.append(what_fails)
        raise OSError(5)

    # Replace all three by functions that only note the call; then one by fail().
    for name in ("on_fault", "_halt", "on_poll"):
        setattr(real, name, lambda name=name: called.append(name))
    setattr(real, what_fails, fail)
    real._advance = fail  # the first failure: this is called in each turn
    rig.engine.start()
    rig.run(10)  # ms
    assert {"on_fault", "_halt"} <= set(called)
    assert "OS" in rig.engine.fault()


@pytest.mark.parametrize("before_us", range(10_000, 600_000, 59_000))
@pytest.mark.parametrize("engine", ESP)
def test_motion_begins_at_once_even_right_before_the_clock_wraps(
    engine: str, before_us: int
) -> None:
    """The clock of ticks_us() is set before_us before its wrap; steps must come within 150 ms."""
    clock.us += -(clock.us + before_us) & 0x3FFFFFFF  # ticks_us() wraps to 0 at 2**30
    rig = make(engine, "diagonal")
    rig.engine.start()
    rig.run(150)  # ms
    assert rig.steps


@pytest.mark.parametrize("engine", ESP)
def test_motion_that_does_not_continue_is_a_fault(engine: str) -> None:
    """fault() reports a pause of more than about half a second in motion, and stop() clears it."""
    rig = make(engine, "diagonal")
    rig.engine.start()
    rig.run(100)
    assert rig.engine.fault() == ""
    rig.engine.real._timer.deinit()  # no more turns: the engine gets no new segments
    rig.run(300)  # ms
    assert rig.engine.fault() == ""
    rig.run(400)
    assert "later than scheduled" in rig.engine.fault()
    rig.engine.stop()
    assert rig.engine.fault() == "" and rig.engine.idle()


@pytest.mark.parametrize("away_ms", [12, 60, 250])
@pytest.mark.parametrize("engine", ESP)
def test_interrupts_delayed_by_a_collection_come_late_and_lose_nothing(
    engine: str, away_ms: int
) -> None:
    """The garbage collector stops Python for away_ms, four times: motion pauses, no step is
    lost."""
    rig = make(engine, "diagonal")
    rig.engine.start()
    for _ in range(4):
        rig.run(90)  # ms
        clock.work(away_ms * 1000)  # the collection: no interrupt is served
    rig.run()
    assert rig.reported_steps() == rig.counted_steps() == [1500, 1075, -425]
    assert rig.engine.fault() == "" and rig.ends_reported == 1


# RMT


@pytest.mark.parametrize("engine", ["rmt", "rmt_s3"])
def test_rmt_never_plays_more_than_a_channel_holds(engine: str) -> None:
    """A longer train would be refilled by an interrupt, which a flash write delays.

    channel.trains: those played, (start us, level, durations, end us). A symbol has two durations.
    """
    random_numbers = random.Random(5)
    # steps/mm, mm/min, mm/s²: fast, so that trains of pulses become as long as possible.
    limits = Limits((400.0,) * 3, (60_000.0,) * 3, (5000.0,) * 3)
    rig = EngineRig(engine, limits)
    rig.bench.line((20.0, 20.0, -7.0), 60_000.0)
    rig.engine.start()
    while not rig.engine.idle():
        rig.run(random_numbers.uniform(5, 30))  # ms
        for channel in esp32.RMT.channels:
            channel.flash_write(random_numbers.randrange(20_000))  # us without interrupts
    assert rig.counted_steps() == rig.reported_steps() == [8000, 8000, -2800]  # 400 steps/mm
    for channel in esp32.RMT.channels:
        longest = max(len(durations) for _, _, durations, _ in channel.trains)
        assert longest <= 2 * (channel.symbols - 1)
    longest = max(len(train[2]) for train in esp32.RMT.channels[0].trains)
    assert longest > channel.symbols, "trains should be as long as allowed"


@pytest.mark.parametrize("engine", ["rmt", "rmt_s3"])
def test_rmt_disconnects_the_pins_while_the_channels_continue(engine: str) -> None:
    """A train of pulses cannot be cut off in the channel, so stop() routes the pins elsewhere."""
    rig = make(engine, "fast")
    rig.engine.start()
    rig.run(100)  # ms
    rig.engine.stop()
    stopped_us = clock.us
    # A train is (start us, level, durations, end us): some channel plays 1.5 ms longer.
    last_end_us = max(channel.trains[-1][3] for channel in esp32.RMT.channels)
    assert last_end_us > stopped_us + 1500
    rig.engine.advance(rig.engine.now + 50_000)  # ticks of 1 us
    assert all(us <= stopped_us for us, *_ in rig.steps)


@pytest.mark.parametrize("engine", ["rmt", "rmt_s3"])
def test_rmt_waits_for_the_end_of_disconnected_trains(engine: str) -> None:
    """New motion right after a stop must not begin with what a channel still plays."""
    rig = make(engine, "fast")
    rig.engine.start()
    rig.run(100)  # ms: trains are being played
    rig.engine.stop()
    rig.engine.arm()
    before = rig.counted_steps()
    bench = rig.bench
    # Plan anew from the position of the stop.
    bench.planner.clear()
    bench.segments.clear()
    bench.planner.sync_motors(array("i", rig.reported_steps()))
    target = [steps + 160 for steps in rig.reported_steps()]
    # "fast" has 80, 80 and 400 steps/mm.
    bench.line((target[0] / 80, target[1] / 80, target[2] / 400), feed=1200.0)
    rig.run_to_end()
    assert rig.reported_steps() == target
    # All 160 steps are at the pins: none came during the rest of an old train.
    assert [b - a for a, b in zip(before, rig.counted_steps(), strict=True)] == [160, 160, 160]


def test_rmt_inverts_steps_in_the_pin_registers() -> None:
    """Bit 9 of a pin's word in the GPIO matrix inverts its output; words_of_pins() has X, Y, Z."""
    rig = make("rmt", "reversals")
    rig.engine.configure(_PULSE_US, 0b010, 0)  # step_invert: axis 1; dir_invert: none
    assert [word >> 9 & 1 for word in words_of_pins()] == [0, 1, 0]
    rig.run_to_end()
    assert rig.reported_steps() == rig.counted_steps() == [0, 0, 0]
    assert [word >> 9 & 1 for word in words_of_pins()] == [0, 1, 0]
    rig.engine.stop()
    # 0x100: not connected to RMT, level 0; with bit 9: level 1, no pulse for axis 1.
    assert [word & 0x300 for word in words_of_pins()] == [0x100, 0x300, 0x100]


def words_of_pins() -> "list[int]":
    """Return the GPIO matrix words of the step pins."""
    return [esp_machine.mem32.log[pin][-1][1] for pin in RMT_STEP[:3]]


def test_rmt_states_the_rate_at_which_trains_are_long_enough() -> None:
    assert EngineRig("rmt", Limits()).engine.max_step_hz(_PULSE_US) == 20_000
    assert EngineRig("rmt_s3", Limits()).engine.max_step_hz(_PULSE_US) == 7833


# I2S


@pytest.mark.parametrize("notified", [True, False])
def test_i2s_begins_a_new_stream_after_a_flash_write(notified: bool) -> None:
    """A flash write disorders the DMA's buffers; flash_written() makes the engine start anew.

    Without that call (notified is False) the model must show the disorder: steps at wrong times.
    """
    rig = make("i2s", "diagonal")
    # A new stream, which a pause of 200 ms, and a flash write of 45 ms, follow before motion.
    rig.engine.real._stream.close()
    rig.engine.real._reopen()
    rig.engine.advance(rig.engine.now + 200_000 * rig.engine._per_us)
    esp_machine.I2S.open_streams[0].flash_write(45_000)
    if notified:
        rig.engine.real.flash_written()
    rig.run_to_end()
    assert rig.reported_steps() == [1500, 1075, -425]
    due = planned(rig)
    real = [steps_of_axis(rig.steps, axis) for axis in range(3)]
    # Every interval between steps at the pins is within 20 us of the planned one.
    as_planned = all(
        len(due_steps) == len(real_steps)
        and all(
            abs((b - a) - (d - c)) < 20
            for (a, _), (b, _), (c, _), (d, _) in pair_gaps(real_steps, due_steps)
        )
        for due_steps, real_steps in zip(due, real, strict=True)
    )
    assert as_planned is notified, (
        "a wrong order of buffers must show, unless there is a new stream"
    )


def pair_gaps(real: Any, due: Any) -> Any:
    """Pair each step of an axis with its successor, as made and as planned."""
    return zip(real, real[1:], due, due[1:], strict=False)
