// A drawing context that writes SVG. The figures are drawn with the same calls on the screen (CanvasRenderingContext2D)
// and for the download, so the file shows exactly what the screen shows. Only the calls that draw.js uses are here.

const SVG_ANCHORS = { left: "start", right: "end", center: "middle" };

const svgNumber = (value) => String(Math.round(value * 100) / 100);

const svgText = (text) =>
  String(text).replace(/[&<>"]/g, (c) => ({ "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;" })[c]);

// Clip paths have names that no other drawing of the same document has.
let clipCount = 0;

export class SvgContext {
  constructor(measure) {
    this.parts = [];
    this.path = [];
    this.stack = [];
    this.open = 0;
    this.measure = measure;
    Object.assign(this, {
      fillStyle: "#000",
      strokeStyle: "#000",
      lineWidth: 1,
      font: "11px sans-serif",
      textAlign: "left",
    });
    Object.assign(this, {
      textBaseline: "alphabetic",
      globalAlpha: 1,
      lineCap: "butt",
      lineJoin: "round",
      dash: [],
    });
  }

  // Groups: save and restore keep the style; clip and the transforms open a group that restore closes.
  save() {
    const { fillStyle, strokeStyle, lineWidth, font, textAlign, textBaseline, globalAlpha, dash } = this;
    this.stack.push({
      style: { fillStyle, strokeStyle, lineWidth, font, textAlign, textBaseline, globalAlpha, dash },
      open: this.open,
    });
    this.open = 0;
  }

  restore() {
    this.parts.push("</g>".repeat(this.open));
    const { style, open } = this.stack.pop();
    Object.assign(this, style);
    this.open = open;
  }

  group(attributes) {
    this.parts.push(`<g ${attributes}>`);
    this.open += 1;
  }

  translate(x, y) {
    this.group(`transform="translate(${svgNumber(x)} ${svgNumber(y)})"`);
  }

  rotate(angle) {
    this.group(`transform="rotate(${svgNumber((angle * 180) / Math.PI)})"`);
  }

  clip() {
    clipCount += 1;
    this.parts.push(`<clipPath id="clip${clipCount}"><path d="${this.path.join("")}"/></clipPath>`);
    this.group(`clip-path="url(#clip${clipCount})"`);
  }

  beginPath() {
    this.path = [];
  }

  moveTo(x, y) {
    this.path.push(`M${svgNumber(x)} ${svgNumber(y)}`);
  }

  lineTo(x, y) {
    this.path.push(`L${svgNumber(x)} ${svgNumber(y)}`);
  }

  closePath() {
    this.path.push("Z");
  }

  rect(x, y, width, height) {
    this.path.push(`M${svgNumber(x)} ${svgNumber(y)}h${svgNumber(width)}v${svgNumber(height)}h${svgNumber(-width)}Z`);
  }

  // The figures draw whole circles only.
  arc(x, y, radius) {
    const [r, left, y0] = [svgNumber(radius), svgNumber(x - radius), svgNumber(y)];
    this.path.push(
      `M${left} ${y0}a${r} ${r} 0 1 0 ${svgNumber(2 * radius)} 0a${r} ${r} 0 1 0 ${svgNumber(-2 * radius)} 0Z`,
    );
  }

  setLineDash(dash) {
    this.dash = dash;
  }

  alpha() {
    return this.globalAlpha < 1 ? ` opacity="${svgNumber(this.globalAlpha)}"` : "";
  }

  stroke() {
    const dash = this.dash.length ? ` stroke-dasharray="${this.dash.join(" ")}"` : "";
    const line = `stroke="${this.strokeStyle}" stroke-width="${svgNumber(this.lineWidth)}" stroke-linejoin="round"`;
    this.parts.push(`<path d="${this.path.join("")}" fill="none" ${line}${dash}${this.alpha()}/>`);
  }

  fill() {
    this.parts.push(`<path d="${this.path.join("")}" fill="${this.fillStyle}"${this.alpha()}/>`);
  }

  fillRect(x, y, width, height) {
    const box = `x="${svgNumber(x)}" y="${svgNumber(y)}" width="${svgNumber(width)}" height="${svgNumber(height)}"`;
    this.parts.push(`<rect ${box} fill="${this.fillStyle}"${this.alpha()}/>`);
  }

  strokeRect(x, y, width, height) {
    this.beginPath();
    this.rect(x, y, width, height);
    this.stroke();
  }

  clearRect() {}

  measureText(text) {
    this.measure.font = this.font;
    return this.measure.measureText(text);
  }

  fillText(text, x, y) {
    const [, weight, size] = this.font.match(/^(\d+ )?(\d+)px/) || [null, null, "11"];
    const shift =
      this.textBaseline === "middle" ? 0.35 * Number(size) : this.textBaseline === "top" ? 0.8 * Number(size) : 0;
    const style = `font-size="${size}"${weight ? ` font-weight="${weight.trim()}"` : ""} text-anchor="${SVG_ANCHORS[this.textAlign]}"`;
    this.parts.push(
      `<text x="${svgNumber(x)}" y="${svgNumber(y + shift)}" ${style} fill="${this.fillStyle}"${this.alpha()}>${svgText(text)}</text>`,
    );
  }

  body() {
    return this.parts.join("\n");
  }
}

export function svgDocument(body, width, height, background) {
  const size = `width="${width}" height="${height}" viewBox="0 0 ${width} ${height}"`;
  const family = "font-family=\"'Helvetica Neue', Arial, 'Liberation Sans', sans-serif\"";
  const head = `<svg xmlns="http://www.w3.org/2000/svg" ${size} ${family}>`;
  return `<?xml version="1.0" encoding="UTF-8"?>\n${head}\n<rect width="${width}" height="${height}" fill="${background}"/>\n${body}\n</svg>\n`;
}
