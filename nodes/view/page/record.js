// The server's events, by kind and in order of their stamps. Times are milliseconds since 1970; stamps stay texts, since
// they name pictures.

const milliseconds = (stamp) => Number(stamp) / 1e6;

/** The index of the first of the sorted `items` at or after `t`. */
function lower(items, t) {
  let [low, high] = [0, items.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (items[middle].t < t) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Inserts an item in order, nearly always at the end. */
function insert(items, item) {
  if (!items.length || items[items.length - 1].t <= item.t) items.push(item);
  else items.splice(lower(items, item.t), 0, item);
}

/** The last of the sorted `items` at or before `t`. */
function last(items, t) {
  const index = lower(items, t + 1e-3);
  return index > 0 ? items[index - 1] : null;
}

/** The id of a picture. */
export const key = (label) => `${label.source}/${label.stamp}/${label.observed}/${label.k}`;

const SERIES = ["frames", "predicted", "errors", "plans", "ways", "actions", "chunks", "candidates", "assessments", "goals", "outcomes", "subgoals",
  "candidatePictures", "latencies", "log"];
const OF_SOURCE = { camera: "frames", predicted: "predicted", plan: "outcomes", candidates: "candidatePictures", goal: "goals", subgoals: "subgoals" };
const OF_KIND = { error: "errors", plan: "plans", way: "ways", action: "actions", chunk: "chunks", candidates: "candidates",
  assessment: "assessments" };

export class Record {
  constructor() {
    this.clear();
  }

  clear() {
    for (const name of SERIES) this[name] = [];
    this.horizon = 0;
    this.period = 0;
    this.model = "";
    this.count = 0;
  }

  add(event) {
    this.count++;
    let t = milliseconds(event.stamp);
    switch (event.t) {
      case "picture": {
        const { stamp, observed, k, source } = event;
        // A goal's stamp may be any time, such as a bag's end: the goal is valid from its arrival.
        if (source === "goal") t = milliseconds(event.at);
        insert(this[OF_SOURCE[source]], { t, at: milliseconds(event.at), stamp, observed, k, source, from: milliseconds(observed) });
        break;
      }
      case "prediction":
        this.horizon = Math.min(event.horizon, 64);
        this.period = event.period_ms;
        this.model = event.model;
        if (event.k === 1 && event.latency_ms !== null) insert(this.latencies, { t: milliseconds(event.at), latency: event.latency_ms });
        break;
      case "log":
        this.log.push({ ...event, t: milliseconds(event.at) });
        break;
      case "goal":
        break;
      default:
        insert(this[OF_KIND[event.t]], { ...event, t });
    }
  }

  /** Removes events older than `from`. */
  prune(from) {
    for (const name of SERIES) {
      const items = this[name];
      // A goal is valid until the next one.
      const keep = name === "goals" || name === "plans" || name === "ways" || name === "outcomes" || name === "subgoals" ? 1 : 0;
      let old = 0;
      while (old < items.length - keep && items[old].t < from) old++;
      if (old > 0) items.splice(0, old);
    }
  }

  newest() {
    return this.frames[this.frames.length - 1] ?? null;
  }

  /** The tolerance of stamps: an eighth of a step; the next frame is further away. */
  get tolerance() {
    return (this.period || 400) / 8;
  }

  /** The frame nearest to `t`; with `exact`, only within the tolerance. */
  frame(t, exact = false) {
    const index = lower(this.frames, t);
    const [before, after] = [this.frames[index - 1], this.frames[index]];
    const near = !before ? after : !after ? before : t - before.t <= after.t - t ? before : after;
    if (!near || (exact && Math.abs(near.t - t) > this.tolerance)) return null;
    return near;
  }

  /** The frame `by` frames later, among those that satisfy `predicate` if given. */
  step(frame, by, predicate = () => true) {
    let index = lower(this.frames, frame.t) + by;
    while (index >= 0 && index < this.frames.length && !predicate(this.frames[index])) index += Math.sign(by);
    return this.frames[index] ?? null;
  }

  /** The picture of time `t` that was predicted k steps earlier. */
  predictionOf(t, k) {
    let found = null;
    for (let index = lower(this.predicted, t - this.tolerance); index < this.predicted.length; index++) {
      const picture = this.predicted[index];
      if (picture.t > t + this.tolerance) break;
      if (picture.k === k && (!found || picture.from > found.from)) found = picture;
    }
    return found;
  }

  /** The newest frame with a prediction, at or before `t`. */
  newestPair(k, t) {
    for (let index = lower(this.frames, t + 1e-3) - 1; index >= 0 && index > this.frames.length - 400; index--) {
      const picture = this.predictionOf(this.frames[index].t, k);
      if (picture) return { frame: this.frames[index], picture };
    }
    return null;
  }

  /** The pictures by k of the newest rollout that begins at or before `t`. */
  rollout(t) {
    const span = (this.horizon || 64) * (this.period || 400) + this.tolerance;
    let from = -Infinity;
    const end = lower(this.predicted, t + span);
    // Older rollouts are not of interest.
    for (let index = end - 1; index >= 0 && index > end - 1000; index--) {
      const picture = this.predicted[index];
      if (picture.from <= t + 1e-3 && picture.from > from) from = picture.from;
      // Predictions of a time begin earlier.
      if (picture.t < from) break;
    }
    const steps = new Map();
    for (const picture of this.within("predicted", from, from + span)) if (picture.from === from) steps.set(picture.k, picture);
    return { from, steps };
  }

  before(name, t) {
    return last(this[name], t);
  }

  /** A plan's path in the picture; null if unknown. */
  wayOf(plan) {
    const { begin } = plan.actions;
    const way = this.before("ways", milliseconds(begin));
    return way?.stamp === begin ? way : null;
  }

  within(name, from, to) {
    const items = this[name];
    return items.slice(lower(items, from), lower(items, to));
  }

  /** Squared error of k=1 divided by that of the held frame, summed over the 5 s before `t`; null without data. */
  ratio(t) {
    let [mse, persistence, count] = [0, 0, 0];
    for (const error of this.within("errors", t - 5000, t + 1e-3)) {
      if (error.k !== 1) continue;
      mse += error.mse;
      persistence += error.persistence;
      count++;
    }
    return count >= 3 && persistence > 0 ? mse / persistence : null;
  }
}
