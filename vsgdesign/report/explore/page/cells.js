// The cells of a page without a server: what the file says of every controller on each grid of its lattice.
import { at, readColumns } from "./columns.js";

const STABLE = [null, false, true];
const STEP_S = 2;
const STEP_POINTS = 400;
const STEP_PU = 0.05;
const BODE_POINTS = 240;
const BODE_RAD_S = [1, 3000];

const orNull = (value) => (Number.isNaN(value) ? null : value);

const nearestIndex = (values, value) => {
  let best = 0;
  values.forEach((v, i) => {
    if (Math.abs(Math.log(v / value)) < Math.abs(Math.log(values[best] / value))) best = i;
  });
  return best;
};

export class Cells {
  /** kept: what the file holds; figures and texts: the packed columns and the texts. */
  constructor(kept, figures, texts) {
    Object.assign(this, { kept, texts, lattice: kept.info.lattice, T_s: kept.runs.info.T_s });
    this.columns = readColumns(figures, kept.cells.columns);
  }

  number(column, cell) {
    return at(this.columns[column], cell);
  }

  text(column, cell) {
    return this.texts[this.number(column, cell) - 1] || null;
  }

  /** The rows of all controllers on a grid, as those of the server; settling time and overshoot are those of a signal. */
  rows(cell, held, signal) {
    return this.kept.cells[held ? "held" : "follow"].map((one, k) => {
      const { name: own, colour, structure, note } = this.kept.cells.controllers[k];
      const numbers = (columns) =>
        Object.fromEntries(Object.entries(columns).map(([name, column]) => [name, orNull(this.number(column, cell))]));
      const figures = numbers(one.figures);
      const { settling_Q_s: settling, overshoot_Q: overshoot, ...rest } = figures;
      if (signal === "Q") Object.assign(rest, { settling_s: settling, overshoot });
      const modes = one.modes
        .map(([re, im]) => ({ re: this.number(re, cell), im: this.number(im, cell) }))
        .filter(({ re }) => !Number.isNaN(re))
        .map(({ re, im }) => ({ re, im, damping: -re / Math.hypot(re, im), f_hz: im / (2 * Math.PI) }));
      return {
        ...rest,
        name: own,
        colour,
        structure,
        note,
        gains: numbers(one.gains),
        modes,
        stable: STABLE[this.number(one.stable, cell)],
        schedule: one.schedules[this.number(one.schedule, cell)],
        why: this.text(one.why, cell),
        outside: this.text(one.outside, cell),
      };
    });
  }

  /** The linear answer on a grid: rows, and curves that the worker draws. */
  async linear(cell, state, live) {
    const { event } = state;
    const step = event.kind === "step";
    const [signal, size] = step ? [event.signal, event.size] : ["P", STEP_PU];
    const rows = this.rows(cell, state.hold, signal);
    const [low, high] = [BODE_RAD_S[0], Math.min(BODE_RAD_S[1], (0.99 * Math.PI) / this.T_s)];
    const omega = Float64Array.from({ length: BODE_POINTS }, (_, k) => low * (high / low) ** (k / (BODE_POINTS - 1)));
    const every = Math.max(Math.round(STEP_S / STEP_POINTS / this.T_s), 1);
    const count = Math.floor(Math.round(STEP_S / this.T_s) / every) + 1;
    const key = state.hold ? `${cell},h` : `${cell}`;
    const asked = { omega, every, count, signal };
    const arrays = {};
    const times = Float32Array.from({ length: count }, (_, k) => k * every * this.T_s);
    const { P_pu, Q_pu } = this.kept.info.defaults;
    const begin = signal === "P" ? P_pu : Q_pu;
    const places = rows.map((_, k) => k);
    const drawn = await live.shared(1, places, { kind: "linear", key, asked });
    drawn.forEach((curves, k) => {
      if (!curves || rows[k].stable === null) return;
      const put = (name, values) => (arrays[`${k}/${name}`] = Float32Array.from(values));
      put("bode_w", omega);
      put("bode_mag_db", curves.mag);
      put("bode_phase_deg", curves.phase);
      put("bode_Q_mag_db", curves.mag_Q);
      put("bode_Q_phase_deg", curves.phase_Q);
      put("step_t", times);
      put(
        "step_full",
        curves.step.map((y) => begin + size * Math.min(Math.max(y, -1e3), 1e3)),
      );
    });
    return { header: { signal, step_pu: size, controllers: rows }, arrays };
  }

  /** What takes part in the modes of every controller on a grid, and what moves them. */
  async modes(cell, state, live) {
    const rows = this.rows(cell, state.hold, "P");
    const key = state.hold ? `${cell},h` : `${cell}`;
    const found = await live.asks(1, { kind: "modes", key, modes: rows.map((row) => row.modes) });
    return { header: { controllers: rows.map(({ name }, k) => ({ name, modes: found[k] })) }, arrays: {} };
  }

  /** The map of a figure of one controller. */
  map(state) {
    const { info, cells } = this.kept;
    const figure = info.figures.find((one) => one.name === state.figure);
    const shown = cells.controllers.map(({ name }) => name).filter((name) => state.controllers.includes(name));
    const controller = shown.includes(state.map_of) ? state.map_of : shown[shown.length - 1];
    const place = cells.controllers.findIndex(({ name }) => name === controller);
    const one = cells[state.hold ? "held" : "follow"][place];
    const count = this.lattice.scr.length * this.lattice.x_over_r.length;
    const every = (of) => Float32Array.from({ length: count }, (_, cell) => of(cell));
    const stable = (cell) => STABLE[this.number(one.stable, cell)];
    const column = one.figures[figure.name];
    // What is stable and has no time within which it settles takes longer than any promise.
    const without = figure.better === "low" ? Infinity : NaN;
    const value = (cell) => {
      const found = column === undefined ? NaN : figure.scale * this.number(column, cell);
      return Number.isNaN(found) ? without : found;
    };
    const values = every((cell) => (stable(cell) ? value(cell) : stable(cell) === false ? -Infinity : NaN));
    return {
      place,
      header: { ...figure, figure: figure.name, controller, why: null },
      arrays: {
        scr: this.lattice.scr,
        x_over_r: this.lattice.x_over_r,
        values,
        unstable: every((cell) => Number(stable(cell) === false)),
        limit_use: every((cell) => this.number(one.limit_use, cell)),
      },
    };
  }

  /** The nearest grid of the lattice, and its place there. */
  nearest(grid) {
    const [i, j] = [nearestIndex(this.lattice.scr, grid.scr), nearestIndex(this.lattice.x_over_r, grid.x_over_r)];
    const { scr, x_over_r } = this.lattice;
    return { scr: scr[i], x_over_r: x_over_r[j], cell: i + j * scr.length, place: [i + 1, j + 1] };
  }

  /** Which grid of the lattice is shown. */
  says(grid) {
    const { place } = this.nearest(grid);
    const { scr, x_over_r } = this.lattice;
    return `Grid ${place[0]}, ${place[1]} of the ${scr.length} × ${x_over_r.length} in this file`;
  }
}
