// Pictures of $3 and $23: the table from above, and Z at its right side.

const MASK_BOX = "0 0 110 76";
const PATHS = { X: "M16 66h40M50 61l6 5-6 5", Y: "M10 58v-44M5 20l5-6 5 6", Z: "M96 66v-52M91 20l5-6 5 6" };
const MIDDLES = { X: [36, 66], Y: [10, 36], Z: [96, 40] };

function maskPicture(words, ...inside) {
  const picture = svg("svg", { class: "mask", viewBox: MASK_BOX, role: "img", "aria-label": words });
  picture.append(svg("rect", { x: 18, y: 10, width: 52, height: 44, fill: "none", stroke: "currentColor" }), ...inside);
  return picture;
}

/** $3: the direction of each motor; an inverted one in colour, its arrow turned round. */
PICTURES.set(3, (mask) => {
  const turned = (letter) => mask >> AXES.indexOf(letter) & 1;
  const arrows = Object.entries(PATHS).map(([letter, d]) => {
    const around = turned(letter) ? { class: "on", transform: `rotate(180 ${MIDDLES[letter].join(" ")})` } : {};
    return svg("path", { d, fill: "none", stroke: "currentColor", "stroke-width": 2, ...around });
  });
  return maskPicture(Object.keys(PATHS).map((letter) => `${letter} ${turned(letter) ? t`inverted` : t`as wired`}`).join(", "), ...arrows);
});

/** $23: where the homing switches are. */
PICTURES.set(23, (mask) => {
  const low = [0, 1, 2].map((axis) => mask >> axis & 1);
  const words = [[t`right`, t`left`], [t`back`, t`front`], [t`top`, t`bottom`]].map((ends, axis) => ends[low[axis]]);
  const dot = (cx, cy) => svg("circle", { class: "on", cx, cy, r: 6, fill: "currentColor" });
  return maskPicture(t`Switches: ${words.join(", ")}`, svg("path", { d: "M96 10v44", stroke: "currentColor" }), dot(low[0] ? 18 : 70, low[1] ? 54 : 10), dot(96, low[2] ? 54 : 10));
});
