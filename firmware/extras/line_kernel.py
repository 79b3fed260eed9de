# mypy: disable-error-code="arg-type, call-overload, has-type, misc"
"""Lines that do no more than move, on machines whose own kernels plan them: rotary axes, skew.

Viper; what stands where is told in language/fast_kernel.py, whose follow() this is up to the plan.
"""

import micropython
from control import modes as md
from control.canon import judge
from language import fast_kernel as fk
from language.fast_kernel import place, read
from micropython import const
from motion.plan_kernel import FULL, OUTSIDE
from motion.reals import per_second

_ODD_NEWS = const(fk.MODES | fk.HAS_S | fk.CHANGED | fk.SAME)


@micropython.viper
def take(text: ptr8, length: int, memory: object) -> int:
    """Read a line that has nothing in its way, and put its place into target, its feed rate in
    force. Returns what read() has found; or 0, and nothing has changed. What is less simple is for
    the interpreter: another motion mode or power, a feed rate in inches, check mode. memory: as
    that of fast_kernel.follow_line()."""
    modes, position, places, travel, _, _, queue, _, changes, speeds, _, _ = memory
    known = ptr32(modes)
    target = ptr32(places)
    rates = ptr32(speeds)
    flow = ptr32(queue)
    if known[fk.AXES] == 0 or known[fk.POWER] == fk.UNTOLD:
        return 0
    if known[fk.CHANGES] != ptr32(changes)[0]:
        return 0
    if known[fk.DRY]:
        return 0
    seen = int(read(text, 0, length, known))
    if seen <= 0 or seen & _ODD_NEWS or (seen & fk.HAS_F and known[fk.LINE_INCHES]):
        return 0
    place(known, seen, ptr32(position), target)
    found = int(judge(target, ptr32(travel), flow))
    if found & OUTSIDE:
        return 0
    if found & FULL:
        known[fk.WAITS] = 1
        return 0
    if seen & fk.HAS_F:
        known[fk.LACKS] = 1
        known[fk.FEED] = known[fk.VALUES]
        rates[md.FEED] = known[fk.FEED]
        known[fk.RATE] = int(per_second(known, fk.FEED))
    return seen
