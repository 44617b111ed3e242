// The state that the page can change, its history (undo and redo), and the link's part after #.

/** Whether the page is a part of another one, kept in its text: it has no address of its own then. */
export const framed = window.location.protocol === "about:";

const copyOf = (value) => JSON.parse(JSON.stringify(value));

const sameJson = (a, b) => JSON.stringify(a) === JSON.stringify(b);

/** The part after #: the top-level keys that differ from the defaults, as JSON. */
export function linkOf(state, defaults) {
  const changed = Object.fromEntries(Object.entries(state).filter(([key, value]) => !sameJson(value, defaults[key])));
  return Object.keys(changed).length ? "#" + encodeURIComponent(JSON.stringify(changed)) : "";
}

/** The state of a link over the defaults; throws with a sentence when the link cannot be read. */
export function stateOfLink(hash, defaults) {
  const text = hash.replace(/^#/, "");
  if (!text) return copyOf(defaults);
  let changed = null;
  try {
    changed = JSON.parse(decodeURIComponent(text));
  } catch {
    changed = null;
  }
  if (!changed || typeof changed !== "object" || Array.isArray(changed)) {
    throw new Error("The part of the link after # cannot be read, so the page shows the study as it is.");
  }
  const unknown = Object.keys(changed).filter((key) => !(key in defaults));
  if (unknown.length) throw new Error(`The link names ${unknown.join(", ")}, which this version does not know.`);
  return { ...copyOf(defaults), ...changed };
}

/**
 * Holds the state. `set` changes it for now (a drag), `commit` makes what is there one step of the history.
 * Listeners are called with the state after each change.
 */
export class Store {
  constructor(defaults, start) {
    this.defaults = copyOf(defaults);
    this.state = copyOf(start);
    // The last state that was answered; what a link asks for is not known to be possible yet.
    this.good = copyOf(defaults);
    this.history = [copyOf(start)];
    this.at = 0;
    this.dragging = false;
    this.listeners = [];
  }

  listen(listener) {
    this.listeners.push(listener);
  }

  tell() {
    for (const listener of this.listeners) listener(this.state);
  }

  set(changes) {
    // A case of a report is as it was: whoever moves something leaves it.
    const moved = "case" in this.state && ["scr", "x_over_r", "hold", "event", "changes"].some((key) => key in changes);
    Object.assign(this.state, moved ? { case: null } : {}, copyOf(changes));
    this.tell();
  }

  commit() {
    if (sameJson(this.state, this.history[this.at])) return;
    this.history.length = this.at + 1;
    this.history.push(copyOf(this.state));
    if (this.history.length > 200) this.history.shift();
    this.at = this.history.length - 1;
    this.writeLink();
    this.tell();
  }

  writeLink() {
    if (framed) return;
    const link = linkOf(this.state, this.defaults);
    window.history.replaceState(null, "", link || window.location.pathname + window.location.search);
  }

  step(by) {
    const to = this.at + by;
    if (to < 0 || to >= this.history.length) return false;
    this.at = to;
    this.state = copyOf(this.history[to]);
    this.writeLink();
    this.tell();
    return true;
  }

  replace(state) {
    this.state = copyOf(state);
    this.commit();
    this.tell();
  }

  get canUndo() {
    return this.at > 0;
  }

  get canRedo() {
    return this.at < this.history.length - 1;
  }

  // A field is a key of the state ("P_pu"), a key of one of its parts ("event.size", "own.k_p"), or a path of the
  // study file, which is kept in state.changes.
  isOwnKey(path) {
    const [head, ...rest] = path.split(".");
    return head in this.defaults && head !== "changes" && (rest.length === 0 || head === "event" || head === "own");
  }

  read(path, fallback) {
    if (!this.isOwnKey(path)) return path in this.state.changes ? this.state.changes[path] : fallback;
    const [head, ...rest] = path.split(".");
    const value = rest.length ? (this.state[head] || {})[rest.join(".")] : this.state[head];
    return value === undefined ? fallback : value;
  }

  write(path, value) {
    if (!this.isOwnKey(path)) {
      const changes = { ...this.state.changes, [path]: value };
      if (value === undefined || value === null) delete changes[path];
      return this.set({ changes });
    }
    const [head, ...rest] = path.split(".");
    return this.set({ [head]: rest.length ? { ...this.state[head], [rest.join(".")]: value } : value });
  }

  /** After a refusal: the present state takes the place of the refused one in the history. */
  forget() {
    this.history[this.at] = copyOf(this.state);
    if (this.at > 0 && sameJson(this.state, this.history[this.at - 1])) this.history.splice(this.at--, 1);
    this.writeLink();
    this.tell();
  }

  /** Put one field back to its value in the last state that was answered. True if that changed anything. */
  takeBack(path) {
    const head = path in this.state ? path : this.isOwnKey(path) ? path.split(".")[0] : "changes";
    if (sameJson(this.state[head], this.good[head])) return false;
    this.state[head] = copyOf(this.good[head]);
    return true;
  }
}
