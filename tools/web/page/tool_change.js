// Tool changes: the page pauses for an M6 that the machine refuses, as Grbl does, until the user confirms.

const SAME_PLACE_MM = 0.005;
let toolPause = null; // { modes, place, offsets } of the machine when a page paused; {} until they are known

/** An offset in mm, by its name in $#: of all axes, or of Z for TLO. */
function offsetMm(name) {
  const mm = inMm((grbl.offsets.get(name) || "0,0,0").split(",").map(Number));
  return name === "TLO" ? [0, 0, mm[0]] : mm;
}

/** Position in mm in a work coordinate system, whichever is in force. */
function placeIn(system) {
  const offsets = [system, "G92", "TLO"].map(offsetMm);
  return inMm(grbl.machine).map((mm, axis) => offsets.reduce((left, offset) => left - (offset[axis] || 0), mm));
}

/** Whether a program cuts before it says again what the spindle is to do. */
function cutsFirst(lines, motion) {
  for (const line of lines) {
    const words = wordsOf(line);
    if (words.some(([letter, value]) => letter === "M" && value >= 3 && value <= 5)) return false;
    for (const [letter, value] of words) if (letter === "G" && (value < 4 || value >= 73 && value <= 89)) motion = `G${value}`;
    if (motion !== "G0" && words.some(([letter]) => "XYZ".includes(letter))) return true;
  }
  return false;
}

const modeLike = (pattern) => toolPause.modes.find((word) => pattern.test(word)) || "";

/** Lines that bring the tool back to where the page paused, and restore the modes. */
function toolChangeLines() {
  const system = modeLike(/^G5[4-9]$/), motion = modeLike(/^G([0-3]|80|38\..)$/), spindle = modeLike(/^M[34]$/);
  const feed = inMm([Number(modeLike(/^F/).slice(1))])[0] || (motion === "G1" ? SLOW_MM_MIN : 0), speed = modeLike(/^S/);
  const lines = [`G21 G90 G94 ${system}`, ...wayBack(placeIn(system))];
  const isLaser = grbl.setting(32) === 1; // with M3 it would burn at rest
  if (spindle && !isLaser && cutsFirst([withoutToolChange(job.toolLine.text), ...program.lines.slice(job.line)], motion)) lines.push(`${spindle} ${speed}`, `G4 P${SPIN_UP_S}`);
  if (feed) lines.push(`F${millimetres(feed)} ${speed}`);
  lines.push([/^G[01]$/.test(motion) ? motion : "G80", modeLike(/^G1[789]$/), modeLike(/^G2[01]$/), modeLike(/^G9[01]$/)].join(" "));
  return modeLike(/^G93$/) ? [...lines, "G93"] : lines; // alone: G1 in its line would need an F
}

/** Moves from a place to that of the pause: up, across, down. */
function wayBack(now) {
  const { place } = toolPause, far = (axis) => Math.abs(place[axis] - now[axis]) > SAME_PLACE_MM;
  const to = (letter) => word(letter, place[AXES.indexOf(letter)]), moves = [];
  let z = now[2];
  if (far(0) || far(1)) {
    const safe = Math.max(z, place[2], safeZ());
    if (safe > z) moves.push(`G0 ${word("Z", safe)}`);
    moves.push(`G0 ${to("X")} ${to("Y")}`);
    z = safe;
  }
  return Math.abs(place[2] - z) > SAME_PLACE_MM ? [...moves, `G0 ${to("Z")}`] : moves;
}

/** The highest Z of the program so far. */
const safeZ = () => program.readTo(job.line).highest;

async function beginToolChange() {
  const pause = toolPause = {};
  await grbl.send("$G", true);
  await grbl.send("$#", true);
  const modes = [...grbl.modes], offsets = Object.fromEntries(grbl.offsets);
  if (modes.some((text) => /^M[3478]$/.test(text))) await grbl.send("M5 M9");
  if (toolPause !== pause || job?.state !== "tool") return;
  toolPause = job.pause || { modes, offsets }; // noted by a page that drove before: the machine may have been moved since
  if (!job.pause) {
    toolPause.place = placeIn(modeLike(/^G5[4-9]$/));
    job.pause = toolPause;
    job.share();
  }
  const [, tool] = wordsOf(program.lines[job.line - 1]).find(([letter]) => letter === "T") || [];
  $("tool-title").textContent = tool === undefined ? t`Tool change` : t`Tool change: tool ${tool}`;
  $("tool-words").replaceChildren(t`The program waits in line ${job.line}: `, make("span", { className: "mono" }, program.lines[job.line - 1]));
  renderToolChange();
  $("tool-change").hidden = false;
  if (!$("dialog").open) $("tool-title").focus();
}

function renderToolChange() {
  const safe = safeZ();
  $("tool-up").hidden = !(safe > grbl.workMm()[2] + SAME_PLACE_MM);
  setText("tool-up", t`Raise Z to ${millimetres(safe)}`);
  const changed = ["TLO", ...SYSTEMS].filter((name) => grbl.offsets.get(name) !== toolPause.offsets[name]);
  setText("tool-measured", changed.map((name) => t`${name === "TLO" ? t`Tool length` : name}: ${toolPause.offsets[name]} is ${grbl.offsets.get(name)} now.`).join(" "));
  setText("tool-sends", toolChangeLines().join(", "));
}

grbl.on("change", () => {
  const pauses = job?.state === "tool" && grbl.drives;
  if (pauses && !toolPause && job.rests && asked() && is("Idle")) beginToolChange();
  else if (!pauses && toolPause) endToolPause();
  else if (toolPause?.place) renderToolChange();
});

function endToolPause() {
  toolPause = null;
  $("tool-change").hidden = true;
}

$("tool-go").onclick = () => alone(async () => {
  const pause = toolPause;
  await readAtRest();
  for (const line of toolChangeLines()) {
    if (toolPause !== pause) return;
    await sendLines([line]);
  }
  if (toolPause !== pause) return;
  endToolPause(); // not by the next "change": the answers up to the next M6 may come in one piece
  job.toolChanged();
});
$("tool-end").onclick = () => job.end();
$("tool-up").onclick = () => grbl.send(`$J=G21 G90 ${word("Z", safeZ())} F${zFeed() * (grbl.inches ? MM_PER_INCH : 1)}`);
for (const [id, kind] of [["tool-length", "length"], ["tool-plate", "plate"]]) {
  $(id).onclick = () => {
    probeSet.kind = kind;
    keepProbe();
    renderProbe();
    showTab("offsets");
    $("probe-run").focus();
  };
}

// Pauses of the machine itself: M0, or a question of custom.py

let saidInJob = "";
grbl.on("line", (text) => { if (busy() && text.startsWith("[MSG:")) saidInJob = text.slice(5, -1); });
grbl.on("status", () => {
  const waits = busy() && NEEDS.waiting() && grbl.detail === "0" && saidInJob;
  if (waits && !$("notice-pause")) notice("pause", t`The machine waits. Its last message: ${saidInJob}`, { kind: "warn", buttons: [[t`Go on`, resume]] });
  if (waits || !$("notice-pause")) return;
  unsay("pause");
  saidInJob = "";
});
