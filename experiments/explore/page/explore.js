"use strict";
/* Builds the controls, asks the server for each state, shows the answer. One question is under way at a time; while it is, only the
   newest move is kept. */
const root = document.documentElement, byId = (id) => document.getElementById(id);
const state = {}, inputs = {};
let controls = [], busy = false, moved = null, waiting = null;
/* For tests and the curious: milliseconds from each move to the page showing its answer. */
const moves = [];

function make(name, properties = {}, ...children) {
  const made = Object.assign(document.createElement(name), properties);
  made.append(...children);
  return made;
}

const written = (value) => (value === true ? "1" : value === false ? "0" : String(value));
const query = () => new URLSearchParams(controls.filter((c) => state[c.key] !== c.start).map((c) => [c.key, written(state[c.key])])).toString();
const nearest = (values, value) => values.reduce((best, v, i) => (Math.abs(Math.log(v / value)) < Math.abs(Math.log(values[best] / value)) ? i : best), 0);

function build(described) {
  controls = described.controls;
  byId("title").textContent = described.title;
  const groups = {};
  for (const control of controls) {
    const group = (groups[control.group] ??= byId("controls").appendChild(make("fieldset", {}, make("legend", { textContent: control.group }))));
    group.append(inputs_of(control));
    state[control.key] = control.start;
  }
}

function inputs_of(control) {
  const id = `c-${control.key.replaceAll(".", "-")}`, output = make("output");
  const change = (value) => {
    state[control.key] = value;
    if (control.key === "exposure_s") state.exposure = "fixed";
    ask();
  };
  if (control.kind === "slider") {
    const slider = make("input", { type: "range", id, min: 0, max: control.values.length - 1, step: 1 });
    slider.addEventListener("input", () => change(control.values[slider.valueAsNumber]));
    const ready = make("div", { className: "ready" }, ...(control.live ? [] : control.values.map(() => make("i"))));
    ready.setAttribute("aria-hidden", "true");
    inputs[control.key] = { slider, output, ready };
    output.setAttribute("for", id);
    return make("div", { className: "control", title: control.about }, make("label", { htmlFor: id }, make("span", { textContent: control.label }), output), slider, ...(control.live ? [] : [ready]));
  }
  if (control.kind === "choice") {
    const select = make("select", { id }, ...control.values.map((v, i) => make("option", { value: written(v), textContent: control.texts[i] })));
    select.addEventListener("change", () => change(control.values[select.selectedIndex]));
    inputs[control.key] = { select };
    return make("div", { className: "control", title: control.about }, make("label", { htmlFor: id, textContent: control.label }), select);
  }
  const radios = control.values.map((v, i) => {
    const radio = make("input", { type: "radio", name: id, value: written(v), id: `${id}-${i}` });
    radio.addEventListener("change", () => change(v));
    return radio;
  });
  inputs[control.key] = { radios };
  const box = make("div", { className: "switch" }, ...radios.map((radio, i) => make("label", {}, radio, control.texts[i])));
  box.setAttribute("role", "radiogroup");
  box.setAttribute("aria-label", control.label);
  return make("div", { className: "control", title: control.about }, make("div", { className: "named" }, make("span", { textContent: control.label })), box);
}

function show_controls(answer) {
  for (const control of controls) {
    const { slider, output, ready, select, radios } = inputs[control.key], value = state[control.key];
    if (slider) {
      const automatic = control.key === "exposure_s" && state.exposure === "auto";
      const shown = automatic && answer?.numbers ? answer.numbers.exposure_s : value;
      const exact = control.values.indexOf(shown), index = exact >= 0 ? exact : nearest(control.values, shown);
      const text = automatic ? `auto: ${answer?.numbers?.exposure_text ?? "…"}` : exact >= 0 ? control.texts[index] : `${shown} ${control.unit}`;
      slider.value = index;
      slider.setAttribute("aria-valuetext", text);
      output.textContent = text;
      slider.disabled = control.key === "sun.phase_deg" && state.illumination === "eclipse";
      if (answer && !control.live) [...ready.children].forEach((dot, i) => dot.classList.toggle("yes", answer.ready[control.key][i]));
    }
    if (select) select.selectedIndex = control.values.indexOf(value);
    if (radios) radios.forEach((radio, i) => (radio.checked = control.values[i] === value));
  }
}

/* A move: ask now, or as soon as the question under way is answered. */
function ask() {
  moved = performance.now();
  clearTimeout(waiting);
  show_controls(null);
  if (!busy) question("answer", query());
}

async function question(kind, asked) {
  const began = moved;
  [busy, moved] = [true, null];
  root.dataset.state = root.dataset.state === "loading" ? "loading" : "busy";
  let answer = null, problem = "";
  try {
    const reply = await fetch(`${kind}?${asked}`);
    answer = await reply.json();
    problem = answer.error ?? "";
  } catch {
    problem = "The server does not answer; is `mantis explore` still running?";
  }
  busy = false;
  byId("error").hidden = !problem;
  byId("error").textContent = problem;
  if (moved !== null) return question("answer", query());
  if (problem) return void (root.dataset.state = "failed");
  show(answer, kind, began);
}

function show(answer, kind, began) {
  Object.assign(state, answer.state);
  show_controls(answer);
  const address = answer.query ? `?${answer.query}` : location.pathname;
  history.replaceState(null, "", address);
  byId("link").href = address;
  byId("save").href = `scenario.toml?${answer.query}`;
  if (answer.numbers) show_numbers(answer.numbers);
  const ranges = controls.find((control) => control.key === "range_m").values;
  if (answer.curve) byId("curve").replaceChildren(curveChart(answer.curve, state.range_m, ranges[0], ranges.at(-1), answer.curve_complete));
  if (answer.frame) show_frame(answer.frame);
  if (!answer.numbers) {
    byId("verdict").textContent = "Computing this point …";
    byId("verdict").className = "";
  }
  byId("doing").textContent = answer.doing ? `Rendering aside: ${answer.doing}.` : "";
  root.dataset.state = answer.pending ? "pending" : "ready";
  if (began !== null && answer.frame) {
    moves.push(performance.now() - began);
    byId("took").textContent = `Recomputed in ${Math.round(moves.at(-1))} ms.`;
  } else if (answer.frame) byId("took").textContent = "Rendered.";
  else if (answer.pending) byId("took").textContent = "This geometry is being rendered; until then pictures show the one before.";
  const unseen = !answer.pending && !answer.frame && kind === "numbers" && root.dataset.frame !== answer.query;
  if (answer.frame) root.dataset.frame = answer.query;
  if (unseen) question("answer", answer.query);
  else if (answer.pending || answer.doing || !answer.curve_complete) waiting = setTimeout(() => !busy && question("numbers", query()), answer.pending ? 150 : 700);
}

function show_numbers(numbers) {
  const verdict = byId("verdict"), text = `${numbers.closes ? "✓" : "✗"} ${numbers.verdict}`;
  if (verdict.textContent !== text) verdict.textContent = text;
  verdict.className = numbers.closes ? "pass" : "fail";
  byId("gauges").replaceChildren(...numbers.gauges.map((gauge) => {
    const along = (v) => `${100 * Math.min(Math.max(Math.log(Math.max(v, gauge.low) / gauge.low) / Math.log(gauge.high / gauge.low), 0), 1)}%`;
    const bar = make("div", { className: "bar" }, make("i"), make("s"));
    bar.children[0].style.width = along(gauge.value ?? gauge.low);
    bar.children[1].style.left = along(gauge.limit);
    const mark = gauge.passed === null ? "" : gauge.passed ? "✓ " : "✗ ";
    const word = make("span", { className: "unseen", textContent: gauge.passed === null ? "" : gauge.passed ? "passes" : "fails" });
    const made = make("div", { className: `gauge ${gauge.passed === null ? "" : gauge.passed ? "pass" : "fail"}` },
      make("span", { textContent: gauge.label }), make("b", {}, mark + gauge.text, word), make("span", { className: "limit", textContent: gauge.limit_text }), bar);
    made.dataset.name = gauge.name;
    return made;
  }));
}

function show_frame(frame) {
  const marker = byId("marker"), found = frame.lines.join(" ");
  marker.src = `data:image/svg+xml,${encodeURIComponent(frame.marker_svg)}`;
  marker.alt = `The marker, enlarged ${frame.enlarged} times. ${found}`;
  byId("found").textContent = frame.detection.detected ? `Marker ${frame.detection.id} found; ${frame.detection.reason ?? "all four blobs"}.` : `Not found: ${frame.detection.reason}.`;
  byId("frame").src = `data:image/png;base64,${frame.frame_png}`;
  const [width, height] = frame.frame_px, [x, y, w, h] = frame.crop, crop = byId("crop").style;
  [crop.left, crop.top, crop.width, crop.height] = [x / width, y / height, w / width, h / height].map((share) => `${100 * share}%`);
  byId("frame-text").textContent = `${width} × ${height} px; grey is the square root of the signal, the square is the picture above.`;
  byId("histogram").replaceChildren(histogramChart(frame.histogram));
  const pose = frame.pose;
  byId("pose").replaceChildren(...(pose ? [ellipseChart(pose.across_mm, "position", "mm"), ellipseChart(pose.tilt_deg, "tilt about", "°")] : []));
  byId("pose-text").textContent = pose
    ? `${pose.within ? "✓" : "✗"} Attitude error ${pose.attitude_text}, range error ${pose.range_text}; stated ${pose.sigma_text}${pose.ambiguous ? "; ambiguous" : ""}.`
    : "No pose.";
  byId("models").replaceChildren(...frame.models.map((row) => make("tr", {}, Object.assign(make("th", { textContent: row.model }), { scope: "row" }), ...row.texts.map((text) => make("td", { textContent: text })))));
}

(async () => {
  try {
    build(await (await fetch("controls")).json());
    moved = performance.now();
    await question("answer", location.search.slice(1));
    const problem = byId("error").textContent;
    if (root.dataset.state !== "failed") return;
    await question("answer", ""); // a link with a mistake: the start is shown, and what was wrong with the link
    byId("error").hidden = false;
    byId("error").textContent = problem;
  } catch {
    byId("error").hidden = false;
    byId("error").textContent = "The server does not answer; is `mantis explore` still running?";
  }
})();
