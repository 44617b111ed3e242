// Runs of a page without a server. The loops are those of the package, compiled; this file puts numbers into their memory,
// calls them, and does between two calls what the package does there: new references, gains, grids and source.
import { at, readColumns } from "./columns.js";
import { Loop, Memory } from "./loops.js";

const GAINS = ["K_ip", "D_p", "K_iq", "D_q", "K_pq", "K_qp", "k_P", "k_Q"];
const GAIN_ROWS = GAINS.map((name) => `power_gains.${name}`);
const REFERENCES = ["P_ref", "Q_ref", "omega_0", "V_n"];
/** What an update of the gains reads of a run, by its own names. */
const READ = [
  ["omega_i", "state.omega_i"],
  ["P", "state.P_f"],
  ["Q", "state.Q_f"],
  ["V_rms", "state.V"],
  ...REFERENCES.map((name) => [`refs.${name}`, `refs.${name}`]),
  ...GAINS.map((name) => [`before.${name}`, `power_gains.${name}`]),
];
const LIMITED = 1;
/** Events that last. */
const LASTING = ["sag", "ramp"];

/** How many samples of a log come before the dc link leaves its levels. */
function withinLevels(loop, end, [low, high]) {
  const { floats } = loop.memory;
  const seen = (k, name) => floats[loop.inLog(k, loop.output[name])];
  let k = 0;
  while (k < end && seen(k, "dc.lowest") >= low && seen(k, "dc.highest") <= high) k += 1;
  return k;
}

/** One run that is under way. */
class Run {
  constructor(engine, controller, loop, key, event) {
    const { info } = engine;
    Object.assign(this, { engine, info, controller, loop, event, done: null, blocked: null });
    this.T_s = info.T_s;
    this.start = engine.startOf(controller, key, event.charge);
    this.at = engine.placesOf(controller.loop);
    for (const name in this.at) loop.set(name, this.start.rows[this.at[name]]);
    this.event_k = Math.round(info.event_s / this.T_s);
    const length = LASTING.includes(event.kind) ? event.length_s : 0;
    this.over = Math.round(length / this.T_s);
    // An event begins and ends at a sample; its instants are those of the study's file.
    const near = Math.abs(length / this.T_s - this.over) < 1e-6;
    this.end_s = info.event_s + (near ? length : this.over * this.T_s);
    const after = event.kind === "step" ? info.after_step_s : info.after_s;
    const wanted = (info.event_s + this.over * this.T_s + after) / info.log_interval;
    this.samples = Math.round((Math.max(Math.ceil(wanted - 1e-6), 1) * info.log_interval) / this.T_s);
    this.source = { t_s: 0, V: info.V_g_rms, phase: info.phase, omega: info.omega, slope: 0 };
    this.sources = [[0, this.source]];
    this.place = this.start;
    this.gainRows = GAIN_ROWS.map((name) => (name in loop.at ? loop.place(name) : -1));
    this.limited = 0;
    this.state = { ...this.start.state };
    if (controller.gains === "table" || controller.gains === "followed") {
      this.update = engine.loop(controller.update, controller.limits || [], 1);
    }
  }

  /** The samples before which something happens. */
  marks() {
    const { samples, T_s, event, event_k: k, controller } = this;
    const found = new Set([0, samples]);
    const second = Math.max(Math.round(1 / T_s), 1);
    for (let at = 0; at < samples; at += second) found.add(at);
    this.period = Math.round(controller.period_s / T_s);
    if (this.update) for (let at = this.period; at <= samples; at += this.period) found.add(at);
    found.add(k);
    if (LASTING.includes(event.kind)) found.add(k + this.over);
    if (event.kind === "grid" && controller.gains === "listed") {
      const updates = Math.floor((k * T_s) / controller.period_s + 1e-9) + 1;
      this.change = Math.max(Math.ceil((updates * controller.period_s) / T_s - 1e-6), 0);
      found.add(this.change);
    }
    this.phased = new Set(found);
    if (event.kind === "phase") found.add(k - 1);
    if (event.kind === "ramp") {
      // So long the responses to one frequency serve a ramp.
      this.slope = (2 * Math.PI * event.size) / (this.end_s - this.info.event_s);
      const stretch = Math.max(Math.round(this.info.drift / Math.max(Math.abs(this.slope), 1e-12) / T_s / T_s), 1);
      for (let at = k; at < k + this.over; at += stretch) found.add(at);
    }
    return [...found].filter((at) => at >= 0 && at <= samples).sort((a, b) => a - b);
  }

  before(k) {
    const { event, event_k: begin } = this;
    if (k > 0 && this.update && k % this.period === 0) this.follow(k);
    if (k === this.change) this.listed();
    if (k === begin) this.happen();
    if (event.kind === "sag" && k === begin + this.over) this.voltage(this.end_s, this.info.V_g_rms);
    if (event.kind === "phase" && k === begin - 1) this.turn(event.jump);
    if (event.kind === "ramp") this.ramp(k);
    if (this.phased.has(k)) {
      const [cosine, sine] = this.phasorAt(k);
      this.loop.set("source.cosine", cosine);
      this.loop.set("source.sine", sine);
    }
  }

  /** Cosine and sine of the source's phase at a sample: those of the package, until an event moves the source. */
  phasorAt(k) {
    const { marks, phasors } = this.controller;
    const at = this.sources.length > 1 ? -1 : marks.indexOf(k);
    if (at >= 0) return phasors.slice(2 * at, 2 * at + 2);
    return this.engine.directionOf(this.phaseAt(k));
  }

  /** The phase of the source at a sample, as the package computes it. */
  phaseAt(k) {
    const start = k * this.T_s;
    const t_s = start + 1e-6 * this.T_s;
    const [, source] = this.sources.findLast(([at]) => at <= t_s);
    if (source.slope || source.omega !== this.info.omega) return this.moved(start, source).phase;
    return source.phase + this.info.omega * (t_s - source.t_s) + this.info.omega * (start - t_s);
  }

  happen() {
    const { event, info, controller } = this;
    if (event.kind === "step") {
      const name = event.signal === "P" ? "P_ref" : "Q_ref";
      this.loop.set(`refs.${name}`, this.loop.get(`refs.${name}`) + event.size * info.S_rated);
    } else if (event.kind in info.set_points) {
      const { row, start, one } = info.set_points[event.kind];
      this.loop.set(row, start + event.size * one);
    } else if (event.kind === "sag") {
      this.voltage(info.event_s, (1 - event.size) * info.V_g_rms);
    } else if (event.kind === "phase") {
      const now = this.moved(info.event_s);
      this.take({ ...now, phase: now.phase + event.jump });
      this.loop.set("row.turn_cos", this.start.rows[this.at["row.turn_cos"]]);
      this.loop.set("row.turn_sin", this.start.rows[this.at["row.turn_sin"]]);
    } else if (event.kind === "grid") {
      this.place = this.engine.startOf(controller, event.key);
      for (const [name, at] of Object.entries(this.at)) {
        if (/^(row|edge)\./.test(name)) this.loop.set(name, this.place.rows[at]);
      }
    }
  }

  /** The source described from an instant on. */
  moved(t_s, from = this.source) {
    const { omega, slope } = from;
    const dt = t_s - from.t_s;
    return { ...from, t_s, omega: omega + slope * dt, phase: from.phase + omega * dt + 0.5 * slope * dt * dt };
  }

  take(source) {
    this.source = source;
    this.sources.push([source.t_s, source]);
  }

  voltage(t_s, V_rms) {
    this.take({ ...this.moved(t_s), V: V_rms });
    const V = V_rms * this.info.peak_per_rms;
    ["re1", "re2", "re3", "im1", "im2", "im3"].forEach((name, j) => {
      this.loop.set(`row.${name}`, V * this.place.source[j]);
    });
    this.loop.set("V_g", V);
  }

  /** A ramp of the frequency: from a sample on, the responses to the frequency at it, and how it goes on. */
  ramp(k) {
    const { event_k: begin, loop, info } = this;
    if (k === begin) this.take({ ...this.moved(info.event_s), slope: this.slope });
    if (k === begin + this.over) {
      this.take({ ...this.moved(this.end_s), omega: info.omega + 2 * Math.PI * this.event.size, slope: 0 });
    }
    const now = this.moved(k * this.T_s);
    const given = { ...info.circuit, h: this.T_s, omega: now.omega };
    [given["circuit.R_g"], given["circuit.L_g"]] = this.start.grid;
    for (const [name, at] of Object.entries(this.at)) {
      if (/^row\.p\d\d$/.test(name)) given[name.replace("row.", "transition.")] = this.start.rows[at];
    }
    const said = this.engine.response.answer(given);
    ["of_constant", "of_slope", "of_square"].forEach((of, m) => {
      ["i_s", "v_c", "i_g"].forEach((state, j) => {
        for (const part of ["re", "im"]) loop.set(`ramp_of.${part}${m}${j + 1}`, said(`${of}.${state}.${part}`));
      });
    });
    loop.set("ramp_of.V_slope", 0);
    loop.set("ramp_of.omega_slope", now.slope);
    loop.set("ramp.V_pk", now.V * info.peak_per_rms);
    loop.set("ramp.drift", 0);
    loop.set("row.turn_cos", said("turn.re"));
    loop.set("row.turn_sin", said("turn.im"));
  }

  /** A jump of the phase is part of the turn of the interval before. */
  turn(jump) {
    const [cosine, sine] = this.engine.directionOf(this.info.omega * this.T_s + jump);
    this.loop.set("row.turn_cos", cosine);
    this.loop.set("row.turn_sin", sine);
  }

  /** Ends the run where the voltage of its dc link has left its levels before a sample: the bridge blocks. */
  block(end) {
    const { loop, info } = this;
    const [low, high] = info.dc.levels;
    const under = loop.get("dc.lowest") < low;
    if (!under && !(loop.get("dc.highest") > high)) return;
    this.done = withinLevels(loop, end, info.dc.levels);
    this.blocked = { t_s: this.done * this.T_s, why: info.dc.blocked[under ? 0 : 1] };
  }

  gains() {
    const found = {};
    GAINS.forEach((name, k) => (found[name] = this.loop.get(GAIN_ROWS[k])));
    return found;
  }

  inForce(prefix) {
    return Object.fromEntries(REFERENCES.map((name) => [`${prefix}${name}`, this.loop.get(`refs.${name}`) ?? 0]));
  }

  /** New gains, in the order of GAINS, where they are others. */
  put(gains, omega) {
    const { gainRows } = this;
    const { floats } = this.loop.memory;
    if (gainRows.every((at, k) => at < 0 || gains[k] === floats[at])) return;
    this.loop.set("state.omega_i", omega);
    gainRows.forEach((at, k) => at >= 0 && (floats[at] = gains[k]));
  }

  /** Gains of a closed form that are made for the grid alone. */
  listed() {
    const { transfer } = this.engine;
    const gains = GAIN_ROWS.map((name) => this.place.rows[this.at[name]]);
    const given = { omega_i: this.loop.get("state.omega_i"), ...this.inForce("refs.") };
    for (const [name, value] of Object.entries(this.gains())) given[`old.${name}`] = value;
    GAINS.forEach((name, k) => (given[`new.${name}`] = gains[k]));
    this.put(gains, transfer.answer(given)("gain_transfer"));
    this.tellGrid(...this.place.grid);
  }

  /** What the scheduler says at an update, for the grid as it was up to this instant. */
  follow(k) {
    const { loop, controller, update } = this;
    // A change that coincides with the update is seen by the next one.
    const [R_g, L_g] = k > this.event_k ? this.place.grid : this.start.grid;
    const count = loop.get("limited");
    const limited = count - this.limited;
    this.limited = count;
    if (controller.gains === "followed") {
      update.fill(loop, READ, { R_g, L_g });
      update.call(0, 1);
      const gains = update.loggedAs("gains.", GAINS);
      if (!gains.every(Number.isFinite)) return;
      this.put(gains, update.memory.floats[update.log + update.output.next_omega_i]);
      this.tellGrid(R_g, L_g);
      return;
    }
    const [P, Q, V_rms] = ["P_f", "Q_f", "V"].map((name) => loop.get(`state.${name}`));
    const given = { omega_i: loop.get("state.omega_i"), ...this.inForce("refs.") };
    for (const [name, value] of Object.entries(this.state)) given[name] = value;
    const ticks = Math.round((k * this.T_s) / controller.tick) >>> 0;
    const asked = { said: 0, R_g, L_g, has_error: 0, var_R: 0, cov_RL: 0, var_L: 0, P, Q, V_rms, ticks };
    for (const [name, value] of Object.entries(asked)) given[`given.${name}`] = value;
    const said = update.answer({ ...given, told: limited > 0 ? LIMITED : 0 });
    for (const name of controller.state) this.state[name] = said(name.replace("s.", "following."));
    const gains = GAINS.map((name) => this.state[`s.gains.${name}`]);
    this.put(gains, said("next_omega_i"));
    this.tellGrid(said("R_g"), said("L_g"));
  }

  tellGrid(R_g, L_g) {
    this.loop.set("grid.R_g", R_g);
    this.loop.set("grid.L_g", L_g);
  }
}

/** The loops of a page and the starts of its controllers. */
export class Engine {
  /** info: the description; data: the bytes behind it. */
  constructor(info, data) {
    const module = new WebAssembly.Module(data.subarray(0, info.module));
    Object.assign(this, { info, loops: {}, memory: new Memory(new WebAssembly.Instance(module, {}).exports) });
    this.columns = readColumns(data.subarray(info.module), info.columns);
    this.behind = new Float64Array(data.slice(info.behind).buffer);
    this.transfer = this.loop("transfer", [], 1);
    this.response = this.loop("response", [], 1);
    this.direction = this.loop("direction", [], 1);
    if (info.dc) this.linkRest = this.loop("link_rest", [], 1);
    this.directions = new Map();
  }

  /** Cosine and sine of an angle with the bits of a strict run. The runs of an event on many grids ask for the same ones. */
  directionOf(angle) {
    const { directions } = this;
    if (!directions.has(angle)) {
      if (directions.size > 4096) directions.clear();
      const said = this.direction.answer({ angle });
      directions.set(angle, [said("re"), said("im")]);
    }
    return directions.get(angle);
  }

  loop(name, uniform, slots) {
    const known = this.loops[name];
    if (known && known.slots >= slots) return known;
    this.loops[name] = new Loop(this, name, uniform, slots);
    return this.loops[name];
  }

  /** Where the numbers of a start are that become the rows of a loop. */
  placesOf(name) {
    this.known ||= {};
    this.known[name] ||= Object.fromEntries(this.info.places[name].rows.map((row, at) => [row, at]));
    return this.known[name];
  }

  /** A controller by its place; one whose gains are held is another one. A key is the number of a cell, and "…,h" where
   * gains are held. */
  controller(k, key) {
    return (key.endsWith(",h") ? this.info.held : this.info.controllers)[k];
  }

  /** Whether a controller has a start on a grid. */
  has(controller, key) {
    return at(this.columns[controller.there], parseInt(key, 10)) === 1;
  }

  /** The number of the text that says why it has none. */
  whyNot(controller, key) {
    return at(this.columns[controller.why], parseInt(key, 10));
  }

  /** Whether a controller can begin on a grid at a state of charge. */
  begins(controller, key, charge) {
    return this.has(controller, key) && (charge === undefined || this.startOf(controller, key, charge) !== undefined);
  }

  /** The voltage at which the dc link rests while the bridge takes a power; null where its source cannot give it, or the
   * bridge blocks. value(row): the numbers of the link. */
  linkAt(value, p, charge) {
    const given = { p, charge, bleed: value("link.bleed") };
    for (const name of Object.keys(this.linkRest.at))
      if (name.startsWith("c.")) given[name] = value(`link.source.${name.slice(2)}`);
    const said = this.linkRest.answer(given);
    const [v, [low, high]] = [said("v"), this.info.dc.levels];
    return said("possible") && v >= low && v <= high ? v : null;
  }

  /** A start at another state of charge; undefined where there is none. */
  recharged(controller, start, charge) {
    const { row, full } = this.info.dc.charge;
    const at = this.placesOf(controller.loop);
    const { rows } = start;
    const v = this.linkAt((name) => rows[at[name]], rows[at["dc.p"]], charge);
    if (v === null) return undefined;
    rows[at[row]] = charge * full;
    for (const name of ["v", "spare", "lowest", "highest"]) rows[at[`dc.${name}`]] = v;
    return start;
  }

  /** The numbers of a controller at rest on a grid, and at a state of charge that is not the study's; undefined where there
   * are none. */
  startOf(controller, key, charge) {
    if (!this.has(controller, key)) return undefined;
    const cell = parseInt(key, 10);
    const all = Float64Array.from(controller.numbers, (column) => at(this.columns[column], cell));
    const rows = this.info.places[controller.loop].rows.length;
    const names = controller.state || [];
    const start = {
      rows: all.subarray(0, rows),
      source: all.subarray(rows, rows + 6),
      grid: all.subarray(rows + 6, rows + 8),
      state: Object.fromEntries(names.map((name, k) => [name, all[rows + 8 + k]])),
    };
    return charge === undefined ? start : this.recharged(controller, start, charge);
  }

  /** The study file of a cell: the numbers of its lines and of its words among the texts, P_ref and Q_ref; and R_g and L_g
   * of another cell. */
  saveOf(cell, held, to) {
    const { lines, words, refs } = this.info.saves[held ? "held" : "follow"];
    const number = (column) => at(this.columns[column], cell);
    const grid = to === undefined ? [] : this.info.grids.map((column) => at(this.columns[column], to));
    return { lines: lines.map(number), words: number(words), refs: refs.map(number), grid };
  }

  /** Every sample of a case of a report, which was recorded: its rows, and what was put into them before which sample. */
  replay(number) {
    let at = 0;
    const next = (count) => this.behind.subarray(at, (at += count));
    let [one, rows, when, where, what] = [];
    for (const known of this.info.cases.slice(0, number + 1)) {
      one = known;
      rows = next(this.info.places[one.loop].rows.length);
      [when, where, what] = [next(one.puts), next(one.puts), next(one.puts)];
    }
    this.loops[`case ${number}`] ||= new Loop(this, one.loop, one.uniform, one.samples);
    const loop = this.loops[`case ${number}`];
    loop.memory.floats.set(rows, loop.rows);
    const marks = [...new Set([0, ...when, one.samples])].filter((k) => k <= one.samples);
    let put = 0;
    for (let j = 0; j + 1 < marks.length; j += 1) {
      for (; put < one.puts && when[put] <= marks[j]; put += 1) loop.memory.floats[loop.rows + where[put]] = what[put];
      loop.call(marks[j], marks[j + 1]);
    }
    const log = loop.memory.floats.subarray(loop.log, loop.log + one.samples * loop.logged);
    const done = this.info.dc ? withinLevels(loop, one.samples, this.info.dc.levels) : one.samples;
    return { rows: log, width: loop.logged, done, loop: one.loop, event_s: one.event_s };
  }

  /** Every sample of an event: (samples, logged) numbers, row by row, and how many rows are good. */
  run(controller, key, event) {
    const ramp = event.kind === "ramp";
    const [run] = this.begun(ramp ? controller.ramp : controller.loop, controller, [key], event);
    const { loop, done } = run;
    return {
      rows: loop.memory.floats.subarray(loop.log, loop.log + done * loop.logged),
      width: loop.logged,
      done,
      run,
    };
  }

  /** An event on several grids beside each other, as many as the controller's paired loop has lanes. */
  together(controller, keys, event) {
    return this.begun(controller.pair, controller, keys, event);
  }

  /** Runs of a controller in the lanes of a loop, over. */
  begun(name, controller, keys, event) {
    const { info } = this;
    const length = LASTING.includes(event.kind) ? event.length_s : 0;
    const longest = Math.max(info.after_step_s, info.after_s) + info.event_s + length + 2 * info.log_interval;
    const uniform = event.kind === "ramp" ? controller.ramp_uniform : controller.uniform;
    const loop = this.loop(name, uniform, Math.ceil(longest / info.T_s) + 1);
    const runs = keys.map((key, lane) => new Run(this, controller, loop.each[lane], key, event));
    const marks = runs.map((run) => run.marks())[0];
    for (let j = 0; j + 1 < marks.length; j += 1) {
      const [first, following] = [marks[j], marks[j + 1]];
      const going = runs.filter((run) => run.done === null);
      if (!going.length) break;
      for (const run of going) run.before(first);
      loop.call(first, following);
      for (const run of going) {
        if (!Number.isFinite(run.loop.get("state.V"))) run.done = following;
        if (info.dc) run.block(following);
      }
    }
    for (const run of runs) run.done ??= run.samples;
    return runs;
  }
}
