// A slice through the cost over two directions: colours, contour lines, quadratic model, path of the solver.

import { INK, RIM, SOFT, TRUTH, block2, contour, ellipsePoints, fresh, inverse2, levelColour, polyline, tickText, ticks, viridis } from "./drawing.js";
import { DIRECTIONS, NAMES, UNITS } from "./pose.js";

const MARGIN = { left: 44, right: 52, top: 4, bottom: 32 }, LINES = 9, CLICK_PX = 4;

export class SliceView {
  // onMove(step, phase, isJump): a step along the two directions from the pose at the start of the drag.
  constructor(canvas, pair, onMove, onZoom) {
    Object.assign(this, { canvas, pair, onMove, index: pair.map((name) => DIRECTIONS.indexOf(name)) });
    this.tile = document.createElement("canvas");
    canvas.addEventListener("pointerdown", (event) => {
      if (!this.grid) return;
      canvas.setPointerCapture(event.pointerId);
      this.held = { x: event.offsetX, y: event.offsetY, extent: this.extent(), moved: false };
    });
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    canvas.addEventListener("pointerup", (event) => this.release(event));
    canvas.addEventListener("pointercancel", () => (this.held = null));
    canvas.addEventListener("wheel", (event) => { event.preventDefault(); onZoom(Math.exp(0.0016 * event.deltaY)); }, { passive: false });
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // A new answer; one without slices leaves the old one in sight, dimmed.
  show(answer, levels) {
    this.answer = answer;
    this.levels = levels;
    const found = answer.arrays[`slice_${this.pair[0]}${this.pair[1]}`];
    this.isOld = !found;
    if (found) {
      const { slice_xy: a, slice_xyaw: b } = answer.arrays;
      this.grid = { values: found.data, side: found.shape[0], extent: answer.head.extent, range: rangeOf(a.data, b.data) };
      this.paint();
    }
    this.draw();
  }

  extent() { return this.pair.map((name) => this.grid.extent[name]); }

  box() {
    const width = this.canvas.clientWidth - MARGIN.left - MARGIN.right;
    const height = this.canvas.clientHeight - MARGIN.top - MARGIN.bottom;
    return { left: MARGIN.left, top: MARGIN.top, width: Math.max(width, 10), height: Math.max(height, 10) };
  }

  // Screen position of offsets (a, b).
  at([a, b]) {
    const { left, top, width, height } = this.box(), [ea, eb] = this.extent();
    return [left + (0.5 + (0.5 * a) / ea) * width, top + (0.5 - (0.5 * b) / eb) * height];
  }

  drag(event) {
    if (!this.held) return;
    const dx = event.offsetX - this.held.x, dy = event.offsetY - this.held.y;
    if (!this.held.moved && Math.hypot(dx, dy) < CLICK_PX) return;
    const phase = this.held.moved ? "move" : "start", { width, height } = this.box(), [ea, eb] = this.held.extent;
    this.held.moved = true;
    // The landscape is dragged, so the pose goes the other way.
    const step = { [this.pair[0]]: (-2 * ea * dx) / width, [this.pair[1]]: (2 * eb * dy) / height };
    if (phase === "start") this.onMove({}, "start");
    this.onMove(step, "move");
  }

  release(event) {
    const held = this.held;
    this.held = null;
    if (!held) return;
    if (held.moved) return this.onMove(null, "end");
    const { left, top, width, height } = this.box(), [ea, eb] = held.extent;
    const a = (2 * (event.offsetX - left)) / width - 1, b = 1 - (2 * (event.offsetY - top)) / height;
    if (Math.abs(a) > 1 || Math.abs(b) > 1) return;
    this.onMove({}, "start");
    this.onMove({ [this.pair[0]]: a * ea, [this.pair[1]]: b * eb }, "move");
    this.onMove(null, "end");
  }

  paint() {
    const { values, side, range } = this.grid;
    this.tile.width = this.tile.height = side;
    const g = this.tile.getContext("2d"), image = g.createImageData(side, side);
    for (let i = 0; i < side; i++) {
      for (let j = 0; j < side; j++) {
        const value = values[i * side + j], place = 4 * ((side - 1 - j) * side + i);
        const colour = Number.isFinite(value) ? viridis((value - range[0]) / (range[1] - range[0])) : [40, 46, 54];
        image.data.set([...colour, 255], place);
      }
    }
    g.putImageData(image, 0, 0);
  }

  draw() {
    if (!this.grid) return;
    const { g } = fresh(this.canvas), { left, top, width, height } = this.box(), { side } = this.grid;
    g.save();
    g.beginPath();
    g.rect(left, top, width, height);
    g.clip();
    // The outermost values stand on the rim, so the picture reaches half a cell beyond it.
    const cellX = width / (side - 1), cellY = height / (side - 1);
    g.globalAlpha = this.isOld ? 0.55 : 1;
    g.imageSmoothingQuality = "high";
    g.drawImage(this.tile, left - cellX / 2, top - cellY / 2, width + cellX, height + cellY);
    this.lines(g);
    g.globalAlpha = 1;
    this.model(g);
    this.marks(g);
    g.restore();
    this.axes(g);
    this.bar(g);
  }

  lines(g) {
    const { values, side, range } = this.grid, { left, top, width, height } = this.box();
    g.strokeStyle = "rgba(255,255,255,.33)";
    g.lineWidth = 0.7;
    g.beginPath();
    const place = ([i, j]) => [left + (i / (side - 1)) * width, top + (1 - j / (side - 1)) * height];
    for (let k = 1; k <= LINES; k++) {
      contour(values, side, range[0] + ((range[1] - range[0]) * k) / (LINES + 1), (from, to) => {
        g.moveTo(...place(from));
        g.lineTo(...place(to));
      });
    }
    g.stroke();
  }

  // The quadratic model within the slice: the line on which it is half a nat (1 sigma) above its minimum.
  model(g) {
    const [i, j] = this.index, { gradient, hessian } = this.answer.head;
    const covariance = inverse2(block2(hessian, i, j));
    if (!covariance) return;
    const minimum = covariance.map((row) => -(row[0] * gradient[i] + row[1] * gradient[j]));
    g.strokeStyle = "#ffffff";
    g.setLineDash([4, 3]);
    g.lineWidth = 1.3;
    polyline(g, ellipsePoints(covariance, minimum).map((point) => this.at(point)));
    g.setLineDash([]);
    g.lineWidth = 1;
    polyline(g, [this.at([0, 0]), this.at(minimum)]);
  }

  marks(g) {
    const { path, to_truth: truth } = this.answer.head, [i, j] = this.index;
    const cross = ([x, y], reach) => { polyline(g, [[x - reach, y], [x + reach, y]]); polyline(g, [[x, y - reach], [x, y + reach]]); };
    if (path) {
      let last = this.at([0, 0]);
      for (const step of path.steps.filter((s) => s.accepted)) {
        const place = this.at([step.xi[i], step.xi[j]]);
        g.strokeStyle = g.fillStyle = levelColour(step.level, this.levels);
        g.lineWidth = 2;
        polyline(g, [last, place]);
        g.beginPath();
        g.arc(...place, 2.2, 0, 7);
        g.fill();
        last = place;
      }
    }
    if (truth) {
      g.strokeStyle = TRUTH;
      g.lineWidth = 2;
      cross(this.at([truth[i], truth[j]]), 7);
    }
    const [x, y] = this.at([0, 0]);
    g.strokeStyle = "#ffffff";
    g.lineWidth = 1.5;
    g.beginPath();
    g.arc(x, y, 5, 0, 7);
    g.stroke();
  }

  axes(g) {
    const { left, top, width, height } = this.box(), [ea, eb] = this.extent();
    g.strokeStyle = RIM;
    g.strokeRect(left, top, width, height);
    g.fillStyle = SOFT;
    g.font = "10.5px system-ui, sans-serif";
    g.textAlign = "center";
    for (const value of ticks(ea, 5)) g.fillText(tickText(value), this.at([value, 0])[0], top + height + 13);
    g.textAlign = "right";
    for (const value of ticks(eb, 5)) g.fillText(tickText(value), left - 5, this.at([0, value])[1] + 3.5);
    g.fillStyle = INK;
    g.textAlign = "center";
    const text = this.pair.map((name) => `${NAMES[name]} [${UNITS[name] === "°" ? "deg" : "m"}]`);
    g.fillText(text[0], left + width / 2, top + height + 27);
    g.save();
    g.translate(11, top + height / 2);
    g.rotate(-Math.PI / 2);
    g.fillText(text[1], 0, 0);
    g.restore();
    g.textAlign = "left";
  }

  bar(g) {
    const { left, top, width, height } = this.box(), x = left + width + 9, [low, high] = this.grid.range;
    for (let k = 0; k < height; k++) {
      g.fillStyle = `rgb(${viridis(1 - k / height).join(",")})`;
      g.fillRect(x, top + k, 9, 1.5);
    }
    g.fillStyle = SOFT;
    g.font = "10.5px system-ui, sans-serif";
    g.fillText(high.toFixed(2), x + 12, top + 9);
    g.fillText(low.toFixed(2), x + 12, top + height);
    g.fillText("cost", x + 12, top + height / 2 + 4);
  }
}

function rangeOf(...arrays) {
  let low = Infinity, high = -Infinity;
  for (const values of arrays) {
    for (const value of values) {
      if (value < low) low = value;
      if (value > high) high = value;
    }
  }
  return low < high ? [low, high] : [0, 1];
}
