"""A counter of parts, kept over power-off: each M2 or M30 adds one.

Reports have |Pn:12,50, the parts made and wanted. M120 Q50 sets how many are wanted, M121 starts
again at 0. When all are made the sender gets a message, and the next program waits for cycle
start.
"""

from ugrbl import Refuse, mcode, on


@on.program_done
def count(m):
    m.keep["parts"] = made = m.keep.get("parts", 0) + 1
    wanted = m.keep.get("wanted", 0)
    if made == wanted:
        m.ask("%d parts are made: empty the box, then cycle start" % made)


@on.report
def field(m):
    return "Pn:%d,%d" % (m.keep.get("parts", 0), m.keep.get("wanted", 0))


@mcode(120, "Q")
def want(m, Q):
    if Q < 0 or Q != int(Q):
        raise Refuse("M120: Q is a number of parts, not %g" % Q)
    m.keep["wanted"] = int(Q)


@mcode(121)
def begin_anew(m):
    m.keep["parts"] = 0
