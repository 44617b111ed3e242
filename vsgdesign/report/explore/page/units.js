// Numbers with units, as text and back.

const stepDigits = (step) => Math.max(0, Math.min(6, -Math.floor(Math.log10(step) + 1e-9)));

export const fieldText = (value, step) => (Number.isFinite(value) ? value.toFixed(stepDigits(step || 0.01)) : "");

export const plainNumber = (value) => String(Number(value.toPrecision(5))).replace("-", "−");

/** The text of a value that misses a limit, with so many more digits that it is not the text of the limit. */
export function besideLimit(value, limit, text) {
  for (let more = 0; more <= 12; more++) if (text(value, more) !== text(limit, more)) return text(value, more);
  return text(value);
}

const PREFIXES = { "": 0, k: 3, M: 6, m: -3, µ: -6, u: -6 };
const BASES = ["s", "W", "var", "VA", "V", "A", "Hz", "H", "Ω"];

/** The power of ten from one unit to another of the same kind ("ms" to "s": -3); NaN where they differ in kind. */
function powerBetween(from, to) {
  if (from === to) return 0;
  if (from === "%" && (to === "" || to === "pu")) return -2;
  for (const base of BASES) {
    const [a, b] = [from, to].map((unit) =>
      unit.endsWith(base) ? PREFIXES[unit.slice(0, unit.length - base.length)] : undefined,
    );
    if (a !== undefined && b !== undefined) return a - b;
  }
  return NaN;
}

/**
 * What a text says in a field's unit: {value}, or {fault} in words. The unit may be typed too, with another prefix.
 * A comma as decimal sign and a true minus are understood.
 */
export function readNumber(text, unit = "") {
  const parts = text
    .trim()
    .replace("−", "-")
    .replace(",", ".")
    .match(/^([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*(.*)$/i);
  if (!parts) return { value: NaN, fault: `“${text}” is not a number.` };
  const power = parts[2] === "" ? 0 : powerBetween(parts[2], unit);
  if (Number.isNaN(power))
    return {
      value: NaN,
      fault: `“${text}” is ${unit ? `not in ${unit}` : "not a plain number: this field has no unit"}.`,
    };
  return { value: Number((Number(parts[1]) * 10 ** power).toPrecision(12)) };
}
