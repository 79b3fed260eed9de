// Move once round everything that a program cuts, to check clamps and stock before the job.

const OUTLINE_POWER = 0.01; // of a laser's full power

/** [low, high] of X and Y over the cuts of a path, in mm; null without cuts. */
function cutBox(path) {
  const low = [Infinity, Infinity], high = [-Infinity, -Infinity];
  path.forEach(([x, y, , kind], index) => {
    if (!kind) return;
    for (const [px, py] of [path[index - 1] || [x, y], [x, y]]) {
      [px, py].forEach((at, axis) => {
        low[axis] = Math.min(low[axis], at);
        high[axis] = Math.max(high[axis], at);
      });
    }
  });
  return low[0] <= high[0] ? [low, high] : null;
}

/** Lines that go round a box at a feed in mm/min. A spindle's tool is raised first; a laser is on at low power, by M4: dark at rest.
 * laser: S for its power, or null. */
function outlineLines([low, high], feed, { up, laser }) {
  const corners = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]], [low[0], low[1]]];
  const words = corners.map(([x, y]) => `X${millimetres(x)} Y${millimetres(y)}`);
  if (laser === null) {
    const raise = up === null ? [] : [`$J=G21 G90 Z${millimetres(up)} F${feed}`];
    return [...raise, ...words.map((place) => `$J=G21 G90 ${place} F${feed}`)];
  }
  return [`G21 G90 G0 ${words[0]}`, ...words.slice(1).map((place, index) => `G1 ${place}${index ? "" : ` F${feed} M4 S${laser}`}`), "M5 G0"];
}

$("outline").onclick = () => alone(async () => {
  const box = cutBox(program.path);
  if (!box) return trouble(t`The program cuts nothing: there is no outline.`);
  await readAtRest();
  const [low, high] = box, isLaser = grbl.setting(32) === 1, z = grbl.workMm()[2];
  const { highest } = program.readTo(program.lines.length + 1), up = Number.isFinite(highest) && highest > z ? highest : null;
  const laser = isLaser ? Math.max(1, Math.round(OUTLINE_POWER * (grbl.setting(30) || 1000))) : null;
  const mm = (value) => `${millimetres(value)} mm`;
  const words = [t`X from ${mm(low[0])} to ${mm(high[0])}, Y from ${mm(low[1])} to ${mm(high[1])}, at the jog feed.`,
    isLaser ? t`The laser is on at S${laser}, 1 % of full power.` : up === null ? t`Z stays at ${mm(z)}. The spindle stays as it is.` : t`First Z goes up to ${mm(up)}. The spindle stays as it is.`];
  if (!await sure(t`Outline`, words, isLaser ? t`Laser on, go round` : t`Go round`)) return;
  const feed = jogFeed() * (grbl.inches ? MM_PER_INCH : 1);
  await sendLines(outlineLines(box, feed, { up, laser })).catch((error) => {
    if (isLaser && is("Idle")) grbl.send("M5");
    trouble(t`${t`Outline`} ends at: ${error.message}`);
  });
});
