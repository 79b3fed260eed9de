// Macros: the user's own buttons. This browser stores them; they can be saved to a file.

const MACROS_AS = "ugrbl-macros";
const PLACEHOLDER = /\{(\w+)(?:=([^{}]*))?\}/g;
let macros = [];

/** Macros from JSON: [{ name, lines }]. Throws an Error for invalid ones. */
function readMacros(text) {
  const read = JSON.parse(text);
  if (!Array.isArray(read) || !read.every(({ name, lines }) => typeof name === "string" && typeof lines === "string")) throw new Error(t`there are no macros in it`);
  return read.map(({ name, lines }) => ({ name, lines }));
}

try {
  macros = readMacros(localStorage.getItem(MACROS_AS) || "[]");
} catch (error) {
  console.info("no macros:", error.message); // storage is off, or holds something else
}

function keepMacros() {
  try {
    localStorage.setItem(MACROS_AS, JSON.stringify(macros));
  } catch (error) {
    trouble(t`This browser does not keep macros: ${error.message}. Save them to a file.`);
  }
  renderMacros();
}

/** The arguments of a macro: [[name, default]], each once. */
function argumentsOf(lines) {
  return [...new Map([...lines.matchAll(PLACEHOLDER)].map(([, name, usual]) => [name, usual || ""]))];
}

async function runMacro({ name, lines }) {
  const asked = argumentsOf(lines), inputs = asked.map(([label, usual]) => make("input", { value: usual, "aria-label": label }));
  const fields = asked.map(([label], index) => make("label", {}, label, inputs[index]));
  if (asked.length && !await sure(name, [], t`Run`, [], fields)) return;
  const values = Object.fromEntries(asked.map(([label], index) => [label, inputs[index].value.trim()]));
  const ready = lines.replace(PLACEHOLDER, (_, label) => values[label]).split("\n").map(bare).filter(Boolean);
  const wrong = ready.find(unsafe);
  if (wrong) return trouble(`${name}: ${wrong}\n${unsafe(wrong)}`);
  await sendLines(ready).catch((error) => trouble(t`${name} ends at: ${error.message}`));
}

function renderMacros() {
  $("macros").replaceChildren(...macros.map((macro) => make("button", { "data-needs": "idle", disabled: !NEEDS.idle(), onclick: () => alone(() => runMacro(macro)) }, macro.name)));
  if (!macros.length) $("macros").append(make("span", { className: "small faint" }, t`None yet.`));
}

function renderMacroRows() {
  $("macros-rows").replaceChildren(...macros.map((macro, index) => make("div", { style: "display:grid;gap:4px;padding:6px 0;border-top:1px solid var(--line)" },
    make("div", { className: "row spread" }, make("input", { value: macro.name, size: 14, "aria-label": t`Name of macro ${index + 1}`, onchange: ({ target }) => { macro.name = target.value.trim() || t`Macro`; keepMacros(); } }),
      make("button", { "aria-label": t`Remove ${macro.name}`, onclick: () => { macros.splice(index, 1); keepMacros(); renderMacroRows(); } }, t`Remove`)),
    make("textarea", { className: "mono", rows: 3, value: macro.lines, spellcheck: false, "aria-label": t`Lines of ${macro.name}`, style: "width:100%;font:inherit;color:inherit;background:var(--ground);border:1px solid var(--line);border-radius:var(--round);padding:6px 8px", onchange: ({ target }) => { macro.lines = target.value; keepMacros(); } }))));
}

$("macros-edit").onclick = () => {
  const shown = $("macros-form").hidden;
  $("macros-form").hidden = !shown;
  $("macros-edit").setAttribute("aria-expanded", String(shown));
  if (shown) renderMacroRows();
};
$("macro-add").onclick = () => {
  macros.push({ name: t`Macro ${macros.length + 1}`, lines: "" });
  keepMacros();
  renderMacroRows();
};
$("macros-save").onclick = () => saveFile("ugrbl-macros.json", JSON.stringify(macros, null, 2), "application/json");
$("macros-file").onchange = async ({ target }) => {
  const [file] = target.files;
  target.value = "";
  try {
    macros = readMacros(await file.text());
    keepMacros();
    renderMacroRows();
  } catch (error) {
    trouble(`${file.name}: ${error.message}`);
  }
};
renderMacros();
