"""Makes punch.nc: a loudspeaker's grille of 127 holes, for a machine with a punch.

python3 examples/make_punch.py > examples/punch.nc
"""

from math import cos, radians, sin

CENTRE = 50.0  # mm, X and Y
PITCH = 6.0  # mm from ring to ring
RINGS = 6
REGISTER = (10.0, 90.0)  # mm: a hole in each corner

_HEAD = """\
(A loudspeaker's grille: 127 holes in 6 rings, and one in each corner)
(For a board with TOOL = punch. M3 arms it: every line of motion)
(then ends with a stroke. M5 disarms it. Set $1=255: motors that)
(are off do not hold against a punch.)
G21 G90 G17
M5"""


def grille() -> list[str]:
    """Return the program, line by line."""
    lines = _HEAD.splitlines()
    low, high = REGISTER
    lines += [f"G0 X{low:g} Y{low:g}", "M3", f"G0 X{low:g} Y{low:g}"]
    lines += [f"X{high:g}", f"Y{high:g}", f"X{low:g}", "M5", "(The centre, then ring by ring)"]
    lines += [f"G0 X{CENTRE:g} Y{CENTRE:g}", "M3", f"X{CENTRE:g} Y{CENTRE:g}"]
    for ring in range(1, RINGS + 1):
        lines.append(f"(ring {ring})")
        count = 6 * ring
        for k in range(count):
            x, y = _place(ring, k / count)
            if k == 0:
                lines.append(f"G0 X{x:.3f} Y{y:.3f}")
            else:
                lines.append(f"G3 X{x:.3f} Y{y:.3f} R{PITCH * ring:g} F500")
    return [*lines, "M5", "G0 X0 Y0", "M30"]


def _place(ring: int, turn: float) -> tuple[float, float]:
    angle = radians(360 * turn)
    return CENTRE + PITCH * ring * cos(angle), CENTRE + PITCH * ring * sin(angle)


if __name__ == "__main__":
    print("\n".join(grille()))
