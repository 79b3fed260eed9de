# mypy: disable-error-code=arg-type
"""The engine state: all that the PIO engine's interrupt works on, in one array, and its kernels.

It is one array because each argument of a viper call costs 1 us. state_layout.py says what it
holds; engine.py gives an overview. Nothing here allocates.

Segments are numbered from power-up: MADE of them were made, FED handed to the hardware, and BEGUN
is the number of the one being played. Each has a row (motion/layout.py: time, directions, power,
steps per motor), in a ring of ROWS rows. After those, at `begins`, the row has when it begins (us,
half ticks), the value of BEATS when it ends, and each motor's position at its start. BEATS counts
the words handed to the clock, a state machine that interrupts as segments begin. END_US and
END_REST are when all words handed over will have ended.

A lane, one per motor, has LANE integers in `lanes` (pulses.py): HEAD and SENT are indexes in its
ring of words, after the last word made and after the last one handed over; PLACE and END are its
positions in steps at those two places. OURS, OURS + 1 and THIRD are masks of this engine's
machines in PIO 0, 1 and 2; `player` is the registers of one machine. LOCKED is a mask of lanes
that are stopped while others go on. Each kernel returns 0 unless it says otherwise.
"""

import micropython
from base.times import MASK, NEGATIVE
from micropython import const
from motion.layout import (
    KEEP_POWER,
    ROW_AXES,
    ROW_DIRS,
    ROW_POWER,
    ROW_STRIDE,
    ROW_TICKS,
)

from pio import registers as reg
from pio import state_layout as s
from pio.pulses import (
    CARRY,
    DIR,
    END,
    HEAD,
    KEEP,
    LANE,
    LONGEST,
    MACHINE,
    PLACE,
    PULSE,
    RING_MASK,
    SENT,
    convert,
    cut,
)

# Ticks of motion made ahead of the segment that is played; a hold takes that much longer. In a
# long segment the clock interrupts so long before its end.
LEAD = const(40_000)
# Words must be handed over so many us before the last ones end, or they might come too late.
_MARGIN = const(20)

# PIO instructions that are forced into a machine: pull noblock; mov isr, null; set x, 0; in x, 5;
# set pins, 0.
_PULL = const(0x8080)
_CLEAR_ISR = const(0xA0C3)
_SET_X = const(0xE020)  # five bits are added
_SHIFT_IN = const(0x4025)  # shifts them into ISR from below
_STEP_LOW = const(0xE000)

_LEVEL = const(15)  # FLEVEL has 8 bits per machine: the lower four are its TX FIFO's words
_ADDRESS = const(31)  # a program's address has five bits
_TO_US = const(12)  # divides ticks into us: 12.5 of them, rounded down
# A mask of machines times this is a value for CTRL: bits 0 to 3 enable them, bits 8 to 11 restart
# their dividers.
_ENABLE_RESTART = const(0x101)

_CLOCK_INSTR = const(reg.MACHINES + reg.SM * s.CLOCK + reg.INSTR)
_CLOCK_OVERHEAD = const(4)  # ticks of its loop in addition to the count


@micropython.viper
def read_progress(state: ptr32) -> int:
    """Update BEGUN, AHEAD, EARLY and RUNNING from what the hardware has played. Returns the
    spindle power to set, that of the segment begun last, or KEEP_POWER.

    The clock has read `beat` of its words. A row ends with the word whose number is row[ends], so
    EARLY > 0 means that the segment has more words: the clock interrupts again before its end.
    """
    pio = ptr32(state[s.CLOCK_PIO])
    level = (pio[reg.FLEVEL] >> 8 * s.CLOCK) & _LEVEL  # words in the clock's FIFO
    beat = state[s.BEATS] - level
    ends = ROW_AXES + ROW_STRIDE * state[s.AXES] + 2  # index in a row: BEATS when it ends
    row = ptr32(state[s.ROW + (state[s.BEGUN] & s.LAST_ROW)])
    power = KEEP_POWER
    while state[s.BEGUN] < state[s.FED] - 1 and row[ends] < beat:
        state[s.BEGUN] += 1
        row = ptr32(state[s.ROW + (state[s.BEGUN] & s.LAST_ROW)])
        state[s.AHEAD] -= row[ROW_TICKS]
        power = row[ROW_POWER]
    state[s.EARLY] = row[ends] - beat
    if level == 0 and pio[reg.MACHINES + reg.SM * s.CLOCK + reg.ADDR] == state[s.CLOCK_AT]:
        state[s.RUNNING] = 0  # all words have been played
    if power == KEEP_POWER or power == state[s.POWER]:
        return KEEP_POWER
    state[s.POWER] = power
    return power


@micropython.viper
def append(state: ptr32) -> int:
    """Add the segment just made to the rows, or the next piece of a long one; update positions.

    The segment is in row MADE of the ring. If it is too long for the words, it is copied to WHOLE,
    and the row becomes its first piece; further calls add the others (CUT: the tick at which the
    next one begins; 0 after the last).
    """
    axes = state[s.AXES]
    lanes = ptr32(state[s.LANES])
    row = ptr32(state[s.ROW + (state[s.MADE] & s.LAST_ROW)])
    if state[s.CUT] or row[ROW_TICKS] > LONGEST:
        whole = ptr32(state[s.WHOLE])
        if state[s.CUT] == 0:
            for i in range(ROW_AXES + ROW_STRIDE * axes):
                whole[i] = row[i]
        state[s.CUT] = int(cut(row, whole, state[s.CUT], axes))
    start = ROW_AXES + ROW_STRIDE * axes + s.ROW_EXTRA
    for i in range(axes):
        place = lanes[LANE * i + PLACE]  # position in steps
        row[start + i] = place
        steps = row[ROW_AXES + ROW_STRIDE * i]  # without sign
        lanes[LANE * i + PLACE] = place - steps if (row[ROW_DIRS] >> i) & 1 else place + steps
    state[s.AHEAD] += row[ROW_TICKS]
    state[s.MADE] += 1
    return 0


@micropython.viper
def _load(player: ptr32, pulse: int) -> int:
    """Load `pulse` (ticks, up to 15 bits) into a machine's ISR, five bits at a time, because the
    instruction `set` takes no more. player: the machine's registers."""
    player[reg.INSTR] = _CLEAR_ISR
    shift = 15
    while shift:
        shift -= 5
        player[reg.INSTR] = _SET_X | ((pulse >> shift) & 31)
        player[reg.INSTR] = _SHIFT_IN
    return 0


@micropython.viper
def _prepare(state: ptr32) -> int:
    """Restart all machines, which have stopped or run dry, at their start with empty FIFOs.

    DMA knows a FIFO's free space by counting writes and pulls: a forced pull may remove words, as
    the machine itself does, but only DMA may write them. FAULT is JAMMED if DMA does not move on.
    """
    axes = state[s.AXES]
    pio = ptr32(state[s.PIO0])
    clock = ptr32(state[s.CLOCK_PIO])
    other = clock
    if s.RP2350:
        other = ptr32(state[s.PIO1])
    lanes = ptr32(state[s.LANES])
    timing = ptr32(state[s.TIMING])
    timer = ptr32(state[s.TIMER])
    patience = 1000
    while ((timer[0] & MASK) - state[s.END_US]) & MASK <= timing[PULSE] // _TO_US + 1 and patience:
        patience -= 1  # let the last pulses end at their full length
    first = state[s.OURS]
    second = state[s.OURS + 1]
    pio[reg.CTRL + reg.CLEAR] = first
    other[reg.CTRL + reg.CLEAR] = second
    pio[reg.CTRL + reg.SET] = first << 4  # SM_RESTART
    other[reg.CTRL + reg.SET] = second << 4
    if s.RP2350 and state[s.THIRD]:
        clock[reg.CTRL + reg.CLEAR] = state[s.THIRD]
        clock[reg.CTRL + reg.SET] = state[s.THIRD] << 4
    while (clock[reg.FLEVEL] >> 8 * s.CLOCK) & _LEVEL:
        clock[_CLOCK_INSTR] = _PULL
    patience = 1000
    for i in range(axes):
        player = ptr32(lanes[LANE * i + MACHINE])
        pio = ptr32(state[s.PIO0 + (i >> s.BLOCK_LOG2)])
        dma = ptr32(state[s.DMA + i])
        bit = 8 * (i & s.IN_BLOCK)  # the first bit of its level in FLEVEL
        while patience and (dma[reg.STATUS] & state[s.BUSY] or (pio[reg.FLEVEL] >> bit) & _LEVEL):
            player[reg.INSTR] = _PULL
            patience -= 1
    if patience == 0:
        state[s.FAULT] = s.JAMMED
        return 0
    for i in range(axes):
        ptr32(state[s.DMA + i])[reg.READ] = state[s.WORDS] + 4 * (RING_MASK + 1) * i
        lane = LANE * i
        lanes[lane + HEAD] = 0
        lanes[lane + SENT] = 0
        lanes[lane + CARRY] = 0
        player = ptr32(lanes[lane + MACHINE])
        # Read the pin: words that change DIR may never have been played.
        levels = ptr32(state[s.PIO0 + (i >> s.BLOCK_LOG2)])[reg.PADOUT]
        # Bits 0 to 4 of PINCTRL are OUT_BASE, the pin of DIR.
        lanes[lane + DIR] = (levels >> (player[reg.PINCTRL] & 31)) & 1
        _load(player, timing[PULSE] - 3)  # the program adds 3 ticks to ISR
        player[reg.INSTR] = _STEP_LOW
        player[reg.INSTR] = (player[reg.EXECCTRL] >> 7) & _ADDRESS  # jmp to WRAP_BOTTOM, the start
    clock[_CLOCK_INSTR] = state[s.CLOCK_AT] - 1  # jmp to the irq before the clock's pull
    state[s.END_US] = 0  # until _launch() adds the present time
    state[s.END_REST] = 0
    state[s.POWER] = -1  # none reported yet
    return 0


@micropython.viper
def feed(state: ptr32) -> int:
    """Convert waiting segments (from FED to MADE) to words, and hand the words over.

    Only if all lanes' DMA channels have moved their words and the clock's FIFO has space. If the
    machines are stopped, they are prepared first and started at the end. `count` counts the
    clock's words: one per segment, or two for a long one, so that the clock interrupts LEAD before
    its end.
    """
    axes = state[s.AXES]
    space = s.CLOCK_FIFO  # words that the clock can take
    if state[s.RUNNING]:
        # us until the words handed over end, negative if they have ended.
        left = (state[s.END_US] - (ptr32(state[s.TIMER])[0] & MASK)) & MASK
        if left >= NEGATIVE or left < _MARGIN + ptr32(state[s.TIMING])[KEEP] // _TO_US:
            return 0  # too late: all machines are restarted once the last has stopped
        for i in range(axes):
            if (
                ptr32(state[s.DMA + i])[reg.STATUS] & state[s.BUSY]
                and (state[s.LOCKED] >> i) & 1 == 0
            ):
                return 0
        space -= (ptr32(state[s.CLOCK_PIO])[reg.FLEVEL] >> 8 * s.CLOCK) & _LEVEL
        if space == 0:
            return 0
    else:
        _prepare(state)
    clocked = ptr32(state[s.CLOCKED])
    begins = ROW_AXES + ROW_STRIDE * axes
    fed = state[s.FED]
    count = 0
    while fed != state[s.MADE] and count < space:
        row = ptr32(state[s.ROW + (fed & s.LAST_ROW)])
        ticks = row[ROW_TICKS]
        long = ticks >= 2 * LEAD  # it takes two of the clock's words
        if long and count + 1 == space:
            break
        # By how many ticks the segment begins after the end of the one before.
        late = int(convert(row, state[s.LANES], state[s.WORDS], state[s.TIMING]))
        lasts = late + ticks
        clocked[count] = lasts - _CLOCK_OVERHEAD if lasts > _CLOCK_OVERHEAD else 0
        if long:
            clocked[count] -= LEAD
            count += 1
            clocked[count] = LEAD - _CLOCK_OVERHEAD
        rest = state[s.END_REST] + 2 * late  # half ticks since END_US
        row[begins] = (state[s.END_US] + rest // s.HALF_TICKS_PER_US) & MASK
        row[begins + 1] = rest % s.HALF_TICKS_PER_US
        rest += 2 * ticks
        state[s.END_US] = (state[s.END_US] + rest // s.HALF_TICKS_PER_US) & MASK
        state[s.END_REST] = rest % s.HALF_TICKS_PER_US
        count += 1
        row[begins + 2] = state[s.BEATS] + count
        fed += 1
    _start_transfer(state, fed, count)
    return 0


@micropython.viper
def _start_transfer(state: ptr32, fed: int, count: int) -> int:
    """Hand DMA the words of all segments before number `fed`, and the clock `count` words; start
    the machines if they are stopped.

    Interrupts that may stop the engine (RIVALS) are masked meanwhile. If a word was lost, written
    to a full FIFO, nothing is started, and FAULT is LOST.
    """
    axes = state[s.AXES]
    lanes = ptr32(state[s.LANES])
    nvic = ptr32(state[s.NVIC])
    clock = ptr32(state[s.CLOCK_PIO])
    other = clock
    if s.RP2350:
        other = ptr32(state[s.PIO1])
    following = ptr32(state[s.ROW + (fed & s.LAST_ROW)])
    nvic[reg.DISABLE] = state[s.RIVALS]
    over = (ptr32(state[s.PIO0])[reg.FDEBUG] >> reg.TXOVER) & state[s.OURS]
    if s.RP2350 and state[s.THIRD]:
        over |= (clock[reg.FDEBUG] >> reg.TXOVER) & state[s.THIRD]
    if over | (other[reg.FDEBUG] >> reg.TXOVER) & state[s.OURS + 1]:
        state[s.FAULT] = s.LOST
    if state[s.HALT] == 0 and state[s.FAULT] == 0:
        for i in range(axes):
            lane = LANE * i
            if (state[s.LOCKED] >> i) & 1 == 0:
                new = (lanes[lane + HEAD] - lanes[lane + SENT]) & RING_MASK  # words not sent yet
                if new:
                    ptr32(state[s.DMA + i])[reg.COUNT_TRIGGER] = new
                lanes[lane + SENT] = lanes[lane + HEAD]
                # The position at the end of these words is that where the next segment starts.
                place = lanes[lane + PLACE]
                if fed != state[s.MADE]:
                    place = following[ROW_AXES + ROW_STRIDE * axes + s.ROW_EXTRA + i]
                lanes[lane + END] = place
        clocked = ptr32(state[s.CLOCKED])
        for i in range(count):
            clock[reg.TXF + s.CLOCK] = clocked[i]
        state[s.BEATS] += count
        if state[s.RUNNING] == 0:
            _launch(state, fed)
        state[s.FED] = fed
    nvic[0] = state[s.RIVALS]  # enables these interrupts again
    return 0


@micropython.viper
def _launch(state: ptr32, fed: int) -> int:
    """Start all machines within one tick, and add the present time to END_US and to the begins of
    the rows before number `fed`, which were counted from 0."""
    axes = state[s.AXES]
    for i in range(axes):
        pio = ptr32(state[s.PIO0 + (i >> s.BLOCK_LOG2)])
        patience = 100
        while (pio[reg.FLEVEL] >> 8 * (i & s.IN_BLOCK)) & _LEVEL == 0 and patience:
            patience -= 1  # wait for DMA to write the first word
    now = ptr32(state[s.TIMER])[0] & MASK
    first = state[s.OURS] * _ENABLE_RESTART
    second = state[s.OURS + 1] * _ENABLE_RESTART
    pio = ptr32(state[s.PIO0] + 4 * (reg.CTRL + reg.SET))
    clock = ptr32(state[s.CLOCK_PIO] + 4 * (reg.CTRL + reg.SET))
    other = clock
    third = 0
    if s.RP2350:
        other = ptr32(state[s.PIO1] + 4 * (reg.CTRL + reg.SET))
        third = state[s.THIRD] * _ENABLE_RESTART
    # No interrupt can come in between (_start_transfer masks them). The writes compile to nine
    # cycles, a tick has ten; with the third, an RP2350's tick has twelve.
    pio[0] = first
    other[0] = second
    if s.RP2350 and third:
        clock[0] = third
    for k in range(state[s.FED], fed):
        row = ptr32(state[s.ROW + (k & s.LAST_ROW)])
        begins = ROW_AXES + ROW_STRIDE * axes
        row[begins] = (row[begins] + now) & MASK
    state[s.END_US] = (state[s.END_US] + now) & MASK
    state[s.RUNNING] = 1
    return 0
