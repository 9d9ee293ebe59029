// The state of the page, and the one loop that asks the server: always about the newest pose, one question at a time.

import { evaluate, getJson, postJson } from "./api.js";
import { CameraView } from "./camera_view.js";
import { levelColour } from "./drawing.js";
import { MapView } from "./map_view.js";
import { ClassTable, Moves, drawCertainty, drawReadout } from "./panels.js";
import { moved, withStanding } from "./pose.js";
import { SliceView } from "./slice_view.js";

const SLOW_MS = 60, SLICES_EVERY_MS = 300, REST_MS = 160, STEP_MS = 45, TOAST_MS = 5000, POLL_MS = 250;
const $ = (id) => document.getElementById(id);
const pause = (ms) => new Promise((done) => setTimeout(done, ms));

// What tests and the console of the browser may look at.
const state = (window.explorer = {
  scene: null, pose: null, level: 1, shown: new Set(), colouring: "residual", picture: "image", zoom: 1,
  answer: null, solved: null, moving: false, answered: [], errors: [],
  isBusy: () => asking || wanted !== null || solving, carOnScreen: () => map.carOnScreen(),
});
let wanted = null, asking = false, restTimer = 0, dragStart = null, lastMs = 0, slicesMs = 0, slicesAt = 0, solving = false;

const cameras = new CameraView($("cameras"), $("residual-legend"));
const map = new MapView($("map-base"), $("map-top"), dragTo);
const slices = [["slice-xy", ["x", "y"]], ["slice-xyaw", ["x", "yaw"]]].map(
  ([id, pair]) => new SliceView($(id), pair, dragBy, (factor) => { state.zoom = Math.min(Math.max(state.zoom * factor, 1 / 16), 8); ask(); }),
);
const classes = new ClassTable($("classes"), toggle, alone);
const moves = new Moves($("moves"), step, (name, value) => go(withStanding(state.pose, name, value)));

// Ask about the pose as it is now: coarse slices while something moves, fine ones at rest.
function ask(grid = "coarse") {
  clearTimeout(restTimer);
  wanted = grid;
  if (!asking) pump();
}

async function pump() {
  asking = true;
  while (wanted !== null) {
    let grid = wanted;
    wanted = null;
    const frame = state.scene.frame, started = performance.now();
    // Where slices take long, the contours follow the hand at full rate and the slices three times a second.
    if (grid === "coarse" && state.moving && slicesMs > SLOW_MS && started < slicesAt + SLICES_EVERY_MS) grid = "none";
    try {
      const answer = await evaluate({
        pose: state.pose, level: state.level, channels: [...state.shown], grid, zoom: state.zoom, path: true, prior: "start",
      });
      if (frame !== state.scene.frame || answer.head.frame !== frame) continue;
      lastMs = performance.now() - started;
      if (grid === "coarse") slicesMs = lastMs;
      if (grid !== "none") slicesAt = performance.now();
      state.answer = answer;
      draw();
      count(performance.now());
      if (grid !== "fine" && wanted === null) restTimer = setTimeout(() => ask("fine"), REST_MS);
    } catch (error) {
      tell(error.message);
    }
  }
  asking = false;
}

function draw() {
  const { answer, scene, level, shown, colouring } = state, rampPx = scene.levels[level].ramp_px;
  cameras.draw(answer, colouring, rampPx);
  map.draw(state.pose, answer, state.solved);
  slices.forEach((slice) => slice.show(answer, scene.levels.length));
  classes.draw(answer, shown, rampPx);
  moves.draw(answer, state.pose, scene.places.truth || scene.places.prior);
  drawCertainty($("certainty"), answer.head.covariance);
  drawReadout($("readout"), answer, scene, state.pose);
}

function count(now) {
  state.answered.push(now);
  if (state.answered.length > 2000) state.answered.splice(0, 1000);
  const rate = state.answered.filter((time) => time > now - 1000).length;
  $("rate").textContent = `${rate} updates/s, ${Math.round(lastMs)} ms`;
}

function go(pose) {
  state.solved = null;
  state.pose = pose;
  map.draw(pose, state.answer, null);
  ask();
}

function step(by) { go(moved(state.pose, by)); }

function dragTo(pose, phase) {
  state.moving = phase !== "end";
  if (phase === "move") go(pose);
}

function dragBy(by, phase) {
  state.moving = phase !== "end";
  if (phase === "start") dragStart = { ...state.pose };
  if (phase === "move") go(moved(dragStart, by));
}

// Walk along the solver's steps to where it ends.
async function solve() {
  if (solving || !state.answer) return;
  solving = true;
  $("solve").disabled = true;
  try {
    while (asking) await pause(10);
    const path = state.answer.head.path, isCalm = matchMedia("(prefers-reduced-motion: reduce)").matches;
    state.solved = path;
    state.moving = true;
    for (const { xy, yaw_deg } of isCalm ? [] : path.steps.filter((s) => s.accepted)) {
      state.pose = { ...state.pose, x_m: xy[0], y_m: xy[1], yaw_deg };
      ask();
      await pause(STEP_MS);
    }
    state.moving = false;
    state.pose = path.end;
    ask();
  } finally {
    state.moving = solving = false;
    $("solve").disabled = false;
  }
}

function toggle(name, on) {
  if (on) state.shown.add(name);
  else state.shown.delete(name);
  ask();
}

function alone(name) {
  const all = state.scene.channels.map((channel) => channel.name);
  const isAlone = state.shown.size === 1 && state.shown.has(name);
  state.shown = new Set(isAlone ? all : [name]);
  ask();
}

function setLevel(level) {
  if (level < 0 || level >= state.scene.levels.length) return;
  state.level = level;
  check("levels", level);
  ask();
}

function setColouring(colouring) {
  state.colouring = colouring;
  check("colours", colouring === "class" ? 1 : 0);
  if (state.answer) draw();
}

function setPicture(kind) {
  state.picture = kind;
  check("pictures", kind === "mask" ? 1 : 0);
  cameras.show(kind);
}

async function openFrame(index) {
  if (index < 0 || index >= state.scene.frames.length) return;
  try {
    show(await postJson("api/frame", { index }));
  } catch (error) {
    tell(error.message);
  }
}

function check(id, index) {
  [...$(id).children].forEach((button, k) => button.setAttribute("aria-checked", String(k === index)));
}

function segments(id, texts, onChoice) {
  $(id).replaceChildren(...texts.map((text, index) => {
    const button = Object.assign(document.createElement("button"), { textContent: text });
    button.setAttribute("role", "radio");
    button.addEventListener("click", () => onChoice(index));
    return button;
  }));
}

// A scene: at the start, and for every other frame.
function show(scene) {
  const isFirst = !state.scene;
  state.scene = scene;
  state.solved = state.answer = null;
  state.pose = { ...scene.places.start };
  if (isFirst) {
    state.level = scene.level;
    state.shown = new Set(scene.channels.map((channel) => channel.name));
    $("frame").replaceChildren(...scene.frames.map((id, index) => new Option(`frame ${id}`, index)));
    segments("levels", scene.levels.map(({ ramp_px }, k) => (k ? `${ramp_px} px` : `ramp ${ramp_px} px`)), setLevel);
    classes.open(scene);
  }
  $("where").textContent = $("where").title = [scene.drive, scene.variant, `masks ${scene.masks}`].filter(Boolean).join(" · ");
  $("frame").value = scene.frame;
  $("to-truth").disabled = !scene.places.truth;
  document.title = `${scene.drive} ${scene.frames[scene.frame]} · semloc explorer`;
  legend(scene);
  cameras.open(scene, state.picture);
  map.open(scene, state.pose);
  setLevel(state.level);
}

function legend(scene) {
  const items = [["#ffffff", "pose"], ...(scene.places.truth ? [["#00e676", "truth"]] : []), ["#ffb300", "prior 1σ"]];
  scene.levels.forEach(({ ramp_px }, k) => items.push([levelColour(k, scene.levels.length), `steps, ${ramp_px} px`]));
  $("map-legend").replaceChildren(...items.map(([colour, text]) => {
    const mark = document.createElement("i"), item = document.createElement("span");
    mark.style.background = colour;
    item.append(mark, text);
    return item;
  }));
}

function tell(text) {
  state.errors.push(text);
  $("toast").textContent = text;
  $("toast").hidden = false;
  clearTimeout(tell.timer);
  tell.timer = setTimeout(() => ($("toast").hidden = true), TOAST_MS);
}

const KEYS = {
  arrowup: (k) => step({ x: 0.1 * k }), arrowdown: (k) => step({ x: -0.1 * k }),
  arrowleft: (k) => step({ y: 0.1 * k }), arrowright: (k) => step({ y: -0.1 * k }),
  q: (k) => step({ yaw: 0.25 * k }), e: (k) => step({ yaw: -0.25 * k }),
  r: (k) => step({ z: 0.01 * k }), f: (k) => step({ z: -0.01 * k }),
  i: (k) => step({ pitch: 0.1 * k }), k: (k) => step({ pitch: -0.1 * k }),
  j: (k) => step({ roll: -0.1 * k }), l: (k) => step({ roll: 0.1 * k }),
  enter: solve, t: () => state.scene.places.truth && go({ ...state.scene.places.truth }),
  p: () => go({ ...state.scene.places.prior }),
  c: () => setColouring(state.colouring === "class" ? "residual" : "class"),
  m: () => setPicture(state.picture === "mask" ? "image" : "mask"),
  "[": () => openFrame(state.scene.frame - 1), "]": () => openFrame(state.scene.frame + 1),
  "?": () => $("notes").showModal(),
};

function onKey(event) {
  const isWidget = event.target.closest("input, select, dialog") || (event.key === "Enter" && event.target.closest("button"));
  if (isWidget || event.ctrlKey || event.metaKey || event.altKey || !state.pose) return;
  const key = event.key.toLowerCase();
  if (/^[1-9]$/.test(key)) return setLevel(Number(key) - 1);
  if (!KEYS[key]) return;
  event.preventDefault();
  KEYS[key](event.shiftKey ? 10 : 1);
}

function listen() {
  segments("colours", ["residual", "class"], (k) => setColouring(k ? "class" : "residual"));
  segments("pictures", ["image", "mask"], (k) => setPicture(k ? "mask" : "image"));
  check("colours", 0);
  check("pictures", 0);
  document.addEventListener("keydown", onKey);
  $("solve").addEventListener("click", solve);
  $("to-truth").addEventListener("click", KEYS.t);
  $("to-prior").addEventListener("click", KEYS.p);
  $("frame").addEventListener("change", () => openFrame(Number($("frame").value)));
  $("frame-back").addEventListener("click", KEYS["["]);
  $("frame-next").addEventListener("click", KEYS["]"]);
  $("map-in").addEventListener("click", () => map.zoom(1.6));
  $("map-out").addEventListener("click", () => map.zoom(1 / 1.6));
  $("map-center").addEventListener("click", () => map.centerOnCar());
  $("show-notes").addEventListener("click", KEYS["?"]);
}

// Wait for the compiler, telling how far it is.
async function ready() {
  for (;;) {
    const { text, done, of, ready: isReady, error } = await getJson("api/progress");
    if (error) throw new Error(error);
    if (isReady) return;
    $("loading-text").textContent = `compiling: ${text} (${done + 1} of ${of})`;
    $("loading-bar").value = (done + 0.5) / of;
    await pause(POLL_MS);
  }
}

async function start() {
  try {
    await ready();
    listen();
    show(await getJson("api/scene"));
    $("loading").classList.add("done");
  } catch (error) {
    $("loading").classList.add("failed");
    $("loading-text").textContent = error.message;
  }
}

start();
