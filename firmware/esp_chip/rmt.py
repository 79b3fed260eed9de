# mypy: disable-error-code=arg-type
"""RmtEngine: pulses on pins of their own, made by esp32.RMT, a channel per axis.

RMT plays a list of durations exactly, but MicroPython can hand it the next list only after the
last one has ended. So motion is cut into trains (trains.py), the same stretch for all axes.
Between two trains there is a gap, as long as three calls of write_pulses() take. A train ends
after a step, and the gap falls into the pause before the next one: steps are on time as long as
that pause is longer. Above that rate motion stands still for the rest of the gap at every end of a
train: MAX_STEP_RATE_HZ of a board file says where this begins.

A soft timer gives the engine its turns. There it waits for the end of a train, for a millisecond
at most, so that nothing else runs in between. Each channel is started a bit later than the one
before; its time to the first step is shortened by that, as measured at the last call of
write_pulses(). Directions change between trains.

A channel has memory for a limited number of steps (channel.py): at higher rates trains are
shorter, and gaps more frequent. At the highest rate a train lasts 4 ms, one row.

The clock gives the progress, never the hardware. How much of a train stop() leaves cannot be known
to the step: position is the clock's, and code that stops a moving machine must raise an alarm. The
channels play their trains to the end, which the pins do not show; the next motion waits for that.
"""

import time
from array import array

import machine
import micropython
from base.times import MASK, NEGATIVE
from micropython import const
from motion.layout import ROW_POWER, row_length

from esp_chip import trains
from esp_chip.channel import RESOLUTION_HZ, Channel, most_steps
from esp_chip.timer_engine import LOST_US, SETUP_US, TimerEngine
from esp_chip.trains import made

_HIGHEST_HZ = const(20_000)
_SHORTEST_US = const(6_000)  # a channel's steps last this long at the highest rate
_PULSE_MAX = const(32_767)

# How long before it is due the next train is prepared, and handed over, in us.
_PREPARE_US = const(6_000)
_EARLY_US = const(4_000)
# For less than this the end of a train is waited for in a loop; the timer period is 1 ms.
_WAIT_US = const(1_200)
_FROM_REST_US = const(2_000)
_GUARD_US = const(20)
# About how long the hardware has been running when write_pulses() returns.
_RETURN_US = const(10)
# First estimate of the time of write_pulses(): us, and per duration in 1/8 us.
_CALL_US = const(150)
_CALL_EIGHTHS = const(2)
_LEAST_CALL_US = const(20)  # the estimate is between these
_MOST_CALL_US = const(1000)
# A later start than that was delayed by flash or a radio.
_HELD_UP_US = const(60)

# State.
_HALT = const(0)  # stopped, until arm()
_PULLING = const(1)  # there may be more segments
_RUNNING = const(2)  # a train is being played, or waited for
_READY = const(3)  # the next train is prepared
_DUE = const(4)  # when the next train is due, in us
_FREE = const(5)  # when the channels will have ended, in us
_BEGAN = const(6)  # when the train being played was due, in us
_REPORTED = const(7)  # last spindle power reported
_GAP = const(8)  # longest standstill between trains, in us,
_SKEW = const(9)  # largest error of a channel's start, us,
_TRAINS = const(10)  # and number of trains
_CUT = const(11)  # a train was cut off: its channels may still be playing
_STATE_LENGTH = const(12)

# Lanes: integers per axis.
_LANE = const(6)
_PLACE = const(0)  # position at the start of the train being played
_BACK = const(1)  # 1: its steps go backwards
_COUNT = const(2)  # its durations,
_START = const(3)  # and the start of the channel
_LEVEL = const(4)  # of the direction pin, before $3; -1: unknown
_CALL = const(5)  # time of write_pulses(), without that per duration, us


@micropython.viper
def _place(lanes: ptr32, axis: int, playing: ptr32, now: int) -> int:
    """Return the position of a motor at the time now: us, masked by base/times.py.

    playing: the durations of the axis' train, which began at _START.
    """
    lane = _LANE * axis
    place = lanes[lane + _PLACE]
    if lanes[lane + _COUNT] == 0:
        return place
    passed = (now - lanes[lane + _START]) & MASK
    if passed >= NEGATIVE:
        return place
    steps = int(made(playing, lanes[lane + _COUNT], passed))
    return place - steps if lanes[lane + _BACK] else place + steps


class RmtEngine(TimerEngine):
    """The engine. step, direction: pin numbers per axis."""

    tick_hz = RESOLUTION_HZ
    segment_log2 = 12

    def __init__(self, step: "tuple[int, ...]", direction: "tuple[int, ...]") -> None:
        super().__init__()
        self._axes = axes = len(step)
        self._direction = [machine.Pin(pin, machine.Pin.OUT, value=0) for pin in direction]
        self._channels = [Channel(i, step[i], axes) for i in range(axes)]
        self._dir_invert = 0
        self._state = array("i", (0 for _ in range(_STATE_LENGTH)))
        self._state[_HALT] = 1
        self._timing = array("i", (0 for _ in range(trains.TIMING_LENGTH)))
        self._timing[trains.AXES] = axes
        self._timing[trains.MOST] = most = most_steps(axes)
        self._lanes = array("i", (0 for _ in range(_LANE * axes)))
        for i in range(axes):
            self._lanes[_LANE * i + _LEVEL] = -1
            self._lanes[_LANE * i + _CALL] = _CALL_US
        self._size = row_length(axes)
        self._row = array("i", (0 for _ in range(self._size)))
        self._rows = array("i", (0 for _ in range(self._size * trains.ROWS)))
        # Per axis: the train being played, the next one, and the list for RMT.
        self._playing = [array("i", (0 for _ in range(2 * most))) for _ in range(axes)]
        self._next = [array("i", (0 for _ in range(2 * most))) for _ in range(axes)]
        self._counts = array("i", (0 for _ in range(axes)))
        self._lists: "list[list[int]]" = [[] for _ in range(axes)]
        # Spindle powers of a train: start in us, power.
        self._powers = array("i", (0 for _ in range(2 * trains.ROWS)))
        self._next_powers = array("i", (0 for _ in range(2 * trains.ROWS)))
        self._timer = machine.Timer(0)
        self.configure(10, 0, 0)

    # The StepEngine interface

    def max_step_hz(self, pulse_us: int) -> int:
        """Return the highest rate of one axis, steps/s: as many as can be prepared per train."""
        most = self._timing[trains.MOST] * RESOLUTION_HZ // _SHORTEST_US
        return min(_HIGHEST_HZ, most, RESOLUTION_HZ // (2 * pulse_us))

    def configure(self, pulse_us: int, step_invert: int, dir_invert: int) -> None:
        """Apply $0, and $2 and $3: masks of motors with inverted STEP or DIR. Only while idle."""
        self._timing[trains.PULSE] = pulse_us
        self._dir_invert = dir_invert
        for i in range(self._axes):
            self._channels[i].invert(step_invert >> i & 1)
            level = max(self._lanes[_LANE * i + _LEVEL], 0)
            self._direction[i].value(level ^ (dir_invert >> i & 1))

    def arm(self) -> None:
        """Enable motion after power-up or stop(). Clears the fault and all locks."""
        self._failure = None
        self._timing[trains.LOCKED] = 0
        self._state[_HALT] = 0

    def start(self) -> None:
        """Begin to pull, if the engine had run out of segments. A stopped engine stays stopped."""
        state = self._state
        if state[_HALT]:
            return
        state[_PULLING] = 1
        if not state[_RUNNING]:
            state[_REPORTED] = -1
            now = time.ticks_us()
            rest_us = time.ticks_diff(state[_FREE], now)
            if not (state[_CUT] and 0 < rest_us < LOST_US):  # no rest of a train is being played
                state[_FREE] = now & MASK
            state[_CUT] = 0
            state[_DUE] = (state[_FREE] + _FROM_REST_US) & MASK
            self._powers[0] = MASK  # no power is due, because that time never comes
            state[_RUNNING] = 1
            self._timer.init(mode=machine.Timer.PERIODIC, period=1, callback=self._refill)

    def stop(self) -> None:
        """Stop at once, until arm(); safe in a soft interrupt. Drops queued steps and locks."""
        self._halt()
        self._state[_RUNNING] = 0

    def _halt(self) -> None:
        """Cut off all trains and drop what is queued. _RUNNING: channels may play on to _FREE."""
        state, timing = self._state, self._timing
        state[_HALT] = 1
        self._cut_off((1 << self._axes) - 1)
        state[_CUT] = 1
        state[_RUNNING] = 1
        state[_PULLING] = state[_READY] = 0
        timing[trains.HELD] = timing[trains.DONE] = timing[trains.LOCKED] = 0

    def _cut_off(self, axes: int) -> None:
        """End the trains of the axes in a mask now; their positions are the clock's."""
        for i in range(self._axes):
            if axes >> i & 1:
                self._channels[i].cut()
        now = time.ticks_us()
        for i in range(self._axes):
            lane = _LANE * i
            if axes >> i & 1 and self._lanes[lane + _COUNT]:
                self._lanes[lane + _PLACE] = _place(self._lanes, i, self._playing[i], now)
                self._lanes[lane + _COUNT] = 0

    def lock(self, motors: int) -> None:
        """Stop the pulses of these motors (a mask) until stop(); the others continue."""
        self._timing[trains.LOCKED] = self._timing[trains.LOCKED] | motors
        for i in range(self._axes):
            if motors >> i & 1:
                self._counts[i] = 0
        self._cut_off(motors)

    def idle(self) -> bool:
        """Return whether nothing moves and nothing is queued in hardware."""
        return not self._state[_RUNNING]

    def _is_late(self) -> bool:
        """Return whether the next train is so late that it will never begin."""
        late_us = time.ticks_diff(time.ticks_us(), self._state[_DUE])
        return bool(self._state[_RUNNING]) and late_us > LOST_US

    def position(self, steps: "array[int]") -> None:
        """Copy each motor's position, in steps, into `steps`, as the clock says."""
        for i in range(self._axes):
            steps[i] = _place(self._lanes, i, self._playing[i], time.ticks_us())

    def set_position(self, steps: "array[int]") -> None:
        """Set the present position, also of locked motors. Only while idle."""
        for i in range(self._axes):
            self._lanes[_LANE * i + _PLACE] = steps[i]
            self._lanes[_LANE * i + _COUNT] = 0

    def longest_gap_us(self) -> int:
        """Return the longest standstill of motion between trains, in us."""
        return self._state[_GAP]

    def worst_skew_us(self) -> int:
        """Return the largest error of a channel's start, early or late, in us."""
        return self._state[_SKEW]

    # The timer's turns: no other soft interrupt runs within them

    def _advance(self) -> None:
        """Do one turn: prepare the next train, and start it when the last one has ended."""
        state = self._state
        if state[_HALT] or not state[_RUNNING]:  # turns queued before deinit() still run
            state[_RUNNING] = 0
            self._timer.deinit()
            return
        now = time.ticks_us()
        self._report_power(now)
        due_in = time.ticks_diff(state[_DUE], now)
        if due_in > _PREPARE_US:
            return
        if not state[_READY] and not self._prepare():
            if time.ticks_diff(state[_FREE], now) <= 0 and due_in <= 0:
                self._end_train()
                state[_RUNNING] = 0
                self._timer.deinit()
                self._on_rest()
            return
        wait = time.ticks_diff(state[_FREE], time.ticks_us())
        if due_in > _EARLY_US or wait > _WAIT_US:
            return
        while time.ticks_diff(state[_FREE], time.ticks_us()) > 0:
            pass
        self._send()
        self._collect(self._timing[trains.LENGTH] - _PREPARE_US)

    def _prepare(self) -> bool:
        """Prepare the next train: _next, _counts. Returns False if there is nothing to move."""
        state, timing, rows = self._state, self._timing, self._rows
        size = self._size
        while (
            state[_PULLING]
            and timing[trains.HELD] < trains.ROWS
            and trains.held_us(rows, timing, size) < trains.LONGEST
        ):
            if not self._next_segment(self._row):
                state[_PULLING] = 0
                break
            index = (timing[trains.FIRST] + timing[trains.HELD]) % trains.ROWS * size
            for k in range(size):
                rows[index + k] = self._row[k]
            timing[trains.HELD] += 1
        if not timing[trains.HELD]:
            return False
        trains.cut(rows, timing, size)
        for i in range(self._axes):
            count = trains.durations(rows, timing, size, i, self._next[i])
            if count < 0:
                raise RuntimeError("a train is longer than its channel")
            self._counts[i] = count
        self._note_powers()
        trains.advance(timing)
        state[_READY] = 1
        return True

    def _note_powers(self) -> None:
        """Store the next train's spindle powers and start times (us); MASK: row not in it."""
        timing, rows = self._timing, self._rows
        start_us = -timing[trains.DONE]  # part of the first row was in the last train
        for k in range(trains.ROWS):
            row = (timing[trains.FIRST] + k) % trains.ROWS * self._size
            is_in_train = k < timing[trains.TAKEN] or (k == 0 and timing[trains.PART])
            self._next_powers[2 * k] = start_us if is_in_train else MASK
            self._next_powers[2 * k + 1] = rows[row + ROW_POWER]
            start_us += rows[row]  # a row begins with its length

    def _report_power(self, now: int) -> None:
        """Report the spindle power that is due at `now`, us, in the train being played."""
        state = self._state
        passed = time.ticks_diff(now, state[_BEGAN])
        power = state[_REPORTED]
        for k in range(trains.ROWS):
            if self._powers[2 * k] > passed:
                break
            power = self._powers[2 * k + 1]
        if power < MASK and power != state[_REPORTED]:
            state[_REPORTED] = power
            self._on_power(power)

    def _end_train(self) -> None:
        """Add the steps of the train, which has been played, to the positions."""
        for i in range(self._axes):
            lane = _LANE * i
            steps = self._lanes[lane + _COUNT] // 2  # each has a pause and a pulse
            self._lanes[lane + _COUNT] = 0
            back = self._lanes[lane + _BACK]
            self._lanes[lane + _PLACE] += -steps if back else steps

    def _call_us(self, axis: int) -> int:
        """Return the expected time of write_pulses() for the next train of an axis, in us."""
        return self._lanes[_LANE * axis + _CALL] + (self._counts[axis] * _CALL_EIGHTHS >> 3)

    def _send(self) -> None:
        """Start the next train on all axes in step. The last one must have ended."""
        state, lanes = self._state, self._lanes
        self._end_train()
        setup = 0
        for i in range(self._axes):
            lane = _LANE * i
            back = self._timing[trains.DIRS] >> i & 1
            if self._counts[i]:
                lanes[lane + _BACK] = back
                if lanes[lane + _LEVEL] != back:
                    lanes[lane + _LEVEL] = back
                    self._direction[i].value(back ^ (self._dir_invert >> i & 1))
                    setup = SETUP_US
        # The train begins when it is due, or when the slowest start allows.
        now = time.ticks_us()
        due_in = time.ticks_diff(state[_DUE], now)
        late = 0
        ready_in = setup + _GUARD_US
        for i in range(self._axes):
            if self._counts[i]:
                ready_in += self._call_us(i)
                late = max(late, ready_in - due_in - self._next[i][0])
        state[_BEGAN] = (state[_DUE] + late) & MASK
        state[_FREE] = state[_BEGAN]
        self._playing, self._next = self._next, self._playing
        self._powers, self._next_powers = self._next_powers, self._powers
        delay = 0
        for i in range(self._axes):
            if self._counts[i]:
                delay = max(delay, self._start_channel(i))
        # The next train waits for the slowest: no interval between steps is shorter than planned.
        state[_GAP] = max(state[_GAP], late + delay)
        state[_DUE] = (state[_BEGAN] + self._timing[trains.LENGTH] + delay) & MASK
        state[_READY] = 0
        state[_TRAINS] += 1

    def _start_channel(self, axis: int) -> int:
        """Start one axis so that its first step is on time. Returns by how many us it is late, if
        the start was delayed, else 0."""
        state, lanes = self._state, self._lanes
        lane = _LANE * axis
        count = self._counts[axis]
        playing = self._playing[axis]
        pulses = self._lists[axis]
        first = playing[0]  # time from the train's begin to its first step
        call = self._call_us(axis)
        del pulses[:]
        pulses.extend(memoryview(playing)[:count])
        before = time.ticks_us()
        lead = time.ticks_diff(state[_BEGAN], before) + first - call
        pulses[0] = playing[0] = min(max(lead, 1), _PULSE_MAX)
        self._channels[axis].play(pulses)
        took = time.ticks_diff(time.ticks_us(), before)
        began = (before + took - _RETURN_US) & MASK
        lanes[lane + _START] = began
        lanes[lane + _COUNT] = count
        state[_SKEW] = max(state[_SKEW], abs(took - call))
        learned = min(max(took - call, -_HELD_UP_US), _HELD_UP_US) // 4  # a part of the error
        estimate = max(lanes[lane + _CALL] + learned, _LEAST_CALL_US)
        lanes[lane + _CALL] = min(estimate, _MOST_CALL_US)
        end = (before + took + trains.lasts(playing, count) + _GUARD_US) & MASK
        if time.ticks_diff(end, state[_FREE]) > 0:
            state[_FREE] = end
        first_edge = (began + playing[0]) & MASK
        delay = time.ticks_diff(first_edge, (state[_BEGAN] + first) & MASK)
        return delay if delay > _HELD_UP_US else 0
