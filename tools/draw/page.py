"""Jobs as one page for a browser: it can be rotated and zoomed, shows values, and needs no
network.

The page contains plotly.js and its figures, compressed; browsers since 2023 can decompress them.
Everything is drawn by WebGL, so that a long job can be drawn completely.
"""

import base64
import gzip
import html
import json
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from . import drawing
from .drawing import Drawing, Numbers, envelope
from .job import Job, short
from .motion_trace import LETTERS, MEAN_S
from .script import PAGE, SCRIPT

# The most points that a browser rotates without delay. Above it the tolerance grows, and the page
# says so.
_MOST = 600_000
_POINTS = 4000
_KINDS = {"f4": np.float32, "f8": np.float64, "i4": np.int32, "u1": np.uint8}
_CHARTS = (
    "speed, mm/min",
    f"acceleration, mm/s²,<br>mean of {MEAN_S * 1000:.0f} ms",
    "steps per second",
    "spindle or laser, %",
)


def page(jobs: Sequence[Job], title: str, words: str) -> str:
    """Return the text of the page."""
    drawings = [drawing.draw(job, _MOST // len(jobs)) for job in jobs]
    figures = {
        "fastest": drawing.fastest(drawings),
        "scale": [[step / (drawing.SHADES - 1), _colour(step)] for step in range(drawing.SHADES)],
        "rapid": drawing.RAPID,
        "travel": drawing.TRAVEL,
        "charts": _CHARTS,
        "program": "\n".join(line.decode("latin-1") for line in jobs[0].program),
        "jobs": [_job(job, drawn) for job, drawn in zip(jobs, drawings, strict=True)],
    }
    parts = {
        "title": html.escape(title),
        "words": html.escape(words),
        "figures": _packed(json.dumps(figures, separators=(",", ":"))),
        "library": _library(),
        "script": SCRIPT,
    }
    return re.sub(r"@(\w+)@", lambda match: parts[match[1]], PAGE)  # fills in @title@, …


def _packed(text: str) -> str:
    """Return a text compressed (gzip), in base64."""
    return base64.b64encode(gzip.compress(text.encode(), 6, mtime=0)).decode()


def _library() -> str:
    """Return plotly.js, compressed, as text."""
    try:
        from plotly.offline import get_plotlyjs  # type: ignore[import-untyped,unused-ignore]
    except ImportError as error:
        raise ValueError("a page needs plotly: pip install plotly; or draw a .png") from error
    return _packed(get_plotlyjs())


def _column(values: Numbers, kind: str) -> tuple[str, str]:
    """Return numbers for the script: their type, and their bytes."""
    return kind, base64.b64encode(np.ascontiguousarray(values, _KINDS[kind]).tobytes()).decode()


def _job(job: Job, drawn: Drawing) -> dict[str, Any]:
    """Return the data of a job for the script (script.py): figures, columns and curves."""
    figures = [
        *drawing.figures(job),
        ("drawn", f"at most {drawn.tolerance_mm:g} mm off the path"),
    ]
    columns: dict[str, tuple[Numbers, str]] = {
        # Values with their type in numpy, which the script reads.
        **{name: (drawn.points[:, i], "f4") for i, name in enumerate("xyz")},
        "time": (drawn.time_s, "f8"),
        "speed": (drawn.speed, "f4"),
        "rapid": (drawn.rapid, "u1"),
        "line": (drawn.line, "i4"),
        "power": (drawn.power, "f4"),
    }
    return {
        "name": f"{job.name}: {short(job.seconds)}",
        "figures": figures,
        "shape": _shape(drawn),
        "frame": _frame(job, drawn),
        "marks": [list(mark) for mark in job.marks],
        "curves": list(_curves(job)),
        **{name: _column(values, kind) for name, (values, kind) in columns.items()},
    }


def _shape(drawn: Drawing) -> dict[str, float]:
    """Return the sides of the 3D view, in plotly's units: the longest is 1.2. The height is
    visible, however small."""
    _, size = drawing.box(drawn)
    longest = float(max(size))
    sides = [size[0], size[1], max(size[2], drawing.FLATTEST * longest)]
    return {name: 1.2 * float(mm) / longest for name, mm in zip("xyz", sides, strict=True)}


def _frame(job: Job, drawn: Drawing) -> dict[str, float] | None:
    """Return the corners of drawing.travel(), the frame of the machine's travel; None if the job
    is much smaller."""
    place = drawing.travel(job, drawn)
    if place is None:
        return None
    low, size = place
    return {
        "x0": float(low[0]),
        "y0": float(low[1]),
        "x1": float(low[0] + size[0]),
        "y1": float(low[1] + size[1]),
    }


def _curves(job: Job) -> "Sequence[list[dict[str, Any]]]":
    """Return the curves over time, for each chart in the order of _CHARTS."""
    motion = job.motion
    speed = 60 * np.frombuffer(motion.speed_mm_s, np.float32)
    power = 100 * np.frombuffer(motion.power, np.float32)
    axes = list(zip(LETTERS, drawing.AXES, motion.axes(), strict=False))
    return [
        [_curve(job, speed, "along the path", "#222")],
        [_curve(job, motion.acceleration(i), name, colour) for name, colour, i in axes],
        [_curve(job, motion.step_hz(i), name, colour) for name, colour, i in axes],
        [_curve(job, power, "power", drawing.POWER)],
    ]


def _curve(job: Job, values: Numbers, name: str, colour: str) -> dict[str, Any]:
    """Return a curve for the script, with at most _POINTS points."""
    times, kept = envelope(np.frombuffer(job.motion.time_s), values, _POINTS)
    return {
        "name": name,
        "colour": colour,
        "time": _column(times, "f8"),
        "value": _column(kept, "f4"),
    }


def _colour(step: int) -> str:
    """Return the colour of a step, 0 to SHADES - 1, of the scale, the same as in pictures."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return str(to_hex(colormaps[drawing.SCALE](step / (drawing.SHADES - 1))))
