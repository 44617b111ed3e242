// The linear model of a page without a server. Its matrices are those of the package, differentiated and compiled; here is
// only what one does with any matrices: powers for a step, a system of equations for a frequency or a mode.

/** The solution of M x = b for complex numbers, in place: M (n, n) and b (n), each as real and imaginary parts. */
function solved(n, re, im, bre, bim) {
  for (let k = 0; k < n; k += 1) {
    let pivot = k;
    const size = (i) => Math.abs(re[i * n + k]) + Math.abs(im[i * n + k]);
    for (let i = k + 1; i < n; i += 1) if (size(i) > size(pivot)) pivot = i;
    if (pivot !== k) {
      for (let j = k; j < n; j += 1) {
        [re[k * n + j], re[pivot * n + j]] = [re[pivot * n + j], re[k * n + j]];
        [im[k * n + j], im[pivot * n + j]] = [im[pivot * n + j], im[k * n + j]];
      }
      [bre[k], bre[pivot], bim[k], bim[pivot]] = [bre[pivot], bre[k], bim[pivot], bim[k]];
    }
    const [a, b] = [re[k * n + k], im[k * n + k]];
    const scale = a * a + b * b;
    for (let i = k + 1; i < n; i += 1) {
      const [c, d] = [re[i * n + k], im[i * n + k]];
      if (c === 0 && d === 0) continue;
      const [fr, fi] = [(c * a + d * b) / scale, (d * a - c * b) / scale];
      for (let j = k + 1; j < n; j += 1) {
        re[i * n + j] -= fr * re[k * n + j] - fi * im[k * n + j];
        im[i * n + j] -= fr * im[k * n + j] + fi * re[k * n + j];
      }
      bre[i] -= fr * bre[k] - fi * bim[k];
      bim[i] -= fr * bim[k] + fi * bre[k];
    }
  }
  for (let k = n - 1; k >= 0; k -= 1) {
    for (let j = k + 1; j < n; j += 1) {
      bre[k] -= re[k * n + j] * bre[j] - im[k * n + j] * bim[j];
      bim[k] -= re[k * n + j] * bim[j] + im[k * n + j] * bre[j];
    }
    const [a, b] = [re[k * n + k], im[k * n + k]];
    const scale = a * a + b * b;
    [bre[k], bim[k]] = [(bre[k] * a + bim[k] * b) / scale, (bim[k] * a - bre[k] * b) / scale];
  }
  return [bre, bim];
}

/** (z − A) x = b, or with A transposed. */
function resolvent(n, A, [zre, zim], bre, bim, transposed = false) {
  const [re, im] = [new Float64Array(n * n), new Float64Array(n * n)];
  for (let i = 0; i < n; i += 1) {
    for (let j = 0; j < n; j += 1) re[i * n + j] = -(transposed ? A[j * n + i] : A[i * n + j]);
    re[i * n + i] += zre;
    im[i * n + i] = zim;
  }
  return solved(n, re, im, Float64Array.from(bre), Float64Array.from(bim));
}

/** A without what lies below its first subdiagonal, by elimination; every b of `into` and every c
 * of `onto` goes along, so that c·(z − A)⁻¹·b stays. */
function hessenberg(n, A, into, onto) {
  const H = Float64Array.from(A);
  for (let k = 1; k + 1 < n; k += 1) {
    let pivot = k;
    for (let i = k + 1; i < n; i += 1) if (Math.abs(H[i * n + k - 1]) > Math.abs(H[pivot * n + k - 1])) pivot = i;
    if (pivot !== k) {
      for (let j = 0; j < n; j += 1) [H[k * n + j], H[pivot * n + j]] = [H[pivot * n + j], H[k * n + j]];
      for (let j = 0; j < n; j += 1) [H[j * n + k], H[j * n + pivot]] = [H[j * n + pivot], H[j * n + k]];
      for (const x of [...into, ...onto]) [x[k], x[pivot]] = [x[pivot], x[k]];
    }
    const head = H[k * n + k - 1];
    if (!head) continue;
    for (let i = k + 1; i < n; i += 1) {
      const factor = H[i * n + k - 1] / head;
      if (!factor) continue;
      for (let j = 0; j < n; j += 1) H[i * n + j] -= factor * H[k * n + j];
      for (let j = 0; j < n; j += 1) H[j * n + k] += factor * H[j * n + i];
      for (const x of into) x[i] -= factor * x[k];
      for (const x of onto) x[k] += factor * x[i];
    }
  }
  return H;
}

/** c·x of (z − H) x = b for every pair of b and c, as real and imaginary parts; H has nothing below its first subdiagonal. */
function seenThrough(n, H, [zre, zim], pairs, [re, im, bre, bim]) {
  for (let i = 0; i < n; i += 1) {
    for (let j = Math.max(i - 1, 0); j < n; j += 1) {
      re[i * n + j] = (i === j ? zre : 0) - H[i * n + j];
      im[i * n + j] = i === j ? zim : 0;
    }
    pairs.forEach(([b], m) => {
      bre[m * n + i] = b[i];
      bim[m * n + i] = 0;
    });
  }
  const count = pairs.length;
  for (let k = 0; k < n; k += 1) {
    const [own, next] = [k * n, (k + 1) * n];
    if (k + 1 < n && Math.abs(re[next + k]) + Math.abs(im[next + k]) > Math.abs(re[own + k]) + Math.abs(im[own + k])) {
      for (let j = k; j < n; j += 1) {
        let kept = re[own + j];
        re[own + j] = re[next + j];
        re[next + j] = kept;
        kept = im[own + j];
        im[own + j] = im[next + j];
        im[next + j] = kept;
      }
      for (let at = k; at < count * n; at += n) {
        let kept = bre[at];
        bre[at] = bre[at + 1];
        bre[at + 1] = kept;
        kept = bim[at];
        bim[at] = bim[at + 1];
        bim[at + 1] = kept;
      }
    }
    if (k + 1 === n) break;
    const a = re[own + k];
    const b = im[own + k];
    const scale = a * a + b * b;
    const fr = (re[next + k] * a + im[next + k] * b) / scale;
    const fi = (im[next + k] * a - re[next + k] * b) / scale;
    for (let j = k + 1; j < n; j += 1) {
      re[next + j] -= fr * re[own + j] - fi * im[own + j];
      im[next + j] -= fr * im[own + j] + fi * re[own + j];
    }
    for (let at = k; at < count * n; at += n) {
      bre[at + 1] -= fr * bre[at] - fi * bim[at];
      bim[at + 1] -= fr * bim[at] + fi * bre[at];
    }
  }
  return pairs.map(([, c], m) => {
    const at = m * n;
    let [sre, sim] = [0, 0];
    for (let k = n - 1; k >= 0; k -= 1) {
      let [xre, xim] = [bre[at + k], bim[at + k]];
      for (let j = k + 1; j < n; j += 1) {
        xre -= re[k * n + j] * bre[at + j] - im[k * n + j] * bim[at + j];
        xim -= re[k * n + j] * bim[at + j] + im[k * n + j] * bre[at + j];
      }
      const a = re[k * n + k];
      const b = im[k * n + k];
      const scale = a * a + b * b;
      bre[at + k] = (xre * a + xim * b) / scale;
      bim[at + k] = (xim * a - xre * b) / scale;
      sre += c[k] * bre[at + k];
      sim += c[k] * bim[at + k];
    }
    return [sre, sim];
  });
}

function product(n, X, Y) {
  const found = new Float64Array(n * n);
  for (let i = 0; i < n; i += 1)
    for (let k = 0; k < n; k += 1) {
      const x = X[i * n + k];
      if (x) for (let j = 0; j < n; j += 1) found[i * n + j] += x * Y[k * n + j];
    }
  return found;
}

function power(n, X, count) {
  let found = null;
  for (let [square, left] = [X, count]; left > 0; left = Math.floor(left / 2)) {
    if (left % 2) found = found ? product(n, found, square) : square;
    if (left > 1) square = product(n, square, square);
  }
  return found;
}

/** The model of one controller at rest on a grid. */
export class LinearModel {
  constructor(engine, controller, start) {
    const { model } = controller;
    const { rows } = start;
    Object.assign(this, { engine, model, n: model.states.length, T_s: engine.info.T_s });
    this.z = this.inSource(
      model.z.map((at) => rows[at]),
      start.phase ?? engine.info.phase,
    );
    this.p = Float64Array.from(model.p);
    for (const [k, at] of Object.entries(model.of_start)) this.p[k] = rows[at];
    ["R_g", "L_g"].forEach((name, k) => (this.p[model.parameters.indexOf(name)] = start.grid[k]));
    [this.A, this.B, this.C, this.D] = this.matrices(this.z, this.p);
  }

  /** A state in the frame of the source, whose phase is not zero at the start of a run. */
  inSource(z, phase) {
    const { states } = this.model;
    const [cosine, sine] = [Math.cos(phase), Math.sin(phase)];
    for (const name of ["i_s", "v_c", "i_g", "pending"]) {
      const [d, q] = ["d", "q"].map((axis) => states.indexOf(`${name}_${axis}`));
      if (d >= 0) [z[d], z[q]] = [cosine * z[d] + sine * z[q], cosine * z[q] - sine * z[d]];
    }
    z[states.indexOf("delta")] -= phase;
    return z;
  }

  /** What a compiled function says of z and p: its results by the letter of their names, as they come. */
  said(loop, z, p, letters) {
    const { states, parameters } = this.model;
    const given = {};
    states.forEach((name, k) => (given[`z.${name}`] = z[k]));
    parameters.forEach((name, k) => (given[name] = p[k]));
    const one = this.engine.loop(this.model[loop], [], 1);
    one.answer(given);
    const { floats } = one.memory;
    const found = Object.fromEntries([...letters].map((letter) => [letter, []]));
    this.engine.info.places[this.model[loop]].logged.forEach((name, k) => {
      found[name[0]][Number(name.slice(1))] = floats[one.log + k];
    });
    return found;
  }

  /** A, B, C and D, row by row. */
  matrices(z, p) {
    const { n, model } = this;
    const found = this.said("linear", z, p, "ABCD");
    const [inputs, outputs] = [model.inputs.length, model.outputs.length];
    const shapes = { A: [n, n], B: [n, inputs], C: [outputs, n], D: [outputs, inputs] };
    return Object.entries(shapes).map(([letter, [rows, columns]]) => {
      const matrix = new Float64Array(rows * columns);
      for (let i = 0; i < rows; i += 1)
        for (let j = 0; j < columns; j += 1) matrix[i * columns + j] = found[letter][j * rows + i];
      return matrix;
    });
  }

  input(name) {
    const [at, count] = [this.model.inputs.indexOf(name), this.model.inputs.length];
    return Float64Array.from({ length: this.n }, (_, i) => this.B[i * count + at]);
  }

  output(name) {
    const at = this.model.outputs.indexOf(name);
    return this.C.subarray(at * this.n, (at + 1) * this.n);
  }

  /** The response to a unit step at every `every`-th sample. */
  step(input, output, every, count) {
    const { n, model } = this;
    const [b, c] = [this.input(input), this.output(output)];
    const d = this.D[model.outputs.indexOf(output) * model.inputs.length + model.inputs.indexOf(input)];
    const m = n + 1;
    const one = new Float64Array(m * m);
    for (let i = 0; i < n; i += 1) {
      for (let j = 0; j < n; j += 1) one[i * m + j] = this.A[i * n + j];
      one[i * m + n] = b[i];
    }
    one[m * m - 1] = 1;
    const several = power(m, one, every);
    let [x, next] = [new Float64Array(m), new Float64Array(m)];
    x[n] = 1;
    const found = new Float64Array(count);
    for (let k = 0; k < count; k += 1) {
      let y = d;
      for (let i = 0; i < n; i += 1) y += c[i] * x[i];
      found[k] = y;
      for (let i = 0; i < m; i += 1) {
        let sum = 0;
        for (let j = 0; j < m; j += 1) sum += several[i * m + j] * x[j];
        next[i] = sum;
      }
      [x, next] = [next, x];
    }
    return found;
  }

  /** Magnitude in dB and phase in degrees of the open loop of each of these powers, the other one closed. */
  loops(powers, omega) {
    const { n } = this;
    const pairs = powers.map((power_) => [this.input(`${power_}_meas`), Float64Array.from(this.output(power_))]);
    const H = hessenberg(
      n,
      this.A,
      pairs.map(([b]) => b),
      pairs.map(([, c]) => c),
    );
    const room = [n * n, n * n, n * pairs.length, n * pairs.length].map((size) => new Float64Array(size));
    const found = powers.map(() => [[], []]);
    for (const w of omega) {
      const z = [Math.cos(w * this.T_s), Math.sin(w * this.T_s)];
      seenThrough(n, H, z, pairs, room).forEach(([sre, sim], m) => {
        const [magnitude, phase] = found[m];
        const [re, im] = [1 + sre, sim];
        const size = re * re + im * im;
        const [lre, lim] = [re / size - 1, -im / size];
        magnitude.push(20 * Math.log10(Math.hypot(lre, lim)));
        let angle = (Math.atan2(lim, lre) * 180) / Math.PI;
        if (phase.length) angle += 360 * Math.round((phase[phase.length - 1] - angle) / 360);
        phase.push(angle);
      });
    }
    // The same curve is drawn on the same branch everywhere: it begins between −360 and 0 degrees.
    return found.map(([magnitude, phase]) => {
      const turns = 360 * Math.ceil(phase[0] / 360);
      return [magnitude, phase.map((angle) => angle - turns)];
    });
  }

  /** The mode nearest to s = re + j im: what takes part in it and what moves it, as the package says it. */
  mode(re, im, shares, movers) {
    const { n, T_s, model } = this;
    const ones = Float64Array.from({ length: n }, (_, k) => 1 + 0.1 * k);
    const none = new Float64Array(n);
    const size = Math.exp(re * T_s);
    let z = [size * Math.cos(im * T_s), size * Math.sin(im * T_s)];
    let [right, left] = [
      [ones, none],
      [ones, none],
    ];
    const scaled = ([a, b]) => {
      const most = a.reduce((found, value, k) => Math.max(found, Math.hypot(value, b[k])), 0);
      return [a.map((value) => value / most), b.map((value) => value / most)];
    };
    const dot = ([a, b], [c, d]) => {
      let found = [0, 0];
      for (let k = 0; k < n; k += 1)
        found = [found[0] + a[k] * c[k] - b[k] * d[k], found[1] + a[k] * d[k] + b[k] * c[k]];
      return found;
    };
    const over = ([a, b], [c, d]) => [(a * c + b * d) / (c * c + d * d), (b * c - a * d) / (c * c + d * d)];
    const times = (A, [a, b]) =>
      [a, b].map((x) => Float64Array.from(x, (_, i) => x.reduce((s, v, j) => s + A[i * n + j] * v, 0)));
    for (let k = 0; k < 4; k += 1) {
      right = scaled(resolvent(n, this.A, z, ...right));
      left = scaled(resolvent(n, this.A, z, ...left, true));
      if (k > 0) z = over(dot(left, times(this.A, right)), dot(left, right));
      z = [z[0] * (1 + 1e-13), z[1]];
    }
    const weight = dot(left, right);
    const parts = model.states.map((_, k) => {
      const [a, b] = [
        left[0][k] * right[0][k] - left[1][k] * right[1][k],
        left[0][k] * right[1][k] + left[1][k] * right[0][k],
      ];
      return Math.hypot(a, b);
    });
    const sum = parts.reduce((a, b) => a + b, 0);
    const strongest = (rows, count, by) => [...rows].sort((a, b) => by(b) - by(a)).slice(0, count);
    const participation = strongest(
      model.states.map((name, k) => [name, parts[k] / sum]),
      shares,
      (row) => row[1],
    );
    const moved = (movers ? model.ranked : []).map((at) => {
      const relative = over(dot(left, times(this.along(at), right)), weight);
      const [value] = over(relative, [z[0] * T_s, z[1] * T_s]);
      return [model.parameters[at], 0.01 * value, Math.hypot(...over(relative, z))];
    });
    const s = [Math.log(Math.hypot(...z)) / T_s, Math.atan2(z[1], z[0]) / T_s];
    const moved_by = strongest(moved, movers, (row) => row[2]).map(([name, value]) => [name, value]);
    return { re: s[0], im: s[1], participation, moved_by };
  }

  /** p dA/dp of a parameter, whose rest follows it, by differences. */
  along(at) {
    const { n, z, p } = this;
    const h = 1e-5;
    const moved = (sign) => Float64Array.from(p, (value, k) => (k === at ? value * (1 + sign * h) : value));
    const [up, down] = [1, -1].map((sign) => this.said("period", z, moved(sign), "zy").z);
    const of_p = Float64Array.from(up, (value, k) => (value - down[k]) / (2 * h));
    const [dz] = resolvent(n, this.A, [1, 0], of_p, new Float64Array(n));
    const shifted = (sign) =>
      this.matrices(
        z.map((value, k) => value + sign * h * dz[k]),
        moved(sign),
      )[0];
    const [above, below] = [shifted(1), shifted(-1)];
    return above.map((value, k) => (value - below[k]) / (2 * h));
  }
}
