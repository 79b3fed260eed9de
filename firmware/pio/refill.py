# mypy: disable-error-code=operator
"""Refill: the PIO engine's interrupt, the path without errors (engine.py).

`state` is the engine state (state_layout.py). Segments are counted from power-up: MADE of them
were made, FED handed to the hardware. AHEAD is how many ticks of motion were made after the begin
of the segment being played. RUNNING: the state machines are enabled. CUT is not 0 while a long
segment is made in pieces. HALT is 1 after a stop.
"""

import micropython
from micropython import const
from motion.layout import KEEP_POWER

from pio.engine_state import LEAD, append, feed, read_progress
from pio.state_layout import AHEAD, CUT, EARLY, FED, HALT, LAST_ROW, MADE, ROW, RUNNING

_MOST = const(2)  # segments made in one interrupt, at most
_WAITING = const(10)  # rows that may wait; position() may still read the others


@micropython.viper
def refill(state: ptr32, next_segment: object, on_power: object, on_rest: object) -> int:
    """Set spindle power if a segment has begun; make the next segments and hand them to the
    hardware.

    Motion is made up to LEAD ticks ahead of the segment being played (AHEAD), because a hold takes
    effect only after the segments already made. next_segment(row) fills in a segment's row; it
    returns 0 if no motion is due. on_power(power) sets spindle power. on_rest() is called if the
    machines have stopped, and nothing more is to be played. Returns 0.
    """
    power = int(read_progress(state)) if state[RUNNING] else KEEP_POWER
    if power != KEEP_POWER:
        on_power(power)
    # EARLY > 0: the clock interrupts again LEAD before the end of a long segment, in time.
    if state[RUNNING] == 0 or state[EARLY] <= 0:
        # First what had no space in the hardware: it must not wait while segments are made.
        if state[MADE] != state[FED]:
            feed(state)
        made = 0
        while made < _MOST and state[AHEAD] < LEAD and state[MADE] - state[FED] < _WAITING:
            if state[CUT] == 0:  # else append() cuts the next piece off a long segment
                # Its argument is the address of a row: ROW is the first of the ring's.
                if int(next_segment(state[ROW + (state[MADE] & LAST_ROW)])) == 0:
                    break
            append(state)
            made += 1
        if made:
            feed(state)
        if state[RUNNING] == 0 and state[HALT] == 0:  # feed() would have started the machines
            on_rest()
    return 0
