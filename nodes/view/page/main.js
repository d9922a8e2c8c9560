// The page: records events and draws the selected time.

import { arrows, timeline } from "./charts.js";
import { Controls } from "./controls.js";
import * as panels from "./panels.js";
import { Pictures, Screen, compare, framed, placement } from "./pictures.js";
import { Record, key } from "./record.js";
import { Connection } from "./socket.js";

const element = (id) => document.getElementById(id);
const GAINS = [1, 4, 16];
/** How often everything but pictures is redrawn [ms]. */
const PANEL_PERIOD = 250;
/** A longer silence means that the page is not live [ms]; the node uses the same limit for cameras. */
const SILENT = 3000;
/** Older pairs of pictures are marked as old [ms]. */
const OLD = 5000;
const AN_HOUR = 3_600_000;
const MOST_LATENCIES = 600;

const record = new Record();
const screens = Object.fromEntries(
  ["camera", "predicted", "difference", "goal", "outcome", "subgoals", "candidate-pictures"].map((id) => [id, new Screen(element(id))]),
);
const page = {
  /** The selected frame; null: the newest, live. */
  at: null,
  k: 1,
  gainIndex: 1,
  hasArrows: true,
  hello: null,
  status: null,
  isConnected: false,
  /** When the last message arrived, since the page was opened [ms]. */
  heard: 0,
  /** Where a bag plays from, and when that began. */
  playing: null,
  /** Recent times from a frame's capture until it was drawn [ms]. */
  latencies: [],
  /** The path of the shown plan in the picture, if known. */
  way: null,
  // Sizes of the camera's and the model's pictures, once drawn.
  cameraSize: null,
  modelSize: null,
  /** When the first picture was drawn, since the page was opened [ms]. */
  firstPicture: null,
  labels: {},

  get isBag() {
    return Boolean(this.hello?.bag);
  },
  /** The estimated time of the server. */
  get now() {
    return this.isBag ? (record.newest()?.t ?? 0) : Date.now();
  },
  shown(panel) {
    return this.labels[panel] ?? null;
  },
  look(frame) {
    if (!frame) return;
    this.at = frame;
    changed();
  },
  pause() {
    this.playing = null;
    this.look(this.at ?? record.newest());
  },
  live() {
    if (this.isBag) this.look(record.newest());
    else this.at = null;
    this.playing = null;
    changed();
  },
  toggle() {
    if (this.isBag) {
      if (this.playing) this.pause();
      else if (this.at) {
        this.playing = { from: this.at === record.newest() ? record.frames[0].t : this.at.t, since: performance.now() };
        requestAnimationFrame(play);
      }
    } else if (this.at) this.live();
    else this.pause();
    changed();
  },
  step(by, withPrediction = false) {
    this.playing = null;
    const from = this.at ?? record.newest();
    if (!from) return;
    this.look(record.step(from, by, withPrediction ? (frame) => record.predictionOf(frame.t, this.k) : undefined) ?? from);
  },
  setK(k) {
    this.k = Math.min(Math.max(1, k), Number(element("k").max));
    element("k").value = this.k;
    changed();
  },
  gain() {
    this.gainIndex = (this.gainIndex + 1) % GAINS.length;
    screens.difference.wanted = null;
    document.body.classList.toggle("difference");
    changed();
  },
  toggleArrows() {
    this.hasArrows = !this.hasArrows;
    changed();
  },
};

const connection = new Connection({
  message(message) {
    page.heard = performance.now();
    if (message.op === "hello") {
      page.hello = message;
      page.isConnected = true;
      page.status = page.newest = null;
      record.clear();
      pictures.clear();
      element("notice").hidden = true;
      element("token-form").hidden = true;
      controls.permit(message.control, page.isBag);
    } else if (message.op === "events") {
      for (const event of message.events) record.add(event);
      if (page.isBag && !page.at) page.at = record.newestPair(page.k, Infinity)?.frame ?? record.newest();
    } else if (message.op === "status") page.status = message;
    changed();
  },
  picture({ label, blob }) {
    page.heard = performance.now();
    pictures.add(label, blob);
    const t = Number(label.stamp) / 1e6;
    if (label.source === "camera") page.newest = { ...label, t };
    changed();
  },
  failed(text) {
    const stamp = page.isBag && page.at ? page.at.stamp : `${Date.now()}000000`;
    record.add({ t: "log", stamp, at: stamp, level: 30, node: "this page", text });
    drawn = "";
  },
  state() {
    page.isConnected = false;
    changed();
  },
  refused(status, text) {
    page.isConnected = false;
    document.body.dataset.state = "refused";
    sayState();
    element("notice").textContent = text;
    element("notice").hidden = false;
    element("token-form").hidden = status !== 401;
  },
});
const pictures = new Pictures(connection);
const controls = new Controls(connection, page);

let isDue = false;
/** Schedules drawing. */
function changed() {
  if (isDue) return;
  isDue = true;
  requestAnimationFrame(() => {
    isDue = false;
    drawPictures();
  });
}

/** Shows a picture in a panel. */
function show(id, label, name = key(label), drawn) {
  page.labels[id] = label;
  screens[id].show(name, () => pictures.get(label), drawn);
}

const wholeSeconds = (milliseconds) => `${Math.floor(milliseconds / 1000)} s`;

/** The page's state: id, name, and its duration if relevant. */
function stateOf() {
  if (!page.isConnected) return document.body.dataset.state === "refused" ? ["refused", "refused"] : ["connecting", "not connected, trying again"];
  if (page.isBag) return ["bag", page.playing ? "bag, playing" : "bag"];
  if (page.at) return ["paused", "paused"];
  const silence = performance.now() - page.heard;
  if (silence > SILENT) return ["stale", "no message", silence];
  const camera = page.status?.topics[0];
  const age = camera?.age_ms ?? null;
  if (age === null) return page.newest ? ["live", "live"] : ["waiting", `connected, waiting for ${camera?.name ?? "the node"}`];
  return age > SILENT ? ["stale", "no frame", age] : ["live", "live"];
}

function sayState() {
  const [state, words, age] = stateOf();
  document.body.dataset.state = state;
  const [text, time] = element("state").children;
  if (text.textContent !== words) text.textContent = words;
  // A separate element, so that screen readers do not read every second.
  time.textContent = age === undefined ? "" : ` for ${wholeSeconds(age)}`;
}

/** How the model frames the camera's pictures. */
const fit = () => page.status?.fit ?? "stretch";

/** Stretched predicted pictures have the camera's aspect ratio; others have the model's. */
function shapePredicted() {
  const size = fit() === "stretch" ? page.cameraSize : page.modelSize;
  if (!size) return;
  for (const id of ["predicted", "difference"]) screens[id].aspect = `${size.width} / ${size.height}`;
}

/** The part of the camera's picture that the model sees, in fractions of its width and height; null: all of it. */
function seen() {
  const { cameraSize: from, modelSize: to } = page;
  if (fit() !== "crop" || !from || !to) return null;
  const { x, y, width, height } = placement("crop", from, to).source;
  return [x / from.width, y / from.height, width / from.width, height / from.height];
}

function drawPictures() {
  const isLive = !page.at && !page.isBag;
  // A picture arrives before its event.
  const newest = page.newest && page.newest.t >= (record.newest()?.t ?? 0) ? page.newest : record.newest();
  const frame = isLive ? newest : page.at;
  sayState();
  if (!frame) {
    for (const id of ["camera", "predicted", "difference"]) screens[id].blank(panels.missingIn(page.status, id === "camera" ? id : "predicted") || (page.isConnected ? "" : "not connected"));
    return;
  }
  show("camera", frame, key(frame), (picture) => {
    screens.camera.aspect = `${picture.width} / ${picture.height}`;
    page.cameraSize = { width: picture.width, height: picture.height };
    shapePredicted();
    page.firstPicture ??= performance.now();
    const latency = performance.timeOrigin + performance.now() - frame.t;
    if (isLive && Math.abs(latency) < AN_HOUR) {
      page.latencies.push(latency);
      if (page.latencies.length > MOST_LATENCIES) page.latencies.shift();
    }
    drawArrows();
  });
  const age = page.status?.topics[0]?.age_ms ?? 0;
  const newestText = age > SILENT ? "the last frame" : "now";
  screens.camera.caption.textContent = isLive ? newestText : new Date(frame.t).toLocaleTimeString();
  if (isLive) screens.camera.say(panels.missingIn(page.status, "camera"));
  drawPair(frame, isLive);
  drawStrip(frame);
  const [goal, outcome] = [record.before("goals", isLive ? Infinity : frame.t), record.before("outcomes", isLive ? Infinity : frame.t + AN_HOUR)];
  if (goal) show("goal", goal);
  if (outcome) show("outcome", outcome);
  const subgoals = record.before("subgoals", isLive ? Infinity : frame.t);
  element("subgoals").hidden = !subgoals;
  if (subgoals) show("subgoals", subgoals);
  const candidates = record.before("candidatePictures", isLive ? Infinity : frame.t);
  if (candidates) show("candidate-pictures", candidates);
}

/** The prediction of the shown time, or while live the last prediction, and its difference. */
function drawPair(frame, isLive) {
  const { k } = page;
  const own = record.predictionOf(frame.t, k);
  const pair = own ? { frame, picture: own } : isLive ? record.newestPair(k, frame.t) : null;
  if (!pair) {
    const text = panels.missingIn(page.status, "predicted") || `no picture of this moment, ${k} ${k === 1 ? "step" : "steps"} ahead`;
    page.labels.predicted = null;
    for (const id of ["predicted", "difference"]) {
      screens[id].blank(text);
      screens[id].caption.textContent = "";
    }
    return;
  }
  show("predicted", pair.picture, key(pair.picture), (picture) => {
    page.modelSize = { width: picture.width, height: picture.height };
    shapePredicted();
  });
  const ahead = ((k * record.period) / 1000).toFixed(1);
  const age = isLive ? frame.t - pair.frame.t : 0;
  const ofWhat = age < 50 ? "this frame" : `the frame of ${(age / 1000).toFixed(1)} s ago`;
  screens.predicted.caption.textContent = `${ahead} s in advance: ${ofWhat}`;
  screens.predicted.caption.classList.toggle("old", age > OLD);
  const gain = GAINS[page.gainIndex];
  const difference = screens.difference;
  const name = `${key(pair.frame)} ${key(pair.picture)} ${gain} ${fit()}`;
  if (difference.wanted === name) return;
  difference.wanted = name;
  const held = record.frame(pair.picture.from, true);
  const all = [pictures.get(pair.frame), pictures.get(pair.picture), held ? pictures.get(held) : null];
  Promise.all(all).then(([real, predicted, heldPicture]) => {
    if (difference.wanted !== name || !real || !predicted) return;
    const { psnr, held: heldPsnr } = compare(difference.canvas, real, predicted, heldPicture, { gain, fit: fit() });
    difference.shown = name;
    difference.say("");
    page.psnr = psnr;
    difference.caption.textContent = `× ${gain}, PSNR ${psnr.toFixed(1)} dB${heldPsnr === null ? "" : ` (held frame: ${heldPsnr.toFixed(1)} dB)`}`;
  });
}

let cells = [];

/** The newest rollout: predictions above, real frames below. */
function drawStrip(frame) {
  const { from, steps } = record.rollout(frame.t);
  const horizon = Math.max(record.horizon, ...steps.keys(), 0);
  if (element("k").max !== String(Math.max(1, horizon)) && horizon > 0) element("k").max = horizon;
  if (page.k > horizon && horizon > 0) page.setK(horizon);
  const text = `k=${page.k}${record.period ? `, ${((page.k * record.period) / 1000).toFixed(1)} s` : ""}`;
  if (element("k-text").textContent !== text) element("k-text").textContent = text;
  if (cells.length !== horizon) {
    cells = Array.from({ length: horizon }, (_, index) => {
      const button = document.createElement("button");
      const [predicted, real, label] = [document.createElement("canvas"), document.createElement("canvas"), document.createElement("span")];
      button.append(predicted, real, label);
      button.onclick = () => page.setK(index + 1);
      const screen = (canvas) => new Screen({ querySelector: (name) => (name === "canvas" ? canvas : name === ".screen" ? button : null) });
      return { button, label, predicted: screen(predicted), real: screen(real) };
    });
    element("strip").replaceChildren(...cells.map((cell) => cell.button));
  }
  cells.forEach((cell, index) => {
    const k = index + 1;
    const picture = steps.get(k);
    if (picture) cell.predicted.show(key(picture), () => pictures.get(picture));
    const real = picture ? record.frame(picture.t, true) : null;
    if (real) cell.real.show(`${key(real)} ${fit()}`, async () => framed(await pictures.get(real), fit(), page.modelSize));
    else if (cell.real.wanted) cell.real.blank("");
    cell.label.textContent = `+${((k * record.period) / 1000).toFixed(1)} s`;
    cell.button.setAttribute("aria-pressed", String(k === page.k));
    cell.button.title = `${k} steps after ${new Date(from).toLocaleTimeString()}: predicted above, real below`;
  });
}

function planShown() {
  return record.before("plans", page.at ? page.at.t : Infinity);
}

function drawArrows() {
  const canvas = element("camera").querySelector(".overlay");
  const plan = page.hasArrows ? planShown() : null;
  const now = page.at?.t ?? page.now;
  // An ended plan does not belong to this picture.
  const isCurrent = plan && now < Number(plan.actions.begin) / 1e6 + (plan.actions.values.length + 2) * plan.actions.period_ms;
  page.way = isCurrent ? record.wayOf(plan) : null;
  arrows(canvas, seen(), isCurrent ? { values: plan.actions.values, way: page.way?.points, axes: page.hello?.axes ?? [] } : {});
}

/** The span of the time line: live the last minute, of a bag all of it. */
function span() {
  if (!page.isBag) return [page.now - panels.SPAN, page.now];
  return [record.frames[0]?.t ?? 0, Math.max(record.newest()?.t ?? 0, record.errors.at(-1)?.t ?? 0)];
}

let drawn = "";

function drawPanels() {
  if (document.hidden || !page.hello) return;
  sayState();
  const { status, k } = page;
  // For a bag, panels change only with the selected time.
  const view = `${page.at?.stamp}/${k}/${record.count}/${status?.now}/${innerWidth}`;
  if (page.isBag && view === drawn) return;
  drawn = view;
  if (!page.isBag) record.prune(page.now - 1.5 * panels.SPAN);
  const x = span();
  const now = page.isBag ? x[0] : page.now;
  const cursor = page.at?.t ?? (page.isBag ? x[1] : null);
  const screenLatency = page.at ? null : panels.median(page.latencies.slice(-25));
  panels.figures({ status, record, now: cursor ?? page.now, screenLatency });
  panels.errorPanel({ status, record, now, x, k, cursor, canTrust: !page.isBag });
  panels.planPanel({ status, record, now: page.now, cursor, isLive: !page.at && !page.isBag, plan: planShown() });
  const until = page.at?.t ?? Infinity;
  panels.candidatesPanel({ offer: record.before("candidates", until), assessment: record.before("assessments", until + 2000), canPick: controls.canSteer, pick: (stamp, index) => controls.pick(stamp, index) });
  panels.logPanel({ record, until: page.isBag ? until : Infinity });
  if (status) {
    const { isBag } = page;
    panels.executorPanel({ status, control: controls.control, isBag });
    panels.learnerPanel({ status });
    panels.nodesPanel({ status, isBag });
    panels.topicsPanel({ status, isBag });
  }
  const line = element("timeline");
  timeline(line, { x, record, cursor: cursor ?? x[1], isLive: !page.at && !page.isBag });
  const seconds = page.isBag ? ((cursor ?? x[0]) - x[0]) / 1000 : ((cursor ?? x[1]) - x[1]) / 1000;
  element("moment").textContent = page.at || page.isBag ? `${seconds.toFixed(1)} s${page.isBag ? ` of ${((x[1] - x[0]) / 1000).toFixed(1)}` : ""}` : "now";
  line.setAttribute("aria-valuemax", Math.round((x[1] - x[0]) / 1000));
  line.setAttribute("aria-valuenow", Math.round(((cursor ?? x[1]) - x[0]) / 1000));
  line.setAttribute("aria-valuetext", element("moment").textContent);
  const isRunning = page.isBag ? Boolean(page.playing) : !page.at;
  element("play").textContent = isRunning ? "❚❚" : "▶";
  element("play").setAttribute("aria-label", isRunning ? "Pause" : "Continue");
  element("live").hidden = page.isBag;
  element("live").disabled = !page.at;
  document.title = page.isBag ? `wm view: ${page.hello.bag}` : "wm view";
  drawArrows();
}

/** Plays a bag until its end or another selection. */
function play() {
  if (!page.playing) return;
  const t = page.playing.from + (performance.now() - page.playing.since);
  const frame = record.before("frames", t);
  if (frame && frame !== page.at) page.look(frame);
  if (t > (record.newest()?.t ?? 0)) page.pause();
  else requestAnimationFrame(play);
}

function seek(event) {
  const { left, width } = element("timeline").getBoundingClientRect();
  const x = span();
  page.playing = null;
  page.look(record.frame(x[0] + ((event.clientX - left) / width) * (x[1] - x[0])));
}

element("timeline").addEventListener("pointerdown", (event) => {
  element("timeline").setPointerCapture(event.pointerId);
  seek(event);
});
element("timeline").addEventListener("pointermove", (event) => event.buttons && seek(event));
element("k").addEventListener("input", () => page.setK(Number(element("k").value)));
element("play").onclick = () => page.toggle();
element("back").onclick = () => page.step(-1);
element("forward").onclick = () => page.step(1);
element("live").onclick = () => page.live();
element("difference").querySelector(".screen").onclick = () => page.gain();
for (const button of document.querySelectorAll("button.swap")) button.onclick = () => document.body.classList.toggle("difference");
element("log-level").onchange = () => (drawn = "");
element("token-form").onsubmit = (event) => {
  event.preventDefault();
  connection.use(element("token").value.trim());
};
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  drawn = "";
  drawPanels();
});
setInterval(drawPanels, PANEL_PERIOD);

// For benchmarks and tests.
window.wmView = { page, record, connection };
