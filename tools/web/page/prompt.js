// MicroPython's prompt on the machine's link: runs Python on the board and stores files there.

const PROMPT_MS = 5000, RUN_MS = 10000, START_MS = 20000, LATE_MS = 1500;
const CTRL_A = "\x01", CTRL_B = "\x02", CTRL_C = "\x03", CTRL_D = "\x04";
// An ESP32's serial line has no handshake, so a piece must be smaller than its buffer.
const WIRE_BYTES = 128, WIRE_MS = 12;
const WRITE_BYTES = 192; // bytes of a file in one line of Python
const RAW = /raw REPL; CTRL-B to exit\r\n>$/;

const ABOUT_BOARD = `
import sys, os, json
path, sys.path[:] = sys.path[:], [".frozen"]
try:
    from base.frozen import ABOUT as frozen
except ImportError:
    frozen = ""
sys.path[:] = path
names = os.listdir("/")
def text(name):
    return open("/" + name).read() if name in names else None
print(json.dumps([".".join(map(str, sys.implementation[1][:3])), getattr(sys.implementation, "_machine", ""), frozen, "main.py" in names, text("board.py"), text("custom.py")]))
`;
/** Python that compares a new file's checksum, tests it, and replaces the old one. A board file
 * is data, so it is executed; custom.py needs the running machine, so it is only compiled. */
const PLACE_FILE = (name, checksum) => `
import hashlib, binascii, os
with open("/new.py", "rb") as file:
    text = file.read()
if binascii.hexlify(hashlib.sha256(text).digest()) != b"${checksum}":
    raise ValueError("the file was damaged on its way")
made = compile(text, "${name}", "exec")
${name === "board.py" ? "exec(made, {})" : ""}
os.rename("/new.py", "/${name}")
`;

/** A fault of Python on the board, with its traceback. */
class PythonFault extends Error {
  /** The line of the sent file, or 0. */
  get line() { return Number(/"(?:board|custom)\.py", line (\d+)/.exec(this.message)?.[1] || 0); }
  get words() { return this.message.trim().split(/\r?\n/).at(-1); }
}

/** The prompt. Call its methods one at a time; each may throw an Error for the user. */
class Prompt {
  #grbl; #text = ""; #decoder = new TextDecoder("latin1"); #waits = null;

  constructor(grbl) {
    this.#grbl = grbl;
    grbl.on("lost", () => this.#waits?.fail(new Error(t`The connection is lost.`)));
  }

  /** Enter the raw prompt. fresh: with a soft reset, so that all memory is free. */
  async enter(fresh = false) {
    const { state, link } = this.#grbl;
    if (state && !["Idle", "Alarm"].includes(state)) throw new Error(t`The machine is in ${state} and is not disturbed. Wait until it is idle.`);
    if (busy() || acting) throw new Error(t`A job is running. End it first.`); // Idle, in a tool change or a dwell
    if (!(link instanceof SerialLink)) throw new Error(t`This needs the board's USB port: open the page from disk, and press Connect by USB.`);
    this.#text = "";
    this.#grbl.lend((bytes) => this.#hear(bytes));
    try {
      await this.#ask(`\r${CTRL_C}${CTRL_C}${CTRL_C}`, />>> $/).catch(() => this.#ask(`${CTRL_B}\r${CTRL_C}`, />>> $/));
      await this.#ask(CTRL_A, RAW);
      if (fresh) await this.#ask(CTRL_D, /soft reboot[^]*raw REPL; CTRL-B to exit\r\n>$/, RUN_MS);
    } catch (error) {
      this.leave();
      throw error;
    }
  }

  /** Run Python; returns its output. Throws PythonFault. */
  async run(code) {
    this.#text = "";
    for (let at = 0; at < code.length; at += WIRE_BYTES) {
      this.#write(code.slice(at, at + WIRE_BYTES));
      await new Promise((resolve) => setTimeout(resolve, WIRE_MS));
    }
    const [, out, fault] = await this.#ask(CTRL_D, /OK([^\x04]*)\x04([^\x04]*)\x04>$/, RUN_MS);
    if (fault) throw new PythonFault(fault);
    return out;
  }

  /** Query the board's software; board, custom: the texts of these files, or null. */
  async about() {
    const [version, machine, frozen, hasMain, board, custom] = JSON.parse(await this.run(ABOUT_BOARD));
    return { version, machine, frozen, hasMain, board, custom };
  }

  /** Replace a file if it arrived undamaged and Python accepts it. */
  async putFile(name, text, progress = () => {}) {
    const bytes = ENCODER.encode(text);
    await this.run('file = open("/new.py", "wb")');
    for (let at = 0; at < bytes.length; at += WRITE_BYTES) {
      progress(at / bytes.length);
      await this.run(`file.write(${pythonBytes(bytes.subarray(at, at + WRITE_BYTES))})`);
    }
    await this.run("file.close()");
    await this.run(PLACE_FILE(name, await sha256(bytes)));
  }

  /** Start main.py as at power-up; resolves to the welcome, or to "" and the message instead. */
  async start() {
    this.#text = "";
    this.#write(CTRL_B);
    const ended = /(Grbl(?:HAL)? \d[^\r\n]*)\r\n|\[MSG:([^\]]*)\]\r\n|soft reboot\r\n[^]*>>> $/;
    try {
      const [, banner = "", message = ""] = await this.#ask(CTRL_D, ended, START_MS);
      if (banner) return { banner, message: "" };
      // A message may also come before a welcome.
      return await this.#ask("", /(Grbl(?:HAL)? \d[^\r\n]*)\r\n/, LATE_MS)
        .then(([, late]) => ({ banner: late, message: "" }), () => ({ banner: "", message }));
    } finally {
      this.#grbl.takeBack();
    }
  }

  /** Return the link to the machine; the board stays at the prompt. */
  leave() {
    this.#write(CTRL_B);
    this.#grbl.takeBack();
  }

  #write(text) { if (this.#grbl.lent) this.#grbl.link.write(ENCODER.encode(text)); }

  #hear(bytes) {
    this.#text += this.#decoder.decode(bytes, { stream: true });
    this.#waits?.look();
  }

  /** Send, and wait until the pattern matches; resolves to the match. */
  #ask(text, pattern, patience = PROMPT_MS) {
    return new Promise((resolve, reject) => {
      const end = (act, value) => {
        clearTimeout(timer);
        this.#waits = null;
        act(value);
      };
      const timer = setTimeout(() => end(reject, new Error(t`MicroPython's prompt does not answer. Unplug the board, plug it in, and connect again.`)), patience);
      this.#waits = {
        fail: (error) => end(reject, error),
        look: () => {
          const found = pattern.exec(this.#text);
          if (!found) return;
          this.#text = "";
          end(resolve, found);
        },
      };
      this.#write(text);
    });
  }
}

const pythonBytes = (bytes) => `b"${Array.from(bytes, (byte) => `\\x${byte.toString(16).padStart(2, "0")}`).join("")}"`;

async function sha256(bytes) {
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", bytes));
  return Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** The name in BOARDS.chips for MicroPython's name of the machine; "" if unknown. */
function chipOf(machine) {
  const processor = machine.split(" with ").at(-1);
  const names = Object.keys(BOARDS.chips).filter((name) => BOARDS.chips[name].processor === processor);
  const pico = /\bPico ?(2?) ?(W?)\b/.exec(machine);
  const own = pico ? `pico${pico[1]}${pico[2] ? "_w" : ""}` : processor.toLowerCase();
  return names.includes(own) ? own : names.at(-1) || "";
}
