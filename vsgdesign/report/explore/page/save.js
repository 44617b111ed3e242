// What the user takes away: the study as TOML, the figures as one SVG or PNG, and the data behind them as CSV.
import { svgDocument } from "./svg.js";
import { SHAPES, font, lineColour, shapePath, theme } from "./draw.js";
import { paintScale } from "./map.js";

export function download(name, content, type) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(content instanceof Blob ? content : new Blob([content], { type }));
  link.download = name;
  document.body.append(link);
  link.click();
  link.remove();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

export const fileName = (study, ending) => `${(study || "explore").replace(/[^\w-]+/g, "_")}_explore.${ending}`;

/** The five figures as they are on the screen, under a title line and the key of the controllers. */
export function figuresSvg({ map, modes, bode, response, titles, headline, controllers }) {
  const gap = 16;
  const head = 58;
  const panels = [];
  const place = (figure, paint, title, x, y) => {
    const svg = figure.svg();
    const { width, height } = figure.begin(svg);
    paint(svg);
    panels.push({ svg, title, x, y, width, height });
    return [x + width, y + height + 20];
  };
  let right = 0;
  const [mapRight, mapBottom] = place(map.figure, (svg) => map.paintTo(svg), titles.map, gap, head);
  if (map.answer) {
    const svg = map.figure.svg();
    const scale = document.getElementById("scale");
    paintScale(scale, map.answer.header, svg);
    panels.push({
      svg,
      title: "",
      x: gap,
      y: mapBottom - 18,
      width: scale.clientWidth,
      height: scale.clientHeight,
    });
  }
  const [, stepBottom] = place(response.figure, (svg) => response.paint(svg), titles.response, mapRight + gap, head);
  const [stepRight, modesBottom] = place(
    modes.figure,
    (svg) => modes.paint(svg),
    titles.modes,
    mapRight + gap,
    stepBottom + gap,
  );
  const [magnitude, phase] = [bode.magnitude.svg(), bode.phase.svg()];
  const sizes = [bode.magnitude.begin(magnitude), bode.phase.begin(phase)];
  bode.paintTo(magnitude, phase);
  panels.push({
    svg: magnitude,
    title: titles.bode,
    x: stepRight + gap,
    y: head,
    width: sizes[0].width,
    height: sizes[0].height,
  });
  const phaseTop = head + sizes[0].height + gap;
  panels.push({
    svg: phase,
    title: "",
    x: stepRight + gap,
    y: phaseTop,
    width: sizes[1].width,
    height: sizes[1].height,
  });
  right = stepRight + gap + sizes[0].width + gap;
  const bottom = Math.max(mapBottom, modesBottom, phaseTop + sizes[1].height + 20) + gap;
  const frame = map.figure.svg();
  frame.fillStyle = theme().text;
  frame.font = font(15, "600");
  frame.fillText(headline[0], gap, 22);
  frame.font = font(12);
  frame.fillStyle = theme().soft;
  frame.fillText(headline[1], gap, 40);
  paintKey(frame, controllers, right - gap, 22);
  frame.font = font(12, "600");
  frame.fillStyle = theme().text;
  const bodies = panels.map((panel) => {
    if (panel.title) frame.fillText(panel.title, panel.x + 4, panel.y + 12);
    return `<g transform="translate(${panel.x} ${panel.y + 18})">${panel.svg.body()}</g>`;
  });
  return svgDocument([frame.body(), ...bodies].join("\n"), Math.ceil(right), Math.ceil(bottom), theme().back);
}

function paintKey(ctx, controllers, right, y) {
  let x = right;
  ctx.font = font(12);
  for (const c of [...controllers].reverse()) {
    x -= ctx.measureText(c.name).width;
    ctx.fillStyle = theme().text;
    ctx.fillText(c.name, x, y);
    x -= 30;
    ctx.strokeStyle = lineColour(c.colour);
    ctx.lineWidth = 2;
    ctx.beginPath();
    ctx.moveTo(x, y - 4);
    ctx.lineTo(x + 24, y - 4);
    ctx.stroke();
    shapePath(ctx, SHAPES[c.place % SHAPES.length], x + 12, y - 4, 4);
    ctx.stroke();
    x -= 16;
  }
}

/** A PNG of an SVG's text, twice as fine as the screen. */
export function pngOf(svg) {
  return new Promise((resolve, reject) => {
    const url = URL.createObjectURL(new Blob([svg], { type: "image/svg+xml" }));
    const image = new Image();
    image.onload = () => {
      const canvas = document.createElement("canvas");
      Object.assign(canvas, { width: 2 * image.width, height: 2 * image.height });
      const ctx = canvas.getContext("2d");
      ctx.scale(2, 2);
      ctx.drawImage(image, 0, 0);
      URL.revokeObjectURL(url);
      canvas.toBlob(resolve, "image/png");
    };
    image.onerror = () => reject(new Error("The browser could not draw the figures."));
    image.src = url;
  });
}

const csvCell = (value) => (/[",\n]/.test(String(value)) ? `"${String(value).replaceAll('"', '""')}"` : String(value));

/** The data of all figures in long form: one row a value, with its figure, controller, and both units. */
export function dataCsv(answers, state) {
  const rows = [`# state: ${JSON.stringify(state)}`, "figure,controller,quantity,x_name,x,value,unit"];
  const put = (...cells) => rows.push(cells.map(csvCell).join(","));
  const { linear, emt, map } = answers;
  const series = [
    ["bode_mag_db", "bode_w", "w in rad/s", "dB", "bode"],
    ["bode_phase_deg", "bode_w", "w in rad/s", "deg", "bode"],
    ["bode_Q_mag_db", "bode_w", "w in rad/s", "dB", "bode"],
    ["bode_Q_phase_deg", "bode_w", "w in rad/s", "deg", "bode"],
    ["step_reduced", "step_t", "t in s", "pu", "linear step"],
    ["step_full", "step_t", "t in s", "pu", "linear step"],
  ];
  if (linear) {
    linear.header.controllers.forEach((c, i) => {
      for (const [name, x, xName, unit, figure] of series) {
        const [xs, ys] = [linear.arrays[`${i}/${x}`], linear.arrays[`${i}/${name}`]];
        if (xs && ys) xs.forEach((v, k) => Number.isFinite(ys[k]) && put(figure, c.name, name, xName, v, ys[k], unit));
      }
      for (const m of c.modes || []) put("modes", c.name, "mode", "real part in 1/s", m.re, m.im, "rad/s");
    });
  }
  if (emt) {
    const units = { P: "pu", Q: "pu", i_s_pu: "pu", v_pu: "pu", omega_hz: "Hz" };
    emt.header.controllers.forEach((c, i) => {
      const t = emt.arrays[`${i}/t`];
      for (const [name, unit] of Object.entries(units)) {
        const ys = emt.arrays[`${i}/${name}`];
        if (t && ys) t.forEach((v, k) => Number.isFinite(ys[k]) && put("EMT", c.name, name, "t in s", v, ys[k], unit));
      }
    });
  }
  if (map) {
    const { scr, x_over_r: ratio, values } = map.arrays;
    values.forEach((v, k) => {
      const at = `SCR ${scr[k % scr.length].toFixed(4)}, X/R ${ratio[Math.floor(k / scr.length)].toFixed(4)}`;
      put(
        "map",
        map.header.controller || "",
        map.header.figure,
        "grid",
        at,
        Number.isFinite(v) ? v : "",
        map.header.unit || "",
      );
    });
  }
  return rows.join("\n") + "\n";
}
