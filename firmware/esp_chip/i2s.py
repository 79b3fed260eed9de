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

`state` is indexed by i2s_layout.py. Buffers are counted twice: of our ring MADE were filled and
SENT handed over, since power-up; and a stream numbers all that it plays, from 0: PLAYING now (its
start: PLAYING_SINCE, us), NEXT_NUMBER to be handed over next, LAST_MOTION_NUMBER the last one with
motion. Powers are the spindle's; -1: none. Flags are 0 or 1:

    STOPPED         from a stop until arm()           PULLING    there may be more segments
    KEEP_TIMER_OUT  the timer's turn does nothing     MOVING     not idle
    FLASH_WRITTEN   the stream must be opened again   ROW_BEGUN  a row is in progress
    QUIET_DUE       a buffer without steps is sent before the next one

MOTION_END is MADE after the last buffer with motion. _notes has _note_size integers for each
buffer of our ring, by its slot: NUMBER in the stream, FIRST_WORD without steps, POWER, HAS_MOTION,
and from START_PLACES on each axis's position at its start.

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
from esp_chip import i2s_layout as s
from esp_chip.frames import FRAMES, LANE, PLACE, STEPS_LEFT
from esp_chip.stream import BYTES, Stream
from esp_chip.timer_engine import LOST_US, SETUP_US, TimerEngine

_HIGHEST_OUTPUT = const(29)  # its bit, 30, is the highest of a small integer
_TURN_MS = const(4)  # period of the timer
_UNFILLED = const(2)  # buffers of DMA's ring that are not filled
_IDLE_DEPTH = const(5)  # buffers filled ahead while idle
_DOUBT_US = const(300)  # so close to a buffer's end it is uncertain which one a write would be
_RETURN_HZ = const(1000)  # a locked axis returns to its position at this rate, without a ramp


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
            raise ValueError("I2S outputs are numbered from 0 to 29")
        self._axes = axes = len(step)
        self._rate_hz = rate_hz
        self._buffers = buffers
        self._stream = Stream(pins, rate_hz, buffers)
        self._buffer_us = self._stream.buffer_us
        self.tick_hz = rate_hz << frames.FRAME_LOG2
        self._enable_bits = sum([2 << output for output in enables])  # output n is bit n + 1
        self._state = array("i", (0 for _ in range(s.STATE_LENGTH)))
        self._timing = array("i", (0 for _ in range(frames.TIMING_LENGTH)))
        self._timing[frames.AXES] = axes
        self._lanes = array("i", (0 for _ in range(LANE * axes)))
        for i in range(axes):
            self._lanes[LANE * i + frames.STEP_BIT] = 2 << step[i]
            self._lanes[LANE * i + frames.DIR_BIT] = 2 << direction[i]
        self._row = array("i", (0 for _ in range(row_length(axes))))
        # Our ring holds the buffers that DMA may still have to play, and those to be handed over.
        self._slots = buffers + 2
        self._memory = bytearray(BYTES * self._slots)
        whole = memoryview(self._memory)
        self._ring = [whole[BYTES * k : BYTES * (k + 1)] for k in range(self._slots)]
        self._quiet_buffer = bytearray(BYTES)  # a buffer without steps
        self._note_size = s.START_PLACES + axes  # integers in the notes of a buffer
        self._notes = array("i", (0 for _ in range(self._note_size * self._slots)))
        # Per axis that is or was locked: where, and the steps made since then, which are taken
        # back before the next motion. _steps is scratch for position().
        self._locked_at, self._owed, self._steps = [
            array("i", (0 for _ in range(axes))) for _ in range(3)
        ]
        self._state[s.STOPPED] = 1
        self.enable(1)  # off
        self._timer = machine.Timer(0)
        self.configure(pulse_us=10, step_invert=0, dir_invert=0)
        self._open()
        self.flash_written()  # later imports read flash, which has the same effect
        self._timer.init(mode=machine.Timer.PERIODIC, period=_TURN_MS, callback=self._refill)

    def _open(self) -> None:
        """Open a new stream, which plays zeros until its first buffer is handed over."""
        state = self._state
        state[s.PLAYING_SINCE] = self._stream.open() & MASK
        state[s.PLAYING] = state[s.FLASH_WRITTEN] = 0
        state[s.NEXT_NUMBER] = self._buffers  # the first that can be written: see Stream.open()
        state[s.LAST_MOTION_NUMBER] = -1
        state[s.QUIET_DUE] = 1
        for slot in range(self._slots):  # the old stream's numbers are void
            self._notes[slot * self._note_size + s.NUMBER] = -1

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
        timing[frames.PULSE_FRAMES] = self._frames_of(pulse_us)
        timing[frames.SETUP_FRAMES] = self._frames_of(SETUP_US)
        for i in range(self._axes):
            self._lanes[LANE * i + frames.DIR_INVERT] = dir_invert >> i & 1
        frames.drop_row(timing, self._lanes)  # sets the levels of DIR anew

    def enable(self, level: int) -> None:
        """Set the level of the drivers' enable outputs, from the next buffer on. For the port."""
        self._timing[frames.ENABLE_BITS] = self._enable_bits if level else 0

    def flash_written(self) -> None:
        """Note that flash was written, so the stream must be opened again. Only while idle."""
        self._state[s.FLASH_WRITTEN] = 1

    def arm(self) -> None:
        """Enable motion after power-up or stop()."""
        if self._failure:
            self.flash_written()  # since the failure no turn has followed the stream
            self._failure = None
        self._timing[frames.LOCKED] = 0
        self._state[s.STOPPED] = 0

    def start(self) -> None:
        """Begin to pull segments, in the timer's next turn. A stopped engine stays stopped."""
        state = self._state
        if state[s.STOPPED] or state[s.PULLING]:
            return
        if state[s.FLASH_WRITTEN] and not state[s.MOVING]:  # reopen; the timer must not use it now
            state[s.KEEP_TIMER_OUT] = 1
            self._stream.close()
            self._reopen()
            state[s.KEEP_TIMER_OUT] = 0
        state[s.LAST_WRITE_US] = time.ticks_us() & MASK  # _is_late() counts from here
        state[s.REPORTED_POWER] = state[s.NEWEST_POWER] = -1
        state[s.PULLING] = state[s.MOVING] = 1

    def stop(self) -> None:
        """Stop at once, until arm(); safe in a soft interrupt. Drops queued steps and locks."""
        self._halt()
        self._state[s.MOVING] = 0

    def _halt(self) -> None:
        """Stop: close the stream, drop everything that was not played, and open a new one. MOVING
        is set, so that the main loop asks for the fault; stop() clears it."""
        state, lanes, steps = self._state, self._lanes, self._steps
        kept_out = state[s.KEEP_TIMER_OUT]  # 1 if the interrupted code has set it
        state[s.STOPPED] = state[s.KEEP_TIMER_OUT] = 1
        state[s.NEWEST_POWER] = -1
        if state[s.MOVING] or state[s.PULLING]:
            now = time.ticks_us()
            try:
                self._stream.close()
                self._find_places(steps, now)  # reported positions, without _owed
                for i in range(self._axes):
                    lanes[LANE * i + PLACE] = steps[i] + self._owed[i]  # the motor's, see lock()
                self._reopen()
            except BaseException as why:
                self._failure = why
        # What locked axes have moved since lock() is taken back before the next motion.
        for i in range(self._axes):
            locked = self._timing[frames.LOCKED] >> i & 1
            self._owed[i] = lanes[LANE * i + PLACE] - self._locked_at[i] if locked else 0
        state[s.PULLING] = state[s.ROW_BEGUN] = 0
        self._timing[frames.LOCKED] = 0
        state[s.MOVING] = 1
        state[s.KEEP_TIMER_OUT] = kept_out

    def _reopen(self) -> None:
        """Drop all frames that were not played, and open a new stream; the old one is closed."""
        state = self._state
        state[s.SENT] = state[s.MOTION_END] = state[s.MADE]  # nothing filled waits
        frames.drop_row(self._timing, self._lanes)
        self._open()

    def lock(self, motors: int) -> None:
        """Stop the pulses of these motors (a mask) until stop(); the others continue.

        Steps that DMA already has are made, and taken back before the next motion.
        """
        timing = self._timing
        self._state[s.KEEP_TIMER_OUT] = 1
        self.position(self._steps)
        for i in range(self._axes):
            if motors >> i & 1 and not timing[frames.LOCKED] >> i & 1:
                self._locked_at[i] = self._steps[i]
                self._lanes[LANE * i + STEPS_LEFT] = 0
        timing[frames.LOCKED] = timing[frames.LOCKED] | motors
        self._state[s.KEEP_TIMER_OUT] = 0

    def idle(self) -> bool:
        """Return whether nothing moves and nothing is queued in hardware, as of the last turn."""
        return not self._state[s.MOVING]

    def _is_late(self) -> bool:
        """Return whether the stream has accepted nothing for so long that it never will."""
        since_us = time.ticks_diff(time.ticks_us(), self._state[s.LAST_WRITE_US])
        return bool(self._state[s.MOVING]) and since_us > LOST_US

    def position(self, steps: "array[int]") -> None:
        """Copy the steps made, per motor, exact to a frame, without those to be taken back."""
        self._find_places(steps, time.ticks_us())

    def _find_places(self, steps: "array[int]", now: int) -> None:
        """Compute the positions at the time now (us) into steps, from the buffer being played: its
        notes have those at its start, and its bits the steps since then.

        _owed: steps that an axis has made after it was locked, and will take back.
        """
        state, axes = self._state, self._axes
        passed = frames.find_playing(state, now, self._buffer_us)
        slot = frames.playing_slot(state, self._notes, self._slots, self._note_size)
        zeros_are_played = slot < 0  # the positions are those at the start of the next buffer
        is_filled = slot != s.NOT_FILLED  # if not, those after all steps put into buffers
        noted_slot = slot + s.ZEROS_BEFORE if zeros_are_played else slot
        places_at = noted_slot * self._note_size + s.START_PLACES  # index in the notes
        for i in range(axes):
            place = self._notes[places_at + i] if is_filled else self._lanes[LANE * i + PLACE]
            steps[i] = place - self._owed[i]
        if not zeros_are_played:
            frames_played = passed * FRAMES // self._buffer_us + 1  # with the present one
            frames.count(self._ring[slot], frames_played, self._timing, self._lanes, steps)

    def set_position(self, steps: "array[int]") -> None:
        """Set the present position, also of locked motors. Only while idle.

        A locked axis is where it was locked, so its motor is ahead by _owed steps. PLACE and notes
        count the motor's steps.
        """
        self._state[s.KEEP_TIMER_OUT] = 1  # meanwhile the timer's turn does nothing
        for i in range(self._axes):
            self._locked_at[i] = steps[i]
            place = steps[i] + self._owed[i]
            self._lanes[LANE * i + PLACE] = place
            # Buffers are played while idle, too, and position() counts from their notes.
            for slot in range(self._slots):
                self._notes[slot * self._note_size + s.START_PLACES + i] = place
        self._state[s.KEEP_TIMER_OUT] = 0

    def underrun_count(self) -> int:
        """Return how often the machine has paused during motion because the engine was late."""
        return self._state[s.UNDERRUNS]

    # The timer's turns: no other soft interrupt runs within them

    def _advance(self) -> None:
        """Do one turn: report power, and fill and hand over buffers until enough are queued."""
        state = self._state
        if state[s.KEEP_TIMER_OUT]:
            return
        if state[s.STOPPED]:  # also if the stop has interrupted start()
            state[s.PULLING] = state[s.MOVING] = 0
        passed_us = frames.find_playing(state, time.ticks_us(), self._buffer_us)
        self._report_power()
        if state[s.NEXT_NUMBER] <= state[s.PLAYING] + 1:  # nothing follows the buffer being played
            if passed_us < _DOUBT_US or passed_us > self._buffer_us - _DOUBT_US:
                return  # too close to a buffer's end: in the next turn
            # The stream is out of data, or may be: zeros are played before the next buffer.
            state[s.NEXT_NUMBER] = state[s.PLAYING] + 1
            state[s.QUIET_DUE] = 1
            if state[s.PULLING] or state[s.MOTION_END] > state[s.SENT]:
                state[s.UNDERRUNS] += 1
        # Buffers filled ahead of the one being played.
        depth = self._buffers - _UNFILLED if state[s.PULLING] else _IDLE_DEPTH
        while state[s.NEXT_NUMBER] - state[s.PLAYING] < depth:
            if state[s.MADE] == state[s.SENT]:
                self._fill_next()
            if not (self._send_quiet() if state[s.QUIET_DUE] else self._send()):
                return
            state[s.LAST_WRITE_US] = time.ticks_us() & MASK

    def _report_power(self) -> None:
        """Set the spindle power of the buffer being played, and notice the end of motion."""
        slot = frames.playing_slot(self._state, self._notes, self._slots, self._note_size)
        # Not while idle, because code that sees idle() may set the spindle.
        if slot >= 0 and self._notes[slot * self._note_size + s.HAS_MOTION]:
            self._set_power(self._notes[slot * self._note_size + s.POWER])
        self._check_idle()

    def _check_idle(self) -> None:
        """After the last buffer with motion, set its power, then report the end of motion."""
        state = self._state
        all_sent = state[s.MOTION_END] <= state[s.SENT]
        all_played = all_sent and state[s.LAST_MOTION_NUMBER] < state[s.PLAYING]
        if state[s.MOVING] and not state[s.PULLING] and all_played:
            self._set_power(state[s.NEWEST_POWER])
            state[s.MOVING] = 0
            self._on_rest()

    def _set_power(self, power: int) -> None:
        """Report a spindle power, if it is known (not -1) and another than the last."""
        if power >= 0 and power != self._state[s.REPORTED_POWER]:
            self._state[s.REPORTED_POWER] = power
            self._on_power(power)

    def _fill_next(self) -> None:
        """Fill the next buffer of our ring with frames, and its notes."""
        state, timing, lanes = self._state, self._timing, self._lanes
        row, slot = self._row, state[s.MADE] % self._slots
        note = slot * self._note_size  # index of the buffer's notes
        buffer, notes = self._ring[slot], self._notes
        for i in range(self._axes):
            notes[note + s.START_PLACES + i] = lanes[LANE * i + PLACE]
        notes[note + s.FIRST_WORD] = frames.begin_buffer(buffer, timing, lanes)
        notes[note + s.POWER] = state[s.NEWEST_POWER]
        notes[note + s.HAS_MOTION] = state[s.PULLING]
        if state[s.PULLING]:
            state[s.MOTION_END] = state[s.MADE] + 1
            if not state[s.ROW_BEGUN]:  # motion begins: first axes that were locked return
                timing[frames.ROW_END] = 0  # at the buffer's start
                gap_ticks = self.tick_hz // _RETURN_HZ
                if frames.make_return_row(row, self._owed, self._axes, gap_ticks):
                    late = frames.lateness(row, timing, lanes)
                    frames.begin_row(buffer, row, timing, lanes, late)
                    state[s.ROW_BEGUN] = 1
            # render() returns 1 if the row is over and the buffer has space for another one.
            while not state[s.ROW_BEGUN] or frames.render(buffer, timing, lanes):
                if not self._next_segment(row):
                    state[s.PULLING] = state[s.ROW_BEGUN] = 0
                    break
                late = frames.lateness(row, timing, lanes)
                frames.begin_row(buffer, row, timing, lanes, late)
                state[s.ROW_BEGUN] = 1
                notes[note + s.POWER] = state[s.NEWEST_POWER] = row[ROW_POWER]
        frames.end_buffer(timing, lanes)
        state[s.MADE] += 1

    def _send_quiet(self) -> bool:
        """Send, after zeros, a buffer without steps that has the directions of the next one.
        Returns False if DMA has no space yet."""
        state = self._state
        note = state[s.SENT] % self._slots * self._note_size  # of the next buffer
        frames.blank(self._quiet_buffer, self._notes[note + s.FIRST_WORD])
        if not self._stream.write(self._quiet_buffer):
            return False
        state[s.QUIET_DUE] = 0
        state[s.NEXT_NUMBER] += 1
        return True

    def _send(self) -> bool:
        """Hand over the next buffer. Returns False if DMA has no space yet."""
        state = self._state
        slot = state[s.SENT] % self._slots
        if not self._stream.write(self._ring[slot]):
            return False
        note = slot * self._note_size
        self._notes[note + s.NUMBER] = state[s.NEXT_NUMBER]
        if self._notes[note + s.HAS_MOTION]:
            state[s.LAST_MOTION_NUMBER] = state[s.NEXT_NUMBER]
        state[s.NEXT_NUMBER] += 1
        state[s.SENT] += 1
        return True
