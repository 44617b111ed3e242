// Events that a page without a server simulates by itself, in a worker that is made of a text in the page: a page from the
// file system may not load another file.

/** A number in the words of the package: "{:.2f}" and "{:.3g}". */
const worded = (text, value) =>
  text.replace("{:.2f}", value.toFixed(2)).replace("{:.3g}", String(Number(value.toPrecision(3))));

export class LiveRuns {
  /** runs: {info, words}; bytes(): the promise of what is behind it; code: the text of the worker. */
  constructor(runs, bytes, code) {
    Object.assign(this, { info: runs, bytes, code, waiting: new Map(), asked: 0, ready: null });
  }

  /** What is wrong with an event that is to be simulated here, as the server says it; null: nothing. */
  fault(event) {
    const { events, limits, words } = this.info;
    if (!events.includes(event.kind)) return { field: null, text: words.no_event };
    const asked = { "event.size": [event.size, limits.size[event.kind]] };
    if (event.kind === "sag") asked["event.length_s"] = [event.length_s, limits.length_s];
    for (const [field, [value, limit]] of Object.entries(asked)) {
      if (!limit || (value >= limit[0] && value <= limit[1])) continue;
      const text = [words.labels[field], limit[0], limit[1], limit[2]].reduce(
        (t, part) => t.replace("{}", part),
        words.range,
      );
      return { field, text };
    }
    return null;
  }

  async start() {
    const address = URL.createObjectURL(new Blob([this.code], { type: "text/javascript" }));
    const worker = new Worker(address);
    URL.revokeObjectURL(address);
    worker.onmessage = ({ data }) => {
      const { resolve, reject } = this.waiting.get(data.id);
      this.waiting.delete(data.id);
      if (data.error) reject(new Error(data.error));
      else resolve(data.runs);
    };
    const { words, ...info } = this.info;
    const bytes = await this.bytes();
    await this.post(worker, { info: { ...info, words }, bytes, places: [] });
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

  /**
   * The answer to an event: rows and curves as those of the server. `stored` is the answer of the file on this grid, and
   * `to` the grid of the file to which the event leads.
   */
  async answer(key, event, stored, to) {
    this.ready ||= this.start();
    const worker = await this.ready;
    const given = { ...event, jump: event.size * (Math.PI / 180) };
    const places = this.info.controllers.map((_, k) => k);
    const runs = await this.post(worker, { key, event: given, places });
    const arrays = {};
    const controllers = stored.header.controllers.map((row, k) => {
      const { name, colour } = row;
      const note = to
        ? `${row.note} ${this.info.words.nearest.replace("{}", to.scr).replace("{}", to.x_over_r)}`
        : row.note;
      const none = Object.fromEntries(this.info.figures.map((figure) => [figure, null]));
      const run = runs[k];
      if (!run.curves) return { ...none, name, colour, note, status: "not simulated", why: run.why, verdict: run.why };
      for (const [signal, values] of Object.entries(run.curves)) arrays[`${k}/${signal}`] = values;
      const { peak_pu: peak, first_peak_pu: first, limited_s: limited, diverged } = run;
      const status = diverged ? "diverged" : "not judged";
      return {
        ...none,
        name,
        colour,
        note,
        status,
        why: "",
        verdict: this.verdict(run),
        peak_pu: peak,
        first_peak_pu: first,
        limited_s: limited,
      };
    });
    const bands = stored.header.bands.filter((band) => band.signal === "i_s_pu");
    return { header: { event_s: 0, controllers, bands, words: "" }, arrays };
  }

  verdict({ peak_pu: peak, first_peak_pu: first, limited_s: limited, diverged }) {
    const { words } = this.info;
    if (diverged) return words.diverged;
    const acts = limited < 5e-4 ? "." : worded(words.limited, limited);
    return `${words.no_verdict}${worded(words.peak, Math.max(peak, first || 0))}${acts}`;
  }
}
