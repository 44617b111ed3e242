// The map of an event that the reader sets: the event is run on a part of the lattice, in both workers, nearest grids first.

const MOST = [24, 16];
const TOGETHER = 2;
// Questions that a worker has at a time: while one is answered, the next one is there.
const AHEAD = 2;
const PAINT_MS = 90;

/** At most so many places of so many, evenly spread. */
const spread = (count, most) => {
  const wanted = Math.min(count, most);
  return Array.from({ length: wanted }, (_, k) => Math.round((k * (count - 1)) / Math.max(wanted - 1, 1)));
};

export class LiveMap {
  constructor(cells, live) {
    Object.assign(this, { cells, live, key: null });
  }

  /** As much of the map as there is: `more` says that the page may ask again. `to`: the key of the grid after the event. */
  async answer(state, event) {
    const base = this.cells.map(state);
    const key = JSON.stringify([event, state.hold, base.header.controller]);
    if (key !== this.key) this.begin(key, state, event, base);
    await Promise.race([this.finished, new Promise((resolve) => setTimeout(resolve, PAINT_MS))]);
    if (key === this.key && this.failed) throw this.failed;
    const { scr, x_over_r, values, limit_use } = this;
    const arrays = { scr, x_over_r, values: values.slice(), limit_use, unstable: values.map(() => 0) };
    return { header: { ...base.header, more: this.left.length > 0 || this.under_way > 0 }, arrays };
  }

  begin(key, state, event, base) {
    const { scr, x_over_r: ratio } = this.cells.lattice;
    const [columns, rows] = [spread(scr.length, MOST[0]), spread(ratio.length, MOST[1])];
    const places = rows.flatMap((j) => columns.map((i) => i + j * scr.length));
    const far = (n) =>
      Math.hypot(
        Math.log(scr[columns[n % columns.length]] / state.scr),
        Math.log(ratio[rows[Math.floor(n / columns.length)]] / state.x_over_r),
      );
    const left = places.map((_, n) => n).sort((a, b) => far(a) - far(b));
    Object.assign(this, { key, left, places, under_way: 0, failed: null });
    this.scr = columns.map((i) => scr[i]);
    this.x_over_r = rows.map((j) => ratio[j]);
    this.values = new Float32Array(places.length).fill(NaN);
    this.limit_use = Float32Array.from(places, (cell) => base.arrays.limit_use[cell]);
    const ask = { k: base.place, event, held: state.hold ? ",h" : "" };
    const pumps = Array.from({ length: 2 * AHEAD }, (_, n) => this.pump(n % 2, key, ask));
    this.finished = Promise.all(pumps).catch((error) => {
      if (key === this.key) Object.assign(this, { failed: error, left: [] });
    });
  }

  /** Has cells run by a worker as long as there are some, and this map is the one that is asked for. */
  async pump(worker, key, { k, event, held }) {
    while (key === this.key && this.left.length) {
      const part = this.left.splice(0, TOGETHER);
      this.under_way += 1;
      const keys = part.map((n) => `${this.places[n]}${held}`);
      const found = await this.live.asks(worker, { kind: "survived", k, keys, event });
      if (key !== this.key) return;
      this.under_way -= 1;
      part.forEach((n, j) => (this.values[n] = found[j]));
    }
  }
}
