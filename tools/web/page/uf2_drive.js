// Writes a UF2 file to the drive of a board's boot loader, if the browser can write to folders.

const UF2_MAGIC = 0x0a324655, UF2_FAMILY_AT = 28, UF2_FLAGS_AT = 8, UF2_HAS_FAMILY = 0x2000;
const FAMILIES = { 0xe48bff56: "RP2040", 0xe48bff57: "", 0xe48bff59: "RP2350", 0xe48bff5a: "RP2350" };
const DRIVES = { "RPI-RP2": "RP2040", RP2350: "RP2350" }; // Board-ID of INFO_UF2.TXT

/** The processor of a UF2 file, "" if it names none. Throws an Error for another file. */
function processorOfUf2(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (bytes.length < 512 || view.getUint32(0, true) !== UF2_MAGIC) throw new Error(t`This is no UF2 file.`);
  for (let at = 0; at + 512 <= bytes.length; at += 512) { // blocks without a chip's family come first
    if (!(view.getUint32(at + UF2_FLAGS_AT, true) & UF2_HAS_FAMILY)) continue;
    const processor = FAMILIES[view.getUint32(at + UF2_FAMILY_AT, true)];
    if (processor === undefined) throw new Error(t`This file is for another chip than RP2040 and RP2350.`);
    if (processor) return processor;
  }
  return "";
}

/** Write the file after checking that the drive belongs to a board with its chip. Returns a message. */
async function writeToDrive(file, drive) {
  const bytes = new Uint8Array(await file.arrayBuffer()), processor = processorOfUf2(bytes);
  let info = "";
  try {
    info = await (await (await drive.getFileHandle("INFO_UF2.TXT")).getFile()).text();
  } catch (error) {
    if (error.name !== "NotFoundError") throw error;
    throw new Error(t`There is no INFO_UF2.TXT: this is not the drive of a board in its boot loader.`);
  }
  const found = DRIVES[/Board-ID: *(\S+)/.exec(info)?.[1]];
  if (!found) throw new Error(t`This is the drive of another kind of board.`);
  if (processor && processor !== found) throw new Error(t`The file is for an ${processor}, and the board has an ${found}.`);
  const out = await (await drive.getFileHandle(file.name, { create: true })).createWritable();
  await out.write(bytes);
  await out.close();
  return t`${file.name} is on the board, which starts by itself now. Press Connect by USB.`;
}
