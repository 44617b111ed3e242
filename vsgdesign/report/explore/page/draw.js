// One drawing layer for all figures: colours of the theme, axes, lines, markers. It draws on a canvas, or into an
// SvgContext for the download.
import { SvgContext } from "./svg.js";

const LIGHT = {
  text: "#1f2328",
  soft: "#57606a",
  rule: "#8c959f",
  grid: "#e6e8eb",
  back: "#ffffff",
  unstableSide: "#fbeeee",
  band: "#d9ebe2",
  limit: "#b3261e",
  middle: [247, 247, 247],
  bad: [178, 48, 28],
  good: [33, 102, 172],
  badHalf: [244, 178, 140],
  goodHalf: [146, 197, 222],
  none: "#b8b8b8",
  unstable: "#4a3a57",
  unstableLine: "#8d7c9b",
  black: "#111111",
};
const DARK = {
  text: "#e6e9ed",
  soft: "#a9b1bb",
  rule: "#6e7681",
  grid: "#2b3138",
  back: "#15191e",
  unstableSide: "#2b1c1f",
  band: "#1d3a30",
  limit: "#ff8a80",
  middle: [50, 55, 62],
  bad: [236, 112, 70],
  good: [86, 160, 226],
  badHalf: [140, 80, 60],
  goodHalf: [62, 100, 138],
  none: "#666666",
  unstable: "#08060a",
  unstableLine: "#55465f",
  black: "#f4f6f8",
};

// The controllers' colours (Okabe and Ito): the light ones are darker on a white page, and all are lighter on a dark one,
// so that a line has a contrast of at least 3 to its ground. tests/explore/test_colours.py holds them apart for everybody.
const ON_LIGHT = {
  "#CC79A7": "#b8588f",
  "#E69F00": "#7e5700",
  "#56B4E9": "#275169",
  "#777777": "#656565",
};
const ON_DARK = {
  "#0072B2": "#4aa8ec",
  "#D55E00": "#f5853a",
  "#009E73": "#22c799",
  "#CC79A7": "#e6a3c9",
  "#E69F00": "#eaad26",
  "#56B4E9": "#9ad2f2",
  "#000000": "#f2f2f2",
  "#777777": "#929292",
};

const darkQuery = window.matchMedia("(prefers-color-scheme: dark)");

const isDark = () => darkQuery.matches;
export const theme = () => (darkQuery.matches ? DARK : LIGHT);
export const onThemeChange = (listener) => darkQuery.addEventListener("change", listener);
export const lineColour = (colour) => (isDark() ? ON_DARK : ON_LIGHT)[colour.toUpperCase()] || colour;

// A marker's shape tells the controllers apart without colour.
export const SHAPES = ["cross", "plus", "triangle", "square", "diamond", "circle"];

const FACE = "'Helvetica Neue', Arial, 'Liberation Sans', sans-serif";
export const font = (size = 11, weight = "") => `${weight ? weight + " " : ""}${size}px ${FACE}`;

/** A drawing area on a canvas element that follows the size of its box. */
export class Figure {
  constructor(canvas, margins) {
    this.canvas = canvas;
    this.margins = margins;
    this.ctx = canvas.getContext("2d");
  }

  /** Sizes the canvas to its box and clears it; returns {ctx, width, height, box}. */
  begin(svg = null) {
    const parent = this.canvas.parentElement;
    const [width, height] = [Math.max(120, parent.clientWidth), Math.max(20, parent.clientHeight)];
    const { left, right, top, bottom } = this.margins;
    const box = { x: left, y: top, w: width - left - right, h: height - top - bottom };
    if (svg) return { ctx: svg, width, height, box };
    const ratio = window.devicePixelRatio || 1;
    const [w, h] = [Math.round(width * ratio), Math.round(height * ratio)];
    if (this.canvas.width !== w || this.canvas.height !== h) {
      this.canvas.width = w;
      this.canvas.height = h;
    }
    this.ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.ctx.clearRect(0, 0, width, height);
    return { ctx: this.ctx, width, height, box };
  }

  svg() {
    return new SvgContext(this.ctx);
  }
}

/** From a value to a place, linear or logarithmic, and back. */
export function scaleOf([low, high], start, length, log = false) {
  const [a, b] = log ? [Math.log(low), Math.log(high)] : [low, high];
  const place = (value) => start + (length * ((log ? Math.log(value) : value) - a)) / (b - a);
  place.back = (at) => {
    const value = a + ((at - start) / length) * (b - a);
    return log ? Math.exp(value) : value;
  };
  place.low = low;
  place.high = high;
  return place;
}

/** Round numbers between low and high, about `count` of them. */
export function ticksOf(low, high, count = 5) {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 2.5, 5, 10].map((m) => m * power).find((s) => s >= rough * 0.999);
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) ticks.push(k * step);
  return ticks;
}

export function logTicks(low, high, multiples = [1]) {
  const ticks = [];
  for (let p = Math.floor(Math.log10(low)); p <= Math.ceil(Math.log10(high)); p++) {
    for (const m of multiples) if (m * 10 ** p >= low * 0.999 && m * 10 ** p <= high * 1.001) ticks.push(m * 10 ** p);
  }
  return ticks;
}

/** A tick's text, with a true minus sign. */
export const tickText = (value) =>
  (value === 0 ? "0" : String(Number(value.toPrecision(6)))).replace("-", "−").replace("e+", "e");

/** Limits with some room around the values, on round numbers; null without values. */
export function roomFor(values, least = 0) {
  let [low, high] = [Infinity, -Infinity];
  for (const v of values) {
    if (v < low) low = v;
    if (v > high) high = v;
  }
  if (!Number.isFinite(low) || !Number.isFinite(high)) return null;
  if (high - low < least) [low, high] = [(low + high - least) / 2, (low + high + least) / 2];
  const spare = 0.06 * (high - low) || 1;
  const step = ticksOf(low - spare, high + spare, 10);
  const one = step.length > 1 ? step[1] - step[0] : spare;
  return [Math.floor((low - spare) / one) * one, Math.ceil((high + spare) / one) * one];
}

/** Frame, grid lines, tick texts and labels. `x` and `y`: {scale, ticks, label, texts (optional), bare}. */
export function drawAxes(ctx, box, x, y) {
  const t = theme();
  ctx.lineWidth = 1;
  ctx.strokeStyle = t.grid;
  ctx.setLineDash([]);
  ctx.beginPath();
  for (const v of x.ticks) {
    const at = Math.round(x.scale(v)) + 0.5;
    ctx.moveTo(at, box.y);
    ctx.lineTo(at, box.y + box.h);
  }
  for (const v of y.ticks) {
    const at = Math.round(y.scale(v)) + 0.5;
    ctx.moveTo(box.x, at);
    ctx.lineTo(box.x + box.w, at);
  }
  ctx.stroke();
  drawFrame(ctx, box, x, y);
}

/** The frame and the texts alone, for a figure that fills its box. */
export function drawFrame(ctx, box, x, y) {
  const t = theme();
  ctx.setLineDash([]);
  ctx.lineWidth = 1;
  ctx.strokeStyle = t.rule;
  ctx.strokeRect(Math.round(box.x) + 0.5, Math.round(box.y) + 0.5, Math.round(box.w) - 1, Math.round(box.h) - 1);
  ctx.fillStyle = t.soft;
  ctx.font = font(11);
  ctx.textBaseline = "alphabetic";
  if (!x.bare) {
    for (const v of x.ticks) {
      const text = x.text ? x.text(v) : tickText(v);
      ctx.textAlign = x.scale(v) > box.x + box.w - 8 ? "right" : "center";
      ctx.fillText(text, Math.min(x.scale(v), box.x + box.w + 4), box.y + box.h + 14);
    }
  }
  ctx.textAlign = "right";
  for (const v of y.ticks) {
    const at = Math.min(Math.max(y.scale(v) + 4, box.y + 8), box.y + box.h);
    ctx.fillText(y.text ? y.text(v) : tickText(v), box.x - 5, at);
  }
  ctx.fillStyle = t.text;
  if (x.label) {
    ctx.textAlign = "center";
    ctx.fillText(x.label, box.x + box.w / 2, box.y + box.h + 29);
  }
  if (y.label) {
    ctx.save();
    ctx.translate(11, box.y + box.h / 2);
    ctx.rotate(-Math.PI / 2);
    ctx.textAlign = "center";
    ctx.fillText(y.label, 0, 0);
    ctx.restore();
  }
}

/** Everything drawn by `draw` stays inside the box. */
export function clipped(ctx, box, draw) {
  ctx.save();
  ctx.beginPath();
  ctx.rect(box.x, box.y, box.w, box.h);
  ctx.clip();
  draw();
  ctx.restore();
}

/** A polyline; it is broken where a value is not a number. Far outside the box it is held at its rim, so that paths stay sane. */
export function drawLine(ctx, box, sx, sy, xs, ys, { colour, width = 1.75, dash = [], alpha = 1 }) {
  ctx.strokeStyle = colour;
  ctx.lineWidth = width;
  ctx.globalAlpha = alpha;
  ctx.setLineDash(dash);
  ctx.beginPath();
  const [top, bottom] = [box.y - 2000, box.y + box.h + 2000];
  let down = false;
  for (let i = 0; i < xs.length; i++) {
    if (Number.isNaN(ys[i]) || Number.isNaN(xs[i])) {
      down = false;
      continue;
    }
    const at = Math.min(Math.max(sy(ys[i]), top), bottom);
    if (down) ctx.lineTo(sx(xs[i]), at);
    else ctx.moveTo(sx(xs[i]), at);
    down = true;
  }
  ctx.stroke();
  ctx.setLineDash([]);
  ctx.globalAlpha = 1;
}

/** A straight reference line over the box at y (or at x where `upright`). */
export function drawLevel(ctx, box, at, { colour, dash = [5, 4], width = 1, upright = false }) {
  ctx.strokeStyle = colour;
  ctx.lineWidth = width;
  ctx.setLineDash(dash);
  ctx.beginPath();
  if (upright) {
    ctx.moveTo(at, box.y);
    ctx.lineTo(at, box.y + box.h);
  } else {
    ctx.moveTo(box.x, at);
    ctx.lineTo(box.x + box.w, at);
  }
  ctx.stroke();
  ctx.setLineDash([]);
}

/** The outline of a marker; the caller strokes or fills it. */
export function shapePath(ctx, shape, x, y, r) {
  ctx.beginPath();
  if (shape === "cross" || shape === "plus") {
    const [a, b] = shape === "cross" ? [r * 0.85, r * 0.85] : [r * 1.1, 0];
    ctx.moveTo(x - a, y - b);
    ctx.lineTo(x + a, y + b);
    ctx.moveTo(x - b, y + a);
    ctx.lineTo(x + b, y - a);
    return;
  }
  if (shape === "circle") {
    ctx.arc(x, y, r, 0, 7);
    return;
  }
  const turns = { triangle: [3, 0, 1.15], square: [4, 0.25, 1.25], diamond: [4, 0, 1.2] }[shape];
  for (let k = 0; k < turns[0]; k++) {
    const angle = -Math.PI / 2 + (2 * Math.PI * k) / turns[0] + turns[1] * Math.PI;
    const at = [x + turns[2] * r * Math.cos(angle), y + turns[2] * r * Math.sin(angle)];
    if (k) ctx.lineTo(...at);
    else ctx.moveTo(...at);
  }
  ctx.closePath();
}

/** A text on a plate of the page's colour, so that lines under it do not disturb. */
export function plateText(ctx, text, x, y, { align = "left", colour = null, size = 11, weight = "" } = {}) {
  ctx.font = font(size, weight);
  const width = ctx.measureText(text).width;
  const left = align === "left" ? x : align === "right" ? x - width : x - width / 2;
  ctx.fillStyle = theme().back;
  ctx.globalAlpha = 0.82;
  ctx.fillRect(left - 3, y - size + 1, width + 6, size + 3);
  ctx.globalAlpha = 1;
  ctx.fillStyle = colour || theme().text;
  ctx.textAlign = "left";
  ctx.textBaseline = "alphabetic";
  ctx.fillText(text, left, y);
}

/** Words in place of a plot, broken into lines that fit. */
export function drawWords(ctx, box, text) {
  ctx.font = font(13);
  const lines = [""];
  for (const word of text.split(" ")) {
    const longer = `${lines[lines.length - 1]} ${word}`.trim();
    if (ctx.measureText(longer).width > box.w - 32) lines.push(word);
    else lines[lines.length - 1] = longer;
  }
  ctx.strokeStyle = theme().grid;
  ctx.lineWidth = 1;
  ctx.setLineDash([]);
  ctx.strokeRect(box.x + 0.5, box.y + 0.5, box.w - 1, box.h - 1);
  const top = box.y + box.h / 2 - 9 * (lines.length - 1);
  lines.forEach((line, i) => plateText(ctx, line, box.x + box.w / 2, top + 18 * i, { align: "center", size: 13 }));
}
