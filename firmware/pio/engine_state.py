# mypy: disable-error-code=arg-type
"""The engine state: all that the PIO engine's interrupt works on, in one array, and its kernels.

It is one array because each argument of a viper call costs 1 us. state_layout.py says what it
holds; engine.py gives an overview. Nothing here allocates.

Segments are numbered from power-up: MADE of them were made, FED handed to the hardware, and BEGUN
is the number of the one being played. Each has a row (motion/layout.py: time, directions, power,
steps per motor), in a ring of ROWS rows. After those, at `begins`, the row has when it begins (us,
half ticks), the value of CLOCK_WORDS when it ends, and each motor's position at its start.
CLOCK_WORDS counts the words handed to the clock, a state machine that interrupts at each of its
words: as a segment begins, in a long one once more. WORDS_TO_END of them are left of BEGUN. A
clock without words waits at CLOCK_PULL_AT. END_US and END_REST (half ticks) are when all words
handed over will have ended. TICKS_AHEAD is the motion made after the begin of BEGUN, in ticks;
POWER the last spindle power reported. RUNNING: the machines are enabled. HALT is 1 after a stop.

A lane, one per motor, has LANE integers in `lanes` (pulses.py): HEAD and SENT are indexes in its
ring of words, after the last word made and after the last one handed over; MADE_PLACE and
SENT_PLACE are its positions in steps at those two places. OURS_0, OURS_1 and OURS_2 are masks of
this engine's machines in PIO 0, 1 and 2 (an RP2350's; 0 if unused); `player` is the registers of
one machine. LOCKED is a mask of lanes that are stopped while others go on. A register at + CLEAR
or + SET is an alias: its ones clear or set bits. A tick is 80 ns: HALF_TICKS_PER_US is 25. Each
kernel returns 0 unless it says otherwise.
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
    HEAD,
    IDLE_CARRY,
    LANE,
    LONGEST,
    MACHINE,
    MADE_PLACE,
    PULSE,
    RING_MASK,
    SENT,
    SENT_PLACE,
    convert,
    cut_row,
)

# Motion is made so far ahead of the segment that is played; a hold takes that much longer.
LEAD = const(40_000)  # ticks; also: the clock interrupts so long before a long segment ends
_MARGIN_US = const(20)  # before the last words end; with less, new ones might come too late

# PIO instructions that are forced into a machine.
_PULL = const(0x8080)  # pull noblock
_CLEAR_ISR = const(0xA0C3)  # mov isr, null
_SET_X = const(0xE020)  # set x, 0; five bits are added
_SHIFT_IN = const(0x4025)  # in x, 5: shifts them into ISR from below
_STEP_LOW = const(0xE000)  # set pins, 0

_TX_LEVEL = const(15)  # FLEVEL has 8 bits per machine: the lower four are its TX FIFO's words
_ADDRESS = const(31)  # a program's address has five bits
_TO_US = const(12)  # divides ticks into us: 12.5 of them, rounded down
_ENABLE_RESTART = const(0x101)  # times a mask, for CTRL: enables machines, restarts dividers

_CLOCK_INSTR = const(reg.MACHINES + reg.MACHINE_STRIDE * s.CLOCK + reg.INSTR)
_CLOCK_ADDR = const(reg.MACHINES + reg.MACHINE_STRIDE * s.CLOCK + reg.ADDR)
_CLOCK_OVERHEAD = const(4)  # ticks of its loop in addition to the count


@micropython.viper
def read_progress(state: ptr32) -> int:
    """Update BEGUN, TICKS_AHEAD, WORDS_TO_END and RUNNING from what the hardware has played.
    Returns the spindle power to set, that of the segment begun last, or KEEP_POWER.

    The clock has read words_read of its words. A row's last word is number row[ends], from 1 on.
    WORDS_TO_END > 0 means that the clock interrupts again before the segment's end.
    """
    pio = ptr32(state[s.CLOCK_PIO])
    waiting = (pio[reg.FLEVEL] >> 8 * s.CLOCK) & _TX_LEVEL  # words in the clock's FIFO
    words_read = state[s.CLOCK_WORDS] - waiting
    ends = ROW_AXES + ROW_STRIDE * state[s.AXES] + 2  # index in a row: CLOCK_WORDS when it ends
    row = ptr32(state[s.ROW + (state[s.BEGUN] & s.LAST_ROW)])
    power = KEEP_POWER
    while state[s.BEGUN] < state[s.FED] - 1 and row[ends] < words_read:
        state[s.BEGUN] += 1
        row = ptr32(state[s.ROW + (state[s.BEGUN] & s.LAST_ROW)])
        state[s.TICKS_AHEAD] -= row[ROW_TICKS]
        power = row[ROW_POWER]
    state[s.WORDS_TO_END] = row[ends] - words_read
    if waiting == 0 and pio[_CLOCK_ADDR] == state[s.CLOCK_PULL_AT]:
        state[s.RUNNING] = 0  # all words have been played
    if power == KEEP_POWER or power == state[s.POWER]:  # no segment has begun, or no change
        return KEEP_POWER
    state[s.POWER] = power
    return power


@micropython.viper
def append(state: ptr32) -> int:
    """Add the segment just made to the rows, or the next piece of a long one; update positions.

    The segment is in row MADE of the ring. If it is too long for the words, it is copied to
    LONG_ROW, and the row becomes its first piece; further calls add the others (NEXT_PIECE: the
    tick at which the next one begins; 0 after the last, and if no long one is in progress).
    """
    axes = state[s.AXES]
    lanes = ptr32(state[s.LANES])
    row = ptr32(state[s.ROW + (state[s.MADE] & s.LAST_ROW)])
    if state[s.NEXT_PIECE] or row[ROW_TICKS] > LONGEST:
        whole = ptr32(state[s.LONG_ROW])
        if state[s.NEXT_PIECE] == 0:  # its first piece
            for i in range(ROW_AXES + ROW_STRIDE * axes):
                whole[i] = row[i]
        state[s.NEXT_PIECE] = int(cut_row(row, whole, state[s.NEXT_PIECE], axes))
    start = ROW_AXES + ROW_STRIDE * axes + s.ROW_EXTRA  # index of the start positions in the row
    for i in range(axes):
        place = lanes[LANE * i + MADE_PLACE]  # position in steps
        row[start + i] = place
        steps = row[ROW_AXES + ROW_STRIDE * i]  # without sign
        lanes[LANE * i + MADE_PLACE] = place - steps if (row[ROW_DIRS] >> i) & 1 else place + steps
    state[s.TICKS_AHEAD] += row[ROW_TICKS]
    state[s.MADE] += 1
    return 0


@micropython.viper
def _load_isr(player: ptr32, pulse: int) -> int:
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
    """Reset all machines, which have stopped or run dry, and their lanes, ready for _launch().

    DMA knows a FIFO's free space by counting writes and pulls: a forced pull may remove words, as
    the machine itself does, but only DMA may write them. FAULT is JAMMED if DMA does not move on.
    """
    axes = state[s.AXES]
    pio = ptr32(state[s.PIO0])
    clock = ptr32(state[s.CLOCK_PIO])
    pio_1 = clock
    if s.RP2350:  # there the clock may be on PIO 2
        pio_1 = ptr32(state[s.PIO1])
    lanes = ptr32(state[s.LANES])
    timing = ptr32(state[s.TIMING])
    timer = ptr32(state[s.TIMER])
    patience = 1000  # readings, here and below: no loop waits forever for broken hardware
    pulse_us = timing[PULSE] // _TO_US + 1  # let the last pulses end at their full length
    while ((timer[0] & MASK) - state[s.END_US]) & MASK <= pulse_us and patience:
        patience -= 1
    pio[reg.CTRL + reg.CLEAR] = state[s.OURS_0]  # disables them
    pio_1[reg.CTRL + reg.CLEAR] = state[s.OURS_1]
    pio[reg.CTRL + reg.SET] = state[s.OURS_0] << 4  # SM_RESTART
    pio_1[reg.CTRL + reg.SET] = state[s.OURS_1] << 4
    if s.RP2350 and state[s.OURS_2]:
        clock[reg.CTRL + reg.CLEAR] = state[s.OURS_2]
        clock[reg.CTRL + reg.SET] = state[s.OURS_2] << 4
    while (clock[reg.FLEVEL] >> 8 * s.CLOCK) & _TX_LEVEL:
        clock[_CLOCK_INSTR] = _PULL  # empty the clock's FIFO, then those of the lanes
    patience = 1000
    busy = state[s.BUSY]  # mask of STATUS: the channel has words to move
    for i in range(axes):
        player = ptr32(lanes[LANE * i + MACHINE])
        pio = ptr32(state[s.PIO0 + (i >> s.BLOCK_LOG2)])  # a PIO has four lanes
        dma = ptr32(state[s.DMA + i])
        bit = 8 * (i & s.IN_BLOCK)  # the first bit of its level in FLEVEL
        while patience and (dma[reg.STATUS] & busy or (pio[reg.FLEVEL] >> bit) & _TX_LEVEL):
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
        # Read DIR's pin, OUT_BASE in PINCTRL: words that change it may never have been played.
        levels = ptr32(state[s.PIO0 + (i >> s.BLOCK_LOG2)])[reg.PADOUT]
        lanes[lane + DIR] = (levels >> (player[reg.PINCTRL] & 31)) & 1
        _load_isr(player, timing[PULSE] - 3)  # the program adds 3 ticks to ISR
        player[reg.INSTR] = _STEP_LOW
        player[reg.INSTR] = (player[reg.EXECCTRL] >> 7) & _ADDRESS  # jmp to WRAP_BOTTOM, the start
    clock[_CLOCK_INSTR] = state[s.CLOCK_PULL_AT] - 1  # jmp to the irq before the clock's pull
    state[s.END_US] = 0  # until _launch() adds the present time
    state[s.END_REST] = 0
    state[s.POWER] = -1  # none reported yet
    return 0


@micropython.viper
def feed_lanes(state: ptr32) -> int:
    """Convert waiting segments (from FED to MADE) to words, and hand the words over.

    While the machines run, only if all lanes' DMA channels have moved their words and the clock's
    FIFO has space. If they are stopped, they are prepared first and started at the end. `count`
    counts the clock's words: one per segment, or two for a long one, so that the clock interrupts
    LEAD before its end.
    """
    axes = state[s.AXES]
    space = s.CLOCK_FIFO  # words that the clock can take
    if state[s.RUNNING]:
        # us until the words handed over end, negative if they have ended.
        us_left = (state[s.END_US] - (ptr32(state[s.TIMER])[0] & MASK)) & MASK
        # A lane without steps needs its next word IDLE_CARRY (ticks) earlier than the others.
        least_us = _MARGIN_US + ptr32(state[s.TIMING])[IDLE_CARRY] // _TO_US
        if us_left >= NEGATIVE or us_left < least_us:
            return 0  # too late: all machines are restarted once the last has stopped
        for i in range(axes):
            if (
                ptr32(state[s.DMA + i])[reg.STATUS] & state[s.BUSY]
                and (state[s.LOCKED] >> i) & 1 == 0  # a locked lane never moves its words
            ):
                return 0
        space -= (ptr32(state[s.CLOCK_PIO])[reg.FLEVEL] >> 8 * s.CLOCK) & _TX_LEVEL
        if space == 0:
            return 0
    else:
        _prepare(state)
    clocked = ptr32(state[s.CLOCK_BUFFER])
    begins = ROW_AXES + ROW_STRIDE * axes  # index in a row: see above
    fed = state[s.FED]
    count = 0
    while fed != state[s.MADE] and count < space:
        row = ptr32(state[s.ROW + (fed & s.LAST_ROW)])
        ticks = row[ROW_TICKS]
        long = ticks >= 2 * LEAD  # it takes two of the clock's words
        if long and count + 1 == space:
            break
        # By how many ticks the segment begins after the end of the one before: mostly 0.
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
        row[begins + 2] = state[s.CLOCK_WORDS] + count
        fed += 1
    _start_transfer(state, fed, count)
    return 0


@micropython.viper
def _start_transfer(state: ptr32, fed: int, count: int) -> int:
    """Hand DMA the words of all segments before number `fed`, and the clock `count` words; start
    the machines if they are stopped.

    Interrupts that may stop the engine (MASKED_IRQS) are masked meanwhile. Nothing is handed over
    after a stop or a fault. If a word was lost, written to a full FIFO, FAULT is LOST.
    """
    axes = state[s.AXES]
    lanes = ptr32(state[s.LANES])
    nvic = ptr32(state[s.NVIC])
    clock = ptr32(state[s.CLOCK_PIO])
    pio_1 = clock
    if s.RP2350:  # there the clock may be on PIO 2
        pio_1 = ptr32(state[s.PIO1])
    following = ptr32(state[s.ROW + (fed & s.LAST_ROW)])
    nvic[reg.DISABLE] = state[s.MASKED_IRQS]
    lost = (ptr32(state[s.PIO0])[reg.FDEBUG] >> reg.TXOVER) & state[s.OURS_0]
    if s.RP2350 and state[s.OURS_2]:
        lost |= (clock[reg.FDEBUG] >> reg.TXOVER) & state[s.OURS_2]
    if lost | (pio_1[reg.FDEBUG] >> reg.TXOVER) & state[s.OURS_1]:
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
                place = lanes[lane + MADE_PLACE]
                if fed != state[s.MADE]:
                    place = following[ROW_AXES + ROW_STRIDE * axes + s.ROW_EXTRA + i]
                lanes[lane + SENT_PLACE] = place
        clocked = ptr32(state[s.CLOCK_BUFFER])
        for i in range(count):
            clock[reg.TXF + s.CLOCK] = clocked[i]
        state[s.CLOCK_WORDS] += count
        if state[s.RUNNING] == 0:
            _launch(state, fed)
        state[s.FED] = fed
    nvic[0] = state[s.MASKED_IRQS]  # enables these interrupts again
    return 0


@micropython.viper
def _launch(state: ptr32, fed: int) -> int:
    """Start all machines within one tick, and add the present time to END_US and to the begins of
    the segments from FED up to `fed`, which feed_lanes() has counted from 0."""
    axes = state[s.AXES]
    for i in range(axes):
        pio = ptr32(state[s.PIO0 + (i >> s.BLOCK_LOG2)])
        patience = 100  # readings: a locked lane has no words
        while (pio[reg.FLEVEL] >> 8 * (i & s.IN_BLOCK)) & _TX_LEVEL == 0 and patience:
            patience -= 1  # wait for DMA to write the first word
    now = ptr32(state[s.TIMER])[0] & MASK
    bits_0 = state[s.OURS_0] * _ENABLE_RESTART
    bits_1 = state[s.OURS_1] * _ENABLE_RESTART
    pio = ptr32(state[s.PIO0] + 4 * (reg.CTRL + reg.SET))
    clock = ptr32(state[s.CLOCK_PIO] + 4 * (reg.CTRL + reg.SET))
    pio_1 = clock
    bits_2 = 0
    if s.RP2350:  # there the clock may be on PIO 2
        pio_1 = ptr32(state[s.PIO1] + 4 * (reg.CTRL + reg.SET))
        bits_2 = state[s.OURS_2] * _ENABLE_RESTART
    # No interrupt can come in between (_start_transfer masks them). The writes compile to nine
    # cycles, a tick has ten; with the third, an RP2350's tick has twelve.
    pio[0] = bits_0
    pio_1[0] = bits_1
    if s.RP2350 and bits_2:
        clock[0] = bits_2
    for k in range(state[s.FED], fed):
        row = ptr32(state[s.ROW + (k & s.LAST_ROW)])
        begins = ROW_AXES + ROW_STRIDE * axes
        row[begins] = (row[begins] + now) & MASK
    state[s.END_US] = (state[s.END_US] + now) & MASK
    state[s.RUNNING] = 1
    return 0
