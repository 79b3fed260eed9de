"""Pictures of a tool path, coloured by speed: from above and in space."""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import dist
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# More strokes than that cannot be told apart on a picture and take long to draw.
_MOST_STROKES = 40_000
# The least share of the width that height gets in the view in space.
FLATTEST = 0.2
# The scale of colours leaves out the fastest of the path, by this share of the time.
_RAPID_SHARE = 0.03

# How a mark looks.
_RING: dict[str, Any] = {"mfc": "white", "mec": "black", "ms": 5, "mew": 1.2}

Place = tuple[float, float, float]


class Stroke(NamedTuple):
    """A piece of the path: where it ends, in mm, and how long it took."""

    x: float
    y: float
    z: float
    seconds: float

    @property
    def place(self) -> Place:
        """Where it ends."""
        return self[:3]


def strokes(path: Sequence[float]) -> list[Stroke]:
    """The strokes of a Recorder's path: four floats each."""
    columns = iter(path)
    return [Stroke(*row) for row in zip(*[columns] * 4, strict=True)]


def thin(path: Iterable[Stroke], shortest_mm: float) -> list[Stroke]:
    """The same path in fewer strokes: what is shorter is joined to what follows."""
    kept: list[Stroke] = []
    seconds = 0.0
    stroke = None
    for stroke in path:
        seconds += stroke.seconds
        if not kept or dist(stroke.place, kept[-1].place) >= shortest_mm:
            kept.append(stroke._replace(seconds=seconds))
            seconds = 0.0
    if stroke and seconds:
        kept.append(stroke._replace(seconds=seconds))
    return kept


def draw(
    path: Sequence[Stroke], title: str = "", marks: Sequence[Sequence[float]] = ()
) -> "Figure":
    """A figure of the path, from above and in space. The first stroke is only where it begins.

    marks: places to be ringed, the holes of a punch.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import art3d  # type: ignore[import-untyped]

    path = thin(path, sum(dist(a.place, b.place) for a, b in pairwise(path)) / _MOST_STROKES)
    lines = [(a.place, b.place) for a, b in pairwise(path)]
    speeds = [60 * dist(a.place, b.place) / (b.seconds or 1.0) for a, b in pairwise(path)]
    look: dict[str, Any] = {"array": speeds, "cmap": "turbo", "clim": (0, fast(path, speeds))}
    low, size = box(path)

    figure = Figure(figsize=(15, 7.5), dpi=110, layout="constrained")
    figure.suptitle(title)
    above = figure.add_subplot(1, 2, 1, aspect="equal", xlabel="X mm", ylabel="Y mm")
    flat = LineCollection([(a[:2], b[:2]) for a, b in lines], linewidths=0.7, **look)
    above.add_collection(flat)
    above.plot([mark[0] for mark in marks], [mark[1] for mark in marks], "o", **_RING)
    above.autoscale_view()

    space = figure.add_subplot(1, 2, 2, projection="3d", xlabel="X mm", ylabel="Y mm")
    space.add_collection3d(art3d.Line3DCollection(lines, linewidths=0.5, **look))
    space.set(zlabel="Z mm", box_aspect=(size[0], size[1], max(size[2], FLATTEST * max(size))))
    for name, start, side in zip(("xlim", "ylim", "zlim"), low, size, strict=True):
        space.set(**{name: (start, start + side)})
    space.locator_params(nbins=5)
    space.xaxis.labelpad = space.yaxis.labelpad = 8
    figure.colorbar(
        flat, ax=[above, space], label="speed in mm/min", shrink=0.7, aspect=40, extend="max"
    )
    return figure


def save(
    path: Sequence[Stroke], file: Path, title: str = "", marks: Sequence[Sequence[float]] = ()
) -> None:
    """Draw the path into a file; its suffix says in which format."""
    file.parent.mkdir(parents=True, exist_ok=True)
    draw(path, title, marks).savefig(file)


def fast(path: Sequence[Stroke], speeds: Sequence[float]) -> float:
    """The speed that is exceeded for a tiny part of the time only: by the rapids, in most jobs."""
    left = _RAPID_SHARE * sum(stroke.seconds for stroke in path[1:])
    for speed, seconds in sorted(
        zip(speeds, (stroke.seconds for stroke in path[1:]), strict=True), reverse=True
    ):
        left -= seconds
        if left < 0:
            return speed
    return 1.0


def box(path: Sequence[Stroke]) -> tuple[Place, Place]:
    """Lowest corner and size; no side is 0."""
    axes = list(zip(*(stroke.place for stroke in path), strict=True)) or [(0.0,)] * 3
    low = (min(axes[0]), min(axes[1]), min(axes[2]))
    size = [max(axis) - least or 1.0 for axis, least in zip(axes, low, strict=True)]
    return low, (size[0], size[1], size[2])
