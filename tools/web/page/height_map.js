// A height map: the top of the work, probed on a grid over the area that the open program cuts.

const HEIGHT_AS = "ugrbl-height", PLOT_PX = [360, 240], WAY_MM = 2; // moves are cut into pieces no longer than that
let heightMap = null; // { x: [mm], y: [mm], z: [row][column] of mm, work coordinates }

/** A height map from JSON. Throws an Error for an invalid one. */
function readHeights(text) {
  const read = JSON.parse(text), numbers = (list) => Array.isArray(list) && list.length > 1 && list.every(Number.isFinite);
  if (read === null) return null;
  if (!numbers(read.x) || !numbers(read.y) || read.z?.length !== read.y.length || !read.z.every((row) => numbers(row) && row.length === read.x.length)) throw new Error(t`this is no height map`);
  return { x: read.x, y: read.y, z: read.z };
}

function setHeights(map) {
  heightMap = map;
  try {
    localStorage.setItem(HEIGHT_AS, JSON.stringify(map));
  } catch (error) {
    console.info("not kept:", error.message);
  }
  renderProbe();
  drawHeights();
}

/** The height at a position, between four points; beyond the grid the height of its edge. */
function heightAt({ x, y, z }, px, py) {
  const cell = (list, at) => {
    const clamped = Math.min(Math.max(at, list[0]), list.at(-1));
    const index = Math.max(0, Math.min(list.length - 2, list.findLastIndex((one) => one <= clamped)));
    return [index, (clamped - list[index]) / (list[index + 1] - list[index])];
  };
  const [column, right] = cell(x, px), [row, up] = cell(y, py);
  const low = z[row][column] * (1 - right) + z[row][column + 1] * right;
  const high = z[row + 1][column] * (1 - right) + z[row + 1][column + 1] * right;
  return low * (1 - up) + high * up;
}

const evenly = (low, high, count) => Array.from({ length: count }, (_, index) => low + (high - low) * index / (count - 1));

function heightGrid() {
  const box = program && cutBox(program.path);
  if (!box) return null;
  const [low, high] = box;
  return { x: evenly(low[0], high[0], Math.max(2, Math.round(probeValue("columns")))), y: evenly(low[1], high[1], Math.max(2, Math.round(probeValue("rows")))) };
}

PROBE_KINDS.height = { title: t`Height map`, fields: ["columns", "rows", "far", "feed", "up"], words: t`Open a program first: the grid lies on what it cuts. Set Z by the plate or by hand before, at the height of this map's 0.`,
  picture: [["work", 10, 55, 100, 25], ["tool", 57, 8, 6, 24]], way: "M20 50v-10M40 52v-12M60 48v-12M80 50v-10M100 46v-8", lines: heightLines, run: probeHeights,
  done: () => t`${heightMap.x.length * heightMap.y.length} points. Heights from ${millimetres(Math.min(...heightMap.z.flat()))} to ${millimetres(Math.max(...heightMap.z.flat()))} mm.` };

function heightLines() {
  const grid = heightGrid();
  if (!grid) return [`(${t`no program is open that cuts something`})`];
  const corner = (list) => `${millimetres(list[0])} … ${millimetres(list.at(-1))}`;
  return [`G90 G0 ${word("Z", probeValue("up"))}`, `(${t`${grid.x.length} times ${grid.y.length} points: X ${corner(grid.x)}, Y ${corner(grid.y)}`})`, "G0 X Y", `G91 G38.2 ${word("Z", -probeValue("far"))} F${probeValue("feed")}`, `G90 G0 ${word("Z", probeValue("up"))}`];
}

async function probeHeights() {
  const grid = heightGrid();
  if (!grid) throw new Error(t`Open a program that cuts something first.`);
  const offset = inMm(grbl.offset)[2] || 0, z = grid.y.map(() => []), up = `G90 G0 ${word("Z", probeValue("up"))}`;
  await sendLines([up]);
  for (const [row, y] of grid.y.entries()) {
    const columns = [...grid.x.entries()];
    if (row % 2) columns.reverse(); // alternate rows run backwards
    for (const [column, x] of columns) {
      $("probe-says").textContent = t`Point ${row * grid.x.length + (row % 2 ? grid.x.length - column : column + 1)} of ${grid.x.length * grid.y.length} …`;
      await sendLines([`G0 ${word("X", x)} ${word("Y", y)}`, `G91 G38.2 ${word("Z", -probeValue("far"))} F${probeValue("feed")}`]);
      z[row][column] = touched()[2] - offset;
      await sendLines([up]);
    }
  }
  setHeights({ ...grid, z });
}

function drawHeights() {
  const canvas = $("height-plot"), pen = canvas.getContext("2d");
  if (!heightMap) return;
  const { x, y, z } = heightMap, flat = z.flat(), low = Math.min(...flat), high = Math.max(...flat);
  const wide = x.at(-1) - x[0] || 1, tall = y.at(-1) - y[0] || 1, scale = Math.min(PLOT_PX[0] / wide, PLOT_PX[1] / tall), cells = 24;
  [canvas.width, canvas.height] = [wide * scale, tall * scale];
  for (let i = 0; i < cells; i += 1) {
    for (let j = 0; j < cells; j += 1) {
      const at = heightAt(heightMap, x[0] + wide * (i + 0.5) / cells, y[0] + tall * (j + 0.5) / cells);
      pen.fillStyle = Plot.shade(high > low ? (at - low) / (high - low) : 0);
      pen.fillRect(i * wide * scale / cells, (cells - 1 - j) * tall * scale / cells, wide * scale / cells + 1, tall * scale / cells + 1);
    }
  }
  pen.fillStyle = "#fff";
  pen.font = "11px system-ui, sans-serif";
  y.forEach((py, row) => x.forEach((px, column) => {
    const at = [Math.min((px - x[0]) * scale + 2, wide * scale - 30), Math.max(tall * scale - (py - y[0]) * scale - 3, 11)];
    pen.fillText(z[row][column].toFixed(2), ...at);
  }));
}

/** A program whose moves follow the map. Throws an Error for words that cannot follow it. */
function withHeights(opened, map) {
  const { lines } = opened, reader = new Reader(), made = ["(moves follow a height map)", "G21 G90 G94"];
  let done = 0, from = [NaN, NaN, NaN];
  lines.forEach((text, index) => {
    const words = wordsOf(text), codes = words.filter(([letter]) => letter === "G").map(([, value]) => `G${value}`);
    const refused = codes.find((code) => !/^G([0123]|4|17|20|21|40|49|5[4-9]|54\.0|61|64|80|90|91|91\.1|94)$/.test(code));
    if (refused || /^\s*\$/.test(text)) throw new Error(t`line ${index + 1} has ${refused || t`a $ command`}, which cannot follow a height map`);
    reader.read(text);
    const rest = words.filter(([letter, value]) => !(/[XYZIJKRFN]/.test(letter) || letter === "G" && /^([0123]|20|21|90|91|94)$/.test(String(value))));
    const isEnd = ([letter, value]) => letter === "M" && [0, 1, 2, 30].includes(value); // after the line's motion
    const said = (some) => { if (some.length) made.push(some.map(([letter, value]) => letter + value).join(" ")); };
    said(rest.filter((one) => !isEnd(one)));
    for (; done < reader.path.length; done += 1) {
      made.push(...followed(from, reader.path[done], map));
      from = reader.path[done];
    }
    said(rest.filter(isEnd));
  });
  if (reader.relative || !reader.path.length) throw new Error(t`it moves relative to where the tool is (G91), or not at all`);
  return `${made.join("\n")}\n`;
}

/** A move in pieces, each at the work's height there; unchanged until X, Y and Z are known. */
function followed(from, [x, y, z, kind, , feed], map) {
  const known = from.slice(0, 3).every(Number.isFinite), far = known ? Math.hypot(x - from[0], y - from[1]) : 0;
  const pieces = kind ? Math.max(1, Math.ceil(far / WAY_MM)) : 1;
  return Array.from({ length: pieces }, (_, index) => {
    const part = (index + 1) / pieces, at = [x, y, z].map((to, axis) => (known ? from[axis] + (to - from[axis]) * part : to));
    const place = `X${millimetres(at[0])} Y${millimetres(at[1])} Z${millimetres(at[2] + heightAt(map, at[0], at[1]))}`;
    return kind ? `G1 ${place} F${millimetres(feed)}` : `G0 ${place}`;
  });
}

$("height-use").onclick = () => {
  try {
    openJob(new File([withHeights(program, heightMap)], program.name.replace(/(\.\w+)?$/, "_level$1")));
  } catch (error) {
    $("probe-says").textContent = `${program.name}: ${error.message}.`;
  }
};
$("height-save").onclick = () => saveFile("height_map.json", JSON.stringify(heightMap), "application/json");
$("height-drop").onclick = () => setHeights(null);
$("height-file").onchange = async ({ target }) => {
  const [file] = target.files;
  target.value = "";
  try {
    setHeights(readHeights(await file.text()));
  } catch (error) {
    $("probe-says").textContent = `${file.name}: ${error.message}.`;
  }
};
try {
  heightMap = readHeights(localStorage.getItem(HEIGHT_AS) || "null");
} catch (error) {
  console.info("no height map:", error.message);
}
renderProbe();
drawHeights();
