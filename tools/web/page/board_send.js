// The files: board.py, and the user's own Python

const CUSTOM_BEGIN = `"""My own words: docs/custom.md."""

from ugrbl import mcode


@mcode(100)
def hello(m):
    m.message("hello")
`;
const isBoardFile = () => $("file-name").value === "board.py";
const boardFileText = () => ownWords ?? (draft ? boardText(tidy()) : "");
const fileText = () => (isBoardFile() ? boardFileText() : kept.custom ?? CUSTOM_BEGIN);

function renderFile() {
  $("board-text").value = fileText();
  renderFileSays();
}

let fileFault = { line: 0, message: "" };
/** Numbers of the lines, and a message beside the line that it is about. */
function renderMargin() {
  const area = $("board-text"), height = parseFloat(getComputedStyle(area).lineHeight), { line, message } = fileFault;
  const numbers = area.value.split("\n").map((_, index) => make("span", { className: index + 1 === line ? "bad" : "" }, `${index + 1}\n`));
  $("file-numbers").replaceChildren(...numbers);
  $("file-numbers").scrollTop = area.scrollTop;
  const top = 9 + (line - 1) * height - area.scrollTop; // 9 px: its border and padding
  $("file-fault").hidden = !line || top < 0 || top > area.clientHeight - height;
  $("file-fault").textContent = message;
  $("file-fault").style.top = `${top}px`;
}
$("board-text").onscroll = renderMargin;

function renderFileSays() {
  fileFault = { line: 0, message: "" };
  renderMargin();
  $("remake-board").hidden = !isBoardFile() || ownWords === null || !draft;
  says("file-says", fileRows());
  renderSend();
}

function fileRows() {
  if (!isBoardFile()) return [[t`Your own Python, apart from the board file. It is compiled on the board before it replaces what is there; what fails later is a message in the console.`, ""]];
  if (ownWords !== null) return [[t`This text was written by hand or comes as it is. The board checks it when it starts.`, ""]];
  return draft ? verdict() : [[t`Choose a board first, or open a file.`, "warn"]];
}

function renderSend() {
  const open = isBoardFile() && ownWords === null && (!draft || verdict().some(([, tone]) => tone === "bad") || openJobs().length > 0);
  const usb = grbl.up && grbl.link instanceof SerialLink;
  $("send-board").disabled = Boolean(looking) || open || !usb || Boolean(grbl.state) && !is("Idle", "Alarm");
  $("send-board").title = !usb ? t`Connect the board by USB first.` : open ? t`The file is not ready: see above.` : "";
}
grbl.on("change", renderSend);
STEP_SHOWN.file = renderFile;
$("file-name").onchange = renderFile;

/** Store the typed or opened text. */
function useFile(text) {
  if (isBoardFile()) useText(text);
  else keep("custom", text);
}
$("board-text").oninput = ({ target }) => {
  useFile(target.value);
  renderFileSays();
};
$("remake-board").onclick = () => {
  ownWords = null;
  keep("ownWords", null);
  renderFile();
};
$("save-board").onclick = () => saveFile($("file-name").value, fileText(), "text/x-python");
$("open-board").onchange = async ({ target }) => {
  if (target.files[0]) useFile(await target.files[0].text());
  target.value = "";
  renderFile();
};

/** Select the faulty line of the file. */
function markLine(number) {
  const area = $("board-text"), lines = area.value.split("\n");
  const from = lines.slice(0, number - 1).join("\n").length + (number > 1 ? 1 : 0);
  area.focus();
  area.setSelectionRange(from, from + (lines[number - 1] || "").length);
  area.scrollTop = Math.max(0, (number - 4) * area.scrollHeight / lines.length);
}

/** The line of the file to which a message refers: its number is in it, or an option's name. */
function lineOf(message) {
  const said = Number(/(?:board|custom)\.py"?, line (\d+)/.exec(message)?.[1] || 0);
  const name = isBoardFile() && /([A-Z][A-Z0-9_]{2,})/.exec(message)?.[1];
  return said || (name ? fileText().split("\n").findIndex((line) => line.startsWith(`${name} =`)) + 1 : 0);
}

function showFault(message, known = 0) {
  const line = known || lineOf(message);
  says("file-says", [[`${line ? t`Line ${line}: ` : ""}${message}`, "bad"]]);
  fileFault = { line, message };
  if (line) markLine(line);
  renderMargin();
}

// A failed handler: its message names the line.
grbl.on("line", (text) => {
  if (/^\[MSG:.*custom\.py, line \d+/.test(text) && setupStep === "file" && !isBoardFile()) showFault(text.slice(5, -1));
});

/** Refuse a file for another chip. */
function checkFits({ frozen, hasMain, machine }, text) {
  if (!frozen && !hasMain) throw new Error(t`There is no ugrbl on this board: put the firmware on it first, step 1.`);
  const chip = chipOf(machine), wanted = /^MPY_ARCH = "(\w+)"/m.exec(text)?.[1];
  if (chip && wanted && BOARDS.chips[chip].mpy_arch !== wanted) throw new Error(t`This is ${machine}; the file is for another chip (MPY_ARCH = "${wanted}").`);
}

async function sendFile() {
  const name = $("file-name").value, text = fileText();
  let said = null, before = null;
  $("send-bar").hidden = false;
  const went = await atPrompt(async () => {
    onBoard = await micropython.about();
    before = isBoardFile() ? onBoard.board : onBoard.custom;
    checkFits(onBoard, text);
    await micropython.putFile(name, text, (part) => { $("send-bar").value = part; });
    said = await startMachine();
    onBoard = null;
  }, true);
  $("send-bar").hidden = true;
  if (!went) showFault(promptTrouble, faultLine);
  else if (said.banner) says("file-says", [[t`The board has taken the file, and the machine runs.`, "good"]]);
  else showFault(t`The board does not start with it: ${said.message || t`it says nothing`}`);
  if (before !== null && before !== text && !said?.banner) {
    $("file-says").append(make("li", {}, make("button", { onclick: () => { useFile(before); renderFile(); } }, t`Show the file that was there before`)));
  }
  promptTrouble = "";
  renderSend();
}
$("send-board").onclick = sendFile;
