// The page as a file without a server: its cells are in the file, and events are simulated here.
import { Cells } from "./cells.js";
import { LiveRuns } from "./live.js";
import { LiveMap } from "./live_map.js";
import { start } from "./main.js";

/** Deflated bytes (zlib) in base 64, as they were. */
function bytesOf(text) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

/** What answers the questions of the page. */
function fileAsk(kept, cells) {
  const live = new LiveRuns(kept.runs.info, () => bytesOf(kept.runs.data), kept.worker);
  const refused = (text) => ({ status: 422, faults: [{ field: null, text }] });
  const target = ({ kind, to_scr: scr, to_x_over_r }) =>
    kind === "grid" ? cells.nearest({ scr, x_over_r: to_x_over_r }) : null;
  const save = async (cell, state) => {
    const { event, hold } = state;
    const to = target(event);
    const found = await live.asks(0, { kind: "save", cell, held: Boolean(hold), to: to ? to.cell : undefined });
    const lines = found.lines.map((number) => cells.texts[number - 1]).filter((line) => line !== undefined);
    if (!lines.length) return refused(kept.runs.info.words.no_save);
    const text = lines.map((line) => (line === " " ? "" : line)).join("\n");
    const at = { ...event, charge: live.chargeOf(state) };
    const shown = to ? { ...at, to_scr: to.scr, to_x_over_r: to.x_over_r } : at;
    const words = cells.texts[found.words - 1] || "";
    return { status: 200, answer: live.saved([text, words, ...found.refs], shown, found.grid) };
  };
  const emt = async (cell, state) => {
    const { event, hold, case: number = null } = state;
    if (number !== null) return live.caseAnswer(number, kept.cells);
    const to = target(event);
    const shown = { controllers: kept.cells.controllers, texts: cells.texts, bands: live.bands(kept.cells, event) };
    return live.answer(`${cell}${hold ? ",h" : ""}`, given(state), shown, to);
  };
  const lived = new LiveMap(cells, live);
  const given = (state) => {
    const { event, hold } = state;
    const [to, charge] = [target(event), live.chargeOf(state)];
    const key = to ? `${to.cell}${hold ? ",h" : ""}` : undefined;
    return { ...event, jump: event.size * (Math.PI / 180), key, ...(charge === undefined ? {} : { charge }) };
  };
  const map = (_, state) => (state.figure === "survived" ? lived.answer(state, given(state)) : cells.map(state));
  const answers = {
    linear: (cell, state) => cells.linear(cell, state, live),
    modes: (cell, state) => cells.modes(cell, state, live),
    map,
    emt,
  };
  return async (kind, seq, state) => {
    const runs = ["emt", "save"].includes(kind) || (kind === "map" && state.figure === "survived");
    const fault = runs && live.fault(state.event, live.chargeOf(state));
    if (fault) return { status: 422, faults: [fault] };
    if (kind === "save" && (state.case ?? null) !== null) return refused(kept.runs.info.words.no_save_case);
    if (kind === "map" && !kept.info.figures.some(({ name }) => name === state.figure))
      return refused(kept.runs.info.words.no_figure);
    const { cell } = cells.nearest(state);
    try {
      if (kind === "save") return await save(cell, state);
      const answer = await answers[kind](cell, state);
      answer.header.seq = seq;
      return { status: 200, answer };
    } catch (error) {
      // Also where it does not let a worker begin.
      const missing = /WebAssembly|CompileError/.test(error.message);
      return refused(
        missing ? kept.runs.info.words.no_wasm : `This browser does not simulate here (${error.message}).`,
      );
    }
  };
}

const kept = window.STATIC;

(async () => {
  const [figures, texts] = [await bytesOf(kept.figures), await bytesOf(kept.texts)];
  const cells = new Cells(kept, new Uint8Array(figures), JSON.parse(new TextDecoder().decode(texts)));
  const placeOf = (number) => {
    const { scr, x_over_r: ratio } = cells.nearest(kept.runs.info.cases[number]);
    return { scr, x_over_r: ratio };
  };
  const { defaults } = kept.info;
  if ("case" in defaults) Object.assign(defaults, placeOf(defaults.case));
  start({
    info: { ...kept.info, simulated: kept.runs.info.events },
    ask: fileAsk(kept, cells),
    snap: (grid) => cells.nearest(grid),
    cases: kept.runs.info.cases,
    fields: kept.runs.info.dc?.charge ? [kept.runs.info.dc.charge.path] : [],
    placeOf,
    says: (grid) => cells.says(grid),
    holds: "held" in kept.cells,
  });
})();
