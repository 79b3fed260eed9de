"""Jobs as one page for a browser: it can be turned, zoomed and read off, and needs no network.

The page carries plotly.js, packed; the browser unpacks it, which those since 2023 can.
"""

import base64
import gzip
import html
import json
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from . import picture
from .motion_trace import LETTERS
from .plot import Job, envelope, short
from .plot_image import path_speeds, thinned

_STROKES = 12_000
_STROKES_FLAT = 6000
_POINTS = 4000
# Lines in the plane have one colour each: so many of them make the scale.
_BINS = 12
_COLOURS = ("#d62728", "#2ca02c", "#1f77b4", "#ff7f0e", "#9467bd", "#8c564b")
_GAP = 0.06

_PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<title>{title}</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; margin: 1.5rem auto; max-width: 1500px;
  padding: 0 1rem; color: #222 }}
h1 {{ font-size: 1.3rem; margin: 0 }}
p {{ margin: 0.3rem 0 1rem }}
button {{ font: inherit; padding: 0.2rem 0.8rem }}
#space {{ height: 620px }}
#flat {{ height: 560px }}
#time {{ height: 820px }}
</style>
<h1>{title}</h1>
<p id="words">{words}</p>
<p><button data-up="0">in space</button> <button data-up="1">from above</button></p>
<div id="space"></div>
<div id="flat"></div>
<div id="time"></div>
<noscript>This page draws with JavaScript.</noscript>
<script type="application/json" id="figures">{figures}</script>
<script type="text/plain" id="library">{library}</script>
<script>
const fail = (why) => {{ document.getElementById("words").textContent += " Not drawn: " + why; }};
const views = [
  {{ eye: {{ x: -0.9, y: -1.5, z: 1.1 }}, up: {{ x: 0, y: 0, z: 1 }} }},
  {{ eye: {{ x: 0, y: 0, z: 1.9 }}, up: {{ x: 0, y: 1, z: 0 }} }},
];
async function draw() {{
  const packed = atob(document.getElementById("library").textContent);
  const bytes = Uint8Array.from(packed, (letter) => letter.charCodeAt(0));
  const unpacked = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  const script = document.createElement("script");
  script.textContent = await new Response(unpacked).text();
  document.head.append(script);
  const figures = JSON.parse(document.getElementById("figures").textContent);
  for (const name of ["flat", "time", "space"]) {{
    const {{ data, layout }} = figures[name];
    await Plotly.newPlot(name, data, layout, {{ responsive: true, displaylogo: false }});
  }}
  for (const button of document.querySelectorAll("button")) {{
    button.onclick = () => {{
      const camera = views[button.dataset.up];
      const scenes = Object.keys(figures.space.layout).filter((name) => /^scene/.test(name));
      const changes = scenes.map((name) => [name + ".camera", camera]);
      Plotly.relayout("space", Object.fromEntries(changes));
    }};
  }}
  document.body.dataset.drawn = "yes";
}}
draw().catch(fail);
</script>
</html>
"""


def page(jobs: Sequence[Job], title: str, words: str) -> str:
    """The text of the page."""
    fastest = max(picture.fast(job.strokes(), path_speeds(job.strokes())) for job in jobs)
    figures = {
        "space": _space(jobs, fastest),
        "flat": _flat(jobs, fastest),
        "time": _time(jobs),
    }
    data = json.dumps(figures, separators=(",", ":")).replace("</", "<\\/")
    return _PAGE.format(
        title=html.escape(title), words=html.escape(words), figures=data, library=_library()
    )


def _library() -> str:
    """plotly.js, packed, as text."""
    try:
        from plotly.offline import get_plotlyjs  # type: ignore[import-untyped,unused-ignore]
    except ImportError as error:
        raise ValueError("a page needs plotly: pip install plotly; or draw a .png") from error
    packed = gzip.compress(get_plotlyjs().encode(), 9, mtime=0)
    return base64.b64encode(packed).decode()


def _label(job: Job) -> str:
    return f"{job.name}: {short(job.seconds)}"


def _side(index: int, count: int) -> list[float]:
    """The part of the width that job number index has."""
    width = (1 - _GAP * (count - 1)) / count
    return [index * (width + _GAP), index * (width + _GAP) + width]


def _titles(jobs: Sequence[Job]) -> list[dict[str, Any]]:
    """A heading over each job's column."""
    return [
        {
            "text": html.escape(_label(job)),
            "x": sum(_side(index, len(jobs))) / 2,
            "y": 1.0,
            "xref": "paper",
            "yref": "paper",
            "xanchor": "center",
            "yanchor": "bottom",
            "showarrow": False,
        }
        for index, job in enumerate(jobs)
    ]


def _space(jobs: Sequence[Job], fastest: float) -> dict[str, Any]:
    """The path in space, each point coloured by the speed of its stroke."""
    scale = [[step / (_BINS - 1), _colour(step)] for step in range(_BINS)]
    data = []
    layout: dict[str, Any] = {
        "margin": {"l": 0, "r": 0, "t": 30, "b": 0},
        "annotations": _titles(jobs),
        "showlegend": False,
    }
    for index, job in enumerate(jobs):
        path = thinned(job.strokes(), _STROKES)
        speeds = [round(speed) for speed in [0.0, *path_speeds(path)]]
        line = {"color": speeds, "colorscale": scale, "cmin": 0, "cmax": fastest, "width": 3}
        if index == 0:
            line |= {"showscale": True, "colorbar": {"title": {"text": "mm/min"}, "len": 0.8}}
        scene = f"scene{index + 1 if index else ''}"
        data.append(
            {
                "type": "scatter3d",
                "mode": "lines",
                "scene": scene,
                "line": line,
                **{name: [round(s[i], 3) for s in path] for i, name in enumerate("xyz")},
                "text": [f"{speed} mm/min" for speed in speeds],
                "name": _label(job),
            }
        )
        layout[scene] = _scene(_side(index, len(jobs)), path)
    return {"data": data, "layout": layout}


def _scene(side: Sequence[float], path: Sequence[picture.Stroke]) -> dict[str, Any]:
    _, size = picture.box(path)
    longest = max(size)
    shape = [size[0], size[1], max(size[2], picture.FLATTEST * longest)]
    return {
        "domain": {"x": side, "y": [0, 1]},
        "aspectmode": "manual",
        "aspectratio": {name: mm / longest * 1.2 for name, mm in zip("xyz", shape, strict=True)},
        "camera": {"eye": {"x": -0.9, "y": -1.5, "z": 1.1}},
        **{f"{name}axis": {"title": {"text": f"{name.upper()} mm"}} for name in "xyz"},
    }


def _flat(jobs: Sequence[Job], fastest: float) -> dict[str, Any]:
    """The path from above, in as many colours as the scale has steps."""
    data = []
    layout: dict[str, Any] = {"annotations": _titles(jobs), "margin": {"t": 30}}
    named = set()
    for index, job in enumerate(jobs):
        number = str(index + 1) if index else ""
        path = thinned(job.strokes(), _STROKES_FLAT)
        for step, (xs, ys) in enumerate(_binned(path, fastest)):
            if not xs:
                continue
            data.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "x": xs,
                    "y": ys,
                    "xaxis": f"x{number}",
                    "yaxis": f"y{number}",
                    "line": {"width": 1.2, "color": _colour(step)},
                    "name": f"{step * fastest / _BINS:.0f} mm/min and more",
                    "legendgroup": str(step),
                    "legendrank": step,
                    "showlegend": step not in named,
                    "hoverinfo": "x+y+name",
                }
            )
            named.add(step)
        side = _side(index, len(jobs))
        layout[f"xaxis{number}"] = {"domain": side, "title": {"text": "X mm"}}
        layout[f"yaxis{number}"] = {
            "scaleanchor": f"x{number}",
            "anchor": f"x{number}",
            "title": {"text": "Y mm"},
        }
    return {"data": data, "layout": layout}


def _binned(
    path: Sequence[picture.Stroke], fastest: float
) -> list[tuple[list[float | None], list[float | None]]]:
    """Strokes by speed; within a colour, those that do not join are parted by a gap."""
    bins: list[tuple[list[float | None], list[float | None]]] = [([], []) for _ in range(_BINS)]
    previous = -1
    for (a, b), speed in zip(pairwise(path), path_speeds(path), strict=True):
        step = min(int(_BINS * speed / fastest), _BINS - 1)
        xs, ys = bins[step]
        if step != previous:
            xs += [None, round(a.x, 3)]
            ys += [None, round(a.y, 3)]
        xs.append(round(b.x, 3))
        ys.append(round(b.y, 3))
        previous = step
    return bins


def _colour(step: int) -> str:
    """The colour of one step of the scale, as the picture's."""
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return str(to_hex(colormaps["turbo"](step / (_BINS - 1))))


def _time(jobs: Sequence[Job]) -> dict[str, Any]:
    """Speed, acceleration and step rate over time; jobs side by side, on one scale each."""
    data: list[dict[str, Any]] = []
    layout: dict[str, Any] = {
        "annotations": _titles(jobs),
        "margin": {"t": 30},
        "hovermode": "x unified",
    }
    names = ("speed, mm/min", "acceleration, mm/s²", "steps per second")
    for index, job in enumerate(jobs):
        motion = job.motion
        x = str(index + 1) if index else ""
        lowest = f"y{3 * index + 3}"
        layout[f"xaxis{x}"] = {"domain": _side(index, len(jobs)), "anchor": lowest}
        layout[f"xaxis{x}"]["title"] = {"text": "seconds"}
        if index:
            layout[f"xaxis{x}"]["matches"] = "x"
        speed = [60 * mm_s for mm_s in motion.speed_mm_s]
        columns: tuple[Sequence[Sequence[float]], ...] = (
            [speed],
            motion.acceleration,
            motion.step_hz,
        )
        for row, (name, curves) in enumerate(zip(names, columns, strict=True)):
            first = 3 * index + row
            y = str(first + 1) if first else ""
            top = 1 - row / 3
            axis: dict[str, Any] = {"domain": [top - 0.28, top], "anchor": f"x{x}"}
            if index:
                axis["matches"] = f"y{row + 1 if row else ''}"
            else:
                axis["title"] = {"text": name}
            layout[f"yaxis{y}"] = axis
            for letter, curve in zip(LETTERS, curves, strict=False):
                data.append(_curve(job, curve, letter if row else "", f"x{x}", f"y{y}", index))
    return {"data": data, "layout": layout}


def _curve(
    job: Job, values: Sequence[float], letter: str, x: str, y: str, index: int
) -> dict[str, Any]:
    times, kept = envelope(job.motion.time_s, values, _POINTS)
    colour = _COLOURS[LETTERS.index(letter)] if letter else "#222"
    return {
        "type": "scatter",
        "mode": "lines",
        "x": [round(time, 3) for time in times],
        "y": [round(value, 1) for value in kept],
        "xaxis": x,
        "yaxis": y,
        "name": letter or "along the path",
        "line": {"width": 1, "color": colour},
        "legendgroup": letter,
        "showlegend": index == 0 and y in ("y", "y2"),
    }
