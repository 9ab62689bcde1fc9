"use strict";
/* Small charts as SVG elements: lines on logarithmic axes, bars, and ellipses. Every axis has its quantity and unit. */
const SVG = "http://www.w3.org/2000/svg";
const COLOURS = { saturation: "#d55e00", cnr: "#0072b2", sampling: "#009e73", smear: "#cc79a7" };
const DASHES = { saturation: "", cnr: "6 3", sampling: "2 3", smear: "8 3 2 3" };

function element(name, attributes = {}, text = "") {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (text) made.textContent = text;
  return made;
}

function canvas(width, height, label) {
  return element("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label });
}

const superscript = (n) => [...String(n)].map((c) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(c)]).join("");
const tick = (v) => (v >= 1e5 || (v > 0 && v < 0.01 && Math.log10(v) % 1 === 0) ? `10${superscript(Math.round(Math.log10(v)))}` : String(v).replace("-", "−"));

/* Axes of a plot: x and y are {low, high, log, ticks, label}; gives functions from values to places. */
function axes(svg, box, x, y) {
  const place = (axis, from, to) => (v) => {
    const [a, b, c] = axis.log ? [axis.low, axis.high, v].map(Math.log10) : [axis.low, axis.high, v];
    return from + (to - from) * Math.min(Math.max((c - a) / (b - a), 0), 1);
  };
  const px = place(x, box.left, box.right), py = place(y, box.bottom, box.top);
  for (const v of x.ticks) {
    svg.append(element("line", { x1: px(v), x2: px(v), y1: box.top, y2: box.bottom, stroke: "#ddd" }));
    svg.append(element("text", { x: px(v), y: box.bottom + 13, "text-anchor": "middle" }, tick(v)));
  }
  for (const v of y.ticks) {
    svg.append(element("line", { x1: box.left, x2: box.right, y1: py(v), y2: py(v), stroke: "#ddd" }));
    svg.append(element("text", { x: box.left - 4, y: py(v) + 4, "text-anchor": "end" }, tick(v)));
  }
  svg.append(element("path", { d: `M${box.left} ${box.top}V${box.bottom}H${box.right}`, fill: "none", stroke: "#000" }));
  svg.append(element("text", { x: (box.left + box.right) / 2, y: box.bottom + 27, "text-anchor": "middle" }, x.label));
  const middle = (box.top + box.bottom) / 2;
  svg.append(element("text", { x: 10, y: middle, "text-anchor": "middle", transform: `rotate(-90 10 ${middle})` }, y.label));
  return [px, py];
}

/* Margin of each criterion over the ranges from low to high; above one it is met. `present` is the range that is set. */
function curveChart(curve, present, low, high, complete) {
  const ranges = curve.range_m, width = 400, height = 300;
  const svg = canvas(width, height, `Margin of each criterion over range, from ${low} to ${high} m; above one it is met`);
  high = Math.max(high, low * 1.01);
  const stops = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].filter((v) => v >= low && v <= high);
  const x = { low, high, log: true, ticks: stops.length > 1 ? stops : [low, high], label: "range [m]" };
  const y = { low: 0.01, high: 1000, log: true, ticks: [0.01, 0.1, 1, 10, 100, 1000], label: "margin of the criterion [1]" };
  const box = { left: 52, right: width - 14, top: 40, bottom: height - 36 };
  const [px, py] = axes(svg, box, x, y);
  svg.append(element("rect", { x: box.left, y: py(1), width: box.right - box.left, height: box.bottom - py(1), fill: "#d55e00", opacity: 0.08 }));
  svg.append(element("line", { x1: box.left, x2: box.right, y1: py(1), y2: py(1), stroke: "#000", "stroke-width": 1.2 }));
  svg.append(element("text", { x: box.left + 4, y: py(1) + 12 }, "below: fails"));
  if (!complete) svg.append(element("text", { x: box.right - 4, y: box.top + 14, "text-anchor": "end" }, `computing: ${ranges.length} points so far`));
  const names = Object.keys(curve.margins), least = ranges.map((_, i) => {
    const all = names.map((name) => curve.margins[name][i]);
    return all.includes(null) ? null : Math.min(...all);
  });
  const path = (values) => values.map((v, i) => (v === null ? "" : `${i && values[i - 1] !== null ? "L" : "M"}${px(ranges[i])} ${py(v)}`)).join("");
  svg.append(element("path", { d: path(least), fill: "none", stroke: "#bbb", "stroke-width": 6, opacity: 0.6 }));
  names.forEach((name, k) => {
    const style = { fill: "none", stroke: COLOURS[name], "stroke-width": 2, "stroke-dasharray": DASHES[name] };
    svg.append(element("path", { d: path(curve.margins[name]), ...style }));
    const at = { x: 52 + (k % 2) * 172, y: 12 + Math.floor(k / 2) * 16 };
    svg.append(element("path", { d: `M${at.x} ${at.y - 4}h24`, ...style }));
    svg.append(element("text", { x: at.x + 28, y: at.y }, curve.names[name]));
  });
  const here = ranges.findIndex((r) => Math.abs(r - present) < 1e-9);
  svg.append(element("line", { x1: px(present), x2: px(present), y1: box.top, y2: box.bottom, stroke: "#000", "stroke-dasharray": "3 3" }));
  if (here >= 0 && least[here] !== null)
    svg.append(element("circle", { cx: px(present), cy: py(least[here]), r: 5, fill: "#fff", stroke: "#000", "stroke-width": 2, class: "present" }));
  return svg;
}

/* Pixels by charge, with the well's end. */
function histogramChart(histogram) {
  const width = 340, height = 240, { edges, counts } = histogram;
  const svg = canvas(width, height, `Histogram: pixels by charge, up to ${Math.round(edges.at(-1))} electrons; full well ${Math.round(histogram.full_well)}`);
  const high = edges.at(-1), most = Math.max(10, ...counts), step = 10 ** Math.floor(Math.log10(high));
  const wide = [1, 2, 5].map((f) => (f * step) / 10).concat(step).find((s) => high / s <= 5) ?? 2 * step;
  const x = { low: 0, high, log: false, ticks: Array.from({ length: Math.floor(high / wide) + 1 }, (_, i) => i * wide), label: "charge [e⁻]" };
  const powers = Array.from({ length: Math.ceil(Math.log10(most)) + 1 }, (_, i) => 10 ** i);
  const y = { low: 0.7, high: powers.at(-1), log: true, ticks: powers, label: "pixels [1]" };
  const box = { left: 52, right: width - 20, top: 20, bottom: height - 36 };
  const [px, py] = axes(svg, box, x, y);
  counts.forEach((n, i) => {
    if (n) svg.append(element("rect", { x: px(edges[i]), width: Math.max(px(edges[i + 1]) - px(edges[i]) - 0.3, 0.5), y: py(n), height: box.bottom - py(n), fill: "#0072b2" }));
  });
  const well = px(histogram.full_well);
  svg.append(element("line", { x1: well, x2: well, y1: box.top - 4, y2: box.bottom, stroke: "#d55e00", "stroke-width": 2 }));
  svg.append(element("text", { x: well - 4, y: 12, "text-anchor": "end" }, `full well; ${(100 * histogram.saturated).toPrecision(2)} % saturated`));
  return svg;
}

/* A 95 % ellipse about the estimate, and the truth beside it. */
function ellipseChart(ellipse, quantity, unit) {
  const width = 180, height = 200, svg = canvas(width, height, `95 % ellipse of ${quantity} in ${unit}; the truth lies ${ellipse.inside ? "inside" : "outside"}`);
  const reach = 1.25 * Math.max(ellipse.half[0], Math.hypot(...ellipse.truth), 1e-9);
  const step = 10 ** Math.floor(Math.log10(reach)), stop = [5, 2, 1].map((f) => f * step).find((s) => s <= reach);
  const box = { left: 58, right: width - 14, top: 8, bottom: height - 58 };
  const label = (name) => `${quantity} ${name} [${unit}]`;
  const show = (v) => Number(v.toPrecision(1));
  const scale = (box.right - box.left) / (2 * reach), cx = (box.left + box.right) / 2, cy = (box.top + box.bottom) / 2;
  for (const v of [-stop, 0, stop]) {
    svg.append(element("line", { x1: cx + v * scale, x2: cx + v * scale, y1: box.top, y2: box.bottom, stroke: "#ddd" }));
    svg.append(element("line", { x1: box.left, x2: box.right, y1: cy + v * scale, y2: cy + v * scale, stroke: "#ddd" }));
    svg.append(element("text", { x: cx + v * scale, y: box.bottom + 12, "text-anchor": "middle" }, tick(show(v))));
    svg.append(element("text", { x: box.left - 3, y: cy + v * scale + 4, "text-anchor": "end" }, tick(show(v))));
  }
  svg.append(element("text", { x: cx, y: box.bottom + 27, "text-anchor": "middle" }, label("x")));
  svg.append(element("text", { x: 10, y: cy, "text-anchor": "middle", transform: `rotate(-90 10 ${cy})` }, label("y")));
  svg.append(element("ellipse", {
    rx: ellipse.half[0] * scale, ry: ellipse.half[1] * scale, transform: `translate(${cx} ${cy}) rotate(${ellipse.angle_deg})`,
    fill: "#0072b2", "fill-opacity": 0.18, stroke: "#0072b2", "stroke-width": 1.5,
  }));
  svg.append(element("circle", { cx, cy, r: 2.5, fill: "#0072b2" }));
  const [x, y] = [cx + ellipse.truth[0] * scale, cy + ellipse.truth[1] * scale];
  svg.append(element("path", { d: `M${x - 5} ${y - 5}l10 10m0 -10l-10 10`, stroke: "#d55e00", "stroke-width": 2 }));
  svg.append(element("circle", { cx: 16, cy: height - 8, r: 2.5, fill: "#0072b2" }));
  svg.append(element("text", { x: 22, y: height - 4 }, "estimate"));
  svg.append(element("path", { d: `M90 ${height - 12}l8 8m0 -8l-8 8`, stroke: "#d55e00", "stroke-width": 2 }));
  svg.append(element("text", { x: 103, y: height - 4 }, "truth"));
  return svg;
}
