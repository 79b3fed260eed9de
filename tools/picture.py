"""Pictures of a tool path, coloured by speed: from above and in space."""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import dist
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# More strokes than that cannot be told apart on a picture and take long to draw.
_MOST_STROKES = 40_000
# The least share of the width that height gets in the view in space.
_FLATTEST = 0.2

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


def draw(path: Sequence[Stroke], title: str = "") -> "Figure":
    """A figure of the path, from above and in space. The first stroke is only where it begins."""
    import matplotlib.colors
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    length = sum(dist(a.place, b.place) for a, b in pairwise(path))
    path = thin(path, length / _MOST_STROKES)
    lines = [(a.place, b.place) for a, b in pairwise(path)]
    speeds = [60 * dist(a.place, b.place) / (b.seconds or 1.0) for a, b in pairwise(path)]
    colours = matplotlib.colors.PowerNorm(0.5, 0, max(speeds, default=1.0) or 1.0)
    low, size = _box(path)

    figure = Figure(figsize=(15, 7), dpi=110, layout="constrained")
    figure.suptitle(title)
    above = figure.add_subplot(1, 2, 1, aspect="equal", xlabel="X mm", ylabel="Y mm")
    flat = [(a[:2], b[:2]) for a, b in lines]
    top = LineCollection(flat, array=speeds, cmap="turbo", norm=colours, linewidths=0.6)
    above.add_collection(top)
    above.autoscale_view()

    space = figure.add_subplot(1, 2, 2, projection="3d", xlabel="X mm", ylabel="Y mm")
    solid = Line3DCollection(lines, array=speeds, cmap="turbo", norm=colours, linewidths=0.4)
    space.add_collection3d(solid)
    space.set(
        xlim=(low[0], low[0] + size[0]),
        ylim=(low[1], low[1] + size[1]),
        zlim=(low[2], low[2] + size[2]),
        zlabel="Z mm",
        box_aspect=(size[0], size[1], max(size[2], _FLATTEST * max(size))),
    )
    figure.colorbar(top, ax=[above, space], label="speed in mm/min", shrink=0.8)
    return figure


def save(path: Sequence[Stroke], file: Path, title: str = "") -> None:
    """Draw the path into a file; its suffix says in which format."""
    file.parent.mkdir(parents=True, exist_ok=True)
    draw(path, title).savefig(file)


def _box(path: Sequence[Stroke]) -> tuple[Place, Place]:
    """Lowest corner and size; no side is 0."""
    axes = list(zip(*(stroke.place for stroke in path), strict=True)) or [(0.0,)] * 3
    low = (min(axes[0]), min(axes[1]), min(axes[2]))
    size = [max(axis) - least or 1.0 for axis, least in zip(axes, low, strict=True)]
    return low, (size[0], size[1], size[2])
