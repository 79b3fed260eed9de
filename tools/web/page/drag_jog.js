// Jog in the drawing: the machine follows a dragged point while it is held, and stops on release.

const GRAB_PX = 26;
let dragJog = false, dragHeld = null; // by a pointer, its number, or by "Enter"
let dragFrom = null; // [pointer X, Y, point X, Y] at the grab

/** X and Y of the point, in mm; null if the machine's place is not known. */
const pointAt = () => plot.target || (grbl.work.length ? grbl.workMm().slice(0, 2) : null);

function showPoint(point) {
  plot.toolAt(plot.place, point);
  const [x, y] = (pointAt() || []).map(millimetres);
  $("drag-words").textContent = t`Drag the point at X${x} Y${y}: the machine follows at the jog feed, and stops when you let go. By keys: arrows move the point by a step, Enter held goes there.`;
}

/** Move towards the point, as long as it is held. */
function followPoint() {
  const at = grbl.workMm(), shift = plot.target.map((mm, axis) => mm - at[axis]);
  jogger.follow(inMm(grbl.machine).map((mm, axis) => mm + (shift[axis] || 0)));
}

function setDragJog(on) {
  dragJog = on;
  $("drag").setAttribute("aria-pressed", String(on));
  $("drag-words").hidden = !on;
  $("plot").setAttribute("role", on ? "application" : "img");
  if (on && !plot.flat) $("turn").click(); // a point of a view from the side has no X and Y
  endDrag("abort");
  plot.toolAt(plot.place, null);
  if (on) showPoint(null);
}

/** how: "release" or "abort", of what this drawing has begun. */
function endDrag(how, held = dragHeld) {
  if (dragHeld === null || dragHeld !== held) return false;
  dragHeld = null;
  jogger[how]();
  plot.toolAt(plot.place, null);
  return true;
}

$("drag").onclick = () => setDragJog(!dragJog);
$("turn").addEventListener("click", () => { if (!plot.flat) setDragJog(false); });

/** Hear an event of the drawing before it is panned. */
function onPlot(name, act) {
  $("plot").addEventListener(name, (event) => {
    if (dragJog && event.target === $("tool") && act(event)) event.stopPropagation();
  }, true);
}

onPlot("pointerdown", (event) => {
  const point = pointAt();
  if (event.button !== 0 || dragHeld !== null || !point || !NEEDS.jog()) return false;
  const [x, y] = plot.pixel([...point, 0]);
  if (Math.hypot(event.offsetX - x, event.offsetY - y) > GRAB_PX) return false;
  $("tool").setPointerCapture(event.pointerId);
  dragHeld = event.pointerId;
  dragFrom = [...plot.placeAt(event.offsetX, event.offsetY), ...point];
  return true;
});
onPlot("pointermove", (event) => {
  if (event.pointerId !== dragHeld) return false;
  const [fromX, fromY, x, y] = dragFrom, [toX, toY] = plot.placeAt(event.offsetX, event.offsetY);
  showPoint([x + toX - fromX, y + toY - fromY]);
  followPoint();
  return true;
});
onPlot("pointerup", (event) => endDrag("release", event.pointerId));
onPlot("pointercancel", (event) => endDrag("abort", event.pointerId));
onPlot("lostpointercapture", (event) => endDrag("abort", event.pointerId));

// The same by keys

$("plot").addEventListener("keydown", (event) => {
  const way = dragJog && !event.ctrlKey && !event.altKey && !event.metaKey && KEYS[event.key], point = pointAt();
  if (!point || event.key.startsWith("Page")) return;
  if (way) showPoint(point.map((mm, axis) => mm + way[axis] * step * (grbl.inches ? MM_PER_INCH : 1)));
  else if (!dragJog || event.key !== "Enter") return;
  else if (!event.repeat && dragHeld === null && plot.target && NEEDS.jog()) {
    dragHeld = event.key;
    followPoint();
  }
  event.preventDefault();
  event.stopPropagation(); // arrows do not jog as well
});
$("plot").addEventListener("keyup", (event) => endDrag("release", event.key));
$("plot").addEventListener("blur", () => endDrag("abort"));
