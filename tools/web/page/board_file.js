// Board files: their text, and the problems of one.
//
// A draft holds a board file's values: { chip, title, motors, rotary, pins: {STEP: [2, 3, 4], …},
// outputs: {name: pin}, inputs, options: {JERK: true}, kept: lines of a board that no form
// covers }. The rules repeat those of tools/boardfile/board_check.py and new_board.py;
// test_board_rules.py compares both with a thousand random boards.

const BOARDS = JSON.parse($("board_data").textContent);
const FORM_OPTIONS = Object.fromEntries(Object.values(BOARDS.forms).flat().map((row) => [row.name, row]));
const ITEMS = BOARDS.items.map(([name, question, perAxis, needed, output]) => ({ name, question, perAxis, needed, output }));
const FEWEST_AXES = 3, MOST_LETTERS = AXES.length, MOST_OF_AN_AXIS = 2;
const BEAM_HZ = [10, 100000], BESIDE_RADIO = 4;

/** A value in Python's notation. */
function literal(value) {
  if (value === null) return "None";
  if (typeof value === "boolean") return value ? "True" : "False";
  if (typeof value === "string") return JSON.stringify(value);
  if (Array.isArray(value)) return `(${value.map(literal).join(", ")}${value.length === 1 ? "," : ""})`;
  if (typeof value === "object") return `{${Object.entries(value).map(([key, one]) => `${/^\d+$/.test(key) ? key : JSON.stringify(key)}: ${literal(one)}`).join(", ")}}`;
  return String(value);
}

const axesOf = (draft) => new Set(draft.motors).size || (draft.pins.STEP || []).length;

/** Names of motors: X, Y, Z, and Y2 for a second motor of Y. */
function motorNames(letters) {
  const axes = new Set(letters).size;
  return [...letters].map((letter, index) => (index < axes ? letter : `${letter}2`));
}

/** Values of the file by name, without the pins in ITEMS. */
function valuesOf(draft) {
  const chip = BOARDS.chips[draft.chip];
  const values = { LINK: chip.link, ...draft.options };
  for (const [name, option] of Object.entries(BOARDS.switchedOn)) if (draft.pins[name]?.length) values[option] = true;
  return values;
}

/** The text of the board file. */
function boardText(draft) {
  const chip = BOARDS.chips[draft.chip], { options } = draft, kept = draft.kept || {};
  const held = (name) => draft.pins[name] || [];
  const lines = [`"""${draft.title}: ${chip.title}."""`, "", `CHIP = "${draft.chip}"`, `MPY_ARCH = "${chip.mpy_arch}"`,
    `ENGINE = "${chip.engine}"`, `LINK = "${options.LINK || chip.link}"`, ...(options.PAGE ? ["PAGE = True"] : []), ""];
  if (draft.motors) lines.push(`MOTORS = "${draft.motors}"  # the axis of each motor`);
  if (draft.rotary) lines.push(`ROTARY = "${draft.rotary}"  # axes that turn, in degrees`);
  for (const { name, question, perAxis } of ITEMS) {
    if (name === BOARDS.controls[0] && BOARDS.controls.some((one) => held(one).length)) {
      lines.push(`CONTROL = (${BOARDS.controls.map((one) => held(one)[0] ?? "None").join(", ")})  # reset, hold, start, door`);
    }
    if (BOARDS.controls.includes(name) || !held(name).length) continue;
    const value = perAxis || held(name).length > 1 ? literal(held(name)) : String(held(name)[0]);
    lines.push(`${name} = ${value}  # ${question}`);
  }
  for (const [name, option] of Object.entries(BOARDS.switchedOn)) if (held(name).length) lines.push(`${option} = True`);
  const bare = usedPins(draft).map(([pin]) => pin).filter((pin) => chip.inputs_only.includes(pin)).sort((a, b) => a - b);
  if (bare.length) lines.push(`NO_PULL_UP = ${literal(bare)}  # resistors to 3.3 V do it`);
  if (draft.repl !== undefined && draft.repl !== null) lines.push(`REPL_PIN = ${draft.repl}`);
  for (const [name, pins] of [["OUTPUTS", draft.outputs], ["INPUTS", draft.inputs]]) {
    if (Object.keys(pins || {}).length) lines.push(`${name} = ${literal(pins)}`);
  }
  if (chip.engine === "rmt" && !options.MAX_STEP_RATE_HZ) lines.push("", "# See esp32_devkit.py.", `MAX_STEP_RATE_HZ = ${BOARDS.rmtHz}`);
  lines.push("", `PWM_MAX = ${options.PWM_MAX ?? 1000}`);
  for (const name of BOARDS.order) {
    if (["LINK", "PAGE", "PWM_MAX"].includes(name) || !(name in options)) continue;
    lines.push(`${name} = ${literal(options[name])}`);
  }
  for (const [name, value] of Object.entries(kept)) lines.push(`${name} = ${literal(value)}`);
  return `${lines.join("\n")}\n`;
}

/** Every pin in use with its connection; null pins are left out. */
function usedPins(draft) {
  const names = motorNames(draft.motors || AXES);
  return ITEMS.flatMap(({ name, question, perAxis }) => (draft.pins[name] || []).map((pin, motor) => {
    const what = question.split(",")[0];
    return [pin, perAxis ? `${what} ${names[motor]}` : what];
  })).filter(([pin]) => pin !== null);
}

/** Names with their pins, in the order of the checks. */
function heldPins(draft) {
  const some = (name) => draft.pins[name]?.length;
  const plain = ITEMS.filter(({ name }) => !BOARDS.controls.includes(name) && some(name)).map(({ name }) => name);
  const found = [...plain, ...BOARDS.controls.filter(some)].map((name) => [name, draft.pins[name]]);
  if (draft.repl !== undefined && draft.repl !== null) found.push(["REPL_PIN", [draft.repl]]);
  for (const [name, pins] of [["OUTPUTS", draft.outputs], ["INPUTS", draft.inputs]]) {
    if (Object.keys(pins || {}).length) found.push([name, Object.values(pins)]);
  }
  for (const name of ["SD_CARD", "TMC_UART"]) if (draft.kept?.[name]) found.push([name, draft.kept[name]]);
  if (Number.isInteger(draft.kept?.POWER_FAIL)) found.push(["POWER_FAIL", [draft.kept.POWER_FAIL]]);
  return found;
}

/** Why these pins do not suit the item, or conflict with known pins; "" if they fit. */
function itemProblem(draft, known, item, pins) {
  const { name } = item, chip = BOARDS.chips[draft.chip];
  const count = item.perAxis ? (known.STEP || pins).length : 1;
  const axes = new Set(draft.motors).size || (known.STEP || []).length;
  const wanted = [...new Set(name === "LIMIT" ? [count, axes || count] : [count])].sort((a, b) => a - b);
  if (name === "STEP" && pins.length > chip.most_motors) return t`${chip.engine} drives ${chip.most_motors} motors at most: name fewer pins`;
  if (!wanted.includes(pins.length)) {
    const many = wanted.join(t` or `);
    return many === "1" ? t`${name} needs 1 pin, not ${pins.length}` : t`${name} needs ${many} pins, not ${pins.length}`;
  }
  const used = usesOf(known);
  for (const [index, pin] of pins.entries()) {
    if (pin === null) {
      if (name !== "LIMIT") return t`${name}: only LIMIT may have None: name a pin`;
      continue;
    }
    if (!chip.pins.includes(pin)) return t`${name}: ${translated(chip.title)} has no pin ${pin} to connect to`;
    if (BOARDS.quick.includes(name) && pin > chip.last_quick) {
      return t`${name}: pin ${pin} cannot do it: steps, directions, limits, probe and buttons have to be pins up to ${chip.last_quick}`;
    }
    if (item.output && chip.inputs_only.includes(pin)) return t`${name}: pin ${pin} of ${translated(chip.title)} is an input only: choose another`;
    if (used.has(pin)) return t`${name}: pin ${pin} is ${used.get(pin)} already`;
    if (name !== "LIMIT" && pins.indexOf(pin) < index) return t`${name} names pin ${pin} twice`;
  }
  return "";
}

function usesOf(known) {
  return new Map(Object.entries(known).flatMap(([name, pins]) => pins.map((pin) => [pin, name])));
}

/** Problems of pins that are not in ITEMS. */
function loosePins(draft, known, name, pins) {
  const used = usesOf(known), chip = BOARDS.chips[draft.chip], found = [];
  for (const [index, pin] of pins.entries()) {
    if (pin === null) continue;
    if (!chip.pins.includes(pin)) found.push(t`${name}: ${translated(chip.title)} has no pin ${pin} to connect to`);
    else if (used.has(pin)) found.push(t`${name}: pin ${pin} is ${used.get(pin)} already`);
    else if (name !== "LIMIT" && pins.indexOf(pin) < index) found.push(t`${name} names pin ${pin} twice`);
  }
  return found;
}

function pinProblems(draft) {
  const found = [], known = {}, items = Object.fromEntries(ITEMS.map((item) => [item.name, item]));
  const axes = axesOf(draft);
  if (axes < FEWEST_AXES) found.push(t`STEP needs ${FEWEST_AXES} pins, for ${AXES.slice(0, FEWEST_AXES)}`);
  for (const [name, pins] of heldPins(draft)) {
    if (items[name] && !(name === "ENABLE" && pins.length > 1)) {
      const problem = itemProblem(draft, known, items[name], pins);
      if (problem) {
        found.push(problem);
        continue;
      }
    } else found.push(...loosePins(draft, known, name, pins));
    known[name] = pins;
    if (name === "STEP" && !draft.motors && pins.length > MOST_LETTERS) {
      found.push(t`STEP has ${pins.length} pins, but there are ${MOST_LETTERS} axes: name the axis of each in MOTORS, as in "${(AXES + AXES).slice(0, pins.length)}"`);
    }
  }
  return found;
}

/** Values out of range, and unknown words. */
function valueProblems(draft) {
  const found = [];
  for (const name of BOARDS.order) {
    const option = FORM_OPTIONS[name], value = draft.options[name];
    if (!option || value === undefined) continue;
    if (option.kind.startsWith("whole") && value < option.low) found.push(t`${name} is ${value}: it is ${option.low} at the least`);
    else if (option.high !== null && value > option.high) found.push(t`${name} is ${value}: it is ${option.high} at the most`);
    else if (option.words) {
      const unknown = [value].flat().find((word) => !option.words.includes(word));
      if (unknown !== undefined) found.push(t`${name}: '${unknown}' is not one of ${option.words.join(", ")}`);
    }
  }
  return found;
}

function networkProblems(draft) {
  const chip = BOARDS.chips[draft.chip], { LINK, PAGE } = valuesOf(draft), wireless = Object.values(BOARDS.wireless);
  if (PAGE && chip.mpy_arch === BOARDS.tooSmall) return [translated(BOARDS.noPage)];
  if (PAGE && !wireless.includes(LINK)) return [t`PAGE: it needs a network, LINK = "wifi", or "uart_wifi" on an ESP32`];
  return !chip.radio && wireless.includes(LINK) ? [t`LINK: ${translated(chip.title)} has no radio`] : [];
}

/** Functions that are switched on or inverted and have no pin. */
function wireProblems(draft) {
  const found = [], laser = draft.options.TOOL === "laser", motors = (draft.pins.STEP || []).length;
  const has = (name) => Boolean(draft.pins[name]?.length);
  if (laser && !has("SPINDLE_PWM")) found.push(t`TOOL = laser: there is no pin for SPINDLE_PWM`);
  if (laser && motors > BOARDS.mostBesideBeam) found.push(t`TOOL = laser: its beam takes what a motor takes, and leaves ${BOARDS.mostBesideBeam}`);
  for (const name of draft.options.INVERT || []) {
    if (BOARDS.invertible.includes(name) && !has(name)) found.push(t`INVERT: there is no pin for ${name}`);
  }
  return found;
}

/** The first refusal by an extra of the firmware, in the order in which extras are loaded. */
function extraProblem(draft) {
  const says = valuesOf(draft), axes = axesOf(draft);
  return motorsProblem(draft) || apartProblem("BACKLASH", says, draft) || apartProblem("SKEW", says, draft)
    || rotaryProblem(draft, axes) || homingProblem(says.HOMING, axes) || limitProblem(draft, axes)
    || toolProblem(draft, says);
}

function motorsProblem({ motors, pins, options }) {
  if (!motors) return "";
  const count = (pins.STEP || []).length, axes = new Set(motors).size, limits = pins.LIMIT || [];
  if (motors.length !== count) return t`MOTORS has ${motors.length} letters, and STEP ${count} pins`;
  if (axes < FEWEST_AXES || !AXES.startsWith(motors.slice(0, axes))) return t`MOTORS: ${AXES.slice(0, Math.max(axes, FEWEST_AXES))} first, then second motors: XYZY`;
  const crowded = [...motors].find((letter) => [...motors].filter((one) => one === letter).length > MOST_OF_AN_AXIS);
  if (crowded) return t`MOTORS: ${crowded} has more than two`;
  for (let motor = axes; motor < motors.length; motor += 1) {
    const axis = AXES.indexOf(motors[motor]);
    if (options.COREXY && axis < 2) return t`MOTORS: ${motors[motor]} shares its motor, and has no second`;
    if ((limits[motor] ?? null) !== null && limits[axis] === null) return t`LIMIT: ${motors[motor]} has its second switch only`;
  }
  return "";
}

/** Two options that exclude each other. */
function apartProblem(name, says, draft) {
  if (!says[name]) return "";
  const other = BOARDS.apart[name].find((word) => says[word] || (word === "ROTARY" && draft.rotary) || draft.kept?.[word]);
  return other ? t`${name} and ${other} cannot be combined` : "";
}

function rotaryProblem({ rotary }, axes) {
  const wrong = [...rotary].find((letter, index) => {
    const axis = AXES.slice(0, axes).indexOf(letter);
    return axis < FEWEST_AXES || rotary.indexOf(letter) < index;
  });
  return wrong ? t`ROTARY: ${wrong} is no rotary axis here, or named twice` : "";
}

const MOST_CYCLES = 6;
function homingProblem(words = [], axes) {
  if (words.length > MOST_CYCLES) return t`HOMING has ${words.length} parts: there may be ${MOST_CYCLES}`;
  const letters = words.join("");
  const wrong = [...letters].find((letter, index) => AXES.slice(0, axes).indexOf(letter) < 0 || letters.indexOf(letter) < index);
  return wrong ? t`HOMING: ${wrong} is no axis, or named twice` : "";
}

/** Problems of limit inputs that axes share. */
function limitProblem(draft, axes) {
  const limits = draft.pins.LIMIT || [], shared = [];
  const axisOf = (index) => (index >= axes ? AXES.indexOf(draft.motors[index]) : index);
  for (const pin of new Set(limits.filter((one) => one !== null))) {
    const sharing = limits.flatMap((one, index) => (one === pin ? [index] : [])), seen = [];
    for (const index of sharing) {
      if (seen.includes(axisOf(index))) return t`LIMIT: both switches of ${AXES[axisOf(index)]} are on pin ${pin}: None for the second motor's`;
      seen.push(axisOf(index));
    }
    if (sharing.length > 1) shared.push(seen);
  }
  if (!shared.length) return "";
  const words = draft.options.HOMING || [];
  const cycles = (words.length ? words : ["Z", AXES.slice(0, axes).replace("Z", "")]).map((word) => [...word].map((letter) => AXES.indexOf(letter)));
  for (const cycle of cycles) {
    for (const seen of shared) {
      const both = seen.filter((axis) => cycle.includes(axis)).sort((a, b) => a - b);
      if (both.length < 2) continue;
      const apart = ["Z", ...AXES.slice(0, axes).replace("Z", "")].join('", "');
      return t`LIMIT: ${both.map((axis) => AXES[axis]).join(t` and `)} share a pin and are homed together: write HOMING = ("${apart}")`;
    }
  }
  return "";
}

function toolProblem(draft, says) {
  const chip = BOARDS.chips[draft.chip], hz = says.PWM_HZ ?? 5000;
  if (says.TOOL === "laser") {
    if (hz < BEAM_HZ[0] || hz > BEAM_HZ[1]) return t`TOOL = laser: PWM_HZ is ${BEAM_HZ[0]} to ${BEAM_HZ[1]}`;
    if (draft.pins.SPINDLE_ON?.length) return t`TOOL = laser: remove SPINDLE_ON, it lags the beam`;
    const tight = chip.engine === "pio" && chip.mpy_arch === "armv6m" && says.LINK === "wifi";
    if (tight && draft.pins.STEP.length > BESIDE_RADIO) return t`TOOL = laser: LINK = "wifi" allows ${BESIDE_RADIO} motors at most`;
  }
  if (!says.CLUSTERS) return "";
  if (says.TOOL !== "laser") return t`CLUSTERS needs TOOL = "laser"`;
  return chip.engine === "pio" ? "" : t`CLUSTERS needs a Pico: it uses PIO state machines`;
}

/** Every problem, in the words of `ugrbl build` and `ugrbl deploy`; [] for a correct board. */
function boardProblems(draft) {
  const missing = ITEMS.filter(({ name, needed }) => needed && !draft.pins[name]?.length);
  if (missing.length) return [t`${missing[0].name} is missing`];
  const values = [...valueProblems(draft), ...networkProblems(draft)];
  const { LINK } = draft.options;
  if (LINK !== undefined && !FORM_OPTIONS.LINK.words.includes(LINK)) { // an unknown part: nothing else can be checked
    return values.filter((words) => words.startsWith("LINK:")).slice(0, 1);
  }
  const pins = pinProblems(draft), extra = values.length || pins.length ? "" : extraProblem(draft);
  return [...pins, ...wireProblems(draft), ...values, ...(extra ? [extra] : [])];
}

/** Hints about the pins of a correct board. */
function boardNotes(draft) {
  const { odd } = BOARDS.chips[draft.chip];
  return heldPins(draft).flatMap(([name, pins]) => pins.filter((pin) => odd[pin]).map((pin) => t`${name}: pin ${pin} ${translated(odd[pin])}`));
}

/** A draft from a board in boards/; null if its motors do not use pins of the chip. */
function draftOf(name) {
  const { about, chip, values } = BOARDS.boards[name];
  if (values.I2S) return null;
  const draft = { chip, title: about.replace(/["\\]/g, "").replace(/[:.].*/, ""), motors: values.MOTORS || "", rotary: values.ROTARY || "", pins: {}, options: {}, kept: {},
    repl: values.REPL_PIN ?? null, outputs: values.OUTPUTS || {}, inputs: values.INPUTS || {} };
  const apart = ["CHIP", "MPY_ARCH", "ENGINE", "MOTORS", "ROTARY", "REPL_PIN", "OUTPUTS", "INPUTS", "NO_PULL_UP", "CONTROL", ...Object.values(BOARDS.switchedOn)];
  for (const { name: item } of ITEMS) if ((values[item] ?? null) !== null) draft.pins[item] = [values[item]].flat();
  (values.CONTROL || []).forEach((pin, index) => { if (pin !== null) draft.pins[BOARDS.controls[index]] = [pin]; });
  for (const [word, value] of Object.entries(values)) {
    if (apart.includes(word) || ITEMS.some((item) => item.name === word)) continue;
    if (word in FORM_OPTIONS) draft.options[word] = value;
    else draft.kept[word] = value;
  }
  return draft;
}
