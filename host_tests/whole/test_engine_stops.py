"""How engines stop, rest and fail, and how the ESP32's handle slow hardware."""

import random
import sys
from array import array
from typing import Any

import pytest
from esp_bench import RMT_STEP, clock, esp32, esp_machine
from laws import Limits
from test_engines import _PULSE_US, ESP, WHOLE, Made, make, of_axis, planned

# Many cases of each: the first ring runs a sample.
pytestmark = pytest.mark.sampled(2)


@pytest.mark.parametrize("move", ["diagonal", "one step", "fast"])
@pytest.mark.parametrize("engine", WHOLE)
def test_rest_is_reported_once_and_after_the_last_power(engine: str, move: str) -> None:
    made = make(engine, move)
    told: list[int] = []
    made.engine.attach(made.bench.segments.next, made.powers.append, lambda: told.append(1))
    made.engine.start()
    while not made.engine.idle():
        assert not told
        made.run(0.5)
    made.engine.advance(made.engine.now + int(50_000 / made.us))
    assert told == [1]


@pytest.mark.parametrize("engine", WHOLE)
def test_rest_is_not_reported_after_a_stop(engine: str) -> None:
    made = make(engine, "fast")
    made.engine.start()
    made.run(100)
    made.engine.stop()
    made.engine.advance(made.engine.now + int(100_000 / made.us))
    assert made.rests == 0


@pytest.mark.parametrize("engine", WHOLE)
def test_a_stopped_engine_stays_stopped_until_it_is_armed(engine: str) -> None:
    made = make(engine, "fast")
    made.engine.stop()
    for _ in range(3):
        made.engine.start()
        made.engine.advance(made.engine.now + int(50_000 / made.us))
    assert made.steps == [] and made.engine.idle()
    made.engine.arm()
    made.go()
    assert made.places() == made.position() == [0, 0, 0] and made.steps


def count_lines_of_start(made: Made) -> int:
    """Start the engine; return how many lines of its Python are executed for that."""
    return start_and_stop(made, -1)


def start_and_stop(made: Made, at_line: int) -> int:
    """Start the engine, and stop it before the line with this number, from 0; -1: not at all.

    Return the number of lines executed. The stop's own lines are not counted.
    """
    count = 0

    def trace(frame: Any, event: str, _: Any) -> Any:
        nonlocal count
        if "esp_chip" not in frame.f_code.co_filename:
            return None
        if event == "line":
            if count == at_line:
                sys.settrace(None)
                made.engine.stop()
                sys.settrace(trace)
            count += 1
        return trace

    getattr(made.engine.real, "flash_written", int)()  # makes the start longer
    sys.settrace(trace)
    try:
        made.engine.real.start()
    finally:
        sys.settrace(None)
    return count


@pytest.mark.thorough
@pytest.mark.parametrize("engine", ESP)
def test_a_stop_during_the_start_wins(engine: str) -> None:
    """An interrupt may stop the engine between any two lines of the start."""
    for line in range(count_lines_of_start(make(engine, "fast"))):
        made = make(engine, "fast")
        start_and_stop(made, line)
        made.engine.advance(made.engine.now + 100_000 * made.engine._per_us)
        assert made.steps == [] and made.engine.idle() and made.engine.fault() == ""
        made.engine.arm()
        made.go()
        assert made.steps and made.places() == made.position()


@pytest.mark.parametrize("after_ms", [3, 77, 180])
@pytest.mark.parametrize("engine", ESP)
def test_a_failing_turn_stops_the_tool_then_the_motors_and_is_reported(
    engine: str, after_ms: float
) -> None:
    made = make(engine, "fast")
    real = made.engine.real
    order: list[str] = []
    halt = real._halt
    real._halt = lambda: (order.append("motors"), halt())
    real.on_fault = lambda: order.append("tool")
    made.engine.start()
    made.run(after_ms)

    def look() -> None:
        if not order:
            raise ValueError("an error that is ok")

    real.on_poll = look
    made.run(20)
    stopped = made.engine.now * made.us
    assert order == ["tool", "motors"] and not made.engine.idle()
    words = made.engine.fault().lower()
    assert "value" in words and "error" not in words and "ok" not in words
    made.engine.advance(made.engine.now + 200_000 * made.engine._per_us)
    assert all(us <= stopped for us, *_ in made.steps)
    made.engine.stop()
    assert made.engine.idle()
    off = [abs(a - b) for a, b in zip(made.position(), made.places(), strict=True)]
    assert max(off) <= 1
    made.engine.arm()
    assert made.engine.fault() == ""


@pytest.mark.parametrize("engine", ESP)
def test_the_engine_works_again_long_after_a_fault(engine: str) -> None:
    """Longer than the largest difference between two of its times."""
    made = make(engine, "diagonal")
    made.engine.real._fail(ValueError())
    made.engine.real._timer.deinit()
    clock.work(700_000_000)
    made.engine.stop()
    made.engine.real._timer.init(period=1, callback=made.engine.real._refill)
    made.run(30)
    made.engine.arm()
    made.go()
    assert made.engine.fault() == ""
    assert made.places() == made.position() == [1500, 1075, -425]


@pytest.mark.parametrize("what_fails", ["on_fault", "_halt"])
@pytest.mark.parametrize("engine", ESP)
def test_a_failure_during_fault_handling_does_not_prevent_the_stop(
    engine: str, what_fails: str
) -> None:
    made = make(engine, "fast")
    real = made.engine.real
    done: list[str] = []

    def fail() -> None:
        done.append(what_fails)
        raise OSError(5)

    for name in ("on_fault", "_halt", "on_poll"):
        setattr(real, name, lambda name=name: done.append(name))
    setattr(real, what_fails, fail)
    real._advance = fail
    made.engine.start()
    made.run(10)
    assert {"on_fault", "_halt"} <= set(done)
    assert "OS" in made.engine.fault()


@pytest.mark.parametrize("before_us", range(10_000, 600_000, 59_000))
@pytest.mark.parametrize("engine", ESP)
def test_motion_begins_at_once_even_right_before_the_clock_wraps(
    engine: str, before_us: int
) -> None:
    clock.us += -(clock.us + before_us) & 0x3FFFFFFF
    made = make(engine, "diagonal")
    made.engine.start()
    made.run(150)
    assert made.steps


@pytest.mark.parametrize("engine", ESP)
def test_motion_that_does_not_continue_is_a_fault(engine: str) -> None:
    made = make(engine, "diagonal")
    made.engine.start()
    made.run(100)
    assert made.engine.fault() == ""
    made.engine.real._timer.deinit()
    made.run(300)
    assert made.engine.fault() == ""
    made.run(400)
    assert "later than scheduled" in made.engine.fault()
    made.engine.stop()
    assert made.engine.fault() == "" and made.engine.idle()


@pytest.mark.parametrize("away_ms", [12, 60, 250])
@pytest.mark.parametrize("engine", ESP)
def test_interrupts_delayed_by_a_collection_come_late_and_lose_nothing(
    engine: str, away_ms: int
) -> None:
    made = make(engine, "diagonal")
    made.engine.start()
    for _ in range(4):
        made.run(90)
        clock.work(away_ms * 1000)
    made.run()
    assert made.position() == made.places() == [1500, 1075, -425]
    assert made.engine.fault() == "" and made.rests == 1


# RMT


@pytest.mark.parametrize("engine", ["rmt", "rmt_s3"])
def test_rmt_never_plays_more_than_a_channel_holds(engine: str) -> None:
    chance = random.Random(5)
    limits = Limits((400.0,) * 3, (60_000.0,) * 3, (5000.0,) * 3)
    made = Made(engine, limits)
    made.bench.line((20.0, 20.0, -7.0), 60_000.0)
    made.engine.start()
    while not made.engine.idle():
        made.run(chance.uniform(5, 30))
        for channel in esp32.RMT.channels:
            channel.flash_write(chance.randrange(20_000))
    assert made.places() == made.position() == [8000, 8000, -2800]
    for channel in esp32.RMT.channels:
        most = max(len(durations) for _, _, durations, _ in channel.trains)
        assert most <= 2 * (channel.symbols - 1)
    most = max(len(train[2]) for train in esp32.RMT.channels[0].trains)
    assert most > channel.symbols, "trains should be as long as allowed"


@pytest.mark.parametrize("engine", ["rmt", "rmt_s3"])
def test_rmt_disconnects_the_pins_while_the_channels_continue(engine: str) -> None:
    made = make(engine, "fast")
    made.engine.start()
    made.run(100)
    made.engine.stop()
    stopped = clock.us
    assert max(channel.trains[-1][3] for channel in esp32.RMT.channels) > stopped + 1500
    made.engine.advance(made.engine.now + 50_000)
    assert all(us <= stopped for us, *_ in made.steps)


@pytest.mark.parametrize("engine", ["rmt", "rmt_s3"])
def test_rmt_waits_for_the_end_of_disconnected_trains(engine: str) -> None:
    made = make(engine, "fast")
    made.engine.start()
    made.run(100)
    made.engine.stop()
    made.engine.arm()
    before = made.places()
    bench = made.bench
    bench.planner.clear()
    bench.segments.clear()
    bench.planner.sync_motors(array("i", made.position()))
    target = [p + 160 for p in made.position()]
    bench.line((target[0] / 80, target[1] / 80, target[2] / 400), 1200.0)
    made.go()
    assert made.position() == target
    assert [b - a for a, b in zip(before, made.places(), strict=True)] == [160, 160, 160]


def test_rmt_inverts_steps_in_the_pin_registers() -> None:
    made = make("rmt", "reversals")
    made.engine.configure(_PULSE_US, 0b010, 0)
    assert [word >> 9 & 1 for word in words_of_pins()] == [0, 1, 0]
    made.go()
    assert made.position() == made.places() == [0, 0, 0]
    assert [word >> 9 & 1 for word in words_of_pins()] == [0, 1, 0]
    made.engine.stop()
    assert [word & 0x300 for word in words_of_pins()] == [0x100, 0x300, 0x100]


def words_of_pins() -> "list[int]":
    """Return the GPIO matrix words of the step pins."""
    return [esp_machine.mem32.log[pin][-1][1] for pin in RMT_STEP[:3]]


def test_rmt_states_the_rate_at_which_trains_are_long_enough() -> None:
    assert Made("rmt", Limits()).engine.max_step_hz(_PULSE_US) == 20_000
    assert Made("rmt_s3", Limits()).engine.max_step_hz(_PULSE_US) == 7833


# I2S


@pytest.mark.parametrize("told", [True, False])
def test_i2s_begins_a_new_stream_after_a_flash_write(told: bool) -> None:
    made = make("i2s", "diagonal")
    made.engine.real._stream.close()
    made.engine.real._reopen()
    made.engine.advance(made.engine.now + 200_000 * made.engine._per_us)
    esp_machine.I2S.open_streams[0].flash_write(45_000)
    if told:
        made.engine.real.flash_written()
    made.go()
    assert made.position() == [1500, 1075, -425]
    due = planned(made)
    real = [of_axis(made.steps, axis) for axis in range(3)]
    as_planned = all(
        len(steps) == len(there)
        and all(
            abs((b - a) - (d - c)) < 20 for (a, _), (b, _), (c, _), (d, _) in gaps(there, steps)
        )
        for steps, there in zip(due, real, strict=True)
    )
    assert as_planned is told, "a wrong order of buffers must show, unless there is a new stream"


def gaps(real: Any, due: Any) -> Any:
    """Pair each step of an axis with its successor, as made and as planned."""
    return zip(real, real[1:], due, due[1:], strict=False)
