"""A height map: M118 X60 Y40 Q10 probes the work every 10 mm, G102 X Y Z F cuts over it like G1.

Start M118 in the front left corner, above the work. X and Y are the size of the area, Q is the
grid's width, in the program's units. Afterwards Z0 is the work's height in that corner. The map is
kept.
"""

from ugrbl import Refuse, gcode, mcode

DEEP, MOST = 10.0, 150  # mm below the start: the probe must touch by then; points at most
grid = []  # x, y, width, columns, rows; then heights, row by row


@mcode(118, "XYQ")
def probe_map(m, X, Y, Q):
    width, begin = m.mm(Q), m.work()
    columns, rows = (int(m.mm(way) / width + 1.001) if width > 0 else 0 for way in (X, Y))
    if columns < 2 or rows < 2 or columns * rows > MOST:
        raise Refuse("M118: %d by %d points, of 2 by 2 to %d" % (columns, rows, MOST))
    if "M5" not in m.modes() or m.touches():
        raise Refuse("M118: the spindle turns, or the probe touches already")
    with m.saved():
        found = []
        for i in range(columns * rows):
            m.g("G0 X%.3f" % (begin.x + i % columns * width))
            m.g("G0 Y%.3f" % (begin.y + i // columns * width))
            found.append(m.probe("Z%.3f F100" % (begin.z - DEEP)))
            m.g("G0 Z%.3f" % begin.z)
        m.set_work(found[0], "Z0")
    grid[:] = [begin.x, begin.y, width, columns, rows] + [at.z - found[0].z for at in found]
    m.keep["map"] = " ".join(["%.3f" % number for number in grid])


def height(x, y):
    """Interpolate between four points of the grid; beyond its edge use the edge."""
    x, y = (min(max((v - grid[i]) / grid[2], 0), grid[i + 3] - 1.001) for i, v in ((0, x), (1, y)))
    at, x, y = 5 + int(y) * int(grid[3]) + int(x), x % 1, y % 1
    low, high = (grid[i] * (1 - x) + grid[i + 1] * x for i in (at, at + int(grid[3])))
    return low * (1 - y) + high * y


@gcode(102, "xyzF", sync=None)
def cut(m, F, X=None, Y=None, Z=None):
    grid[:] = grid or [float(number) for number in m.keep.get("map", "").split()]
    if not grid or "G91" in m.modes():
        raise Refuse("G102: no map, M118 makes one; and absolute places only")
    here = m.target()
    plain = (here.x, X), (here.y, Y), (here.z - height(here.x, here.y), Z)
    ends = [(old, old if new is None else m.mm(new)) for old, new in plain]
    pieces = int(max(abs(end - old) for old, end in ends[:2]) / grid[2] * 2) + 1
    with m.saved():
        for i in range(1, pieces + 1):
            x, y, z = (old + (end - old) * i / pieces for old, end in ends)
            m.g("G1 X%.3f Y%.3f Z%.4f F%.1f" % (x, y, z + height(x, y), m.mm(F)))
