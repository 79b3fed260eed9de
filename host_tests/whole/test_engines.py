"""The laws that every pulse engine keeps: its output to hardware, turned back into steps.

sim: the simulator's engine. pio: the words of firmware/pio, played by the timing that
programs.py states. i2s, rmt: the whole engines on stand-ins of the ESP32's hardware.

make(engine, move) returns an EngineRig: a bench (planner and segments) with an engine, and planned
motion by its name in moves(). rig.run_to_end() executes it. clock.work(us): the CPU is busy, and
no timer is served. TOLERANCES: those an engine states, by its name, in us: steps may come `early`
and `late`, motion may pause for `gap`, axes may drift `apart`; in ms: hold_ms, lock_ms.

A segment is an array, a "row": ROW_TICKS its duration, ROW_DIRS a bit per motor (1: negative),
ROW_POWER the laser's power, and from ROW_AXES on, ROW_STRIDE values per motor: its number of
steps, and the ticks of the first and the last one; the others are evenly spaced.
"""

import json
import random
from array import array
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from esp_bench import I2S_ENABLE, EspEngine, Step, clock, esp32
from laws import Bench, Limits
from motion.layout import ROW_AXES, ROW_DIRS, ROW_POWER, ROW_STRIDE, ROW_TICKS, row_length
from pio import pulses
from ugrbl.boardfile.files import load_board
from ugrbl.replay.compare_motion import judge_motion
from ugrbl.sim import replay
from ugrbl.sim import rig as sim_rig
from ugrbl.sim.engine import SimEngine, step_tick

# Many cases of each: the first ring runs a sample.
pytestmark = pytest.mark.sampled(2)

_SHARED = Path(__file__).resolve().parents[3] / "shared"
_PULSE_US = 10  # length of a step pulse, $0


@dataclass
class Tolerances:
    """An engine's stated tolerances, in us: README and board files state the same."""

    early: float  # how much earlier than planned a step may come after the one before
    late: float  # the same for later, unless motion pauses
    gap: float  # longest pause, at the ends of trains
    apart: float  # how far axes may drift against each other
    hold_ms: float  # motion already handed over, which delays a hold
    lock_ms: float = 0.0  # how long a locked axis continues


TOLERANCES = {
    "sim": Tolerances(0.1, 0.1, 0, 0.1, 60),
    "pio": Tolerances(0.2, 0.2, 0, 0.2, 10),
    "i2s": Tolerances(17, 17, 0, 17, 40, 33),
    "rmt": Tolerances(60, 60, 600, 100, 50),
    "rmt_s3": Tolerances(60, 60, 600, 100, 50),
}
_TURN_US = 14  # additional delay of all axes for a reversal
ENGINES = ("sim", "i2s", "rmt", "rmt_s3", "pio")
WHOLE = ("sim", "i2s", "rmt", "rmt_s3")  # engines whose hardware is modelled too
ESP = ("i2s", "rmt", "rmt_s3")  # rmt_s3: on an ESP32-S3, with smaller channels
MOST_MOTORS = {"rmt": 4, "rmt_s3": 4, "i2s": 6}  # others: 8


class EngineRig:
    """A bench with an engine, and the steps that it made."""

    def __init__(self, name: str, limits: Limits) -> None:
        """Connect planner, segments and engine. name: of ENGINES; limits: of the axes."""
        self.name = name
        motors = len(limits.moves or limits.rate)
        self.engine: Any
        if name in ESP:
            self.engine = EspEngine(name, motors)
            # tick frequency, log2 of a full segment's ticks, highest step frequency
            hz, log2 = self.engine.tick_hz, self.engine.segment_log2
            most = self.engine.max_step_hz(_PULSE_US)
        elif name == "pio":  # no engine object: see _play_words()
            hz, log2, most = 12_500_000, 16, 12_500_000 // pulses.shortest_gap(125)
        else:
            self.engine = SimEngine(motors)
            hz, log2, most = SimEngine.tick_hz, 17, 90_909  # 1 / (10 us pulse + 1 us pause)
        limits.step_hz = min(limits.step_hz, most)
        self.tick_us = 1_000_000 / hz  # of a tick
        self.bench = Bench(limits, 64, hz, log2)  # 64 planner blocks
        self.steps: list[Step] = []  # (us, axis, sign)
        self.powers: list[int] = []  # spindle power, as reported by the engine
        if name != "pio":
            self.ends_reported = 0  # how often the engine has reported the end of motion
            self.engine.attach(self.bench.segments.next, self.powers.append, self._on_motion_end)
            self.engine.arm()
            self.engine.configure(_PULSE_US, 0, 0)  # no output is inverted
            self.engine.trace = self._trace

    def _on_motion_end(self) -> None:
        assert self.engine.idle(), "rest is reported too early"
        self.ends_reported += 1

    def _trace(self, start: int, row: "array[int]") -> None:
        """Add the steps of a row that the engine executes from tick `start` on."""
        steps = [  # ns, so that sorting is exact
            (int((start + step_tick(row, base, k)) * self.tick_us * 1000), axis, sign)
            for axis in range((len(row) - ROW_AXES) // ROW_STRIDE)
            for base in [ROW_AXES + ROW_STRIDE * axis]
            for sign in [-1 if row[ROW_DIRS] >> axis & 1 else 1]
            for k in range(row[base])
        ]
        self.steps += [(ns / 1000, axis, sign) for ns, axis, sign in sorted(steps)]  # type: ignore[misc]

    def run(self, milliseconds: float = 60_000) -> None:
        """Run the engine until it is idle, or for this time; the PIO's always to its end."""
        if self.name == "pio":
            self.steps += _play_words(self.bench, self.tick_us)
            return
        end = self.engine.now + int(milliseconds * 1000 / self.tick_us)
        while not self.engine.idle() and self.engine.now < end:
            self.engine.advance(min(self.engine.now + int(500 / self.tick_us), end))

    def run_to_end(self) -> "EngineRig":
        """Execute everything planned."""
        if self.name != "pio":
            self.engine.start()
        self.run()
        return self

    def counted_steps(self) -> "list[int]":
        """Return the position in steps: the sum of the steps made, per motor."""
        steps_by_axis = [0] * self.bench.planner.motors
        for _, axis, sign in self.steps:
            steps_by_axis[axis] += sign
        return steps_by_axis

    def reported_steps(self) -> "list[int]":
        """Return the motors' position as the engine reports it."""
        steps = array("i", [0] * self.bench.planner.motors)
        self.engine.position(steps)
        return list(steps)


def _play_words(bench: Bench, us: float) -> "list[Step]":
    """Convert segments to words for the PIO, and words to steps by the timing in programs.py.

    A word: bit 0 the direction, 12 bits the number of steps, and the delay before each, in ticks.
    A tick is 80 ns: 125 ticks are a pulse of 10 us. The sums with 3, 6 and 9 are the instructions
    of the PIO's loop. us: length of a tick.
    """
    axes = bench.planner.motors
    timing = array("i", [0] * pulses.TIMING_LENGTH)
    timing[pulses.AXES] = axes
    pulses.set_timing(timing, pulse=125, hold=25, setup=63)  # ticks: 10, 2, and 5 us
    # Of each motor: the state of the conversion, with HEAD, where the next word goes; and words.
    lanes = array("i", [0] * (pulses.LANE * axes))
    words = array("i", [0] * (axes << pulses.RING_LOG2))
    whole = array("i", [0] * row_length(axes))
    piece = array("i", whole)
    ready = [0] * axes  # tick at which each motor's program reads its next word
    steps: list[tuple[float, int, int]] = []
    while bench.segments.next(whole):
        begin = 0
        while True:
            row = whole
            if whole[ROW_TICKS] > pulses.LONGEST:  # cut it: 0 is returned with the last piece
                begin = pulses.cut_row(piece, whole, begin, axes)
                row = piece
            # The positions in the rings before convert() writes the words of this row.
            sent = [lanes[pulses.LANE * i + pulses.HEAD] for i in range(axes)]
            pulses.convert(row, lanes, words, timing)
            for i in range(axes):  # play the new words of each motor
                ring = i << pulses.RING_LOG2
                while sent[i] != lanes[pulses.LANE * i + pulses.HEAD]:
                    word = words[ring + sent[i]] & 0xFFFFFFFF
                    sent[i] = (sent[i] + 1) % (1 << pulses.RING_LOG2)
                    count, delay = word >> 1 & 0xFFF, word >> 13
                    edge = ready[i] + 6 + delay
                    ready[i] = edge if count == 0 else edge + 125 + 3
                    for k in range(count):
                        if k:
                            edge += 125 + 9 + delay
                            ready[i] = edge + 125 + 3
                        steps.append((edge * us, i, -1 if word & 1 else 1))
            if not begin:
                break
    return sorted(steps)  # type: ignore[return-value]


def moves() -> "dict[str, tuple[Limits, list[tuple[tuple[float, ...], float]]]]":
    """Return (limits, lines) by what is special in them; a line is (target in mm, mm/s).

    slow has 250 steps/mm; fast 80, 80 and 400, with its rates in mm/min and mm/s².
    """
    slow = Limits(acceleration=(200.0,) * 3, rate=(3000.0,) * 3)
    fast = Limits((80.0, 80.0, 400.0), (6000.0, 6000.0, 600.0), (500.0, 500.0, 200.0))
    ring = [(0.0, 0.0), (1.0, 0.1), (1.9, 0.5), (2.4, 1.2), (2.5, 2.0), (2.1, 2.8), (1.2, 3.2)]
    return {
        "diagonal": (slow, [((6.0, 4.3, -1.7), 15.0)]),
        "reversals": (slow, [((1.0, 0.2, 0.0), 9.0), ((-0.3, 0.0, 0.1), 9.0), ((0.0,) * 3, 9.0)]),
        "slow": (slow, [((0.5, 0.0, 0.03), 0.8), ((0.5, 0.0, 0.0), 0.05)]),
        "short lines": (slow, [((x, y, 0.0), 12.0) for x, y in ring]),
        "fast": (fast, [((30.0, -12.0, 0.4), 60.0), ((0.0, 0.0, 0.0), 60.0)]),
        "one step": (slow, [((0.004, 0.0, 0.0), 5.0)]),
        "two on Y": (_ganged("XYZY"), [((4.0, -3.3, 0.7), 15.0), ((0.0, 0.1, 0.0), 15.0)]),
        "two on X and Z": (_ganged("XYZXZ"), [((4.0, -3.3, 0.7), 15.0), ((0.0,) * 3, 15.0)]),
        "six motors": (_ganged("XYZXYZ"), [((4.0, -3.3, 1.7), 15.0), ((0.0,) * 3, 15.0)]),
        "four axes": _of_axes(4),
        "five axes": _of_axes(5),
        "six axes": _of_axes(6),
        "seven motors": _of_axes(6, (5,)),
        "eight motors": _of_axes(6, (0, 1)),
    }


def _of_axes(
    axes: int, twice: "tuple[int, ...]" = ()
) -> "tuple[Limits, list[tuple[tuple[float, ...], float]]]":
    """Return limits and lines, as moves(): all axes go, and come back one by one.

    twice: axes with a second motor.
    """
    limits = Limits((250.0,) * axes, (3000.0,) * axes, (200.0,) * axes)
    if twice:
        limits.moves = [1 << axis for axis in (*range(axes), *twice)]  # each motor's axis
    far = tuple((4.0, -3.3, 1.7, 0.9, -2.2, 3.1)[:axes])
    targets = [tuple(0.0 if i < k else at for i, at in enumerate(far)) for k in range(axes + 1)]
    return limits, [(target, 15.0) for target in targets]


def _ganged(letters: str) -> Limits:
    moves = [1 << "XYZ".index(letter) for letter in letters]
    return Limits(acceleration=(200.0,) * 3, rate=(3000.0,) * 3, moves=moves)


MOVES = moves()


def make(engine: str, move: str) -> EngineRig:
    """Return a bench with the engine and this motion planned, not started. move: of moves()."""
    limits, lines = moves()[move]
    if len(limits.moves or limits.rate) > MOST_MOTORS.get(engine, 8):
        pytest.skip(f"{engine} has fewer motors")
    rig = EngineRig(engine, limits)
    for target, feed in lines:
        rig.bench.line(target, feed * 60)  # mm/min
    return rig


Planned = "list[list[tuple[float, int]]]"


def planned(rig: EngineRig) -> "list[list[tuple[float, int]]]":
    """Return a list per axis of the planned steps, as (us, sign)."""
    steps_by_axis: list[list[tuple[float, int]]] = [[] for _ in range(rig.bench.planner.motors)]
    for segment in rig.bench.watch.made:
        for axis, steps in enumerate(steps_by_axis):
            base = ROW_AXES + ROW_STRIDE * axis
            sign = -1 if segment.row[ROW_DIRS] >> axis & 1 else 1
            for k in range(segment.row[base]):
                steps.append(
                    ((segment.start + step_tick(segment.row, base, k)) * rig.tick_us, sign)
                )
    return steps_by_axis


def steps_of_axis(steps: "list[Step]", axis: int) -> "list[tuple[float, int]]":
    return [(us, sign) for us, i, sign in steps if i == axis]


@pytest.mark.sampled(20)
@pytest.mark.parametrize("move", MOVES)
@pytest.mark.parametrize("engine", ENGINES)
def test_steps_are_those_planned_in_order(engine: str, move: str) -> None:
    rig = make(engine, move).run_to_end()
    for axis, steps in enumerate(planned(rig)):
        assert [sign for _, sign in steps_of_axis(rig.steps, axis)] == [sign for _, sign in steps]


@pytest.mark.sampled(20)
@pytest.mark.parametrize("move", MOVES)
@pytest.mark.parametrize("engine", ENGINES)
def test_steps_come_within_the_stated_tolerance(engine: str, move: str) -> None:
    """late_us: of each step against the plan. It may change from step to step within TOLERANCES;
    and all axes must be late together.
    """
    rig = make(engine, move).run_to_end()
    tolerances = TOLERANCES[engine]
    tracks = []
    for axis, steps in enumerate(planned(rig)):
        real = steps_of_axis(rig.steps, axis)
        late_us = [us - due for (us, _), (due, _) in zip(real, steps, strict=True)]
        for k, (before, after) in enumerate(pairwise(late_us)):
            turn = _TURN_US if steps[k][1] != steps[k + 1][1] else 0
            allowed = tolerances.late + tolerances.gap + turn
            # The law of the motor: no interval is shorter, or longer, than stated.
            assert -tolerances.early <= after - before <= allowed, f"axis {axis}, step {k}"
        tracks.append(list(zip([due for due, _ in steps], late_us, strict=True)))
    # Each axis against the next one that moves: (planned us, late us) of all their steps.
    for a, b in pairwise([track for track in tracks if track]):
        check_late_together(a, b, tolerances.apart + tolerances.gap + 2 * _TURN_US)


@pytest.mark.parametrize("late_axis", [0, 1])
@pytest.mark.parametrize("engine", ["rmt", "rmt_s3"])
def test_a_late_train_shortens_no_interval(
    engine: str, late_axis: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The motor waits and does not catch up when flash or a radio delays a train's start.

    late_axis: the one whose fourth and seventh train start 7 ms late.
    """
    write = esp32.RMT.write_pulses

    def delayed_write(channel: esp32.RMT, durations: "list[int]", data: object = True) -> None:
        if channel is esp32.RMT.channels[late_axis] and len(channel.trains) in (3, 6):
            clock.work(7000)
        write(channel, durations, data)

    monkeypatch.setattr(esp32.RMT, "write_pulses", delayed_write)
    rig = make(engine, "diagonal").run_to_end()
    assert len(esp32.RMT.channels[late_axis].trains) > 7  # so two of them were late
    for axis, steps in enumerate(planned(rig)):
        late_us = [us - due for (us, _), (due, _) in zip(steps_of_axis(rig.steps, axis), steps)]
        assert len(late_us) == len(steps)
        assert all(b - a >= -TOLERANCES[engine].early for a, b in pairwise(late_us)), (
            f"axis {axis}"
        )


def check_late_together(
    a: "list[tuple[float, float]]", b: "list[tuple[float, float]]", allowed: float
) -> None:
    """Check that axes are late together, because then the path is the planned one.

    a, b: (planned us, late us) of each step of two axes. The lateness of b's step must be between
    those of a's steps just before and after it, to `allowed` us.
    """
    k = 0
    for due, late in b:
        while k + 1 < len(a) and a[k + 1][0] <= due:
            k += 1
        neighbours = [a[k][1], a[min(k + 1, len(a) - 1)][1]]
        assert min(neighbours) - allowed <= late <= max(neighbours) + allowed, (
            f"axes apart at {due} us"
        )


@pytest.mark.sampled(14)
@pytest.mark.parametrize("move", MOVES)
@pytest.mark.parametrize("engine", ESP)
def test_drivers_get_the_times_they_need(engine: str, move: str) -> None:
    """Pins' levels: pulse and pause of step, direction before and after a step; all in us."""
    rig = make(engine, move).run_to_end()
    for levels in rig.engine.pins.levels:
        assert levels.shortest_pulse >= _PULSE_US
        assert levels.shortest_pause >= 2  # us
        assert levels.shortest_setup >= 8, "direction to step"
        assert levels.shortest_hold >= _PULSE_US, "step to direction"


@pytest.mark.parametrize("engine", WHOLE)
def test_position_matches_the_steps_at_any_time(engine: str) -> None:
    """Compare the engine's count with the steps at the pins each 3.7 ms, and at the end."""
    rig = make(engine, "reversals")
    rig.engine.start()
    while not rig.engine.idle():
        rig.run(3.7)  # ms
        if engine != "sim":  # its trace shows whole segments only
            differences = [
                abs(a - b) for a, b in zip(rig.reported_steps(), rig.counted_steps(), strict=True)
            ]
            assert max(differences) <= 1  # step: its pulse may be under way
    assert rig.reported_steps() == rig.counted_steps()


@pytest.mark.parametrize("after_ms", [15, 90, 160, 233])
@pytest.mark.parametrize("engine", WHOLE)
def test_a_stop_is_immediate_and_leaves_a_position(engine: str, after_ms: float) -> None:
    """No step comes more than 30 us after the stop, and the count is right to one step."""
    rig = make(engine, "fast")
    rig.engine.start()
    rig.run(after_ms)
    rig.engine.stop()
    stopped_us = rig.engine.now * rig.tick_us
    rig.engine.advance(rig.engine.now + int(100_000 / rig.tick_us))  # 100 ms
    assert rig.engine.idle()
    assert all(us <= stopped_us + 30 for us, *_ in rig.steps)
    differences = [
        abs(a - b) for a, b in zip(rig.reported_steps(), rig.counted_steps(), strict=True)
    ]
    assert max(differences) <= 1


@pytest.mark.parametrize("engine", WHOLE)
def test_motion_continues_after_a_stop(engine: str) -> None:
    """A line planned after a stop, from a position set to 0, makes its own steps only."""
    rig = make(engine, "fast")
    rig.engine.start()
    rig.run(100)  # ms
    rig.engine.stop()
    bench = rig.bench
    # What the firmware does after a reset: nothing is planned, and the position is 0.
    rig.engine.arm()
    bench.planner.clear()
    bench.segments.clear()
    bench.planner.sync_motors(array("i", [0, 0, 0]))
    rig.engine.set_position(array("i", [0, 0, 0]))
    rig.engine.advance(rig.engine.now + int(1000 / rig.tick_us))  # 1 ms
    before = rig.counted_steps()
    bench.line((3.0, 2.0, -0.25), feed=1200.0)
    rig.run_to_end()
    assert rig.reported_steps() == [240, 160, -100]  # 80, 80 and 400 steps/mm
    moved = [b - a for a, b in zip(before, rig.counted_steps(), strict=True)]
    # Of the stopped motion, one step may still come.
    assert all(abs(a - b) <= 1 for a, b in zip(moved, [240, 160, -100], strict=True)), moved


@pytest.mark.parametrize("engine", WHOLE)
def test_a_locked_axis_stands_still_and_the_others_arrive(engine: str) -> None:
    """As in homing: an axis at its switch stops, the others go on to the end of their motion."""
    rig = make(engine, "slow")
    rig.engine.start()
    rig.run(200)  # ms
    rig.engine.lock(0b001)  # a mask of motors: X
    at_lock = rig.reported_steps()[0]
    rig.run(TOLERANCES[engine].lock_ms + 2)
    locked = rig.counted_steps()[0]
    rig.run()
    assert rig.counted_steps()[0] == locked
    planned_steps = [sum(sign for _, sign in steps) for steps in planned(rig)]
    assert rig.counted_steps()[1:] == rig.reported_steps()[1:] == planned_steps[1:]
    # A train under way at lock() may have ended later. The next motion first takes these steps
    # back, so position(), the engine's count, is that of the lock.
    rig.engine.stop()
    rig.engine.arm()
    assert rig.reported_steps()[0] == at_lock
    rig.bench.planner.clear()
    rig.bench.planner.sync_motors(array("i", rig.reported_steps()))
    rig.bench.line((0.5, 0.5, 0.5), 60.0)
    rig.run_to_end()
    assert rig.counted_steps() == rig.reported_steps() == [125, 125, 125]  # 250 steps/mm * 0.5 mm


@pytest.mark.parametrize("engine", WHOLE)
def test_a_motor_locked_at_rest_stays_and_keeps_its_position(engine: str) -> None:
    """The lock lasts for one motion. Positions begin at 70, 80, 90 and 100 steps."""
    rig = make(engine, "two on Y")
    rig.engine.lock(0b0010)  # the first motor of Y; the last motor is Y's, too
    rig.engine.set_position(array("i", [70, 80, 90, 100]))
    rig.run_to_end()
    planned_steps = [sum(sign for _, sign in steps) for steps in planned(rig)]
    assert (
        rig.counted_steps() == [planned_steps[0], 0, planned_steps[2], planned_steps[3]]
        and planned_steps[3]
    )
    positions = [70 + planned_steps[0], 80, 90 + planned_steps[2], 100 + planned_steps[3]]
    assert rig.reported_steps() == positions
    rig.engine.stop()
    rig.engine.arm()
    assert rig.reported_steps() == positions
    before = rig.counted_steps()
    rig.bench.planner.clear()
    rig.bench.line((1.0, 1.0, 1.0), 600.0)
    rig.bench.line((2.0, 2.0, 2.0), 600.0)
    rig.run_to_end()
    moved = [now - then for now, then in zip(rig.counted_steps(), before, strict=True)]
    assert moved[1] == moved[3] and moved[1], "the motor must move again"


@pytest.mark.parametrize("engine", WHOLE)
def test_a_hold_comes_to_rest_within_the_stated_time_and_loses_nothing(engine: str) -> None:
    """Hold after 250 ms, and resume: the end is the planned one, in steps."""
    rig = make(engine, "diagonal")
    rig.engine.start()
    rig.run(250)  # ms
    rig.bench.segments.hold(True)
    asked_us = rig.engine.now * rig.tick_us
    rig.run()
    steps_at_rest = rig.counted_steps()
    assert rig.reported_steps() == steps_at_rest
    brake_ms = 15.0 / 200.0 * 1000  # speed / acceleration
    last_step_us = max(us for us, *_ in rig.steps)
    # 60 % more than the shortest braking, and the motion that the engine holds already.
    assert last_step_us - asked_us <= (brake_ms * 1.6 + TOLERANCES[engine].hold_ms) * 1000
    rig.bench.segments.hold(False)
    rig.run_to_end()
    assert rig.reported_steps() == rig.counted_steps() == [1500, 1075, -425]


@pytest.mark.parametrize("engine", WHOLE)
def test_power_is_reported_with_the_segments(engine: str) -> None:
    """Each four segments get a higher power; the engine must report them in this order."""
    rig = make(engine, "diagonal")
    powers = iter(range(1, 10_000))
    next_segment = rig.bench.segments.next

    def with_power(row: "array[int]") -> int:
        has_row = next_segment(row)
        row[ROW_POWER] = next(powers) // 4  # 0, 0, 0, 1, 1, 1, 1, 2 …
        return has_row

    rig.engine.attach(with_power, rig.powers.append, rig._on_motion_end)
    rig.run_to_end()
    assert rig.powers == sorted(rig.powers)
    assert len(set(rig.powers)) >= 5


@pytest.mark.parametrize("engine", WHOLE)
def test_power_after_motion_is_the_last_segments(engine: str) -> None:
    """With M4, which adapts a laser's power to the speed, that is off or the lowest power.

    Here each segment has a power that is lower by 7; nothing may be reported after the last one.
    """
    for length in (0.1, 0.5, 1.5, 3.0):
        rig = EngineRig(engine, Limits(acceleration=(200.0,) * 3, rate=(3000.0,) * 3))
        rig.bench.line((length, 0.0, 0.0), 1200.0)
        powers: list[int] = []
        next_segment = rig.bench.segments.next

        def with_power(
            row: "array[int]", next_segment: Any = next_segment, powers: Any = powers
        ) -> int:
            """Get the next segment, give it a power, and note this if there was a segment (1, not
            0)."""
            has_row: int = next_segment(row)
            row[ROW_POWER] = 9000 - 7 * len(powers)
            powers.extend([row[ROW_POWER]] * has_row)
            return has_row

        rig.engine.attach(with_power, rig.powers.append, rig._on_motion_end)
        rig.run_to_end()
        assert rig.powers[-1] == powers[-1]
        reports = len(rig.powers)
        rig.engine.advance(rig.engine.now + int(100_000 / rig.tick_us))  # 100 ms
        assert len(rig.powers) == reports


@pytest.mark.parametrize("after_ms", [1, 5, 20, 33, 41, 120])
@pytest.mark.parametrize("engine", WHOLE)
def test_no_power_is_reported_after_a_stop(engine: str, after_ms: float) -> None:
    """Each segment has another power; after stop(), neither power nor position changes."""
    rig = make(engine, "fast")
    powers = iter(range(1, 10_000))
    next_segment = rig.bench.segments.next

    def with_power(row: "array[int]") -> int:
        has_row = next_segment(row)
        row[ROW_POWER] = next(powers)
        return has_row

    rig.engine.attach(with_power, rig.powers.append, rig._on_motion_end)
    rig.engine.start()
    rig.run(after_ms)
    rig.engine.stop()
    reports, position = len(rig.powers), rig.reported_steps()
    for _ in range(50):
        rig.engine.advance(rig.engine.now + int(2000 / rig.tick_us))  # 2 ms
        assert rig.engine.idle()
        assert rig.reported_steps() == position
    assert len(rig.powers) == reports


def awkward_rows(seed: int, tick_hz: int, count: int) -> "list[array[int]]":
    """Return rows that no planner makes: steps on their edges, reversals at full speed.

    gap: ticks between steps (50, 110 or 900 us); row[base] to row[base + 2]: the number of steps,
    the tick of the first, and of the last.
    """
    random_numbers = random.Random(seed)
    rows = []
    for _ in range(count):
        row = array("i", [0] * row_length(3))
        gap = random_numbers.choice((50, 110, 900)) * tick_hz // 1_000_000
        steps = random_numbers.choice((1, 2, 40))
        ticks = row[ROW_TICKS] = gap * steps
        row[ROW_DIRS] = random_numbers.randrange(8)
        for base in range(ROW_AXES, len(row), ROW_STRIDE):
            row[base] = random_numbers.randint(0, steps)
            row[base + 1] = random_numbers.choice((0, 1, gap)) if row[base] else 0
            row[base + 2] = ticks if row[base] > 1 else row[base + 1]
        rows.append(row)
    return rows


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("engine", ESP)
def test_awkward_segments_are_complete_and_in_order(engine: str, seed: int) -> None:
    """All steps are made, and pulse, pause, setup and hold times in us are those of drivers."""
    rig = EngineRig(engine, Limits())
    rows = awkward_rows(seed, rig.engine.tick_hz, 60)
    rows_left = list(rows)

    def next_segment(row: "array[int]") -> int:
        if rows_left:
            row[:] = rows_left.pop(0)
            return 1
        return 0

    rig.engine.attach(next_segment, rig.powers.append, rig._on_motion_end)
    rig.run_to_end()
    for axis in range(3):
        base = ROW_AXES + ROW_STRIDE * axis
        signs = [-1 if row[ROW_DIRS] >> axis & 1 else 1 for row in rows for _ in range(row[base])]
        assert [sign for _, sign in steps_of_axis(rig.steps, axis)] == signs
    assert rig.reported_steps() == rig.counted_steps()
    for levels in rig.engine.pins.levels:
        assert levels.shortest_pulse >= _PULSE_US
        assert levels.shortest_pause >= 2
        assert levels.shortest_setup >= 10
        assert levels.shortest_hold >= _PULSE_US


@pytest.mark.parametrize("late_us", range(30_000, 60_000, 7000))
def test_i2s_keeps_the_setup_time_after_it_has_run_empty(late_us: int) -> None:
    """Directions precede steps also after the CPU was busy for too long for the stream."""
    rig = EngineRig("i2s", Limits())

    def next_segment(row: "array[int]") -> int:
        # 1600 ticks, all backwards, power 0; each axis: 2 steps, the first at tick 10
        row[:] = array("i", [1600, 7, 0, *([2, 10, 810] * 3)])
        return 1

    rig.engine.attach(next_segment, rig.powers.append, rig._on_motion_end)
    rig.engine.start()
    rig.run(100)
    for levels in rig.engine.pins.levels:
        levels.shortest_setup = 1_000_000  # us; measured anew from here
    for _ in range(5):
        clock.work(late_us)
        rig.run(41)  # ms
    rig.engine.stop()
    rig.run(1)
    for levels in rig.engine.pins.levels:
        # us: directions, lost when the stream runs empty, are set long before steps go on.
        assert levels.shortest_setup >= 1000
    assert all(sign < 0 for _, _, sign in rig.steps)


def test_i2s_loses_nothing_after_an_underrun() -> None:
    """An underrun: the CPU is away for so long that the stream has nothing left to play."""
    rig = make("i2s", "diagonal")
    rig.engine.start()
    rig.run(200)  # ms
    clock.work(80_000)  # us: flash, or a very long garbage collection
    rig.run()
    assert rig.engine.real.underrun_count() == 1
    assert rig.reported_steps() == rig.counted_steps() == [1500, 1075, -425]
    for levels in rig.engine.pins.levels:
        assert levels.shortest_setup >= 8
        assert levels.shortest_pulse >= 8


def test_i2s_drives_the_motors_enable_outputs() -> None:
    """A board may have several drivers' enable outputs: all follow enable().

    They reach the pins with the stream, within 100 ms. A tick is half a microsecond.
    """
    rig = EngineRig("i2s", Limits())
    enables = sum(1 << output for output in I2S_ENABLE)
    rig.engine.real.enable(1)
    rig.engine.advance(rig.engine.now + 200_000)  # 100 ms
    assert rig.engine.pins.outputs() & enables == enables
    rig.engine.real.enable(0)
    rig.engine.advance(rig.engine.now + 100_000)  # 50 ms
    assert rig.engine.pins.outputs() & enables == 0


def test_i2s_reaches_its_highest_rate() -> None:
    """A step every three frames of 8 us, or 41,667 a second: nothing is late, nothing is lost."""
    limits = Limits((400.0,) * 3, (60_000.0,) * 3, (5000.0,) * 3)  # steps/mm, mm/min, mm/s²
    rig = EngineRig("i2s", limits)
    rig.bench.line((40.0, 20.0, 0.0), 60_000.0)  # mm; mm/min, faster than the engine can
    rig.run_to_end()
    assert rig.counted_steps() == rig.reported_steps() == [16_000, 8000, 0]  # 400 steps/mm
    steps_us = [us for us, _ in steps_of_axis(rig.steps, 0)]
    gaps_us = [b - a for a, b in pairwise(steps_us)]
    assert min(gaps_us) >= 24  # us
    # Frames (of 16 ticks) per second / frames (of 8 us) per step, in the middle of the motion.
    assert max(rig.engine.tick_hz // 16 / (gap / 8) for gap in gaps_us[6000:9000]) > 40_000


def test_rmt_hides_its_gap_below_the_stated_rate() -> None:
    """One axis at 2000 steps/s (250 steps/mm * 8 mm/s): no train is late."""
    limits = Limits(acceleration=(200.0,) * 3, rate=(3000.0,) * 3)
    rig = EngineRig("rmt", limits)
    rig.bench.line((6.0, 0.0, 0.0), 480.0)
    rig.run_to_end()
    assert rig.engine.real.longest_gap_us() == 0
    assert rig.engine.real.worst_skew_us() <= 60  # of a channel's start


@pytest.mark.parametrize("invert", [0b000, 0b101])
@pytest.mark.parametrize("engine", ESP)
def test_directions_are_inverted_on_request(engine: str, invert: int) -> None:
    """$3, here of axes 0 and 2: the direction pins are inverted, and so is the modelled driver."""
    rig = make(engine, "reversals")
    rig.engine.configure(_PULSE_US, 0, invert)
    for i, levels in enumerate(rig.engine.pins.levels):
        levels.invert = invert >> i & 1
    rig.run_to_end()
    assert rig.reported_steps() == rig.counted_steps() == [0, 0, 0]


# Recorded motion of real Grbl

_RECORDS = sorted((_SHARED / "conformance" / "motion").glob("*.json"))
# A peak rate is averaged over 16 steps, which may include the end of a train.
_PEAK = {"i2s": 0.02, "rmt": 0.06}


@pytest.fixture
def on_engine(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Make Rigs use this engine instead of the simulator's."""
    name: str = request.param

    class Engine:  # with the constructor of SimEngine
        tick_hz = EspEngine(name).tick_hz

        def __new__(cls, axes: int, _depth: int) -> Any:
            return EspEngine(name, axes)

    replay.factory_store(load_board("sim"))  # simulates a first start once, with SimEngine
    monkeypatch.setattr(sim_rig, "SimEngine", Engine)
    return name


@pytest.mark.usefixtures("each_ms")
@pytest.mark.sampled(12)
@pytest.mark.skipif(not _RECORDS, reason="no recordings here")
@pytest.mark.parametrize("on_engine", ["i2s", "rmt"], indirect=True)
@pytest.mark.parametrize("path", _RECORDS, ids=lambda path: path.stem)
def test_recorded_motion_is_repeated(path: Path, on_engine: str) -> None:
    """Grbl's recorded motion, replayed with an ESP32's engine: judge_motion() finds no error.

    Its peak rate may differ by _PEAK, a fraction. net_steps: those at the pins.
    """
    record = json.loads(path.read_text())
    motion = replay._Motion(record, load_board("sim"))
    observed = motion.run()
    wrong = judge_motion(record, observed, [])
    stops = bool(record.get("events_ms_after_first_step") or record.get("switches"))
    if stops:
        # The reaction to an event depends on the engine (Grbl's takes 45 ms), and so do these.
        ignored = ("duration", "peak rate", "not at rest", "net_steps", "pulses", "final")
        wrong = [text for text in wrong if not text.startswith(ignored) and " at " not in text]
    assert not [text for text in wrong if not is_near_peak(text, _PEAK[on_engine])]
    steps = array("i", [0, 0, 0])
    motion.rig.engine.physical(steps)
    steps_by_letter = zip("XYZ", steps, strict=True)
    assert observed["net_steps"] == dict(steps_by_letter)


def is_near_peak(text: str, share: float) -> bool:
    """Return whether a text is "peak rate X: 99.0 Hz, expected 100" and the rates are near."""
    if not text.startswith("peak rate"):
        return False
    words = text.replace(",", "").split()
    got, expected = float(words[3]), float(words[6])
    return abs(got - expected) <= share * expected
