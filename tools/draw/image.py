"""Jobs as a picture: a column each, with the path from above and in 3D, and curves over time."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from . import drawing
from .drawing import Drawing, Numbers, envelope
from .job import Job, short
from .motion_trace import LETTERS, MEAN_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The most points of a curve, and of a path in a drawing made of lines.
_POINTS = 4000
_STROKES = 40_000
_STROKES_SVG = 10_000
# The width of a picture in dots; finer details are not visible.
_DOTS = 2000
# In inches: width of a single job, width of one of several; heights of path, 3D view, curves.
_WIDE = 15.0
_WIDTH = 9.0
_LETTERS = 80  # characters per line above a path
_HEIGHTS = (6.5, 5.0, 1.6, 1.6, 1.6, 1.6)
# Of the 3D view: its size, because matplotlib ignores the numbers at its ticks; the distance of
# these numbers, so that they do not overlap in a corner; the most ticks of the longest side.
_ZOOM = 0.85
_PAD = 6
_TICKS = 5
# The mark of a punched hole.
_RING: dict[str, Any] = {"mfc": "white", "mec": "black", "ms": 5, "mew": 1.2}


def draw(jobs: Sequence[Job], title: str, words: str, is_svg: bool = False) -> "Figure":
    """Draw the jobs as a figure. words: a line below the title, or "". is_svg: with fewer strokes,
    because each one is an element of the file."""
    from matplotlib.figure import Figure

    figure = Figure(dpi=100, layout="constrained")
    figure.suptitle(f"{title}\n{words}" if words else title, parse_math=False)
    places = _places(figure, len(jobs))  # by job: from above, in 3D, and its curves
    drawings = [_draw(job, _STROKES_SVG if is_svg else _STROKES) for job in jobs]
    colour_scale: dict[str, Any] = {"cmap": drawing.SCALE, "clim": (0, drawing.fastest(drawings))}
    views: list[Any] = []  # from above
    for place, job, drawn in zip(places, jobs, drawings, strict=True):
        views.append(figure.add_subplot(place[0], aspect="equal"))
        cuts = _from_above(views[-1], job, drawn, colour_scale)
        views[-1].set_title(_heading(job, drawn), fontsize="small", parse_math=False)
        _in_space(figure.add_subplot(place[1], projection="3d"), drawn, colour_scale)
    # The last job's cuts stand for all, which have one scale.
    figure.colorbar(cuts, ax=views, label="speed of cuts in mm/min", extend="max", panchor=False)
    _curves(figure, [place[2:] for place in places], jobs)
    return figure


def _places(figure: "Figure", count: int) -> list[list[Any]]:
    """Return the places of path, 3D view and curves of each job. Several jobs are columns; a
    single one has path and 3D view side by side, above its curves."""
    if count == 1:
        heights = _HEIGHTS[:1] + _HEIGHTS[2:]  # without that of the 3D view
        figure.set_size_inches(_WIDE, sum(heights))
        grid = figure.add_gridspec(len(heights), 2, height_ratios=heights)
        return [[grid[0, 0], grid[0, 1], *(grid[row, :] for row in range(1, len(heights)))]]
    figure.set_size_inches(_WIDTH * count, sum(_HEIGHTS))
    grid = figure.add_gridspec(len(_HEIGHTS), count, height_ratios=_HEIGHTS)
    return [[grid[row, column] for row in range(len(_HEIGHTS))] for column in range(count)]


def _draw(job: Job, most: int) -> Drawing:
    """Return a job with at most so many points, and no finer than the picture's dots."""
    longest = max(high - low for low, high in job.result.totals.bounds_mm.values())
    return drawing.draw(job, most, max(drawing.TOLERANCE_MM, longest / _DOTS))


def _heading(job: Job, drawn: Drawing) -> str:
    """Return the job's name, time and figures in some lines."""
    rows = [f"{name} {what}" for name, what in drawing.figures(job)]
    rows.append(f"drawn within {drawn.tolerance_mm:.2g} mm; rapids dashed")
    return "\n".join([f"{job.name}: {short(job.seconds)}", *_filled(rows[1:])])


def _filled(rows: Sequence[str]) -> list[str]:
    """Join texts to lines, as many as fit above a path."""
    lines = [rows[0]]
    for row in rows[1:]:
        if len(lines[-1]) + len(row) < _LETTERS:
            lines[-1] += f"   {row}"
        else:
            lines.append(row)
    return lines


def _from_above(axes: "Axes", job: Job, drawn: Drawing, colour_scale: dict[str, Any]) -> Any:
    """Draw the path from above; return the cuts, whose colours the figure's colour scale explains.
    colour_scale: of speeds, as arguments for LineCollection."""
    from matplotlib.collections import LineCollection

    rapids = LineCollection(
        list(drawn.strokes(rapid=True)[:, :, :2]),
        colors=drawing.RAPID,
        linewidths=0.6,
        linestyles="--",
    )
    speeds = drawn.stroke_speeds(rapid=False)
    cuts = LineCollection(
        list(drawn.strokes(rapid=False)[:, :, :2]), array=speeds, linewidths=0.8, **colour_scale
    )
    axes.add_collection(rapids)
    axes.add_collection(cuts)
    axes.plot([mark[0] for mark in job.marks], [mark[1] for mark in job.marks], "o", **_RING)
    low, size = _roomy(drawn)
    axes.update_datalim([low[:2], (low + size)[:2]])
    axes.autoscale_view()
    axes.set(xlabel="X mm", ylabel="Y mm")
    _travel(axes, job, drawn)
    return cuts


def _travel(axes: "Axes", job: Job, drawn: Drawing) -> None:
    """Draw a frame of the travel of $130 and $131, if the job is nearly as large."""
    from matplotlib.patches import Rectangle

    place = drawing.travel(job, drawn)
    if place:
        (x, y), size = place
        axes.add_patch(Rectangle((x, y), *size, fill=False, ec=drawing.TRAVEL, ls=":"))


def _in_space(axes: Any, drawn: Drawing, colour_scale: dict[str, Any]) -> None:
    """Draw the path in 3D. colour_scale: of speeds, as arguments for LineCollection."""
    from matplotlib.ticker import MaxNLocator
    from mpl_toolkits.mplot3d import art3d  # type: ignore[import-untyped]

    rapids, cuts = drawn.strokes(rapid=True), drawn.strokes(rapid=False)
    axes.add_collection3d(
        art3d.Line3DCollection(
            _lines(rapids), colors=drawing.RAPID, linewidths=0.4, linestyles="--"
        )
    )
    axes.add_collection3d(
        art3d.Line3DCollection(
            _lines(cuts), array=drawn.stroke_speeds(rapid=False), linewidths=0.6, **colour_scale
        )
    )
    low, size = _roomy(drawn)
    longest = max(size)
    axes.tick_params(pad=_PAD)
    # A flat job is drawn higher than it is, so that its height is visible.
    axes.set_box_aspect(np.maximum(size, drawing.FLATTEST * longest), zoom=_ZOOM)
    for letter, start, side in zip("xyz", low, size, strict=True):
        axes.set(**{f"{letter}lim": (start, start + side)})
        axis = getattr(axes, f"{letter}axis")
        axis.set_major_formatter(f"{letter.upper()}{{x:g}}")
        ticks = max(2, round(_TICKS * side / longest))
        # Z's lowest tick would overlap Y's last.
        axis.set_major_locator(MaxNLocator(ticks, prune="lower" if letter == "z" else None))


def _roomy(drawn: Drawing) -> tuple[Numbers, Numbers]:
    """Return lowest corner and size of a drawing. A narrow side of X or Y is widened, because both
    have the same scale."""
    low, size = drawing.box(drawn)
    missing = np.maximum(drawing.FLATTEST * max(size) - size, 0) * (1, 1, 0)  # not of Z
    return low - missing / 2, size + missing


def _lines(strokes: Numbers) -> list[Any]:
    """Return the strokes for matplotlib, which needs at least one."""
    return list(strokes) or [np.zeros((2, 3))]


def _curves(figure: "Figure", places: Sequence[Sequence[Any]], jobs: Sequence[Job]) -> None:
    """Draw speed, acceleration, step rate and power; each row has one scale, and all have one time
    axis."""
    rows: list[list[Axes]] = [[], [], [], []]  # of each row: the axes of each job so far
    first: Axes | None = None  # whose time axis all share
    for column, job in zip(places, jobs, strict=True):
        motion = job.motion
        for place, row in zip(column, rows, strict=True):
            axes = figure.add_subplot(place, sharex=first, sharey=row[0] if row else None)
            first = first or axes
            axes.grid(alpha=0.3)
            row.append(axes)
        time_s, power = np.frombuffer(motion.time_s), np.frombuffer(motion.power, np.float32)
        speed = 60 * np.frombuffer(motion.speed_mm_s, np.float32)
        rows[0][-1].plot(*envelope(time_s, speed, _POINTS), linewidth=0.6, color="black")
        _by_axis(rows[1][-1], job, map(motion.acceleration, motion.axes()), "acceleration")
        _by_axis(rows[2][-1], job, map(motion.step_hz, motion.axes()), "step_hz")
        rows[3][-1].plot(
            *envelope(time_s, 100 * power, _POINTS), linewidth=0.6, color=drawing.POWER
        )
        rows[3][-1].set(xlabel="seconds")
    mean = f"acceleration\nmm/s², mean\nof {MEAN_S * 1000:.0f} ms"
    labels = ("speed\nmm/min", mean, "steps\nper second", "spindle or\nlaser, %")
    for row, label in zip(rows, labels, strict=True):
        row[0].set(ylabel=label)


def _by_axis(axes: "Axes", job: Job, columns: Iterable[Numbers], limits: str) -> None:
    """Draw a curve per axis, of columns, and its limit as a dotted line if it is near. limits: the
    key of job.limits."""
    time_s = np.frombuffer(job.motion.time_s)
    highest = 0.0
    for letter, colour, values in zip(LETTERS, drawing.AXES, columns, strict=False):
        times, kept = envelope(time_s, values, _POINTS)
        axes.plot(times, kept, linewidth=0.6, color=colour, label=letter)
        highest = max(highest, float(kept.max(initial=0)))
    for limit, colour in zip(job.limits[limits], drawing.AXES, strict=False):
        if limit <= 2 * highest:  # else it would make the curves too small
            axes.axhline(limit, color=colour, linewidth=0.8, linestyle=":")
    axes.legend(loc="upper right", ncols=len(LETTERS), fontsize="small")
