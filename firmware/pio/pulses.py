# mypy: disable-error-code=arg-type
"""Pulses: from a segment row to the words of programs.stepper, in integers and ticks.

Knows the programs' timing, no hardware. A lane is what is remembered per axis, a few integers;
its words go into a ring. The axes' words always fill the same time, to the tick: what a lane's
words lack to the end of a segment is carried on as part of its next delay.

Called in the engine's interrupt.
"""

import micropython
from micropython import const
from motion.layout import ROW_AXES, ROW_DIRS, ROW_POWER, ROW_STRIDE, ROW_TICKS
from motion.slice_kernel import leading

TYPE_CHECKING = const(False)
if TYPE_CHECKING:
    from array import array


# Lanes: integers per axis.
LANE = const(8)
CARRY = const(0)  # ticks from where the lane's words end to where the next segment begins
DIR = const(1)  # level of the direction output
HEAD = const(2)  # where in the ring the next word goes
SENT = const(3)  # up to where words have been handed to the hardware
PLACE = const(4)  # position at the end of all segments made
END = const(5)  # position at the end of all words sent
FROZEN = const(6)  # position of a locked axis
MACHINE = const(7)  # where the registers of its machine are

# Words a lane's ring holds. A segment takes six at the most: wait before a reversal, first
# step, long gaps, short gaps, long gaps, rest.
RING_LOG2 = const(5)
RING_MASK = const(31)

# The longest row that convert() takes, and the length of the pieces of longer ones, in ticks.
LONGEST = const(0x40000)
_PIECE = const(0x20000)

# Timing: what convert() is told, in ticks.
AXES = const(0)
PULSE = const(1)  # length of a pulse
TURN_WAIT = const(2)  # delay of the word that waits before DIR changes,
TURN_DELAY = const(3)  # and least delay of the word after it
KEEP = const(4)  # a lane with nothing to do waits until so long before the end of its segment
TIMING_LENGTH = const(5)

# A word for programs.stepper, and what it costs.
_STEPS_SHIFT = const(1)
_STEPS_MASK = const(0xFFF)
_DELAY_SHIFT = const(13)
_HALF_DELAY = const(0x40000)
_ALL_DELAY = const(0x80000)
_FETCH = const(6)  # ready to first edge, or to ready where there is none, besides the delay
_AFTER = const(3)  # end of a pulse to ready
_BETWEEN = const(9)  # end of a pulse to the next edge of the same word, besides the delay
_TURN_HELD = const(10)  # end of a pulse to the change of DIR, besides the waiting word's delay
_TURN_SET = const(5)  # change of DIR to the next edge, besides the delay
_SPARE = const(3)  # for gaps that rounding makes shorter than the mean

# Where programs.stepper stands.
_NEXT = const(0)
_STEP = const(3)
_RISEN = const(7)
_MADE = const(11)


def shortest_gap(pulse: int) -> int:
    """Ticks from step to step at the highest rate, with pulses of so many ticks."""
    return pulse + _BETWEEN + _SPARE


def set_timing(timing: "array[int]", pulse: int, hold: int, setup: int) -> None:
    """Take over the pulse's length, and how long DIR is to stay before and after it changes."""
    timing[PULSE] = pulse
    timing[TURN_WAIT] = max(hold - _TURN_HELD, 0)
    timing[TURN_DELAY] = max(setup - _TURN_SET, 0)
    # As long as a reversal takes, so that none has to be waited for after a pause.
    timing[KEEP] = 2 * _FETCH + timing[TURN_WAIT] + timing[TURN_DELAY]


@micropython.viper
def _put(words: ptr32, ring: int, head: int, word: int, steps: int) -> int:
    """Add a word of so many steps, if any, to a lane's ring. Returns where the next one goes."""
    if steps == 0:
        return head
    words[ring + head] = word | (steps << _STEPS_SHIFT)
    return (head + 1) & RING_MASK


@micropython.viper
def convert(row: ptr32, lanes: ptr32, words: ptr32, timing: ptr32) -> int:
    """Add a segment's words to the lanes' rings. Returns by how many ticks all axes begin late.

    They wait where one would reverse or step too soon after its last step."""
    late = 0
    for i in range(timing[AXES]):
        base = ROW_AXES + ROW_STRIDE * i
        if row[base]:
            lack = _FETCH - lanes[LANE * i + CARRY] - row[base + 1]
            if (row[ROW_DIRS] >> i) & 1 != lanes[LANE * i + DIR]:
                lack += _FETCH + timing[TURN_WAIT] + timing[TURN_DELAY]
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
                words[ring + head] = level | (timing[TURN_WAIT] << _DELAY_SHIFT)
                head = (head + 1) & RING_MASK
                carry -= _FETCH + timing[TURN_WAIT]
                level = 1 - level
            carry += row[base + 1] - _FETCH
            if carry >= _HALF_DELAY:
                carry -= _ALL_DELAY  # the same bits in a word, which is signed here
            words[ring + head] = level | (1 << _STEPS_SHIFT) | (carry << _DELAY_SHIFT)
            head = (head + 1) & RING_MASK
            carry = 0 - row[base + 1] - timing[PULSE] - _AFTER
            steps -= 1
            if steps:
                span = row[base + 2] - row[base + 1]
                gap = span // steps
                longer = span - gap * steps
                if gap < timing[PULSE] + _BETWEEN:
                    gap = timing[PULSE] + _BETWEEN
                    longer = 0
                carry -= gap * steps + longer
                word = level | ((gap - timing[PULSE] - _BETWEEN) << _DELAY_SHIFT)
                front = int(leading(steps, gap, longer))
                head = int(_put(words, ring, head, word + (1 << _DELAY_SHIFT), front))
                head = int(_put(words, ring, head, word, steps - longer))
                head = int(_put(words, ring, head, word + (1 << _DELAY_SHIFT), longer - front))
        carry += row[ROW_TICKS]
        if carry >= timing[KEEP] + _FETCH:
            carry -= timing[KEEP] + _FETCH
            if carry >= _HALF_DELAY:
                carry -= _ALL_DELAY
            words[ring + head] = level | (carry << _DELAY_SHIFT)
            head = (head + 1) & RING_MASK
            carry = timing[KEEP]
        lanes[lane + HEAD] = head
        lanes[lane + CARRY] = carry
        lanes[lane + DIR] = level
    return late


@micropython.viper
def cut(row: ptr32, whole: ptr32, begin: int, axes: int) -> int:
    """Fill a row with a piece of a long one, from tick `begin`. Returns its end, 0 at the last.

    For rows that last longer than a word can wait: their steps are few.
    """
    ticks = whole[ROW_TICKS]
    end = begin + _PIECE
    if end + _PIECE > ticks:
        end = ticks
    row[ROW_TICKS] = end - begin
    row[ROW_DIRS] = whole[ROW_DIRS]
    row[ROW_POWER] = whole[ROW_POWER]
    for i in range(axes):
        base = ROW_AXES + ROW_STRIDE * i
        steps = whole[base]
        span = whole[base + 2] - whole[base + 1]
        gap = span // (steps - 1) if steps > 1 else 0
        longer = span - gap * (steps - 1)
        front = int(leading(steps - 1, gap, longer))
        tick = whole[base + 1] - begin
        count = 0
        for k in range(steps):
            if tick >= 0 and (tick < end - begin or end == ticks):
                if count == 0:
                    row[base + 1] = tick
                row[base + 2] = tick
                count += 1
            tick += gap + 1 if k < front or k >= steps - 1 - longer + front else gap
        row[base] = count
    return end if end < ticks else 0


@micropython.viper
def undone(words: ptr32, axis: int, sent: int, waiting: int, at: int, x: int) -> int:
    """Steps, backward ones negative, that a machine stopped in the middle has not made.

    waiting: words sent that it has not fetched; at, x: where it stands and its X register.
    """
    ring = axis << RING_LOG2
    total = 0
    for k in range(waiting if at == _NEXT else waiting + 1):
        word = words[ring + ((sent - 1 - k) & RING_MASK)]
        steps = (word >> _STEPS_SHIFT) & _STEPS_MASK
        if k == waiting and at >= _STEP:
            steps = x
            if at >= _RISEN and at < _MADE:
                steps -= 1
        total += 0 - steps if word & 1 else steps
    return total


@micropython.viper
def places(row: ptr32, tick: int, start: ptr32, steps: ptr32, axes: int) -> int:
    """Positions `tick` ticks into a segment that begins at the positions start."""
    for i in range(axes):
        base = ROW_AXES + ROW_STRIDE * i
        made = row[base]
        if made == 0 or tick < row[base + 1]:
            made = 0
        elif tick < row[base + 2]:
            span = row[base + 2] - row[base + 1]
            gap = span // (made - 1)
            longer = span - gap * (made - 1)
            front = int(leading(made - 1, gap, longer))
            rest = tick - row[base + 1]
            behind = span - rest  # before the last step
            if rest < front * (gap + 1):
                made = rest // (gap + 1) + 1
            elif behind <= (longer - front) * (gap + 1):
                made -= (behind + gap) // (gap + 1)
            else:
                made = (rest - front) // gap + 1
        steps[i] = start[i] - made if (row[ROW_DIRS] >> i) & 1 else start[i] + made
    return 0
