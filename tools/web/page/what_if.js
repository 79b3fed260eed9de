// Times of a program: estimated and real, and estimated with other settings. Only `ugrbl web` estimates.

const WHAT_IF = [11, ...[120, 110].flatMap((first) => [...AXES].map((_, axis) => first + axis))];
let whatIfOf = null; // the program of the answers shown

/** Estimated seconds from the job's first line to the end of another. */
function estimatedTo(number) {
  const before = job.from > 1 ? program.secondsAt(job.from - 1) : 0, at = program.secondsAt(number);
  return at - before;
}

function renderTimes() {
  const known = Boolean(job && !job.check && program.look?.times.length);
  $("times").hidden = !known;
  if (!known) return;
  const all = estimatedTo(program.lines.length);
  setText("time-all", duration(all));
  setText("time-here", job.state === "done" ? duration(all) : duration(estimatedTo(job.made)));
  setText("time-real", duration(((job.ended || performance.now()) - job.begun) / 1000));
}

function renderWhatIf() {
  $("what-if").hidden = !(program?.look && !busy() && grbl.settings.size);
  if ($("what-if").hidden) return;
  $("what-if-go").disabled = program.looking || program.outdated;
  if (whatIfOf === program) return;
  whatIfOf = program;
  $("what-if-says").replaceChildren();
}

/** Fields with the machine's values. */
function fillWhatIf() {
  const fields = WHAT_IF.filter((number) => grbl.settings.has(number)).map((number) => {
    const [name, , unit] = settingWords(number);
    return make("label", { title: translated(unit) }, `${name} $${number}`, make("input", { name: number, type: "number", min: "0", step: "any", value: Number(grbl.settings.get(number)), "aria-label": t`What if $${number}, ${name}, ${translated(unit)}` }));
  });
  $("what-if-form").replaceChildren(...fields, make("button", { id: "what-if-go", className: "main" }, t`Estimate`));
}

async function askWhatIf() {
  const seen = program, inputs = [...$("what-if-form").querySelectorAll("input")];
  const changes = Object.fromEntries(inputs.filter(({ name, value }) => Number(value) !== grbl.setting(Number(name))).map(({ name, value }) => [name, value]));
  const named = Object.entries(changes).map(([number, value]) => `$${number}=${value}`).join(" ");
  const says = (text) => $("what-if-says").prepend(make("li", {}, text));
  if (!named) return says(t`Change a number first.`);
  const wrong = inputs.find(({ name, value }) => !(Number(value) > 0) && !(name === "11" && value === "0"));
  if (wrong) return says(t`$${wrong.name} wants a number of more than 0.`);
  $("what-if-go").disabled = true;
  const answer = await simulate(seen, changes).catch((error) => new Response(error.message, { status: 500 }));
  if (seen !== program) return;
  if (!answer.ok) return says(answer.status === 409 ? t`The program was simulated anew meanwhile: ask again.` : await answer.text());
  const { seconds } = await answer.json(), less = seen.look.seconds - seconds;
  const share = Math.round(100 * Math.abs(less) / (seen.look.seconds || 1));
  says(t`${named}: ${duration(seconds)}, ${duration(Math.abs(less))} (${share} %) ${less < 0 ? t`more` : t`less`}. The machine's settings are as before.`);
}

$("what-if").ontoggle = fillWhatIf;
$("what-if-form").onsubmit = async (event) => {
  event.preventDefault();
  await askWhatIf();
  renderWhatIf();
};
fillWhatIf();
grbl.on("change", () => {
  renderTimes();
  renderWhatIf();
});
