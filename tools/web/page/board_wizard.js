// The first steps of the setup: the software on the board, the board, its pins, its file.

const IMAGES = { pico: "RPI_PICO", pico_w: "RPI_PICO_W", pico2: "RPI_PICO2", pico2_w: "RPI_PICO2_W" };
const NEW_DRAFT = { title: "My machine", motors: "XYZ", rotary: "", pins: {}, repl: null, outputs: {}, inputs: {}, options: {}, kept: {} };
const micropython = new Prompt(grbl);
let onBoard = null; // the result of Prompt.about(); null before
let otherVersion = ""; // of ugrbl on the board, in words
let promptTrouble = "", faultLine = 0, looking = ""; // looking: the present action, in words
let draft = kept.draft?.chip in BOARDS.chips ? kept.draft : null;
let ownWords = kept.ownWords ?? null; // the file's text, if it was edited by hand

// The software on the board

function situation() {
  if (looking) return [looking];
  if (promptTrouble) return [promptTrouble, "look"];
  if (!SerialLink.possible()) return [t`This browser cannot open a USB port. Chrome, Edge and Opera on a computer can (Web Serial).` + t` A board file can be made and saved here all the same.`];
  if (!grbl.up) return [t`No board is connected. Plug it in and press Connect by USB. If no board is in the list, put the firmware on it first: see below.`, "connect"];
  if (grbl.lent && onBoard) return boardWords(onBoard);
  if (grbl.state) return [t`A machine is at work: ${grbl.version ? t`version ${grbl.version}` : t`a Grbl`}. Its pins can be changed here, or go on with step 6.` + otherVersion, "read", "guide"];
  if (grbl.message) return [t`The firmware does not start: ${grbl.message}`, "look"];
  if (grbl.silent) return [t`The board says nothing. It may have no firmware yet, or another program on it.`, "look"];
  return [t`Waiting for an answer …`];
}

function boardWords({ version, machine, frozen, hasMain, board }) {
  const python = t`MicroPython ${version} on ${machine}`;
  if (!frozen && !hasMain) return [t`${python}, without ugrbl. Put the firmware on it: see below.`, "again"];
  if (board === null) return [t`${python}, with ugrbl and without a board file. The next step makes one.` + otherVersion, "board"];
  return [t`${python}, with ugrbl and a board file. The machine does not run.` + otherVersion, "start", "file"];
}

const ACTIONS = {
  connect: [t`Connect by USB`, () => connectUsb()],
  look: [t`Look what is on it`, () => lookAtBoard()],
  again: [t`Look again`, () => lookAtBoard()],
  read: [t`Read its board file`, () => lookAtBoard(true)],
  guide: [t`Set the machine up`, () => showStep("guide")],
  board: [t`Choose the board`, () => showStep("board")],
  start: [t`Start it`, () => startBoard()],
  file: [t`Show its board file`, () => showStep("file")],
};

let situationWas = "";
function renderSituation() {
  const [words, ...actions] = situation();
  if (words === situationWas) return;
  situationWas = words;
  $("setup-found").textContent = words;
  $("setup-actions").replaceChildren(...actions.map((name, index) => make("button", { className: index ? "" : "main", onclick: ACTIONS[name][1] }, ACTIONS[name][0])));
}
grbl.on("change", renderSituation);
grbl.on("lost", () => { onBoard = null; promptTrouble = otherVersion = ""; });
grbl.on("prompt", () => {
  showTab("setup");
  showStep("connect");
  lookAtBoard();
});

/** Query MicroPython; restart: start the machine again afterwards. */
async function lookAtBoard(restart = false) {
  if (looking) return;
  await atPrompt(async () => {
    onBoard = await micropython.about();
    const chip = chipOf(onBoard.machine);
    if (chip) $("board-chip").value = $("uf2-board").value = chip;
    renderUf2();
    const [, found] = / ([\d.]+)$/.exec(onBoard.frozen) || [];
    otherVersion = found && found !== BOARDS.version ? " " + t`It is ugrbl ${found}; this page belongs to ${BOARDS.version}. To update, put the firmware on the board again, see below: settings, board file and custom.py stay.` : "";
    $("bootsel").open = Boolean(otherVersion) || !onBoard.frozen && !onBoard.hasMain;
    if (onBoard.board !== null) useText(onBoard.board);
    if (onBoard.custom !== null) keep("custom", onBoard.custom);
    if (restart) await startMachine(); // else it stays at the prompt
  });
  if (!restart || promptTrouble) return;
  onBoard = null;
  showStep("file");
}

function startMachine() {
  looking = t`The board starts …`;
  renderSituation();
  return micropython.start();
}

/** Act at the raw prompt; show a fault. Returns whether it succeeded. */
async function atPrompt(act, fresh = false) {
  looking = t`Looking at what is on the board …`;
  promptTrouble = "";
  renderSituation();
  try {
    await micropython.enter(fresh);
    await act();
    return true;
  } catch (error) {
    promptTrouble = error.words || error.message;
    faultLine = error.line || 0; // of board.py
    if (grbl.lent && !onBoard) micropython.leave();
    return false;
  } finally {
    looking = "";
    renderSituation();
  }
}

async function startBoard() {
  let said = null;
  await atPrompt(async () => { said = await startMachine(); });
  onBoard = null;
  if (said && !said.banner) promptTrouble = t`The firmware does not start: ${said.message || t`it says nothing`}`;
  renderSituation();
}

function renderUf2() {
  const name = $("uf2-board").value;
  $("uf2-name").textContent = `ugrbl-…-${IMAGES[name]}.uf2`;
  $("uf2-drive").textContent = BOARDS.chips[name].processor === "RP2350" ? "RP2350" : "RPI-RP2";
}
$("uf2-board").append(...Object.keys(IMAGES).map((name) => make("option", { value: name }, translated(BOARDS.chips[name].title))));
$("uf2-board").onchange = renderUf2;
$("uf2-write").hidden = !("showDirectoryPicker" in window);
$("uf2-file").onchange = async ({ target }) => {
  const [file] = target.files;
  target.value = "";
  const say = (text) => { $("uf2-words").textContent = text; };
  try {
    say(t`Choose the board's drive.`);
    const drive = await window.showDirectoryPicker({ mode: "readwrite" });
    say(t`Writing …`);
    say(await writeToDrive(file, drive));
  } catch (error) {
    say(error.name === "AbortError" ? t`No drive was chosen.` : error.message);
  }
};
STEP_SHOWN.connect = () => {
  renderUf2();
  renderSituation();
};

// Choice of the board

$("board-chip").append(...Object.entries(BOARDS.chips).map(([name, { title }]) => make("option", { value: name }, translated(title))));
$("board-chip").onchange = renderCards;
let chosen = ""; // name of the board
function renderCards() {
  const chip = $("board-chip").value, { processor, title } = BOARDS.chips[chip];
  const near = Object.entries(BOARDS.boards).filter(([, board]) => BOARDS.chips[board.chip].processor === processor);
  near.sort(([, one], [, other]) => (other.chip === chip) - (one.chip === chip));
  $("board-cards").replaceChildren(
    make("button", { className: "main", onclick: () => chooseOwn(chip) }, make("b", {}, t`My own`), make("span", { className: "small" }, t`Pins of the ${translated(title)}, one by one`)),
    ...near.map(([name, { about }]) => make("button", { "aria-pressed": String(name === chosen), onclick: () => chooseBoard(name) }, make("b", { className: "mono" }, name), make("span", { className: "small" }, about))));
}
STEP_SHOWN.board = renderCards;

/** Without a choice the next step begins with a board of the user's own. */
const beginDraft = () => draft ?? beginOwn($("board-chip").value);
const beginOwn = (chip) => setDraft({ ...structuredClone(NEW_DRAFT), chip });

function chooseOwn(chip) {
  chosen = "";
  if (draft?.chip !== chip) beginOwn(chip);
  ownWords = null;
  keep("ownWords", null);
  showStep("pins");
}

function chooseBoard(name) {
  chosen = name;
  const made = draftOf(name);
  if (made) setDraft(made);
  useText(BOARDS.boards[name].text);
  showStep(made ? "pins" : "file");
}

/** Store changed answers and update the file. */
function setDraft(made) {
  draft = made;
  ownWords = null;
  keep("draft", draft);
  keep("ownWords", null);
}

function useText(text) {
  ownWords = text;
  keep("ownWords", text);
}

// Pins

const PIN_KINDS = { STEP: "motor", DIR: "motor", ENABLE: "motor" };
const SHORT = { STEP: t`step`, DIR: t`dir`, ENABLE: t`enable`, LIMIT: t`limit`, PROBE: t`probe`, RESET: t`reset`, HOLD: t`hold`, START: t`start`, DOOR: t`door`,
  ESTOP: t`e-stop`, SPINDLE_PWM: t`tool PWM`, SPINDLE_DIR: t`tool dir`, SPINDLE_ON: t`tool on`, FLOOD: t`flood`, MIST_PIN: t`mist` };
const kindOfItem = ({ name, output }) => PIN_KINDS[name] || (output ? "out" : "in");
const motorLetters = () => draft.motors || AXES.slice(0, (draft.pins.STEP || []).length);

/** All possible jobs of a pin: [value, words, kind]. */
function pinJobs() {
  const names = motorNames(motorLetters());
  const items = ITEMS.flatMap((item) => {
    const words = SHORT[item.name] || item.name;
    const kind = kindOfItem(item);
    return item.perAxis ? names.map((motor, index) => [`${item.name} ${index}`, `${words} ${motor}`, kind]) : [[item.name, words, kind]];
  });
  const own = (way, word) => Object.keys(draft[way]).map((name) => [`${way} ${name}`, `${word} ${name}`, "own"]);
  return [...items, ["repl", t`prompt`, "in"], ...own("outputs", t`output`), ...own("inputs", t`input`)];
}

/** The job of a pin; "" if it has none. */
function jobOfPin(pin) {
  if (draft.repl === pin) return "repl";
  for (const way of ["outputs", "inputs"]) {
    const name = Object.keys(draft[way]).find((one) => draft[way][one] === pin);
    if (name) return `${way} ${name}`;
  }
  for (const { name, perAxis } of ITEMS) {
    const index = (draft.pins[name] || []).indexOf(pin);
    if (index >= 0) return perAxis ? `${name} ${index}` : name;
  }
  return "";
}

function freePin(pin) {
  if (draft.repl === pin) draft.repl = null;
  for (const way of ["outputs", "inputs"]) for (const name of Object.keys(draft[way])) if (draft[way][name] === pin) draft[way][name] = null;
  for (const item of ITEMS) {
    const held = draft.pins[item.name];
    if (!held?.includes(pin)) continue;
    if (item.perAxis) draft.pins[item.name] = held.map((one) => (one === pin ? null : one));
    else draft.pins[item.name] = held.filter((one) => one !== pin);
    if (draft.pins[item.name].every((one) => one === null)) delete draft.pins[item.name];
  }
}

/** Give a pin a job; the pin that had it loses it, except ENABLE: each driver may have one. */
function givePin(pin, job) {
  freePin(pin);
  const [name, index] = job.split(" ");
  if (job === "repl") draft.repl = pin;
  else if (name in draft && index) draft[name][index] = pin;
  else if (index) {
    const count = motorLetters().length, held = draft.pins[name] || [];
    draft.pins[name] = Array.from({ length: count }, (_, motor) => held[motor] ?? null);
    draft.pins[name][Number(index)] = pin;
  } else if (name) draft.pins[name] = name === "ENABLE" ? [...(draft.pins.ENABLE || []), pin].sort((a, b) => a - b) : [pin];
  setDraft(draft);
  renderPins();
}

/** The draft for the file, without unconnected outputs and inputs, and without MOTORS if not needed. */
function tidy() {
  const wired = (pins) => Object.fromEntries(Object.entries(pins).filter(([, pin]) => pin !== null));
  const own = motorLetters() === AXES.slice(0, motorLetters().length);
  return { ...draft, motors: own ? "" : draft.motors, outputs: wired(draft.outputs), inputs: wired(draft.inputs) };
}

/** Motor jobs that have no pin yet. */
function openJobs() {
  const names = motorNames(motorLetters());
  return [["STEP", SHORT.STEP], ["DIR", SHORT.DIR]].flatMap(([item, words]) => names.filter((_, motor) => (draft.pins[item]?.[motor] ?? null) === null).map((name) => `${words} ${name}`));
}

/** [text, tone] of each message about the draft. */
function verdict() {
  const open = openJobs(), made = tidy();
  if (open.length) return [[t`Still without a pin: ${open.join(", ")}.`, "warn"], ...noteRows(made)];
  const problems = boardProblems(made);
  if (problems.length) return problems.map((text) => [text, "bad"]);
  return [[t`No rule is broken: the file is ready.`, "good"], ...noteRows(made)];
}
const noteRows = (made) => boardNotes(made).map((text) => [text, "warn"]);

function renderPins() {
  $("board-title").value = draft.title;
  $("board-motors").value = motorLetters();
  $("board-rotary").value = draft.rotary;
  const focused = document.activeElement?.id;
  const { module, title } = BOARDS.chips[draft.chip], left = module.left.split(" "), right = module.right.split(" ");
  const rows = Math.max(left.length, right.length), jobs = pinJobs();
  const parts = [make("div", { className: "body", style: `grid-row:1/span ${rows}`, title: translated(title) }, make("span", {}, module.title))];
  for (let row = 0; row < rows; row += 1) {
    parts.push(...pinCells(left[row], row, [2, 1], jobs), ...pinCells(right[row], row, [4, 5], jobs));
  }
  module.on_board.split(" ").filter(Boolean).forEach((pin, index) => parts.push(...pinCells(pin, rows + index, [2, 1], jobs)));
  $("module").replaceChildren(...parts);
  if (focused) $(focused)?.focus();
  says("pins-says", verdict());
}

/** A pin's number and the choice of its job; for a supply pin its name. */
function pinCells(word, row, [padColumn, jobColumn], jobs) {
  if (word === undefined) return [];
  const where = (column) => `grid-column:${column};grid-row:${row + 1}`;
  if (!/^\d+$/.test(word)) return [make("span", { className: "power", style: where(padColumn) }, word)];
  const pin = Number(word), job = jobOfPin(pin), { odd, inputs_only: inputsOnly } = BOARDS.chips[draft.chip];
  const kind = jobs.find(([value]) => value === job)?.[2] || "";
  const hint = [inputsOnly.includes(pin) && t`can only read`, translated(odd[pin])].filter(Boolean).join("; ");
  const select = make("select", { id: `pin-${pin}`, "aria-label": t`Job of pin ${pin}${hint ? t`, which ${hint}` : ""}`, style: where(jobColumn), title: hint, onchange: ({ target }) => givePin(pin, target.value) },
    make("option", { value: "" }, "–"), ...jobs.map(([value, text]) => make("option", { value, selected: value === job }, text)));
  return [make("label", { htmlFor: select.id, "data-kind": kind, style: where(padColumn), title: hint }, word + (hint ? "*" : "")), select];
}
STEP_SHOWN.pins = () => {
  beginDraft();
  renderPins();
};

$("board-title").oninput = ({ target }) => {
  draft.title = target.value.replace(/["\\]/g, "").trim() || NEW_DRAFT.title;
  setDraft(draft);
};
$("board-motors").onchange = ({ target }) => {
  draft.motors = target.value.toUpperCase().replace(/[^XYZABC]/g, "") || "XYZ";
  for (const { name, perAxis } of ITEMS) if (perAxis && draft.pins[name]) draft.pins[name] = draft.pins[name].slice(0, draft.motors.length);
  setDraft(draft);
  renderPins();
};
$("board-rotary").onchange = ({ target }) => {
  draft.rotary = target.value.toUpperCase();
  setDraft(draft);
  renderPins();
};
$("own-pins").onsubmit = (event) => {
  event.preventDefault();
  const name = $("own-name").value.trim();
  if (!name || name in draft.outputs || name in draft.inputs) return says("pins-says", [[t`Give it a name that is not there yet.`, "bad"]]);
  draft[event.submitter.value][name] = null;
  $("own-name").value = "";
  setDraft(draft);
  renderPins();
};

// Options

function renderOptions() {
  says("options-says", verdict());
  $("option-forms").replaceChildren(...Object.entries(BOARDS.forms).map(([title, options]) => make("details", { open: options.some(({ name }) => name in draft.options) },
    make("summary", {}, make("b", {}, translated(title))), ...options.map(optionRow))));
  const others = Object.keys(draft.kept);
  if (others.length) $("option-forms").append(make("p", { className: "small faint" }, t`Kept as they are, and checked by the board when it starts: ${others.join(", ")}.`));
}

function optionRow(option) {
  const id = `option-${option.name}`;
  return make("div", { className: "option" }, make("label", { htmlFor: id, className: "mono small" }, option.name),
    make("div", { className: option.kind === "True or False" ? "tick" : "" }, optionControl(option, id), make("div", { className: "small faint" }, translated(option.meaning))));
}

/** Store an option; a default value is left out of the file. */
function setOption({ name, default: usual }, value) {
  if (value === undefined || literal(value) === literal(name === "LINK" ? BOARDS.chips[draft.chip].link : usual)) delete draft.options[name];
  else draft.options[name] = value;
  setDraft(draft);
  says("options-says", verdict());
}

function optionControl(option, id) {
  const { name, kind, low, high, choices } = option, value = draft.options[name];
  const usual = name === "LINK" ? BOARDS.chips[draft.chip].link : option.default;
  if (kind === "True or False") return make("input", { type: "checkbox", id, checked: value ?? usual, onchange: ({ target }) => setOption(option, target.checked) });
  if (kind === "whole number") {
    return make("input", { type: "number", id, min: low, ...(high === null ? {} : { max: high }), value: value ?? "", placeholder: String(usual),
      onchange: ({ target }) => setOption(option, target.value === "" ? undefined : Math.round(Number(target.value))) });
  }
  if (kind === "names" && choices) {
    return make("div", { className: "bits", id }, ...choices.map((word) => make("label", { className: "check small" }, make("input", { type: "checkbox", checked: (value || []).includes(word),
      onchange: ({ target }) => setOption(option, choices.filter((one) => (one === word ? target.checked : (draft.options[name] || []).includes(one)))) }), word)));
  }
  if (kind === "names") {
    return make("input", { id, value: (value || []).join(", "), placeholder: "Z, XY",
      onchange: ({ target }) => setOption(option, target.value.toUpperCase().split(/[\s,]+/).filter(Boolean)) });
  }
  if (choices) {
    return make("select", { id, onchange: ({ target }) => setOption(option, target.value) },
      ...choices.map((word) => make("option", { value: word, selected: word === (value ?? usual) }, word)));
  }
  return make("input", { id, value: value ?? "", placeholder: t`none`, onchange: ({ target }) => setOption(option, target.value.replace(/[^\w-]/g, "") || undefined) });
}
STEP_SHOWN.options = () => {
  beginDraft();
  renderOptions();
};
