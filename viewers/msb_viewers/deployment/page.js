// The page of the comparison.
const state = { layout: meta.layout, pair: meta.pair.slice(), at: 0, divider: 0.5, top: meta.top };
const LAYOUTS = [["side", "Side by side"], ["wipe", "Wipe"], ["difference", "Difference"]];
const label = (tier) => meta.tiers.find((p) => p.tier === tier).label;
const shot = (tier, at = state.at) => meta.views[at].shots[tier];
const drawable = meta.tiers.filter((p) => p.drawable).map((p) => p.tier);

// PSNR in dB between two tiers. The value is a number or "identical". If an image is missing, it is
// undefined.
const decibels = (a, b, at = state.at) => meta.views[at].decibels[a < b ? `${a} ${b}` : `${b} ${a}`];
const inWords = (value) => (typeof value === "number" ? `${value.toFixed(2)} dB` : value);

function picture(tier, eager) {
  const { image, why } = shot(tier), view = meta.views[state.at];
  if (!image) {
    const box = make("div", undefined, "none");
    box.style.aspectRatio = `${view.width} / ${view.height}`;
    box.append(make("b", "N/A"), make("span", why));
    return box;
  }
  const img = make("img");
  Object.assign(img, { alt: `${label(tier)}, ${view.name}`, width: view.width, height: view.height, draggable: false });
  img.style.height = "auto";
  img.onload = () => img.classList.toggle("large", img.clientWidth > view.width);
  img.src = image;
  if (eager) img.decoding = "sync";
  return img;
}
function caption(tier) {
  const box = make("figcaption"), top = make("div", undefined, "top"), at = state.pair.indexOf(tier);
  if (at >= 0 && state.pair[0] !== state.pair[1]) top.append(make("span", "AB"[at], "badge"));
  top.append(make("b", label(tier)));
  const value = tier === state.pair[0] ? undefined : decibels(state.pair[0], tier);
  if (value !== undefined) top.append(make("b", `${inWords(value)} to A`, "found"));
  box.append(top, ...shot(tier).lines.map((line) => make("div", line, "faint")));
  return box;
}
function figureOf(tier) {
  const figure = make("figure");
  figure.append(picture(tier), caption(tier));
  return figure;
}
function pairFigures() {
  const box = make("div");
  box.id = "pair";
  box.append(...state.pair.map(figureOf));
  return box;
}
const absent = () => state.pair.find((tier) => !shot(tier).image);

function drawWipe() {
  const box = byId("wipe"), missing = absent();
  if (missing) { box.replaceChildren(picture(missing), caption(missing)); return; }
  const [a, b] = state.pair, view = meta.views[state.at], frame = make("div", undefined, "wipe");
  // Images are as large as possible, but not higher than the window.
  frame.style.maxWidth = `min(100%, ${(76 * view.width / view.height).toFixed(1)}vh)`;
  const [left, right] = [picture(a, true), picture(b, true)], line = make("div", undefined, "line"), across = make("input");
  Object.assign(across, { type: "range", min: 0, max: 1000, id: "across" });
  across.setAttribute("aria-label", `Divider: left of it ${label(a)}, right of it ${label(b)}`);
  const chips = [["A", a, "left"], ["B", b, "right"]].map(([letter, tier, side]) => {
    const chip = make("span", undefined, "chip");
    chip.style[side] = "6px";
    chip.append(make("span", letter, "badge"), ` ${label(tier)}`);
    return chip;
  });
  const place = () => {
    const percent = 100 * state.divider;
    right.style.clipPath = `inset(0 0 0 ${percent}%)`;
    line.style.left = `${percent}%`;
    across.value = Math.round(1000 * state.divider);
  };
  const follow = (event) => {
    const { left: start, width } = frame.getBoundingClientRect();
    state.divider = Math.min(Math.max((event.clientX - start) / width, 0), 1);
    place();
  };
  frame.onpointerdown = (event) => { frame.setPointerCapture(event.pointerId); follow(event); };
  frame.onpointermove = (event) => { if (event.buttons) follow(event); };
  across.oninput = () => { state.divider = across.value / 1000; place(); };
  frame.append(left, right, line, ...chips);
  const captions = make("div");
  captions.id = "pair";
  captions.append(caption(a), caption(b));
  box.replaceChildren(frame, across, captions);
  place();
}

const colorOf = (place) => {
  const at = Math.min(Math.max(place, 0), 1) * (meta.scale.length - 1), low = Math.min(Math.floor(at), meta.scale.length - 2);
  return meta.scale[low].map((x, i) => Math.round(x + (at - low) * (meta.scale[low + 1][i] - x)));
};
const ramp = Array.from({ length: 256 }, (_, i) => colorOf(i / 255));
async function pixels(tier) {
  const img = new Image();
  img.src = shot(tier).image;
  await img.decode();
  const canvas = make("canvas");
  Object.assign(canvas, { width: img.naturalWidth, height: img.naturalHeight });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(img, 0, 0);
  return context.getImageData(0, 0, canvas.width, canvas.height);
}
let drawing = 0;
async function drawMap() {
  const box = byId("map"), missing = absent(), number = ++drawing;
  if (missing) { box.replaceChildren(picture(missing), caption(missing)); return; }
  const [a, b] = state.pair, [first, second] = await Promise.all([pixels(a), pixels(b)]);
  if (number !== drawing) return;
  // The root mean square of red, green and blue at each pixel, as in `difference.py`.
  const out = new ImageData(first.width, first.height), x = first.data, y = second.data;
  for (let i = 0; i < x.length; i += 4) {
    const squared = (x[i] - y[i]) ** 2 + (x[i + 1] - y[i + 1]) ** 2 + (x[i + 2] - y[i + 2]) ** 2;
    const color = ramp[Math.min(Math.floor(Math.sqrt(squared / 3) / state.top), 255)];
    out.data.set([color[0], color[1], color[2], 255], i);
  }
  const canvas = make("canvas");
  Object.assign(canvas, { width: first.width, height: first.height, id: "heat" });
  canvas.style.maxWidth = `min(100%, ${(70 * first.width / first.height).toFixed(1)}vh)`;
  canvas.style.margin = "0 auto";
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `Difference of ${label(a)} and ${label(b)}`);
  canvas.getContext("2d").putImageData(out, 0, 0);
  const figure = make("div", inWords(decibels(a, b)));
  figure.id = "figure";
  const bar = make("div"), ticks = make("div");
  bar.id = "bar";
  bar.style.background = `linear-gradient(to right, ${meta.scale.map((c) => `rgb(${c})`).join(", ")})`;
  ticks.id = "ticks";
  for (let i = 0; i < 5; i++) ticks.append(make("span", `${state.top * i / 4}${i === 4 && state.top < 1 ? " or more" : ""}`));
  box.replaceChildren(canvas, figure, make("div", `PSNR of B (${label(b).toLowerCase()}) with respect to A (${label(a).toLowerCase()}), both as 8-bit images`, "faint"),
    bar, ticks, make("div", "difference per pixel: root mean square of red, green and blue; black and white differ by 1", "faint"), pairFigures());
  canvas.classList.toggle("large", canvas.clientWidth > first.width);
}

function scores() {
  const box = byId("scores"), others = drawable.filter((tier) => tier !== state.pair[0]);
  if (!others.length) { box.replaceChildren(); return; }
  const table = make("table"), head = table.createTHead().insertRow(), body = table.createTBody(), foot = table.createTFoot().insertRow();
  table.createCaption().textContent = `PSNR in dB with respect to A (${label(state.pair[0]).toLowerCase()})`;
  const header = (row, text) => { const cell = make("th", text); row.append(cell); return cell; };
  ["Camera", ...others.map(label)].forEach((text) => header(head, text));
  meta.views.forEach((view, at) => {
    const row = body.insertRow();
    row.className = at === state.at ? "shown" : "";
    row.onclick = () => { state.at = at; draw(); };
    header(row, view.name);
    for (const tier of others) {
      const value = decibels(state.pair[0], tier, at);
      row.insertCell().textContent = value === undefined ? "N/A" : typeof value === "number" ? value.toFixed(2) : value;
    }
  });
  header(foot, `average of ${meta.views.length}`);
  for (const tier of others) {
    const values = meta.views.map((_, at) => decibels(state.pair[0], tier, at));
    // For the average, identical images have the maximum PSNR of msb.metrics.
    const known = values.filter((v) => v !== undefined).map((v) => (v === "identical" ? meta.cap : v));
    foot.insertCell().textContent = known.length === values.length ? (known.reduce((x, y) => x + y, 0) / known.length).toFixed(2) : "N/A";
  }
  box.replaceChildren(table);
}

function choice(text, options, value, change) {
  const box = make("label", text), select = make("select");
  for (const [key, name] of options) select.append(new Option(name, key, false, String(key) === String(value)));
  select.onchange = () => { change(select.value); draw(); };
  box.append(select);
  return box;
}
function button(text, action, name) {
  const node = make("button", text);
  node.onclick = action;
  if (name) node.setAttribute("aria-label", name);
  return node;
}
function controls() {
  const layouts = make("span", undefined, "group");
  LAYOUTS.forEach(([key, text]) => {
    const node = button(text, () => setLayout(key));
    node.setAttribute("aria-pressed", state.layout === key);
    node.disabled = key !== "side" && drawable.length < 2;
    layouts.append(node);
  });
  const parts = [layouts];
  if (drawable.length > 1) {
    const options = drawable.map((tier) => [tier, label(tier)]);
    [0, 1].forEach((side) => parts.push(choice("AB"[side], options, state.pair[side], (tier) => put(side, tier))));
  }
  if (meta.views.length > 1) {
    const steps = make("span", undefined, "group");
    steps.append(button("◂", () => step(-1), "previous camera"), button("▸", () => step(1), "next camera"));
    parts.push(choice(`Camera ${state.at + 1} of ${meta.views.length}`, meta.views.map((v, i) => [i, v.name]), state.at, (at) => { state.at = Number(at); }), steps);
  }
  if (state.layout === "difference")
    parts.push(choice("brightest at", meta.tops.map((t) => [t, t]), state.top, (top) => { state.top = Number(top); }));
  parts.push(button("Help (H)", help));
  byId("controls").replaceChildren(...parts);
}
function draw() {
  const had = document.activeElement?.textContent;
  controls();
  byId("side").hidden = state.layout !== "side";
  byId("wipe").hidden = state.layout !== "wipe";
  byId("map").hidden = state.layout !== "difference";
  if (state.layout === "side") byId("side").replaceChildren(...meta.tiers.map((p) => figureOf(p.tier)));
  if (state.layout === "wipe") drawWipe();
  if (state.layout === "difference") drawMap();
  scores();
  // The page controls were replaced, so restore the keyboard focus.
  [...byId("controls").querySelectorAll("button, select")].find((node) => had && node.textContent === had)?.focus();
}
const setLayout = (layout) => { if (layout === "side" || drawable.length > 1) { state.layout = layout; draw(); } };
function put(side, tier) {
  if (tier === state.pair[1 - side]) state.pair.reverse();
  else state.pair[side] = tier;
}
function next(side) {
  const choices = drawable.filter((tier) => tier !== state.pair[1 - side]);
  if (choices.length) state.pair[side] = choices[(choices.indexOf(state.pair[side]) + 1) % choices.length];
}
const step = (by) => { state.at = (state.at + by + meta.views.length) % meta.views.length; draw(); };
const help = () => showKeys([["1 / 2 / 3", "side by side, wipe, difference"], ["A / B", "next tier for image A / image B"],
  ["N / P", "next / previous camera"], ["+ / -", "brighten / darken the difference"], ["← / →", "move the divider of the wipe, or drag it"], ["H", "this help"]]);
onkeydown = (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || ["SELECT", "INPUT"].includes(event.target.tagName)) return;
  const bright = (by) => { state.top = meta.tops[Math.min(Math.max(meta.tops.indexOf(state.top) + by, 0), meta.tops.length - 1)]; draw(); };
  const slide = (by) => { state.divider = Math.min(Math.max(state.divider + by * 0.02, 0), 1); draw(); };
  const actions = { 1: () => setLayout("side"), 2: () => setLayout("wipe"), 3: () => setLayout("difference"), a: () => { next(0); draw(); }, b: () => { next(1); draw(); },
    n: () => step(1), p: () => step(-1), "+": () => bright(1), "=": () => bright(1), "-": () => bright(-1), arrowleft: () => slide(-1), arrowright: () => slide(1),
    h: help, escape: () => { byId("help").hidden = true; } };
  const action = actions[event.key.toLowerCase()];
  if (action) { event.preventDefault(); action(); }
};
document.title = `${meta.name} - msb compare`;
byId("head").append(make("h1", meta.name), make("p", meta.subtitle), make("p", meta.settings, "faint"));
// If the page address ends in #view=3&layout=wipe, the page opens at this view and layout.
const wanted = new URLSearchParams(location.hash.slice(1));
if (wanted.get("view") > 0 && wanted.get("view") <= meta.views.length) state.at = wanted.get("view") - 1;
if (LAYOUTS.some(([key]) => key === wanted.get("layout"))) state.layout = wanted.get("layout");
if (drawable.length < 2) state.layout = "side";
draw();
