// The worker of a page without a server: it runs events, and gives curves that can be drawn and the figures of the current.
import { Engine } from "./engine.js";
import { LinearModel } from "./linear.js";
import { Judge } from "./verdict.js";

const BUCKETS = 320;

/** Rows with which all signals can be drawn: of each bucket the first one, and every least and largest value. */
function thinned(signals) {
  const count = signals[0].length;
  const size = Math.max(Math.ceil(count / BUCKETS), 1);
  const kept = new Set([count - 1]);
  for (let begin = 0; begin < count; begin += size) {
    const end = Math.min(begin + size, count);
    kept.add(begin);
    for (const values of signals) {
      let [least, most] = [begin, begin];
      for (let k = begin; k < end; k += 1) {
        if (values[k] < values[least]) least = k;
        if (values[k] > values[most]) most = k;
      }
      kept.add(least);
      kept.add(most);
    }
  }
  return [...kept].sort((a, b) => a - b);
}

function simulated(engine, k, key, event) {
  const { info } = engine;
  const controller = engine.controller(k, key);
  const missing = [key, event.key].filter((one) => one !== undefined && !engine.has(controller, one));
  if (missing.length) return { why: engine.whyNot(controller, missing[0]) };
  const found = engine.run(controller, key, event);
  const curves = curvesOf(info, { ...found, loop: controller.loop, event_s: info.event_s });
  return { curves, row: judge.judged(found.run, found.done) };
}

/** What can be drawn of the samples of a run. */
function curvesOf(info, { rows, width, done, loop, event_s: event }) {
  const curves = signalsOf(info, info.places[loop].logged, rows, width, done);
  const kept = thinned(Object.values(curves));
  const found = { t: Float32Array.from(kept, (j) => j * info.T_s - event) };
  for (const [name, values] of Object.entries(curves)) found[name] = Float32Array.from(kept, (j) => values[j]);
  return found;
}

/** The signals of every sample. */
function signalsOf(info, logged, rows, width, done) {
  const names = [
    "said.P",
    "said.Q",
    "said.omega",
    ...["i_s", "v_c", "i_g"].flatMap((x) => [`x.${x}_alpha`, `x.${x}_beta`]),
  ];
  const [P, Q, omega, i_a, i_b, v_a, v_b, g_a, g_b] = names.map((name) => logged.indexOf(name));
  const found = {};
  for (const name of ["P", "Q", "i_s_pu", "omega_hz", "v_pu"]) found[name] = new Float64Array(done);
  const R_c = info.circuit["circuit.R_c"];
  for (let j = 0, at = 0; j < done; j += 1, at += width) {
    found.P[j] = rows[at + P] / info.S_rated;
    found.Q[j] = rows[at + Q] / info.S_rated;
    found.omega_hz[j] = rows[at + omega] / (2 * Math.PI);
    const [a, b] = [rows[at + i_a], rows[at + i_b]];
    found.i_s_pu[j] = Math.sqrt(a * a + b * b) / info.I_rated_pk;
    // The voltage at the control point.
    const c = rows[at + v_a] + R_c * (a - rows[at + g_a]);
    const d = rows[at + v_b] + R_c * (b - rows[at + g_b]);
    found.v_pu[j] = Math.sqrt(c * c + d * d) / info.V_rated_pk;
  }
  return found;
}

/** 1 where a controller survives an event, or settles after a step, and 0 where it does not; NaN where there is no rest within
 * its limit before and after it. */
function survived(k, key, event) {
  const controller = engine.controller(k, key);
  if ([key, event.key].some((one) => one !== undefined && !engine.has(controller, one))) return NaN;
  const { done, run } = engine.run(controller, key, event);
  return judge.survived(run, done);
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
  const [[mag, phase], [mag_Q, phase_Q]] = ["P", "Q"].map((power) => model.loop(power, omega));
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
  survived: ({ k, keys, event }) => keys.map((key) => survived(k, key, event)),
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
