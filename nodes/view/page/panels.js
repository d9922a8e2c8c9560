// Panels without pictures: figures, plan, candidates, executor, nodes, topics, log.

import { colour, lines } from "./charts.js";

const element = (id) => document.getElementById(id);
const SPAN = 60_000;
/** Points of a computed line. */
const MOST_POINTS = 400;
/** The most log lines. */
const MOST_LINES = 200;

/** Sets a text if it has changed: otherwise screen readers would repeat it, and selections would be lost. */
function say(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

function make(name, text = "", attributes = {}) {
  const made = document.createElement(name);
  made.textContent = text;
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

const hertz = (value) => (value > 0 ? `${value.toFixed(1)} Hz` : "–");
const fixed = (value, digits = 3) => (value === null || value === undefined ? "–" : Number(value).toPrecision(digits));

export function median(values) {
  if (!values.length) return null;
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[sorted.length >> 1];
}

/** Missing inputs by panel. */
export const missingIn = (status, panel) => status?.missing.find((missing) => missing.panel === panel)?.text ?? "";

function drops(status) {
  let total = 0;
  for (const node of status.nodes) {
    for (const [name, value] of node.values) if (name.startsWith("dropped: ")) total += Number(value) || 0;
  }
  return total;
}

export function figures({ status, record, now, screenLatency }) {
  const topic = (ending) => status?.topics.find(({ name }) => name.endsWith(ending));
  say(element("figure-camera"), hertz(status?.topics[0]?.hz ?? 0));
  say(element("figure-predicted"), hertz(topic("/predicted")?.hz ?? 0));
  const latency = median(record.within("latencies", now - 5000, now + 1000).map((item) => item.latency));
  say(element("figure-latency"), latency === null ? "–" : `${latency.toFixed(0)} ms`);
  say(element("figure-screen"), screenLatency === null ? "–" : `${screenLatency.toFixed(0)} ms`);
  const ratio = record.ratio(now);
  say(element("figure-ratio"), ratio === null ? "–" : ratio.toFixed(2));
  say(element("figure-drops"), status ? String(drops(status)) : "–");
}

export function errorPanel({ status, record, now, x, k, cursor, canTrust = true }) {
  const panel = element("error");
  const errors = record.within("errors", ...x);
  const byStep = new Map();
  for (const error of errors) {
    if (!byStep.has(error.k)) byStep.set(error.k, []);
    byStep.get(error.k).push([error.t, error.ratio]);
  }
  const gap = 8 * (record.period || 400);
  const series = [...byStep]
    .sort(([a], [b]) => (a === k) - (b === k))
    .map(([step, points]) => ({ points, gap, colour: colour("model"), bold: step === k, faint: step !== k }));
  const first = errors.filter((error) => error.k === 1);
  // For a long bag, one per pixel.
  const stride = Math.ceil(first.length / MOST_POINTS);
  const band = first.filter((_, index) => index % stride === 0).map((error) => [error.t, record.ratio(error.t)]);
  series.unshift({ points: band, gap, colour: colour("real"), wide: true });
  const highest = Math.max(1.5, ...errors.filter((error) => error.k === k).map((error) => error.ratio ?? 0));
  const marks = [{ value: 1, colour: colour("soft"), label: "held frame" }];
  lines(panel.querySelector(".chart"), { x, y: [0, Math.min(4, highest * 1.1)], now, zero: canTrust ? "now" : "0 s", unit: "error ratio", series, marks, cursor });
  say(panel.querySelector(".missing"), errors.length ? "" : missingIn(status, "error"));
  const ratio = record.ratio(cursor ?? now);
  const doubt = status?.nodes.find((node) => node.name.endsWith("predictor") && /unlike those|no better than/.test(node.message));
  const verdict = ratio === null ? "" : ratio < 1 ? `explains ${Math.round(100 * (1 - ratio))} % of the motion` : "no better than repeating the last frame";
  const trust = element("trust");
  say(trust, canTrust && doubt ? `not to be trusted: ${doubt.message}` : verdict);
  trust.style.color = doubt || ratio >= 1 ? colour("bad") : ratio === null ? "" : colour("good");
}

/** The colours of the first three values of an action: of Bridge V2's seven these are dx, dy and dz [m]. */
const AXES = ["x", "y", "z"];
const BRIDGE_VALUES = 7;
const MM = 1000;
const LEGENDS = {
  bridge: ["dx forward", "dy left", "dz up: the end effector's velocity along the axes of the robot's base. Turns and gripper are not drawn."],
  other: ["first", "second", "third value of the actions, in the robot's units. Further values are not drawn."],
};

/** The actions that were taken, and those of the plan: motions of the end effector in mm per s, an action lasting as long as
    it says; actions of another kind as they are. */
export function planPanel({ status, record, now, cursor, isLive, plan }) {
  const panel = element("plan");
  const at = cursor ?? now;
  const x = [at - 8000, at + 4000];
  const taken = record.within("actions", x[0], at);
  const count = (plan?.actions.values[0] ?? taken.at(-1)?.values)?.length ?? BRIDGE_VALUES;
  const isMotion = count === BRIDGE_VALUES;
  const series = [];
  let highest = isMotion ? 20 : 0.01;
  const drawn = (value, ms) => {
    const height = isMotion && ms > 0 ? (value * MM) / (ms / 1000) : value;
    highest = Math.max(highest, Math.abs(height));
    return height;
  };
  for (const [index, tone] of AXES.slice(0, count).entries()) {
    const points = [];
    for (let number = 0; number + 1 < taken.length; number++) {
      const { t, values } = taken[number];
      const ms = taken[number + 1].t - t;
      points.push([t, ms > 0 && index in values ? drawn(values[index], ms) : null]);
    }
    series.push({ points, stepped: true, gap: 2000, colour: colour(tone) });
    if (!plan) continue;
    const { begin: beginNs, period_ms: period } = plan.actions;
    const begin = Number(beginNs) / 1e6;
    const planned = plan.actions.values.map((values, number) => [begin + number * period, drawn(values[index], period)]);
    if (planned.length) planned.push([begin + planned.length * period, planned.at(-1)[1]]);
    series.push({ points: planned, stepped: true, bold: true, colour: colour(tone) });
  }
  lines(panel.querySelector(".chart"), { x, y: [-highest * 1.1, highest * 1.1], now: at, zero: isLive ? "now" : "shown", unit: isMotion ? "mm/s" : "", series, cursor: at });
  for (const [index, text] of LEGENDS[isMotion ? "bridge" : "other"].entries()) say(element(`plan-legend-${index}`), text);
  const note = panel.querySelector(":scope > .missing");
  say(note, plan ? "" : missingIn(status, "plan"));
  if (!plan) {
    say(element("plan-cost"), "");
    say(element("plan-text"), "");
    return;
  }
  const terms = plan.terms.length > 1 ? ` = ${plan.terms.map(([name, cost]) => `${name} ${fixed(cost)}`).join(" + ")}` : "";
  say(element("plan-cost"), `cost ${fixed(plan.cost)}${terms}`);
  say(element("plan-text"), `${plan.planner}: ${plan.candidates} candidates in ${plan.taken_ms.toFixed(0)} ms${plan.cut ? ", cut by the deadline" : ""}; ` +
    `distance to the goal ${fixed(plan.distance)}; cost by iteration ${plan.iterations.map((cost) => fixed(cost)).join(" → ")}.`);
}

/** The candidates on offer, with buttons if choosing is permitted. */
export function candidatesPanel({ offer, assessment, canPick, pick }) {
  const panel = element("candidates");
  panel.hidden = !offer;
  if (!offer) return;
  const isOf = assessment && assessment.candidates === offer.stamp;
  const words = `${offer.stamp}/${isOf ? assessment.stamp : ""}/${canPick}`;
  if (panel.dataset.words === words) return;
  panel.dataset.words = words;
  say(element("candidates-text"), `${offer.chunks.length} offered by ${offer.policy || "a policy"}`);
  const items = offer.chunks.map((chunk, index) => {
    const [cost, success] = isOf ? (assessment.costs[index] ?? [null, null]) : [null, null];
    const item = make("li", "", isOf && assessment.best === index ? { class: "best" } : {});
    const parts = [`${index}: ${chunk.values.length} actions`];
    if (cost !== null) parts.push(`cost ${fixed(cost)}`);
    if (success !== null) parts.push(`success ${(100 * success).toFixed(0)} %`);
    if (isOf && assessment.best === index) parts.push("best");
    item.append(make("span", parts.join(" · ")));
    if (canPick) {
      const button = make("button", "pick");
      button.onclick = () => pick(offer.stamp, index);
      item.append(button);
    }
    return item;
  });
  element("candidate-list").replaceChildren(...items);
}

export function executorPanel({ status, control, isBag }) {
  // A bag's executor cannot be stopped.
  const executor = isBag ? null : status.executor;
  element("executor").hidden = !executor;
  if (!executor) return;
  const isSilent = status.executor_age_ms > 3000;
  say(element("executor-state"), isSilent ? `${executor.state}, silent for ${(status.executor_age_ms / 1000).toFixed(0)} s` : executor.state);
  say(element("executor-text"), `${executor.reason ? `${executor.reason}. ` : ""}Chunks and plans: ${executor.begun} begun, ${executor.refused} refused, ` +
    `${executor.vetoed} vetoed, ${executor.interrupted} interrupted.`);
  element("arm").hidden = control !== "all" || executor.state !== "dry run";
  element("release").hidden = control !== "all" || executor.state !== "stopped";
  element("disarm").hidden = executor.state === "dry run" || executor.state === "stopped";
}

/** The learner's state, and the error ratios of its rounds. */
export function learnerPanel({ status }) {
  const { learner } = status;
  const panel = element("learner");
  panel.hidden = !learner;
  if (!learner) return;
  say(element("learner-state"), learner.detail);
  const { rounds } = learner;
  const last = rounds.at(-1);
  const verdict = last && (last.accepted ? "its model is in use" : "the model before stayed");
  say(element("learner-text"), last
    ? `Round ${last.number}: ${last.ratio.toFixed(2)}, before ${last.before.toFixed(2)}; ${verdict}. ${Math.round(learner.recorded_s / 60)} min recorded.`
    : `No round yet. ${Math.round(learner.recorded_s)} s recorded.`);
  const points = (name) => rounds.map((round) => [round.at * 1000, round[name]]);
  const highest = Math.max(1.1, ...rounds.map((round) => Math.max(round.ratio, round.before)));
  const x = [(rounds[0]?.at ?? 0) * 1000 - 30_000, (last?.at ?? 0) * 1000 + 30_000];
  lines(panel.querySelector(".chart"), {
    x, y: [0, Math.min(3, highest)], now: (last?.at ?? 0) * 1000, zero: "last round", unit: "error ratio",
    marks: [{ value: 1, colour: colour("soft"), label: "held frame" }],
    series: [{ points: points("before"), colour: colour("real"), wide: true }, { points: points("ratio"), colour: colour("model"), bold: true }],
  });
}

/** The rows of a table by name; kept, so that open details and the focus stay. */
function rowsOf(table, items, name, begin, update) {
  const body = table.querySelector("tbody");
  table.rowsByName ??= new Map();
  const rows = items.map((item) => {
    let row = table.rowsByName.get(name(item));
    if (!row) {
      row = begin(item);
      table.rowsByName.set(name(item), row);
    }
    update(row, item);
    return row;
  });
  if (rows.length !== body.rows.length || rows.some((row, index) => row !== body.rows[index])) body.replaceChildren(...rows);
}

export function nodesPanel({ status, isBag }) {
  const panel = element("nodes");
  // Reports about parts of a node are shown only if they are not OK.
  const nodes = status.nodes.filter((node) => node.level > 0 || !node.name.includes(": "));
  say(panel.querySelector(".missing"), nodes.length ? "" : isBag ? "the bag has nothing on /diagnostics" : "no node has reported on /diagnostics yet");
  const begin = (node) => {
    const [row, name, text, details] = ["tr", "td", "td", "details"].map((tag) => make(tag));
    name.append(make("span"), node.name.replace(/^\/?wm\//, ""));
    details.append(make("summary"), make("dl"));
    text.append(details);
    row.append(name, text);
    return row;
  };
  rowsOf(panel.querySelector("table"), nodes, (node) => node.name, begin, (row, node) => {
    const isSilent = !isBag && node.age_ms > 3500;
    row.className = isSilent ? "silent" : "";
    const light = row.querySelector("span");
    light.className = `level level-${node.level}`;
    light.title = ["ok", "warn", "error", "stale"][node.level] ?? "";
    say(row.querySelector("summary"), isSilent ? `silent for ${(node.age_ms / 1000).toFixed(0)} s; last: ${node.message}` : node.message);
    const details = row.querySelector("details");
    if (details.open) {
      details.querySelector("dl").replaceChildren(...node.values.flatMap(([key, value]) => [make("dt", key), make("dd", value)]));
    }
  });
}

export function topicsPanel({ status, isBag }) {
  const begin = ({ name }) => {
    const row = make("tr");
    row.append(make("td", name), make("td", "", { class: "number" }), make("td", "", { class: "number" }));
    return row;
  };
  rowsOf(element("topics").querySelector("table"), status.topics, (topic) => topic.name, begin, (row, { hz, count, publishers }) => {
    row.className = count ? "" : "silent";
    say(row.cells[1], isBag ? "" : count ? hertz(hz) : publishers ? "silent" : "no publisher");
    say(row.cells[2], count ? String(count) : "");
  });
}

const LEVELS = { 10: "debug", 20: "info", 30: "warn", 40: "error", 50: "fatal" };

export function logPanel({ record, until }) {
  const least = Number(element("log-level").value);
  const list = element("log").querySelector("ol");
  const lines = record.log.filter((line) => line.level >= least && line.t <= until).slice(-MOST_LINES);
  const words = `${lines.length}/${lines.at(-1)?.at}/${lines[0]?.at}`;
  if (list.dataset.words === words) return;
  list.dataset.words = words;
  const isAtEnd = list.scrollTop + list.clientHeight >= list.scrollHeight - 8;
  list.replaceChildren(...lines.map((line) => {
    const item = make("li", "", { class: `level-${line.level}` });
    item.append(make("b", `${new Date(line.t).toLocaleTimeString()} ${LEVELS[line.level] ?? line.level} ${line.node.replace(/^wm\./, "")} `), line.text);
    return item;
  }));
  if (isAtEnd) list.scrollTop = list.scrollHeight;
}

export { SPAN };
