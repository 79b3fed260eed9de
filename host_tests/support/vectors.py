"""Print the results of kernels and words for pseudo-random vectors: equal on every Python."""

import sys
from array import array

from base import float32_math
from base.float32 import vector
from base.state import State
from language import words
from motion import arcs, layout, minifloat, ramps
from motion.arc_geometry import CENTRE_0, CENTRE_1, CLOCKWISE, RADIUS, Arc
from motion.kinematics import COREXY, Kinematics
from motion.layout import ROWS
from motion.planner import Move, Planner
from motion.segments import Segments


class Dice:
    """A small generator that needs no module and no big integers."""

    def __init__(self, seed):
        self._state = seed

    def below(self, limit):
        """Return an integer from 0 to limit - 1, limit up to 2**24."""
        self._state = (self._state * 1103 + 12345) % 16777213
        return self._state % limit

    def any(self, choices):
        """Return one of the choices."""
        return choices[self.below(len(choices))]


def print_reals(dice):
    """Print the arithmetic of minifloats and of the interrupt."""
    for _ in range(600):
        a = minifloat.pack(1 + dice.below(1 << 24), 50 + dice.below(28))
        b = minifloat.pack(1 + dice.below(1 << 24), 50 + dice.below(28))
        n, m = dice.below(1 << 24) << dice.below(6), dice.below(1 << 24)
        part = dice.below(131073)
        print(
            minifloat.mul(a, b),
            minifloat.ratio(n, b),
            minifloat.product(a, b, b),
            minifloat.square_root(n),
            ramps.share(n, m + 1),
            ramps.times(n, part),
            ramps.braking(max(n, m), min(n, m), 1 + dice.below(1 << 20), dice.any((0, 18))),
            ramps.after(n, 1 + dice.below(1 << 20), m, dice.below(2)),
        )


def print_words(dice):
    """Print numbers of any length, read into the bits of floats."""
    letters, values = bytearray(128), array("f", [0.0] * 128)
    for _ in range(1500):
        text = ""
        for _ in range(1 + dice.below(5)):
            text += dice.any("GXYZF") + dice.any(("", "-", "+"))
            text += str(dice.below(10 ** (1 + dice.below(7))))
            if dice.below(2):
                text += "." + "0" * dice.below(4) + str(dice.below(10 ** (1 + dice.below(7))))
        count = words.scan(bytearray(text.encode() + b"\0"), len(text) << 8, letters, values)
        bits = bytes(array("f", [values[i] for i in range(count & 255)]))
        print(text, count, list(bits))
        one, other = array("f", [values[0]]), array("f", [values[1 % (count & 255)]])
        float32_math.add_single(one, 0, other, 0)
        print(list(bytes(other)))


class Settings:
    """The settings that Planner.configure() reads."""

    junction_deviation_mm = 0.01

    def __init__(self, dice):
        self.steps_per_mm = array("f", [dice.any((5.0, 80.0, 250.0, 3200.0)) for _ in range(3)])
        self.max_rate = array("f", [dice.any((100.0, 500.0, 3000.0, 20000.0)) for _ in range(3)])
        self.acceleration = array(
            "f", [dice.any((36000.0, 360000.0, 3600000.0)) for _ in range(3)]
        )


def print_blocks(dice):
    """Print blocks as they are planned, and the rows of segments cut from them."""
    row = array("i", [0] * layout.row_length(3))
    target = vector(3)
    move = Move()
    for k in range(40):
        planner = Planner(3, 16, Kinematics(3, COREXY) if k % 5 == 4 else None, State())
        planner.configure(Settings(dice), 13107200, 17, 90909)
        planner.override()
        segments = Segments(planner)
        for _ in range(40):
            for i in range(3):
                target[i] += dice.any((0.0, 0.25, 2.0)) * (dice.below(9) - 4)
            move.feed = 30.0 * (1 + dice.below(100))
            move.flags = dice.any((0, 0, 1))
            head = planner.flow[layout.HEAD]
            if not planner.full() and planner.line(target, move, 0):
                size = planner.flow[layout.ROW_SIZE]
                print([planner.ring[head * size + i] for i in range(size)])
            segments.hold(dice.below(12) == 0)
            for _ in range(dice.below(6)):
                if segments.next(row):
                    print(list(row))
        print(list(planner.flow), planner.flow[ROWS])


def print_arcs(dice):
    """Print steps of chords, in any plane, with helices, for many scales."""
    course, table = array("i", [0] * arcs.course_length(4)), array("i", [0] * 60)
    table[layout.AXES] = 4
    start, target = vector(4), vector(4)
    arc = Arc()
    for axis in range(4):
        arcs.limit(course, axis, -1.0e6, 2.0e6)
    for _ in range(150):
        plane = dice.any(((0, 1), (2, 0), (1, 2)))
        arc.plane[0], arc.plane[1] = plane
        arc.plane[CLOCKWISE] = dice.below(2)
        steps_per_mm = array("f", [dice.any((5.0, 80.0, 250.0, 3200.0)) for _ in range(4)])
        for i in range(4):
            start[i] = target[i] = 0.25 * (dice.below(4000) - 2000)
            if i not in plane:
                target[i] += 0.125 * (dice.below(200) - 100)
        x, y = dice.any(((3.0, 4.0), (-0.25, 0.0), (60.0, -80.0)))
        arc.numbers[CENTRE_0], arc.numbers[CENTRE_1] = x, y
        arc.numbers[RADIUS] = (x * x + y * y) ** 0.5
        arcs.stray(course, dice.any((0.002, 0.1)))
        print(arc.lay(start, target, steps_per_mm, course))
        for _ in range(min(course[arcs.CHORDS_LEFT], 20)):
            outside = arcs.next_chord(course, table)
            print(outside, list(table[layout.LIMITS + 4 * layout.TARGET :][:4]))


def main():
    """Print the part named on the command line."""
    parts = {
        "reals": print_reals,
        "words": print_words,
        "blocks": print_blocks,
        "arcs": print_arcs,
    }
    parts[sys.argv[1]](Dice(4711))


if __name__ == "__main__":
    main()
