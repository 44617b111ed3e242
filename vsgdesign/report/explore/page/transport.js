// Questions to the server and its binary answers. Of each kind one question is under way at a time; a newer wish replaces
// the one that waits, and an answer that a newer one has overtaken is dropped. Nothing piles up during a drag.

/** One answer: the length of the header (uint32, little endian), the header as JSON, then float32 arrays. */
export function readAnswer(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const start = 4 + length;
  const arrays = {};
  for (const { name, shape, offset } of header.arrays) {
    const count = shape.reduce((a, b) => a * b, 1);
    const at = start + offset;
    // A view needs an offset that is a multiple of four; a header of another length is copied instead.
    arrays[name] = at % 4 ? new Float32Array(buffer.slice(at, at + 4 * count)) : new Float32Array(buffer, at, count);
    arrays[name].shape = shape;
  }
  return { header, arrays };
}

export class Transport {
  /** ask(kind, seq, state) -> Promise of {status, answer, faults}; the callbacks get what comes back. */
  constructor(ask, { onAnswer, onFaults, onLost }) {
    this.ask = ask;
    this.calls = { onAnswer, onFaults, onLost };
    this.kinds = {};
    this.seq = 0;
  }

  kind(name) {
    this.kinds[name] ||= { busy: false, wish: null, newest: 0, shown: 0, replaced: 0, lost: false };
    return this.kinds[name];
  }

  /** Ask for an answer to this state; `since` is when the user moved something (performance.now()). */
  wish(name, state, since = performance.now()) {
    const kind = this.kind(name);
    kind.newest = ++this.seq;
    const wish = { seq: kind.newest, state: JSON.parse(JSON.stringify(state)), since };
    if (kind.busy) {
      if (kind.wish) kind.replaced += 1;
      kind.wish = wish;
    } else {
      this.send(name, wish);
    }
  }

  /** The kinds whose last question had no answer. */
  get lost() {
    return Object.keys(this.kinds).filter((name) => this.kinds[name].lost);
  }

  async send(name, wish) {
    const kind = this.kind(name);
    kind.busy = true;
    let reply = null;
    try {
      reply = await this.ask(name, wish.seq, wish.state);
    } catch (error) {
      this.calls.onLost(name, error);
    }
    kind.lost = !reply;
    kind.busy = false;
    const next = kind.wish;
    kind.wish = null;
    if (next) this.send(name, next);
    if (!reply) return;
    if (reply.status === 422) {
      if (wish.seq === kind.newest) this.calls.onFaults(name, reply.faults, wish);
    } else if (reply.answer && wish.seq > kind.shown) {
      kind.shown = wish.seq;
      this.calls.onAnswer(name, reply.answer, wish);
    }
  }
}

/** Milliseconds until a server that does not answer is asked again, after so many losses in a row. */
export const waitAfter = (losses) => Math.min(1000 * 2 ** (losses - 1), 16000);

/** Questions to the server beside this page. */
export function serverAsk(tab) {
  return async (kind, seq, state) => {
    const body = JSON.stringify({ tab, seq, state });
    const reply = await fetch(kind, { method: "POST", headers: { "Content-Type": "application/json" }, body });
    if (reply.status === 204) return { status: 204 };
    if (!reply.ok) {
      const json = await reply.json().catch(() => ({}));
      const text = json.error || `The server answered with status ${reply.status}.`;
      return { status: 422, faults: json.faults || [{ field: null, text }] };
    }
    if (kind === "save") return { status: 200, answer: await reply.json() };
    return { status: 200, answer: readAnswer(await reply.arrayBuffer()) };
  };
}

/**
 * The study's description; calls onWait(words) while the server still imports or compiles. Throws when the server says
 * that it will never be ready.
 */
export async function loadInfo(onWait) {
  for (;;) {
    let [info, failed] = [null, false];
    let words = "The server does not answer. Is `vsgdesign explore` still running?";
    try {
      const reply = await fetch("study");
      const json = await reply.json();
      if (reply.ok && json.ready !== false) info = json;
      else words = json.words || json.error || words;
      failed = Boolean(json.failed);
    } catch {
      info = null;
    }
    if (info) return info;
    if (failed) throw new Error(words);
    onWait(words);
    await new Promise((resolve) => setTimeout(resolve, 400));
  }
}
