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
from motion.layout import KEEP_POWER, ROW_POWER, row_length

from esp_chip import trains
from esp_chip.channel import RESOLUTION_HZ, Channel, most_steps
from esp_chip.timer_engine import LOST_US, SETUP_US, TimerEngine
from esp_chip.trains import made

_HIGHEST_HZ = const(20_000)  # steps/s of one axis, at most
_SHORTEST_US = const(6_000)  # a channel's steps last this long at the highest rate
_LONGEST_DURATION_US = const(32_767)  # that RMT can play
_PREPARE_US = const(6_000)  # the next train is prepared so long before it is due
_EARLY_US = const(4_000)  # the next train is handed over at most so long before it is due
_WAIT_US = const(1_200)  # so long a turn waits in a loop for a train's end; the timer has 1 ms
_START_DELAY_US = const(2_000)  # from start() to the first train
_GUARD_US = const(20)  # margin for times that are estimates
_RETURN_US = const(10)  # how long the hardware has been running when write_pulses() returns
_FIRST_CALL_US = const(150)  # first estimate of the time of write_pulses()
_CALL_EIGHTHS = const(2)  # what each duration adds to that time, in 1/8 us
_LEAST_CALL_US = const(20)  # least estimate of the time of write_pulses()
_MOST_CALL_US = const(1000)  # highest estimate
_HELD_UP_US = const(60)  # a later start than that was delayed by flash or a radio
_NEVER = const(MASK)  # a time, us, that is not reached

# State.
_STOPPED = const(0)  # 1: until arm()
_PULLING = const(1)  # there may be more segments
_RUNNING = const(2)  # not idle: a train is being played, or waited for
_NEXT_READY = const(3)  # the next train is prepared
_NEXT_DUE_US = const(4)  # when the next train is due, in us
_FREE_US = const(5)  # when all channels will have ended their trains, in us
_BEGAN_US = const(6)  # when the train being played was due, in us
_REPORTED_POWER = const(7)  # last spindle power reported; -1: none
_LONGEST_GAP_US = const(8)  # longest standstill between trains, in us
_WORST_SKEW_US = const(9)  # largest error of a channel's start, us
_TRAINS = const(10)  # number of trains
_WAS_CUT_OFF = const(11)  # 1: a train was cut off; channels play its rest, without pins
_STATE_LENGTH = const(12)

# Lanes: integers per axis, about the train being played.
_LANE = const(6)  # integers per axis
_PLACE = const(0)  # position at its start
_BACKWARDS = const(1)  # 1: its steps go backwards
_DURATIONS = const(2)  # number of its durations, two per step; 0: no train
_STARTED_US = const(3)  # when the channel was started with it, in us
_DIR_LEVEL = const(4)  # of the direction pin, before $3 inverts it; -1: unknown
_CALL_TIME_US = const(5)  # estimate for write_pulses(), without what each duration adds


@micropython.viper
def _place(lanes: ptr32, axis: int, playing: ptr32, now: int) -> int:
    """Return the position of a motor at the time now: us, masked by base/times.py.

    playing: the durations of the axis' train, which began at _STARTED_US.
    """
    lane = _LANE * axis
    place = lanes[lane + _PLACE]
    if lanes[lane + _DURATIONS] == 0:
        return place
    passed = (now - lanes[lane + _STARTED_US]) & MASK
    if passed >= NEGATIVE:  # below 0: the train begins later
        return place
    steps = int(made(playing, lanes[lane + _DURATIONS], passed))
    return place - steps if lanes[lane + _BACKWARDS] else place + steps


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
        self._state[_STOPPED] = 1
        self._timing = array("i", (0 for _ in range(trains.TIMING_LENGTH)))
        self._timing[trains.AXES] = axes
        self._timing[trains.MOST_STEPS] = most = most_steps(axes)
        self._lanes = array("i", (0 for _ in range(_LANE * axes)))
        for i in range(axes):
            self._lanes[_LANE * i + _DIR_LEVEL] = -1
            self._lanes[_LANE * i + _CALL_TIME_US] = _FIRST_CALL_US
        self._row_size = row_length(axes)
        self._row = array("i", (0 for _ in range(self._row_size)))
        self._rows = array("i", (0 for _ in range(self._row_size * trains.ROWS)))
        # Per axis: the train being played; the next one, its number of durations; RMT's list.
        self._playing = [array("i", (0 for _ in range(2 * most))) for _ in range(axes)]
        self._next = [array("i", (0 for _ in range(2 * most))) for _ in range(axes)]
        self._counts = array("i", (0 for _ in range(axes)))
        self._lists: "list[list[int]]" = [[] for _ in range(axes)]
        # Spindle powers of a train, a pair per row: start, us from the train's begin; power.
        self._powers = array("i", (0 for _ in range(2 * trains.ROWS)))
        self._next_powers = array("i", (0 for _ in range(2 * trains.ROWS)))
        self._timer = machine.Timer(0)
        self.configure(pulse_us=10, step_invert=0, dir_invert=0)

    def max_step_hz(self, pulse_us: int) -> int:
        """Return the highest rate of one axis, steps/s: as many as can be prepared per train."""
        most = self._timing[trains.MOST_STEPS] * RESOLUTION_HZ // _SHORTEST_US
        return min(_HIGHEST_HZ, most, RESOLUTION_HZ // (2 * pulse_us))

    def configure(self, pulse_us: int, step_invert: int, dir_invert: int) -> None:
        """Apply $0, and $2 and $3: masks of motors with inverted STEP or DIR. Only while idle."""
        self._timing[trains.PULSE_US] = pulse_us
        self._dir_invert = dir_invert
        for i in range(self._axes):
            self._channels[i].invert(step_invert >> i & 1)
            level = max(self._lanes[_LANE * i + _DIR_LEVEL], 0)
            self._direction[i].value(level ^ (dir_invert >> i & 1))

    def arm(self) -> None:
        """Enable motion after power-up or stop(). Clears the fault and all locks."""
        self._failure = None
        self._timing[trains.LOCKED] = 0
        self._state[_STOPPED] = 0

    def start(self) -> None:
        """Begin to pull, if the engine had run out of segments. A stopped engine stays stopped."""
        state = self._state
        if state[_STOPPED]:
            return
        state[_PULLING] = 1
        if not state[_RUNNING]:
            state[_REPORTED_POWER] = -1
            now = time.ticks_us()
            rest_us = time.ticks_diff(state[_FREE_US], now)
            channels_are_busy = state[_WAS_CUT_OFF] and 0 < rest_us < LOST_US  # above: wrapped
            if not channels_are_busy:
                state[_FREE_US] = now & MASK
            state[_WAS_CUT_OFF] = 0
            state[_NEXT_DUE_US] = (state[_FREE_US] + _START_DELAY_US) & MASK
            self._powers[0] = _NEVER  # no power is due before the first train
            state[_RUNNING] = 1
            self._timer.init(mode=machine.Timer.PERIODIC, period=1, callback=self._refill)

    def stop(self) -> None:
        """Stop at once, until arm(); safe in a soft interrupt. Drops queued steps and locks."""
        self._halt()
        self._state[_RUNNING] = 0

    def _halt(self) -> None:
        """Stop: cut off all trains, drop what is queued. _RUNNING is set; stop() clears it."""
        state, timing = self._state, self._timing
        state[_STOPPED] = 1
        self._cut_off((1 << self._axes) - 1)
        state[_WAS_CUT_OFF] = 1  # channels may play on until _FREE_US
        state[_RUNNING] = 1
        state[_PULLING] = state[_NEXT_READY] = 0
        timing[trains.ROWS_HELD] = timing[trains.DONE_US] = timing[trains.LOCKED] = 0

    def _cut_off(self, axes: int) -> None:
        """End the trains of the axes in a mask now; their positions are the clock's."""
        for i in range(self._axes):
            if axes >> i & 1:
                self._channels[i].cut()
        now = time.ticks_us()
        for i in range(self._axes):
            lane = _LANE * i
            if axes >> i & 1 and self._lanes[lane + _DURATIONS]:
                self._lanes[lane + _PLACE] = _place(self._lanes, i, self._playing[i], now)
                self._lanes[lane + _DURATIONS] = 0

    def lock(self, motors: int) -> None:
        """Stop the pulses of these motors (a mask) until stop(); the others continue."""
        self._timing[trains.LOCKED] = self._timing[trains.LOCKED] | motors
        for i in range(self._axes):
            if motors >> i & 1:
                self._counts[i] = 0  # durations of the next train
        self._cut_off(motors)

    def idle(self) -> bool:
        """Return whether nothing moves and nothing is queued in hardware."""
        return not self._state[_RUNNING]

    def _is_late(self) -> bool:
        """Return whether the next train is so late that it will never begin."""
        late_us = time.ticks_diff(time.ticks_us(), self._state[_NEXT_DUE_US])
        return bool(self._state[_RUNNING]) and late_us > LOST_US

    def position(self, steps: "array[int]") -> None:
        """Copy each motor's position, in steps, into `steps`, as the clock says."""
        for i in range(self._axes):
            steps[i] = _place(self._lanes, i, self._playing[i], time.ticks_us())

    def set_position(self, steps: "array[int]") -> None:
        """Set the present position, also of locked motors. Only while idle."""
        for i in range(self._axes):
            self._lanes[_LANE * i + _PLACE] = steps[i]
            self._lanes[_LANE * i + _DURATIONS] = 0

    def longest_gap_us(self) -> int:
        """Return the longest standstill of motion between trains, in us."""
        return self._state[_LONGEST_GAP_US]

    def worst_skew_us(self) -> int:
        """Return the largest error of a channel's start, early or late, in us."""
        return self._state[_WORST_SKEW_US]

    # The timer's turns: no other soft interrupt runs within them

    def _advance(self) -> None:
        """Do one turn: prepare the next train, and start it when the last one has ended."""
        state = self._state
        if state[_STOPPED] or not state[_RUNNING]:  # turns queued before deinit() still run
            state[_RUNNING] = 0  # also if stop() has interrupted start()
            self._timer.deinit()
            return
        now = time.ticks_us()
        self._report_power(now)
        due_in = time.ticks_diff(state[_NEXT_DUE_US], now)
        if due_in > _PREPARE_US:  # too early: in a later turn
            return
        if not state[_NEXT_READY] and not self._prepare():  # no more motion
            if time.ticks_diff(state[_FREE_US], now) <= 0 and due_in <= 0:
                self._end_train()
                state[_RUNNING] = 0
                self._timer.deinit()
                self._on_rest()
            return
        free_in = time.ticks_diff(state[_FREE_US], time.ticks_us())
        if due_in > _EARLY_US or free_in > _WAIT_US:  # in a later turn
            return
        while time.ticks_diff(state[_FREE_US], time.ticks_us()) > 0:
            pass
        self._start_train()
        self._collect(self._timing[trains.LENGTH_US] - _PREPARE_US)  # garbage, if there is time

    def _prepare(self) -> bool:
        """Fill the ring of rows (ROWS_HELD wait there), and prepare the next train: durations per
        axis (_next), and their numbers (_counts). Returns False if there is nothing to move."""
        state, timing, rows = self._state, self._timing, self._rows
        size = self._row_size
        while (
            state[_PULLING]
            and timing[trains.ROWS_HELD] < trains.ROWS
            and trains.held_us(rows, timing, size) < trains.LONGEST_US
        ):
            if not self._next_segment(self._row):
                state[_PULLING] = 0
                break
            index = (timing[trains.FIRST_ROW] + timing[trains.ROWS_HELD]) % trains.ROWS * size
            for k in range(size):
                rows[index + k] = self._row[k]
            timing[trains.ROWS_HELD] += 1
        if not timing[trains.ROWS_HELD]:
            return False
        trains.choose_end(rows, timing, size)
        for i in range(self._axes):
            count = trains.durations(rows, timing, size, i, self._next[i])
            if count < 0:
                raise RuntimeError("RMT: a pulse train does not fit into its channel's memory")
            self._counts[i] = count
        self._note_powers()
        trains.remove_rows(timing)
        state[_NEXT_READY] = 1
        return True

    def _note_powers(self) -> None:
        """Store the next train's spindle powers in _next_powers, a pair per row: its start, us
        from the train's begin, or _NEVER if it is not in the train; its power."""
        timing, rows = self._timing, self._rows
        start_us = -timing[trains.DONE_US]  # so much of the first row was in the last train
        for k in range(trains.ROWS):
            at = (timing[trains.FIRST_ROW] + k) % trains.ROWS * self._row_size  # index in rows
            is_in_train = k < timing[trains.ROWS_TAKEN] or (k == 0 and timing[trains.PART_US])
            self._next_powers[2 * k] = start_us if is_in_train else _NEVER
            self._next_powers[2 * k + 1] = rows[at + ROW_POWER]
            start_us += rows[at]  # a row begins with its time

    def _report_power(self, now: int) -> None:
        """Report the spindle power that is due at `now`, us, in the train being played."""
        state = self._state
        passed = time.ticks_diff(now, state[_BEGAN_US])
        power = state[_REPORTED_POWER]
        for k in range(trains.ROWS):  # pairs of a start and a power
            if self._powers[2 * k] > passed:
                break
            power = self._powers[2 * k + 1]
        if power != KEEP_POWER and power != state[_REPORTED_POWER]:
            state[_REPORTED_POWER] = power
            self._on_power(power)

    def _end_train(self) -> None:
        """Add the steps of the train, which has been played, to the positions."""
        for i in range(self._axes):
            lane = _LANE * i
            steps = self._lanes[lane + _DURATIONS] // 2  # each has a pause and a pulse
            self._lanes[lane + _DURATIONS] = 0
            back = self._lanes[lane + _BACKWARDS]
            self._lanes[lane + _PLACE] += -steps if back else steps

    def _call_us(self, axis: int) -> int:
        """Return the expected time of write_pulses() for the next train of an axis, in us."""
        durations_us = self._counts[axis] * _CALL_EIGHTHS >> 3
        return self._lanes[_LANE * axis + _CALL_TIME_US] + durations_us

    def _start_train(self) -> None:
        """Start the next train on all axes in step; the last one must have ended. An axis's first
        duration, _next[i][0], is the time to its first step."""
        state, lanes = self._state, self._lanes
        self._end_train()
        setup_us = 0
        for i in range(self._axes):
            lane = _LANE * i
            back = self._timing[trains.DIRS] >> i & 1
            if self._counts[i]:
                lanes[lane + _BACKWARDS] = back
                if lanes[lane + _DIR_LEVEL] != back:
                    lanes[lane + _DIR_LEVEL] = back
                    self._direction[i].value(back ^ (self._dir_invert >> i & 1))
                    setup_us = SETUP_US
        # It begins when it is due, or so late that all axes can be started, one after the other.
        due_in = time.ticks_diff(state[_NEXT_DUE_US], time.ticks_us())
        late_us = 0
        ready_in = setup_us + _GUARD_US  # us from now until channel i can play
        for i in range(self._axes):
            if self._counts[i]:
                ready_in += self._call_us(i)
                first_step_in = due_in + self._next[i][0]  # us from now, if it begins when due
                late_us = max(late_us, ready_in - first_step_in)
        state[_BEGAN_US] = (state[_NEXT_DUE_US] + late_us) & MASK
        state[_FREE_US] = state[_BEGAN_US]  # _start_channel() moves it to the channels' ends
        self._playing, self._next = self._next, self._playing
        self._powers, self._next_powers = self._next_powers, self._powers
        delay_us = 0  # of the slowest start, in addition
        for i in range(self._axes):
            if self._counts[i]:
                delay_us = max(delay_us, self._start_channel(i))
        # The next train waits for the slowest: no interval between steps is shorter than planned.
        state[_LONGEST_GAP_US] = max(state[_LONGEST_GAP_US], late_us + delay_us)
        state[_NEXT_DUE_US] = (state[_BEGAN_US] + self._timing[trains.LENGTH_US] + delay_us) & MASK
        state[_NEXT_READY] = 0
        state[_TRAINS] += 1

    def _start_channel(self, axis: int) -> int:
        """Start one axis so that its first step is on time. Returns by how many us it is late, if
        the start was delayed, else 0."""
        state, lanes = self._state, self._lanes
        lane = _LANE * axis
        count = self._counts[axis]
        playing = self._playing[axis]
        pulses = self._lists[axis]
        first_step_us = playing[0]  # from the train's begin
        expected = self._call_us(axis)  # time of write_pulses(), us
        del pulses[:]  # the list is used again: nothing is allocated
        pulses.extend(memoryview(playing)[:count])
        before_us = time.ticks_us()
        # What is left until the first step when the channel will begin.
        first_pause_us = time.ticks_diff(state[_BEGAN_US], before_us) + first_step_us - expected
        pulses[0] = playing[0] = min(max(first_pause_us, 1), _LONGEST_DURATION_US)
        self._channels[axis].play(pulses)
        took_us = time.ticks_diff(time.ticks_us(), before_us)
        began_us = (before_us + took_us - _RETURN_US) & MASK
        lanes[lane + _STARTED_US] = began_us
        lanes[lane + _DURATIONS] = count
        error_us = took_us - expected
        state[_WORST_SKEW_US] = max(state[_WORST_SKEW_US], abs(error_us))
        correction_us = min(max(error_us, -_HELD_UP_US), _HELD_UP_US) // 4  # smoothed
        estimate = max(lanes[lane + _CALL_TIME_US] + correction_us, _LEAST_CALL_US)
        lanes[lane + _CALL_TIME_US] = min(estimate, _MOST_CALL_US)
        end_us = (before_us + took_us + trains.lasts(playing, count) + _GUARD_US) & MASK
        if time.ticks_diff(end_us, state[_FREE_US]) > 0:
            state[_FREE_US] = end_us
        planned_step = (state[_BEGAN_US] + first_step_us) & MASK
        late_us = time.ticks_diff((began_us + playing[0]) & MASK, planned_step)
        return late_us if late_us > _HELD_UP_US else 0
