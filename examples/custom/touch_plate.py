"""Work zero by a plate on a corner, on the PROBE input: M110 for Z, M110 D6 for Z, X and Y.

The plate lies on the front left corner of the work. Begin above it, at most 20 mm high, and up to
15 mm to the right of the corner and to its rear. D: the tool's diameter, in the program's units.
"""

from ugrbl import Refuse, mcode

THICK, WALL = 12.0, 8.0  # mm: from the work's faces to those of the plate
DEEP, BESIDE = 6.0, 30.0  # mm: how far below its top a side is touched; how far away is clear


def touch(m, axis, way):
    """Touch twice, the second time slowly, and move clear; return the place of contact."""
    m.probe("G91 %s%g F200" % (axis, way))
    m.g("G91 G0 %s%g\nG90" % (axis, -1.0 if way > 0 else 1.0))
    at = m.probe("G91 %s%g F30" % (axis, 2.0 if way > 0 else -2.0))
    m.g("G91 G0 %s%g\nG90" % (axis, -3.0 if way > 0 else 3.0))
    return at


def move(m, words):
    """Move, and refuse if something is in the way."""
    if m.probe("G91 %s F600" % words, must=False):
        raise Refuse("The tool has touched something on its way, %s" % words)


@mcode(110, "d")
def zero(m, D=None):
    if "M5" not in m.modes():
        raise Refuse("The spindle turns: M5 first")
    if m.touches():
        raise Refuse("The plate touches the tool: clip off, and more height, first")
    beyond = WALL + m.mm(D or 0) / 2
    with m.saved():
        found = [(touch(m, "Z", -20), "Z%g" % THICK)]
        for axis in "XY" if D else "":
            move(m, "%s%g" % (axis, -BESIDE))
            move(m, "Z%g" % -(3 + DEEP))
            found.append((touch(m, axis, BESIDE), "%s%g" % (axis, -beyond)))
            move(m, "Z%g" % (3 + DEEP))
            move(m, "%s%g" % (axis, BESIDE))
        for at, words in found:
            m.set_work(at, words)
