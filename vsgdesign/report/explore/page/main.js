// The explorer's page. It computes nothing of the physics: every number is an answer of the package's own functions.
// Order: svg draw notice state words live columns cells live_map transport map modes bode response units fields event table save actions main
import { onThemeChange } from "./draw.js";
import { Store, framed, linkOf, stateOfLink } from "./state.js";
import { Transport, loadInfo, serverAsk, waitAfter } from "./transport.js";
import { GridMap, figureText, paintScale } from "./map.js";
import { ModesPlot } from "./modes.js";
import { BodePlot } from "./bode.js";
import { ResponsePlot } from "./response.js";
import { Field, FieldList, faultText } from "./fields.js";
import { ControllerTable, isWild, sentence } from "./table.js";
import { forgetNotice, notice, say } from "./notice.js";
import { EventPanel } from "./event.js";
import { Actions } from "./actions.js";

const byId = (id) => document.getElementById(id);

const option = (value, text) => Object.assign(document.createElement("option"), { value, textContent: text });

class Page {
  // A page without a server brings its description, its own answers, the nearest of its grids, and whether it holds gains.
  constructor(info, file) {
    Object.assign(this, { info, file });
    this.answers = { linear: null, emt: null, map: null };
    this.store = new Store(info.defaults, this.startState());
    const calls = {
      onAnswer: (kind, answer, wish) => this.answered(kind, answer, wish),
      onFaults: (kind, faults) => this.refused(faults),
      onLost: () => this.lost(),
    };
    this.tab = Array.from(crypto.getRandomValues(new Uint32Array(2)), (n) => n.toString(36)).join("");
    this.ask = file ? file.ask : serverAsk(this.tab);
    this.transport = new Transport(this.ask, calls);
    this.losses = 0;
    this.retry = null;
    this.makeFigures();
    this.makeGridPanel();
    this.event = new EventPanel(info, this.store, (signal) => this.chooseShown(signal));
    this.makeSwitches();
    this.fields = new FieldList(byId("fields"), info, this.store, ["scr", "x_over_r", ...this.event.paths]);
    if (info.static) this.fields.describe(info.fields, info.made, file.fields);
    for (const field of [...this.gridFields, ...this.event.fields]) this.fields.add(field.spec.path, field);
    this.actions = new Actions(this);
    this.store.listen(() => this.changed());
    this.store.listen(forgetNotice);
    onThemeChange(() => this.repaint(true));
    const observer = new ResizeObserver(() => this.repaint(false));
    for (const box of document.querySelectorAll(".plot")) observer.observe(box);
    window.addEventListener("hashchange", () => this.openLink());
    document.documentElement.dataset.state = "ready";
    document.querySelector("main").inert = false;
    this.changed();
  }

  startState() {
    const { defaults } = this.info;
    try {
      return stateOfLink(window.location.hash, defaults);
    } catch (error) {
      notice(error.message, true);
      return stateOfLink("", defaults);
    }
  }

  openLink() {
    if (window.location.hash === linkOf(this.store.state, this.info.defaults)) return;
    try {
      const state = stateOfLink(window.location.hash, this.info.defaults);
      this.fields.clearFaults();
      this.store.replace(state);
      notice("");
    } catch (error) {
      notice(error.message, true);
    }
  }

  makeFigures() {
    const { info, store } = this;
    this.map = new GridMap(byId("map"), info, store);
    this.modes = new ModesPlot(byId("modes"), byId("mode"), info, store);
    this.modes.onChosen = () => this.wishDetails(performance.now());
    this.bode = new BodePlot(byId("magnitude"), byId("phase"), store);
    this.response = new ResponsePlot(byId("response"), byId("readout"), store, info.signals);
    this.table = new ControllerTable(byId("table"), info, store, { onEmphasis: (name) => this.emphasise(name) });
  }

  makeGridPanel() {
    const { info, store } = this;
    byId("title").textContent = info.study.title || info.study.name;
    document.title = `${info.study.title || info.study.name} – vsgdesign explore`;
    byId("title").title = byId("title").textContent;
    byId("figure").replaceChildren(...info.figures.map((f) => option(f.name, f.label)));
    byId("figure").addEventListener("change", (event) => {
      store.set({ figure: event.target.value });
      store.commit();
    });
    if ("map_of" in info.defaults && info.controllers.length > 1) {
      byId("map-of-box").hidden = false;
      byId("map-of").replaceChildren(...info.controllers.map((c) => option(c.name, c.name)));
      byId("map-of").addEventListener("change", (event) => {
        store.set({ map_of: event.target.value });
        store.commit();
      });
    }
    const known = (path) => (info.fields || []).find((f) => f.path === path);
    const grid = [
      ["scr", "SCR", info.map.scr],
      ["x_over_r", "X/R", info.map.x_over_r],
    ];
    this.gridFields = grid.map(([path, label, [low, high]]) => {
      const spec = { label, unit: "", low, high, step: 0.01, value: info.defaults[path], ...known(path), path };
      return new Field({ ...spec, step: Math.min(spec.step, 0.01) }, store, { slider: false, compact: true });
    });
    if (info.static) this.makeStatic();
    byId("grid-fields").append(...this.gridFields.map((field) => field.row));
    byId("hold").addEventListener("change", (event) => this.hold(event.target.checked));
    const holds = (key) => Boolean(info[key] && info[key].scr.length);
    const missed = holds("nodes") && info.nodes.kept && info.nodes.kept.some((kept) => !kept);
    const signs = {
      node: holds("nodes"),
      missed,
      proof: holds("certificate"),
      limit: true,
      unstable: true,
      nothing: true,
    };
    for (const [sign, there] of Object.entries(signs)) byId("map-key").querySelector(`.${sign}`).hidden = !there;
  }

  // A file without server knows a lattice of grids: the ring snaps to it. Beside it the event can be changed.
  makeStatic() {
    this.map.snap = this.file.snap;
    byId("hold-box").hidden = !this.file.holds;
    byId("link").hidden = framed;
    byId("save").hidden = byId("event").disabled = !this.info.simulated.length;
    document.documentElement.classList.add("static");
    const { cases } = this.file;
    byId("case-box").hidden = !cases.length;
    byId("case").replaceChildren(
      ...cases.map((one, k) => option(k, one.label)),
      option("", "none: the grid of the map"),
    );
    byId("case").addEventListener("change", ({ target }) => {
      const chosen = target.value === "" ? null : Number(target.value);
      this.store.set({ case: chosen, ...(chosen === null ? {} : this.file.placeOf(chosen)) });
      this.store.commit();
    });
    for (const field of this.gridFields) field.input.readOnly = true;
  }

  hold(on) {
    const { store, info } = this;
    const { scr, x_over_r: ratio } = store.state;
    store.set({ hold: on ? (info.static && info.lattice.hold) || { scr, x_over_r: ratio } : null });
    store.commit();
    const { hold } = store.state;
    say(hold ? `The gains of SCR ${hold.scr}, X/R ${hold.x_over_r} are held.` : "The gains follow the grid again.");
  }

  makeSwitches() {
    const segment = (root, name, choices, choose) => {
      for (const [value, text] of Object.entries(choices)) {
        const radio = Object.assign(document.createElement("input"), { type: "radio", name, value });
        radio.addEventListener("change", () => choose(value));
        const label = document.createElement("label");
        label.append(radio, text);
        root.append(label);
      }
      root.querySelector("input").checked = true;
    };
    const quantities = { P: "P", Q: "Q", i_s_pu: "current", v_pu: "voltage", omega_hz: "frequency" };
    for (const { name, short } of this.info.signals) quantities[name] = short;
    segment(byId("shown"), "shown", quantities, (value) => this.response.choose(value));
    segment(byId("loop"), "loop", { P: "P", Q: "Q" }, (value) => {
      this.bode.loop = value;
      this.showLinear();
    });
  }

  // The quantity that the event is about is drawn, unless the user chooses another.
  chooseShown(name) {
    byId("shown").querySelector(`input[value="${name}"]`).checked = true;
    this.response.choose(name);
  }

  // The map depends on everything but the place of the ring and, unless it is a map of the event, the event.
  mapKey() {
    const rest = { ...this.store.state };
    const others = rest.figure === "survived" ? [] : ["event", "silent_s"];
    for (const key of ["scr", "x_over_r", "case", ...others]) delete rest[key];
    return JSON.stringify(rest);
  }

  // Linear and EMT do not depend on the map's figure.
  pointKey() {
    const { figure, map_of: of, ...rest } = this.store.state;
    return JSON.stringify(rest);
  }

  changed() {
    const { store } = this;
    const since = performance.now();
    this.map.paint();
    const point = this.pointKey();
    if (point !== this.askedPoint) {
      this.askedPoint = point;
      // Both at once: the server computes EMT in a process of its own.
      this.transport.wish("linear", store.state, since);
      this.transport.wish("emt", store.state, since);
      if (this.modes.chosen) this.wishDetails(since);
    }
    const map = this.mapKey();
    if (map !== this.askedMap) {
      this.askedMap = map;
      this.transport.wish("map", store.state, since);
    }
    this.updateControls();
    if (!store.dragging && this.answers.linear) this.showLinear();
    if (!store.dragging && this.answers.emt) this.showEmt();
  }

  wishDetails(since) {
    this.transport.wish("modes", this.store.state, since);
  }

  updateControls() {
    const { store, info } = this;
    const { scr, x_over_r: ratio, hold, figure } = store.state;
    byId("where").textContent = `SCR ${scr.toFixed(2)}   X/R ${ratio.toFixed(2)}`;
    if (info.static) byId("where").title = this.file.says(store.state);
    byId("map").setAttribute(
      "aria-label",
      `Grid on the map: SCR ${scr.toFixed(2)}, X/R ${ratio.toFixed(2)}.${hold ? ` Gains held at SCR ${hold.scr}, X/R ${hold.x_over_r}.` : ""}`,
    );
    const shown = store.state.case ?? null;
    byId("case").value = shown ?? "";
    byId("response-title").parentElement.hidden = shown !== null;
    byId("undo").disabled = !store.canUndo;
    byId("redo").disabled = !store.canRedo;
    byId("hold").checked = Boolean(hold);
    byId("figure").value = figure;
    byId("map-of").value =
      store.state.map_of ||
      (this.answers.map && this.answers.map.header.controller) ||
      info.controllers[info.controllers.length - 1].name;
    this.fields.update();
    this.event.update(this.fields);
    if (shown !== null) byId("linear-key").hidden = true;
  }

  answered(kind, answer, wish) {
    this.found();
    // While the server still compiles, it says so and wants to be asked again.
    if (answer.header.again) {
      this.response.wait(answer.header.words);
      this.transport.wish(kind, this.store.state, wish.since);
      return;
    }
    this.answers[kind] = answer;
    this.store.good = wish.state;
    if (kind === "linear") this.showLinear();
    else if (kind === "modes") this.modes.detail(answer.header.controllers);
    else if (kind === "emt") this.showEmt();
    else this.showMap();
    // A map that is still computed is shown as it comes.
    if (answer.header.more && this.store.state.figure === answer.header.figure)
      this.transport.wish(kind, this.store.state, wish.since);
    // The time until the frame with this answer is on the screen, for whoever measures.
    requestAnimationFrame(() => {
      const channel = new MessageChannel();
      channel.port1.onmessage = () => {
        const detail = { kind, seq: wish.seq, ms: performance.now() - wish.since, server: answer.header.ms };
        document.dispatchEvent(new CustomEvent("drawn", { detail }));
      };
      channel.port2.postMessage(0);
    });
  }

  // Controllers of an answer that are still shown, with their place in the study (for the marker's shape).
  shownOf(answer) {
    const place = new Map(this.info.controllers.map((c, k) => [c.name, k]));
    return answer.header.controllers
      .map((c, index) => ({ ...c, index, place: place.has(c.name) ? place.get(c.name) : place.size }))
      .filter((c) => this.store.state.controllers.includes(c.name));
  }

  showLinear() {
    const { header, arrays } = this.answers.linear;
    const shown = this.shownOf(this.answers.linear);
    const without = shown.filter((c) => !c.stable && c.why && !(c.modes || []).length);
    const words = header.words || (without.length && without.length === shown.length ? sentence(without[0].why) : "");
    const q = this.bode.loop === "Q" ? "_Q" : "";
    const curves = shown.map((c) => {
      const get = (name) => arrays[`${c.index}/${name}`];
      const w = get("bode_w");
      const mag = get(`bode${q}_mag_db`);
      return {
        name: c.name,
        colour: c.colour,
        stable: c.stable,
        t: get("step_t"),
        full: get("step_full"),
        w: mag && w,
        mag,
        phase: get(`bode${q}_phase_deg`),
        crossover: c[`crossover${q}_rad_s`],
        phaseCrossover: c[`phase_crossover${q}_rad_s`],
      };
    });
    byId("loop").hidden = !Object.keys(arrays).some((name) => name.endsWith("bode_Q_mag_db"));
    this.modes.show(shown, words);
    this.bode.show(curves, words);
    const { event } = this.store.state;
    const drawn = (this.store.state.case ?? null) === null && event.kind === "step";
    this.response.showLinear(drawn ? curves : [], drawn ? event.signal : null, words);
    this.showTable();
    const last = shown[shown.length - 1];
    this.fields.offerGains(last && last.gains && Object.keys(last.gains).length ? last.gains : null);
  }

  showEmt() {
    const { header, arrays } = this.answers.emt;
    const curves = this.shownOf(this.answers.emt).map((c) => {
      const curve = { name: c.name, colour: c.colour, t: arrays[`${c.index}/t`], wild: isWild(c.status) };
      for (const name of Object.keys(this.response.known)) curve[name] = curve.t && arrays[`${c.index}/${name}`];
      return curve;
    });
    this.response.showEmt(curves, header.bands, header.words);
    this.showTable();
  }

  showTable() {
    const { linear, emt } = this.answers;
    this.table.show(linear ? linear.header.controllers : [], emt ? emt.header.controllers : []);
  }

  showMap() {
    const { answers, info } = this;
    const known = info.figures.find((f) => f.name === answers.map.header.figure) || {};
    Object.assign(answers.map.header, { ...known, ...answers.map.header });
    this.map.show(answers.map);
    paintScale(byId("scale"), answers.map.header);
    const { promise, unit, label, controller } = answers.map.header;
    const promised =
      promise === null || promise === undefined ? "" : ` The line is at the promised ${figureText(promise, unit)}.`;
    byId("map").title =
      `${label || ""}${controller ? ` of ${controller}` : ""}.${promised} Dark: unstable. Grey: no operating point.`;
  }

  emphasise(name) {
    this.bode.emphasis = this.response.emphasis = name;
    this.bode.paint();
    this.response.paint();
  }

  repaint(anew) {
    this.map.refresh();
    if (this.answers.map) paintScale(byId("scale"), this.answers.map.header);
    this.modes.paint();
    this.bode.paint();
    this.response.paint();
    if (anew) {
      this.table.layout = null;
      this.table.paint();
    }
  }

  /** Faults are marked at their fields, and the fields' last good values stay in force. */
  refused(faults) {
    this.found();
    const homeless = this.fields.mark(faults);
    let changed = false;
    for (const fault of faults) if (fault.field) changed = this.store.takeBack(String(fault.field)) || changed;
    if (changed) this.store.forget();
    notice(homeless.map(faultText).join(" "), true);
  }

  /** The server does not answer: it is asked again after a while, and after a longer one the next time. */
  lost() {
    document.documentElement.dataset.state = "lost";
    notice(
      "The server does not answer. Is `vsgdesign explore` still running? What is drawn is the last answer. The page asks again.",
      true,
    );
    if (this.retry) return;
    this.losses += 1;
    this.retry = setTimeout(() => {
      this.retry = null;
      this.askLost();
    }, waitAfter(this.losses));
  }

  // All that was lost, or one answer as a sign of life where that was no picture.
  askLost() {
    const { lost } = this.transport;
    for (const kind of lost.length ? lost : ["linear"])
      if (!this.transport.kind(kind).busy) this.transport.wish(kind, this.store.state);
  }

  // The server answers, perhaps again: what was lost is asked for, so that all pictures are of one state.
  found() {
    if (document.documentElement.dataset.state !== "lost") return;
    this.losses = 0;
    clearTimeout(this.retry);
    this.retry = null;
    if (this.transport.lost.length) this.askLost();
    else {
      document.documentElement.dataset.state = "ready";
      notice("");
    }
  }
}

/** Opens the page; `file` is what a page without a server brings. */
export async function start(file = null) {
  try {
    const info = file ? file.info : await loadInfo((words) => notice(words));
    notice("");
    window.page = new Page(info, file);
  } catch (error) {
    notice(error.message, true);
  }
}

if (!window.STATIC) start();
