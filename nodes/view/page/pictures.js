// Pictures: cached, fetched if missing, drawn and compared.

import { key } from "./record.js";

/** The most encoded pictures: half a minute of frames and rollouts. */
const MOST_BLOBS = 800;
/** The most decoded pictures. */
const MOST_BITMAPS = 48;
/** Larger pictures are scaled down: no panel is wider. */
const WIDEST = 1280;

export class Pictures {
  constructor(connection) {
    this.connection = connection;
    this.clear();
  }

  clear() {
    this.blobs = new Map();
    this.bitmaps = new Map();
  }

  add(label, blob) {
    this.blobs.set(key(label), blob);
    if (this.blobs.size > MOST_BLOBS) this.blobs.delete(this.blobs.keys().next().value);
  }

  /** The decoded picture; null if it has expired. */
  get(label) {
    const name = key(label);
    let bitmap = this.bitmaps.get(name);
    if (!bitmap) {
      bitmap = this.load(name).catch(() => null);
      this.bitmaps.set(name, bitmap);
      if (this.bitmaps.size > MOST_BITMAPS) {
        const [oldest, old] = this.bitmaps.entries().next().value;
        this.bitmaps.delete(oldest);
        // Callers that are about to draw it have it by then.
        setTimeout(() => old.then((picture) => picture?.close()), 2000);
      }
    }
    return bitmap;
  }

  async load(name) {
    let blob = this.blobs.get(name);
    if (!blob) {
      const answer = await fetch(`/picture/${name}`, { headers: this.connection.headers });
      if (!answer.ok) return null;
      blob = await answer.blob();
    }
    return createImageBitmap(blob);
  }
}

/** Shows pictures; the last request is drawn last. */
export class Screen {
  constructor(figure) {
    this.screen = figure.querySelector(".screen") ?? figure;
    this.canvas = figure.querySelector("canvas");
    this.caption = figure.querySelector(".caption");
    this.note = figure.querySelector(".missing");
    this.wanted = null;
    this.shown = null;
  }

  /** Shows the picture from `load`; calls `drawn` when it is on the canvas. */
  async show(name, load, drawn = () => {}) {
    if (this.wanted === name) return;
    this.wanted = name;
    const picture = await load();
    if (this.wanted !== name) return;
    if (!picture) {
      this.blank("this picture has expired");
      this.wanted = name;
      return;
    }
    this.draw(picture);
    this.shown = name;
    this.say("");
    drawn(picture);
  }

  draw(picture) {
    const scale = Math.min(1, WIDEST / picture.width);
    const [width, height] = [Math.round(picture.width * scale), Math.round(picture.height * scale)];
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    this.canvas.getContext("2d").drawImage(picture, 0, 0, width, height);
  }

  blank(text) {
    this.wanted = null;
    if (this.shown !== null) this.canvas.width = this.canvas.width;
    this.shown = null;
    this.say(text);
  }

  /** Shows a text over the picture; a picture under it is marked as old. */
  say(text) {
    if (!this.note) return;
    if (this.note.textContent !== text) this.note.textContent = text;
    this.screen.classList.toggle("stale", text !== "" && this.shown !== null);
  }

  set aspect(ratio) {
    this.screen.style.aspectRatio = ratio;
    // A predicted picture has the model's size, but the camera's contents.
    this.canvas.style.objectFit = "fill";
  }
}

/** Maps a part of a picture of size `from` to a part of one of size `to`: `Fit::placement` of wm_model. */
export function placement(fit, from, to) {
  const whole = ({ width, height }) => ({ x: 0, y: 0, width, height });
  const inside = (of, shape) => {
    const isWider = of.width * shape.height > shape.width * of.height;
    const rounded = (side, by, over, most) => Math.min(most, Math.max(1, Math.floor((side * by + Math.floor(over / 2)) / over)));
    const width = isWider ? rounded(of.height, shape.width, shape.height, of.width) : of.width;
    const height = isWider ? of.height : rounded(of.width, shape.height, shape.width, of.height);
    return { x: Math.floor((of.width - width) / 2), y: Math.floor((of.height - height) / 2), width, height };
  };
  return { source: fit === "crop" ? inside(from, to) : whole(from), target: fit === "pad" ? inside(to, from) : whole(to) };
}

/** Draws a camera's picture as framed for the model; padding stays empty. */
function drawFramed(context, picture, fit, { width, height }) {
  const { source, target } = placement(fit, picture, { width, height });
  const { x, y } = target;
  context.drawImage(picture, source.x, source.y, source.width, source.height, x, y, target.width, target.height);
}

/** A camera's picture as framed for the model, at the model's size. */
export function framed(picture, fit, size) {
  if (!picture || !size) return picture;
  const canvas = new OffscreenCanvas(size.width, size.height);
  const context = canvas.getContext("2d");
  context.imageSmoothingQuality = "high";
  drawFramed(context, picture, fit, size);
  return canvas;
}

const scratch = document.createElement("canvas").getContext("2d", { willReadFrequently: true });

/** Draws |a - b| at b's size, `a` as framed for the model; returns the mean squared difference of the 8-bit values. */
function subtract(context, a, b, fit) {
  const { width, height } = b;
  if (context.canvas.width !== width || context.canvas.height !== height) Object.assign(context.canvas, { width, height });
  context.globalCompositeOperation = "copy";
  context.imageSmoothingQuality = "high";
  drawFramed(context, a, fit, b);
  context.globalCompositeOperation = "difference";
  context.drawImage(b, 0, 0, width, height);
  const pixels = context.getImageData(0, 0, width, height).data;
  let sum = 0;
  for (let at = 0; at < pixels.length; at += 4) {
    sum += pixels[at] ** 2 + pixels[at + 1] ** 2 + pixels[at + 2] ** 2;
  }
  return sum / (width * height * 3);
}

const decibel = (mse) => (mse > 0 ? Math.min(60, 10 * Math.log10(65025 / mse)) : 60);

/** Draws the difference between prediction and real frame; returns PSNR [dB], and that of the held frame if there is one. */
export function compare(canvas, real, predicted, held, { gain, fit }) {
  const mse = subtract(scratch, real, predicted, fit);
  const { width, height } = predicted;
  if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  const context = canvas.getContext("2d");
  context.globalCompositeOperation = "copy";
  context.drawImage(scratch.canvas, 0, 0);
  context.globalCompositeOperation = "lighter";
  for (let times = 1; times < gain; times++) context.drawImage(scratch.canvas, 0, 0);
  const heldMse = held ? subtract(scratch, real, sized(held, fit, width, height), fit) : null;
  return { psnr: decibel(mse), held: heldMse === null ? null : decibel(heldMse) };
}

const holder = document.createElement("canvas");

/** A picture as framed for the model, at the size of the comparison. */
function sized(picture, fit, width, height) {
  Object.assign(holder, { width, height });
  const context = holder.getContext("2d");
  context.imageSmoothingQuality = "high";
  drawFramed(context, picture, fit, holder);
  return holder;
}
