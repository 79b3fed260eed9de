"""Test a probe that touches around a hold: only braking steps follow the contact.

A phase is one probing move with a hold and a contact, each at a time in ms after its start. The
move ends where the braking that began first ends; that place is compared with a move that is
stopped only once. A script yields a condition, or the tick at which it is resumed; rig.ms(n) is
the tick n ms from now.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from rig_bench import Machine

# Many cases: the first ring runs a sample of them.
pytestmark = pytest.mark.sampled(4)

_FAST = {110: 3000, 111: 3000, 112: 3000, 120: 200, 121: 200, 122: 200}
_PER_MM = 250
_Z = 2
_HOLD, _DOOR, _RESUME = "!", "\x84", "~"
# For `G38.n Z-3 F600`: it reaches 10 mm/s in 50 ms, and brakes in the same time.
_LINE, _END_STEPS = "G38.%d Z-3 F600", -3 * _PER_MM
_BRAKES_MS = 80  # includes the segments that the engine has already

Script = Iterator[Any]


@dataclass
class Stop:
    """A way to hold.

    send: bytes; pin: an input; parks: the machine is homed and below Z-5.
    """

    name: str
    board: str = "sim"
    send: str = ""
    pin: str = ""
    parks: bool = False


STOPS = (
    Stop("hold", send=_HOLD),
    Stop("door", send=_DOOR),
    Stop("hold button", pin="hold"),
    Stop("door switch", board="sim_door", pin="hold"),
    Stop("parking", board="sim_parking", send=_DOOR, parks=True),
)


class Bench(Machine):
    """A machine that probes repeatedly from the same place. top_steps: its Z in steps, from which
    z_steps() counts."""

    def __init__(self, stop: Stop) -> None:
        settings = {**_FAST, 22: 1} if stop.parks else _FAST
        super().__init__(settings, stop.board, watched=False)
        self.stop = stop
        self.top_steps = 0

    def start_at_top(self) -> Script:
        """Start the machine; for parking, unlock it and move to Z-20."""
        yield from self.start()
        if self.stop.parks:
            yield from self.say("$X\nG21 G90 G0 Z-20\n")
            self.top_steps = -20 * _PER_MM

    def say(self, text: str, how: str = "idle") -> Script:
        """Send text and wait (how: see Sender.wait); return the lines received."""
        self.take()
        yield from self.sender.wait(how, text)
        return self.take()

    def z_steps(self) -> int:
        """Return the steps since the start of the probing move."""
        return self.physical()[_Z] - self.top_steps

    def set_probe(self, touches: bool) -> None:
        self.rig.port.push({"probe": touches})

    def hold(self) -> None:
        """Send the byte of this way to hold, or push its input."""
        if self.stop.pin:
            self.rig.port.push({self.stop.pin: True})
        self.rig.link.send(self.stop.send.encode("latin-1"))

    def resume(self) -> Script:
        """Release the pin of the hold and resume with `~`; wait until the machine is idle."""
        yield self.rig.ms(40)  # the delay before the hold is complete ($1)
        if self.stop.pin:
            self.rig.port.push({self.stop.pin: False})
            yield self.rig.ms(30)  # the main loop sees it
        yield from self.say(_RESUME, "ms 30")
        yield self.idle

    def probe(self, word: int, events: "dict[float, Any]") -> Script:
        """Start G38.`word` and wait until it stops.

        events: ms after the first step -> function, which is called with the state of the probe
        that ends the move: G38.2 and .3 end at a contact, .4 and .5 when it is lost.
        """
        starts_closed = word > 3
        self.set_probe(starts_closed)
        yield from self.say("G90 G0 Z%g\n" % (self.top_steps / _PER_MM))
        assert self.z_steps() == 0
        self.rig.link.send(b"G91 " + (_LINE % word).encode() + b"\n")
        yield self.rig.moving
        start = self.rig.now
        for ms in sorted(events):
            yield start + int(ms * self.rig.ticks_per_ms)
            events[ms](not starts_closed)
        yield self.rig.ms(_BRAKES_MS)
        while self.rig.moving():
            yield self.rig.ms(5)

    def state(self) -> Script:
        """Return the state in the status report, e.g. "Idle"."""
        output = yield from self.say("?", "report")
        return output[-1][1:].split("|")[0].split(":")[0]

    def stop_positions(self, word: int, how: str, times_ms: "list[int]") -> Script:
        """Return Z in steps where moves stop that are only held (how: "hold") or only touch (how:
        "contact"), by the time in ms."""
        z_by_ms = {}
        for ms in times_ms:
            if how == "hold":
                yield from self.probe(word, {ms: lambda _: self.hold()})
                z_by_ms[ms] = self.z_steps()
                yield from self.resume()
            else:
                yield from self.probe(word, {ms: self.set_probe})
                z_by_ms[ms] = self.z_steps()
                yield self.idle
            yield from self.unlock_if_alarm()
        return z_by_ms

    def unlock_if_alarm(self) -> Script:
        """Leave the alarm of a probe without contact."""
        yield self.rig.ms(30)  # the alarm is reported
        if (yield from self.state()) == "Alarm":
            yield self.rig.ms(600)  # until the reset after the alarm is over
            yield from self.say("$X\n")


def probe_result(output: "list[str]") -> "tuple[int, int]":
    """Return the result in the first [PRB:…]: Z in steps, and 1 if the probe succeeded."""
    prb = next(line for line in output if line.startswith("[PRB:"))
    places, success = prb[5:-1].split(":")
    return round(float(places.split(",")[_Z]) * _PER_MM), int(success)


def hold_and_touch(
    bench: Bench, word: int, hold_ms: float, contact_ms: float, stop_steps: int
) -> Script:
    """Hold and touch at these times; check what holds in any order. stop_steps: where the
    move must stop."""
    z_at_contact: list[int] = []

    def touch(touches: bool) -> None:
        z_at_contact.append(bench.z_steps())
        bench.set_probe(touches)

    times_ms = hold_ms, contact_ms
    said_before = len(bench.received)
    yield from bench.probe(word, {hold_ms: lambda _: bench.hold(), contact_ms: touch})
    assert bench.z_steps() == stop_steps, times_ms
    yield bench.rig.ms(300)  # until the hold is complete
    assert bench.z_steps() == stop_steps, ("in the hold", times_ms)
    yield from bench.resume()
    yield bench.rig.ms(50)
    assert bench.z_steps() == stop_steps, ("after ~", times_ms)
    assert (yield from bench.state()) == "Idle", times_ms
    bench.take()
    lines = bench.received[said_before:]
    assert probe_result(lines) == (bench.top_steps + z_at_contact[0], 1), times_ms
    # An ok for the probing line, and one for the line that moved to its start.
    assert lines.count("ok") == 2, (lines, times_ms)
    reported_mm = [float(n) for n in lines[-1].split("MPos:")[1].split("|")[0].split(",")]
    assert round(reported_mm[_Z] * _PER_MM) == bench.top_steps + stop_steps, times_ms
    yield from bench.say("G91 G0 Z1\n")  # the next move begins where the motors are
    assert bench.z_steps() == stop_steps + _PER_MM, ("planned from elsewhere", times_ms)


@pytest.mark.parametrize("word", [2, 3, 4, 5])
@pytest.mark.parametrize("stop", STOPS, ids=lambda stop: stop.name)
def test_only_braking_steps_follow_the_contact(stop: Stop, word: int) -> None:
    """Hold at 100 ms; contacts come from then until long after its braking."""
    bench = Bench(stop)
    # Each case has its own offset: together the cases try every ms.
    phases_ms = range((4 * STOPS.index(stop) + word) % 14, 140, 14)

    def script() -> Script:
        yield from bench.start_at_top()
        stops_at_steps = yield from bench.stop_positions(word, "hold", [100])
        for delay_ms in phases_ms:
            yield from hold_and_touch(bench, word, 100, 100 + delay_ms + 0.5, stops_at_steps[100])

    bench.run(script())


@pytest.mark.parametrize("word", [2, 5])
@pytest.mark.parametrize("stop", STOPS, ids=lambda stop: stop.name)
def test_hold_after_the_contact_changes_nothing(stop: Stop, word: int) -> None:
    """Contact at 100 ms, hold up to 60 ms later: the move stops where the contact alone
    stops it."""
    bench = Bench(stop)

    def script() -> Script:
        yield from bench.start_at_top()
        stops_at_steps = yield from bench.stop_positions(word, "contact", [100])
        for delay_ms in range(1 + (STOPS.index(stop) + word) % 6, 60, 6):
            yield from hold_and_touch(bench, word, 100 + delay_ms, 100, stops_at_steps[100])

    bench.run(script())


@pytest.mark.parametrize("stop", STOPS, ids=lambda stop: stop.name)
def test_contact_that_ends_before_motion_resumes_is_ignored(stop: Stop) -> None:
    """A probe touched by hand during a hold still finds the work afterwards."""
    bench = Bench(stop)

    def script() -> Script:
        """Hold a probing move; touch and release the probe; resume, and touch it further down."""
        yield from bench.start_at_top()
        yield from bench.probe(2, {100: lambda _: bench.hold()})
        held_at_steps = bench.z_steps()
        yield bench.rig.ms(100)  # until it has stopped
        for touches in (True, False):
            bench.set_probe(touches)
            yield bench.rig.ms(50)  # several checks of the probe
        yield from bench.say(_RESUME, "ms 1")
        if bench.stop.pin:  # an open door prevents that: close it, and resume again
            bench.rig.port.push({bench.stop.pin: False})
            yield bench.rig.ms(30)  # the main loop sees it
            bench.rig.link.send(_RESUME.encode())
        yield lambda: bench.z_steps() < held_at_steps - 20  # resumed: it moves down again
        z_at_contact = bench.z_steps()
        bench.set_probe(True)
        yield bench.idle
        yield bench.rig.ms(100)  # all output has arrived
        bench.take()
        assert probe_result(bench.received) == (bench.top_steps + z_at_contact, 1)
        assert _END_STEPS < bench.z_steps() < z_at_contact

    bench.run(script())


def test_jog_cancel_does_not_end_a_probe() -> None:
    """The byte 0x85 cancels jogs only: the probe moves to its end, without a contact."""
    bench = Bench(STOPS[0])

    def script() -> Script:
        """Probe with G38.3; 50 ms after its first step send the byte that cancels jogs."""
        yield from bench.start_at_top()
        yield from bench.probe(3, {50: lambda _: bench.rig.link.send(b"\x85")})
        yield bench.idle
        yield bench.rig.ms(100)  # all output has arrived
        bench.take()
        assert bench.z_steps() == _END_STEPS and probe_result(bench.received)[1] == 0

    bench.run(script())


def test_machine_does_not_park_while_it_probes() -> None:
    """The way back would run into the object that the probe has touched."""
    bench = Bench(STOPS[-1])  # parking

    def script() -> Script:
        """Open the door 100 ms after the first step of a probing move; wait, and resume."""
        yield from bench.start_at_top()
        yield from bench.probe(3, {100: lambda _: bench.hold()})
        held_at_steps = bench.z_steps()
        yield bench.rig.ms(1000)  # parking would have begun
        assert bench.z_steps() == held_at_steps and (yield from bench.state()) == "Door"
        yield from bench.resume()
        assert bench.z_steps() == _END_STEPS

    bench.run(script())


@pytest.mark.parametrize("touches", [False, True])
def test_motion_is_free_after_a_reset_in_the_hold_of_a_probe(touches: bool) -> None:
    """The probe no longer ends moves, whether it touches or not."""
    bench = Bench(STOPS[0])  # hold by `!`

    def script() -> Script:
        """Hold a probing move, reset, unlock, and move 1 mm down."""
        yield from bench.start_at_top()
        yield from bench.probe(2, {100: lambda _: bench.hold()})
        yield bench.rig.ms(100)  # until it has stopped
        yield from bench.say("\x18", "banner")
        bench.set_probe(touches)
        yield from bench.say("$X\n")
        held_at_steps = bench.z_steps()
        assert (yield from bench.say("G91 G1 Z-1 F600\n")) == ["ok"]
        assert bench.z_steps() == held_at_steps - _PER_MM

    bench.run(script())
