// Setup of the machine: motors, switches, homing, travel, tool; each task can be continued later.

// Slow enough to reach for STOP.
const GUIDE_FEED = 200, FIRST_MM = 1;
const WAYS = { X: [t`to the right`, t`to the left`], Y: [t`away from you`, t`towards you`], Z: [t`up`, t`down`] };
const waysOf = (letter) => WAYS[letter] || [t`the way you call plus`, t`the other way`];
const guideDone = new Set(kept.guideDone || []);
let guideTask = kept.guideTask || "motor X";
let guideShown = "";

function guideTasks() {
  const letters = [...AXES.slice(0, grbl.machine.length || 3)];
  return [...letters.map((letter) => `motor ${letter}`), "switches", "homing", "travel", "tool", "save"];
}

function taskDone(name) {
  guideDone.add(name);
  keep("guideDone", [...guideDone]);
  const tasks = guideTasks();
  openTask(tasks[tasks.indexOf(name) + 1] || name);
}

function openTask(name) {
  guideTask = name;
  keep("guideTask", name);
  guideShown = "";
  says("guide-says", []);
  renderGuide();
}

const guideSays = (text, tone = "") => says("guide-says", text ? [[text, tone]] : []);

const TASK_WORDS = { switches: t`Switches`, homing: t`Homing`, travel: t`Travel`, tool: t`Tool`, save: t`Save` };
const taskWords = (name) => TASK_WORDS[name] || t`Motor ${name.split(" ")[1]}`;

/** Change settings and show refusals. Returns whether all were accepted. */
async function put(...changes) {
  for (const [number, value] of changes) {
    const answer = await grbl.send(`$${number}=${value}`);
    if (answer !== "ok") {
      guideSays(t`$${number}=${value} was refused: ${explained(answer)}`, "bad");
      return false;
    }
  }
  await grbl.send("$$", true);
  return true;
}

let onReady = null;
grbl.on("ready", () => {
  onReady?.();
  onReady = null;
});
/** Grbl stores its position in mm and in steps, so after a change of steps per mm its next move
 * would compensate the difference. A reset while idle makes it start from the steps. */
async function forgetPlace() {
  const ready = new Promise((resolve) => { onReady = resolve; });
  grbl.reset();
  await ready;
  if (is("Alarm")) await grbl.send("$X");
}

const needing = (need, properties, text) => make("button", { "data-needs": need, disabled: !NEEDS[need](), ...properties }, text);
const numberField = (id, label, value, unit) => make("label", {}, label, make("input", { id, type: "number", step: "any", min: "0", value }), make("span", { className: "faint" }, unit));

/** Draw the open task; redraw only if the task or its completion has changed. */
function renderGuide() {
  if ($("guide").hidden) return;
  const tasks = guideTasks();
  if (!tasks.includes(guideTask)) guideTask = tasks[0];
  const key = JSON.stringify([guideTask, tasks, [...guideDone], grbl.up && grbl.settings.size > 0, guideTask === "homing" && grbl.setting(22)]);
  if (key !== guideShown) {
    guideShown = key;
    $("guide-tasks").replaceChildren(...tasks.map((name) => make("button", { "aria-pressed": String(name === guideTask), onclick: () => openTask(name) }, `${taskWords(name)}${guideDone.has(name) ? " ✓" : ""}`)));
    $("guide-task").replaceChildren(...(grbl.up && grbl.settings.size ? taskBody() : [t`Connect the machine first.`]));
  }
  if (guideTask === "switches" || guideTask === "homing") renderSwitches();
  if (guideTask === "travel") renderTravel();
}

function taskBody() {
  const [kind, letter] = guideTask.split(" ");
  const bodies = { motor: () => motorTask(AXES.indexOf(letter)), switches: switchesTask, homing: homingTask, travel: travelTask, tool: toolTask, save: saveTask };
  return bodies[kind]();
}

// A motor: direction and distance

function motorTask(axis) {
  const letter = AXES[axis], [right, wrong] = waysOf(letter);
  let moved = 0;
  const move = async (sign) => {
    const mm = Number($("guide-mm").value);
    if (!(mm > 0)) return guideSays(t`Say how far it is to go.`, "bad");
    const answer = await grbl.send(`$J=G21 G91 ${letter}${sign * mm} F${GUIDE_FEED}`);
    if (answer !== "ok") return guideSays(explained(answer), "bad");
    moved = mm;
    guideSays(t`It was asked to go ${mm} mm ${sign > 0 ? right : wrong}.`);
  };
  const turn = async () => {
    const mask = grbl.setting(3) ^ 1 << axis;
    if (await put([3, mask])) guideSays(t`$3=${mask}: ${letter} turns the other way now. Move it once more.`, "good");
  };
  const measure = async () => {
    const real = Number($("guide-real").value), before = grbl.setting(100 + axis);
    if (!moved) return guideSays(t`Let it move first.`, "bad");
    if (!(real > 0)) return guideSays(t`Say how far it went, in mm.`, "bad");
    const steps = Number((before * moved / real).toFixed(3));
    if (await put([100 + axis, steps])) {
      moved = 0; // with other steps per mm it must be measured again
      await forgetPlace();
      guideSays(t`$${100 + axis}=${steps} (it was ${before}). Move it once more; a longer way measures better.`, "good");
    }
  };
  return [make("ol", {},
    make("li", {}, t`Let ${letter} move: the tool is to go ${right}.`, make("div", { className: "row" }, numberField("guide-mm", "", FIRST_MM, "mm"),
      needing("jog", { onclick: () => move(1), id: "guide-plus" }, t`Move ${letter}+`), needing("jog", { onclick: () => move(-1), id: "guide-minus" }, t`Move ${letter}−`))),
    make("li", {}, t`Which way did it go?`, make("div", { className: "row" }, make("button", { id: "guide-right", onclick: () => guideSays(t`Good. Now measure.`, "good") }, right[0].toUpperCase() + right.slice(1)),
      needing("idle", { id: "guide-wrong", onclick: turn }, wrong[0].toUpperCase() + wrong.slice(1)), make("button", { onclick: () => guideSays(t`Is the supply of the drivers on? Is it quiet and loose by hand: turn $4 round (enable) in the settings. Does it hum: swap no wires with the supply on; check the two pairs of the motor, and the driver's current.`, "warn") }, t`Not at all`))),
    make("li", {}, t`How far did it go? Measure with a ruler; ten times the way is ten times as exact.`, make("div", { className: "row" }, numberField("guide-real", "", "", "mm"), needing("idle", { id: "guide-set", onclick: measure }, t`Set the steps per mm`)))),
  make("div", { className: "row" }, make("button", { className: "main", id: "guide-done", onclick: () => taskDone(guideTask) }, t`It goes right`))];
}

// Switches

let switchesSeen = new Set();
function switchesTask() {
  switchesSeen = new Set();
  const turn = async (number, name) => {
    if (await put([number, grbl.setting(number) ? 0 : 1])) guideSays(t`$${number}=${grbl.setting(number)}: ${name} count the other way round now.`, "good");
  };
  return [make("p", {}, t`Press each switch, button and the probe by hand. It lights up here for as long as it is pressed.`),
    make("div", { className: "switches", id: "guide-switches" }),
    make("p", { className: "small" }, t`Lit although nothing is pressed? Then its contact opens when it is pressed:`),
    make("div", { className: "row" }, needing("lines", { onclick: () => turn(5, t`limit switches`) }, t`Turn limits round ($5)`), needing("lines", { onclick: () => turn(6, t`the probe`) }, t`Turn the probe round ($6)`)),
    make("div", { className: "row" }, make("button", { className: "main", id: "guide-done", onclick: () => taskDone("switches") }, t`All light up`))];
}

function renderSwitches() {
  for (const pin of grbl.pins) switchesSeen.add(pin);
  const row = $("guide-switches");
  if (!row) return;
  const letters = [...AXES.slice(0, grbl.machine.length || 3), "P", ...[...switchesSeen].filter((pin) => !(AXES + "P").includes(pin))];
  const now = letters.map((pin) => `${pin}${grbl.pins.includes(pin)}${switchesSeen.has(pin)}`).join();
  if (row.dataset.now === now) return;
  row.dataset.now = now;
  row.replaceChildren(...letters.map((pin) => make("span", { className: grbl.pins.includes(pin) ? "on" : "" }, `${PIN_WORDS[pin] || pin}${grbl.pins.includes(pin) ? t`: pressed` : switchesSeen.has(pin) ? " ✓" : ""}`)));
}

// Homing

function homingTask() {
  const letters = [...AXES.slice(0, grbl.machine.length || 3)], mask = grbl.setting(23) || 0;
  const use = async () => {
    const chosen = letters.reduce((sum, letter, axis) => sum | ($(`guide-end-${letter}`).value === "-") << axis, 0);
    const slow = Number($("guide-seek").value);
    if (!(slow > 0)) return guideSays(t`Say how fast it is to search.`, "bad");
    if (await put([23, chosen], [25, slow], [24, Math.min(slow, grbl.setting(24) || slow)], [27, $("guide-pull").value || 1], [22, 1])) guideSays(t`$23=${chosen}, $22=1. Put the tool in the middle, then home with a hand on STOP.`, "good");
  };
  const ends = letters.map((letter, axis) => make("label", {}, letter, make("select", { id: `guide-end-${letter}` },
    ...[["+", waysOf(letter)[0]], ["-", waysOf(letter)[1]]].map(([end, words]) => make("option", { value: end, selected: (mask >> axis & 1 ? "-" : "+") === end }, t`switch ${words}`)))));
  return [make("ol", {},
    make("li", {}, t`At which end is each switch?`, make("div", { className: "row" }, ...ends)),
    make("li", {}, t`How fast, at first? And how far back from the switch?`, make("div", { className: "row" }, numberField("guide-seek", "", Math.min(grbl.setting(25) || 500, 500), "mm/min"), numberField("guide-pull", "", grbl.setting(27) ?? 1, "mm"),
      needing("lines", { id: "guide-use", onclick: use }, t`Use this`))),
    make("li", {}, t`Put the tool in the middle of its way. Home, with a hand on STOP: each axis goes towards its switch, and back a little.`, make("div", { className: "row" }, needing("homing", { id: "guide-home", onclick: homeOnce }, t`Home`), needing("stop", { onclick: stop }, t`It goes the wrong way: stop`)),
      make("div", { className: "switches", id: "guide-switches" }))),
  make("div", { className: "row" }, make("button", { className: "main", id: "guide-done", onclick: () => taskDone("homing") }, t`It homes`))];
}

async function homeOnce() {
  guideSays(t`Homing …`);
  const answer = await grbl.send("$H");
  if (answer === "ok") guideSays(t`It is home.`, "good");
  else guideSays(t`It did not come home: ${grbl.alarm ? alarmWords(grbl.alarm) : explained(answer)} Unlock it, correct the end above, and home again.`, "bad");
}

// Travel

function travelTask() {
  const letters = [...AXES.slice(0, grbl.machine.length || 3)];
  const here = async (axis) => {
    const at = Math.abs(inMm(grbl.machine)[axis]), mm = Number((at + (grbl.setting(27) || 0)).toFixed(3));
    if (await put([130 + axis, mm])) {
      guideShown = "";
      renderGuide();
      guideSays(t`$${130 + axis}=${mm}: that is the travel of ${letters[axis]}.`, "good");
    }
  };
  const arm = async () => {
    if (await put([20, 1], [21, 1])) guideSays(t`Soft limits ($20) keep motion within the travel, and a switch that is hit stops the machine ($21).`, "good");
  };
  return [make("p", {}, t`After homing, jog one axis to the end that has no switch, a little before it touches. Then say: here it ends.`),
    make("table", {}, make("tbody", {}, ...letters.map((letter, axis) => make("tr", {}, make("th", {}, letter), make("td", { className: "number", id: `guide-at-${letter}` }), make("td", { className: "number faint" }, t`travel ${grbl.setting(130 + axis)} mm`),
      make("td", {}, needing("idle", { id: `guide-here-${letter}`, onclick: () => here(axis) }, t`Here ${letter} ends`)))))),
    make("div", { className: "row" }, needing("lines", { id: "guide-arm", onclick: arm }, t`Guard the travel ($20, $21)`)),
    make("div", { className: "row" }, make("button", { className: "main", id: "guide-done", onclick: () => taskDone("travel") }, t`The travel is right`))];
}

function renderTravel() {
  inMm(grbl.machine).forEach((at, axis) => {
    const cell = $(`guide-at-${AXES[axis]}`), text = `${at.toFixed(2)} mm`;
    if (cell && cell.textContent !== text) cell.textContent = text;
  });
}

// Spindle or laser, while a button is held

const LASER_PART = 0.01; // of full power
function toolTask() {
  const laser = grbl.setting(32) === 1, most = grbl.setting(30) || 1000;
  const off = () => { if (running) { running = false; grbl.send("M5"); if (laser) grbl.send("G0"); } };
  let running = false;
  const on = (event) => {
    if (event.button || !NEEDS.idle()) return;
    event.target.setPointerCapture?.(event.pointerId);
    running = true;
    const speed = Number($("guide-speed").value) || 0;
    grbl.send(laser ? `G1 F100 M3 S${speed}` : `M3 S${speed}`);
  };
  const button = needing("accessory", { id: "guide-run", onpointerdown: on, onpointerup: off, onpointercancel: off, onlostpointercapture: off, onblur: off,
    onkeydown: (event) => { if (event.key === " " && !event.repeat && !running) on({ target: {} }); }, onkeyup: (event) => { if (event.key === " ") off(); } }, laser ? t`Hold: laser on` : t`Hold: spindle on`);
  const kind = async ({ target }) => {
    if (await put([32, target.value])) {
      guideShown = "";
      renderGuide();
    }
  };
  return [make("label", {}, t`The tool is a`, make("select", { id: "guide-kind", onchange: kind }, make("option", { value: "0", selected: !laser }, t`spindle`), make("option", { value: "1", selected: laser }, t`laser ($32)`))),
    make("p", { className: "warn" }, laser ? t`Put on the glasses, close the cover, and put something under the beam that may burn.` : t`No hand, sleeve or hair near the spindle; no tool in it.`),
    make("div", { className: "row" }, numberField("guide-speed", "S", laser ? Math.max(1, Math.round(most * LASER_PART)) : Math.min(most, 1000), laser ? t`of ${most}` : t`rpm`), button),
    make("p", { className: "small" }, t`It is on for as long as the button is held. Does full power come with another S? $30 is the S of full power, $31 of the least.`),
    make("div", { className: "row" }, make("button", { className: "main", id: "guide-done", onclick: () => taskDone("tool") }, t`It works`))];
}

// The end

function saveTask() {
  return [make("p", {}, t`The machine keeps its settings by itself. A file of them brings them back after a change of the board, or onto a second machine: Settings, Compare with a file.`),
    make("div", { className: "row" }, make("button", { className: "main", id: "guide-save", onclick: () => { backUp(); taskDone("save"); } }, t`Save the settings to a file`),
      make("button", { id: "guide-again", onclick: () => { guideDone.clear(); keep("guideDone", []); openTask("motor X"); } }, t`Begin the guide again`))];
}

grbl.on("change", renderGuide);
STEP_SHOWN.guide = renderGuide;
