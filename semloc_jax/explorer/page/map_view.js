// The map from above, heading up: one drags the car, turns it by its handle, moves and zooms the view.

import { INK, PRIOR, TRUTH, ellipseOf, fresh, levelColour, polyline } from "./drawing.js";

const HANDLE_M = 7.5, GRAB_PX = 16;
const rad = (degrees) => (degrees * Math.PI) / 180;

export class MapView {
  // onPose(pose, phase) with phase start, move or end.
  constructor(base, top, onPose) {
    Object.assign(this, { base, top, onPose, scene: null, pose: null, scale: 9, heading: 0, center: [0, 0] });
    top.addEventListener("pointerdown", (event) => this.grab(event));
    top.addEventListener("pointermove", (event) => this.drag(event));
    for (const name of ["pointerup", "pointercancel"]) top.addEventListener(name, () => this.release());
    top.addEventListener("wheel", (event) => this.zoomAt(event), { passive: false });
    new ResizeObserver(() => this.redraw()).observe(base.parentElement);
  }

  open(scene, pose) {
    this.scene = scene;
    this.pose = pose;
    this.heading = rad((scene.places.truth || scene.places.prior).yaw_deg);
    this.centerOnCar();
  }

  centerOnCar() {
    const height = this.base.clientHeight || 400;
    this.scale = height / 36;
    this.center = [this.pose.x_m + 11 * Math.cos(this.heading), this.pose.y_m + 11 * Math.sin(this.heading)];
    this.redraw();
  }

  zoom(factor, [px, py] = [this.base.clientWidth / 2, this.base.clientHeight / 2]) {
    const before = this.toMap(px, py);
    this.scale = Math.min(Math.max(this.scale * factor, 1.2), 600);
    const after = this.toMap(px, py);
    this.center = [this.center[0] + before[0] - after[0], this.center[1] + before[1] - after[1]];
    this.redraw();
  }

  zoomAt(event) {
    event.preventDefault();
    this.zoom(Math.exp(-0.0016 * event.deltaY), [event.offsetX, event.offsetY]);
  }

  toScreen([x, y]) {
    const c = Math.cos(this.heading), s = Math.sin(this.heading), dx = x - this.center[0], dy = y - this.center[1];
    const ahead = c * dx + s * dy, left = c * dy - s * dx;
    return [this.base.clientWidth / 2 - left * this.scale, this.base.clientHeight / 2 - ahead * this.scale];
  }

  toMap(px, py) {
    const c = Math.cos(this.heading), s = Math.sin(this.heading);
    const left = (this.base.clientWidth / 2 - px) / this.scale, ahead = (this.base.clientHeight / 2 - py) / this.scale;
    return [this.center[0] + c * ahead - s * left, this.center[1] + s * ahead + c * left];
  }

  // A point of the vehicle's frame on the screen.
  onCar(pose, [x, y]) {
    const c = Math.cos(rad(pose.yaw_deg)), s = Math.sin(rad(pose.yaw_deg));
    return this.toScreen([pose.x_m + c * x - s * y, pose.y_m + s * x + c * y]);
  }

  // Middle of the car on the page, and the pixels of a metre.
  carOnScreen() {
    const { left, top } = this.top.getBoundingClientRect(), [x, y] = this.onCar(this.pose, [1.5, 0]);
    return { x: left + x, y: top + y, scale: this.scale };
  }

  // The handle stays within reach when the view is zoomed in or out.
  handle() {
    const reach = Math.min(Math.max(HANDLE_M, 60 / this.scale), 130 / this.scale);
    return this.onCar(this.pose, [reach, 0]);
  }

  grab(event) {
    if (!this.pose || event.button > 0) return;
    const place = [event.offsetX, event.offsetY], near = ([x, y]) => Math.hypot(x - place[0], y - place[1]);
    const start = { place, pose: { ...this.pose }, center: [...this.center] };
    const onCar = near(this.onCar(this.pose, [1.5, 0])) < Math.max(GRAB_PX, 2.4 * this.scale);
    if (near(this.handle()) < GRAB_PX) this.held = { ...start, kind: "turn" };
    else if (onCar || event.shiftKey) this.held = { ...start, kind: "move" };
    else this.held = { ...start, kind: "view" };
    this.top.setPointerCapture(event.pointerId);
    if (this.held.kind !== "view") this.onPose(this.pose, "start");
  }

  drag(event) {
    if (!this.held) return this.showCursor(event);
    const { place, pose, center, kind } = this.held;
    const from = this.toMap(...place), to = this.toMap(event.offsetX, event.offsetY);
    const by = [to[0] - from[0], to[1] - from[1]];
    if (kind === "view") {
      this.held.place = [event.offsetX, event.offsetY];
      this.center = [center[0] - by[0], center[1] - by[1]];
      this.held.center = this.center;
      return this.redraw();
    }
    const next = { ...pose };
    if (kind === "move") Object.assign(next, { x_m: pose.x_m + by[0], y_m: pose.y_m + by[1] });
    else next.yaw_deg = (Math.atan2(to[1] - pose.y_m, to[0] - pose.x_m) * 180) / Math.PI;
    this.onPose(next, "move");
  }

  release() {
    const held = this.held;
    this.held = null;
    if (held && held.kind !== "view") this.onPose(this.pose, "end");
  }

  showCursor(event) {
    if (!this.pose) return;
    const near = ([x, y], reach) => Math.hypot(x - event.offsetX, y - event.offsetY) < reach;
    const on = near(this.handle(), GRAB_PX) || near(this.onCar(this.pose, [1.5, 0]), Math.max(GRAB_PX, 2.4 * this.scale));
    this.top.style.cursor = on ? "grab" : "default";
  }

  redraw() {
    if (!this.scene) return;
    this.drawBase();
    this.draw(this.pose, this.answer, this.solved);
  }

  drawBase() {
    const { g } = fresh(this.base);
    g.lineJoin = "round";
    for (const { kind, colour, points } of this.scene.shapes) {
      const places = points.map((point) => this.toScreen(point));
      g.strokeStyle = g.fillStyle = colour;
      g.globalAlpha = 0.85;
      if (kind === "dot") {
        g.beginPath();
        g.arc(...places[0], Math.max(2.2, 0.12 * this.scale), 0, 7);
        g.fill();
        continue;
      }
      g.lineWidth = kind === "face" ? 0.6 : 1.2;
      g.beginPath();
      places.forEach(([x, y], k) => (k ? g.lineTo(x, y) : g.moveTo(x, y)));
      if (kind === "face") { g.closePath(); g.fill(); }
      g.stroke();
    }
    g.globalAlpha = 1;
    this.drawScaleAndNorth(g);
  }

  drawScaleAndNorth(g) {
    const { clientWidth: width, clientHeight: height } = this.base;
    const length = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50].find((m) => m * this.scale > 50) || 100;
    g.strokeStyle = g.fillStyle = INK;
    g.lineWidth = 1.5;
    polyline(g, [[12, height - 18], [12, height - 13], [12 + length * this.scale, height - 13], [12 + length * this.scale, height - 18]]);
    g.font = "11px system-ui, sans-serif";
    g.fillText(`${length} m`, 16, height - 19);
    const x = width - 24, y = 26, north = [-Math.cos(this.heading), -Math.sin(this.heading)];
    polyline(g, [[x - 11 * north[0], y - 11 * north[1]], [x + 11 * north[0], y + 11 * north[1]]]);
    g.beginPath();
    g.arc(x + 11 * north[0], y + 11 * north[1], 2.6, 0, 7);
    g.fill();
    g.textAlign = "center";
    g.fillText("N", x + 20 * north[0], y + 20 * north[1] + 4);
    g.textAlign = "left";
  }

  // What moves: poses, path, ellipse. `solved` is the path that a solve has taken.
  draw(pose, answer, solved) {
    Object.assign(this, { pose, answer, solved });
    const { g, height } = fresh(this.top), { places, prior_sigma: sigma, levels } = this.scene;
    const spread = this.onCar(places.prior, [0, 0]);
    g.setLineDash([4, 4]);
    g.strokeStyle = PRIOR;
    g.lineWidth = 1;
    g.beginPath();
    g.arc(...spread, sigma.xy_m * this.scale, 0, 7);
    g.stroke();
    g.setLineDash([]);
    this.car(g, places.prior, PRIOR);
    if (places.truth) this.car(g, places.truth, TRUTH, "rgba(0,230,118,.12)");
    this.car(g, pose, "#ffffff", "rgba(255,255,255,.2)");
    for (const path of [solved, answer && answer.head.path]) if (path) this.path(g, path, levels.length);
    const handle = this.handle();
    g.strokeStyle = "#ffffff";
    g.lineWidth = 1.2;
    polyline(g, [this.onCar(pose, [3.9, 0]), handle]);
    g.fillStyle = "#ffffff";
    g.beginPath();
    g.arc(...handle, 5.5, 0, 7);
    g.fill();
    if (answer) this.ellipse(g, pose, answer.head.covariance, height);
  }

  car(g, pose, colour, fill) {
    g.strokeStyle = colour;
    g.lineWidth = 1.6;
    g.beginPath();
    this.scene.vehicle.forEach((point, k) => (k ? g.lineTo(...this.onCar(pose, point)) : g.moveTo(...this.onCar(pose, point))));
    g.closePath();
    if (fill) { g.fillStyle = fill; g.fill(); }
    g.stroke();
  }

  path(g, path, count) {
    let last = null;
    g.lineWidth = 2;
    for (const step of path.steps) {
      const place = this.toScreen(step.xy);
      g.strokeStyle = g.fillStyle = levelColour(step.level, count);
      if (!step.accepted) {
        const [x, y] = this.toScreen(step.tried_xy);
        g.lineWidth = 1;
        polyline(g, [[x - 3, y - 3], [x + 3, y + 3]]);
        polyline(g, [[x - 3, y + 3], [x + 3, y - 3]]);
        g.lineWidth = 2;
        continue;
      }
      if (last) polyline(g, [last, place]);
      g.beginPath();
      g.arc(...place, 2.4, 0, 7);
      g.fill();
      last = place;
    }
    if (last) {
      g.strokeStyle = "#ffffff";
      g.beginPath();
      g.arc(...last, 5.5, 0, 7);
      g.stroke();
    }
  }

  // Centimetres are invisible on a map: the ellipse is drawn larger by a round factor, which is written beside it.
  ellipse(g, pose, covariance, height) {
    const { major, minor, angle } = ellipseOf([[covariance[0][0], covariance[0][1]], [covariance[1][0], covariance[1][1]]]);
    if (!(major > 0)) return;
    const factor = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].findLast((k) => k === 1 || k * major * this.scale <= 45);
    const [x, y] = this.toScreen([pose.x_m, pose.y_m]);
    g.strokeStyle = "#ffffff";
    g.lineWidth = 1.4;
    g.beginPath();
    g.ellipse(x, y, factor * major * this.scale, factor * minor * this.scale, this.heading - Math.PI / 2 - rad(pose.yaw_deg) - angle, 0, 7);
    g.stroke();
    g.fillStyle = INK;
    g.font = "11px system-ui, sans-serif";
    g.fillText(`1σ ellipse × ${factor}`, 12, height - 34);
  }
}
