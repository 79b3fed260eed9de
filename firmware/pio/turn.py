# mypy: disable-error-code=operator
"""The turn: what the PIO engine's interrupt does, as far as nothing goes wrong (engine.py)."""

import micropython
from micropython import const
from motion.layout import KEEP_POWER

from pio.hub import LEAD, append, feed, look
from pio.hub_layout import AHEAD, CUT, EARLY, FED, HALT, LAST_ROW, MADE, ROW, RUNNING

_MOST = const(2)  # segments made in one interrupt
_WAITING = const(10)  # rows that may wait; the others may still be looked at


@micropython.viper
def turn(hub: ptr32, next_segment: object, on_power: object, on_rest: object) -> int:
    """A segment has begun, or the engine is to start: keep the hardware busy."""
    power = int(look(hub)) if hub[RUNNING] else KEEP_POWER
    if power != KEEP_POWER:
        on_power(power)
    if hub[RUNNING] == 0 or hub[EARLY] <= 0:
        if hub[MADE] != hub[FED]:
            feed(hub)
        made = 0
        while made < _MOST and hub[AHEAD] < LEAD and hub[MADE] - hub[FED] < _WAITING:
            if hub[CUT] == 0:
                if int(next_segment(hub[ROW + (hub[MADE] & LAST_ROW)])) == 0:
                    break
            append(hub)
            made += 1
        if made:
            feed(hub)
        if hub[RUNNING] == 0 and hub[HALT] == 0:
            on_rest()
    return 0
