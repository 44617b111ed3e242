// The page as a file without a server: its answers are in the file, and other events are simulated here.
import { LiveRuns } from "./live.js";
import { readAnswer } from "./transport.js";
import { start } from "./main.js";

const nearestIndex = (values, value) => {
  let best = 0;
  values.forEach((v, i) => {
    if (Math.abs(Math.log(v / value)) < Math.abs(Math.log(values[best] / value))) best = i;
  });
  return best;
};

/** The nearest grid of the lattice of a file without server. */
function snapToLattice(lattice, grid) {
  const [i, j] = [nearestIndex(lattice.scr, grid.scr), nearestIndex(lattice.x_over_r, grid.x_over_r)];
  return { scr: lattice.scr[i], x_over_r: lattice.x_over_r[j], key: `${i},${j}` };
}

/** Deflated bytes (zlib) as they were. */
function inflated(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

const bytesOf = (text) => inflated(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)));

const sameEvent = (a, b) => JSON.stringify(a) === JSON.stringify(b);

/** Answers that are kept in the page itself, deflated and in base 64 (a file without server). */
function fileAsk(kept) {
  const live = kept.runs && new LiveRuns(kept.runs.info, () => bytesOf(kept.runs.data), kept.worker);
  const refused = (text) => ({ status: 422, faults: [{ field: null, text }] });
  const stored = async (name) => {
    const text = kept.answers[name];
    return text && readAnswer(await bytesOf(text));
  };
  const saved = async (place, state) => {
    const { event } = state;
    const fault = live.fault(event);
    if (fault) return { status: 422, faults: [fault] };
    const saves = JSON.parse(new TextDecoder().decode(await bytesOf(kept.runs.saves)));
    if (!saves[place]) return refused(kept.runs.info.words.no_save);
    const to = snapToLattice(kept.info.lattice, { scr: event.to_scr, x_over_r: event.to_x_over_r });
    const grid = kept.runs.info.grids[to.key];
    const shown = event.kind === "grid" ? { ...event, to_scr: to.scr, to_x_over_r: to.x_over_r } : event;
    return { status: 200, answer: live.saved(saves[place], shown, grid) };
  };
  return async (kind, seq, state) => {
    const { lattice, defaults } = kept.info;
    const held = state.hold ? ",h" : "";
    const place = snapToLattice(lattice, state).key + held;
    if (kind === "save") return saved(place, state);
    let answer = await stored(`${kind}:${kind === "map" ? state.figure + held : place}`);
    if (!answer) return refused("This file holds no answer for this choice; `vsgdesign explore` computes it.");
    if (kind === "emt" && !sameEvent(state.event, defaults.event)) {
      if (!live) return refused("This file simulates nothing; `vsgdesign explore` does.");
      const { event } = state;
      const fault = live.fault(event);
      if (fault) return { status: 422, faults: [fault] };
      const to = event.kind === "grid" && snapToLattice(lattice, { scr: event.to_scr, x_over_r: event.to_x_over_r });
      try {
        answer = await live.answer(place, { ...event, key: to ? to.key + held : undefined }, answer, to);
      } catch (error) {
        return refused(`This browser does not simulate here (${error.message}). The file has the event of the study.`);
      }
    }
    answer.header.seq = seq;
    return { status: 200, answer };
  };
}

const kept = window.STATIC;

start({
  info: { ...kept.info, static: true, simulated: kept.runs ? kept.runs.info.events : [] },
  ask: fileAsk(kept),
  snap: (grid) => snapToLattice(kept.info.lattice, grid),
  holds: Object.keys(kept.answers).some((key) => key.endsWith(",h")),
});
