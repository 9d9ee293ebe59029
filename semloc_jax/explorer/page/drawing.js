// Canvases of the right resolution, colours, axes, contour lines.

const VIRIDIS = ["#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725"].map(rgb);
const FIT = ["#19e68c", "#a8e05f", "#ffd54f", "#ff9a4d", "#ff5252"].map(rgb);
const LEVELS = ["#b28dff", "#5aa9ff", "#2fd8c8", "#ffe45c"].map(rgb);

export const INK = "#dfe6ee", SOFT = "#8b98a8", RIM = "#2c3744", TRUTH = "#00e676", PRIOR = "#ffb300";

function rgb(text) {
  const value = parseInt(text.slice(1), 16);
  return [value >> 16, (value >> 8) & 255, value & 255];
}

function between(stops, share) {
  const place = Math.min(Math.max(share, 0), 1) * (stops.length - 1);
  const low = Math.min(Math.floor(place), stops.length - 2), rest = place - low;
  return stops[low].map((value, k) => Math.round(value + rest * (stops[low + 1][k] - value)));
}

const css = (colour) => `rgb(${colour.join(",")})`;

export const viridis = (share) => between(VIRIDIS, share);
// |residual| as a share of the ramp: on the border green, at the end of the ramp red.
export const fitColour = (share) => css(between(FIT, share));
export const fitGradient = `linear-gradient(90deg, ${FIT.map(css).join(",")})`;
export const levelColour = (level, count) => css(between(LEVELS, count > 1 ? level / (count - 1) : 1));

// The context of a canvas in CSS pixels, at the resolution of the screen, cleared.
export function fresh(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  const w = Math.max(1, Math.round(width * ratio)), h = Math.max(1, Math.round(height * ratio));
  if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
  const g = canvas.getContext("2d");
  g.setTransform(ratio, 0, 0, ratio, 0, 0);
  g.clearRect(0, 0, width, height);
  return { g, width, height };
}

// Round numbers inside [-half, half].
export function ticks(half, count) {
  const raw = (2 * half) / count, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].find((k) => k * power >= raw * 0.999) * power;
  const last = Math.floor((half * 1.001) / step), found = [];
  for (let k = -last; k <= last; k++) found.push(k * step);
  return found;
}

export function tickText(value) {
  return String(Math.round(value * 1e4) / 1e4).replace("-", "−");
}

// A number with a sign and fixed digits, minus as a minus.
export function signed(value, digits) {
  const text = Math.abs(value).toFixed(digits);
  return (value < 0 && Number(text) !== 0 ? "−" : "+") + text;
}

export function polyline(g, points) {
  g.beginPath();
  points.forEach(([x, y], k) => (k ? g.lineTo(x, y) : g.moveTo(x, y)));
  g.stroke();
}

// Ends of the eigenvectors of a symmetric 2x2 matrix as an ellipse: half axes and angle of the first.
export function ellipseOf([[a, b], [, d]]) {
  const mean = (a + d) / 2, apart = Math.hypot((a - d) / 2, b);
  return {
    major: Math.sqrt(Math.max(mean + apart, 0)),
    minor: Math.sqrt(Math.max(mean - apart, 0)),
    angle: 0.5 * Math.atan2(2 * b, a - d),
  };
}

export function inverse2([[a, b], [, d]]) {
  const det = a * d - b * b;
  return det > 0 ? [[d / det, -b / det], [-b / det, a / det]] : null;
}

export function block2(matrix, i, j) {
  return [[matrix[i][i], matrix[i][j]], [matrix[j][i], matrix[j][j]]];
}

// Points of the ellipse {c + d : d' M^-1 d = 1} of a covariance M.
export function ellipsePoints(covariance, [cx, cy], count = 72) {
  const { major, minor, angle } = ellipseOf(covariance);
  const c = Math.cos(angle), s = Math.sin(angle), points = [];
  for (let k = 0; k <= count; k++) {
    const t = (2 * Math.PI * k) / count, p = major * Math.cos(t), q = minor * Math.sin(t);
    points.push([cx + c * p - s * q, cy + s * p + c * q]);
  }
  return points;
}

// Line pieces of {value = level} on a grid (marching squares), in grid coordinates.
export function contour(values, side, level, emit) {
  for (let i = 0; i + 1 < side; i++) {
    for (let j = 0; j + 1 < side; j++) {
      const a = values[i * side + j] - level, b = values[(i + 1) * side + j] - level;
      const c = values[(i + 1) * side + j + 1] - level, d = values[i * side + j + 1] - level;
      if (!(Number.isFinite(a + b + c + d))) continue;
      const cuts = [];
      if (a < 0 !== b < 0) cuts.push([i + a / (a - b), j]);
      if (b < 0 !== c < 0) cuts.push([i + 1, j + b / (b - c)]);
      if (c < 0 !== d < 0) cuts.push([i + 1 - c / (c - d), j + 1]);
      if (d < 0 !== a < 0) cuts.push([i, j + 1 - d / (d - a)]);
      for (let k = 0; k + 1 < cuts.length; k += 2) emit(cuts[k], cuts[k + 1]);
    }
  }
}
