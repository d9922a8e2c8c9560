// Lines on canvases, in the page's colours.

const styles = getComputedStyle(document.documentElement);
export const colour = (name) => styles.getPropertyValue(`--${name}`).trim();

/** A canvas at the screen's resolution, cleared; its context works in CSS pixels. */
export function prepare(canvas) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const ratio = window.devicePixelRatio || 1;
  const [wide, high] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== wide || canvas.height !== high) Object.assign(canvas, { width: wide, height: high });
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "10px system-ui, sans-serif";
  return { context, width, height };
}

/** Steps of 1, 2 or 5 times a power of ten, about four per span. */
function ticks(from, to) {
  const rough = (to - from) / 4;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((times) => times * power).find((size) => size >= rough);
  const all = [];
  for (let at = Math.ceil(from / step) * step; at <= to + step / 1e6; at += step) all.push(Math.abs(at) < step / 1e6 ? 0 : at);
  return all;
}

const LEFT = 34;
const BOTTOM = 14;
const TOP = 4;

/**
 * Draws lines over time. `x` and `y` are [from, to], x in ms, y in `unit`; `now` is where 0 s is, and `zero` its name. A line has points [t, value], a colour,
 * and may be bold, faint or stepped; a mark is a horizontal line with a label.
 */
export function lines(canvas, { x, y, now, zero, unit, series, marks = [], cursor = null }) {
  const { context, width, height } = prepare(canvas);
  if (width < 2 * LEFT || !(x[1] > x[0]) || !(y[1] > y[0])) return;
  const across = (t) => LEFT + ((t - x[0]) / (x[1] - x[0])) * (width - LEFT - 2);
  const up = (value) => TOP + (1 - (value - y[0]) / (y[1] - y[0])) * (height - TOP - BOTTOM);
  context.lineWidth = 1;
  context.textBaseline = "middle";
  context.textAlign = "right";
  for (const value of ticks(...y)) {
    context.strokeStyle = colour("line");
    context.beginPath();
    context.moveTo(LEFT, up(value));
    context.lineTo(width, up(value));
    context.stroke();
    context.fillStyle = colour("soft");
    context.fillText(String(Number(value.toPrecision(3))), LEFT - 4, up(value));
  }
  context.textBaseline = "alphabetic";
  context.textAlign = "center";
  for (const second of ticks((x[0] - now) / 1000, (x[1] - now) / 1000)) {
    const at = across(now + second * 1000);
    if (at < LEFT + 8) continue;
    // The last label ends at the right edge.
    const isLast = at > width - 16;
    context.textAlign = isLast ? "right" : "center";
    context.fillText(second === 0 ? zero : `${Number(second.toPrecision(6))} s`, isLast ? width : at, height - 2);
  }
  context.textAlign = "left";
  context.fillText(unit, LEFT + 4, TOP + 9);
  context.save();
  context.beginPath();
  context.rect(LEFT, 0, width - LEFT, height - BOTTOM);
  context.clip();
  for (const mark of marks) {
    context.strokeStyle = context.fillStyle = mark.colour;
    context.setLineDash([4, 3]);
    context.beginPath();
    context.moveTo(LEFT, up(mark.value));
    context.lineTo(width, up(mark.value));
    context.stroke();
    context.setLineDash([]);
    context.textAlign = "left";
    context.fillText(mark.label, LEFT + 4, up(mark.value) - 3);
  }
  for (const line of series) {
    context.strokeStyle = line.colour;
    context.globalAlpha = line.faint ? 0.3 : 1;
    context.lineWidth = line.bold ? 2 : line.wide ? 5 : 1;
    if (line.wide) context.globalAlpha = 0.25;
    context.beginPath();
    let before = null;
    for (const [t, value] of line.points) {
      if (value === null || !Number.isFinite(value)) {
        before = null;
        continue;
      }
      const [px, py] = [across(t), up(Math.min(Math.max(value, y[0]), y[1]))];
      // Long gaps stay empty.
      if (before === null || (line.gap && t - before.t > line.gap)) context.moveTo(px, py);
      else {
        if (line.stepped) context.lineTo(px, before.py);
        context.lineTo(px, py);
      }
      before = { t, py };
    }
    context.stroke();
  }
  context.globalAlpha = 1;
  if (cursor !== null) {
    context.strokeStyle = colour("ink");
    context.lineWidth = 1;
    context.beginPath();
    context.moveTo(across(cursor), 0);
    context.lineTo(across(cursor), height);
    context.stroke();
  }
  context.restore();
}

/** The time line: frames, rollouts, plans, and the quality of predictions. */
export function timeline(canvas, { x, record, cursor, isLive }) {
  const { context, width, height } = prepare(canvas);
  if (!(x[1] > x[0])) return;
  const across = (t) => ((t - x[0]) / (x[1] - x[0])) * width;
  const rows = [
    ["frames", "real", 3, 7],
    ["predicted", "model", 12, 7],
    ["plans", "warn", 21, 6],
  ];
  for (const [name, tone, top, high] of rows) {
    context.fillStyle = colour(tone);
    let drawn = -2;
    for (const item of record.within(name, ...x)) {
      const at = Math.round(across(name === "predicted" ? item.from : item.t));
      if (at === drawn) continue;
      drawn = at;
      context.fillRect(at, top, 1, high);
    }
  }
  if (cursor !== null) {
    const at = Math.min(Math.max(across(cursor), 1), width - 2);
    context.fillStyle = colour(isLive ? "good" : "ink");
    context.fillRect(at - 1, 0, 2, height);
  }
}

/** A plan's path from the picture's centre; `axes`: right and down for x, y and z [picture widths per m]. */
function alongAxes(values, axes, width, height) {
  let [x, y] = [width / 2, height / 2];
  return [[x, y], ...values.map(([dx, dy, dz]) => [
    (x += width * (axes[0] * dx + axes[2] * dy + axes[4] * dz)),
    (y += width * (axes[1] * dx + axes[3] * dy + axes[5] * dz)),
  ])];
}

/**
 * Arrows of a plan in the picture: along `way`, in fractions of its width and height, or else along its `axes`. What lies
 * beside `seen` (left, top, width and height in fractions) is shaded: the model does not see it.
 */
export function arrows(canvas, seen, { values, way, axes } = {}) {
  const { context, width, height } = prepare(canvas);
  if (seen) {
    const [left, top, wide, high] = [seen[0] * width, seen[1] * height, seen[2] * width, seen[3] * height];
    context.fillStyle = "#0007";
    context.beginPath();
    context.rect(0, 0, width, height);
    context.rect(left, top, wide, high);
    context.fill("evenodd");
  }
  if (!values) return;
  const points = way ? way.map(([u, v]) => [u * width, v * height]) : alongAxes(values, axes, width, height);
  for (let index = 0; index + 1 < points.length; index++) {
    const [[px, py], [qx, qy]] = [points[index], points[index + 1]];
    const [right, down] = [qx - px, qy - py];
    for (const [tone, thick] of [["panel", 5], ["bad", 2.5]]) {
      context.strokeStyle = context.fillStyle = colour(tone);
      context.globalAlpha = 1 - 0.5 * (index / points.length);
      context.lineWidth = thick;
      context.lineCap = "round";
      context.beginPath();
      context.moveTo(px, py);
      context.lineTo(qx, qy);
      if (Math.hypot(right, down) > 6) {
        const turn = Math.atan2(down, right);
        for (const side of [-2.6, 2.6]) {
          context.moveTo(qx, qy);
          context.lineTo(qx + 7 * Math.cos(turn + side), qy + 7 * Math.sin(turn + side));
        }
      }
      context.stroke();
    }
  }
  context.globalAlpha = 1;
}
