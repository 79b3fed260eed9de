# mypy: disable-error-code="arg-type, call-overload, has-type, misc"
"""Check many lines in one call, by the firmware's own kernels: for the simulator only."""

import micropython
from language.line import execute
from talk.lines import LINE, clean


@micropython.viper
def check_lines(
    received: ptr8,
    indices: ptr32,
    line: object,
    kinds: ptr8,
    modal: ptr32,
    machine: ptr32,
    memory: object,
) -> int:
    """Do in check mode what the firmware's loop does with move-only lines (talk/stream_loop.py),
    up to a line that is not move-only. Returns how many were done.

    received, indices, line, kinds: memory of talk/lines.py. modal, machine, memory: that of the
    interpreter.

    clean() moves the next line into `line` and returns flags, LINE if there was one, and its
    length from bit 2. execute() returns 0 for a line that is not move-only.
    """
    done = 0
    text = ptr8(line)
    found = int(clean(received, indices, text, kinds))
    while found & LINE:
        if int(execute(line, found >> 2, modal, machine, memory)) == 0:
            return done
        done += 1
        found = int(clean(received, indices, text, kinds))
    return done
