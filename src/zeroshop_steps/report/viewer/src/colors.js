// Colours of distances: dark blue is none, yellow the end of the scale (cividis-like, readable without red and green), grey does not count.

const STOPS = [
  [0.0, 0.06, 0.13, 0.35],
  [0.25, 0.16, 0.4, 0.58],
  [0.5, 0.27, 0.66, 0.6],
  [0.75, 0.82, 0.74, 0.33],
  [1.0, 0.98, 0.36, 0.2],
];
const UNSEEN = 255;
const LARGEST = 254;

function at(share) {
  const next = Math.max(1, STOPS.findIndex((stop) => stop[0] >= share));
  const [a, b] = [STOPS[next - 1], STOPS[next]];
  const t = (share - a[0]) / (b[0] - a[0]);
  return [1, 2, 3].map((channel) => a[channel] + t * (b[channel] - a[channel]));
}

const linear = (value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);

/** Linear RGB of every vertex, three floats each, from levels of 0 to 254, or 255 for what does not count. */
export function heat(levels) {
  const table = Array.from({ length: 256 }, (_, level) => (level === UNSEEN ? [0.55, 0.55, 0.55] : at(level / LARGEST)).map(linear));
  const colors = new Float32Array(levels.length * 3);
  levels.forEach((level, vertex) => colors.set(table[level], 3 * vertex));
  return colors;
}

/** The scale as a CSS gradient. */
export function gradient() {
  const stops = STOPS.map(([share, ...rgb]) => `rgb(${rgb.map((value) => Math.round(value * 255)).join(" ")}) ${share * 100}%`);
  return `linear-gradient(to right, ${stops.join(", ")})`;
}
