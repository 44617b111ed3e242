// Sentences of the package with values in them, written as Python writes them.

/** Digits behind the point; a number that lies exactly between two texts is rounded to the even one, as Python does. */
function fixed(value, digits) {
  const text = value.toFixed(digits);
  const exact = value.toFixed(Math.min(digits + 60, 100));
  const behind = exact.slice(exact.indexOf(".") + 1 + digits);
  if (!/^50*$/.test(behind)) return text;
  const cut = exact.slice(0, exact.length - behind.length).replace(/\.$/, "");
  return "02468".includes(cut[cut.length - 1]) ? cut : text;
}

function general(value, digits) {
  if (value === 0 || !Number.isFinite(value)) return String(value);
  const power = Number(value.toExponential(digits - 1).split("e")[1]);
  if (power < -4 || power >= digits) {
    const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
    const size = exponent.slice(1).padStart(2, "0");
    return `${Number(mantissa)}e${exponent[0]}${size}`;
  }
  const text = fixed(value, digits - 1 - power);
  return text.includes(".") ? text.replace(/\.?0+$/, "") : text;
}

/** A text with its braces filled: "{}", "{:.2f}", "{:.3g}" and "{:+.3g}". */
export const worded = (text, ...values) =>
  text.replace(/\{(?::(\+?)\.(\d)([fg]))?\}/g, (_, sign, digits, kind) => {
    const value = values.shift();
    if (!digits) return String(value);
    const shown = kind === "f" ? fixed(value, Number(digits)) : general(value, Number(digits));
    return sign && value >= 0 ? `+${shown}` : shown;
  });

const PREFIXES = { "-12": "p", "-9": "n", "-6": "u", "-3": "m", 0: "", 3: "k", 6: "M", 9: "G" };

/** A value with a unit and a prefix, to three digits. */
export function quantity(value, unit) {
  const short = Number(value.toPrecision(3));
  if (short === 0) return `0 ${unit}`;
  const power = Math.min(Math.max(3 * Math.floor(Math.log10(Math.abs(short)) / 3), -12), 9);
  return `${general(short / 10 ** power, 6)} ${PREFIXES[power]}${unit}`;
}

/** A value beside a limit that it misses: with so many more digits that both differ. */
function beside(value, limit, missed, digits) {
  if (missed)
    for (let more = digits; more <= 15; more += 1) {
      if (fixed(value, more) !== fixed(limit, more)) return fixed(value, more);
    }
  return fixed(value, digits);
}

/** A mode in words: how fast it swings and grows, and what takes part in it. */
export function modeInWords({ re, im, participation }, said) {
  const f_hz = Math.abs(im) / (2 * Math.PI);
  const what = f_hz > 1e-3 * Math.abs(re) ? worded(said.swings, f_hz) : said.still;
  const shares = new Map();
  for (const [state, share] of participation) {
    const name = said.quantities[state] || state;
    shares.set(name, (shares.get(name) || 0) + share);
  }
  const named = [...shares].sort((a, b) => b[1] - a[1]).filter(([, share]) => share >= said.least);
  const states = named.slice(0, said.most).map(([name, share]) => `${name} ${fixed(100 * share, 0)} %`);
  const damping = general(-re / Math.hypot(re, im), 2).replaceAll("-", "−");
  return worded(said.whole, what, worded(re > 0 ? said.grows : said.decays, Math.abs(re)), damping, states.join(", "));
}

function settled(found, said, rules) {
  const [late, tooMuch] = rules.asked || [null, null];
  const [mostTime, mostOver] = rules.met || [Infinity, Infinity];
  const time = beside(found.settling_s, late, found.settling_s > mostTime, 2);
  if (found.overshoot === null) return [time, ""];
  if (found.overshoot < rules.no_overshoot) return [time, said.no_overshoot];
  const over = beside(100 * found.overshoot, 100 * tooMuch, found.overshoot > mostOver, 1);
  return [time, worded(said.overshoot, over)];
}

/** One or two sentences on a run: its figures, the templates of the package, what is asked for, the event and its time. */
export function verdictOf(found, said, rules, event, event_s) {
  const { status } = found;
  let text = "";
  if (found.at_end) {
    text = `${found.at_end[0].toUpperCase()}${found.at_end.slice(1)}.`;
  } else if (status === said.settled && found.settling_s !== null) {
    text = worded(said.settles, event.signal, ...settled(found, said, rules));
  } else if (status === said.survived && found.recovery_s !== null) {
    text = worded(said.survives, found.recovery_s, said.since[event.kind] || said.since[""]);
  } else if (found.needs_s !== null) {
    text = worded(said.too_short, event.signal, rules.shown_s, Math.ceil(100 * found.needs_s) / 100);
  } else if (found.unstable) {
    text = worded(said.unstable, found.unstable);
  } else if (status === said.tripped) {
    text = worded(said.trips, found.why, event_s);
  } else if (status === said.blocked) {
    text = worded(said.blocks, found.why);
  } else if (status in said.verdicts) {
    text = said.verdicts[status];
    if (found.before) text = text.replace(...said.before);
  } else {
    return worded(said.no_verdict, found.why || status);
  }
  if (found.peak_pu === null || status === said.diverged) return text;
  text += worded(said.peak, Math.max(found.peak_pu, found.first_peak_pu || 0));
  if (status === said.survived && found.peak_pu > rules.hardware_pu) text += said.hardware;
  return text + (found.limited_s < rules.shortest_limited_s ? "." : worded(said.limited, found.limited_s));
}
