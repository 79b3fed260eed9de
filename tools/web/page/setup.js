// The steps of the setup: one is shown at a time; the browser stores the entries.

const KEPT_AS = "ugrbl-setup";
const kept = (() => {
  try {
    return JSON.parse(localStorage.getItem(KEPT_AS)) || {};
  } catch (error) {
    console.info("nothing is kept:", error.message); // storage is disabled, or was written by another page
    return {};
  }
})();
/** Store a value in this browser. */
function keep(name, value) {
  kept[name] = value;
  try {
    localStorage.setItem(KEPT_AS, JSON.stringify(kept));
  } catch (error) {
    console.info("not kept:", error.message);
  }
}

const SETUP_STEPS = [...$("setup-steps").children].map(({ dataset }) => dataset.step);
let setupStep = "";
/** Functions that run when a step is shown, by its name. */
const STEP_SHOWN = {};

function showStep(name) {
  setupStep = name;
  keep("step", name);
  for (const button of $("setup-steps").children) {
    if (button.dataset.step === name) button.setAttribute("aria-current", "step");
    else button.removeAttribute("aria-current");
  }
  for (const panel of document.querySelectorAll("[data-step-panel]")) panel.hidden = panel.dataset.stepPanel !== name;
  const steps = SETUP_STEPS.filter((step) => step in STEP_SHOWN), at = steps.indexOf(name);
  $("step-back").hidden = at < 1;
  $("step-next").hidden = at === steps.length - 1;
  $("step-back").onclick = () => showStep(steps[at - 1]);
  $("step-next").onclick = () => showStep(steps[at + 1]);
  STEP_SHOWN[name]?.();
}

/** Show sentences, each with a tone: bad, warn or good. */
function says(id, rows) {
  $(id).replaceChildren(...rows.map(([text, tone]) => make("li", { className: tone }, text)));
}

/** Begin when all parts are loaded; a page served by a board has only the guide. */
function beginSetup() {
  for (const button of $("setup-steps").children) {
    button.hidden = !(button.dataset.step in STEP_SHOWN);
    button.onclick = () => showStep(button.dataset.step);
  }
  showStep(kept.step in STEP_SHOWN ? kept.step : SETUP_STEPS.find((step) => step in STEP_SHOWN));
}
addEventListener("load", beginSetup);
