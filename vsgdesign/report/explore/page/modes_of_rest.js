// The slowest mode of a controller at a rest, from its compiled loop: one sample of it, with the source turned back, is a
// map that stays where it is at a rest. Its derivative is taken by differences, and no equation of the controller is here.

const ROUNDS = 12;
const STEP = 5e-3;
const STILL = 1e-9;
const WEAK = 1e-9;

/** The numbers of the loop that one sample moves, as a map in the frame of the source. */
class Sampled {
  constructor(run) {
    const { loop, info } = run;
    const { rows, state } = info.places[run.controller.loop];
    const counted = (name) => !name.startsWith("source.") && name !== "limited";
    Object.assign(this, { loop, names: rows.slice(0, state).filter(counted) });
    this.at = this.names.map((name) => loop.rows + loop.at[name]);
    // Components on the axes α and β, of which the second follows the first, turn with the source.
    this.pairs = this.names.flatMap((name, k) =>
      /[._]alpha$/.test(name) ? [[k, this.names.indexOf(name.replace(/alpha$/, "beta"))]] : [],
    );
    this.angle = this.names.indexOf("state.theta");
    this.omega_T = run.source.omega * run.T_s;
  }

  turned(x, by) {
    const [cosine, sine] = [Math.cos(by), Math.sin(by)];
    for (const [k, j] of this.pairs) [x[k], x[j]] = [cosine * x[k] - sine * x[j], sine * x[k] + cosine * x[j]];
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

  after(x) {
    const { floats } = this.loop.memory;
    this.at.forEach((at, k) => (floats[at] = x[k]));
    this.loop.set("source.cosine", 1);
    this.loop.set("source.sine", 0);
    this.loop.call(0, 1);
    return this.turned(
      Float64Array.from(this.at, (at) => floats[at]),
      -this.omega_T,
    );
  }

  /** The derivative, row by row, by differences of the fourth order. */
  matrix(x) {
    const n = x.length;
    const found = Array.from({ length: n }, () => new Float64Array(n));
    for (let j = 0; j < n; j += 1) {
      const step = STEP * Math.max(Math.abs(x[j]), 1);
      const at = (by) => this.after(x.map((value, k) => (k === j ? value + by * step : value)));
      const [high, low, higher, lower] = [at(1), at(-1), at(2), at(-2)];
      for (let i = 0; i < n; i += 1) {
        const [near, far] = [this.apart(high, low, i), this.apart(higher, lower, i)];
        found[i][j] = (8 * near - far) / (12 * step);
      }
    }
    return found;
  }

  apart(one, other, i) {
    const found = one[i] - other[i];
    return i === this.angle ? Math.atan2(Math.sin(found), Math.cos(found)) : found;
  }
}

/** The places of what moves the angle and is moved by it, directly or not: all else is no part of the rest. */
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
  return [...after].filter((k) => before.has(k)).sort((a, b) => a - b);
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

function product(A, B) {
  const n = A.length;
  return A.map((row) => {
    const found = new Float64Array(n);
    for (let k = 0; k < n; k += 1) {
      const [a, other] = [row[k], B[k]];
      if (a) for (let j = 0; j < n; j += 1) found[j] += a * other[j];
    }
    return found;
  });
}

/** The logarithm of the largest magnitude of an eigenvalue: of a high power of the matrix by squaring (Gelfand). */
export function logOfRadius(matrix) {
  let [A, log, share] = [matrix, 0, 1];
  for (let k = 0; k < 48; k += 1) {
    const size = Math.max(...A.map((row) => row.reduce((most, value) => Math.max(most, Math.abs(value)), 0)));
    if (!(size > 0)) return -Infinity;
    log += share * Math.log(size);
    A = A.map((row) => row.map((value) => value / size));
    A = product(A, A);
    share /= 2;
  }
  return log;
}

/**
 * The decay in 1/s of the slowest mode at the rest to which a run leads, with its present references and gains; null
 * where no rest is found. The rows of the loop are used up.
 */
export function decayOf(run, gains) {
  for (const [name, value] of Object.entries(gains)) run.loop.set(`power_gains.${name}`, value);
  const map = new Sampled(run);
  const starts = [
    map.now(),
    ...[run.start].map((start) =>
      map.turned(
        Float64Array.from(map.names, (name) => start.rows[run.at[name]]),
        0,
      ),
    ),
  ];
  for (const start of starts) {
    let x = start;
    for (let round = 0; round < ROUNDS && x.every(Number.isFinite); round += 1) {
      const after = map.after(x);
      const A = map.matrix(x);
      const missing = after.map((value, k) => value - x[k]);
      const used = coupled(A, x, map.angle);
      const some = used.map((i) => Float64Array.from(used, (j) => (i === j ? 1 : 0) - A[i][j]));
      const step = solved(
        some,
        used.map((i) => missing[i]),
      );
      x = x.slice();
      used.forEach((i, k) => (x[i] += step[k]));
      const far = Math.max(...used.map((i, k) => Math.abs(step[k]) / Math.max(Math.abs(x[i]), 1)));
      if (far < STILL) {
        const radius = logOfRadius(used.map((i) => Float64Array.from(used, (j) => A[i][j])));
        return -radius / run.T_s;
      }
    }
  }
  return null;
}
