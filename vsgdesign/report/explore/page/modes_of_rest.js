// The slowest mode of a controller at a rest. The rest is found with the compiled loop: one sample of it, with the source
// turned back, is a map that stays where it is at a rest. No equation of the controller is here.
import { LinearModel } from "./linear.js";

const ROUNDS = 12;
const STEP = 5e-3;
// Of a dc link, whose source may be near a limit: some millivolts are some milliamperes of a battery.
const STEP_DC = 1e-5;
const STILL = 1e-9;
const SERVES = 0.1;
const WEAK = 1e-9;

/** The numbers of the loop that one sample moves, as a map in the frame of the source. */
class Sampled {
  constructor(run) {
    const { loop, info } = run;
    const { rows, state } = info.places[run.controller.averaged];
    // Of a dc link the states of the model count: a charge, and what is summed up, stay as they are at the start.
    const { model } = run.controller;
    const known = new Set(model ? model.z.map((at) => info.places[run.controller.loop].rows[at]) : []);
    const held = (name) => /^(dc|clamp)\./.test(name) && !known.has(name);
    const counted = (name) => !name.startsWith("source.") && name !== "limited" && !held(name);
    Object.assign(this, { loop, names: rows.slice(0, state).filter(counted) });
    this.held = rows.filter(held).map((name) => [loop.rows + loop.at[name], run.start.rows[run.at[name]]]);
    this.at = this.names.map((name) => loop.rows + loop.at[name]);
    this.source = ["source.cosine", "source.sine"].map((name) => loop.rows + loop.at[name]);
    // Components on the axes α and β, of which the second follows the first, turn with the source.
    this.pairs = this.names.flatMap((name, k) =>
      /[._]alpha$/.test(name) ? [[k, this.names.indexOf(name.replace(/alpha$/, "beta"))]] : [],
    );
    this.angle = this.names.indexOf("state.theta");
    this.omega_T = run.source.omega * run.T_s;
  }

  turned(x, by) {
    const [cosine, sine] = [Math.cos(by), Math.sin(by)];
    for (const [k, j] of this.pairs) {
      const [a, b] = [x[k], x[j]];
      x[k] = cosine * a - sine * b;
      x[j] = sine * a + cosine * b;
    }
    x[this.angle] = Math.atan2(Math.sin(x[this.angle] + by), Math.cos(x[this.angle] + by));
    return x;
  }

  /** The state as it is, with the source at the angle zero. */
  now() {
    const { floats } = this.loop.memory;
    const by = Math.atan2(this.loop.get("source.sine"), this.loop.get("source.cosine"));
    return this.turned(
      Float64Array.from(this.at, (at) => floats[at]),
      -by,
    );
  }

  /** The state one sample after x, in `found`. */
  after(x, found = new Float64Array(x.length)) {
    const { at, loop } = this;
    const { floats } = loop.memory;
    for (let k = 0; k < at.length; k += 1) floats[at[k]] = x[k];
    for (const [place, value] of this.held) floats[place] = value;
    floats[this.source[0]] = 1;
    floats[this.source[1]] = 0;
    loop.call(0, 1);
    for (let k = 0; k < at.length; k += 1) found[k] = floats[at[k]];
    return this.turned(found, -this.omega_T);
  }

  /** The derivative, row by row, by differences of the fourth order. */
  matrix(x) {
    const n = x.length;
    const found = Array.from({ length: n }, () => new Float64Array(n));
    const [high, low, higher, lower] = [1, 2, 3, 4].map(() => new Float64Array(n));
    const moved = x.slice();
    for (let j = 0; j < n; j += 1) {
      const step = (this.names[j].startsWith("dc.") ? STEP_DC : STEP) * Math.max(Math.abs(x[j]), 1);
      const at = (by, into) => {
        moved[j] = x[j] + by * step;
        this.after(moved, into);
      };
      at(1, high);
      at(-1, low);
      at(2, higher);
      at(-2, lower);
      moved[j] = x[j];
      for (let i = 0; i < n; i += 1) {
        const [near, far] = [this.apart(high, low, i), this.apart(higher, lower, i)];
        found[i][j] = (8 * near - far) / (12 * step);
      }
    }
    return found;
  }

  /** The derivative of what is coupled. */
  coupledAt(x) {
    const A = this.matrix(x);
    const { both } = coupled(A, x, this.angle);
    return both.map((i) => Float64Array.from(both, (j) => A[i][j]));
  }

  /** Whether a state is that of a rest. */
  isAt(x, { V_rms, delta }) {
    const [V, theta] = [x[this.names.indexOf("state.V")], x[this.angle]];
    return Math.abs(V / V_rms - 1) < 1e-6 && Math.abs(Math.sin(0.5 * (theta - delta))) < 1e-6;
  }

  apart(one, other, i) {
    const found = one[i] - other[i];
    return i === this.angle ? Math.atan2(Math.sin(found), Math.cos(found)) : found;
  }
}

/** The places of what the angle moves, directly or not, and of those that move it, too: all else is no part of a rest. */
function coupled(A, x, angle) {
  const size = x.map((value) => Math.max(Math.abs(value), 1));
  const moves = (k, i) => Math.abs(A[i][k]) * size[k] > WEAK * size[i];
  const reached = (leads) => {
    const [found, open] = [new Set([angle]), [angle]];
    while (open.length) {
      const k = open.pop();
      for (let i = 0; i < x.length; i += 1) {
        if (found.has(i) || !leads(k, i)) continue;
        found.add(i);
        open.push(i);
      }
    }
    return found;
  };
  const [after, before] = [reached((k, i) => moves(k, i)), reached((k, i) => moves(i, k))];
  const moved = [...after].sort((a, b) => a - b);
  return { moved, both: moved.filter((k) => before.has(k)) };
}

/** x of A x = b, by elimination; A and b are used up. */
function solved(A, b) {
  const n = b.length;
  for (let k = 0; k < n; k += 1) {
    let best = k;
    for (let i = k + 1; i < n; i += 1) if (Math.abs(A[i][k]) > Math.abs(A[best][k])) best = i;
    [A[k], A[best], b[k], b[best]] = [A[best], A[k], b[best], b[k]];
    for (let i = k + 1; i < n; i += 1) {
      const factor = A[i][k] / A[k][k];
      if (!factor) continue;
      for (let j = k; j < n; j += 1) A[i][j] -= factor * A[k][j];
      b[i] -= factor * b[k];
    }
  }
  for (let k = n - 1; k >= 0; k -= 1) {
    for (let j = k + 1; j < n; j += 1) b[k] -= A[k][j] * b[j];
    b[k] /= A[k][k];
  }
  return b;
}

/** A·A over the square of its largest number, in `found`, and this number. A and `found` are (n, n), row by row. */
function squared(n, A, found) {
  let size = 0;
  for (let k = 0; k < n * n; k += 1) size = Math.max(size, Math.abs(A[k]));
  const scale = 1 / size;
  for (let k = 0; k < n * n; k += 1) A[k] *= scale;
  found.fill(0);
  for (let i = 0; i < n; i += 1) {
    for (let k = 0; k < n; k += 1) {
      const a = A[i * n + k];
      if (a) for (let j = 0; j < n; j += 1) found[i * n + j] += a * A[k * n + j];
    }
  }
  return size;
}

const flat = (matrix) => Float64Array.from(matrix.flatMap((row) => [...row]));

/** The logarithm of the largest magnitude of an eigenvalue: of a high power of the matrix by squaring (Gelfand). */
export function logOfRadius(matrix) {
  const n = matrix.length;
  let [A, other, log, share] = [flat(matrix), new Float64Array(n * n), 0, 1];
  for (let k = 0; k < 48; k += 1) {
    const size = squared(n, A, other);
    if (!(size > 0)) return -Infinity;
    log += share * Math.log(size);
    [A, other] = [other, A];
    share /= 2;
  }
  return log;
}

/**
 * The slowest mode at the rest to which a run leads, with its present references and its gains: {decay} in 1/s, and what
 * `mode()` says of it where the file has the model of the controller. null where no rest is found. The rows of the loop are
 * used up.
 */
export function slowestMode(run, rest) {
  for (const [name, value] of Object.entries(rest.gains)) run.loop.set(`power_gains.${name}`, value);
  const map = new Sampled(run);
  const end = map.now();
  const begun = Float64Array.from(map.names, (name) => run.start.rows[run.at[name]]);
  for (const start of [map.turned(begun, -run.info.phase), end]) {
    const found = settled(map, start);
    // Where a limiter acts there may be another state that stays.
    if (!found || !map.isAt(found, rest)) continue;
    if (!run.controller.model) return { decay: -logOfRadius(map.coupledAt(found)) / run.T_s };
    return ofModel(run, map, map.after(found));
  }
  return null;
}

/**
 * The state that stays where it is, near another one; null without one. A derivative serves as long as it brings each step
 * below a part of the one before.
 */
function settled(map, start) {
  let [x, A, used, last] = [start, null, null, 0];
  for (let round = 0; round < ROUNDS && x.every(Number.isFinite); round += 1) {
    const after = map.after(x);
    if (!A) {
      A = map.matrix(x);
      used = coupled(A, x, map.angle).moved;
    }
    const missing = used.map((i) => after[i] - x[i]);
    const some = used.map((i) => Float64Array.from(used, (j) => (i === j ? 1 : 0) - A[i][j]));
    const step = solved(some, missing);
    x = x.slice();
    used.forEach((i, k) => (x[i] += step[k]));
    const far = Math.max(...used.map((i, k) => Math.abs(step[k]) / Math.max(Math.abs(x[i]), 1)));
    if (far < STILL) return x;
    if (!(far < SERVES * last)) A = null;
    last = far;
  }
  return null;
}

/** The same from the full-order model of the file. */
function ofModel(run, map, x) {
  const rows = run.start.rows.slice();
  for (const [name, at] of Object.entries(run.at))
    if (/^(refs|power_gains|grid)\./.test(name)) rows[at] = run.loop.get(name);
  map.names.forEach((name, k) => (rows[run.at[name]] = x[k]));
  const model = new LinearModel(run.engine, run.controller, { rows, grid: run.place.grid, phase: 0 });
  const { n } = model;
  const A = Array.from({ length: n }, (_, i) => model.A.slice(i * n, (i + 1) * n));
  const radius = logOfRadius(A);
  return {
    decay: -radius / run.T_s,
    mode: () => {
      const [re, im] = dominant(A);
      return model.mode(Math.log(Math.hypot(re, im)) / run.T_s, Math.atan2(im, re) / run.T_s, n, 0);
    },
  };
}

/** The eigenvalue of the largest magnitude, of two that are conjugate the upper one. */
function dominant(matrix) {
  const n = matrix.length;
  let [high, other] = [flat(matrix), new Float64Array(n * n)];
  for (let k = 0; k < 40; k += 1) {
    squared(n, high, other);
    [high, other] = [other, high];
  }
  const A = Array.from({ length: n }, (_, i) => high.subarray(i * n, (i + 1) * n));
  const times = (v) => Float64Array.from(matrix, (row) => row.reduce((sum, value, j) => sum + value * v[j], 0));
  const dot = (a, b) => a.reduce((sum, value, k) => sum + value * b[k], 0);
  // In their plane A² v = a A v + b v.
  const v = Float64Array.from(A, (row) => row.reduce((sum, value, j) => sum + value * (1 + 0.1 * j), 0));
  const [w, u] = [times(v), times(times(v))];
  const [vv, vw, ww, vu, wu] = [dot(v, v), dot(v, w), dot(w, w), dot(v, u), dot(w, u)];
  const determinant = ww * vv - vw * vw;
  if (!(determinant > 1e-12 * ww * vv)) return [vw / vv, 0];
  const [a, b] = [(wu * vv - vu * vw) / determinant, (vu * ww - wu * vw) / determinant];
  const inside = 0.25 * a * a + b;
  return inside < 0 ? [0.5 * a, Math.sqrt(-inside)] : [0.5 * a + Math.sign(a) * Math.sqrt(inside), 0];
}
