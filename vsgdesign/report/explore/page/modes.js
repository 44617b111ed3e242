// The modes in the s-plane: a marker of its own shape for each controller, rays of equal damping, and a panel that says
// what takes part in the chosen mode and what moves it.
import {
  Figure,
  SHAPES,
  clipped,
  drawAxes,
  drawWords,
  font,
  lineColour,
  plateText,
  scaleOf,
  shapePath,
  theme,
  tickText,
  ticksOf,
} from "./draw.js";

const RAYS = [0.1, 0.3, 0.5, 0.7];

const signed = (value, digits) => (value < 0 ? "−" : "") + Math.abs(value).toFixed(digits);

const modeDigits = (value) => (Math.abs(value) < 10 ? 2 : Math.abs(value) < 1000 ? 1 : 0);

export class ModesPlot {
  constructor(canvas, panel, info, store) {
    this.figure = new Figure(canvas, { left: 44, right: 10, top: 6, bottom: 36 });
    Object.assign(this, {
      canvas,
      panel,
      info,
      store,
      chosen: null,
      controllers: [],
      before: null,
      words: "",
      zoom: 1,
      details: [],
      onChosen: () => {},
    });
    canvas.addEventListener("click", (event) => this.chooseNear(event));
    canvas.addEventListener("keydown", (event) => this.chooseByKey(event));
  }

  show(controllers, words) {
    if (!this.store.dragging) this.before = controllers;
    this.controllers = controllers;
    this.words = words || "";
    if (this.chosen) this.follow();
    this.paint();
    this.tellChosen();
  }

  /** What takes part in the modes and what moves them, by controller: an answer of its own, while a mode is chosen. */
  detail(controllers) {
    this.details = controllers;
    this.tellChosen();
  }

  // The nearest mode that has been described: until the next answer is here, that of a moment ago.
  detailOf(name, mode) {
    if (mode.participation) return mode;
    const c = this.details.find((one) => one.name === name);
    return (c && nearestMode(c.modes, mode)) || {};
  }

  scales(box) {
    const { re, im } = this.window();
    return [scaleOf(re, box.x, box.w), scaleOf(im, box.y + box.h, -box.h)];
  }

  // The window belongs to the study and stays during a drag; the user may zoom it around the origin.
  window() {
    const { re, im } = this.info.modes;
    return { re: re.map((v) => v / this.zoom), im: im.map((v) => v / this.zoom) };
  }

  zoomBy(factor) {
    this.zoom = Math.min(64, Math.max(1 / 64, this.zoom * factor));
    this.paint();
  }

  paint(svg = null) {
    const { ctx, box } = this.figure.begin(svg);
    this.box = box;
    if (this.words) return drawWords(ctx, box, this.words);
    const [sx, sy] = this.scales(box);
    const t = theme();
    if (sx.high > 0) {
      ctx.fillStyle = t.unstableSide;
      ctx.fillRect(sx(0), box.y, sx(sx.high) - sx(0), box.h);
    }
    const x = { scale: sx, ticks: ticksOf(sx.low, sx.high, 6), label: "real part in 1/s" };
    const y = { scale: sy, ticks: ticksOf(sy.low, sy.high, 6), label: "imaginary part in rad/s" };
    drawAxes(ctx, box, x, y);
    clipped(ctx, box, () => {
      this.paintRays(ctx, box, sx, sy);
      if (this.before && this.before !== this.controllers) this.paintMarkers(ctx, sx, sy, this.before, 0.35);
      this.paintMarkers(ctx, sx, sy, this.controllers, 1);
      this.paintChosen(ctx, sx, sy);
    });
    this.sayOutside(ctx, box, sx, sy);
    return undefined;
  }

  // A ray holds all modes of one damping ratio zeta: real part -zeta w, imaginary part +-sqrt(1 - zeta^2) w.
  paintRays(ctx, box, sx, sy) {
    const t = theme();
    const gate = this.info.gates && this.info.gates.damping_all_modes;
    // The promised ratio comes first: a label that would touch its own is left out.
    const values = [...new Set([...(gate ? [gate] : []), ...RAYS.filter((z) => !gate || Math.abs(z - gate) > 0.05)])];
    const named = [];
    for (const zeta of values) {
      const slope = Math.sqrt(1 - zeta * zeta) / zeta;
      const length = Math.min(-sx.low, sy.high / slope);
      for (const side of [1, -1]) {
        ctx.beginPath();
        ctx.moveTo(sx(0), sy(0));
        ctx.lineTo(sx(-length), sy(side * length * slope));
        ctx.strokeStyle = t.rule;
        ctx.lineWidth = zeta === gate ? 1.5 : 1;
        ctx.setLineDash(zeta === gate ? [6, 3] : [2, 4]);
        ctx.stroke();
      }
      ctx.setLineDash([]);
      const steep = length < -sx.low;
      const [at, up] = [sx(-length) + (steep ? 3 : 4), sy(length * slope) + (steep ? 11 : 4)];
      const text = zeta === gate ? `ζ ${tickText(zeta)} promised` : tickText(zeta);
      ctx.font = font(10);
      const end = at + ctx.measureText(text).width;
      if (named.some(([from, to, y]) => at < to + 8 && end > from - 8 && Math.abs(y - up) < 14)) continue;
      named.push([at, end, up]);
      plateText(ctx, text, at, up, { size: 10, colour: t.soft });
    }
  }

  paintMarkers(ctx, sx, sy, controllers, alpha) {
    ctx.globalAlpha = alpha;
    for (const c of controllers) {
      ctx.strokeStyle = lineColour(c.colour);
      ctx.lineWidth = alpha < 1 ? 1 : 2;
      for (const mode of c.modes || []) {
        // Of a pair the answer lists the mode with the positive imaginary part.
        for (const im of mode.im > 0 ? [mode.im, -mode.im] : [mode.im]) {
          shapePath(ctx, SHAPES[c.place % SHAPES.length], sx(mode.re), sy(im), alpha < 1 ? 3 : 4.5);
          ctx.stroke();
        }
      }
    }
    ctx.globalAlpha = 1;
  }

  paintChosen(ctx, sx, sy) {
    const mode = this.chosenMode();
    if (!mode) return;
    ctx.beginPath();
    ctx.arc(sx(mode.re), sy(mode.im), 9, 0, 7);
    ctx.strokeStyle = theme().black;
    ctx.lineWidth = 1.5;
    ctx.stroke();
  }

  // The least damped mode of all, if it is outside the window: nothing that limits may go unseen.
  sayOutside(ctx, box, sx, sy) {
    let worst = null;
    for (const c of this.controllers) {
      for (const m of c.modes || []) if (!worst || m.damping < worst.m.damping) worst = { c, m };
    }
    if (!worst || (Math.abs(worst.m.im) <= sy.high && worst.m.re >= sx.low && worst.m.re <= sx.high)) return;
    const { c, m } = worst;
    const place = `${signed(m.re, modeDigits(m.re))} ± j${Math.abs(m.im).toFixed(modeDigits(m.im))} 1/s`;
    const text = m.re > 0 ? `unstable, outside: ${c.name} ${place}` : `least damped, outside: ${c.name} ${place}`;
    const colour = m.re > 0 ? theme().limit : theme().text;
    plateText(ctx, text, box.x + 6, box.y + box.h - 8, { colour });
  }

  visible() {
    const { re, im } = this.window();
    const all = [];
    for (const c of this.controllers) {
      (c.modes || []).forEach((mode, index) => {
        if (mode.im >= -1e-9 && mode.re >= re[0] && mode.re <= re[1] && mode.im <= im[1])
          all.push({ name: c.name, index, mode });
      });
    }
    return all;
  }

  chosenMode() {
    if (!this.chosen) return null;
    const c = this.controllers.find((one) => one.name === this.chosen.name);
    return (c && c.modes && c.modes[this.chosen.index]) || null;
  }

  // After a move the chosen mode is the nearest one of the same controller.
  follow() {
    const c = this.controllers.find((one) => one.name === this.chosen.name);
    const mode = nearestMode((c && c.modes) || [], this.chosen);
    this.chosen = mode ? { name: c.name, index: c.modes.indexOf(mode), re: mode.re, im: mode.im } : null;
  }

  choose(entry) {
    this.chosen = entry ? { name: entry.name, index: entry.index, re: entry.mode.re, im: entry.mode.im } : null;
    this.paint();
    this.tellChosen();
    if (this.chosen) this.onChosen();
  }

  chooseNear(event) {
    const frame = this.canvas.getBoundingClientRect();
    const [sx, sy] = this.scales(this.box);
    const [px, py] = [event.clientX - frame.left, event.clientY - frame.top];
    let best = null;
    for (const c of this.controllers) {
      (c.modes || []).forEach((mode, index) => {
        const distance = Math.min(...[mode.im, -mode.im].map((im) => Math.hypot(sx(mode.re) - px, sy(im) - py)));
        if (distance < 16 && (!best || distance < best.distance)) best = { distance, name: c.name, index, mode };
      });
    }
    this.choose(best);
  }

  chooseByKey(event) {
    const all = this.visible();
    if (event.key === "Escape") return this.choose(null);
    if (event.key === "+" || event.key === "-") return this.zoomBy(event.key === "+" ? 2 : 0.5);
    const by = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    if (!by || !all.length) return undefined;
    event.preventDefault();
    const at = all.findIndex((one) => this.chosen && one.name === this.chosen.name && one.index === this.chosen.index);
    return this.choose(all[(at < 0 ? (by > 0 ? 0 : all.length - 1) : at + by + all.length) % all.length]);
  }

  tellChosen() {
    const mode = this.chosenMode();
    this.panel.hidden = !mode;
    if (!mode) return;
    this.panel.replaceChildren(
      ...modePanel(this.chosen.name, mode, this.detailOf(this.chosen.name, mode), () => {
        this.choose(null);
        this.canvas.focus();
      }),
    );
  }
}

function element(tag, text, className = "") {
  const e = document.createElement(tag);
  e.textContent = text;
  if (className) e.className = className;
  return e;
}

function nearestMode(modes, { re, im }) {
  let best = null;
  for (const mode of modes) {
    const distance = Math.hypot(mode.re - re, mode.im - im);
    if (!best || distance < best.distance) best = { distance, mode };
  }
  return best && best.mode;
}

function modePanel(name, mode, detail, close) {
  const im = Math.abs(mode.im) > 1e-6 ? ` ± j${Math.abs(mode.im).toFixed(modeDigits(mode.im))}` : "";
  const button = element("button", "×", "close");
  button.setAttribute("aria-label", "Close the mode's panel");
  button.addEventListener("click", close);
  const facts = [];
  if (mode.damping !== null && mode.damping !== undefined) facts.push(`damping ${signed(mode.damping, 2)}`);
  if (im && mode.f_hz) facts.push(`${mode.f_hz.toFixed(2)} Hz`);
  const parts = [
    button,
    element("strong", `${name}: ${signed(mode.re, modeDigits(mode.re))}${im} 1/s`),
    element("div", facts.join(", ")),
  ];
  const shares = (detail.participation || []).slice(0, 4);
  if (shares.length) {
    parts.push(element("h4", "What takes part"));
    const list = element("ul", "", "shares");
    for (const [state, share] of shares) {
      const item = element("li", "");
      const [bar, filled] = [element("div", "", "bar"), element("span", "")];
      filled.style.width = `${100 * Math.min(1, share)}%`;
      bar.append(filled);
      item.append(element("span", state), bar, element("span", `${(100 * share).toFixed(0)} %`, "number"));
      list.append(item);
    }
    parts.push(list);
  }
  const raw = detail.moved_by || [];
  const moved = (Array.isArray(raw[0]) ? raw : raw.length ? [raw] : []).slice(0, 3);
  if (moved.length) {
    parts.push(element("h4", "What moves it, real part per +1 %"));
    const list = element("ul", "", "moves");
    for (const [parameter, rate] of moved) {
      const item = element("li", "");
      item.append(
        element("span", parameter),
        element("span", `${rate > 0 ? "+" : ""}${signed(rate, 3)} 1/s`, "number"),
      );
      list.append(item);
    }
    parts.push(list);
  }
  return parts;
}
