"""An oscillating blade: G111 X10 Y5 cuts there in a straight line, and every corner lifts it.

OUTPUTS = {"blade": 18} in the board file: the blade starts before it goes in. G110 ends a cut and
stops it. Axis A turns it, in degrees, 0 along X. A blade cuts its full depth only behind its
point. So it cuts a little beyond each corner, and starts as much before the next line.

Checked by: ugrbl custom check oscillating.py --board sim_xyza
"""

from math import atan2, cos, pi, sin

from ugrbl import Refuse, gcode

UP, DOWN = 3.0, -4.0  # Z in work coordinates: clear of the material, through it
OVER = 0.6  # mm beyond corners, about a third of the blade's width
MOST_DEGREES = 5.0  # the most that it may turn within the material
CUT, PLUNGE = 2400, 400  # mm/min
SWING_S = 0.3  # time until the blade has its speed


def beyond(x, y, degrees, mm):
    angle = degrees * pi / 180
    return "X%.4f Y%.4f" % (x + mm * cos(angle), y + mm * sin(angle))


def leave(m, here):
    m.g("G1 %s F%d" % (beyond(here.x, here.y, here.a, OVER), CUT))
    m.g("G0 Z%g" % UP)


@gcode(111, "xyf", sync=None)
def cut(m, X=None, Y=None, F=None):
    if "G91" in m.modes():
        raise Refuse("G111 goes to absolute places: G90 first")
    here = m.target()
    x, y = (old if new is None else m.mm(new) for old, new in ((here.x, X), (here.y, Y)))
    if (x, y) == (here.x, here.y):
        return
    turn = (atan2(y - here.y, x - here.x) * 180 / pi - here.a + 180) % 360 - 180
    a, is_in = here.a + turn, here.z < DOWN + 0.001
    if not m.is_on("blade"):
        m.out("blade", True)
        m.wait(SWING_S)
    with m.saved():
        if is_in and abs(turn) > MOST_DEGREES:
            leave(m, here)
        if not is_in or abs(turn) > MOST_DEGREES:
            m.g("G0 Z%g" % max(UP, here.z))
            m.g("G0 %s A%.3f" % (beyond(here.x, here.y, a, -OVER), a))
            m.g("G1 Z%g F%d" % (DOWN, PLUNGE))
        m.g("G1 X%.4f Y%.4f A%.3f F%.1f" % (x, y, a, m.mm(F) if F else CUT))


@gcode(110, sync=None)
def end(m):
    with m.saved():
        leave(m, m.target())
    m.out("blade", False)
