// Verdicts on the runs of a page without a server. Every figure comes out of the package's own functions, compiled: loops over
// the log of a run, the rest after the event, and what turns both into figures (report.explore.page_verdicts).
import { slowestMode } from "./modes_of_rest.js";
import { Rests } from "./rests.js";
import { modeInWords, quantity, verdictOf, worded } from "./words.js";

/** Rows between two that are looked at for numbers beyond every bound. */
const APART = 64;

/** The first sample at or behind an instant, as the package finds it. */
function firstAt(t_s, T_s, behind = (one) => one >= t_s) {
  let k = Math.max(Math.floor(t_s / T_s) - 2, 0);
  while (!behind(k * T_s)) k += 1;
  return k;
}

/** What judges say who read the runs in the lanes of one loop: they ask for the same samples in turn. */
function read(judges) {
  let asked = judges.map((judge) => judge.next());
  while (asked.some(({ done }) => !done)) {
    const open = asked.filter(({ done }) => !done).map(({ value }) => value);
    const [{ loop, run, end }] = open;
    if (open.some((one) => one.loop.next !== loop.next || one.end !== end)) throw new Apart();
    loop.read(run.loop, end);
    for (const one of open) one.loop.begin(Math.max(end, one.loop.next));
    asked = asked.map((one, k) => (one.done ? one : judges[k].next()));
  }
  return asked.map(({ value }) => value);
}

/** Runs in the lanes of one loop that have to be judged one by one: one of them ends earlier. */
export class Apart extends Error {}

export class Judge {
  constructor(engine) {
    Object.assign(this, { engine, about: engine.info.judge });
    this.rests = new Rests(engine);
    for (const name of ["entered_s", "needs", "swung", "place"]) this[name] = engine.loop(name, [], 1);
  }

  /** The figures of a run, its status and its verdict. */
  judged(run) {
    run.good = this.goodRows(run);
    const own = run.controller.judge;
    const found = Object.fromEntries(this.engine.info.figures.map((name) => [name, null]));
    if (this.clamped(run)) Object.assign(found, { status: "not known", why: this.engine.info.dc.words.clamps });
    else Object.assign(found, read([run.event.kind === "step" ? this.step(run) : this.disturbance(run)])[0]);
    if (run.blocked) {
      const { t_s, why } = run.blocked;
      const said = `${worded(this.engine.info.dc.blocks_at, t_s)}: ${why}`;
      Object.assign(found, { status: this.about.words.blocked, why: said });
    }
    if (found.limited_s === null) Object.assign(found, read([this.loads(run, [run.event_k])])[0]);
    const verdict = verdictOf(found, this.about.words, own.rules, run.event, this.engine.info.event_s);
    const { at_end: _, unstable: __, before: ___, within_s: ____, ...row } = found;
    return { why: "", ...row, verdict };
  }

  /** 1 or 0, or NaN where nothing can be survived, of runs in the lanes of a loop: as the map of the package has it. */
  survived(runs) {
    for (const run of runs) Object.assign(run, { good: this.goodRows(run), brief: true });
    return read(runs.map((run) => this.survives(run)));
  }

  /** Whether a run has asked its source for less than its reference: it has another rest then. */
  clamped(run) {
    return Boolean(this.engine.info.dc?.clamps) && run.good > 0 && this.logged(run, run.good - 1, "clamp.acted") > 0;
  }

  *survives(run) {
    const { words, statuses } = this.about;
    if (run.blocked) return 0;
    if (this.clamped(run)) return NaN;
    if (run.event.kind === "step") {
      if (!this.restWithin(run)) return NaN;
      // What is settled at the end counts on the map, whether or not the run was long enough to say so.
      const { settling_s, within_s } = yield* this.step(run);
      return Number(Number.isFinite(settling_s ?? within_s));
    }
    const { status } = yield* this.disturbance(run);
    if (["not known", statuses[7], statuses[8]].includes(status)) return NaN;
    return Number(status === words.survived);
  }

  /** How many rows come before the first that is no number or beyond every sensible bound. */
  goodRows({ loop, done }) {
    const { floats } = loop.memory;
    const { lanes } = loop;
    const { bounds } = this.about;
    const bad = (k) => {
      const at = loop.inLog(k, 0);
      for (let j = 0; j < bounds.length; j += 1) if (!(Math.abs(floats[at + j * lanes]) <= bounds[j])) return true;
      return false;
    };
    // What has left the bounds goes on to grow: one row of many is enough to see it.
    for (let k = APART - 1; k < done + APART - 1; k += APART) {
      if (!bad(Math.min(k, done - 1))) continue;
      for (let j = k - APART + 1; j < done; j += 1) if (bad(j)) return j;
    }
    return done;
  }

  /** A number of a row of the log. */
  logged(run, k, name) {
    return run.loop.memory.floats[run.loop.inLog(k, run.loop.output[name])];
  }

  diverged(run) {
    return run.good < run.samples;
  }

  /** A loop over the log of the run, in its lane: its rows are zero but for those that are given. */
  over(name, run, length, given) {
    const { lane, lanes } = run.loop;
    const loop = this.engine.loop(lanes > 1 ? `${name}_pair` : name, [], 0).each[lane];
    loop.clear(length, given);
    return loop;
  }

  // ---- disturbances ----------------------------------------------------------------------------------------------

  /** Largest current within 5 ms of an event and later, and how long the limiter acts. */
  *loads(run, events) {
    const loop = this.over("seen_disturbance", run, 1, { "load_of.after": 1 });
    yield* this.eachPart(run, events, loop);
    return this.loadsOf(run, loop, "seen", events[0]);
  }

  loadsOf(run, loop, watch, first) {
    const { I_rated_pk, T_s } = this.engine.info;
    const counted = this.logged(run, run.good - 1, "limited_samples") - this.logged(run, first, "limited_samples");
    return {
      first_peak_pu: Math.sqrt(loop.get(`${watch}.load.first_sq`)) / I_rated_pk,
      peak_pu: Math.sqrt(loop.get(`${watch}.load.later_sq`)) / I_rated_pk,
      limited_s: Math.max(counted, 0) * T_s,
    };
  }

  /** Reads the log from each event to the next; `begun` and `ended` are called with the number of the event. */
  *eachPart(run, events, loop, { marks = {}, begun, ended } = {}) {
    const { good } = run;
    const { T_s } = this.engine.info;
    const until = function* until(end) {
      const stop = Math.min(end, good);
      for (const [k, act] of Object.entries(marks)) {
        if (Number(k) < loop.next || Number(k) >= stop) continue;
        yield { loop, run, end: Number(k) };
        act();
      }
      yield { loop, run, end: stop };
    };
    loop.begin(events[0]);
    for (let n = 0; n < events.length; n += 1) {
      const event = events[n];
      const next = n + 1 < events.length ? events[n + 1] : good;
      const early = Math.ceil((event * T_s + this.about.first_s - 0.5 * T_s) / T_s);
      yield* until(event);
      loop.set("load_of.first", 1);
      if (begun) {
        yield* until(event + 1);
        begun(n);
      }
      yield* until(Math.min(early, next));
      loop.set("load_of.first", 0);
      yield* until(next);
      if (ended) ended(n);
    }
  }

  *disturbance(run) {
    const { info } = this.engine;
    const { T_s } = info;
    const own = run.controller.judge;
    const start = { omega: info.omega, V: info.V_g_rms };
    const before = this.rests.of(run, run.start, start, this.rests.refsOf(run, run.start.rows));
    const same = ["sag", "phase"].includes(run.event.kind);
    const after = same ? before : this.rests.of(run, run.place, run.source, this.rests.refsOf(run));
    const { statuses } = this.about;
    for (const rest of [before, after]) {
      const over = rest && own.limit_pu !== null && rest.i_s_pu > this.about.rest_share * own.limit_pu;
      if (rest && !over) continue;
      return { status: statuses[rest ? 8 : 7], before: rest === before, why: "" };
    }
    const diverged = this.diverged(run);
    if (diverged && run.brief) return { status: this.about.words.diverged };
    const events = run.event.kind === "sag" ? [run.event_k, run.event_k + run.over] : [run.event_k];
    const cleared_s = ["sag", "ramp"].includes(run.event.kind) ? run.end_s : info.event_s;
    const cycle = Math.max(Math.round((2 * Math.PI) / run.source.omega / T_s), 1);
    const [P_rest, Q_rest] = own.own_rest ? yield* this.ownRest(run, after, cycle) : [after.P, after.Q];
    const of = {
      P_rest,
      Q_rest,
      per_S: 1 / info.S_rated,
      band: this.about.band,
      per_cycle: 1 / cycle,
    };
    const given = Object.fromEntries(Object.entries(of).map(([name, value]) => [`of.${name}`, value]));
    const loop = this.over("seen_disturbance", run, cycle, given);
    yield { loop, run, end: events[0] };
    const anew = () => {
      loop.set("seen.entry.last_out", -1);
      loop.set("seen.entry.was_out", 0);
    };
    anew();
    loop.set("load_of.after", 1);
    const parts = events.map(() => ({}));
    const begin = () => {
      loop.set("seen.least", Infinity);
      loop.set("seen.most", -Infinity);
    };
    begin();
    yield* this.eachPart(run, events, loop, {
      marks: { [firstAt(cleared_s, T_s)]: anew },
      begun: (n) => (parts[n].first = loop.get("seen.delta")),
      ended: (n) => {
        Object.assign(parts[n], { least: loop.get("seen.least"), most: loop.get("seen.most") });
        begin();
      },
    });
    const last = loop.get("seen.delta");
    let [swing, slipped] = [0, false];
    parts.forEach((part, n) => {
      if (part.first === undefined) return;
      const final = n + 1 === parts.length && !diverged ? 1 : 0;
      const said = this.swung.answer({ ...part, last, rest: after.delta, final });
      [swing, slipped] = [Math.max(swing, said("far")), slipped || said("slipped") > 0.5];
    });
    const entry = {};
    for (const name of ["last_out", "error_out", "error_in", "was_out"])
      entry[`entry.${name}`] = loop.get(`seen.entry.${name}`);
    const time = this.entered_s.answer({ ...entry, band: this.about.band, T_s, since_s: cleared_s })("entered_s");
    const recovery_s = diverged ? Infinity : time;
    const end_s = (run.good - 1) * T_s;
    const late = firstAt(end_s - this.about.end_s, T_s, (one) => one > end_s - this.about.end_s);
    const acts = this.logged(run, run.good - 1, "limited_samples") - this.logged(run, late - 1, "limited_samples");
    const place = this.place.answer({
      diverged: diverged ? 1 : 0,
      slipped: slipped ? 1 : 0,
      too_short: end_s + 0.5 * T_s < cleared_s + own.needed_s - T_s ? 1 : 0,
      recovery_s,
      deadline_s: own.deadline_s,
      limited_at_end: acts / (run.good - late),
    })("place_of_verdict");
    const found = statuses[place];
    // A map leaves the protection out, as the package's does.
    const guarded = found === this.about.words.survived && !run.brief;
    const trip = guarded ? yield* this.trip(run) : null;
    return {
      status: trip === null ? found : this.about.words.tripped,
      why: trip || "",
      recovery_s: Number.isFinite(recovery_s) ? recovery_s : null,
      swing_deg: swing * (180 / Math.PI),
      ...this.loadsOf(run, loop, "seen", events[0]),
    };
  }

  /** Why the protection of the study trips first after the event; null where it does not. */
  *trip(run) {
    const trips = [];
    for (const { loop: name, ago, whole, of, said } of run.controller.judge.guards) {
      const loop = this.over(name, run, ago, { ...this.engine.info.circuit, ...of });
      yield { loop, run, end: Math.min(whole ? Math.max(run.event_k, ago) : run.event_k, run.good) };
      loop.set("guard_of.on", 1);
      yield { loop, run, end: run.good };
      for (const [at, why] of Object.entries(said)) {
        const k = loop.get(`guard.${at}`) - 1;
        if (k >= 0) trips.push([k, worded(why, loop.get("guard.rate"))]);
      }
    }
    const [first] = trips.sort((one, other) => one[0] - other[0] || (one[1] < other[1] ? -1 : 1));
    return first ? worded(this.about.words.trips_at, first[0] * this.engine.info.T_s, first[1]) : null;
  }

  /** The powers at which a switched bridge itself rests after an event, as its last cycles say. */
  *ownRest(run, rest, cycle) {
    const { cycles } = run.controller.judge.own_rest;
    if (this.diverged(run) || run.good < 2 * cycles * cycle) return [rest.P, rest.Q];
    const loop = this.over("seen_rest", run, cycle, { per_cycle: 1 / cycle });
    const count = (cycles - 1) * cycle;
    yield { loop, run, end: run.good - count };
    for (const name of ["rest.late_P", "rest.late_Q"]) loop.set(name, 0);
    yield { loop, run, end: run.good };
    const [P, Q] = ["P", "Q"].map((name) => loop.get(`rest.late_${name}`) / count);
    const said = this.engine
      .loop("own_powers", [], 1)
      .answer({ P, Q, P_rest: rest.P, Q_rest: rest.Q, S_rated: this.engine.info.S_rated });
    return [said("P_own"), said("Q_own")];
  }

  /** Does something with a run whose loop has it alone, with an averaged bridge, and keeps its log: rows are used up, but
   * not those of others. */
  alone(run, act) {
    const { loop, controller } = run;
    if (loop.lanes === 1 && controller.averaged === controller.loop) return loop.unlogged(act);
    run.loop = this.engine.loop(controller.averaged, controller.averaged_uniform, 1);
    for (const name in run.loop.at) run.loop.set(name, loop.get(name));
    try {
      return run.loop.unlogged(act);
    } finally {
      run.loop = loop;
    }
  }

  // ---- steps -----------------------------------------------------------------------------------------------------

  /** The last second of a run in four parts: their first samples, and the end. */
  parts({ good }) {
    const { ending } = this.about;
    const { T_s } = this.engine.info;
    const end_s = (good - 1) * T_s;
    const begin = firstAt(end_s - ending.length_s, T_s);
    const [size, more] = [Math.floor((good - begin) / ending.parts), (good - begin) % ending.parts];
    return Array.from({ length: ending.parts + 1 }, (_, n) => begin + n * size + Math.min(n, more));
  }

  /** What a run at whose end limits act is said to do; null where none acts, or where it is on its way to a rest. */
  atLimit(sums, parts, rest) {
    const { ending, words } = this.about;
    const { S_rated } = this.engine.info;
    const total = (name) => sums.reduce((sum, one) => sum + one[name], 0) / (parts[parts.length - 1] - parts[0]);
    const acts = ["current", "bridge", "voltage"].map((name) => total(name) >= ending.acts);
    if (!acts.includes(true)) return null;
    const [P, Q] = [total("P"), total("Q")];
    const spreads = ["P", "Q"].map((name) => {
      const means = sums.map((one, n) => one[name] / (parts[n + 1] - parts[n]));
      return Math.max(...means) - Math.min(...means);
    });
    const spread = Math.max(...spreads) / S_rated;
    const rests = spread <= ending.moves;
    const far = rest && Math.max(Math.abs(P - rest.P_pcc), Math.abs(Q - rest.Q_pcc)) > ending.moves * S_rated;
    if (rest && !(rests && far && acts[0])) return null;
    const where = ending.limits.filter((_, n) => acts[n]).join(" and ");
    const at_end = rests
      ? worded(words.rests_at, where, quantity(P, "W"), quantity(Q, "var"))
      : worded(words.moves_at, where, 100 * spread);
    return { status: rests ? "limited" : "not settled", at_end };
  }

  /** The rest of a run after a step, null where there is none within the current limit. */
  restWithin(run) {
    const found = this.rests.of(run, run.place, run.source, this.rests.refsOf(run));
    const { limit_pu: limit } = run.controller.judge;
    return found && limit !== null && found.i_s_pu > limit ? null : found;
  }

  *step(run) {
    const { info } = this.engine;
    const { T_s, S_rated } = info;
    const { words, band } = this.about;
    const own = run.controller.judge;
    if (this.diverged(run)) return { status: words.diverged };
    const rest = this.restWithin(run);
    const slowest = rest && this.alone(run, () => slowestMode(run, rest));
    if (rest && !slowest) return { status: "not known", why: words.no_mode };
    const decay = slowest && slowest.decay;
    if (rest && !(decay > 1e-6)) {
      const said = { ...words.mode, ...run.controller.model };
      const mode = slowest.mode && modeInWords(slowest.mode(), said);
      return {
        status: words.unstable_status,
        unstable: mode ? `${words.unstable_status}: ${mode}` : words.unstable_status,
      };
    }
    const [signal, cycle] = [run.event.signal === "Q" ? "Q" : "P", this.about.per_mean];
    const of = { band, per_cycle: 1 / cycle, of_P: signal === "P" ? 1 : 0, of_Q: signal === "Q" ? 1 : 0, final: 1 };
    const given = { ...info.circuit, T_s, event_s: info.event_s, decay: decay || 1, share: own.share };
    [given["circuit.R_g"], given["circuit.L_g"]] = run.place.grid;
    for (const [name, value] of Object.entries(of)) given[`of.${name}`] = value;
    for (const [name, value] of Object.entries(own.limits)) given[`limits.${name}`] = value;
    let own_final = null;
    if (rest && own.own_rest) {
      // A switched bridge rests beside the averaged one, where its last cycles say.
      const { samples } = own.own_rest;
      const late = this.over("seen_step", run, cycle, given);
      yield { loop: late, run, end: run.good - samples };
      late.set("watch.late", 0);
      yield { loop: late, run, end: run.good };
      own_final = late.get("watch.late") / samples;
    }
    const loop = this.over("seen_step", run, cycle, given);
    yield { loop, run, end: run.event_k };
    const before = loop.get("watch.mean");
    const final = own_final ?? (rest ? rest[`${signal}_pcc`] : before + S_rated);
    const isStep = Math.abs(final - before) > 1e-3 * S_rated;
    // Where nothing is stepped, the distance from the rest is a share of the rating.
    const fresh = { "of.initial": isStep ? before : final - S_rated, "of.final": final, "load_of.after": 1 };
    Object.assign(fresh, { "watch.most": -Infinity, "watch.entry.last_out": -1, "watch.entry.was_out": 0 });
    Object.assign(fresh, { "need.worst": 0, "need.needed_s": 0 });
    for (const [name, value] of Object.entries(fresh)) loop.set(name, value);
    const [parts, sums, marks] = [this.parts(run), [], {}];
    const names = ["P", "Q", "current", "bridge", "voltage"];
    const take = () => sums.push(Object.fromEntries(names.map((name) => [name, loop.get(`end.${name}`)])));
    parts.slice(0, -1).forEach((k, n) => {
      marks[k] = () => {
        if (n) take();
        for (const name of names) loop.set(`end.${name}`, 0);
        loop.set("end.limited", this.logged(run, k - 1, "limited_samples"));
      };
    });
    let first = 0;
    yield* this.eachPart(run, [run.event_k], loop, { marks, begun: () => (first = loop.get("need.worst")) });
    take();
    const row = this.loadsOf(run, loop, "watch", run.event_k);
    const limited = this.atLimit(sums, parts, rest);
    if (limited) return { ...row, ...limited };
    if (!rest) return { ...row, status: "no steady state" };
    const needs = (error) => this.needs.answer({ error, decay, share: own.share })("needs_at_first");
    const needed = Math.max(needs(first), loop.get("need.needed_s"));
    const observed = Math.round((run.samples * T_s) / info.log_interval) * info.log_interval - info.event_s;
    const overshoot = isStep ? Math.max(loop.get("watch.most") - 1, 0) : null;
    const entry = { band, T_s, since_s: info.event_s };
    for (const name of ["last_out", "error_out", "error_in", "was_out"]) {
      entry[`entry.${name}`] = loop.get(`watch.entry.${name}`);
    }
    const settling_s = this.entered_s.answer(entry)("entered_s");
    if (needed > observed) {
      if (observed > 2 * needs(loop.get("need.worst")))
        return { ...row, status: "not settled", overshoot, within_s: settling_s };
      return { ...row, status: words.too_short_status, needs_s: needed, within_s: settling_s };
    }
    return { ...row, status: words.settled, overshoot, settling_s };
  }
}
