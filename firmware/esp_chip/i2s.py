# mypy: disable-error-code=arg-type
"""I2sEngine: pulses through shift registers (74HC595), made by machine.I2S as a stream of bits.

Every frame of the stream is one 32-bit word and has all outputs: steps, directions and the
drivers' enable (frames.py). DMA plays buffers of 256 frames (stream.py); a soft timer fills the
next ones and hands them over.

    segment rows -> frames (our ring) -> DMA's ring -> BCK, WS, DATA -> shift registers

If the engine is late, DMA plays zeros. A zero is no step, a powered motor (enable is low-active)
and some direction. The stream then continues with a buffer without steps, so that directions are
stable long before the next step. No step is lost or repeated.

Position is counted from the bits of the buffer being played. An immediate stop closes the stream;
a new one begins with zeros. What DMA has received cannot be taken back for one axis alone: a
locked axis continues to the end of it, and returns before the next motion, which therefore starts
where the axis was locked. While flash is written, notices of played buffers are lost (the
interrupt of ESP-IDF is not in RAM), and the next free buffer is no longer the next one to be
played: the stream is opened again before the next motion, which starts a round, 32 ms, later.

Philips format: data come one bit later than WS, which the registers use as their latch. So an
output's bit is one place higher than its number. Unverified on hardware, like all here.
"""

import time
from array import array

import machine
from base.times import MASK
from micropython import const
from motion.layout import ROW_POWER, row_length

from esp_chip import frames
from esp_chip.frames import FRAMES, LANE, LEFT, PLACE
from esp_chip.i2s_layout import (
    BEFORE,
    BEGAN,
    DRY,
    HALT,
    LAST,
    LATEST,
    MADE,
    MOVED,
    MOVES,
    MOVING,
    NOTE,
    NOWHERE,
    NUMBER,
    PAUSE,
    PLAYING,
    POWER,
    PULLING,
    REPORTED,
    ROW,
    SENT,
    STALE,
    START,
    STATE_LENGTH,
    STOPPED,
    TAKEN,
    WRITTEN,
)
from esp_chip.stream import BYTES, Stream
from esp_chip.timer_engine import LOST_US, SETUP_US, TimerEngine

_HIGHEST_OUTPUT = const(29)  # its bit, 30, is the highest of a small integer
_TURN_MS = const(4)
_SPARE = const(2)  # buffers of DMA's ring that are not filled
_DEPTH_AT_REST = const(5)
# So close to the end of a DMA buffer, in us, it is uncertain which buffer the next write would be.
_DOUBT_US = const(300)
# A locked axis returns to its position at this rate, without a ramp.
_BACK_HZ = const(1000)


class I2sEngine(TimerEngine):
    """The engine. step, direction: numbers of outputs per axis; enable: output of the drivers'
    enable, or several, which are switched together.

    pins: BCK, WS and DATA. rate_hz: frames per second; 256 must last whole microseconds. buffers:
    of DMA's ring; all but two are filled ahead during motion.
    """

    segment_log2 = 14

    def __init__(
        self,
        step: "tuple[int, ...]",
        direction: "tuple[int, ...]",
        enable: "int | tuple[int, ...]",
        pins: "tuple[int, int, int]",
        rate_hz: int = 125_000,
        buffers: int = 16,
    ) -> None:
        super().__init__()
        enables = (enable,) if isinstance(enable, int) else enable
        if max(step + direction + enables) > _HIGHEST_OUTPUT:
            raise ValueError("outputs have numbers from 0 to 29")
        self._axes = axes = len(step)
        self._rate_hz = rate_hz
        self._buffers = buffers
        self._stream = Stream(pins, rate_hz, buffers)
        self._buffer_us = self._stream.buffer_us
        self.tick_hz = rate_hz << frames.FRAME_LOG2
        self._enable_bits = sum([2 << output for output in enables])
        self._state = array("i", (0 for _ in range(STATE_LENGTH)))
        self._timing = array("i", (0 for _ in range(frames.TIMING_LENGTH)))
        self._timing[frames.AXES] = axes
        self._lanes = array("i", (0 for _ in range(LANE * axes)))
        for i in range(axes):
            self._lanes[LANE * i + frames.STEP] = 2 << step[i]
            self._lanes[LANE * i + frames.DIR] = 2 << direction[i]
        self._row = array("i", (0 for _ in range(row_length(axes))))
        # Our ring holds the buffers that DMA may still have to play, and those to be handed over.
        self._slots = buffers + 2
        self._memory = bytearray(BYTES * self._slots)
        whole = memoryview(self._memory)
        self._ring = [whole[BYTES * k : BYTES * (k + 1)] for k in range(self._slots)]
        self._pause = bytearray(BYTES)  # a buffer without steps
        self._size = NOTE + axes  # integers in the notes of a buffer
        self._notes = array("i", (0 for _ in range(self._size * self._slots)))
        # Per axis that is or was locked: where, and the steps made since then, which are taken
        # back before the next motion. _steps is scratch for position().
        self._locked_at, self._owed, self._steps = [
            array("i", (0 for _ in range(axes))) for _ in range(3)
        ]
        self._state[STOPPED] = 1
        self.enable(1)  # off
        self._timer = machine.Timer(0)
        self.configure(10, 0, 0)
        self._open()
        self.flash_written()  # later imports read flash, which has the same effect
        self._timer.init(mode=machine.Timer.PERIODIC, period=_TURN_MS, callback=self._refill)

    def _open(self) -> None:
        """Open a new stream, which plays zeros until its first buffer is handed over."""
        state = self._state
        state[BEGAN] = self._stream.open() & MASK
        state[PLAYING] = state[STALE] = 0
        state[WRITTEN] = self._buffers  # the first that can be written: see Stream.open()
        state[LAST] = -1
        state[PAUSE] = 1
        for slot in range(self._slots):  # buffers are numbered from 0 again
            self._notes[slot * self._size + NUMBER] = -1

    # The StepEngine interface

    def max_step_hz(self, pulse_us: int) -> int:
        """Return the highest rate of one axis: pulses are whole frames, with one between them."""
        return self._rate_hz // (self._frames_of(pulse_us) + 1)

    def _frames_of(self, us: int) -> int:
        """Return how many frames a time in us takes, rounded up."""
        return -(-us * self._rate_hz // 1_000_000)

    def configure(self, pulse_us: int, step_invert: int, dir_invert: int) -> None:
        """Apply $0, the length of a pulse, and $3, a mask of motors with inverted DIR. While idle
        only. $2 is ignored: with inverted steps, the zeros of a late stream would be a step.
        """
        timing = self._timing
        timing[frames.PULSE] = self._frames_of(pulse_us)
        timing[frames.SETUP] = self._frames_of(SETUP_US)
        for i in range(self._axes):
            self._lanes[LANE * i + frames.INVERT] = dir_invert >> i & 1
        frames.drop_row(timing, self._lanes)

    def enable(self, level: int) -> None:
        """Set the level of the drivers' enable outputs, from the next buffer on. For the port."""
        self._timing[frames.ENABLE] = self._enable_bits if level else 0

    def flash_written(self) -> None:
        """Note that flash was written, so the stream must be opened again. Only while idle."""
        self._state[STALE] = 1

    def arm(self) -> None:
        """Enable motion after power-up or stop()."""
        if self._failure:
            self.flash_written()  # since the failure no turn has followed the stream
            self._failure = None
        self._timing[frames.LOCKED] = 0
        self._state[STOPPED] = 0

    def start(self) -> None:
        """Begin to pull segments, in the timer's next turn. A stopped engine stays stopped."""
        state = self._state
        if state[STOPPED] or state[PULLING]:
            return
        if state[STALE] and not state[MOVING]:
            state[HALT] = 1
            self._stream.close()
            self._renew()
            state[HALT] = 0
        state[TAKEN] = time.ticks_us() & MASK
        state[REPORTED] = state[LATEST] = -1
        state[PULLING] = state[MOVING] = 1

    def stop(self) -> None:
        """Stop at once, until arm(); safe in a soft interrupt. Drops queued steps and locks."""
        self._halt()
        self._state[MOVING] = 0

    def _halt(self) -> None:
        """Close the stream, and drop everything that was not played; MOVING stays set."""
        state, lanes, steps = self._state, self._lanes, self._steps
        halt_before = state[HALT]  # 1 if the interrupted code has set it
        state[STOPPED] = state[HALT] = 1
        state[LATEST] = -1
        if state[MOVING] or state[PULLING]:
            now = time.ticks_us()
            try:
                self._stream.close()
                self._find_note(steps, now)
                for i in range(self._axes):
                    lanes[LANE * i + PLACE] = steps[i] + self._owed[i]
                self._renew()
            except BaseException as why:
                self._failure = why
        for i in range(self._axes):
            locked = self._timing[frames.LOCKED] >> i & 1
            self._owed[i] = lanes[LANE * i + PLACE] - self._locked_at[i] if locked else 0
        state[PULLING] = state[ROW] = 0
        self._timing[frames.LOCKED] = 0
        state[MOVING] = 1
        state[HALT] = halt_before

    def _renew(self) -> None:
        """Drop all frames that were not played, and begin a new stream."""
        state = self._state
        state[SENT] = state[MOVED] = state[MADE]
        frames.drop_row(self._timing, self._lanes)
        self._open()

    def lock(self, motors: int) -> None:
        """Stop the pulses of these motors (a mask) until stop(); the others continue.

        Steps that DMA already has are made, and taken back before the next motion.
        """
        timing = self._timing
        self._state[HALT] = 1
        self.position(self._steps)
        for i in range(self._axes):
            if motors >> i & 1 and not timing[frames.LOCKED] >> i & 1:
                self._locked_at[i] = self._steps[i]
                self._lanes[LANE * i + LEFT] = 0
        timing[frames.LOCKED] = timing[frames.LOCKED] | motors
        self._state[HALT] = 0

    def idle(self) -> bool:
        """Return whether nothing moves and nothing is queued in hardware, as of the last turn."""
        return not self._state[MOVING]

    def _is_late(self) -> bool:
        """Return whether the stream has accepted nothing for so long that it never will."""
        since_us = time.ticks_diff(time.ticks_us(), self._state[TAKEN])
        return bool(self._state[MOVING]) and since_us > LOST_US

    def position(self, steps: "array[int]") -> None:
        """Copy the steps made, per motor, exact to a frame, without those to be taken back."""
        self._find_note(steps, time.ticks_us())

    def _find_note(self, steps: "array[int]", now: int) -> None:
        """Compute the positions at the time now (us) into steps, from the buffer being played: its
        notes have those at its start, and its bits the steps since then."""
        state, axes = self._state, self._axes
        passed = frames.find_playing(state, now, self._buffer_us)
        slot = frames.playing_slot(state, self._notes, self._slots, self._size)
        # Where zeros are played, the positions are those at the start of the next buffer.
        note = (slot if slot >= 0 else slot + BEFORE) * self._size + NOTE
        for i in range(axes):
            place = self._lanes[LANE * i + PLACE] if slot == NOWHERE else self._notes[note + i]
            steps[i] = place - self._owed[i]
        if slot >= 0:
            frames_played = passed * FRAMES // self._buffer_us + 1
            frames.count(self._ring[slot], frames_played, self._timing, self._lanes, steps)

    def set_position(self, steps: "array[int]") -> None:
        """Set the present position, also of locked motors. Only while idle.

        A locked axis is where it was locked, so its motor is ahead by _owed steps. PLACE and notes
        count the motor's steps.
        """
        self._state[HALT] = 1  # meanwhile the timer's turn does nothing
        for i in range(self._axes):
            self._locked_at[i] = steps[i]
            place = steps[i] + self._owed[i]
            self._lanes[LANE * i + PLACE] = place
            # Buffers are played while idle, too, and position() counts from their notes.
            for slot in range(self._slots):
                self._notes[slot * self._size + NOTE + i] = place
        self._state[HALT] = 0

    def underrun_count(self) -> int:
        """Return how often the machine has paused during motion because the engine was late."""
        return self._state[DRY]

    # The timer's turns: no other soft interrupt runs within them

    def _advance(self) -> None:
        """Do one turn: report power, and fill and hand over buffers until enough are queued."""
        state = self._state
        if state[HALT]:
            return
        if state[STOPPED]:  # the stop may have interrupted start()
            state[PULLING] = state[MOVING] = 0
        passed = frames.find_playing(state, time.ticks_us(), self._buffer_us)
        self._report_power()
        if state[WRITTEN] <= state[PLAYING] + 1:
            if passed < _DOUBT_US or passed > self._buffer_us - _DOUBT_US:
                return
            # The stream is out of data, or may be.
            state[WRITTEN] = state[PLAYING] + 1
            state[PAUSE] = 1
            if state[PULLING] or state[MOVED] > state[SENT]:
                state[DRY] += 1
        depth = self._buffers - _SPARE if state[PULLING] else _DEPTH_AT_REST
        while state[WRITTEN] - state[PLAYING] < depth:
            if state[MADE] == state[SENT]:
                self._make()
            if not (self._send_pause() if state[PAUSE] else self._send()):
                return
            state[TAKEN] = time.ticks_us() & MASK

    def _report_power(self) -> None:
        """Report the spindle power of the buffer being played, and the end of motion."""
        slot = frames.playing_slot(self._state, self._notes, self._slots, self._size)
        # Not while idle, because code that sees idle() may set the spindle.
        if slot >= 0 and self._notes[slot * self._size + MOVES]:
            self._tell(self._notes[slot * self._size + POWER])
        self._check_idle()

    def _check_idle(self) -> None:
        """After the last buffer with a step (LAST), report its power, then the end of motion."""
        state = self._state
        played = state[MOVED] <= state[SENT] and state[LAST] < state[PLAYING]
        if state[MOVING] and not state[PULLING] and played:
            self._tell(state[LATEST])
            state[MOVING] = 0
            self._on_rest()

    def _tell(self, power: int) -> None:
        """Report a spindle power, if it is known (not -1) and another than the last."""
        if power >= 0 and power != self._state[REPORTED]:
            self._state[REPORTED] = power
            self._on_power(power)

    def _make(self) -> None:
        """Fill the next buffer of our ring with frames, and its notes."""
        state, timing, lanes = self._state, self._timing, self._lanes
        row, slot = self._row, state[MADE] % self._slots
        note = slot * self._size
        buffer, notes = self._ring[slot], self._notes
        for i in range(self._axes):
            notes[note + NOTE + i] = lanes[LANE * i + PLACE]
        notes[note + START] = frames.begin_buffer(buffer, timing, lanes)
        notes[note + POWER] = state[LATEST]
        notes[note + MOVES] = state[PULLING]
        if state[PULLING]:
            state[MOVED] = state[MADE] + 1
            if not state[ROW]:  # motion begins
                timing[frames.ROW_END] = 0
                if frames.make_return_row(row, self._owed, self._axes, self.tick_hz // _BACK_HZ):
                    late = frames.lateness(row, timing, lanes)
                    frames.begin_row(buffer, row, timing, lanes, late)
                    state[ROW] = 1
            while not state[ROW] or frames.render(buffer, timing, lanes):
                if not self._next_segment(row):
                    state[PULLING] = state[ROW] = 0
                    break
                late = frames.lateness(row, timing, lanes)
                frames.begin_row(buffer, row, timing, lanes, late)
                state[ROW] = 1
                notes[note + POWER] = state[LATEST] = row[ROW_POWER]
        frames.end_buffer(timing, lanes)
        state[MADE] += 1

    def _send_pause(self) -> bool:
        """Send, after zeros, a buffer without steps that has the directions of the next one.
        Returns False if DMA has no space yet."""
        state = self._state
        frames.blank(self._pause, self._notes[state[SENT] % self._slots * self._size + START])
        if not self._stream.write(self._pause):
            return False
        state[PAUSE] = 0
        state[WRITTEN] += 1
        return True

    def _send(self) -> bool:
        """Hand over the next buffer. Returns False if DMA has no space yet."""
        state = self._state
        slot = state[SENT] % self._slots
        if not self._stream.write(self._ring[slot]):
            return False
        note = slot * self._size
        self._notes[note + NUMBER] = state[WRITTEN]
        if self._notes[note + MOVES]:
            state[LAST] = state[WRITTEN]
        state[WRITTEN] += 1
        state[SENT] += 1
        return True
