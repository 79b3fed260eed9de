"""The data that pages and pictures draw of a job: its path with few enough points, its figures in
words."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .simplify import fitted

if TYPE_CHECKING:
    from .job import Job

# Default of the largest distance between the drawing and the path.
TOLERANCE_MM = 0.01
# Number of speeds that a drawing distinguishes.
SHADES = 12
# The same in pages and pictures.
SCALE = "turbo"
RAPID = "#9aa0a6"
TRAVEL = "#b0b0b0"
POWER = "#b5179e"
AXES = ("#d62728", "#2ca02c", "#1f77b4", "#ff7f0e", "#9467bd", "#8c564b")
# The smallest ratio of height to width in the 3D view.
FLATTEST = 0.2

Numbers = NDArray[Any]


@dataclass
class Drawing:
    """Columns of equal length, a row per point; speed is that of the stroke that ends there."""

    tolerance_mm: float
    time_s: Numbers
    points: Numbers  # X Y Z in mm
    speed: Numbers  # mm/min
    rapid: Numbers
    line: Numbers
    power: Numbers

    def strokes(self, rapid: bool) -> Numbers:
        """Return the strokes of one kind: pairs of points."""
        ends = np.flatnonzero(self._of(rapid))
        return np.asarray(np.stack([self.points[ends - 1], self.points[ends]], axis=1))

    def stroke_speeds(self, rapid: bool) -> Numbers:
        """Return the speeds of these strokes."""
        return np.asarray(self.speed[self._of(rapid)])

    def _of(self, rapid: bool) -> Numbers:
        """Return a mask of the points that end strokes of one kind."""
        chosen = np.asarray(self.rapid == rapid)
        chosen[:1] = False  # the first point ends no stroke
        return chosen


def draw(job: "Job", most: int, tolerance_mm: float = TOLERANCE_MM) -> Drawing:
    """Return a job with at most `most` points, plus those between rapids and cuts.

    Points are left out where path and speed stay within a tolerance, which grows until the rest
    are few enough. Speed of a stroke, between two points: its length along the path, divided by
    its time.
    """
    motion = job.motion
    points, rapid = motion.points, motion.rapids
    time_s = np.frombuffer(motion.time_s)
    speed = np.frombuffer(motion.speed_mm_s, np.float32)
    # Speed is a fourth coordinate, scaled so that half a shade of colour is as the tolerance.
    scale = 2 * SHADES * tolerance_mm / (float(speed.max(initial=0)) or 1.0)
    between_kinds = np.flatnonzero(rapid[1:] != rapid[:-1])
    rows, tolerance_mm = fitted(
        np.column_stack([points, speed * np.float32(scale)]), tolerance_mm, between_kinds, most
    )
    # Distance along the path up to each point; [: len(points)] because there may be none.
    path_mm = np.concatenate([[0.0], np.cumsum(_lengths(points))])[: len(points)]
    length, seconds = np.diff(path_mm[rows], prepend=0), np.diff(time_s[rows], prepend=0)
    mm_s = np.divide(length, seconds, out=np.zeros(len(rows)), where=seconds > 0)
    line, power = motion.lines[rows], np.frombuffer(motion.power, np.float32)[rows]
    return Drawing(tolerance_mm, time_s[rows], points[rows], 60 * mm_s, rapid[rows], line, power)


def _lengths(points: Numbers) -> Numbers:
    """Return the distances from each point to the next."""
    return np.asarray(np.sqrt((np.diff(points, axis=0) ** 2).sum(axis=1, dtype=float)))


def fastest(drawings: Sequence[Drawing]) -> float:
    """Return the end of the colour scale, in mm/min: the fastest cut, or the fastest rapid if
    nothing cuts."""
    for rapid in (False, True):  # cuts first
        highest = max(float(each.stroke_speeds(rapid).max(initial=0)) for each in drawings)
        if highest:
            return highest
    return 1.0


def box(drawing: Drawing) -> tuple[Numbers, Numbers]:
    """Return lowest corner and size in mm, X, Y and Z; a side of 0 is made 1."""
    if not len(drawing.points):
        return np.zeros(3), np.ones(3)
    low, high = drawing.points.min(axis=0), drawing.points.max(axis=0)
    size = high - low
    size[size == 0] = 1.0
    return low, size


def travel(job: "Job", drawing: Drawing) -> tuple[Numbers, Numbers] | None:
    """Return a frame of the travel ($130 and $131) with the job in its middle: lowest corner and
    size, X and Y in mm. None unless the job takes more than a third of it in X or Y."""
    low, size = (values[:2] for values in box(drawing))
    frame = np.array(job.limits["travel"][:2])
    is_large = (size * 3 > frame).any()
    return (low + (size - frame) / 2, frame) if is_large else None


def figures(job: "Job") -> list[tuple[str, str]]:
    """Return the job's figures in words, for the top of a drawing: name, value."""
    from .job import short

    motion, totals = job.motion, job.result.totals
    seconds, is_rapid = motion.seconds, motion.rapids
    is_moving = np.frombuffer(motion.block, np.int32) > 0  # 0: a standstill
    speed = np.frombuffer(motion.speed_mm_s, np.float32)
    power = np.frombuffer(motion.power, np.float32)
    rapid_s = float(seconds[is_rapid].sum())
    cut_s = float(seconds[~is_rapid & is_moving].sum())
    rows = [
        ("takes", short(job.seconds)),
        ("of that", f"cuts {short(cut_s)}, rapids {short(rapid_s)}"),
        ("distance", f"{totals.distance_mm:.1f} mm"),
        ("fastest", f"{60 * float(speed.max(initial=0)):.0f} mm/min"),
    ]
    if power.any():
        on_s = float(seconds[power > 0].sum())
        rows.append(("tool", f"on for {short(on_s)}, at {100 * float(power.max()):.0f} % at most"))
    for axis, (letter, (low, high)) in enumerate(totals.bounds_mm.items()):
        travel, used = job.limits["travel"][axis], high - low
        fits = "" if used <= travel else ": TOO FAR"
        rows.append(
            (letter, f"{low:.3f} to {high:.3f} mm: {used:.3f} of {travel:g} (${130 + axis}){fits}")
        )
    if job.program:
        rows.append(("lines", f"{job.result.lines}, {len(job.result.errors)} with errors"))
    return rows


def envelope(time_s: Numbers, values: Numbers, most: int) -> tuple[Numbers, Numbers]:
    """Return the curve with at most `most` points: the lowest and the highest of each section, so
    that no peak is lost."""
    count = len(time_s)
    if count <= most:
        return np.asarray(time_s), np.asarray(values)
    sections = most // 2
    section = -(-count // sections)  # points of a section, rounded up
    begins = np.arange(0, count, section)
    padded = np.full(len(begins) * section, values[-1])  # the last section is filled up
    padded[:count] = values
    table = padded.reshape(len(begins), section)  # a row per section
    rows = np.concatenate([begins + table.argmin(axis=1), begins + table.argmax(axis=1)])
    rows = np.unique(np.minimum(rows, count - 1))  # sorted; padding is the last point
    return np.asarray(time_s)[rows], np.asarray(values)[rows]
