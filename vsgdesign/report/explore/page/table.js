// The controllers side by side: margins, response, what the grid code would measure, gains in force, and words where
// there is no number.
import { SHAPES, lineColour, shapePath } from "./draw.js";
import { besideLimit } from "./units.js";

const minus = (text) => text.replaceAll("-", "−");
const isNone = (v) => v === null || v === undefined || Number.isNaN(v);
// A text may be asked for with more digits than usual, beside a limit.
const inDigits =
  (digits, factor = 1) =>
  (v, more = 0) =>
    isNone(v) ? "–" : minus((v * factor).toFixed(digits + more));
const orNone = (digits) => (v) => (isNone(v) || !Number.isFinite(v) ? "none" : minus(v.toFixed(digits)));
const significant = (v) =>
  isNone(v)
    ? "–"
    : minus(
        Math.abs(v) >= 1e5 || (v !== 0 && Math.abs(v) < 1e-3)
          ? v.toExponential(1).replace("+", "")
          : String(Number(v.toPrecision(3))),
      );

const perCent = (v) => (isNone(v) ? "–" : inDigits(Math.abs(v) < 0.995 ? 1 : 0, 100)(v));

// Columns: a title, a unit, the value of a row, its text, and the gate with its sense (1: at least, -1: at most).
const COLUMNS = [
  {
    group: "Margins",
    title: "disk",
    unit: "out",
    value: (c) => c.disk_margin_output,
    text: inDigits(2),
    gate: ["disk_margin_output", 1],
    tip: "Disk margin at the output: of both loops at once, broken at the measured P and Q",
  },
  {
    group: "Margins",
    title: "disk",
    unit: "in",
    value: (c) => c.disk_margin_input,
    text: inDigits(2),
    tip: "Disk margin at the input: the same, broken at the angle and the magnitude of the voltage",
  },
  {
    group: "Margins",
    title: "gain P",
    wide: true,
    unit: "dB",
    value: (c) => c.gain_margin_db,
    text: orNone(1),
    tip: "Gain margin of the loop of P",
  },
  {
    group: "Margins",
    title: "phase P",
    wide: true,
    unit: "°",
    value: (c) => c.phase_margin_deg,
    text: orNone(0),
    tip: "Phase margin of the loop of P",
  },
  {
    group: "Margins",
    title: "gain Q",
    wide: true,
    unit: "dB",
    value: (c) => c.gain_margin_Q_db,
    text: orNone(1),
    tip: "Gain margin of the loop of Q",
  },
  {
    group: "Margins",
    title: "phase Q",
    wide: true,
    unit: "°",
    value: (c) => c.phase_margin_Q_deg,
    text: orNone(0),
    tip: "Phase margin of the loop of Q",
  },
  { group: "Margins", title: "Mₛ", unit: "", value: (c) => c.M_s, text: inDigits(2), tip: "Peak of the sensitivity" },
  {
    group: "Linear",
    title: "ζ",
    unit: "",
    value: (c) => c.damping_all_modes,
    text: inDigits(2),
    gate: ["damping_all_modes", 1],
    tip: "Damping ratio of all modes: the least one in full order",
  },
  {
    group: "Linear",
    title: "settles",
    wide: true,
    unit: "s",
    value: (c) => c.settling_s,
    text: inDigits(2),
    gate: ["settling_s", -1],
    tip: "Settling time of the linear step",
  },
  {
    group: "Linear",
    title: "over",
    unit: "%",
    value: (c) => c.overshoot,
    text: inDigits(1, 100),
    gate: ["overshoot", -1],
    tip: "Overshoot of the linear step",
  },
  {
    group: "EMT",
    title: "settles",
    wide: true,
    unit: "s",
    value: (c, e) => e.settling_s ?? e.recovery_s,
    text: inDigits(2),
    tip: "Settling time of the step, or time to recover from the event, in the EMT",
  },
  {
    group: "EMT",
    title: "over",
    unit: "%",
    value: (c, e) => e.overshoot,
    text: inDigits(1, 100),
    tip: "Overshoot of the step in the EMT",
  },
  {
    group: "EMT",
    title: "peak i",
    wide: true,
    unit: "pu",
    value: (c, e) => e.peak_pu,
    text: inDigits(2),
    gate: ["current_limit_pu", -1],
    tip: "Largest current of the converter later than 5 ms after the event, in the EMT",
  },
  {
    group: "Droop, inertia",
    title: "P–f",
    unit: "%",
    value: (c) => c.droop_P,
    text: perCent,
    tip: "Droop of the frequency, as the grid code measures it",
  },
  {
    group: "Droop, inertia",
    title: "Q–V",
    wide: true,
    unit: "%",
    value: (c) => c.droop_Q,
    text: perCent,
    tip: "Droop of the voltage, as the grid code measures it",
  },
  {
    group: "Droop, inertia",
    title: "H",
    wide: true,
    unit: "s",
    value: (c) => c.H_s,
    text: inDigits(2),
    tip: "Inertia constant",
  },
];

/** Whether an EMT of this status does not come to rest. */
export const isWild = (status) => /unstable|diverged|slipped|latched|no rest/.test(status || "");

export const sentence = (words) => words.charAt(0).toUpperCase() + words.slice(1) + (/[.!?]$/.test(words) ? "" : ".");

function tag(name, attributes = {}, ...children) {
  const e = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key in e) e[key] = value;
    else e.setAttribute(key, value);
  }
  e.append(...children);
  return e;
}

/** The sign of a controller: its line and its marker, as in the figures. */
function signOf(colour, place) {
  const canvas = tag("canvas", { width: 44, height: 24, className: "sign" });
  canvas.setAttribute("aria-hidden", "true");
  const ctx = canvas.getContext("2d");
  ctx.scale(2, 2);
  ctx.strokeStyle = lineColour(colour);
  ctx.lineWidth = 2;
  ctx.beginPath();
  ctx.moveTo(0, 6);
  ctx.lineTo(22, 6);
  ctx.stroke();
  ctx.fillStyle = getComputedStyle(document.body).backgroundColor;
  shapePath(ctx, SHAPES[place % SHAPES.length], 11, 6, 4);
  if (place > 1) ctx.fill();
  ctx.stroke();
  return canvas;
}

export class ControllerTable {
  constructor(root, info, store, { onEmphasis }) {
    Object.assign(this, { root, info, store, onEmphasis, linear: [], emt: [] });
  }

  show(linear, emt) {
    this.linear = linear;
    this.emt = emt;
    this.paint();
  }

  gainNames() {
    const names = [];
    const every = this.linear.map((c) => c.gains || {});
    for (const gains of every) for (const name of Object.keys(gains)) if (!names.includes(name)) names.push(name);
    // A gain that no controller uses has no column. A grid without gains leaves the columns as they are.
    const used = names.filter((name) => every.some((gains) => gains[name]));
    const whole = (gains) => Object.keys(gains).length > 0 && !Object.values(gains).some(isNone);
    const known = every.some(whole);
    this.gains = known || !this.gains ? used : this.gains;
    return this.gains;
  }

  paint() {
    const gains = this.gainNames();
    const layout = `${gains.join()}|${this.rows()
      .map((r) => r.name)
      .join()}`;
    if (layout !== this.layout) this.build(gains);
    this.layout = layout;
    for (const row of this.rows()) this.fill(row, gains);
  }

  rows() {
    const all = this.info.controllers.filter((c) => c.name !== "own");
    const own = this.info.controllers.find((c) => c.name === "own") || { name: "own", colour: "#777777" };
    return this.store.state.own ? [...all, own] : all;
  }

  build(gains) {
    const groups = [];
    for (const { group } of COLUMNS) {
      if (groups.length && groups[groups.length - 1][0] === group) groups[groups.length - 1][1] += 1;
      else groups.push([group, 1]);
    }
    if (gains.length) groups.push(["Gains in force", gains.length]);
    const first = tag("tr", {}, tag("th", { rowSpan: 2, scope: "col", className: "name" }, "Controller"));
    for (const [group, span] of groups)
      first.append(tag("th", { colSpan: span, scope: "colgroup", className: "group" }, group));
    const second = tag("tr");
    COLUMNS.forEach((column, k) => {
      const start = k === 0 || COLUMNS[k - 1].group !== column.group;
      second.append(headCell(column.title, column.unit, column.tip, start));
    });
    gains.forEach((name, k) => {
      const known = (this.info.gains || []).find((gain) => gain.name === name) || {};
      second.append(headCell(known.label || name, known.unit || "", name, k === 0));
    });
    // Widths are fixed, so that nothing moves when a number gets longer.
    const widths = tag("colgroup", {}, tag("col", { className: "name" }));
    for (const column of COLUMNS) widths.append(tag("col", { className: column.wide ? "wide" : "" }));
    for (let k = 0; k < gains.length; k++) widths.append(tag("col", { className: "gain" }));
    this.cells = new Map();
    this.root.replaceChildren(
      widths,
      tag("thead", {}, first, second),
      ...this.rows().map((row) => this.buildRow(row, gains)),
    );
  }

  // Each controller has a line of numbers and a line of words, so that words that come and go move nothing.
  buildRow({ name, colour }, gains) {
    const place = this.info.controllers.findIndex((c) => c.name === name);
    const box = tag("input", { type: "checkbox", checked: this.store.state.controllers.includes(name) });
    box.addEventListener("change", () => this.choose(name, box));
    const label = tag(
      "label",
      {},
      box,
      signOf(colour, place < 0 ? this.info.controllers.length : place),
      tag("span", {}, name === "own" ? "my own gains" : name),
    );
    const tr = tag("tr", {}, tag("th", { rowSpan: 2, scope: "rowgroup", className: "name" }, label));
    const titles = [...COLUMNS.map((column) => column.group), ...gains.map(() => "gains")];
    const cells = titles.map((group, k) => tag("td", { className: k && titles[k - 1] === group ? "" : "start" }));
    tr.append(...cells);
    const words = tag("div", {}, tag("span", { className: "bad" }), tag("span"));
    const said = tag("td", { className: "words", colSpan: cells.length }, words);
    const body = tag("tbody", {}, tr, tag("tr", {}, said));
    body.addEventListener("pointerenter", () => this.onEmphasis(name));
    body.addEventListener("pointerleave", () => this.onEmphasis(null));
    box.addEventListener("focus", () => box.matches(":focus-visible") && this.onEmphasis(name));
    box.addEventListener("blur", () => this.onEmphasis(null));
    this.cells.set(name, { body, cells, box, words });
    return body;
  }

  // At least one controller stays shown; the order is the study's.
  choose(name, box) {
    const now = new Set(this.store.state.controllers);
    if (box.checked) now.add(name);
    else now.delete(name);
    if (!now.size) {
      box.checked = true;
      return;
    }
    this.store.set({
      controllers: this.rows()
        .map((row) => row.name)
        .filter((one) => now.has(one)),
    });
    this.store.commit();
  }

  // Cells are changed in place: during a drag the table is filled some fifty times a second.
  fill({ name }, gains) {
    const { body, cells, box, words } = this.cells.get(name);
    const shown = this.store.state.controllers.includes(name);
    box.checked = shown;
    body.classList.toggle("away", !shown);
    const c = this.linear.find((one) => one.name === name);
    const e = this.emt.find((one) => one.name === name) || {};
    const [bad, plain] = shown && c ? wordsOf(c, e) : ["", shown ? "" : "Not shown."];
    setText(words.firstChild, bad);
    setText(words.lastChild, bad && plain ? ` ${plain}` : plain);
    words.title = `${bad} ${plain}`.trim();
    const without = !shown || !c || (!c.stable && !(c.modes || []).length);
    COLUMNS.forEach((column, k) => {
      const value = without ? null : column.value(c, e);
      // An unstable loop has no margins; "none" says of a stable one that it has no crossing.
      const limit = this.missed(column, value);
      const text = isNone(limit) ? column.text(value) : besideLimit(value, limit, column.text);
      setText(cells[k], without || (!c.stable && isNone(value)) ? "–" : text);
      this.mark(cells[k], column, limit);
    });
    gains.forEach((gain, k) => setText(cells[COLUMNS.length + k], significant(without ? null : (c.gains || {})[gain])));
  }

  // The limit that a value misses, or null.
  missed({ gate: [gate, sense] = [] }, value) {
    const { gates = {}, most = {} } = this.info;
    const limit = gate ? gates[gate] : null;
    const kept = most[gate] ?? limit;
    return !isNone(limit) && !isNone(value) && sense * (value - kept) < 0 ? limit : null;
  }

  mark(cell, { gate: [, sense] = [], text, unit }, limit) {
    cell.classList.toggle("miss", !isNone(limit));
    const asked = `The study asks for ${sense > 0 ? "at least" : "at most"}`;
    cell.title = isNone(limit) ? "" : `${asked} ${text(limit)}${unit ? " " + unit : ""}.`;
  }
}

function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

// The scheduler's status. That gains follow the estimate needs no words.
const SCHEDULES = {
  held: "Its gains are held",
  fixed: "Its gains are fixed",
  clamped: "The estimate is outside the table, so the gains are those of its edge",
};

/** What there is to say of a controller: first what is wrong, then the verdict of the EMT, then notes. */
function wordsOf(c, e) {
  const wild = isWild(e.status);
  const wrong = [c.stable === false && !wild ? c.why || "unstable" : "", c.stable === null ? c.why : "", c.outside];
  const bad = [...wrong, wild ? e.verdict || e.why : ""].filter(Boolean);
  const plain = [wild || c.stable === null ? "" : e.verdict || e.why || e.status, SCHEDULES[c.schedule], c.note].filter(
    Boolean,
  );
  return [bad.map(sentence).join(" "), plain.map(sentence).join(" ")];
}

function headCell(title, unit, tip, start) {
  const cell = tag("th", { scope: "col", title: tip, className: start ? "start" : "" }, title);
  cell.append(tag("small", {}, unit || "\u00a0"));
  return cell;
}
