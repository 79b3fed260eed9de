# mypy: disable-error-code="arg-type, call-overload, has-type, misc"
"""Many lines checked in one call, by the firmware's own kernels: for the simulator only."""

import micropython
from language.fast_kernel import follow
from talk.lines import LINE, clean


@micropython.viper
def check_lines(
    heard: ptr8,
    at: ptr32,
    text: ptr8,
    kinds: ptr8,
    known: ptr32,
    position: ptr32,
    target: ptr32,
    travel: ptr32,
    table: ptr32,
    ring: ptr32,
    flow: ptr32,
    speeds: ptr32,
    changes: ptr32,
    rates: ptr32,
    scale: ptr32,
    news: object,
) -> int:
    """Do what the firmware's loop does with lines that only move (talk/quick_lines.py), in check
    mode, up to one that does more. Returns how many were done."""
    done = 0
    found = int(clean(heard, at, text, kinds))
    while found & LINE:
        if int(follow(
            text, found >> 2, known, position, target, travel,
            table, ring, flow, speeds, changes, rates, scale, news,
        )) == 0:  # fmt: skip
            return done
        done += 1
        found = int(clean(heard, at, text, kinds))
    return done
