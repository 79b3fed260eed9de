"""A tangential knife: G101 X10 Y5 cuts there in a straight line, with the blade along the path.

Axis A is the blade's angle in degrees, 0 along X. Where the path turns by more than MOST_DEGREES
the blade comes out, turns, and goes in again. Otherwise it turns as it cuts, without a stop. G100
ends a cut.

Checked by: ugrbl custom check knife.py --board sim_xyza
"""

from math import atan2, pi

from ugrbl import Refuse, gcode

UP, DOWN = 2.0, -1.5  # Z in work coordinates: clear of the material, through it
MOST_DEGREES = 12.0  # the most that the blade may turn within the material
CUT, PLUNGE = 3000, 600  # mm/min


@gcode(101, "xyf", sync=None)
def cut(m, X=None, Y=None, F=None):
    here = m.target()
    x, y = (old if new is None else m.mm(new) for old, new in ((here.x, X), (here.y, Y)))
    if "G91" in m.modes():
        raise Refuse("G101 goes to absolute places: G90 first")
    if (x - here.x) ** 2 + (y - here.y) ** 2 < 1e-6:
        return
    angle = atan2(y - here.y, x - here.x) * 180 / pi
    turn = (angle - here.a + 180) % 360 - 180  # the short way, so that no cable winds up
    with m.saved():
        if here.z > DOWN + 0.001 or abs(turn) > MOST_DEGREES:
            m.g("G0 Z%g" % max(UP, here.z))
            m.g("G0 A%.3f" % (here.a + turn))
            m.g("G1 Z%g F%d" % (DOWN, PLUNGE))
        rate = m.mm(F) if F else CUT
        m.g("G1 X%.4f Y%.4f A%.3f F%.1f" % (x, y, here.a + turn, rate))


@gcode(100, sync=None)
def lift(m):
    with m.saved():
        m.g("G0 Z%g" % UP)
