# mypy: disable-error-code=arg-type
"""Pulses: segment rows become words for programs.stepper, integers only.

A word asks a state machine for equally spaced steps; its format and timing are in programs.py.
Times are in ticks of 80 ns. A lane is the state of one axis, a few integers; its words go into a
ring. The words of all lanes fill the same time to the tick: what a lane's words lack to the end of
a segment is its CARRY, and becomes part of its next delay.

    row     up to LONGEST (2**18 ticks); longer ones, up to some 2**27, go through cut_row() first
    delay   2**19 - 1 at most: a row, CARRY and a late start fit
    steps   4095 at most per row and motor

A segment's row (motion/layout.py) has at ROW_TICKS its time, at ROW_DIRS a mask of the motors that
turn backwards, and per motor ROW_STRIDE integers from ROW_AXES on (`base`): its steps, the tick of
the first one and the tick of the last one, counted from the row's start.

The words that convert() makes of a row, for a lane:

    wait          before a reversal only: no steps, delay = TURN_WAIT, at the old level of DIR
    first step    delay = CARRY + late + its tick - _FETCH_TICKS
    n gaps        span = last tick - first tick: gaps of span // n, and span % n of them one
                  longer, ordered by leading(); delay = gap - PULSE - _BETWEEN_TICKS, at least 0
    rest          no steps, until IDLE_CARRY before the end of the segment, if that is longer

CARRY loses what each word takes and gains the row's ticks, so no rounding adds up. A delay has
19 bits: from 2**18 on the word is negative here, so 2**19 is subtracted, with the same bits.

Arguments: lanes, LANE integers per axis; words, the lanes' rings, one after the other; timing, see
set_timing(). Viper; all of it runs in the engine's interrupt. No hardware is accessed here.
"""

import micropython
from micropython import const
from motion.layout import ROW_AXES, ROW_DIRS, ROW_POWER, ROW_STRIDE, ROW_TICKS
from motion.slice_kernel import leading, step_tick

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array


# Lanes: integers per axis, and the index of each among them.
LANE = const(8)  # integers per axis
CARRY = const(0)  # ticks from the end of the lane's words to the next segment; may be negative
DIR = const(1)  # level of the direction output
HEAD = const(2)  # index in the ring of the next word
SENT = const(3)  # index after the last word handed to the hardware
MADE_PLACE = const(4)  # position in steps at the end of all segments made
SENT_PLACE = const(5)  # position in steps at the end of all words sent
STOPPED_PLACE = const(6)  # position in steps where a locked axis has stopped
MACHINE = const(7)  # address of its state machine's registers

# Words in a lane's ring. A segment has six at most: wait before a reversal, first step, long
# gaps, short gaps, long gaps, rest.
RING_LOG2 = const(5)  # a lane's ring has 32 words
RING_MASK = const(31)  # mask of indexes in it

# 21 ms, and pieces of 10.5 ms.
LONGEST = const(0x40000)  # ticks: the longest row that convert() accepts
_PIECE = const(0x20000)  # ticks

# The timing array of convert(): indexes. Times are in ticks.
AXES = const(0)  # number of lanes
PULSE = const(1)  # length of a pulse, up to 2**15 - 1
TURN_WAIT = const(2)  # delay of the word that waits before DIR changes
TURN_DELAY = const(3)  # least delay of the word after the change of DIR
IDLE_CARRY = const(4)  # a lane's words end so long before the segment, if it has no step to make
TIMING_LENGTH = const(5)

# In a row, per motor from the index `base` on: its steps; then, at base + these, two ticks.
_FIRST_TICK = const(1)  # of the first step
_LAST_TICK = const(2)  # of the last

_STEPS_SHIFT = const(1)  # a word's bits 12 to 1: steps; bit 0: direction
_STEPS_MASK = const(0xFFF)
_DELAY_SHIFT = const(13)  # a word's bits 31 to 13: delay
_HALF_DELAY = const(0x40000)  # from here on a delay of 19 bits, shifted, has the sign bit
_ALL_DELAY = const(0x80000)  # a delay less this is the same bits, as a negative integer
# Ticks that programs.stepper takes, where a word's delay is added unless it says otherwise:
_FETCH_TICKS = const(6)  # from ready to the first edge, plus delay; without steps, to ready again
_AFTER_TICKS = const(3)  # from the end of a pulse to ready; no delay is added
_BETWEEN_TICKS = const(9)  # from the end of a pulse to the next edge of the same word, plus delay
_TURN_HELD = const(10)  # from the end of a pulse to the change of DIR; with the waiting word
_TURN_SET = const(5)  # from the change of DIR to the next edge
_SPARE = const(3)  # reserve for gaps that rounding makes shorter than the mean

# Program addresses of programs.stepper, from its start: as there.
_AT_NEXT = const(0)  # the machine waits for a word
_AT_STEP = const(3)  # from this address on X is loaded
_AT_RISEN = const(7)  # from here on STEP has risen, but X still counts this step
_AT_MADE = const(11)  # from here on X no longer counts it


def shortest_gap(pulse: int) -> int:
    """Return the ticks from step to step at the highest rate; pulse: its length in ticks."""
    return pulse + _BETWEEN_TICKS + _SPARE


def set_timing(timing: "array[int]", pulse: int, hold: int, setup: int) -> None:
    """Fill the timing array, except AXES. All in ticks: the length of a pulse; how long DIR must
    keep its level after a pulse (hold), and before the next one (setup)."""
    timing[PULSE] = pulse
    timing[TURN_WAIT] = max(hold - _TURN_HELD, 0)
    timing[TURN_DELAY] = max(setup - _TURN_SET, 0)
    # As long as a reversal takes, so that a reversal after a pause does not delay other axes.
    timing[IDLE_CARRY] = 2 * _FETCH_TICKS + timing[TURN_WAIT] + timing[TURN_DELAY]


@micropython.viper
def _put(words: ptr32, ring: int, head: int, word: int, steps: int) -> int:
    """Add a word with `steps` steps to a lane's ring, unless they are 0. Returns the index after
    it in the ring.

    ring: index in `words` where the lane's ring begins; head: index in the ring of the new word.
    word: its delay and direction, without steps. steps: 0 to 4095.
    """
    if steps == 0:
        return head
    words[ring + head] = word | (steps << _STEPS_SHIFT)
    return (head + 1) & RING_MASK


@micropython.viper
def convert(row: ptr32, lanes: ptr32, words: ptr32, timing: ptr32) -> int:
    """Add a segment's words to the lanes' rings. Returns by how many ticks all axes begin late.

    All wait if one would step or reverse too soon after its last step. HEAD, CARRY, DIR change.
    """
    late = 0
    for i in range(timing[AXES]):
        base = ROW_AXES + ROW_STRIDE * i
        if row[base]:  # lack: ticks by which its first step would be too early
            lack = _FETCH_TICKS - lanes[LANE * i + CARRY] - row[base + _FIRST_TICK]
            if (row[ROW_DIRS] >> i) & 1 != lanes[LANE * i + DIR]:
                lack += _FETCH_TICKS + timing[TURN_WAIT] + timing[TURN_DELAY]
            if lack > late:
                late = lack
    for i in range(timing[AXES]):
        lane = LANE * i
        base = ROW_AXES + ROW_STRIDE * i
        ring = i << RING_LOG2
        head = lanes[lane + HEAD]
        carry = lanes[lane + CARRY] + late
        level = lanes[lane + DIR]
        steps = row[base]
        if steps:
            if (row[ROW_DIRS] >> i) & 1 != level:
                words[ring + head] = level | (timing[TURN_WAIT] << _DELAY_SHIFT)  # wait
                head = (head + 1) & RING_MASK
                carry -= _FETCH_TICKS + timing[TURN_WAIT]
                level = 1 - level
            carry += row[base + _FIRST_TICK] - _FETCH_TICKS
            if carry >= _HALF_DELAY:
                carry -= _ALL_DELAY
            words[ring + head] = level | (1 << _STEPS_SHIFT) | (carry << _DELAY_SHIFT)  # first
            head = (head + 1) & RING_MASK
            carry = 0 - row[base + _FIRST_TICK] - timing[PULSE] - _AFTER_TICKS  # + ROW_TICKS below
            steps -= 1
            if steps:  # gaps: `longer` of them have a tick more, some first, the others last
                span = row[base + _LAST_TICK] - row[base + _FIRST_TICK]
                gap = span // steps
                longer = span - gap * steps
                if gap < timing[PULSE] + _BETWEEN_TICKS:
                    gap = timing[PULSE] + _BETWEEN_TICKS
                    longer = 0
                carry -= gap * steps + longer
                word = level | ((gap - timing[PULSE] - _BETWEEN_TICKS) << _DELAY_SHIFT)
                front = int(leading(steps, gap, longer))  # how many longer gaps come first
                head = int(_put(words, ring, head, word + (1 << _DELAY_SHIFT), front))
                head = int(_put(words, ring, head, word, steps - longer))
                head = int(_put(words, ring, head, word + (1 << _DELAY_SHIFT), longer - front))
        carry += row[ROW_TICKS]
        if carry >= timing[IDLE_CARRY] + _FETCH_TICKS:
            carry -= timing[IDLE_CARRY] + _FETCH_TICKS
            if carry >= _HALF_DELAY:
                carry -= _ALL_DELAY
            words[ring + head] = level | (carry << _DELAY_SHIFT)  # rest
            head = (head + 1) & RING_MASK
            carry = timing[IDLE_CARRY]
        lanes[lane + HEAD] = head
        lanes[lane + CARRY] = carry
        lanes[lane + DIR] = level
    return late


@micropython.viper
def cut_row(row: ptr32, whole: ptr32, begin: int, axes: int) -> int:
    """Fill a row with the piece of a long one (whole) that begins at tick `begin` of that. Returns
    the tick of its end, or 0 for the last piece.

    For rows longer than LONGEST, because a delay does not fit. Pieces have 2**17 ticks, the last
    one less than 2**18. A long row has few steps, so a loop over them is fast enough.
    """
    ticks = whole[ROW_TICKS]
    end = begin + _PIECE
    if end + _PIECE > ticks:
        end = ticks  # this is the last piece
    row[ROW_TICKS] = end - begin
    row[ROW_DIRS] = whole[ROW_DIRS]
    row[ROW_POWER] = whole[ROW_POWER]
    for i in range(axes):
        base = ROW_AXES + ROW_STRIDE * i
        count = 0  # steps in this piece
        for k in range(whole[base]):
            tick = int(step_tick(whole, base, k)) - begin
            if tick >= 0 and (tick < end - begin or end == ticks):
                if count == 0:
                    row[base + _FIRST_TICK] = tick
                row[base + _LAST_TICK] = tick
                count += 1
        row[base] = count
    return end if end < ticks else 0


@micropython.viper
def undone(words: ptr32, axis: int, sent: int, waiting: int, address: int, x: int) -> int:
    """Return the steps that a stopped machine has not made; backward ones are negative.

    words: the lanes' rings; axis: the lane's number. sent: SENT of its lane, the index after the
    last word sent. waiting: words sent that the machine has not fetched. address: where the
    machine is, from the program's start; x: its X register, the steps left of its word, which from
    _AT_RISEN to _AT_MADE still counts a step that is made.
    """
    ring = axis << RING_LOG2
    total = 0
    for k in range(waiting if address == _AT_NEXT else waiting + 1):
        word = words[ring + ((sent - 1 - k) & RING_MASK)]  # the last one sent first
        steps = (word >> _STEPS_SHIFT) & _STEPS_MASK
        if k == waiting and address >= _AT_STEP:  # the word in the machine, and X is loaded
            steps = x
            if address >= _AT_RISEN and address < _AT_MADE:
                steps -= 1
        total += 0 - steps if word & 1 else steps
    return total


@micropython.viper
def places(row: ptr32, tick: int, start: ptr32, steps: ptr32, axes: int) -> int:
    """Compute each axis's position in steps, `tick` ticks after the begin of the segment in row.

    start: the positions at its begin; steps: receives the results. Returns 0.

    The steps made are counted from the first one, or back from the last one where the longer gaps
    at the end begin: the gaps are in the order of leading(), as in convert().
    """
    for i in range(axes):
        base = ROW_AXES + ROW_STRIDE * i
        made = row[base]
        if made == 0 or tick < row[base + _FIRST_TICK]:
            made = 0
        elif tick < row[base + _LAST_TICK]:  # else all are made
            span = row[base + _LAST_TICK] - row[base + _FIRST_TICK]
            gap = span // (made - 1)
            longer = span - gap * (made - 1)
            front = int(leading(made - 1, gap, longer))
            rest = tick - row[base + _FIRST_TICK]  # ticks after the first step
            ticks_to_last = span - rest  # ticks before the last step
            if rest < front * (gap + 1):  # among the longer gaps that come first
                made = rest // (gap + 1) + 1
            elif ticks_to_last <= (longer - front) * (gap + 1):  # among those that come last
                made -= (ticks_to_last + gap) // (gap + 1)
            else:
                made = (rest - front) // gap + 1
        steps[i] = start[i] - made if (row[ROW_DIRS] >> i) & 1 else start[i] + made
    return 0
