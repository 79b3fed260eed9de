# mypy: disable-error-code=arg-type
"""The engine state: all that the PIO engine's interrupt works on, in one array, and its kernels.

It is one array because each argument of a viper call costs 1 us. hub_layout.py says what it holds;
engine.py gives an overview. Nothing here allocates.
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

from pio.hub_layout import (
    AHEAD,
    AXES,
    BEATS,
    BEGUN,
    BLOCK_LOG2,
    BUSY,
    CLOCK,
    CLOCK_AT,
    CLOCK_FIFO,
    CLOCK_PIO,
    CLOCKED,
    CUT,
    DMA,
    EARLY,
    END_REST,
    END_US,
    FAULT,
    FED,
    HALF_TICKS_PER_US,
    HALT,
    IN_BLOCK,
    JAMMED,
    LANES,
    LAST_ROW,
    LOCKED,
    LOST,
    MADE,
    NVIC,
    OURS,
    PIO0,
    PIO1,
    POWER,
    RIVALS,
    ROW,
    ROW_EXTRA,
    RP2350,
    RUNNING,
    THIRD,
    TIMER,
    TIMING,
    WHOLE,
    WORDS,
)
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
from pio.registers import (
    ADDR,
    CLEAR,
    COUNT_TRIGGER,
    CTRL,
    DISABLE,
    EXECCTRL,
    FDEBUG,
    FLEVEL,
    INSTR,
    MACHINES,
    PADOUT,
    PINCTRL,
    READ,
    SET,
    SM,
    STATUS,
    TXF,
    TXOVER,
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

_CLOCK_INSTR = const(MACHINES + SM * CLOCK + INSTR)
_CLOCK_OVERHEAD = const(4)  # ticks of its loop in addition to the count


@micropython.viper
def read_progress(state: ptr32) -> int:
    """Update the state from what the hardware has played. Returns the power to set, or
    KEEP_POWER."""
    pio = ptr32(state[CLOCK_PIO])
    level = (pio[FLEVEL] >> 8 * CLOCK) & 15
    beat = state[BEATS] - level
    ends = ROW_AXES + ROW_STRIDE * state[AXES] + 2
    row = ptr32(state[ROW + (state[BEGUN] & LAST_ROW)])
    power = KEEP_POWER
    while state[BEGUN] < state[FED] - 1 and row[ends] < beat:
        state[BEGUN] += 1
        row = ptr32(state[ROW + (state[BEGUN] & LAST_ROW)])
        state[AHEAD] -= row[ROW_TICKS]
        power = row[ROW_POWER]
    state[EARLY] = row[ends] - beat
    if level == 0 and pio[MACHINES + SM * CLOCK + ADDR] == state[CLOCK_AT]:
        state[RUNNING] = 0  # all words have been played
    if power == KEEP_POWER or power == state[POWER]:
        return KEEP_POWER
    state[POWER] = power
    return power


@micropython.viper
def append(state: ptr32) -> int:
    """Add the segment just made to the rows, or the next piece of a long one; update positions."""
    axes = state[AXES]
    lanes = ptr32(state[LANES])
    row = ptr32(state[ROW + (state[MADE] & LAST_ROW)])
    if state[CUT] or row[ROW_TICKS] > LONGEST:
        whole = ptr32(state[WHOLE])
        if state[CUT] == 0:
            for i in range(ROW_AXES + ROW_STRIDE * axes):
                whole[i] = row[i]
        state[CUT] = int(cut(row, whole, state[CUT], axes))
    start = ROW_AXES + ROW_STRIDE * axes + ROW_EXTRA
    for i in range(axes):
        place = lanes[LANE * i + PLACE]
        row[start + i] = place
        steps = row[ROW_AXES + ROW_STRIDE * i]
        lanes[LANE * i + PLACE] = place - steps if (row[ROW_DIRS] >> i) & 1 else place + steps
    state[AHEAD] += row[ROW_TICKS]
    state[MADE] += 1
    return 0


@micropython.viper
def _load(player: ptr32, pulse: int) -> int:
    """Load the length of a pulse (15 bits) into a machine's ISR, five bits at a time."""
    player[INSTR] = _CLEAR_ISR
    shift = 15
    while shift:
        shift -= 5
        player[INSTR] = _SET_X | ((pulse >> shift) & 31)
        player[INSTR] = _SHIFT_IN
    return 0


@micropython.viper
def _prepare(state: ptr32) -> int:
    """Restart all machines, which have stopped or run dry, at the start of their programs, with
    empty FIFOs.

    DMA knows the free space of a machine's FIFO only by counting writes and pulls. So words may be
    removed by a forced pull, as the machine itself does, but only DMA may write words.
    """
    axes = state[AXES]
    pio = ptr32(state[PIO0])
    clock = ptr32(state[CLOCK_PIO])
    other = clock
    if RP2350:
        other = ptr32(state[PIO1])
    lanes = ptr32(state[LANES])
    timing = ptr32(state[TIMING])
    timer = ptr32(state[TIMER])
    patience = 1000
    while ((timer[0] & MASK) - state[END_US]) & MASK <= timing[PULSE] // 12 + 1 and patience:
        patience -= 1  # let the last pulses end at their full length
    first = state[OURS]
    second = state[OURS + 1]
    pio[CTRL + CLEAR] = first
    other[CTRL + CLEAR] = second
    pio[CTRL + SET] = first << 4  # SM_RESTART
    other[CTRL + SET] = second << 4
    if RP2350 and state[THIRD]:
        clock[CTRL + CLEAR] = state[THIRD]
        clock[CTRL + SET] = state[THIRD] << 4
    while (clock[FLEVEL] >> 8 * CLOCK) & 15:
        clock[_CLOCK_INSTR] = _PULL
    patience = 1000
    for i in range(axes):
        player = ptr32(lanes[LANE * i + MACHINE])
        pio = ptr32(state[PIO0 + (i >> BLOCK_LOG2)])
        dma = ptr32(state[DMA + i])
        while (dma[STATUS] & state[BUSY] or (pio[FLEVEL] >> 8 * (i & IN_BLOCK)) & 15) and patience:
            player[INSTR] = _PULL
            patience -= 1
    if patience == 0:
        state[FAULT] = JAMMED
        return 0
    for i in range(axes):
        ptr32(state[DMA + i])[READ] = state[WORDS] + 4 * (RING_MASK + 1) * i
        lane = LANE * i
        lanes[lane + HEAD] = 0
        lanes[lane + SENT] = 0
        lanes[lane + CARRY] = 0
        player = ptr32(lanes[lane + MACHINE])
        # Read the pin: words that change DIR may never have been played.
        levels = ptr32(state[PIO0 + (i >> BLOCK_LOG2)])[PADOUT]
        # Bits 0 to 4 of PINCTRL are OUT_BASE, the pin of DIR.
        lanes[lane + DIR] = (levels >> (player[PINCTRL] & 31)) & 1
        _load(player, timing[PULSE] - 3)  # the program adds 3 ticks to ISR
        player[INSTR] = _STEP_LOW
        player[INSTR] = (player[EXECCTRL] >> 7) & 31  # jmp to the program's start (WRAP_BOTTOM)
    clock[_CLOCK_INSTR] = state[CLOCK_AT] - 1  # jmp to the irq before the clock's pull
    state[END_US] = 0
    state[END_REST] = 0
    state[POWER] = -1
    return 0


@micropython.viper
def feed(state: ptr32) -> int:
    """Convert waiting segments to words, if the hardware has space, and hand the words over."""
    axes = state[AXES]
    space = CLOCK_FIFO
    if state[RUNNING]:
        left = (state[END_US] - (ptr32(state[TIMER])[0] & MASK)) & MASK
        if left >= NEGATIVE or left < _MARGIN + ptr32(state[TIMING])[KEEP] // 12:
            return 0  # too late: all machines are restarted once the last has stopped
        for i in range(axes):
            if ptr32(state[DMA + i])[STATUS] & state[BUSY] and (state[LOCKED] >> i) & 1 == 0:
                return 0
        space -= (ptr32(state[CLOCK_PIO])[FLEVEL] >> 8 * CLOCK) & 15
        if space == 0:
            return 0
    else:
        _prepare(state)
    clocked = ptr32(state[CLOCKED])
    begins = ROW_AXES + ROW_STRIDE * axes
    fed = state[FED]
    count = 0
    while fed != state[MADE] and count < space:
        row = ptr32(state[ROW + (fed & LAST_ROW)])
        ticks = row[ROW_TICKS]
        long = ticks >= 2 * LEAD
        if long and count + 1 == space:
            break
        late = int(convert(row, state[LANES], state[WORDS], state[TIMING]))
        lasts = late + ticks
        clocked[count] = lasts - _CLOCK_OVERHEAD if lasts > _CLOCK_OVERHEAD else 0
        if long:
            clocked[count] -= LEAD
            count += 1
            clocked[count] = LEAD - _CLOCK_OVERHEAD
        rest = state[END_REST] + 2 * late
        row[begins] = (state[END_US] + rest // HALF_TICKS_PER_US) & MASK
        row[begins + 1] = rest % HALF_TICKS_PER_US
        rest += 2 * ticks
        state[END_US] = (state[END_US] + rest // HALF_TICKS_PER_US) & MASK
        state[END_REST] = rest % HALF_TICKS_PER_US
        count += 1
        row[begins + 2] = state[BEATS] + count
        fed += 1
    _start_transfer(state, fed, count)
    return 0


@micropython.viper
def _start_transfer(state: ptr32, fed: int, count: int) -> int:
    """Hand DMA the words up to segment `fed`, and the clock `count` words; start the machines if
    they are stopped.

    Interrupts that may stop the engine are masked meanwhile. If a word was lost, nothing is
    started.
    """
    axes = state[AXES]
    lanes = ptr32(state[LANES])
    nvic = ptr32(state[NVIC])
    clock = ptr32(state[CLOCK_PIO])
    other = clock
    if RP2350:
        other = ptr32(state[PIO1])
    following = ptr32(state[ROW + (fed & LAST_ROW)])
    nvic[DISABLE] = state[RIVALS]
    over = (ptr32(state[PIO0])[FDEBUG] >> TXOVER) & state[OURS]
    if RP2350 and state[THIRD]:
        over |= (clock[FDEBUG] >> TXOVER) & state[THIRD]
    if over | (other[FDEBUG] >> TXOVER) & state[OURS + 1]:
        state[FAULT] = LOST
    if state[HALT] == 0 and state[FAULT] == 0:
        for i in range(axes):
            lane = LANE * i
            if (state[LOCKED] >> i) & 1 == 0:
                new = (lanes[lane + HEAD] - lanes[lane + SENT]) & RING_MASK
                if new:
                    ptr32(state[DMA + i])[COUNT_TRIGGER] = new
                lanes[lane + SENT] = lanes[lane + HEAD]
                place = lanes[lane + PLACE]
                if fed != state[MADE]:
                    place = following[ROW_AXES + ROW_STRIDE * axes + ROW_EXTRA + i]
                lanes[lane + END] = place
        clocked = ptr32(state[CLOCKED])
        for i in range(count):
            clock[TXF + CLOCK] = clocked[i]
        state[BEATS] += count
        if state[RUNNING] == 0:
            _launch(state, fed)
        state[FED] = fed
    nvic[0] = state[RIVALS]
    return 0


@micropython.viper
def _launch(state: ptr32, fed: int) -> int:
    """Start all machines within one tick, and add the present time to the times of rows, which
    were counted from 0."""
    axes = state[AXES]
    for i in range(axes):
        pio = ptr32(state[PIO0 + (i >> BLOCK_LOG2)])
        patience = 100
        while (pio[FLEVEL] >> 8 * (i & IN_BLOCK)) & 15 == 0 and patience:
            patience -= 1  # wait for DMA to write the first word
    now = ptr32(state[TIMER])[0] & MASK
    first = state[OURS] * 0x101  # bits 0 to 3 enable, bits 8 to 11 restart the divider
    second = state[OURS + 1] * 0x101
    pio = ptr32(state[PIO0] + 4 * (CTRL + SET))
    clock = ptr32(state[CLOCK_PIO] + 4 * (CTRL + SET))
    other = clock
    third = 0
    if RP2350:
        other = ptr32(state[PIO1] + 4 * (CTRL + SET))
        third = state[THIRD] * 0x101
    # No interrupt can come in between (_start_transfer masks them). The writes compile to nine
    # cycles, a tick has ten; with the third, an RP2350's tick has twelve.
    pio[0] = first
    other[0] = second
    if RP2350 and third:
        clock[0] = third
    for k in range(state[FED], fed):
        row = ptr32(state[ROW + (k & LAST_ROW)])
        begins = ROW_AXES + ROW_STRIDE * axes
        row[begins] = (row[begins] + now) & MASK
    state[END_US] = (state[END_US] + now) & MASK
    state[RUNNING] = 1
    return 0
