// The compiled loops of a page without a server, with their arrays in the module's memory.

/** The module's memory as numbers, with room that is handed out once. */
export class Memory {
  constructor(exports) {
    this.exports = exports;
    this.next = exports.free.value;
  }

  /** The place (in numbers) of so many of them. */
  room(count) {
    const at = this.next;
    this.next += 8 * count;
    const missing = this.next - this.exports.memory.buffer.byteLength;
    if (missing > 0) this.exports.memory.grow(Math.ceil(missing / 65536) + 16);
    return at / 8;
  }

  // A view takes longer to make than a number to read: it is kept until the memory has grown, which leaves it empty.
  get floats() {
    if (!this.floatView?.length) this.floatView = new Float64Array(this.exports.memory.buffer);
    return this.floatView;
  }

  get whole() {
    if (!this.wholeView?.length) this.wholeView = new BigInt64Array(this.exports.memory.buffer);
    return this.wholeView;
  }
}

/** A loop with its arrays in the memory. It moves one run, or several beside each other: `lanes`. */
export class Loop {
  constructor(engine, name, uniform, slots) {
    const { info, memory } = engine;
    const places = info.places[name];
    const { places: onCarrier, bodies } = info.carrier;
    const { lanes } = places;
    Object.assign(this, { memory, run: memory.exports[name], logged: places.logged.length, slots, lanes, lane: 0 });
    this.at = Object.fromEntries(places.rows.map((row, k) => [row, k]));
    this.output = Object.fromEntries(places.logged.map((row, k) => [row, k]));
    this.rows = memory.room(places.rows.length * lanes);
    this.log = memory.room(this.logged * slots * lanes);
    Object.assign(this, { rings: places.rings, count: places.rows.length, next: 0 });
    this.room = { length: 0 };
    this.pointers = Object.fromEntries(info.pointers.map((key, k) => [key, info.integers.length + k]));
    this.whole = Object.fromEntries(info.integers.map((key, k) => [key, k]));
    const [own, nothing] = [memory.room(places.uniform.length), memory.room(4)];
    this.given = memory.room(info.integers.length + info.pointers.length);
    memory.floats.set(uniform, own);
    const [cyclic, cycle] = places.switched
      ? [memory.room(onCarrier.length), memory.room(bodies.length)]
      : [nothing, nothing];
    if (places.switched) memory.floats.set(onCarrier, cyclic);
    const { whole } = memory;
    whole.fill(0n, nothing, nothing + 4);
    if (places.switched) whole.set(bodies.map(BigInt), cycle);
    // One group; rows of a log lie behind each other, one for every sample.
    const period = places.switched ? bodies.length : 1;
    const numbers = { groups: 1, period, log_sample: this.logged * lanes, every: 1 };
    info.integers.forEach((key, k) => (whole[this.given + k] = BigInt(numbers[key] || 0)));
    const arrays = { rows: this.rows, uniform: own, log: this.log, cyclic, cycle };
    info.pointers.forEach((key, k) => {
      whole[this.given + info.integers.length + k] = BigInt(8 * (key in arrays ? arrays[key] : nothing));
    });
    this.each = [this];
    for (let lane = 1; lane < lanes; lane += 1) this.each.push(Object.assign(Object.create(this), { lane }));
  }

  /** Where a number of the rows is, of the run of this lane. */
  place(name) {
    return this.rows + this.at[name] * this.lanes + this.lane;
  }

  /** Where a number of the log is: the column of a sample's row. */
  inLog(k, column) {
    return this.log + (k * this.logged + column) * this.lanes + this.lane;
  }

  /** Moves through samples begin to end − 1. */
  call(begin, end) {
    const { whole } = this.memory;
    whole[this.given] = BigInt(begin);
    whole[this.given + 1] = BigInt(end);
    this.run(8 * this.given);
  }

  /** Sets all rows to zero but for those that are given, and the rings, which have so many samples. */
  clear(length, given) {
    const { room, rings, lanes, lane } = this;
    if (room.length < length) {
      const [ring, ringLength] = [this.memory.room(length * rings * lanes), this.memory.room(1)];
      Object.assign(room, { length, ring, ringLength });
    }
    const { floats, whole } = this.memory;
    for (let k = 0; k < length * rings; k += 1) floats[room.ring + k * lanes + lane] = 0;
    for (let k = 0; k < this.count; k += 1) floats[this.rows + k * lanes + lane] = 0;
    whole[room.ringLength] = BigInt(length);
    whole[this.given + this.whole.ring_size] = BigInt(length);
    whole[this.given + this.pointers.rings] = BigInt(8 * room.ring);
    whole[this.given + this.pointers.ring_length] = BigInt(8 * room.ringLength);
    this.next = 0;
    for (const name in given) this.set(name, given[name]);
  }

  /** The log of another loop is read from this sample on. */
  begin(k) {
    this.next = k;
  }

  /** Reads the log of another loop up to a sample, which is not read any more. */
  read(source, end) {
    if (end <= this.next) return;
    const { whole } = this.memory;
    const row = source.logged * source.lanes;
    whole[this.given + this.whole.fed_sample] = BigInt(row);
    whole[this.given + this.pointers.fed] = BigInt(8 * (source.log + this.next * row));
    this.call(this.next, end);
    this.next = end;
  }

  /** Does something without a log, so that what is there stays. */
  unlogged(act) {
    const at = this.given + this.whole.every;
    this.memory.whole[at] = 0n;
    try {
      return act();
    } finally {
      this.memory.whole[at] = 1n;
    }
  }

  get(name) {
    return this.memory.floats[this.place(name)];
  }

  set(name, value) {
    if (name in this.at) this.memory.floats[this.place(name)] = value;
  }

  /** Rows from those of another loop by pairs of names, whose places are found once; one that it does not have is zero. */
  fill(from, pairs, more) {
    this.plans ||= new Map();
    if (!this.plans.has(from)) {
      const known = pairs.filter(([name]) => name in this.at);
      const places = known.map(([name, of]) => [this.place(name), of in from.at ? from.place(of) : -1]);
      this.plans.set(from, places);
    }
    const { floats } = this.memory;
    for (const [to, of] of this.plans.get(from)) floats[to] = of < 0 ? 0 : floats[of];
    for (const name in more) this.set(name, more[name]);
  }

  /** What the last sample gave by these names, which have a prefix in the log: numbers in their order. */
  loggedAs(prefix, names) {
    this.places ||= {};
    this.places[prefix] ||= names.map((name) => this.inLog(0, this.output[`${prefix}${name}`]));
    const { floats } = this.memory;
    return this.places[prefix].map((at) => floats[at]);
  }

  /** What one sample gives for these values. */
  answer(values) {
    for (const name in values) this.set(name, values[name]);
    this.call(0, 1);
    const { floats } = this.memory;
    return (name) => floats[this.log + this.output[name]];
  }
}
