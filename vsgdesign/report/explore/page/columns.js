// Numbers of the cells of a page without a server: columns as the package packs them (columns.py).

const ORDER = ["e", "f", "d", "w"];
const PLANES = { e: 4, f: 4, d: 3, w: 3 };

/** Whole numbers of so many bytes, byte by byte. */
function words(bytes, at, count, planes) {
  const found = new Uint32Array(count);
  for (let k = 0; k < planes; k += 1)
    for (let j = 0; j < count; j += 1) found[j] |= bytes[at + k * count + j] << (8 * k);
  return found;
}

/** The numbers of which their neighbours have left this. */
function restored(left, width, planes) {
  const mask = planes === 4 ? 0xffffffff : 2 ** (8 * planes) - 1;
  for (let j = 0; j < left.length; j += 1) {
    const value = (left[j] >>> 1) ^ -(left[j] & 1);
    const before = (j >= 1 ? left[j - 1] : 0) + (j >= width ? left[j - width] : 0);
    left[j] = ((value + before - (j > width ? left[j - width - 1] : 0)) & mask) >>> 0;
  }
  return left;
}

/** Typed arrays, one for each letter of `kinds`; of a column that is the same for all cells the number. */
export function readColumns(bytes, { kinds, count, width, dropped }) {
  const same = [...kinds].filter((kind) => kind === "s").length;
  const numbers = new Float64Array(bytes.slice(0, 8 * same).buffer);
  const found = [];
  let at = 8 * same;
  const column = {
    e() {
      const low = words(bytes, at, count, 4);
      const high = restored(words(bytes, at + 4 * count, count, 4), width, 4);
      const pairs = new Uint32Array(2 * count);
      for (let j = 0; j < count; j += 1) [pairs[2 * j], pairs[2 * j + 1]] = [low[j], high[j]];
      at += 8 * count;
      return new Float64Array(pairs.buffer);
    },
    w() {
      const left = restored(words(bytes, at, count, 3), width, 3);
      at += 3 * count;
      return left;
    },
  };
  const real = (kind) => () => {
    const left = restored(words(bytes, at, count, PLANES[kind]), width, PLANES[kind]);
    at += PLANES[kind] * count;
    return new Float32Array(left.map((word) => word << dropped[kind]).buffer);
  };
  Object.assign(column, { f: real("f"), d: real("d") });
  let [one, k] = [0, 0];
  for (const kind of kinds) {
    if (kind === "s") found[k] = numbers[one++];
    k += 1;
  }
  for (const kind of ORDER) [...kinds].forEach((own, place) => own === kind && (found[place] = column[kind]()));
  return found;
}

/** The number of a cell in a column. */
export const at = (column, cell) => (typeof column === "number" ? column : column[cell]);
