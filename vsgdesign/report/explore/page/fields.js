// Sliders and number fields with units, made from the study's description of its fields. What cannot be used is marked
// at its field with the limit and the unit; the last good value stays in force.
import { fieldText, plainNumber, readNumber } from "./units.js";

function made(tag, attributes = {}, ...children) {
  const e = document.createElement(tag);
  for (const [key, value] of Object.entries(attributes)) {
    if (key in e && key !== "list") e[key] = value;
    else e.setAttribute(key, value);
  }
  e.append(...children);
  return e;
}

let fieldCount = 0;

/** One field: a label, a slider (if it has ends), a number with its unit, and a place for the fault. */
export class Field {
  constructor(spec, store, { slider = true, compact = false } = {}) {
    Object.assign(this, { spec, store, faulty: false });
    const id = `field${++fieldCount}`;
    const label = spec.unit ? `${spec.label} in ${spec.unit}` : spec.label;
    this.input = made("input", { id, type: "text", inputMode: "decimal", autocomplete: "off", spellcheck: false });
    this.input.setAttribute("aria-label", label);
    this.input.setAttribute("data-path", spec.path);
    this.fault = made("p", { id: `${id}fault`, className: "fault", hidden: true });
    this.fault.setAttribute("role", "alert");
    this.input.setAttribute("aria-describedby", this.fault.id);
    const unit = made("span", { className: "unit" }, spec.unit || "");
    const path = spec.path.includes(".") ? spec.path : "";
    const about = [spec.meaning, path, spec.controllers ? `acts on ${spec.controllers.join(", ")}` : ""];
    const name = made("label", { htmlFor: id, title: about.filter(Boolean).join("; ") }, spec.label);
    this.ends = spec.slider || [spec.low, spec.high];
    const ends = this.ends.every(Number.isFinite) && this.ends[0] < this.ends[1];
    this.log = slider && ends && this.ends[0] > 0 && this.ends[1] / this.ends[0] >= 30;
    this.reset = made(
      "button",
      { type: "button", className: "reset", title: "Back to the study's value", hidden: true },
      "↺",
    );
    this.reset.setAttribute("aria-label", `${spec.label}: back to the study's value`);
    this.reset.addEventListener("click", () => this.back());
    this.row = made("div", { className: compact ? "field compact" : "field" }, name);
    if (slider && ends) {
      this.slider = made("input", { type: "range", min: 0, max: 1, step: "any", tabIndex: 0 });
      this.slider.setAttribute("aria-label", label);
      this.slider.addEventListener("input", () => this.slide());
      // A slider that comes back to where it was tells no change; a drag ends all the same.
      for (const end of ["change", "pointerup", "blur"]) this.slider.addEventListener(end, () => this.endSlide());
      this.slider.addEventListener("keydown", (event) => this.nudge(event));
      this.row.append(this.slider);
    }
    this.row.append(this.input, unit);
    if (!compact) this.row.append(this.reset);
    this.row.append(this.fault);
    this.input.addEventListener("input", () => (this.edited = true));
    this.input.addEventListener("change", () => this.enter());
    this.input.addEventListener("keydown", (event) => this.key(event));
    this.update();
  }

  // What is shown is in the field's unit; a key of the state may be kept in another (scale).
  get scale() {
    return this.spec.scale || 1;
  }

  get standard() {
    return this.store.isOwnKey(this.spec.path) ? this.defaultOfState() : this.spec.value;
  }

  defaultOfState() {
    const [head, ...rest] = this.spec.path.split(".");
    const kept = rest.length ? (this.store.defaults[head] || {})[rest.join(".")] : this.store.defaults[head];
    return typeof kept === "number" ? kept * this.scale : this.spec.value;
  }

  value() {
    const kept = this.store.read(this.spec.path, null);
    if (kept === null) return this.standard ?? NaN;
    if (!this.store.isOwnKey(this.spec.path)) return typeof kept === "number" ? kept : parseFloat(kept);
    return kept * this.scale;
  }

  write(shown) {
    this.clearFault();
    const tidy = Number(shown.toPrecision(9));
    if (this.store.isOwnKey(this.spec.path))
      return this.store.write(this.spec.path, Number((tidy / this.scale).toPrecision(9)));
    const same =
      Number.isFinite(this.spec.value) && Math.abs(tidy - this.spec.value) <= 1e-9 * Math.abs(this.spec.value);
    return this.store.write(this.spec.path, same ? null : this.spec.unit ? `${tidy} ${this.spec.unit}` : tidy);
  }

  place(value) {
    const [low, high] = this.ends;
    return this.log ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
  }

  slide() {
    const { step } = this.spec;
    const [low, high] = this.ends;
    const u = Number(this.slider.value);
    const raw = this.log ? low * Math.exp(u * Math.log(high / low)) : low + u * (high - low);
    const value = this.log ? Number(raw.toPrecision(2)) : Math.round(raw / step) * step;
    this.store.dragging = true;
    this.write(Math.min(high, Math.max(low, value)));
  }

  endSlide() {
    if (!this.store.dragging) return;
    this.store.dragging = false;
    this.store.commit();
    this.store.tell();
  }

  // The slider's own key steps are far too fine with step "any": one step of the field is taken instead.
  nudge(event) {
    const by = { ArrowUp: 1, ArrowRight: 1, ArrowDown: -1, ArrowLeft: -1, PageUp: 10, PageDown: -10 }[event.key];
    if (!by) return;
    event.preventDefault();
    this.stepBy(by);
  }

  stepBy(by) {
    const { low, high, step } = this.spec;
    const now = this.value();
    const next = this.log ? Number((now * 1.05 ** by).toPrecision(2 + (Math.abs(by) < 2))) : now + by * step;
    if (!Number.isFinite(next)) return;
    this.write(Math.min(high ?? Infinity, Math.max(low ?? -Infinity, Number(next.toPrecision(9)))));
    this.store.commit();
    this.edited = false;
    this.update(true);
  }

  key(event) {
    if (event.key === "ArrowUp" || event.key === "ArrowDown") {
      event.preventDefault();
      this.stepBy((event.key === "ArrowUp" ? 1 : -1) * (event.shiftKey ? 10 : 1));
    } else if (event.key === "Escape") {
      this.edited = false;
      this.clearFault();
      this.update(true);
    } else if (event.key === "Enter") {
      this.enter();
    }
  }

  enter() {
    const { low, high, unit } = this.spec;
    const { value, fault } = readNumber(this.input.value, unit || "");
    if (fault) {
      const limit = this.limited ? ` from ${this.range()}` : unit ? ` in ${unit}` : "";
      this.showFault(`${fault} ${this.spec.label} takes a number${limit}.`);
      return;
    }
    if (this.limited && (value < low - 1e-9 * Math.abs(low) || value > high + 1e-9 * Math.abs(high))) {
      this.showFault(
        `${this.spec.label} must be from ${this.range()}, not ${plainNumber(value)}${unit ? " " + unit : ""}.`,
      );
      return;
    }
    this.edited = false;
    this.write(value);
    this.store.commit();
  }

  get limited() {
    return Number.isFinite(this.spec.low) && Number.isFinite(this.spec.high) && this.spec.low < this.spec.high;
  }

  range() {
    const { low, high, unit } = this.spec;
    return `${plainNumber(low)} to ${plainNumber(high)}${unit ? " " + unit : ""}`;
  }

  back() {
    const standard = this.standard;
    this.clearFault();
    if (this.store.isOwnKey(this.spec.path))
      this.store.write(this.spec.path, Number((standard / this.scale).toPrecision(9)));
    else this.store.write(this.spec.path, null);
    this.store.commit();
    this.input.focus();
  }

  showFault(text) {
    this.faulty = true;
    this.fault.textContent = text;
    this.fault.hidden = false;
    this.input.setAttribute("aria-invalid", "true");
    const group = this.row.closest("details");
    if (group) group.open = true;
  }

  clearFault() {
    this.faulty = false;
    this.fault.hidden = true;
    this.fault.textContent = "";
    this.input.removeAttribute("aria-invalid");
  }

  update(force = false) {
    const value = this.value();
    if (this.slider) {
      this.slider.value = Number.isFinite(value) ? this.place(value) : 1;
      this.slider.setAttribute("aria-valuetext", `${this.textOf(value)} ${this.spec.unit || ""}`);
    }
    if (force || (!this.faulty && !this.typing())) this.input.value = this.textOf(value);
    const standard = this.standard;
    const same = !Number.isFinite(value) || Math.abs(value - standard) <= 1e-9 * Math.max(1, Math.abs(standard));
    this.reset.hidden = Number.isFinite(standard) ? same : !Number.isFinite(value);
  }

  // The text never hides digits of the value in force.
  textOf(value) {
    if (!Number.isFinite(value)) return "none";
    if (this.spec.digits) return String(Number(value.toPrecision(this.spec.digits)));
    const text = fieldText(value, this.log ? Math.abs(value) / 100 : this.spec.step);
    return Math.abs(Number(text) - value) <= 1e-6 * Math.abs(value) ? text : String(Number(value.toPrecision(6)));
  }

  // A text that the user is still typing is not replaced by an answer that comes in meanwhile.
  typing() {
    return document.activeElement === this.input && this.edited;
  }
}

/** A field with a few choices instead of a number. */
class ChoiceField {
  constructor(spec, store) {
    Object.assign(this, { spec, store });
    const id = `field${++fieldCount}`;
    this.input = made(
      "select",
      { id },
      ...spec.choices.map((choice) =>
        made("option", { value: choice }, `${choice} ${choice === 1 ? spec.unit.replace(/s$/, "") : spec.unit}`.trim()),
      ),
    );
    this.input.setAttribute("data-path", spec.path);
    this.fault = made("p", { className: "fault", hidden: true });
    this.row = made("div", { className: "field" }, made("label", { htmlFor: id }, spec.label), this.input, this.fault);
    this.input.addEventListener("change", () => {
      this.clearFault();
      const value = spec.choices.find((choice) => String(choice) === this.input.value);
      store.write(spec.path, value === spec.value ? null : value);
      store.commit();
    });
    this.update();
  }

  showFault(text) {
    Object.assign(this.fault, { textContent: text, hidden: false });
    this.input.setAttribute("aria-invalid", "true");
  }

  clearFault() {
    this.fault.hidden = true;
    this.input.removeAttribute("aria-invalid");
  }

  update() {
    this.input.value = this.store.read(this.spec.path, this.spec.value);
  }
}

/** All fields of the left column, in their groups, and the user's own gains. */
export class FieldList {
  constructor(root, info, store, notHere) {
    Object.assign(this, { root, info, store, fields: new Map(), ownFields: [], gains: null });
    const groups = new Map();
    for (const spec of info.fields || []) {
      if (notHere.includes(spec.path)) continue;
      const field = spec.kind === "choice" ? new ChoiceField(spec, store) : new Field(spec, store);
      this.fields.set(spec.path, field);
      const group = spec.group || "Settings";
      if (!groups.has(group)) groups.set(group, []);
      groups.get(group).push(field.row);
    }
    for (const [group, rows] of groups)
      root.append(made("details", { open: true }, made("summary", {}, group), ...rows));
    if ("own" in store.defaults && !info.static) this.makeOwn();
  }

  /** The values of a file that cannot be changed, in words in place of the fields; those of `open` stay fields. */
  describe(specs, made_by, open) {
    const all = [...this.fields.values()].filter((field) => field.textOf && specs.includes(field.spec));
    const [kept, values] = [true, false].map((own) => all.filter(({ spec }) => open.includes(spec.path) === own));
    const words = values.map((field) => {
      const text = field.textOf(field.value());
      return `${field.spec.label} ${text} ${text === "none" ? "" : field.spec.unit}`.trim();
    });
    const settings = made("ul", { className: "note" }, ...words.map((text) => made("li", {}, text)));
    this.root.replaceChildren(
      ...kept.map(({ row }) => row),
      made("p", { className: "note" }, made_by),
      made("details", {}, made("summary", {}, "Settings of this page"), settings),
    );
    this.fields.clear();
    for (const field of kept) this.add(field.spec.path, field);
  }

  add(path, field) {
    this.fields.set(path, field);
    return field;
  }

  makeOwn() {
    this.ownButton = made("button", { type: "button" }, "");
    this.ownBox = made("div", { className: "own" });
    this.ownButton.addEventListener("click", () => this.switchOwn());
    const note = made("p", { className: "note" }, "A further controller with gains that you set by hand.");
    this.root.append(
      made(
        "details",
        { open: Boolean(this.store.state.own) },
        made("summary", {}, "My own gains"),
        note,
        this.ownButton,
        this.ownBox,
      ),
    );
    this.updateOwn();
  }

  switchOwn() {
    const { store } = this;
    const others = store.state.controllers.filter((name) => name !== "own");
    if (store.state.own) store.set({ own: null, controllers: others });
    else if (this.gains) store.set({ own: { ...this.gains }, controllers: [...others, "own"] });
    store.commit();
  }

  /** The gains in force of the map's controller, which the user's own gains start from. */
  offerGains(gains) {
    this.gains = gains;
    if (this.ownButton) this.ownButton.disabled = !gains && !this.store.state.own;
  }

  updateOwn() {
    if (!this.ownButton) return;
    const { own } = this.store.state;
    this.ownButton.textContent = own ? "Remove my gains" : "Start from the gains in force here";
    const names = own ? Object.keys(own) : [];
    if (names.join() !== this.ownFields.map((field) => field.spec.path.slice(4)).join()) {
      for (const field of this.ownFields) this.fields.delete(field.spec.path);
      this.ownFields = names.map((name) => {
        const known = (this.info.gains || []).find((gain) => gain.name === name) || {};
        const start = Math.abs(own[name]) || 1;
        const step = known.step || 10 ** (Math.floor(Math.log10(start)) - 2);
        const spec = {
          path: `own.${name}`,
          label: known.label || name,
          unit: known.unit || "",
          meaning: known.meaning,
          step,
          value: own[name],
          digits: 4,
        };
        return this.add(spec.path, new Field(spec, this.store, { slider: false }));
      });
      this.ownBox.replaceChildren(...this.ownFields.map((field) => field.row));
    }
  }

  update() {
    this.updateOwn();
    for (const field of this.fields.values()) field.update();
  }

  clearFaults() {
    for (const field of this.fields.values()) field.clearFault();
  }

  /** Marks the fields of the faults; returns the faults that have no field. */
  mark(faults) {
    return faults.filter((fault) => {
      const field =
        this.fields.get(fault.field) || this.fields.get(String(fault.field || "").replace(/^changes\./, ""));
      if (field) field.showFault(faultText(fault));
      return !field;
    });
  }
}

/** One fault in a sentence, with its limit where the text does not name it. */
export function faultText(fault) {
  const limit = fault.limit === null || fault.limit === undefined ? "" : String(fault.limit);
  const text = fault.text || `${fault.field}: ${fault.value} is not possible.`;
  const numbers = limit.match(/[-+]?\d[\d.e+-]*/g) || [limit];
  if (!limit || numbers.every((number) => text.includes(number))) return text;
  return `${text} The limit is ${limit}${fault.unit && !limit.endsWith(fault.unit) ? " " + fault.unit : ""}.`;
}
