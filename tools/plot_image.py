"""Jobs as a picture: a column each, with the path from above and in space, and curves in time."""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from math import dist
from typing import TYPE_CHECKING, Any

from . import picture
from .motion_trace import LETTERS
from .picture import Stroke
from .plot import Job, envelope, short

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# A curve, or a path in a drawing made of lines, has no more points than that.
_POINTS = 4000
_STROKES = 20_000
_STROKES_SVG = 5000
_WIDTH = 9.0
_HEIGHTS = (6.0, 5.0, 2.2, 2.2, 2.2)
_COLOURS = ("tab:red", "tab:green", "tab:blue", "tab:orange", "tab:purple", "tab:brown")


def draw(jobs: Sequence[Job], title: str, words: str, is_svg: bool = False) -> "Figure":
    """The figure."""
    from matplotlib.figure import Figure

    size = (_WIDTH * len(jobs), sum(_HEIGHTS))
    figure = Figure(figsize=size, dpi=100, layout="constrained")
    figure.suptitle(f"{title}\n{words}" if words else title)
    grid = figure.add_gridspec(len(_HEIGHTS), len(jobs), height_ratios=_HEIGHTS)
    paths = [thinned(job.strokes(), _STROKES_SVG if is_svg else _STROKES) for job in jobs]
    fastest = max(picture.fast(path, path_speeds(path)) for path in paths)
    above: list[Any] = []
    for column, (job, path) in enumerate(zip(jobs, paths, strict=True)):
        look: dict[str, Any] = {"array": path_speeds(path), "cmap": "turbo", "clim": (0, fastest)}
        above.append(figure.add_subplot(grid[0, column], aspect="equal"))
        flat = _from_above(above[-1], path, look)
        above[-1].set_title(f"{job.name}: {short(job.seconds)}")
        _in_space(figure.add_subplot(grid[1, column], projection="3d"), path, look)
    figure.colorbar(flat, ax=above, label="speed in mm/min", extend="max")
    _curves(figure, grid, jobs)
    return figure


def thinned(path: Sequence[Stroke], most: int) -> list[Stroke]:
    return picture.thin(path, sum(dist(a.place, b.place) for a, b in pairwise(path)) / most)


def path_speeds(path: Sequence[Stroke]) -> list[float]:
    return [60 * dist(a.place, b.place) / (b.seconds or 1.0) for a, b in pairwise(path)]


def _from_above(axes: "Axes", path: Sequence[Stroke], look: dict[str, Any]) -> Any:
    from matplotlib.collections import LineCollection

    flat = LineCollection([(a[:2], b[:2]) for a, b in pairwise(path)], linewidths=0.7, **look)
    axes.add_collection(flat)
    axes.autoscale_view()
    axes.set(xlabel="X mm", ylabel="Y mm")
    return flat


def _in_space(axes: Any, path: Sequence[Stroke], look: dict[str, Any]) -> None:
    from mpl_toolkits.mplot3d import art3d  # type: ignore[import-untyped]

    lines = [(a.place, b.place) for a, b in pairwise(path)]
    axes.add_collection3d(art3d.Line3DCollection(lines, linewidths=0.5, **look))
    low, size = picture.box(path)
    flattest = picture.FLATTEST * max(size)
    axes.set(xlabel="X mm", ylabel="Y mm", zlabel="Z mm")
    axes.set(box_aspect=(size[0], size[1], max(size[2], flattest)))
    for name, start, side in zip(("xlim", "ylim", "zlim"), low, size, strict=True):
        axes.set(**{name: (start, start + side)})
    axes.locator_params(nbins=5)


def _curves(figure: "Figure", grid: Any, jobs: Sequence[Job]) -> None:
    """Speed, acceleration and step rate; a row has one scale, and time too."""
    rows: list[list[Axes]] = [[], [], []]
    first: Axes | None = None
    for column, job in enumerate(jobs):
        motion = job.motion
        for row, shared in enumerate(rows):
            axes = figure.add_subplot(
                grid[row + 2, column], sharex=first, sharey=shared[0] if shared else None
            )
            first = first or axes
            axes.grid(alpha=0.3)
            shared.append(axes)
        speed = [60 * mm_s for mm_s in motion.speed_mm_s]
        rows[0][-1].plot(*envelope(motion.time_s, speed, _POINTS), linewidth=0.6, color="black")
        _by_axis(rows[1][-1], job, motion.acceleration, job.limits["acceleration"])
        _by_axis(rows[2][-1], job, motion.step_hz, job.limits["step_hz"])
        rows[2][-1].set(xlabel="seconds")
    rows[0][0].set(ylabel="speed\nmm/min")
    rows[1][0].set(ylabel="acceleration\nmm/s²")
    rows[2][0].set(ylabel="steps per second")


def _by_axis(
    axes: "Axes", job: Job, columns: Iterable[Sequence[float]], limits: Sequence[float]
) -> None:
    """A curve per axis, with what its setting allows as a dotted line where it comes near."""
    highest = 0.0
    for letter, colour, values in zip(LETTERS, _COLOURS, columns, strict=False):
        line = envelope(job.motion.time_s, values, _POINTS)
        axes.plot(*line, linewidth=0.6, color=colour, label=letter)
        highest = max(highest, *line[1])
    for limit, colour in zip(limits, _COLOURS, strict=False):
        if limit <= 2 * highest:
            axes.axhline(limit, color=colour, linewidth=0.8, linestyle=":")
    axes.legend(loc="upper right", ncols=len(LETTERS), fontsize="small")
