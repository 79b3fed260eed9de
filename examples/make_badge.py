"""Makes badge.nc: a round wooden badge with a rosette and the word "ugrbl", as CAM would post it.

    python examples/make_badge.py > examples/badge.nc

Work zero: lower left corner of the stock, on its top. Stock 120 x 120 x 8 mm.
Tool: a 3.175 mm end mill for everything. A V-bit would be better for the engraving,
but without a tool change the program runs unattended.
"""

import sys
from collections.abc import Iterator
from math import ceil, cos, pi, sin, tau
from typing import NamedTuple

CENTRE = (60.0, 60.0)
TOOL_RADIUS = 1.5875
SAFE_Z = 5.0
CLEAR_Z = 1.5

FEED = 1200.0
FINISH_FEED = 900.0
ENGRAVE_FEED = 1500.0
PLUNGE = 600.0


class Point(NamedTuple):
    """A place on the stock, in mm."""

    x: float
    y: float


def polar(radius: float, angle: float, centre: tuple[float, float] = CENTRE) -> Point:
    """Return the point at a radius and an angle (radians) from a centre."""
    return Point(centre[0] + radius * cos(angle), centre[1] + radius * sin(angle))


def number(value: float, places: int = 3) -> str:
    """Format a number as posts do: no zeros at the end, but always a point."""
    text = f"{value:.{places}f}".rstrip("0")
    return text.replace("-0.", "0.", 1) if float(text) == 0 else text


class Post:
    """Writes blocks. It leaves out a modal word that has not changed."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._modal: dict[str, str] = {}

    def line(self, text: str) -> None:
        """Write a block, or a comment, unchanged."""
        self.lines.append(text)

    def comment(self, text: str) -> None:
        """Write a comment."""
        self.line(f"({text})")

    def rapid(self, at: Point | None = None, z: float | None = None) -> None:
        """Write a G0."""
        self._move("G0", at, z, None)

    def feed(self, at: Point | None = None, z: float | None = None, rate: float = FEED) -> None:
        """Write a G1."""
        self._move("G1", at, z, rate)

    def arc(
        self,
        to: Point,
        centre: tuple[float, float],
        *,
        z: float | None = None,
        rate: float = FEED,
        clockwise: bool = False,
    ) -> None:
        """Write a G2 or G3 by centre, always with its end: a full turn ends at its start."""
        i = centre[0] - float(self._modal["X"])
        j = centre[1] - float(self._modal["Y"])
        self._modal.pop("X")
        self._modal.pop("Y")
        offset = [f"I{number(i, 4)}", f"J{number(j, 4)}"]
        self._move("G2" if clockwise else "G3", to, z, rate, offset)

    def _move(
        self,
        code: str,
        at: Point | None,
        z: float | None,
        rate: float | None,
        offset: "list[str] | None" = None,
    ) -> None:
        axes = [("X", at.x), ("Y", at.y)] if at else []
        axes += [("Z", z)] if z is not None else []
        words = [self._changed(letter, number(value, 4)) for letter, value in axes]
        words += offset or []
        if any(words):
            speed = self._changed("F", number(rate, 1)) if rate else ""
            self.line(" ".join(filter(None, [self._changed("G", code[1:]), *words, speed])))

    def _changed(self, letter: str, value: str) -> str:
        if self._modal.get(letter) == value:
            return ""
        self._modal[letter] = value
        return letter + value


# The parts of the job


def header(post: Post) -> None:
    """Write the beginning of every program."""
    post.comment("BADGE")
    post.comment("Stock 120 x 120 x 8 mm, zero: lower left corner, top")
    post.comment("T1 D=3.175 - flat end mill")
    post.line("G90 G94 G17")
    post.line("G21")
    post.line("G54")


def begin(post: Post, name: str, spindle_rpm: int) -> None:
    """Start an operation."""
    post.line("")
    post.comment(name)
    post.rapid(z=SAFE_Z)
    post.line(f"S{spindle_rpm} M3")
    post.line("G4 P0.5")


def footer(post: Post) -> None:
    """Switch the spindle off, move away, rewind."""
    post.line("")
    post.rapid(z=15.0)
    post.line("M5")
    post.rapid(Point(0.0, 0.0))
    post.line("M30")


def helix(
    post: Post, centre: tuple[float, float], radius: float, top: float, bottom: float
) -> None:
    """Go down in half turns, at most 0.5 mm each, then once round at the bottom."""
    halves = 2 * ceil((top - bottom) / 1.0)
    for half in range(1, halves + 1):
        z = top + (bottom - top) * half / halves
        post.arc(polar(radius, pi * half, centre), centre, z=z, rate=FINISH_FEED)
    for half in (1, 2):
        post.arc(polar(radius, pi * half, centre), centre, rate=FINISH_FEED)


def bore(post: Post, centre: tuple[float, float], radius: float, depth: float) -> None:
    """Cut a hole by a helix, and clear it of dust on the way out."""
    path = radius - TOOL_RADIUS
    post.rapid(polar(path, 0.0, centre))
    post.rapid(z=CLEAR_Z)
    post.feed(z=0.2, rate=PLUNGE)
    helix(post, centre, path, 0.2, -depth)
    post.feed(Point(*centre), rate=FINISH_FEED)
    post.rapid(z=SAFE_Z)


def drill(post: Post, at: Point, depth: float, peck: float) -> None:
    """Drill a hole in pecks, in single moves: Grbl has no G83."""
    post.rapid(at)
    z = 0.0
    while z > -depth:
        post.rapid(z=CLEAR_Z if z == 0.0 else z + 0.3)
        z = max(z - peck, -depth)
        post.feed(z=z, rate=PLUNGE / 2)
        post.rapid(z=CLEAR_Z)
    post.line("G4 P0.1")
    post.rapid(z=SAFE_Z)


def spiral_pocket(post: Post, inner: float, outer: float, depth: float) -> None:
    """Clear a disc from inside out: a helix into the solid, then a spiral."""
    step = 1.1
    turn_length = 1.6
    post.rapid(polar(inner, 0.0))
    post.rapid(z=CLEAR_Z)
    post.feed(z=0.2, rate=PLUNGE)
    helix(post, CENTRE, inner, 0.2, -depth)
    angle, radius = 0.0, inner
    while radius < outer:
        angle += turn_length / max(radius, turn_length)
        radius = min(inner + step * angle / tau, outer)
        post.feed(polar(radius, angle))
    # A last full turn by arcs, with a smooth exit.
    for half in (1, 2):
        post.arc(polar(outer, angle + pi * half), CENTRE, rate=FINISH_FEED)
    end = polar(outer, angle)
    away = polar(outer - 2.0, angle + 0.1)
    middle = Point((end.x + away.x) / 2, (end.y + away.y) / 2)
    post.arc(away, middle)
    post.rapid(z=SAFE_Z)


def adaptive_ring(post: Post, inner: float, outer: float, depth: float) -> None:
    """Clear a ring in trochoids, which keep the load on the cutter even."""
    middle, swing = (inner + outer) / 2, (outer - inner) / 2 - TOOL_RADIUS
    loops = 160
    post.rapid(polar(middle + swing, 0.0))
    post.rapid(z=CLEAR_Z)
    post.feed(z=-depth, rate=PLUNGE / 2)
    for loop in range(loops):
        at = polar(middle, tau * loop / loops)
        out = tau * loop / loops
        post.feed(polar(swing, out, at))
        post.arc(polar(swing, out + pi, at), at)
        post.arc(polar(swing, out + tau, at), at)
    post.feed(polar(middle + swing, 0.0))
    for radius in (middle + swing, middle - swing):
        post.feed(polar(radius, 0.0), rate=FINISH_FEED)
        post.arc(polar(radius, pi), CENTRE, rate=FINISH_FEED)
        post.arc(polar(radius, tau), CENTRE, rate=FINISH_FEED)
    post.rapid(z=SAFE_Z)


def rosette(post: Post, radius: float, swing: float, lobes: int, points: int) -> None:
    """Engrave a guilloche around the rim, deeper where it swings out, as a V-bit would."""
    depth, deeper = 0.35, 0.2
    for phase in (0.0, 1 / 3, 2 / 3):
        for index in range(points + 1):
            angle = tau * index / points
            wave = sin(lobes * angle + tau * phase)
            at = polar(radius + swing * wave, angle)
            if index == 0:
                post.rapid(at)
                post.rapid(z=CLEAR_Z)
                post.feed(z=-depth - deeper * wave, rate=PLUNGE)
            else:
                post.feed(at, -depth - deeper * wave, ENGRAVE_FEED)
        post.rapid(z=SAFE_Z)


# The word. A stroke is a start and a list of steps, in units of the x-height: (x, y) is a straight
# line to there, (x, y, centre x, centre y, clockwise) an arc.

Step = tuple[float, ...]
LETTERS: dict[str, tuple[float, tuple[tuple[Step, ...], ...]]] = {
    "u": (
        0.8,
        (
            ((0.0, 1.0), (0.0, 0.4), (0.8, 0.4, 0.4, 0.4, 0), (0.8, 1.0)),
            ((0.8, 0.4), (0.8, 0.0)),
        ),
    ),
    "g": (
        0.8,
        (
            ((0.8, 0.6), (0.0, 0.6, 0.4, 0.6, 0), (0.0, 0.4), (0.8, 0.4, 0.4, 0.4, 0)),
            ((0.8, 1.0), (0.8, -0.1), (0.4, -0.5, 0.4, -0.1, 1), (0.1, -0.5)),
        ),
    ),
    "r": (
        0.5,
        (
            ((0.0, 1.0), (0.0, 0.0)),
            ((0.0, 0.6), (0.4, 1.0, 0.4, 0.6, 1), (0.5, 1.0)),
        ),
    ),
    "b": (
        0.8,
        (
            ((0.0, 1.5), (0.0, 0.0)),
            ((0.0, 0.6), (0.8, 0.6, 0.4, 0.6, 1), (0.8, 0.4), (0.0, 0.4, 0.4, 0.4, 1)),
        ),
    ),
    "l": (0.3, (((0.0, 1.5), (0.0, 0.3), (0.3, 0.0, 0.3, 0.3, 0)),)),
}
GAP = 0.32


def word_strokes(word: str, height: float) -> Iterator[tuple[Point, list[Step]]]:
    """Yield every stroke of a centred word, in mm: its start and its steps."""
    width = sum(LETTERS[letter][0] for letter in word) + GAP * (len(word) - 1)
    left = CENTRE[0] - width * height / 2
    base = CENTRE[1] - height / 2
    for letter in word:
        advance, strokes = LETTERS[letter]
        for stroke in strokes:
            steps = []
            for step in stroke:
                places = [
                    (left, base)[index % 2] + height * value
                    for index, value in enumerate(step[:4])
                ]
                steps.append((*places, *step[4:]))
            yield Point(steps[0][0], steps[0][1]), steps[1:]
        left += (advance + GAP) * height


def engrave(post: Post, word: str, height: float, floor: float, depths: tuple[float, ...]) -> None:
    """Cut a word into the floor of the pocket, each stroke in several passes."""
    for start, steps in word_strokes(word, height):
        for depth in depths:
            post.rapid(start)
            post.rapid(z=floor + CLEAR_Z)
            post.feed(z=floor - depth, rate=PLUNGE)
            for step in steps:
                to = Point(step[0], step[1])
                if len(step) == 2:
                    post.feed(to, rate=FINISH_FEED)
                else:
                    centre = (step[2], step[3])
                    post.arc(to, centre, rate=FINISH_FEED, clockwise=bool(step[4]))
            post.rapid(z=floor + CLEAR_Z)
        post.rapid(z=SAFE_Z)


def profile(post: Post, radius: float, depth: float, passes: int) -> None:
    """Cut the badge out clockwise; the deepest passes leave four tabs."""
    path = radius + TOOL_RADIUS
    tab_top, tab = -depth + 1.6, 5.0 / path

    def to(angle: float, z: float | None = None, rate: float = FEED) -> None:
        post.arc(polar(path, -angle), CENTRE, z=z, rate=rate, clockwise=True)

    post.rapid(polar(path + 3.0, 0.0))
    post.rapid(z=CLEAR_Z)
    post.feed(z=0.0, rate=PLUNGE)
    post.feed(polar(path, 0.0), rate=FINISH_FEED)
    for turn in range(1, passes + 1):
        z = -depth * turn / passes
        to(pi / 8, z, FINISH_FEED)  # a ramp
        for quarter in range(4):
            middle = pi / 4 + pi / 2 * quarter
            if z < tab_top:
                to(middle - tab / 2)
                post.feed(z=tab_top, rate=PLUNGE)
                to(middle + tab / 2)
                post.feed(z=z, rate=PLUNGE)
            to(middle + pi / 4)
    post.feed(polar(path + 3.0, 0.0))
    post.rapid(z=SAFE_Z)


def seams(post: Post, inner: float, outer: float, count: int) -> None:
    """Short radial cuts between the ring and the rim, alternating in and out."""
    for index in range(count):
        angle = tau * (index + 0.5) / count
        ends = [polar(inner, angle), polar(outer, angle)]
        start, end = ends if index % 2 == 0 else reversed(ends)
        post.rapid(start)
        post.rapid(z=CLEAR_Z)
        post.feed(z=-0.4, rate=PLUNGE)
        post.feed(end, -0.8, FINISH_FEED)
        post.rapid(z=CLEAR_Z)
    post.rapid(z=SAFE_Z)


def badge() -> list[str]:
    """Return the program, line by line."""
    post = Post()
    header(post)
    begin(post, "Bores for the hold-down screws", 12000)
    for hole in range(4):
        bore(post, polar(62.0, pi / 4 + pi / 2 * hole), 3.0, 5.0)
    begin(post, "Pocket, spiral from inside out", 12000)
    spiral_pocket(post, 2.5, 32.0, 1.2)
    begin(post, "Word", 14000)
    engrave(post, "ugrbl", 13.0, -1.2, (0.3, 0.6))
    begin(post, "Ring, adaptive", 12000)
    adaptive_ring(post, 35.0, 42.0, 1.5)
    begin(post, "Rosette", 16000)
    rosette(post, 47.0, 2.6, 18, 480)
    begin(post, "Seams", 16000)
    seams(post, 50.5, 52.5, 48)
    begin(post, "Eyelet, drilled", 9000)
    for side in (-1, 1):
        drill(post, polar(38.5, pi / 2 + side * 0.1), 5.0, 1.5)
    begin(post, "Outline, with tabs", 12000)
    profile(post, 54.0, 8.0, 6)
    footer(post)
    return post.lines


if __name__ == "__main__":
    sys.stdout.write("\n".join(badge()) + "\n")
