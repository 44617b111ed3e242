// The response in time: the linear answer (dotted) and the EMT of the same event (solid) in the same axes, with the
// specification's bands and limits as the answer brings them.
import {
  Figure,
  clipped,
  drawAxes,
  drawLevel,
  drawLine,
  drawWords,
  lineColour,
  plateText,
  roomFor,
  scaleOf,
  theme,
  ticksOf,
} from "./draw.js";

// What can be shown: the EMT's array, and the least and the most that the axis spans (an unstable curve has no bounds).
const SHOWN = {
  P: { label: "P in pu", least: 0.02, most: 6 },
  Q: { label: "Q in pu", least: 0.02, most: 6 },
  i_s_pu: { label: "current in pu", least: 0.1, most: 4 },
  v_pu: { label: "voltage in pu", least: 0.05, most: 3 },
  omega_hz: { label: "frequency in Hz", least: 0.1, most: 20 },
};

export class ResponsePlot {
  /** signals: what can be shown besides SHOWN: [{name, label, least, most}]. */
  constructor(canvas, readout, store, signals = []) {
    this.known = { ...SHOWN, ...Object.fromEntries(signals.map((one) => [one.name, one])) };
    this.figure = new Figure(canvas, { left: 57, right: 10, top: 6, bottom: 36 });
    Object.assign(this, {
      canvas,
      readout,
      store,
      shown: "P",
      linear: [],
      emt: [],
      bands: [],
      words: "",
      emphasis: null,
      cursor: null,
    });
    this.limits = { t: [0, 2], y: {} };
    canvas.addEventListener("pointermove", (event) => this.readAt(event));
    canvas.addEventListener("pointerleave", () => this.readAt(null));
  }

  /** linear: [{name, colour, t, full}], emt: [{name, colour, t, P, Q, i_s_pu, omega_hz}]. */
  showLinear(curves, signal, words) {
    Object.assign(this, { linear: curves, linearSignal: signal, words: words || "" });
    this.settleAndPaint();
  }

  showEmt(curves, bands, words) {
    Object.assign(this, { emt: curves, bands: bands || [], waiting: words || "" });
    this.settleAndPaint();
  }

  /** Words at the foot of the plot while there is no EMT yet. */
  wait(words) {
    this.waiting = words || "";
    this.paint();
  }

  choose(shown) {
    this.shown = shown;
    this.canvas.setAttribute("aria-label", `Response in time, ${this.known[shown].label}; the table says how it ends`);
    this.settleAndPaint(true);
  }

  settleAndPaint(anew = false) {
    if (!this.store.dragging) this.settle(anew);
    this.paint();
  }

  // Limits stay during a drag. After it they grow with the curves, and shrink only where little of them is used.
  settle(anew) {
    const values = [];
    // The axis follows the curves that come to rest, if there are any.
    const tame = this.emt.filter((c) => c[this.shown] && !c.wild);
    const followed = tame.length ? tame : this.emt.filter((c) => c[this.shown]);
    for (const c of followed) for (const v of c[this.shown]) if (Number.isFinite(v)) values.push(v);
    if (this.linearSignal === this.shown) {
      for (const c of this.linear)
        if (c.full && c.stable !== false) for (const v of c.full) if (Number.isFinite(v)) values.push(v);
    }
    for (const band of this.bandsShown()) for (const v of [band.low, band.high]) if (Number.isFinite(v)) values.push(v);
    const { least, most } = this.known[this.shown];
    const room = roomFor(values, least);
    if (room && room[1] - room[0] > most) {
      const start = followed.length ? followed[0][this.shown][0] : (room[0] + room[1]) / 2;
      [room[0], room[1]] = [Math.max(room[0], start - most / 2), Math.min(room[1], start + most / 2)];
    }
    const old = this.limits.y[this.shown];
    if (room && (anew || !old || room[0] < old[0] || room[1] > old[1] || room[1] - room[0] < 0.6 * (old[1] - old[0]))) {
      this.limits.y[this.shown] = room;
    }
    const first = this.emt.find((c) => c.t && c.t.length) || this.linear.find((c) => c.t && c.t.length);
    if (first) this.limits.t = [Math.min(0, first.t[0]), Math.ceil(first.t[first.t.length - 1] * 20 - 1e-3) / 20];
  }

  // A band with both ends is an area, one with an open side is a line.
  bandsShown() {
    return this.bands.filter((band) => band.signal === this.shown);
  }

  paint(svg = null) {
    const { ctx, box } = this.figure.begin(svg);
    this.box = box;
    const t = theme();
    const limits = this.limits.y[this.shown] || [0, 1];
    if (this.words) return drawWords(ctx, box, this.words);
    const sx = scaleOf(this.limits.t, box.x, box.w);
    const sy = scaleOf(limits, box.y + box.h, -box.h);
    this.paintBands(ctx, box, sx, sy, true);
    const x = { scale: sx, ticks: ticksOf(sx.low, sx.high, 6), label: "time in s" };
    drawAxes(ctx, box, x, { scale: sy, ticks: ticksOf(limits[0], limits[1], 5), label: this.known[this.shown].label });
    clipped(ctx, box, () => {
      this.paintBands(ctx, box, sx, sy, false);
      for (const c of this.emt) {
        if (c[this.shown]) drawLine(ctx, box, sx, sy, c.t, c[this.shown], this.style(c, 2));
      }
      if (this.linearSignal === this.shown) {
        for (const c of this.linear) {
          if (!c.full) continue;
          // Dark dots stay visible on the EMT's line where both are the same; where they part, a thin line of the
          // controller's colour under the dots says whose they are.
          const { colour, alpha } = this.style(c, 1);
          const shown = this.untilOutside(c, limits);
          drawLine(ctx, box, sx, sy, shown.t, shown.full, { colour, width: 0.9, alpha });
          drawLine(ctx, box, sx, sy, shown.t, shown.full, {
            colour: t.black,
            width: 1.3,
            dash: [1.5, 3.5],
            alpha,
          });
        }
      }
      if (this.cursor !== null && !svg)
        drawLevel(ctx, box, sx(this.cursor), { colour: t.soft, dash: [2, 2], upright: true });
    });
    if (this.waiting) plateText(ctx, this.waiting, box.x + 8, box.y + box.h - 8, { size: 12 });
    return undefined;
  }

  // The linear answer of an unstable loop grows without bounds: it is drawn until it leaves the figure.
  untilOutside(c, [low, high]) {
    if (c.stable !== false) return c;
    const end = c.full.findIndex((v) => v < low || v > high);
    return end < 0 ? c : { t: c.t.subarray(0, end + 1), full: c.full.subarray(0, end + 1) };
  }

  paintBands(ctx, box, sx, sy, ground) {
    const t = theme();
    for (const band of this.bandsShown()) {
      const [from, to] = [Math.max(sx(band.from_s), box.x), Math.min(sx(band.to_s), box.x + box.w)];
      if (to <= from) continue;
      const closed = Number.isFinite(band.low) && Number.isFinite(band.high);
      if (ground && !closed) continue;
      if (closed) {
        const [top, bottom] = [Math.max(sy(band.high), box.y), Math.min(sy(band.low), box.y + box.h)];
        if (bottom <= top) continue;
        if (ground) {
          ctx.fillStyle = t.band;
          ctx.fillRect(from, top, to - from, bottom - top);
        } else if (band.label && bottom + 14 < box.y + box.h) {
          plateText(ctx, band.label, to - 4, bottom + 12, { align: "right", size: 10, colour: t.soft });
        }
        continue;
      }
      const at = sy(Number.isFinite(band.high) ? band.high : band.low);
      drawLevel(ctx, { ...box, x: from, w: to - from }, at, { colour: t.limit, dash: [6, 3], width: 1.25 });
      if (band.label)
        plateText(ctx, band.label, to - 4, band.under ? at + 12 : at - 4, {
          align: "right",
          size: 10,
          colour: t.limit,
        });
    }
  }

  style(c, width) {
    const faint = this.emphasis && this.emphasis !== c.name;
    return {
      colour: lineColour(c.colour),
      width: this.emphasis === c.name ? width + 0.75 : width,
      alpha: faint ? 0.25 : 1,
    };
  }

  // The values under the pointer, as answered (the nearest sample that was sent).
  readAt(event) {
    const hadOne = this.cursor !== null;
    this.cursor = null;
    let text = "";
    if (event && this.box && event.pointerType !== "touch") {
      const frame = this.canvas.getBoundingClientRect();
      const at = scaleOf(this.limits.t, this.box.x, this.box.w).back(event.clientX - frame.left);
      if (at >= this.limits.t[0] && at <= this.limits.t[1]) {
        this.cursor = at;
        const each = this.emt
          .filter((c) => c[this.shown])
          .map((c) => `${c.name} ${c[this.shown][nearestSample(c.t, at)].toFixed(3)}`);
        text = `${at.toFixed(2)} s: ${each.join(", ")}`;
      }
    }
    this.readout.textContent = text;
    if (hadOne || this.cursor !== null) this.paint();
  }
}

function nearestSample(times, at) {
  let [low, high] = [0, times.length - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] < at) low = middle;
    else high = middle;
  }
  return at - times[low] < times[high] - at ? low : high;
}
