"use strict";
// The page of the dedicated tier.
// The canvas of the native rendering (WebGPU) lies above the canvas of the mesh (WebGL).
const about = start.dedicated;
const nativeCanvas = byId("native");
const SLOW = 60;        // milliseconds per frame; slower devices draw at a lower resolution while the camera moves
const WIPE_KEYS = { ArrowLeft: -0.02, ArrowRight: 0.02 };
let native = null;      // the native rendering, an object of the class Dedicated; null without WebGPU
let meshArrays = null;  // the arrays of the standard-tier mesh, until the mesh is created
const meshes = {};      // the three.js meshes by name: "standard" and "baked"
let degree = about.view.degree;
let members = { ...about.view.own };  // the method's members of the camera's uniform buffer
const REPLACEMENT = about.baked
  ? "The mesh that msb bake made from this model is shown instead."
  : about.standard.grey
  ? `The triangles are shown in grey instead, because ${about.title} models have colours only in their native rendering.`
  : "The standard mesh, which any engine can draw, is shown instead.";
const GREY_LABEL = "grey triangles";
const note = (text) => { byId("note").textContent = text; byId("note").hidden = !text; };

// The reason why the native rendering is missing, and a remedy.
let reason = "", remedy = "";
// Shows a note about the missing native rendering and about the mesh that replaces it.
function explainReplacement() {
  const lost = "The WebGL context was lost as well, so nothing can be drawn. Reload the page.";
  note(gl.isContextLost() ? `${reason} ${lost}` : `${reason} ${REPLACEMENT}${remedy}`);
}
onWebGlChange = (lost) => {
  if (reason) explainReplacement();
  else note(lost ? "The WebGL context was lost, so the mesh cannot be drawn. Reload the page." : "");
};

// ---- arrays

// Returns an array of the page.
// An array can be read from the page only once, so `cache` keeps the arrays that the standard-tier mesh also needs.
async function arrayOf(name, cache) {
  if (cache[name]) return cache[name];
  const { shrunk: source, ...head } = about.arrays[name];
  const array = source ? shrink(await arrayOf(source.of, cache), source.factor) : await storedArray(name, head);
  if (Object.values(about.standard).includes(name) || name === source?.of) cache[name] = array;
  return array;
}

// Returns the static colours clamp(C0 f_dc + 0.5) as bytes.
// Pass `corners` = 3 if f_dc has one row per face, else 1.
function staticColors(f_dc, corners) {
  const colors = new Uint8Array(f_dc.length * corners);
  for (let i = 0; i < f_dc.length; i += 1) {
    const value = Math.round(255 * Math.min(1, Math.max(0, 0.28209479177387814 * f_dc[i] + 0.5)));
    const row = Math.floor(i / 3), channel = i % 3;
    for (let k = 0; k < corners; k += 1) colors[3 * (corners * row + k) + channel] = value;
  }
  return colors;
}

// Creates the standard-tier mesh with the selected faces from `meshArrays`.
function makeMesh() {
  const { positions, indices, colors, shown: selected, soup } = meshArrays;
  meshArrays = null;
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
  if (colors) geometry.setAttribute("color", new THREE.BufferAttribute(staticColors(colors, soup ? 3 : 1), 3, true));
  let drawn = indices;
  if (selected) {
    drawn = new Uint32Array(3 * selected.reduce((sum, flag) => sum + flag, 0));
    for (let face = 0, to = 0; face < selected.length; face += 1) {
      for (let k = 3 * face; selected[face] && k < 3 * face + 3; k += 1, to += 1) drawn[to] = indices ? indices[k] : k;
    }
  }
  if (drawn) geometry.setIndex(new THREE.BufferAttribute(drawn, 1));
  setColors("stored");
  meshes.standard = new THREE.Mesh(geometry);
  setMesh(new THREE.Group().add(...Object.values(meshes)));
}

// ---- layers

// The mesh to show for each choice in the panel.
const MESH = { standard: "standard", wipe: "standard", baked: "baked", "wipe-baked": "baked" };
const wipes = () => byId("shown").value.startsWith("wipe");
const showsNative = () => byId("shown").value === "dedicated" || wipes();
if (about.baked) {
  const db = (value) => (value === null ? "" : ` (${value.toFixed(1)} dB)`);
  byId("shown").append(new Option("baked mesh" + db(about.baked.psnr), "baked"), new Option("native | baked mesh (split view)", "wipe-baked"));
  byId("shown").querySelector("option[value=standard]").textContent += db(about.baked.plain);
  byId("shown").title = `dB: average PSNR of the mesh against ${about.against}, in ${about.tests.length} views with one sample per pixel. Higher is better.`;
}

let busy = false, again = false, milliseconds = 0;
function drawNative(view) {
  if (!native || !showsNative()) return;
  if (busy) { again = true; return; }
  busy = true;
  const begun = performance.now(), size = state.moving ? movingScale(milliseconds) : 1;
  native.draw(scaleView(view, size), state.background, degree, members).then(() => {
    const took = performance.now() - begun;
    // Estimate the time at full size.
    // The time is nearly proportional to the number of pixels.
    milliseconds = size === 1 ? took : Math.max(milliseconds * 0.9, took);
    const time = took < 10 ? `${took.toFixed(1)} ms` : took < 2000 ? `${Math.round(took)} ms` : `${(took / 1000).toFixed(1)} s`;
    byId("frame").textContent = `${time} per frame` +
      (size < 1 ? `, at ${Math.round(100 * size)} % of the resolution while moving` : "");
  }, (error) => { if (native) note(`This frame cannot be drawn: ${error.message || error}`); }).finally(() => {
    busy = false;
    if (again) { again = false; show(); }
  });
}
// Returns the resolution scale for a moving camera, computed from the milliseconds of a frame.
const movingScale = (took) => (took < SLOW ? 1 : took < 4 * SLOW ? 0.5 : 0.25);

function scaleView(view, factor) {
  if (factor === 1) return view;
  const width = Math.max(1, Math.round(view.width * factor)), height = Math.max(1, Math.round(view.height * factor));
  const x = width / view.width, y = height / view.height;
  return { ...view, width, height, fx: view.fx * x, cx: view.cx * x, fy: view.fy * y, cy: view.cy * y };
}

layers[0] = (view) => {
  const what = MESH[byId("shown").value];
  if (!what) return;
  if (meshArrays) makeMesh();
  for (const [name, mesh] of Object.entries(meshes)) mesh.visible = name === what;
  showMesh(view);
};
layers.push(drawNative);

let share = 0.5;  // share of the window's width that shows the native rendering in the split view
// Shows the canvases and the divider for the current choice.
function layOut() {
  const what = byId("shown").value;
  nativeCanvas.hidden = !native || !showsNative();
  canvas.hidden = what === "dedicated";
  byId("wipe").hidden = !wipes();
  if (wipes()) {
    const label = about.standard.grey && what === "wipe" ? GREY_LABEL : `${MESH[what]} mesh`;
    byId("wipe").querySelector("b:last-of-type").textContent = label;
  }
  byId("wipe").style.left = `${100 * share}%`;
  byId("grip").ariaValueNow = Math.round(100 * share);
  nativeCanvas.style.clipPath = wipes() ? `inset(0 ${100 * (1 - share)}% 0 0)` : "";
}
function wipeTo(x) {
  share = Math.min(0.98, Math.max(0.02, x));
  layOut();
}
byId("shown").addEventListener("change", () => { layOut(); show(); });
byId("grip").addEventListener("pointerdown", (event) => byId("grip").setPointerCapture(event.pointerId));
byId("grip").addEventListener("pointermove", (event) => {
  if (byId("grip").hasPointerCapture(event.pointerId)) wipeTo(event.clientX / window.innerWidth);
});
byId("grip").addEventListener("keydown", (event) => {
  if (event.key in WIPE_KEYS) wipeTo(share + WIPE_KEYS[event.key]);
});
saveImage = () => {
  if (!showsNative()) { layers[0](state.view); download(canvas); return; }
  native.draw(state.view, state.background, degree, members);
  download(nativeCanvas);
};

// ---- settings that change only the camera's uniform buffer

// Adds a drop-down list to the panel.
// `changed` is called with the index of the chosen option.
function addSetting(name, options, value, changed) {
  const label = document.createElement("label"), select = document.createElement("select");
  select.replaceChildren(...options.map((text, k) => new Option(text, k)));
  select.value = String(value);
  select.dataset.setting = name;
  select.addEventListener("change", async () => { await changed(Number(select.value)); show(); });
  label.append(`${name} `, select);
  byId("settings").append(label);
}
if (about.view.degree > 0) {
  const degrees = Array.from({ length: about.view.degree + 1 }, (_, k) => String(k));
  addSetting("SH degree", degrees, degree, (k) => { degree = k; });  // degree of the spherical harmonics
}
for (const { name, value, options } of about.settings) {
  const texts = options.map((option) => ({ true: "on", false: "off" })[option.value] ?? String(option.value));
  addSetting(name.replaceAll("_", " "), texts, options.findIndex((option) => option.value === value), (k) => Object.assign(members, options[k].own));
}

// The orders of the faces and the rules of sampling.
// Each combination is a separate plan, which is compiled when it is chosen.
const ORDERS = { tile: "per tile (official)", global: "by depth", none: "unsorted" };
const SAMPLINGS = { official: "official", engine: "as game engines do" };
const mode = { order: "tile", sampling: "official" };
async function setMode(changed) {
  Object.assign(mode, changed);
  // The sampling "engine" has no plan for "global", because it uses no tiles.
  const fits = (plan) => plan.sampling === mode.sampling && plan.order === mode.order;
  let number = about.plans.findIndex(fits);
  if (number < 0) number = about.plans.findIndex((plan) => plan.sampling === mode.sampling);
  if (!native || number === native.wanted) return;
  note("Compiling shaders ...");
  try {
    await native.use(number);
    if (native) note("");
  } catch (error) { if (native) note(String(error.message || error).slice(0, 300)); }
}
for (const [label, name, texts] of [["Sorting", "order", ORDERS], ["Sampling", "sampling", SAMPLINGS]]) {
  const keys = Object.keys(texts).filter((key) => about.plans.some((plan) => plan[name] === key));
  if (keys.length > 1) addSetting(label, keys.map((key) => texts[key]), 0, (k) => setMode({ [name]: keys[k] }));
}

// ---- opening the model

// Shows progress in the middle of the window and in the panel, which may cover the middle.
function reportProgress(text) {
  say(`${start.name}: ${text}`);
  byId("facts").textContent = text;
}

async function openFirst() {
  const cache = {};
  byId("name").textContent = byId("name").title = start.name;
  for (const part of document.querySelectorAll("#panel select, #panel input, #panel button")) part.disabled = true;
  try {
    native = await Dedicated.open(about, nativeCanvas, (name) => arrayOf(name, cache), reportProgress);
    native.device.onuncapturederror = (event) => note(`The graphics device cannot draw this frame: ${event.error.message.slice(0, 200)}`);
    native.lost.then((info) => {
      for (const select of document.querySelectorAll("#settings select")) select.disabled = true;
      native = null;
      byId("shown").value = about.baked ? "baked" : "standard";
      layOut();
      reason = `The graphics device was lost${info.message ? ` (${info.message.slice(0, 120)})` : ""}.`;
      remedy = " Reload the page for the native rendering.";
      explainReplacement();
      show();
    });
  } catch (error) { reason = String(error.message || error).slice(0, 300); }
  const parts = { soup: about.standard.soup };
  try {
    for (const part of ["positions", "indices", "colors", "shown"]) {
      const name = about.standard[part];
      parts[part] = name ? await arrayOf(name, cache) : null;
    }
  } catch (error) { say(`${start.name} cannot be shown: ${error.message || error}`); return false; }
  meshArrays = parts;
  if (about.baked) meshes.baked = (await parseGlb(embeddedFile())).scene;
  const sphere = about.sphere;
  setName(start.name, about.faces, new THREE.Vector3(...sphere.center), sphere.radius);
  byId("facts").textContent = `${about.title}, ${about.faces.toLocaleString("en")} faces` +
    (about.all_faces > about.faces ? ` of ${about.all_faces.toLocaleString("en")}` : "");
  for (const option of byId("shown").options) option.disabled = !["standard", "baked"].includes(option.value) && !native;
  if (about.standard.grey) document.querySelector("option[value=standard]").textContent = GREY_LABEL;
  byId("shown").value = native ? "dedicated" : about.baked ? "baked" : "standard";
  if (!native) explainReplacement();
  if (native) byId("frame").title = native.name;
  say("");
  for (const part of document.querySelectorAll("#panel select, #panel input, #panel button")) part.disabled = false;
  for (const part of document.querySelectorAll("#settings select")) part.disabled = !native;
  layOut();
  showQuality();
  return true;
}
