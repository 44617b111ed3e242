// The event whose response is shown: a step, a jump of the grid or of its phase, a sag, a frequency ramp.
import { Field } from "./fields.js";

const eventPart = (id) => document.getElementById(id);

const eventOption = (value, text) => Object.assign(document.createElement("option"), { value, textContent: text });

export class EventPanel {
  // The event's own fields: its size, and what this kind of event needs beside it.
  constructor(info, store, onSignal) {
    Object.assign(this, { info, store });
    const events = info.events || [];
    eventPart("event").replaceChildren(...events.map((e) => eventOption(e.kind, e.label)));
    eventPart("event").addEventListener("change", (event) => {
      const chosen = events.find((e) => e.kind === event.target.value);
      store.set({
        event: {
          ...store.state.event,
          kind: chosen.kind,
          ...(Number.isFinite(chosen.value) ? { size: chosen.value } : {}),
        },
      });
      store.commit();
    });
    const specs = [
      { path: "event.length_s", label: "for", unit: "s", step: 0.01 },
      { path: "event.to_scr", label: "to SCR", unit: "", step: 0.01 },
      { path: "event.to_x_over_r", label: "X/R", unit: "", step: 0.01 },
    ];
    this.fields = specs.map((spec) => {
      const given = (info.fields || []).find((f) => f.path === spec.path);
      return new Field(
        {
          low: given && given.low,
          high: given && given.high,
          scale: given && given.scale,
          ...spec,
          value: NaN,
        },
        store,
        { slider: false, compact: true },
      );
    });
    this.sizeFields = events.map(
      (e) =>
        new Field(
          {
            ...e,
            path: "event.size",
            label: { step: "by", sag: "by", ramp: "by", phase: "by" }[e.kind] || "size",
          },
          store,
          { slider: false, compact: true },
        ),
    );
    this.paths = ["event.size", ...specs.map((spec) => spec.path)];
    this.signal = document.createElement("select");
    this.signal.append(eventOption("P", "of P"), eventOption("Q", "of Q"));
    this.signal.setAttribute("aria-label", "Reference that steps");
    this.signal.addEventListener("change", () => {
      store.set({ event: { ...store.state.event, signal: this.signal.value } });
      store.commit();
      onSignal(this.signal.value);
    });
    eventPart("event-fields").append(
      this.signal,
      ...this.sizeFields.map((f) => f.row),
      ...this.fields.map((f) => f.row),
    );
    for (const field of this.sizeFields) field.row.classList.add("size");
    if (!info.static) return;
    eventPart("event-fields").hidden = !info.simulated.length;
    const known = [...info.simulated, info.defaults.event.kind];
    for (const one of eventPart("event").options) one.disabled = !known.includes(one.value);
  }

  /** Shows what belongs to the chosen kind of event. `list` gets the size field in force, so that faults find it. */
  update(list) {
    const { event } = this.store.state;
    eventPart("event").value = event.kind;
    this.signal.value = event.signal;
    this.signal.hidden = eventPart("linear-key").hidden = event.kind !== "step";
    const chosen = (this.info.events || []).findIndex((e) => e.kind === event.kind);
    this.sizeFields.forEach((field, k) => {
      field.row.hidden = k !== chosen || event.kind === "grid";
      if (k === chosen) {
        list.add("event.size", field);
        field.update();
      }
    });
    const [length, scr, ratio] = this.fields;
    length.row.hidden = !["sag", "ramp"].includes(event.kind);
    scr.row.hidden = ratio.row.hidden = event.kind !== "grid";
  }
}
