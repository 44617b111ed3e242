// The loop's frequency response: magnitude over phase with one frequency axis. The margins are marked where they are
// read: the phase margin at the crossing of 0 dB, the gain margin at the crossing of -180 degrees.
import {
  Figure,
  clipped,
  drawAxes,
  drawLevel,
  drawLine,
  drawWords,
  lineColour,
  logTicks,
  plateText,
  scaleOf,
  theme,
  tickText,
} from "./draw.js";

const POWERS = { 0.1: "0.1", 1: "1", 10: "10", 100: "100", 1000: "1 000", 10000: "10⁴", 100000: "10⁵" };

const powerText = (v) => POWERS[Number(v.toPrecision(3))] || tickText(v);

/** The value of a curve at x on the logarithmic axis, for a marker on the drawn line. */
function onCurve(xs, ys, x) {
  for (let i = 1; i < xs.length; i++) {
    if (xs[i] >= x) {
      const f = Math.log(x / xs[i - 1]) / Math.log(xs[i] / xs[i - 1]);
      return ys[i - 1] + f * (ys[i] - ys[i - 1]);
    }
  }
  return NaN;
}

export class BodePlot {
  constructor(magnitude, phase, store) {
    this.magnitude = new Figure(magnitude, { left: 48, right: 10, top: 6, bottom: 6 });
    this.phase = new Figure(phase, { left: 48, right: 10, top: 6, bottom: 36 });
    Object.assign(this, { store, curves: [], words: "", emphasis: null, loop: "P" });
    this.limits = { w: [1, 3000], mag: [-60, 40], phase: [-360, 0] };
  }

  /** curves: [{name, colour, w, mag, phase, crossover, phaseCrossover}] with arrays as answered. */
  show(curves, words) {
    this.curves = curves;
    this.words = words || "";
    if (!this.store.dragging) this.settle();
    this.paint();
  }

  // Limits are chosen when nothing is dragged: the phase in whole quarters of a turn, the frequency as answered.
  settle() {
    const usable = this.curves.filter((c) => c.w && c.w.length > 1);
    if (!usable.length) return;
    this.limits.w = [usable[0].w[0], usable[0].w[usable[0].w.length - 1]];
    let [low, high] = [-270, -90];
    let top = 40;
    for (const c of usable) {
      for (let i = 0; i < c.phase.length; i++) {
        if (c.mag[i] > top) top = c.mag[i];
        // The phase of a loop that is hardly there does not stretch the axis.
        if (c.mag[i] < -60) continue;
        if (c.phase[i] < low) low = c.phase[i];
        if (c.phase[i] > high) high = c.phase[i];
      }
    }
    this.limits.phase = [Math.max(-540, Math.floor(low / 90) * 90), Math.min(180, Math.ceil(high / 90) * 90)];
    this.limits.mag = [-60, Math.min(80, Math.ceil(top / 20) * 20)];
  }

  paint() {
    this.paintMagnitude(this.magnitude.begin());
    this.paintPhase(this.phase.begin());
  }

  paintTo(svgMagnitude, svgPhase) {
    this.paintMagnitude(this.magnitude.begin(svgMagnitude));
    this.paintPhase(this.phase.begin(svgPhase));
  }

  style(c) {
    const faint = this.emphasis && this.emphasis !== c.name;
    return { colour: lineColour(c.colour), width: this.emphasis === c.name ? 2.5 : 1.75, alpha: faint ? 0.3 : 1 };
  }

  axisX(box, bare) {
    const scale = scaleOf(this.limits.w, box.x, box.w, true);
    return {
      scale,
      ticks: logTicks(scale.low, scale.high),
      text: powerText,
      label: bare ? "" : "frequency in rad/s",
      bare,
    };
  }

  paintMagnitude({ ctx, box }) {
    if (this.words) return drawWords(ctx, box, this.words);
    const x = this.axisX(box, true);
    const sy = scaleOf(this.limits.mag, box.y + box.h, -box.h);
    const ticks = [];
    for (let v = this.limits.mag[0]; v <= this.limits.mag[1]; v += 20) ticks.push(v);
    drawAxes(ctx, box, x, { scale: sy, ticks, label: "magnitude in dB" });
    drawLevel(ctx, box, sy(0), { colour: theme().text, dash: [5, 4] });
    clipped(ctx, box, () => {
      for (const c of this.curves) {
        if (!c.w) continue;
        drawLine(ctx, box, x.scale, sy, c.w, c.mag, this.style(c));
        if (c.crossover) this.dot(ctx, x.scale(c.crossover), sy(0), c);
        if (c.phaseCrossover)
          this.bar(ctx, x.scale(c.phaseCrossover), sy(0), sy(onCurve(c.w, c.mag, c.phaseCrossover)), c);
      }
    });
    return undefined;
  }

  paintPhase({ ctx, box }) {
    if (this.words) return undefined;
    const x = this.axisX(box, false);
    const sy = scaleOf(this.limits.phase, box.y + box.h, -box.h);
    const ticks = [];
    for (let v = this.limits.phase[0]; v <= this.limits.phase[1]; v += 90) ticks.push(v);
    drawAxes(ctx, box, x, { scale: sy, ticks, label: "phase in °" });
    drawLevel(ctx, box, sy(-180), { colour: theme().text, dash: [5, 4] });
    plateText(ctx, "−180°", box.x + 5, sy(-180) - 3, { size: 10, colour: theme().soft });
    clipped(ctx, box, () => {
      for (const c of this.curves) {
        if (!c.w) continue;
        drawLine(ctx, box, x.scale, sy, c.w, c.phase, this.style(c));
        if (!c.crossover) continue;
        const at = onCurve(c.w, c.phase, c.crossover);
        const turn = -180 + 360 * Math.round((at + 180) / 360);
        this.bar(ctx, x.scale(c.crossover), sy(turn), sy(at), c);
        this.dot(ctx, x.scale(c.crossover), sy(at), c);
      }
    });
    return undefined;
  }

  dot(ctx, x, y, c) {
    const { colour, alpha } = this.style(c);
    ctx.globalAlpha = alpha;
    ctx.beginPath();
    ctx.arc(x, y, 4, 0, 7);
    ctx.fillStyle = colour;
    ctx.fill();
    ctx.lineWidth = 1.5;
    ctx.strokeStyle = theme().back;
    ctx.stroke();
    ctx.globalAlpha = 1;
  }

  bar(ctx, x, from, to, c) {
    if (Number.isNaN(to)) return;
    const { colour, alpha } = this.style(c);
    ctx.globalAlpha = alpha;
    ctx.strokeStyle = colour;
    ctx.lineWidth = 1.25;
    ctx.setLineDash([2, 2]);
    ctx.beginPath();
    ctx.moveTo(x, from);
    ctx.lineTo(x, to);
    for (const end of [from, to]) {
      ctx.moveTo(x - 3, end);
      ctx.lineTo(x + 3, end);
    }
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.globalAlpha = 1;
  }
}
