"""The text of the page that tools/draw/page.py fills: HTML, and the script that draws.

Columns are compressed. One index is common to path, charts and program, so that a moment in one is
shown in all.
"""

PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="generator" content="ugrbl plot">
<title>@title@</title>
<style>
body { font: 15px/1.5 system-ui, sans-serif; margin: 1.5rem auto; max-width: 1500px;
  padding: 0 1rem; color: #222 }
h1 { font-size: 1.3rem; margin: 0 }
h2 { font-size: 1rem; margin: 0.5rem 0 0 }
p { margin: 0.3rem 0 }
button { font: inherit; padding: 0.2rem 0.8rem }
#jobs { display: flex; gap: 3rem; flex-wrap: wrap }
td { padding: 0 1rem 0 0; vertical-align: top }
td.bad { color: #c00; font-weight: bold }
#now { position: sticky; top: 0; background: #fffe; z-index: 9; padding: 0.3rem 0 }
#moment { width: 100% }
#told { font: 14px/1.5 ui-monospace, monospace; white-space: pre-wrap; min-height: 3em }
#space { height: 620px }
#flat { height: 560px }
#time { height: 900px }
</style>
<h1>@title@</h1>
<p id="words">@words@</p>
<div id="jobs"></div>
<div id="now">
<input type="range" id="moment" min="0" value="0" step="any" aria-label="moment in seconds">
<div id="told"></div>
</div>
<p><button data-up="0">in space</button> <button data-up="1">from above</button></p>
<div id="space"></div>
<div id="flat"></div>
<div id="time"></div>
<noscript>This page draws with JavaScript.</noscript>
<script type="text/plain" id="figures">@figures@</script>
<script type="text/plain" id="library">@library@</script>
<script>
@script@
</script>
</html>
"""

SCRIPT = r"""
const by = (id) => document.getElementById(id);
const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
const column = ([kind, text]) =>
  new { f4: Float32Array, f8: Float64Array, i4: Int32Array, u1: Uint8Array }[kind](
    bytes(text).buffer);
const views = [
  { eye: { x: -0.9, y: -1.5, z: 1.1 }, up: { x: 0, y: 0, z: 1 } },
  { eye: { x: 0, y: 0, z: 1.9 }, up: { x: 0, y: 1, z: 0 } },
];
const GAP = 0.06;
let page, jobs;

async function unpacked(id) {
  const stream = new Blob([bytes(by(id).textContent)]).stream();
  return new Response(stream.pipeThrough(new DecompressionStream("gzip"))).text();
}
const numbered = (name, index) => name + (index ? index + 1 : "");
function side(index) {
  const width = (1 - GAP * (jobs.length - 1)) / jobs.length;
  return [index * (width + GAP), index * (width + GAP) + width];
}
const titles = () => jobs.map((job, index) => ({
  text: job.name, x: (side(index)[0] + side(index)[1]) / 2, y: 1, xref: "paper", yref: "paper",
  xanchor: "center", yanchor: "bottom", showarrow: false }));

// The points at which strokes that are wanted end, with those where they begin, and -1 for a gap.
function strokes(job, wanted) {
  const rows = [];
  let last = -1;
  for (let row = 1; row < job.x.length; row++) {
    if (!wanted(row)) continue;
    if (last !== row - 1) rows.push(-1, row - 1);
    rows.push(row);
    last = row;
  }
  return Int32Array.from(rows);
}
const pick = (values, rows) => Float32Array.from(rows, (row) => (row < 0 ? NaN : values[row]));
function trace(job, rows, more) {
  return { mode: "lines", x: pick(job.x, rows), y: pick(job.y, rows), rows,
    customdata: Array.from(rows, (row) => (row < 0 ? "" : job.line[row])),
    hovertemplate: "X %{x:.3f} Y %{y:.3f}<br>line %{customdata}<extra></extra>", ...more };
}
const cut = (job) => (row) => !job.rapid[row];
const rapid = (job) => (row) => job.rapid[row];
const spot = (more) => ({ mode: "markers", x: [0], y: [0], hoverinfo: "skip", showlegend: false,
  marker: { size: 7, color: "#fff", line: { color: "#000", width: 2 } }, ...more });

function space() {
  const data = [];
  const layout = { margin: { l: 0, r: 0, t: 30, b: 0 }, annotations: titles(),
    legend: { x: 0, y: 1 } };
  jobs.forEach((job, index) => {
    const scene = numbered("scene", index);
    const common = { type: "scatter3d", scene, showlegend: index === 0 };
    const rows = strokes(job, cut(job));
    data.push(trace(job, rows, { ...common, z: pick(job.z, rows), name: "cuts",
      line: { color: pick(job.speed, rows), colorscale: page.scale, cmin: 0, cmax: page.fastest,
        width: 3, showscale: index === 0, colorbar: { title: { text: "mm/min" }, len: 0.8 } } }));
    const fast = strokes(job, rapid(job));
    data.push(trace(job, fast, { ...common, z: pick(job.z, fast), name: "rapids",
      line: { color: page.rapid, width: 1, dash: "dash" } }));
    data.push({ ...common, ...spot({ z: [0] }) });
    layout[scene] = { domain: { x: side(index), y: [0, 1] }, aspectmode: "manual",
      aspectratio: job.shape, camera: views[0],
      ...Object.fromEntries(["x", "y", "z"].map(
        (axis) => [axis + "axis", { title: { text: axis.toUpperCase() + " mm" } }])) };
  });
  return { data, layout };
}

function flat() {
  const data = [];
  const layout = { annotations: titles(), margin: { t: 30 }, shapes: [], hovermode: "closest" };
  const named = new Set();
  const shades = page.scale.length;
  const shade = (job, row) =>
    Math.min(Math.floor((shades * job.speed[row]) / page.fastest), shades - 1);
  jobs.forEach((job, index) => {
    const axes = { xaxis: numbered("x", index), yaxis: numbered("y", index) };
    const add = (rows, name, rank, line) => {
      if (!rows.length) return;
      data.push(trace(job, rows, { type: "scattergl", ...axes, name, line, legendgroup: name,
        legendrank: rank, showlegend: !named.has(name) }));
      named.add(name);
    };
    add(strokes(job, rapid(job)), "rapids", 0, { width: 1, color: page.rapid, dash: "dash" });
    for (let step = 0; step < shades; step++)
      add(strokes(job, (row) => !job.rapid[row] && shade(job, row) === step),
        `${Math.round((step * page.fastest) / shades)} mm/min and more`, step + 1,
        { width: 1.2, color: page.scale[step][1] });
    if (job.marks.length)
      data.push({ type: "scattergl", mode: "markers", ...axes, name: "holes",
        x: job.marks.map((at) => at[0]), y: job.marks.map((at) => at[1]),
        marker: { symbol: "circle-open", color: "#000" } });
    data.push({ type: "scattergl", ...axes, ...spot({}) });
    if (job.frame)
      layout.shapes.push({ type: "rect", xref: axes.xaxis, yref: axes.yaxis, ...job.frame,
        line: { color: page.travel, dash: "dot" }, layer: "below" });
    layout[numbered("xaxis", index)] = { domain: side(index), title: { text: "X mm" } };
    layout[numbered("yaxis", index)] = { scaleanchor: axes.xaxis, anchor: axes.xaxis,
      title: { text: "Y mm" } };
  });
  return { data, layout };
}

function time() {
  const data = [];
  const layout = { annotations: titles(), margin: { t: 30 }, hovermode: "x unified", shapes: [] };
  const count = page.charts.length;
  jobs.forEach((job, index) => {
    const x = numbered("x", index);
    layout[numbered("xaxis", index)] = { domain: side(index), title: { text: "seconds" },
      anchor: numbered("y", count * index + count - 1), ...(index ? { matches: "x" } : {}) };
    page.charts.forEach((title, row) => {
      const y = numbered("y", count * index + row);
      const top = 1 - row / count;
      layout[numbered("yaxis", count * index + row)] = { domain: [top - 0.86 / count, top],
        anchor: x, ...(index ? { matches: numbered("y", row) } : { title: { text: title } }) };
      for (const curve of job.curves[row])
        data.push({ type: "scatter", mode: "lines", x: column(curve.time), y: column(curve.value),
          xaxis: x, yaxis: y, name: curve.name, line: { width: 1, color: curve.colour },
          legendgroup: curve.name, showlegend: index === 0 && row < 2 });
    });
  });
  return { data, layout };
}

// The stroke under way at a moment, and how much of it is done.
function at(job, moment) {
  let low = 0;
  let high = job.time.length - 1;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (job.time[middle] < moment) low = middle + 1;
    else high = middle;
  }
  const before = Math.max(low - 1, 0);
  const long = job.time[low] - job.time[before];
  const done = long > 0 ? Math.min(Math.max((moment - job.time[before]) / long, 0), 1) : 1;
  const place = [job.x, job.y, job.z].map(
    (values) => values[before] + done * (values[low] - values[before]));
  return { row: low, place };
}

function tell(job, moment, { row, place }) {
  const line = job.line[row];
  const words = [`${moment.toFixed(2)} s`,
    ...["X", "Y", "Z"].map((axis, i) => `${axis} ${place[i].toFixed(3)}`),
    job.rapid[row] ? "rapid" : `${Math.round(job.speed[row])} mm/min`,
    `tool ${Math.round(100 * job.power[row])} %`,
    line ? `line ${line}: ${page.program[line - 1] || ""}` : "at rest"];
  return (jobs.length > 1 ? job.name + ": " : "") + words.join("   ");
}

let wanted = null;
let showing = false;
// Show a moment everywhere; the last one asked for counts, where drawing is slower than asking.
async function show(moment) {
  wanted = moment;
  if (showing) return;
  showing = true;
  while (wanted !== null) {
    const now = wanted;
    wanted = null;
    await draw_moment(now);
  }
  showing = false;
}
const spots = (name) => by(name).data.map((one, i) => i)
  .filter((i) => by(name).data[i].mode === "markers" && by(name).data[i].hoverinfo === "skip");
async function draw_moment(moment) {
  const found = jobs.map((job) => at(job, moment));
  by("moment").value = moment;
  by("told").textContent = jobs.map((job, i) => tell(job, moment, found[i])).join("\n");
  const to = (axis) => found.map(({ place }) => [place[axis]]);
  await Plotly.restyle("space", { x: to(0), y: to(1), z: to(2) }, spots("space"));
  await Plotly.restyle("flat", { x: to(0), y: to(1) }, spots("flat"));
  await Plotly.relayout("time", { shapes: jobs.map((job, i) => ({ type: "line", yref: "paper",
    xref: numbered("x", i), x0: moment, x1: moment, y0: 0, y1: 1,
    line: { width: 1, color: "#000" } })) });
}

function link(name, moment_of) {
  for (const event of ["plotly_hover", "plotly_click"])
    by(name).on(event, ({ points }) => {
      const moment = moment_of(points[0]);
      if (moment !== undefined) show(moment);
    });
}
function moment_on_path({ data, pointNumber }, job_of) {
  const row = data.rows ? data.rows[pointNumber] : -1;
  return row >= 0 ? jobs[job_of(data)].time[row] : undefined;
}
const number = (name) => Number(/\d+$/.exec(name || "1")?.[0] || 1) - 1;

function tables() {
  by("jobs").innerHTML = "";
  for (const job of jobs) {
    const part = document.createElement("div");
    const head = part.appendChild(document.createElement("h2"));
    head.textContent = job.name;
    const table = part.appendChild(document.createElement("table"));
    for (const [name, what] of job.figures) {
      const cells = table.insertRow();
      cells.insertCell().textContent = name;
      const cell = cells.insertCell();
      cell.textContent = what;
      cell.className = /TOO FAR|[1-9]\d* with errors/.test(what) ? "bad" : "";
    }
    by("jobs").append(part);
  }
}

async function draw() {
  const script = document.createElement("script");
  script.textContent = await unpacked("library");
  document.head.append(script);
  page = JSON.parse(await unpacked("figures"));
  page.program = page.program.split("\n");
  jobs = page.jobs;
  for (const job of jobs)
    for (const name of ["x", "y", "z", "speed", "rapid", "line", "power", "time"])
      job[name] = column(job[name]);
  tables();
  for (const [name, figure] of [["flat", flat()], ["time", time()], ["space", space()]])
    await Plotly.newPlot(name, figure.data, figure.layout,
      { responsive: true, displaylogo: false });
  by("moment").max = Math.max(...jobs.map((job) => job.time.at(-1) || 0));
  by("moment").oninput = () => show(Number(by("moment").value));
  link("space", (point) => moment_on_path(point, (data) => number(data.scene)));
  link("flat", (point) => moment_on_path(point, (data) => number(data.xaxis)));
  link("time", (point) => point.x);
  for (const button of document.querySelectorAll("button")) {
    button.onclick = () => {
      const camera = views[button.dataset.up];
      const scenes = Object.keys(by("space").layout).filter((name) => /^scene/.test(name));
      Plotly.relayout("space",
        Object.fromEntries(scenes.map((name) => [name + ".camera", camera])));
    };
  }
  await show(0);
  document.body.dataset.drawn = "yes";
}
draw().catch((why) => { by("words").textContent += " Not drawn: " + why; });
"""
