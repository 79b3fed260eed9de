// Probing: a plate, an edge, a corner, a hole, tool lengths; each shows its lines before it sends them.

const PROBE_AS = "ugrbl-probe", SLOW_PART = 0.25, BACK_MM = 1;
const LOSE_PLACE = [1, 3, 6, 7, 8, 9]; // alarms after which the machine does not know where it is
const PROBE_FIELDS = {
  plate: [t`Plate`, "mm", 1.5], tool: [t`Tool`, "mm", 3], far: [t`At most`, "mm", 20], feed: [t`Feed`, "mm/min", 100], up: [t`Then up`, "mm", 5], columns: [t`Columns`, "", 4], rows: [t`Rows`, "", 3],
};
/** The sides from which an edge is probed: axis and sign of the motion. */
const PROBE_SIDES = { left: ["X", 1], right: ["X", -1], front: ["Y", 1], back: ["Y", -1] };
const SIDE_WORDS = { left: t`left`, right: t`right`, front: t`front`, back: t`back` };
const PROBE_KINDS = {
  plate: { title: t`Plate`, fields: ["plate", "far", "feed", "up"], words: t`A plate lies on the work, the tool is above it. Sets Z of the coordinate system in force.`,
    picture: [["work", 20, 60, 80, 20], ["metal", 45, 52, 30, 8], ["tool", 57, 10, 6, 24]], way: "M60 36v14", lines: plateLines },
  edge: { title: t`Edge`, fields: ["side", "tool", "plate", "far", "feed"], words: t`The tool is outside the work, below its top. A plate on the edge counts with its thickness; none is 0.`,
    picture: [["work", 55, 40, 60, 40], ["tool", 20, 16, 6, 44]], way: "M30 55h22", lines: edgeLines },
  corner: { title: t`Corner`, fields: ["tool", "plate", "far", "feed", "up"], words: t`The tool is left of the work, nearer to its front than At most, below its top. It finds the left side, goes round and finds the front: that corner is X0 Y0 then.`,
    picture: [["work", 45, 10, 70, 50], ["tool", 22, 64, 12, 12]], way: "M34 62l20-20", lines: cornerLines },
  hole: { title: t`Hole`, fields: ["tool", "far", "feed"], words: t`The tool is in a hole or ring, below its top. Its middle is X0 Y0 then.`,
    picture: [["work", 10, 10, 100, 70], ["metal", 35, 20, 50, 50], ["tool", 56, 41, 8, 8]], way: "M50 45h-12M70 45h12M60 36v-12M60 54v12", lines: holeLines, run: probeHole },
  length: { title: t`Tool length`, fields: ["far", "feed", "up"], words: t`Over a fixed plate. The first tool is the one by which zero was set; later ones get the difference (G43.1).`,
    picture: [["metal", 35, 66, 50, 12], ["tool", 56, 10, 8, 36]], way: "M60 48v14", lines: lengthLines, run: probeLength },
};
const probeSet = { kind: "plate", side: "left", ...readProbe() };

function readProbe() {
  try {
    const { reference, ...kept } = JSON.parse(localStorage.getItem(PROBE_AS)) || {};
    return { ...kept, ...JSON.parse(sessionStorage.getItem(PROBE_AS)) };
  } catch (error) {
    console.info("no probe settings:", error.message);
    return {};
  }
}
function keepProbe() {
  try {
    localStorage.setItem(PROBE_AS, JSON.stringify(probeSet));
    sessionStorage.setItem(PROBE_AS, JSON.stringify({ reference: probeSet.reference })); // another day has another first tool
  } catch (error) {
    console.info("not kept:", error.message);
  }
}
const probeValue = (name) => Number(probeSet[name] ?? PROBE_FIELDS[name][2]);
/** Placeholder in a line for the coordinate found by the last probing. */
const TOUCHED = `(${t`where it touched`})`;
const word = (letter, value) => `${letter}${millimetres(value)}`;

/** Probe fast, retract, probe slowly; then move to the contact, because the machine stops after it. */
function touchLines(letter, sign, far) {
  const feed = probeValue("feed");
  return [`G38.2 ${word(letter, sign * far)} F${feed}`, `G0 ${word(letter, -sign * BACK_MM)}`, `G38.2 ${word(letter, sign * 2 * BACK_MM)} F${Math.max(1, Math.round(feed * SLOW_PART))}`,
    `G90 G53 G0 ${letter}${TOUCHED}`, "G91"];
}

function plateLines() {
  return [...touchLines("Z", -1, probeValue("far")), `G10 L20 P0 ${word("Z", probeValue("plate"))}`, `G0 ${word("Z", probeValue("up"))}`];
}

function edgeLines() {
  const [letter, sign] = PROBE_SIDES[probeSet.side];
  return [...touchLines(letter, sign, probeValue("far")), `G10 L20 P0 ${word(letter, -sign * (probeValue("tool") / 2 + probeValue("plate")))}`, `G0 ${word(letter, -sign * BACK_MM)}`];
}

/** From outside the left side: probe X, go round to the front, probe Y, and move up. */
function cornerLines() {
  const off = probeValue("tool") / 2 + probeValue("plate"), far = probeValue("far");
  return [...touchLines("X", 1, far), `G10 L20 P0 ${word("X", -off)}`, `G0 ${word("X", -BACK_MM)}`, `G0 ${word("Y", -far)}`, `G0 ${word("X", BACK_MM + 2 * off)}`,
    ...touchLines("Y", 1, 2 * far), `G10 L20 P0 ${word("Y", -off)}`, `G0 ${word("Y", -BACK_MM)}`, `G0 ${word("Z", probeValue("up"))}`];
}

function holeLines() {
  return ["X", "Y"].flatMap((letter) => [`G38.2 ${word(letter, -probeValue("far"))} F${probeValue("feed")}`, `G38.2 ${word(letter, 2 * probeValue("far"))}`, `G90 G53 G0 ${letter}(${t`the middle of both`})`, `G10 L20 P0 ${letter}0`]);
}

function lengthLines() {
  const last = probeSet.reference === undefined ? `(${t`where it touches is kept: this is the first tool`})` : `G43.1 Z(${t`the difference to the first tool`})`;
  return [...touchLines("Z", -1, probeValue("far")), last, `G0 ${word("Z", probeValue("up"))}`];
}

/** The contact of the last probing in mm, machine coordinates; null if it failed. */
function touched() {
  const [place, success] = (grbl.offsets.get("PRB") || "").split(":");
  return success === "1" ? inMm(place.split(",").map(Number)) : null;
}

/** Wait until the lines sent before are executed, then read state, position, pins, modes and offsets.
 * Until then the last report may be of the place before a move, the offsets of before a G10. */
async function readAtRest() {
  await sendLines(["G4 P0"]);
  grbl.now(STATUS);
  await sendLines(["G4 P0"]); // its answer comes after the report
  await sendLines(["$G", "$#"], true);
}

/** Modes that were in force before a probing that ended in an alarm: restored once it is unlocked. */
let owedModes = "";
for (const change of ["welcome", "driver", "lost"]) grbl.on(change, () => { owedModes = ""; }); // others set them since
grbl.on("status", () => {
  if (!owedModes || !is("Idle") || !asked() || acting) return;
  grbl.send(owedModes);
  owedModes = "";
});

/** Run a probing in mm and relative coordinates, then restore G20 and G90. Throws an Error for the user. */
async function probeRun(act) {
  await readAtRest();
  if (grbl.pins.includes("P")) throw new Error(t`The probe touches already. Lift the tool, or turn $6 round.`);
  const before = ["G20", "G90"].filter((mode) => grbl.modes.includes(mode)).join(" ");
  try {
    await sendLines(["G21 G91"]);
    await act();
    await readAtRest(); // the tool still moves up
  } finally {
    if (grbl.session === actSession) {
      if (is("Alarm")) owedModes = before;
      else if (before) await grbl.send(before);
    }
  }
}

/** Send lines in alone(), each after the answer to the one before. Throws an Error for the user. */
async function sendLines(lines, quiet = false) {
  for (const shown of lines) {
    sameSession(); // an ok and a welcome may come in one piece
    const line = shown.replace(/([XYZ])\(.*?\)/, (_, letter) => word(letter, touched()[AXES.indexOf(letter)]));
    const answer = await grbl.send(line, quiet);
    if (answer !== "ok") throw new Error(`${line}: ${explained(answer, line)}`);
    if (grbl.alarm || is("Alarm")) throw new Error(`${line}: ${alarmWords(grbl.alarm || 5)}`);
  }
}

async function probeHole() {
  for (const [axis, letter] of [...AXES.slice(0, 2)].entries()) {
    const ends = [];
    for (const [end, sign] of [-1, 1].entries()) {
      await sendLines([`G38.2 ${word(letter, sign * probeValue("far") * (end + 1))} F${probeValue("feed")}`]);
      ends[end] = touched()[axis];
      await sendLines([`G90 G53 G0 ${word(letter, ends[end])}`, "G91", `G0 ${word(letter, -sign * BACK_MM)}`]);
    }
    await sendLines([`G90 G53 G0 ${word(letter, (ends[0] + ends[1]) / 2)}`, `G10 L20 P0 ${letter}0`, "G91"]);
  }
}

async function probeLength() {
  await sendLines(touchLines("Z", -1, probeValue("far")));
  const at = touched()[2];
  if (probeSet.reference === undefined) probeSet.reference = at;
  else await sendLines([`G43.1 ${word("Z", at - probeSet.reference)}`]);
  keepProbe();
  await sendLines([`G0 ${word("Z", probeValue("up"))}`]);
}

function anotherFirstTool() {
  delete probeSet.reference;
  keepProbe();
  renderProbe();
}

function renderProbe() {
  const kind = PROBE_KINDS[probeSet.kind];
  $("probe-kinds").replaceChildren(...Object.entries(PROBE_KINDS).map(([name, { title }]) => make("button", { "aria-pressed": String(name === probeSet.kind), onclick: () => { probeSet.kind = name; keepProbe(); renderProbe(); } }, title)));
  $("probe-words").textContent = kind.words;
  $("probe-fields").replaceChildren(...kind.fields.map(probeField),
    ...(probeSet.kind === "length" && probeSet.reference !== undefined ? [make("button", { onclick: anotherFirstTool }, t`Another first tool`)] : []));
  $("probe-picture").replaceChildren(...kind.picture.map(([className, x, y, width, height]) => svg("rect", { class: className, x, y, width, height, rx: 2 })), svg("path", { class: "way", d: kind.way }));
  $("height").hidden = probeSet.kind !== "height";
  for (const id of ["height-plot", "height-use", "height-save", "height-drop"]) $(id).hidden = !heightMap;
  renderProbeLines();
}

function renderProbeLines() { $("probe-lines").textContent = ["G21 G91", ...PROBE_KINDS[probeSet.kind].lines()].join("\n"); }

function probeField(name) {
  const change = ({ target }) => {
    probeSet[name] = target.value;
    keepProbe();
    renderProbeLines();
  };
  if (name === "side") return make("label", {}, t`Side of the work`, make("select", { id: "probe-side", onchange: change }, ...Object.keys(PROBE_SIDES).map((side) => make("option", { value: side, selected: side === probeSet.side }, SIDE_WORDS[side]))));
  const [label, unit] = PROBE_FIELDS[name];
  return make("label", {}, label, make("input", { id: `probe-${name}`, type: "number", step: "any", min: "0", value: probeValue(name), oninput: change, style: "width:5em" }), make("span", { className: "faint" }, unit));
}

function svg(tag, attributes) {
  const element = document.createElementNS($("probe-picture").namespaceURI, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  return element;
}

$("probe-run").onclick = () => alone(async () => {
  const kind = PROBE_KINDS[probeSet.kind], say = (text, tone) => Object.assign($("probe-says"), { textContent: text, className: `small ${tone}` });
  say(t`Probing …`, "");
  try {
    await probeRun(async () => (kind.run ? kind.run() : sendLines(kind.lines())));
    say(kind.done?.() || t`Done.`, "good");
  } catch (error) {
    say(error.message, "bad");
  }
  renderProbe();
});
grbl.on("alarm", (number) => { if (LOSE_PLACE.includes(number)) anotherFirstTool(); });
grbl.on("status", () => setText("probe-state", grbl.pins.includes("P") ? t`The probe touches.` : t`The probe is open.`));
