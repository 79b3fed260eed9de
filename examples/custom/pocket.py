"""Find the middle of a pocket, or of a hole: M112 R30. The probe is on the PROBE input.

Begin inside it, at the height of its walls. R: no wall is further away, in the
program's units. Afterwards X0 Y0 is the middle, the probe is there, and a message gives the width.
"""

from ugrbl import Refuse, mcode


def wall(m, axis, way):
    """Return the wall's place in machine coordinates: probe fast, then slowly, and back off."""
    sign = 1 if way > 0 else -1
    m.probe("G91 %s%.3f F300" % (axis, way))
    m.g("G91 G1 %s%.3f F300\nG90" % (axis, -sign))
    at = m.probe("G91 %s%.3f F30" % (axis, 2 * sign))
    m.g("G91 G1 %s%.3f F300\nG90" % (axis, -sign))
    return at["XY".index(axis)]


def middle(m, axis, reach):
    """Go to the middle between two walls; return their distance."""
    low = wall(m, axis, -reach)
    high = wall(m, axis, 2 * reach)
    m.g("G53 G1 %s%.4f F600" % (axis, (low + high) / 2))
    m.wait_motion()
    return high - low


@mcode(112, "R")
def pocket(m, R):
    reach = m.mm(R)
    if reach <= 1:
        raise Refuse("M112: R is how far the walls are, not %g" % R)
    if "M5" not in m.modes() or m.touches():
        raise Refuse("M112: the spindle turns, or the probe touches already")
    with m.saved():
        middle(m, "X", reach)
        wide_y = middle(m, "Y", reach)
        wide_x = middle(m, "X", reach)  # again: only now through the middle of a hole
        m.set_work(m.position(), "X0 Y0")
    m.message("Pocket: X %.3f, Y %.3f mm, and the ball of the probe" % (wide_x, wide_y))
