// Events that a page without a server simulates by itself, in a worker that is made of a text in the page: a page from the
// file system may not load another file.
import { worded } from "./words.js";

export class LiveRuns {
  /** runs: {info, words}; bytes(): the promise of what is behind it; code: the text of the worker. */
  constructor(runs, bytes, code) {
    Object.assign(this, { info: runs, bytes, code, waiting: new Map(), asked: 0, workers: [] });
  }

  /** What is wrong with an event that is to be simulated here, as the server says it; null: nothing. */
  fault(event, charge) {
    const { events, limits, words, dc } = this.info;
    if (charge !== undefined && !(charge >= 0 && charge <= 1))
      return { field: dc.charge.path, text: dc.words.charge_range };
    if (!events.includes(event.kind)) return { field: null, text: words.no_event };
    const asked = { "event.size": [event.size, limits.size[event.kind]] };
    if (["sag", "ramp"].includes(event.kind)) asked["event.length_s"] = [event.length_s, limits.length_s];
    for (const [field, [value, limit]] of Object.entries(asked)) {
      if (!limit || (value >= limit[0] && value <= limit[1])) continue;
      const text = worded(words.range, words.labels[field], ...limit);
      return { field, text };
    }
    return null;
  }

  /** Limits of the curves, and what is asked of a step: as the server's. */
  bands({ bands, asked }, { kind, signal, size, length_s }) {
    const { after_s, after_step_s } = this.info;
    const to_s = (["sag", "ramp"].includes(kind) ? length_s : 0) + (kind === "step" ? after_step_s : after_s);
    const found = bands.map((band) => ({ ...band, to_s }));
    if (!asked || kind !== "step" || !size || !(signal in asked.start)) return found;
    const final = asked.start[signal] + size;
    const [width, most] = [Math.abs(size) * asked.band, final + size * asked.overshoot];
    const [within, beyond] = asked.labels;
    found.push({ signal, from_s: asked.from_s, to_s, low: final - width, high: final + width, label: within });
    const [low, high] = size > 0 ? [null, most] : [most, null];
    found.push({ signal, from_s: 0, to_s, low, high, label: beyond });
    return found;
  }

  async start() {
    const address = URL.createObjectURL(new Blob([this.code], { type: "text/javascript" }));
    const worker = new Worker(address);
    URL.revokeObjectURL(address);
    worker.onmessage = ({ data }) => {
      const { resolve, reject } = this.waiting.get(data.id);
      this.waiting.delete(data.id);
      if (data.error) reject(new Error(data.error));
      else resolve(data.found);
    };
    await this.post(worker, { kind: "start", info: this.info, bytes: await this.bytes() });
    return worker;
  }

  post(worker, question) {
    this.asked += 1;
    const id = this.asked;
    return new Promise((resolve, reject) => {
      this.waiting.set(id, { resolve, reject });
      worker.postMessage({ ...question, id });
    });
  }

  /** What one of the two workers says: runs and what is linear are computed at the same time. */
  async asks(worker, question) {
    this.workers[worker] ||= this.start();
    return this.post(await this.workers[worker], question);
  }

  /** What the workers say of these places, in their order: they share them, the more to the worker that is named. */
  async shared(worker, places, question) {
    const parts = [0, 1].map((m) => places.filter((_, k) => k % 2 === m));
    const found = await Promise.all(
      parts.map((own, m) => own.length && this.asks((worker + m) % 2, { ...question, places: own })),
    );
    return places.map((_, k) => found[k % 2][k >> 1]);
  }

  /**
   * The answer to an event: rows and curves as those of the server. `controllers` are those of the file, with words for
   * why there is no run, and `to` is the grid of the file to which the event leads.
   */
  async answer(key, event, { controllers: shown, texts, bands }, to) {
    const places = shown.map((_, k) => k);
    const runs = await this.shared(0, places, { kind: "runs", key, event });
    const arrays = {};
    const controllers = shown.map((row, k) => {
      const { name, colour, told } = row;
      const note = to ? `${told} ${worded(this.info.words.nearest, to.scr, to.x_over_r)}`.trim() : told;
      const none = Object.fromEntries(this.info.figures.map((figure) => [figure, null]));
      const run = runs[k];
      if (!run.curves) {
        const why = run.said || texts[run.why - 1] || this.info.words.no_start;
        return { ...none, name, colour, note, status: "not simulated", why, verdict: why };
      }
      for (const [signal, values] of Object.entries(run.curves)) arrays[`${k}/${signal}`] = values;
      return { ...run.row, name, colour, note };
    });
    const reasons = new Set(controllers.map(({ why }) => why));
    const words = runs.some(({ curves }) => curves) || reasons.size > 1 ? "" : [...reasons][0];
    return { header: { event_s: 0, controllers, bands, words }, arrays };
  }

  /** The answer of a case of a report: its figures and its words are those of the report. */
  async caseAnswer(number, { controllers, bands }) {
    const { controller, row } = this.info.cases[number];
    const { name, colour } = controllers.find((one) => one.name === controller);
    const curves = await this.asks(0, { kind: "case", number });
    const arrays = Object.fromEntries(Object.entries(curves).map(([signal, values]) => [`0/${signal}`, values]));
    return { header: { event_s: 0, controllers: [{ ...row, name, colour, note: "" }], bands, words: "" }, arrays };
  }

  /** The state of charge of a state of the page; undefined where it is the study's. */
  chargeOf({ changes }) {
    const own = this.info.dc && this.info.dc.charge;
    const given = own && changes && changes[own.path];
    if (given === null || given === undefined) return undefined;
    return typeof given === "number" ? given : parseFloat(given) * (/%\s*$/.test(given) ? 0.01 : 1);
  }

  /** The text of a study file with another state of charge. */
  atCharge(text, charge) {
    if (charge === undefined) return text;
    const at = text.indexOf(this.info.dc.charge.section);
    return text.slice(0, at) + text.slice(at).replace(/^charge = .*$/m, `charge = ${charge}`);
  }

  /** The study file of an event on a grid: its name, its text, and what it does not say. `grid`: R_g and L_g after it. */
  saved([written, said, P_ref, Q_ref], event, grid) {
    const { info } = this;
    const text = this.atCharge(written, event.charge);
    const { names } = info.words;
    const value = (number) => (Number.isInteger(number) ? number.toFixed(1) : String(number));
    const over = ["sag", "ramp"].includes(event.kind) ? Math.round(event.length_s / info.T_s) : 0;
    const begin_s = info.event_s;
    const near = over && Math.abs(event.length_s / info.T_s - over) < 1e-6;
    const end_s = begin_s + (near ? event.length_s : over * info.T_s);
    const V_pu = info.V_g_rms / info.V_rated_rms;
    const other = info.set_points[event.kind];
    const set = other && (other.start + event.size * other.one) / other.unit;
    const lines = {
      [event.kind]: other && [[begin_s, worded(other.name, event.size), `${other.field} = ${value(set)}`]],
      step: [
        [
          begin_s,
          worded(names.step, event.signal, event.size),
          `${event.signal}_ref = ${value((event.signal === "P" ? P_ref : Q_ref) + event.size * info.S_rated)}`,
        ],
      ],
      sag: [
        [begin_s, worded(names.sag, (1 - event.size) * V_pu), `V_g_pu = ${value((1 - event.size) * V_pu)}`],
        [end_s, worded(names.sag, V_pu), `V_g_pu = ${value(V_pu)}`],
      ],
      ramp: [
        [
          begin_s,
          worded(names.ramp, event.size, end_s - begin_s),
          `f_g = ${value(info.omega / (2 * Math.PI) + event.size)}\nover = ${value(end_s - begin_s)}`,
        ],
      ],
      phase: [[begin_s, worded(names.phase, event.size), `phase_jump = ${value(event.size * (Math.PI / 180))}`]],
      grid: [
        [
          begin_s,
          worded(names.grid, event.to_scr, event.to_x_over_r),
          `grid = { R_g = ${value(grid && grid[0])}, L_g = ${value(grid && grid[1])} }`,
        ],
      ],
    }[event.kind];
    const after = event.kind === "step" ? info.after_step_s : info.after_s;
    const wanted = (info.event_s + over * info.T_s + after) / info.log_interval;
    const duration = Math.max(Math.ceil(wanted - 1e-6), 1) * info.log_interval;
    const head = `duration = ${value(duration)}\nsurvival = ${event.kind !== "step"}\n`;
    const events = lines.map(
      ([t_s, name, change]) => `\n[[events]]\ntime = ${value(t_s)}\nname = "${name}"\n${change}\n`,
    );
    return { name: info.words.file, toml: `${text.trimEnd()}\n${head}${events.join("")}`, words: said };
  }
}
