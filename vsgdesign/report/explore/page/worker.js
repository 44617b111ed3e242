// The worker of a page without a server: it runs events, and gives curves that can be drawn and the figures of the current.
import { Engine } from "./engine.js";
import { LinearModel } from "./linear.js";
import { Apart, Judge } from "./verdict.js";
import { worded } from "./words.js";

const BUCKETS = 320;
const SIGNALS = ["P", "Q", "i_s_pu", "omega_hz", "v_pu"];
/** The names of all signals of a page. */
const namesOf = ({ dc }) => [...SIGNALS, ...(dc ? dc.signals.map(({ name }) => name) : [])];

function simulated(engine, k, key, event) {
  const { info } = engine;
  const controller = engine.controller(k, key);
  const missing = [key, event.key].filter((one) => one !== undefined && !engine.has(controller, one));
  if (missing.length) return { why: engine.whyNot(controller, missing[0]) };
  if (!engine.begins(controller, key, event.charge))
    return { said: worded(info.dc.words.no_charge, 100 * event.charge) };
  const found = engine.run(controller, key, event);
  if (event.charge !== undefined && info.dc.clamps && clampedBefore(found.run))
    return { said: worded(info.dc.words.clamped_charge, 100 * event.charge) };
  const curves = curvesOf(info, { ...found, loop: controller.loop, event_s: info.event_s });
  return { curves, row: judge.judged(found.run) };
}

/** Whether a run asks its source for less than its reference before its event: it does not begin at a rest. */
const clampedBefore = ({ loop, event_k: k }) => loop.memory.floats[loop.inLog(k - 1, loop.output["clamp.acted"])] > 0;

/** What can be drawn of the samples of a run: of each bucket the first one, and every least and largest value. */
function curvesOf(info, { rows, width, done, loop, event_s: event }) {
  const size = Math.max(Math.ceil(done / BUCKETS), 1);
  const put = signalsOf(info, info.places[loop].logged, rows, width);
  const names = namesOf(info);
  const block = names.map(() => new Float64Array(size));
  const [kept, drawn] = [[], names.map(() => [])];
  for (let begin = 0; begin < done; begin += size) {
    const count = Math.min(size, done - begin);
    put(begin, count, block);
    const chosen = [0];
    if (begin + count === done) chosen.push(count - 1);
    for (const values of block) {
      let least = 0;
      let most = 0;
      for (let k = 1; k < count; k += 1) {
        if (values[k] < values[least]) least = k;
        if (values[k] > values[most]) most = k;
      }
      chosen.push(least, most);
    }
    chosen.sort((one, other) => one - other);
    chosen.forEach((k, at) => {
      if (at && k === chosen[at - 1]) return;
      kept.push(begin + k);
      block.forEach((values, j) => drawn[j].push(values[k]));
    });
  }
  const drawnAs = [
    (P) => P / info.S_rated,
    (Q) => Q / info.S_rated,
    (square) => Math.sqrt(square) / info.I_rated_pk,
    (omega) => omega / (2 * Math.PI),
    (square) => Math.sqrt(square) / info.V_rated_pk,
    (v) => v,
    (charge) => (100 / info.dc.charge.full) * charge,
  ];
  const found = { t: Float32Array.from(kept, (k) => k * info.T_s - event) };
  names.forEach((name, j) => (found[name] = Float32Array.from(drawn[j], drawnAs[j])));
  return found;
}

/** A function that puts numbers of some samples into arrays, one for each signal, of which the signal grows. */
function signalsOf(info, logged, rows, width) {
  const names = [
    "said.P",
    "said.Q",
    "said.omega",
    ...["i_s", "v_c", "i_g"].flatMap((x) => [`x.${x}_alpha`, `x.${x}_beta`]),
  ];
  const [P, Q, omega, i_a, i_b, v_a, v_b, g_a, g_b] = names.map((name) => logged.indexOf(name));
  const R_c = info.circuit["circuit.R_c"];
  const own = info.dc
    ? ["dc.v", ...(info.dc.charge ? [info.dc.charge.row] : [])].map((name) => logged.indexOf(name))
    : [];
  return (begin, count, [P_now, Q_now, i_sq, omega_now, v_sq, ...of_dc]) => {
    for (let k = 0, at = begin * width; k < count; k += 1, at += width) {
      P_now[k] = rows[at + P];
      Q_now[k] = rows[at + Q];
      omega_now[k] = rows[at + omega];
      const a = rows[at + i_a];
      const b = rows[at + i_b];
      i_sq[k] = a * a + b * b;
      // The voltage at the control point.
      const c = rows[at + v_a] + R_c * (a - rows[at + g_a]);
      const d = rows[at + v_b] + R_c * (b - rows[at + g_b]);
      v_sq[k] = c * c + d * d;
      for (let j = 0; j < own.length; j += 1) of_dc[j][k] = rows[at + own[j]];
    }
  };
}

/** 1 where a controller survives an event, or settles after a step, and 0 where it does not; NaN where there is no rest within
 * its limit before and after it. Two grids are run beside each other. */
function survived(k, keys, event) {
  const found = keys.map(() => NaN);
  const there = keys.flatMap((key, n) => {
    const controller = engine.controller(k, key);
    const there = [key, event.key].every((one) => one === undefined || engine.has(controller, one));
    return there && engine.begins(controller, key, event.charge) ? [n] : [];
  });
  const paired = event.kind !== "ramp";
  for (let at = 0; at < there.length;) {
    const some = there.slice(at, at + (paired ? 2 : 1));
    const controller = engine.controller(k, keys[some[0]]);
    const said = some.length === 2 ? together(controller, [keys[some[0]], keys[some[1]]], event) : null;
    some.forEach((n, lane) => {
      found[n] = said ? said[lane] : judge.survived([engine.run(controller, keys[n], event).run])[0];
    });
    at += some.length;
  }
  return found;
}

/** The same of two grids; null where they have to be judged one by one. */
function together(controller, keys, event) {
  try {
    return judge.survived(engine.together(controller, keys, event));
  } catch (error) {
    if (error instanceof Apart) return null;
    throw error;
  }
}

/** The model of a controller on a grid; null where it has none. */
function modelOf(engine, k, key) {
  const controller = engine.controller(k, key);
  return controller.model && engine.has(controller, key)
    ? new LinearModel(engine, controller, engine.startOf(controller, key))
    : null;
}

/** The open loops of a controller on a grid, and its step; null where it has no model. */
function drawn(engine, k, key, { omega, every, count, signal }) {
  const model = modelOf(engine, k, key);
  if (!model) return null;
  const [[mag, phase], [mag_Q, phase_Q]] = model.loops(["P", "Q"], omega);
  return { mag, phase, mag_Q, phase_Q, step: model.step(`${signal}_ref`, signal, every, count) };
}

/** What takes part in modes of a controller, and what moves them. */
function described(engine, k, key, modes) {
  const model = modelOf(engine, k, key);
  return model ? modes.map(({ re, im }) => model.mode(re, im, 4, 3)) : [];
}

let judge = null;
let engine = null;
const answers = {
  start: ({ info, bytes }) => {
    engine = new Engine(info, new Uint8Array(bytes));
    judge = new Judge(engine);
    return [];
  },
  case: ({ number }) => curvesOf(engine.info, engine.replay(number)),
  runs: ({ places, key, event }) => places.map((k) => simulated(engine, k, key, event)),
  survived: ({ k, keys, event }) => survived(k, keys, event),
  linear: ({ places, key, asked }) => places.map((k) => drawn(engine, k, key, asked)),
  save: ({ cell, held, to }) => engine.saveOf(cell, held, to),
  modes: ({ key, modes }) => modes.map((own, k) => described(engine, k, key, own)),
};
self.onmessage = ({ data }) => {
  try {
    self.postMessage({ id: data.id, found: answers[data.kind](data) });
  } catch (error) {
    self.postMessage({ id: data.id, error: String(error) });
  }
};
