# mypy: disable-error-code=operator
"""Refill: the PIO engine's interrupt, the path without errors (engine.py).

`state` is the engine state (state_layout.py). Segments are counted from power-up: MADE of them
were made, FED handed to the hardware. TICKS_AHEAD is how many ticks of motion were made after the
begin of the segment being played. RUNNING: the state machines are enabled. NEXT_PIECE is not 0
while a long segment is made in pieces. HALT is 1 after a stop. WORDS_TO_END is how many words the
clock, a state machine that interrupts at each of its words, has left of the segment being played.
ROW is the first of the addresses of the rows, a ring; LAST_ROW is the mask of its indexes.
"""

import micropython
from micropython import const
from motion.layout import KEEP_POWER

from pio.engine_state import LEAD, append, feed_lanes, read_progress
from pio.state_layout import (
    FED,
    HALT,
    LAST_ROW,
    MADE,
    NEXT_PIECE,
    ROW,
    RUNNING,
    TICKS_AHEAD,
    WORDS_TO_END,
)

_MOST_PER_CALL = const(2)  # segments made in one interrupt, at most
_MOST_WAITING = const(10)  # rows made, not fed; position() may still read the other 6 of the ring


@micropython.viper
def refill(state: ptr32, next_segment: object, on_power: object, on_rest: object) -> int:
    """Set spindle power if a segment has begun; make the next segments and hand them to the
    hardware.

    Motion is made up to LEAD ticks ahead (about 3 ms) of the segment being played (TICKS_AHEAD),
    because a hold takes effect only after the segments already made. next_segment(row) fills in a
    segment's row; it returns 0 if no motion is due. on_power(power) sets spindle power. on_rest()
    is called if the machines have stopped, and nothing more is to be played. Returns 0.
    """
    power = int(read_progress(state)) if state[RUNNING] else KEEP_POWER
    if power != KEEP_POWER:  # else it is the same as before
        on_power(power)
    # While the clock has further words of a long segment, nothing is due: it interrupts again,
    # the last time LEAD before the segment's end.
    if state[RUNNING] == 0 or state[WORDS_TO_END] <= 0:
        # First what had no space in the hardware: it must not wait while segments are made.
        if state[MADE] != state[FED]:
            feed_lanes(state)
        made = 0  # in this call
        while (
            made < _MOST_PER_CALL
            and state[TICKS_AHEAD] < LEAD
            and state[MADE] - state[FED] < _MOST_WAITING
        ):
            if state[NEXT_PIECE] == 0:  # else append() cuts the next piece off a long segment
                # Its argument is the address of a row: ROW is the first of the ring's.
                if int(next_segment(state[ROW + (state[MADE] & LAST_ROW)])) == 0:
                    break
            append(state)
            made += 1
        if made:
            feed_lanes(state)
        # feed_lanes() would have started the machines.
        if state[RUNNING] == 0 and state[HALT] == 0:
            on_rest()
    return 0
