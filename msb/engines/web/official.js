"use strict";
// The page of the dedicated tier: the method's own look by WebGPU, over the standard mesh by WebGL.
const about = start.dedicated;
const top_ = byId("official");
const SLOW = 60;        // milliseconds of a frame from which moving pictures are drawn in fewer pixels
const WIPE_KEYS = { ArrowLeft: -0.02, ArrowRight: 0.02 };
let official = null;    // a Dedicated
let meshParts = null;   // what the standard mesh is made of, until it is made
const meshes = {};      // the standard one, and what was baked if that is in the page
let degree = about.view.degree;
let own = { ...about.view.own };
const INSTEAD = about.baked
  ? "This is what msb bake made of the model: a plain mesh that was taught to look like it"
  : about.standard.grey
  ? `These are the triangles in grey: ${about.title} has no colours without its decoder`
  : "This is the standard tier: the mesh as any engine draws it";
const GREY = "grey triangles";
const note = (text) => { byId("note").textContent = text; byId("note").hidden = !text; };

// Why there is no dedicated tier, if so; what is shown instead is said anew when WebGL comes and goes.
let why = "", cure = "";
function noteInstead() {
  note(`${why} ${gl.isContextLost() ? "WebGL was lost, too, so nothing is drawn; reload the page" : INSTEAD + cure}.`);
}
webGlLost = (lost) => {
  if (why) noteInstead();
  else note(lost ? "WebGL was lost, so the standard tier is not drawn; reload the page for it." : "");
};

// ---- arrays

// Arrays that the standard mesh needs are kept until it is made.
async function arrayOf(name, kept) {
  if (kept[name]) return kept[name];
  const { shrunk: from, ...head } = about.arrays[name];
  const found = from ? shrunk(await arrayOf(from.of, kept), from.factor) : await storedArray(name, head);
  if (Object.values(about.standard).includes(name) || name === from?.of) kept[name] = found;
  return found;
}

// clamp(C0 f_dc + 0.5), for each corner of a face if colours belong to faces.
function bakedColors(f_dc, corners) {
  const found = new Uint8Array(f_dc.length * corners);
  for (let i = 0; i < f_dc.length; i += 1) {
    const value = Math.round(255 * Math.min(1, Math.max(0, 0.28209479177387814 * f_dc[i] + 0.5)));
    const row = Math.floor(i / 3), channel = i % 3;
    for (let k = 0; k < corners; k += 1) found[3 * (corners * row + k) + channel] = value;
  }
  return found;
}

function makeMesh() {
  const { positions, indices, colors, shown, soup } = meshParts;
  meshParts = null;
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
  if (colors) geometry.setAttribute("color", new THREE.BufferAttribute(bakedColors(colors, soup ? 3 : 1), 3, true));
  let drawn = indices;
  if (shown) {
    drawn = new Uint32Array(3 * shown.reduce((sum, one) => sum + one, 0));
    for (let face = 0, to = 0; face < shown.length; face += 1) {
      for (let k = 3 * face; shown[face] && k < 3 * face + 3; k += 1, to += 1) drawn[to] = indices ? indices[k] : k;
    }
  }
  if (drawn) geometry.setIndex(new THREE.BufferAttribute(drawn, 1));
  setColors("stored");
  meshes.standard = new THREE.Mesh(geometry);
  setMesh(new THREE.Group().add(...Object.values(meshes)));
}

// ---- layers

// What is chosen -> the mesh that it shows.
const MESH = { standard: "standard", wipe: "standard", baked: "baked", "wipe-baked": "baked" };
const wipes = () => byId("shown").value.startsWith("wipe");
const showsOfficial = () => byId("shown").value === "dedicated" || wipes();
if (about.baked) {
  const db = (value) => (value === null ? "" : ` (${value.toFixed(1)} dB)`);
  byId("shown").append(new Option("baked" + db(about.baked.psnr), "baked"), new Option("baked, with a wipe", "wipe-baked"));
  byId("shown").querySelector("option[value=standard]").textContent += db(about.baked.plain);
  byId("shown").querySelector("option[value=wipe]").textContent = "standard, with a wipe";
  byId("shown").title = `dB are of the mesh to ${about.against}, with one sample a pixel, in the mean of ${about.tests.length} views`;
}

let busy = false, again = false, milliseconds = 0;
function showOfficial(view) {
  if (!official || !showsOfficial()) return;
  if (busy) { again = true; return; }
  busy = true;
  const begun = performance.now(), size = state.moving ? fewer(milliseconds) : 1;
  official.draw(resized(view, size), state.background, degree, own).then(() => {
    const took = performance.now() - begun;
    // Of the frame in full size: pixels take most of the time.
    milliseconds = size === 1 ? took : Math.max(milliseconds * 0.9, took);
    const time = took < 10 ? `${took.toFixed(1)} ms` : took < 2000 ? `${Math.round(took)} ms` : `${(took / 1000).toFixed(1)} s`;
    byId("frame").textContent = `${time} a frame` +
      (size < 1 ? `, at ${Math.round(100 * size)} % of the size while it moves` : "");
  }, (error) => { if (official) note(`This frame cannot be drawn: ${error.message || error}`); }).finally(() => {
    busy = false;
    if (again) { again = false; show(); }
  });
}
const fewer = (took) => (took < SLOW ? 1 : took < 4 * SLOW ? 0.5 : 0.25);

function resized(view, factor) {
  if (factor === 1) return view;
  const width = Math.max(1, Math.round(view.width * factor)), height = Math.max(1, Math.round(view.height * factor));
  const x = width / view.width, y = height / view.height;
  return { ...view, width, height, fx: view.fx * x, cx: view.cx * x, fy: view.fy * y, cy: view.cy * y };
}

layers[0] = (view) => {
  const what = MESH[byId("shown").value];
  if (!what) return;
  if (meshParts) makeMesh();
  for (const [name, mesh] of Object.entries(meshes)) mesh.visible = name === what;
  showMesh(view);
};
layers.push(showOfficial);

let share = 0.5;  // of the window's width that is dedicated
function layOut() {
  const what = byId("shown").value;
  top_.hidden = !official || !showsOfficial();
  canvas.hidden = what === "dedicated";
  byId("wipe").hidden = !wipes();
  if (wipes()) byId("wipe").querySelector("b:last-of-type").textContent = about.standard.grey && what === "wipe" ? GREY : MESH[what];
  byId("wipe").style.left = `${100 * share}%`;
  byId("grip").ariaValueNow = Math.round(100 * share);
  top_.style.clipPath = wipes() ? `inset(0 ${100 * (1 - share)}% 0 0)` : "";
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
savePicture = () => {
  if (!showsOfficial()) { layers[0](state.view); download(canvas); return; }
  official.draw(state.view, state.background, degree, own);
  download(top_);
};
// ---- settings that change the camera record alone

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
  addSetting("SH degree", degrees, degree, (k) => { degree = k; });
}
for (const { name, value, options } of about.settings) {
  const texts = options.map((option) => ({ true: "on", false: "off" })[option.value] ?? String(option.value));
  addSetting(name, texts, options.findIndex((option) => option.value === value), (k) => Object.assign(own, options[k].own));
}

// Orders of the faces, and what samples them: each pair is a plan of its own, which is compiled when it is chosen.
const ORDERS = { tile: "official, in tiles", global: "by depth alone", none: "none: as stored" };
const SAMPLINGS = { official: "official", engine: "as an engine" };
const mode = { order: "tile", sampling: "official" };
async function setMode(changed) {
  Object.assign(mode, changed);
  // An engine has no tiles, so "by depth" is the same there.
  const fits = (plan) => plan.sampling === mode.sampling && plan.order === mode.order;
  let number = about.plans.findIndex(fits);
  if (number < 0) number = about.plans.findIndex((plan) => plan.sampling === mode.sampling);
  if (!official || number === official.wanted) return;
  note("Compiling shaders ...");
  try {
    await official.use(number);
    if (official) note("");
  } catch (error) { if (official) note(String(error.message || error).slice(0, 300)); }
}
for (const [name, texts] of [["order", ORDERS], ["sampling", SAMPLINGS]]) {
  const there = Object.keys(texts).filter((key) => about.plans.some((plan) => plan[name] === key));
  if (there.length > 1) addSetting(name, there.map((key) => texts[key]), 0, (k) => setMode({ [name]: there[k] }));
}

// ---- the beginning

// What the page waits for: in the middle, and in the panel, which may cover the middle.
function waitFor(text) {
  say(`${start.name}: ${text}`);
  byId("facts").textContent = text;
}

async function openFirst() {
  const kept = {};
  byId("name").textContent = byId("name").title = start.name;
  for (const part of document.querySelectorAll("#panel select, #panel input, #panel button")) part.disabled = true;
  try {
    official = await Dedicated.open(about, top_, (name) => arrayOf(name, kept), waitFor);
    official.device.onuncapturederror = (event) => note(`The graphics device refuses a frame: ${event.error.message.slice(0, 200)}`);
    official.lost.then((info) => {
      for (const select of document.querySelectorAll("#settings select")) select.disabled = true;
      official = null;
      byId("shown").value = about.baked ? "baked" : "standard";
      layOut();
      why = `The graphics device was lost${info.message ? ` (${info.message.slice(0, 120)})` : ""}.`;
      cure = "; reload the page for the dedicated tier";
      noteInstead();
      show();
    });
  } catch (error) { why = String(error.message || error).slice(0, 300); }
  const parts = { soup: about.standard.soup };
  try {
    for (const part of ["positions", "indices", "colors", "shown"]) {
      const name = about.standard[part];
      parts[part] = name ? await arrayOf(name, kept) : null;
    }
  } catch (error) { say(`${start.name} cannot be shown: ${error.message || error}`); return false; }
  meshParts = parts;
  if (about.baked) meshes.baked = (await parsed(ownFile())).scene;
  const sphere = about.sphere;
  setName(start.name, about.faces, new THREE.Vector3(...sphere.center), sphere.radius);
  byId("facts").textContent = `${about.title}, ${about.faces.toLocaleString("en")} faces` +
    (about.all_faces > about.faces ? ` of ${about.all_faces.toLocaleString("en")}` : "");
  for (const option of byId("shown").options) option.disabled = !["standard", "baked"].includes(option.value) && !official;
  if (about.standard.grey) document.querySelector("option[value=standard]").textContent = GREY;
  byId("shown").value = official ? "dedicated" : about.baked ? "baked" : "standard";
  if (!official) noteInstead();
  if (official) byId("frame").title = official.name;
  say("");
  for (const part of document.querySelectorAll("#panel select, #panel input, #panel button")) part.disabled = false;
  for (const part of document.querySelectorAll("#settings select")) part.disabled = !official;
  layOut();
  showFaithful();
  return true;
}
