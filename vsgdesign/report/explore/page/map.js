// The map SCR x X/R: a figure's colours around its promise, the table's nodes, the static limit, the certificate's
// region, and the ring that is dragged. The map is drawn into a layer of its own, so a drag repaints only the ring.
import { Figure, clipped, drawFrame, drawLine, drawWords, font, logTicks, plateText, scaleOf, theme } from "./draw.js";

const mapRound = (value) => Number(value.toPrecision(3));

const mix = (a, b, f) => a.map((v, i) => Math.round(v + (b[i] - v) * f));
const rgb = ([r, g, b]) => `#${[r, g, b].map((v) => v.toString(16).padStart(2, "0")).join("")}`;

/** The colour of a share from -1 (worst) over 0 (as promised) to 1 (best). */
function shareColour(share) {
  const t = theme();
  const s = Math.max(-1, Math.min(1, share));
  const [half, full] = s < 0 ? [t.badHalf, t.bad] : [t.goodHalf, t.good];
  const size = Math.abs(s);
  return rgb(size < 0.5 ? mix(t.middle, half, 2 * size) : mix(half, full, 2 * size - 1));
}

/**
 * From a value to its share of the colour scale: the promise is at 0. Without a promise the worst end is. Nothing is better
 * than a promise at the best end.
 */
function shareOf({ low, high, promise, better }) {
  const sign = better === "low" ? -1 : 1;
  const middle = promise ?? (sign > 0 ? low : high);
  return (value) =>
    value === middle ? 0 : (sign * (value - middle)) / (value < middle ? middle - low : high - middle);
}

export class GridMap {
  constructor(canvas, info, store) {
    this.figure = new Figure(canvas, { left: 44, right: 10, top: 6, bottom: 36 });
    this.layer = document.createElement("canvas");
    this.canvas = canvas;
    this.info = info;
    this.store = store;
    this.answer = null;
    this.stale = true;
    this.listenToPointer();
    this.listenToKeys();
  }

  show(answer) {
    this.answer = answer;
    this.stale = true;
    this.paint();
  }

  refresh() {
    this.stale = true;
    this.paint();
  }

  scales(box) {
    const { scr, x_over_r: ratio } = this.info.map;
    return [scaleOf(scr, box.x, box.w, true), scaleOf(ratio, box.y + box.h, -box.h, true)];
  }

  paint() {
    const { ctx, width, height, box } = this.figure.begin();
    this.box = box;
    const size = `${this.canvas.width}x${this.canvas.height}`;
    if (this.stale || this.size !== size) {
      Object.assign(this.layer, { width: this.canvas.width, height: this.canvas.height });
      const layer = this.layer.getContext("2d");
      layer.setTransform(this.canvas.width / width, 0, 0, this.canvas.height / height, 0, 0);
      this.paintGround(layer, box);
      this.size = size;
      this.stale = false;
    }
    ctx.drawImage(this.layer, 0, 0, width, height);
    this.paintRing(ctx, box);
  }

  paintTo(svg) {
    const { box } = this.figure.begin(svg);
    this.paintGround(svg, box);
    this.paintRing(svg, box);
  }

  paintGround(ctx, box) {
    const [sx, sy] = this.scales(box);
    const t = theme();
    clipped(ctx, box, () => {
      ctx.fillStyle = t.none;
      ctx.fillRect(box.x, box.y, box.w, box.h);
      if (this.answer) this.paintCells(ctx, box, sx, sy);
      if (this.answer && this.answer.header.why) drawWords(ctx, box, this.answer.header.why);
      this.paintKnown(ctx, box, sx, sy);
    });
    const label = { x: "SCR", y: "X/R" };
    const x = { scale: sx, ticks: logTicks(sx.low, sx.high, [1, 2, 3, 5]), label: label.x };
    const y = { scale: sy, ticks: logTicks(sy.low, sy.high, [1, 2, 5]), label: label.y };
    drawFrame(ctx, box, x, y);
  }

  paintCells(ctx, box, sx, sy) {
    const { header, arrays } = this.answer;
    const t = theme();
    const edges = (values, scale) => {
      const at = Array.from(values, scale);
      const between = at.slice(1).map((v, i) => (v + at[i]) / 2);
      return [2 * at[0] - between[0], ...between, 2 * at[at.length - 1] - between[between.length - 1]].map(Math.round);
    };
    const [xs, ys] = [edges(arrays.scr, sx), edges(arrays.x_over_r, sy)];
    const [columns, rows] = [arrays.scr.length, arrays.x_over_r.length];
    const share = shareOf(header);
    const { values, unstable } = arrays;
    for (let j = 0; j < rows; j++) {
      for (let i = 0; i < columns; i++) {
        const value = values[j * columns + i];
        const broken = (unstable && unstable[j * columns + i] > 0) || value === -Infinity;
        if (!broken && Number.isNaN(value)) continue;
        ctx.fillStyle = broken ? t.unstable : shareColour(share(value));
        ctx.fillRect(xs[i], ys[j + 1], xs[i + 1] - xs[i], ys[j] - ys[j + 1]);
      }
    }
    let level = [];
    if (header.promise !== null && header.promise !== undefined) {
      const worst = header.better === "low" ? Infinity : -Infinity;
      const judged = unstable ? values.map((v, k) => (unstable[k] > 0 ? worst : v)) : values;
      level = this.paintLevel(ctx, sx, sy, judged, header.promise, { colour: t.black, width: 1.4 });
    }
    // Where the operating point uses the whole of the converter's static limits.
    if (arrays.limit_use) {
      const use = arrays.limit_use.map((v) => (Number.isNaN(v) ? Infinity : v));
      this.paintLevel(ctx, sx, sy, use, 1, { colour: t.limit, width: 2.2, casing: t.back });
    }
    // Its name lies over both lines.
    this.nameLevel(ctx, box, level, `promised ${figureText(header.promise, header.unit)}`);
  }

  // The line where values are at a level (marching squares on the cells' centres, in the logarithmic plane); returns
  // its pieces.
  paintLevel(ctx, sx, sy, values, level, { colour, width, casing }) {
    const { scr, x_over_r: ratio } = this.answer.arrays;
    const at = (i, j) => values[j * scr.length + i];
    const pieces = [];
    ctx.strokeStyle = colour;
    ctx.lineWidth = width;
    ctx.setLineDash([]);
    ctx.beginPath();
    for (let j = 0; j < ratio.length - 1; j++) {
      for (let i = 0; i < scr.length - 1; i++) {
        const corners = [
          [i, j],
          [i + 1, j],
          [i + 1, j + 1],
          [i, j + 1],
        ];
        const cuts = [];
        corners.forEach((a, k) => {
          const b = corners[(k + 1) % 4];
          const [va, vb] = [at(...a), at(...b)];
          if (Number.isNaN(va) || Number.isNaN(vb) || va < level === vb < level) return;
          // Towards a cell without a finite value the line is drawn half-way.
          const f = Number.isFinite(vb - va) ? (level - va) / (vb - va) : 0.5;
          const [x0, y0, x1, y1] = [sx(scr[a[0]]), sy(ratio[a[1]]), sx(scr[b[0]]), sy(ratio[b[1]])];
          cuts.push([x0 + f * (x1 - x0), y0 + f * (y1 - y0)]);
        });
        if (cuts.length < 2) continue;
        ctx.moveTo(...cuts[0]);
        ctx.lineTo(...cuts[1]);
        pieces.push(cuts[0]);
      }
    }
    if (casing) {
      // The line is red, and so are cells that it may cross.
      Object.assign(ctx, { strokeStyle: casing, lineWidth: width + 2.4 });
      ctx.stroke();
      Object.assign(ctx, { strokeStyle: colour, lineWidth: width });
    }
    ctx.stroke();
    return pieces;
  }

  nameLevel(ctx, box, pieces, text) {
    const inside = ([x, y]) => x > box.x + 20 && x < box.x + box.w - 90 && y > box.y + 24 && y < box.y + box.h - 20;
    const roomy = pieces.filter(inside);
    if (roomy.length) plateText(ctx, text, ...roomy[Math.floor(roomy.length / 2)], { size: 10 });
  }

  paintKnown(ctx, box, sx, sy) {
    const t = theme();
    const { nodes, static_limit: limit, certificate } = this.info;
    if (certificate && certificate.scr.length) {
      const xs = [...certificate.scr, certificate.scr[0]];
      const ys = [...certificate.x_over_r, certificate.x_over_r[0]];
      drawLine(ctx, box, sx, sy, xs, ys, { colour: t.text, width: 1.5, dash: [2, 3] });
    }
    if (limit && limit.scr.length) drawLine(ctx, box, sx, sy, limit.scr, limit.x_over_r, { colour: t.limit, width: 2 });
    if (nodes) {
      for (let k = 0; k < nodes.scr.length; k++) {
        const kept = !nodes.kept || nodes.kept[k];
        ctx.beginPath();
        ctx.arc(sx(nodes.scr[k]), sy(nodes.x_over_r[k]), kept ? 1.8 : 2.2, 0, 7);
        ctx.fillStyle = kept ? t.text : t.back;
        ctx.globalAlpha = kept ? 0.75 : 1;
        ctx.fill();
        ctx.globalAlpha = 1;
        if (!kept) {
          ctx.strokeStyle = t.text;
          ctx.lineWidth = 1;
          ctx.stroke();
        }
      }
    }
  }

  paintRing(ctx, box) {
    const [sx, sy] = this.scales(box);
    const t = theme();
    const { scr, x_over_r: ratio, hold } = this.store.state;
    const [x, y] = [sx(scr), sy(ratio)];
    clipped(ctx, box, () => {
      ctx.lineWidth = 1;
      ctx.strokeStyle = t.black;
      ctx.globalAlpha = 0.45;
      ctx.setLineDash([]);
      ctx.beginPath();
      ctx.moveTo(x, box.y);
      ctx.lineTo(x, box.y + box.h);
      ctx.moveTo(box.x, y);
      ctx.lineTo(box.x + box.w, y);
      ctx.stroke();
      ctx.globalAlpha = 1;
    });
    if (hold) {
      const [hx, hy] = [sx(hold.scr), sy(hold.x_over_r)];
      ctx.setLineDash([4, 3]);
      ctx.strokeStyle = t.black;
      ctx.lineWidth = 1.75;
      ctx.beginPath();
      ctx.moveTo(hx, hy);
      ctx.lineTo(x, y);
      ctx.stroke();
      ctx.beginPath();
      ctx.arc(hx, hy, 8, 0, 7);
      ctx.stroke();
      ctx.setLineDash([]);
      ctx.font = font(11);
      if (Math.hypot(hx - x, hy - y) > 40)
        plateText(ctx, "gains held here", hx > box.x + box.w - 110 ? hx - 12 : hx + 12, hy - 8, {
          align: hx > box.x + box.w - 110 ? "right" : "left",
          size: 11,
        });
    }
    ctx.beginPath();
    ctx.arc(x, y, 8, 0, 7);
    ctx.fillStyle = t.back;
    ctx.fill();
    ctx.lineWidth = 3;
    ctx.strokeStyle = t.black;
    ctx.stroke();
  }

  moveTo(scr, ratio) {
    const { scr: a, x_over_r: b } = this.info.map;
    const inside = (v, [low, high]) => Math.min(Math.max(v, low), high);
    const grid = { scr: mapRound(inside(scr, a)), x_over_r: mapRound(inside(ratio, b)) };
    const { scr: to, x_over_r: ratioTo } = this.snap ? this.snap(grid) : grid;
    const { state } = this.store;
    if (to !== state.scr || ratioTo !== state.x_over_r) this.store.set({ scr: to, x_over_r: ratioTo });
  }

  listenToPointer() {
    const { canvas, store } = this;
    const move = (event) => {
      const frame = canvas.getBoundingClientRect();
      const [sx, sy] = this.scales(this.box);
      this.moveTo(sx.back(event.clientX - frame.left), sy.back(event.clientY - frame.top));
    };
    const end = () => {
      if (!store.dragging) return;
      store.dragging = false;
      store.commit();
      store.tell();
    };
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !this.box) return;
      canvas.setPointerCapture(event.pointerId);
      store.dragging = true;
      move(event);
    });
    const dragged = (event) => store.dragging && canvas.hasPointerCapture(event.pointerId) && move(event);
    canvas.addEventListener("pointermove", dragged);
    // A move is told once a frame. The first raw update of each frame comes earlier, and asks the server earlier.
    let ahead = false;
    canvas.addEventListener("pointerrawupdate", (event) => {
      if (ahead) return;
      ahead = true;
      requestAnimationFrame(() => (ahead = false));
      dragged(event);
    });
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
  }

  // Arrow keys: 2 % of the axis a step, 10 % with Shift. The move becomes one step of the history after a pause.
  listenToKeys() {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowDown: [0, -1], ArrowUp: [0, 1] };
    let pause = 0;
    this.canvas.addEventListener("keydown", (event) => {
      const step = steps[event.key];
      if (!step) return;
      event.preventDefault();
      const size = event.shiftKey ? 0.1 : 0.02;
      const factor = ([low, high], by) => Math.exp(by * size * Math.log(high / low));
      const { scr, x_over_r: ratio } = this.store.state;
      this.moveTo(scr * factor(this.info.map.scr, step[0]), ratio * factor(this.info.map.x_over_r, step[1]));
      clearTimeout(pause);
      pause = setTimeout(() => this.store.commit(), 500);
    });
  }
}

/** A figure with its unit, for labels. */
export function figureText(value, unit) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  return `${String(Number(value.toPrecision(3))).replace("-", "−")}${unit ? " " + unit : ""}`;
}

/** The colour scale under the map, as a small drawing with its ends, its promise and the other signs of the map. */
export function paintScale(canvas, figure, svg = null) {
  const frame = new Figure(canvas, { left: 44, right: 10, top: 2, bottom: 13 });
  const { ctx, box } = frame.begin(svg);
  const t = theme();
  const share = shareOf(figure);
  const value = (k) => figure.low + ((figure.high - figure.low) * (k + 0.5)) / 60;
  for (let k = 0; k < 60; k++) {
    ctx.fillStyle = shareColour(share(value(k)));
    ctx.fillRect(box.x + (box.w * k) / 60, box.y, box.w / 60 + 1, box.h);
  }
  ctx.strokeStyle = t.rule;
  ctx.strokeRect(box.x + 0.5, box.y + 0.5, box.w - 1, box.h - 1);
  ctx.font = font(10);
  ctx.fillStyle = t.soft;
  const place = scaleOf([figure.low, figure.high], box.x, box.w);
  const marks = [
    [figure.low, "left"],
    [figure.promise === figure.low || figure.promise === figure.high ? null : figure.promise, "center"],
    [figure.high, "right"],
  ];
  for (const [v, align] of marks) {
    if (v === null || v === undefined) continue;
    ctx.textAlign = align;
    ctx.fillText(figureText(v, figure.unit), place(v), box.y + box.h + 11);
    if (align === "center") {
      ctx.fillStyle = t.black;
      ctx.fillRect(place(v) - 0.7, box.y, 1.4, box.h);
      ctx.fillStyle = t.soft;
    }
  }
}
