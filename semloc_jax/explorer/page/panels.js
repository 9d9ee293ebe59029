// Classes with their residuals, fine moves, covariance, numbers in words.

import { INK, RIM, SOFT, TRUTH, block2, ellipsePoints, fresh, inverse2, polyline, signed, tickText, ticks } from "./drawing.js";
import { DIRECTIONS, LIMITS, NAMES, UNITS, offset, standing } from "./pose.js";

const BINS = 21;
const STEPS = { x: 0.05, y: 0.02, z: 0.01, roll: 0.05, pitch: 0.05, yaw: 0.05 };
const make = (tag, properties = {}, ...children) => {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
};

export class ClassTable {
  constructor(root, onToggle, onAlone) {
    Object.assign(this, { root, onToggle, onAlone });
  }

  open(scene) {
    this.scene = scene;
    const head = make("tr");
    for (const text of ["class", "cost", "residual [px]", "in ramp", "in view"]) head.append(make("th", { textContent: text }));
    const body = make("tbody");
    this.rows = scene.channels.map((channel) => {
      const check = make("input", { type: "checkbox", checked: true }), swatch = make("span", { className: "swatch" });
      swatch.style.background = channel.colour;
      const meter = make("i"), canvas = make("canvas"), within = make("td"), seen = make("td");
      const label = make("label", { title: channel.classes.join(", ") }, check, swatch, channel.title);
      const row = make("tr", {}, make("td", {}, label), make("td", { className: "bar-cell" }, make("div", { className: "meter" }, meter)), make("td", {}, canvas), within, seen);
      row.dataset.channel = channel.name;
      check.addEventListener("change", () => this.onToggle(channel.name, check.checked));
      row.addEventListener("click", (event) => { if (!label.contains(event.target)) check.click(); });
      row.addEventListener("dblclick", () => this.onAlone(channel.name));
      body.append(row);
      return { row, check, meter, canvas, within, seen };
    });
    this.root.replaceChildren(make("table", {}, make("thead", {}, head), body));
  }

  draw(answer, shown, rampPx) {
    const counts = this.histograms(answer);
    answer.head.channels.forEach((fit, index) => {
      const { row, check, meter, canvas, within, seen } = this.rows[index], on = shown.has(fit.name);
      row.classList.toggle("off", !on || fit.in_view_px <= 0);
      check.checked = on;
      meter.style.width = `${100 * fit.cost}%`;
      meter.parentElement.parentElement.title = `cost ${fit.cost.toFixed(3)}`;
      within.textContent = fit.visible_px > 0 ? `${Math.round(100 * fit.inlier_ratio)} %` : "–";
      seen.textContent = fit.visible_px >= 9999.5 ? `${(fit.visible_px / 1000).toFixed(1)}k px` : `${Math.round(fit.visible_px)} px`;
      this.histogram(canvas, counts[index], this.scene.channels[index].colour, rampPx);
    });
  }

  histograms(answer) {
    const { residual, weight, channel } = answer.arrays;
    const counts = this.scene.channels.map(() => new Float64Array(BINS));
    for (let k = 0; k < weight.data.length; k++) {
      if (weight.data[k] <= 0) continue;
      const bin = Math.min(Math.floor(((residual.data[k] + 1) / 2) * BINS), BINS - 1);
      counts[channel.data[k]][Math.max(bin, 0)] += weight.data[k];
    }
    return counts;
  }

  histogram(canvas, counts, colour, rampPx) {
    const { g, width, height } = fresh(canvas), most = Math.max(...counts, 1e-9), floor = height - 9;
    g.fillStyle = colour;
    counts.forEach((count, bin) => {
      const tall = ((floor - 2) * count) / most;
      g.fillRect((bin * width) / BINS + 0.5, floor - tall, width / BINS - 1, tall);
    });
    g.fillStyle = RIM;
    g.fillRect(0, floor, width, 1);
    g.fillStyle = SOFT;
    g.font = "8.5px system-ui, sans-serif";
    g.fillText(`−${rampPx}`, 0, height);
    g.textAlign = "center";
    g.fillText("0", width / 2, height);
    g.textAlign = "right";
    g.fillText(`${rampPx}`, width, height);
  }
}

export class Moves {
  // onStep(step) for buttons, onStand(name, value) for sliders.
  constructor(root, onStep, onStand) {
    this.rows = DIRECTIONS.map((name) => {
      const less = make("button", { textContent: "−", title: `${NAMES[name]} −${STEPS[name]} ${UNITS[name]}` });
      const more = make("button", { textContent: "+", title: `${NAMES[name]} +${STEPS[name]} ${UNITS[name]}` });
      const canvas = make("canvas"), value = make("div", { className: "value" });
      less.addEventListener("click", () => onStep({ [name]: -STEPS[name] }));
      more.addEventListener("click", () => onStep({ [name]: STEPS[name] }));
      const row = make("div", { className: "row" }, make("span", { textContent: NAMES[name] }), less, canvas, more, value);
      let slider = null;
      if (name in LIMITS) {
        slider = make("input", { type: "range", min: -LIMITS[name], max: LIMITS[name], step: LIMITS[name] / 500, ariaLabel: NAMES[name] });
        slider.id = `stand-${name}`;
        slider.addEventListener("input", () => onStand(name, Number(slider.value)));
        row.append(slider);
      }
      root.append(row);
      return { name, canvas, value, slider };
    });
  }

  draw(answer, pose, reference) {
    const { head, arrays } = answer, away = reference && offset(pose, reference);
    this.rows.forEach(({ name, canvas, value, slider }, index) => {
      const now = name in LIMITS ? standing(pose, name) : away ? away[name] : 0;
      const sigma = Math.sqrt(Math.max(head.covariance[index][index], 0));
      const [text, unit] = UNITS[name] === "m" ? [`σ ${(100 * sigma).toFixed(1)}`, "cm"] : [`σ ${sigma.toFixed(2)}`, "°"];
      value.innerHTML = "";
      value.append(`${signed(now, UNITS[name] === "m" ? 3 : 2)} ${UNITS[name]}`, make("small", { textContent: `${text} ${unit}` }));
      if (slider && document.activeElement !== slider) slider.value = now;
      if (arrays.curves) this.curve(canvas, arrays.curves, index, head.extent[name], head.to_truth);
    });
  }

  curve(canvas, curves, index, extent, truth) {
    const { g, width, height } = fresh(canvas), count = curves.shape[1];
    let low = Infinity, high = -Infinity;
    for (const value of curves.data) { if (value < low) low = value; if (value > high) high = value; }
    const scale = high > low ? (height - 8) / (high - low) : 0, points = [];
    for (let k = 0; k < count; k++) {
      const value = curves.data[index * count + k];
      if (Number.isFinite(value)) points.push([(k / (count - 1)) * width, height - 4 - (value - low) * scale]);
    }
    g.strokeStyle = RIM;
    polyline(g, [[width / 2, 0], [width / 2, height]]);
    if (truth) {
      const x = (0.5 + (0.5 * truth[index]) / extent) * width;
      g.strokeStyle = TRUTH;
      polyline(g, [[x, 3], [x, height - 3]]);
    }
    g.strokeStyle = "#7fd0ff";
    g.lineWidth = 1.5;
    polyline(g, points);
    g.fillStyle = SOFT;
    g.font = "8.5px system-ui, sans-serif";
    g.fillText(`±${tickText(Number(extent.toPrecision(2)))} ${UNITS[DIRECTIONS[index]]}`, 3, 9);
  }
}

// Three projections of the ellipsoid of x, y and heading, in cm and degrees.
export function drawCertainty(canvas, covariance) {
  const { g, width, height } = fresh(canvas), pairs = [[0, 1], [0, 5], [1, 5]], gap = 14;
  const text = { 0: "forward [cm]", 1: "left [cm]", 5: "heading [deg]" }, unit = { 0: 100, 1: 100, 5: 1 };
  const cell = (width - gap) / 3;
  const information = inverse6(covariance);
  pairs.forEach(([i, j], k) => {
    const box = { left: k * cell + 42, top: 8, width: cell - 50, height: height - 46 };
    const scaled = (m, a, b) => [[m[0][0] * a * a, m[0][1] * a * b], [m[1][0] * a * b, m[1][1] * b * b]];
    const whole = scaled(block2(covariance, i, j), unit[i], unit[j]);
    const held = information && inverse2(block2(information, i, j));
    const reach = [1.35 * Math.sqrt(whole[0][0]), 1.35 * Math.sqrt(whole[1][1])];
    if (!(reach[0] > 0 && reach[1] > 0)) return;
    const at = ([a, b]) => [box.left + (0.5 + (0.5 * a) / reach[0]) * box.width, box.top + (0.5 - (0.5 * b) / reach[1]) * box.height];
    g.strokeStyle = RIM;
    g.lineWidth = 1;
    g.strokeRect(box.left, box.top, box.width, box.height);
    polyline(g, [at([-reach[0], 0]), at([reach[0], 0])]);
    polyline(g, [at([0, -reach[1]]), at([0, reach[1]])]);
    const line = ellipsePoints(whole, [0, 0]).map(at);
    g.fillStyle = "rgba(53,200,180,.16)";
    g.beginPath();
    line.forEach(([x, y], n) => (n ? g.lineTo(x, y) : g.moveTo(x, y)));
    g.fill();
    g.strokeStyle = "#35c8b4";
    g.lineWidth = 1.8;
    polyline(g, line);
    if (held) {
      g.setLineDash([4, 3]);
      g.strokeStyle = "#ffffff";
      g.lineWidth = 1.2;
      polyline(g, ellipsePoints(scaled(held, unit[i], unit[j]), [0, 0]).map(at));
      g.setLineDash([]);
    }
    g.fillStyle = SOFT;
    g.font = "10px system-ui, sans-serif";
    g.textAlign = "center";
    for (const value of ticks(reach[0], 3)) g.fillText(tickText(value), at([value, 0])[0], box.top + box.height + 12);
    g.textAlign = "right";
    for (const value of ticks(reach[1], 3)) g.fillText(tickText(value), box.left - 3, at([0, value])[1] + 3);
    g.fillStyle = INK;
    g.textAlign = "center";
    g.fillText(text[i], box.left + box.width / 2, box.top + box.height + 26);
    g.save();
    g.translate(box.left - 31, box.top + box.height / 2);
    g.rotate(-Math.PI / 2);
    g.fillText(text[j], 0, 0);
    g.restore();
    g.textAlign = "left";
  });
}

// Gauss-Jordan with scaling: variances of metres and degrees differ by orders of magnitude.
function inverse6(matrix) {
  const scale = matrix.map((row, k) => Math.sqrt(row[k]));
  if (!scale.every((value) => value > 0)) return null;
  const rows = matrix.map((row, i) => [...row.map((value, j) => value / scale[i] / scale[j]), ...row.map((_, j) => Number(i === j))]);
  for (let k = 0; k < 6; k++) {
    const pivot = rows[k][k];
    if (!(pivot > 1e-12)) return null;
    rows[k] = rows[k].map((value) => value / pivot);
    rows.forEach((row, i) => { if (i !== k) { const f = row[k]; rows[i] = row.map((value, j) => value - f * rows[k][j]); } });
  }
  return rows.map((row, i) => row.slice(6).map((value, j) => value / scale[i] / scale[j]));
}

export function drawReadout(root, answer, scene, pose) {
  const { head } = answer, truth = scene.places.truth, lines = [];
  const text = (away) => `${signed(100 * away.x, 1)} cm forward, ${signed(100 * away.y, 1)} cm left, ${signed(away.yaw, 2)}°`;
  if (truth) lines.push(["pose off truth", text(offset(pose, truth)), ""]);
  lines.push(["here", `cost ${head.cost.toFixed(3)}, ${Math.round(100 * head.inlier_ratio)} % in ramp, ${Math.round(100 * head.coverage)} % usable`, ""]);
  const path = head.path;
  if (path) {
    const end = truth ? offset(path.end, truth) : null, good = path.status === "CONVERGED";
    if (end) lines.push(["solver ends off truth", text(end), Math.hypot(end.x, end.y) < 0.1 && Math.abs(end.yaw) < 0.3 ? "good" : "bad"]);
    const words = good ? `converged, ${path.steps.length} evaluations, cost ${path.cost.toFixed(3)}` : path.status_text;
    lines.push(["solver", words, good ? "" : "bad"]);
  }
  root.replaceChildren(...lines.flatMap(([name, value, kind]) => [make("span", { textContent: name }), make("span", { textContent: value, className: kind })]));
}
