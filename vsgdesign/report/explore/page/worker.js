// The worker of a page without a server: it runs events, and gives curves that can be drawn and the figures of the current.
import { Engine } from "./engine.js";

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

/** Largest current within `first_s` of an event and later, and how long the limiter acts, as the package counts them. */
function loads(info, current, limited, events) {
  const [first, later] = [[], []];
  const most = (begin, end) => {
    let found = null;
    for (let k = begin; k < Math.min(end, current.length); k += 1) found = Math.max(found ?? 0, current[k]);
    return found;
  };
  let at = events[0];
  for (const begin of events) {
    const end = Math.ceil((begin * info.T_s + info.first_s - 0.5 * info.T_s) / info.T_s);
    later.push(most(at, begin));
    first.push(most(begin, end));
    at = Math.max(at, end);
  }
  later.push(most(at, current.length));
  const largest = (values) => values.reduce((a, b) => (b === null ? a : Math.max(a ?? 0, b)), null);
  const acts = limited[limited.length - 1] - limited[events[0]];
  return { first_peak_pu: largest(first), peak_pu: largest(later), limited_s: acts * info.T_s };
}

function simulated(engine, k, key, event) {
  const { info } = engine;
  const controller = engine.controller(k, key);
  const missing = [key, event.key].filter((one) => one !== undefined && !controller.keys.includes(one));
  if (missing.length) return { why: controller.why[missing[0]] || info.words.no_start };
  const { rows, width, done, run } = engine.run(controller, key, event);
  const column = (name) => {
    const at = info.places[controller.loop].logged.indexOf(name);
    return Float64Array.from({ length: done }, (_, j) => rows[j * width + at]);
  };
  const length = (one, other, scale) => one.map((value, j) => Math.hypot(value, other[j]) / scale);
  const current = length(column("x.i_s_alpha"), column("x.i_s_beta"), info.I_rated_pk);
  const curves = {
    P: column("said.P").map((value) => value / info.S_rated),
    Q: column("said.Q").map((value) => value / info.S_rated),
    i_s_pu: current,
    omega_hz: column("said.omega").map((value) => value / (2 * Math.PI)),
    v_pu: length(column("measured.v_alpha"), column("measured.v_beta"), info.V_rated_pk),
  };
  const kept = thinned(Object.values(curves));
  const found = { t: Float32Array.from(kept, (j) => j * info.T_s - info.event_s) };
  for (const [name, values] of Object.entries(curves)) found[name] = Float32Array.from(kept, (j) => values[j]);
  const events = event.kind === "sag" ? [run.event_k, run.event_k + run.over] : [run.event_k];
  return { curves: found, diverged: done < run.samples, ...loads(info, current, column("limited_samples"), events) };
}

let engine = null;
self.onmessage = ({ data }) => {
  try {
    if (data.info) engine = new Engine(data.info, new Uint8Array(data.bytes));
    const runs = data.places.map((k) => simulated(engine, k, data.key, data.event));
    self.postMessage({ id: data.id, runs });
  } catch (error) {
    self.postMessage({ id: data.id, error: String(error) });
  }
};
