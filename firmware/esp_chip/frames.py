# mypy: disable-error-code=arg-type
"""Frames: from segment rows to the words for the shift registers, in integers.

A frame is one 32-bit word: the levels of all outputs for some microseconds. Frames come in buffers
of 256, the length of one DMA buffer of machine.I2S. A lane is the state of one axis, a few
integers. Times are in ticks, 16 per frame, from the start of the buffer being filled; they may be
later than its end. Only positions may be negative. A buffer has 256 frames, 4096 ticks.

A pulse never crosses the end of a buffer: zeros may follow (see i2s.py), and must not replace the
second half of a step. Called in the engine's turns; nothing here allocates.

Arguments: frames, the words of a buffer; lanes, LANE integers per axis; timing, integers shared by
all lanes; row, a segment's row (motion/layout.py): at ROW_TICKS its time, at ROW_DIRS a mask of
the axes that turn backwards, and per axis, from ROW_AXES on, its steps and the ticks of the first
and of the last one. Results are 0 unless a function says otherwise.
"""

import micropython
from base.times import MASK, NEGATIVE
from micropython import const
from motion.layout import ROW_AXES, ROW_DIRS, ROW_STRIDE, ROW_TICKS
from motion.slice_kernel import leading

from esp_chip.i2s_layout import (
    MADE,
    NOT_FILLED,
    NUMBER,
    PLAYING,
    PLAYING_SINCE,
    SENT,
    ZEROS_BEFORE,
)

FRAMES = const(256)  # per buffer: DMA_BUF_LEN_IN_I2S_FRAMES of MicroPython's machine_i2s.c
FRAME_LOG2 = const(4)  # log2 of the ticks per frame
_BUFFER_TICKS = const(4096)  # per buffer

# Lanes: integers per axis, and the index of each among them.
LANE = const(12)  # integers per axis
STEP_BIT = const(0)  # mask with the bit of the axis's step output
DIR_BIT = const(1)  # mask with the bit of the axis's direction output
DIR_INVERT = const(2)  # 1: the direction output is high forwards, 0: backwards
BACKWARDS = const(3)  # 1: the axis turns backwards
CHANGE_DUE = const(4)  # 1 + frame of the direction output's next change; 0: no change is due
FREE_FRAME = const(5)  # first frame in which the axis may step
STEPS_LEFT = const(6)  # steps of the row that are still to be made
NEXT_TICK = const(7)  # tick of the next of these steps
GAP = const(8)  # ticks from step to step
FIRST_LONGER = const(9)  # how many of the next gaps are one tick longer
PLACE = const(10)  # position after all steps put into buffers
LAST_LONGER = const(11)  # how many of the row's last gaps are one tick longer

# Integers shared by all lanes (timing): indexes.
AXES = const(0)  # number of lanes
PULSE_FRAMES = const(1)  # frames of a pulse
SETUP_FRAMES = const(2)  # frames from a change of direction to a step
DIR_LEVELS = const(3)  # levels of the direction outputs at the end of the filled frames
ROW_END = const(4)  # tick at which the row ends
LOCKED = const(5)  # mask of locked axes, which do not step
ENABLE_BITS = const(6)  # levels of the enable outputs, for the next buffer
TIMING_LENGTH = const(7)


@micropython.viper
def blank(frames: ptr32, word: int) -> int:
    """Fill a buffer with one word."""
    for i in range(FRAMES):
        frames[i] = word
    return 0


@micropython.viper
def begin_buffer(frames: ptr32, timing: ptr32, lanes: ptr32) -> int:
    """Start the next buffer: no steps yet; the changes of direction in CHANGE_DUE are in it.

    Returns its first word: the outputs before any change. frames: all words are overwritten.
    """
    start = timing[DIR_LEVELS] | timing[ENABLE_BITS]
    for i in range(FRAMES):
        frames[i] = start
    for i in range(timing[AXES]):
        change_due = lanes[LANE * i + CHANGE_DUE]
        if change_due:
            lanes[LANE * i + CHANGE_DUE] = 0
            flip = lanes[LANE * i + DIR_BIT]
            timing[DIR_LEVELS] = timing[DIR_LEVELS] ^ flip
            for k in range(change_due - 1, FRAMES):
                frames[k] = frames[k] ^ flip
    return start


@micropython.viper
def end_buffer(timing: ptr32, lanes: ptr32) -> int:
    """Make all times in timing and lanes relative to the start of the next buffer; those that are
    past become 0. A change of direction in CHANGE_DUE is never past."""
    end = timing[ROW_END] - _BUFFER_TICKS
    timing[ROW_END] = end if end > 0 else 0
    for i in range(timing[AXES]):
        lane = LANE * i
        free = lanes[lane + FREE_FRAME] - FRAMES
        lanes[lane + FREE_FRAME] = free if free > 0 else 0
        tick = lanes[lane + NEXT_TICK] - _BUFFER_TICKS
        lanes[lane + NEXT_TICK] = tick if tick > 0 else 0
        if lanes[lane + CHANGE_DUE]:
            lanes[lane + CHANGE_DUE] = lanes[lane + CHANGE_DUE] - FRAMES
    return 0


@micropython.viper
def make_return_row(row: ptr32, owed: ptr32, axes: int, gap: int) -> int:
    """Make a row that takes the owed steps back, `gap` ticks apart. Returns the steps of the axis
    that makes the most; 0 if none is owed. owed: per axis, steps too far: positive or negative;
    becomes 0."""
    most = 0
    dirs = 0
    for i in range(axes):
        steps = owed[i]
        owed[i] = 0
        if steps > 0:
            dirs |= 1 << i
        else:
            steps = 0 - steps
        if steps > most:
            most = steps
        base = ROW_AXES + ROW_STRIDE * i
        row[base] = steps
        row[base + 1] = gap  # tick of the first one, and of the last one
        row[base + 2] = gap * steps
    row[ROW_TICKS] = gap * (most + 1)
    row[ROW_DIRS] = dirs
    return most


@micropython.viper
def lateness(row: ptr32, timing: ptr32, lanes: ptr32) -> int:
    """Return by how many ticks a row must start later than ROW_END; 0: it can follow at once.

    All axes wait for one that would reverse too soon after its last step, or whose pulses would
    overlap.
    """
    late = 0
    start = timing[ROW_END]
    for i in range(timing[AXES]):
        base = ROW_AXES + ROW_STRIDE * i
        if row[base] and (timing[LOCKED] >> i) & 1 == 0:
            lane = LANE * i
            earliest = lanes[lane + FREE_FRAME]  # frame of the first step
            if (row[ROW_DIRS] >> i) & 1 != lanes[lane + BACKWARDS]:
                change_frame = start >> FRAME_LOG2  # in which the direction changes
                if change_frame > earliest:
                    earliest = change_frame
                earliest += timing[SETUP_FRAMES]
            needed = (earliest << FRAME_LOG2) - start - row[base + 1]
            if needed > late:
                late = needed
    return late


@micropython.viper
def begin_row(frames: ptr32, row: ptr32, timing: ptr32, lanes: ptr32, late: int) -> int:
    """Start a row `late` ticks (see lateness()) after the end of the last one: set up the lanes
    for render(), and change directions in the buffer.

    Ticks and frames count from the start of the buffer that is being filled. A direction changes
    in the first frame in which its axis may step (FREE_FRAME) and the row has begun.
    """
    first_frame = timing[ROW_END] >> FRAME_LOG2  # in which the last row ends, before the delay
    start = timing[ROW_END] + late
    timing[ROW_END] = start + row[ROW_TICKS]
    for i in range(timing[AXES]):
        lane = LANE * i
        base = ROW_AXES + ROW_STRIDE * i
        steps = row[base] if (timing[LOCKED] >> i) & 1 == 0 else 0
        lanes[lane + STEPS_LEFT] = steps
        if steps:
            lanes[lane + NEXT_TICK] = start + row[base + 1]
            if steps > 1:
                span = row[base + 2] - row[base + 1]
                lanes[lane + GAP] = span // (steps - 1)
                # So many gaps are one tick longer: some first ones, and the other last ones.
                longer = span % (steps - 1)
                first_longer = int(leading(steps - 1, lanes[lane + GAP], longer))
                lanes[lane + FIRST_LONGER] = first_longer
                lanes[lane + LAST_LONGER] = longer - first_longer
            if (row[ROW_DIRS] >> i) & 1 != lanes[lane + BACKWARDS]:
                lanes[lane + BACKWARDS] = 1 - lanes[lane + BACKWARDS]
                change_frame = lanes[lane + FREE_FRAME]  # in which the direction changes
                if first_frame > change_frame:
                    change_frame = first_frame
                if change_frame >= FRAMES:  # in a later buffer
                    lanes[lane + CHANGE_DUE] = change_frame + 1  # 0 would mean that none is due
                else:
                    flip = lanes[lane + DIR_BIT]
                    timing[DIR_LEVELS] = timing[DIR_LEVELS] ^ flip
                    for k in range(change_frame, FRAMES):
                        frames[k] = frames[k] ^ flip
    return 0


@micropython.viper
def render(frames: ptr32, timing: ptr32, lanes: ptr32) -> int:
    """Put the row's steps into the buffer, up to its end. Returns 1 if the row is over and the
    buffer has space for another one, else 0."""
    over = 1 if timing[ROW_END] < _BUFFER_TICKS else 0
    pulse = timing[PULSE_FRAMES]
    for i in range(timing[AXES]):
        lane = LANE * i
        bit = lanes[lane + STEP_BIT]
        while lanes[lane + STEPS_LEFT]:
            frame = lanes[lane + NEXT_TICK] >> FRAME_LOG2
            if frame < lanes[lane + FREE_FRAME]:
                frame = lanes[lane + FREE_FRAME]
            if frame < FRAMES and frame + pulse > FRAMES:  # the pulse would cross the end
                frame = FRAMES
                lanes[lane + FREE_FRAME] = FRAMES
            if frame >= FRAMES:  # in the next buffer
                over = 0
                break
            for k in range(frame, frame + pulse):
                frames[k] = frames[k] | bit
            lanes[lane + FREE_FRAME] = frame + pulse + 1  # one frame between two pulses
            lanes[lane + STEPS_LEFT] = lanes[lane + STEPS_LEFT] - 1
            gap = lanes[lane + GAP]
            if lanes[lane + FIRST_LONGER]:  # the longer gaps are the first ones and the last ones
                lanes[lane + FIRST_LONGER] = lanes[lane + FIRST_LONGER] - 1
                gap += 1
            elif lanes[lane + STEPS_LEFT] <= lanes[lane + LAST_LONGER]:
                gap += 1
            lanes[lane + NEXT_TICK] = lanes[lane + NEXT_TICK] + gap
            place = lanes[lane + PLACE]
            lanes[lane + PLACE] = place - 1 if lanes[lane + BACKWARDS] else place + 1
    return over


@micropython.viper
def drop_row(timing: ptr32, lanes: ptr32) -> int:
    """Drop the row in progress: the lanes may step at once. Set DIR_LEVELS, the direction outputs,
    from the lanes."""
    word = 0  # levels of the direction outputs
    timing[ROW_END] = 0
    for i in range(timing[AXES]):
        lane = LANE * i
        lanes[lane + CHANGE_DUE] = 0
        lanes[lane + FREE_FRAME] = 0
        lanes[lane + STEPS_LEFT] = 0
        if lanes[lane + BACKWARDS] != lanes[lane + DIR_INVERT]:
            word |= lanes[lane + DIR_BIT]
    timing[DIR_LEVELS] = word
    return 0


@micropython.viper
def count(frames: ptr32, until: int, timing: ptr32, lanes: ptr32, steps: ptr32) -> int:
    """Add to steps (positions per axis) those in the first `until` frames of a buffer.

    They are counted from its bits: a step is a rising edge of the axis' step output, and the
    direction output in the same frame gives its sign.
    """
    for i in range(timing[AXES]):
        lane = LANE * i
        bit = lanes[lane + STEP_BIT]
        direction = lanes[lane + DIR_BIT]
        invert = lanes[lane + DIR_INVERT]
        place = steps[i]
        previous = 0  # level in the frame before
        for k in range(until):
            level = frames[k] & bit
            if level and previous == 0:  # a rising edge
                dir_level = 1 if frames[k] & direction else 0
                place = place - 1 if dir_level != invert else place + 1
            previous = level
        steps[i] = place
    return 0


@micropython.viper
def find_playing(state: ptr32, now: int, buffer_us: int) -> int:
    """Update PLAYING, the number of the buffer being played, and PLAYING_SINCE, its start, in us.
    Returns for how long it has been played, in us.

    state: see i2s_layout.py. now: us, masked by base/times.py. buffer_us: length of a buffer.
    """
    passed = (now - state[PLAYING_SINCE]) & MASK
    # Below 0: after `now` was read, the timer's turn has moved PLAYING_SINCE past it.
    if passed > NEGATIVE:
        return 0
    while passed >= buffer_us:
        passed -= buffer_us
        state[PLAYING_SINCE] = (state[PLAYING_SINCE] + buffer_us) & MASK
        state[PLAYING] = state[PLAYING] + 1
    return passed


@micropython.viper
def playing_slot(state: ptr32, notes: ptr32, slots: int, size: int) -> int:
    """Return the slot of the buffer being played. While zeros are played, it is the next buffer's
    slot - ZEROS_BEFORE, or NOT_FILLED if there is none: both are negative.

    state: i2s_layout.py; MADE buffers were filled, SENT handed over, and PLAYING is the stream's
    number of the one being played. notes: `size` integers per slot of our ring, which has `slots`.
    Our buffer n has slot n % slots, and its NUMBER is that under which the stream plays it.
    Buffers still in the ring are searched, the oldest first.
    """
    sent = state[SENT]
    oldest = sent - slots + 1  # of those handed over: one slot is for the next buffer
    if oldest < 0:
        oldest = 0
    for n in range(oldest, sent):
        stream_number = notes[(n % slots) * size + NUMBER]
        if stream_number == state[PLAYING]:
            return n % slots
        if stream_number > state[PLAYING]:  # buffer n comes later: zeros are played before it
            return n % slots - ZEROS_BEFORE
    # All have been played: zeros, before the next buffer to be handed over.
    return sent % slots - ZEROS_BEFORE if sent < state[MADE] else NOT_FILLED
