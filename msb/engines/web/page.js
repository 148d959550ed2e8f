"use strict";
// Shows one GLB with three.js as the standard tier does: unlit, two-sided, nearest face, colours as stored.
const NEAR = 0.01;
const FOV_Y = 40 * Math.PI / 180;
const byId = (id) => document.getElementById(id);
const canvas = byId("view");
const start = JSON.parse(byId("scene").textContent);
const say = (text) => { byId("message").textContent = text; byId("message").hidden = !text; };

const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true });
if (!gl) say("This browser has no WebGL 2.");
const renderer = new THREE.WebGLRenderer({ canvas, context: gl });
renderer.autoClear = false;
renderer.setPixelRatio(1);
renderer.toneMapping = THREE.NoToneMapping;
if (THREE.ColorManagement) THREE.ColorManagement.legacyMode = true;
const floats = gl.getExtension("EXT_color_buffer_float") !== null;
// Depth 1 at the near plane and 0 infinitely far, in float32, loses nothing to a far plane; where a browser
// cannot (no EXT_clip_control), the usual -1 .. 1, without a far plane either.
const clip = gl.getExtension("EXT_clip_control");
if (clip) clip.clipControlEXT(clip.LOWER_LEFT_EXT, clip.ZERO_TO_ONE_EXT);

const scene = new THREE.Scene();
const camera = new THREE.PerspectiveCamera();
camera.matrixAutoUpdate = false;
const world = { mesh: null, center: new THREE.Vector3(), radius: 1, bytes: {} };
const state = { view: null, fitted: true, target: new THREE.Vector3(), background: start.background, exact: true };

// ---- drawing

const targets = new Map();
function target(type, width, height) {
  let found = targets.get(type);
  if (found && (found.width !== width || found.height !== height)) {
    found.depthTexture.dispose();
    found.dispose();
    found = null;
  }
  if (!found) {
    found = new THREE.WebGLRenderTarget(width, height, {
      type, minFilter: THREE.NearestFilter, magFilter: THREE.NearestFilter, generateMipmaps: false,
      depthTexture: new THREE.DepthTexture(width, height, THREE.FloatType),
    });
    targets.set(type, found);
  }
  return found;
}

// A view is { width, height, fx, fy, cx, cy, world_to_camera }: ours, OpenCV, row-major.
function aim(view) {
  const { width: w, height: h, fx, fy, cx, cy } = view;
  const m = view.world_to_camera;
  const rows = m.flat();
  const flip = new THREE.Matrix4().set(1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1);
  camera.matrix.copy(flip.multiply(new THREE.Matrix4().set(...rows))).invert();
  camera.updateMatrixWorld(true);
  const a = clip ? 0 : -1, b = clip ? NEAR : -2 * NEAR;
  camera.projectionMatrix.set(
    2 * fx / w, 0, 1 - 2 * cx / w, 0, 0, 2 * fy / h, 2 * cy / h - 1, 0, 0, 0, a, b, 0, 0, -1, 0);
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
}

function paint(into, color) {
  renderer.setRenderTarget(into);
  renderer.state.buffers.color.setMask(true);
  renderer.state.buffers.depth.setMask(true);
  gl.clearBufferfv(gl.COLOR, 0, [...color, 0]);
  gl.clearBufferfv(gl.DEPTH, 0, [clip ? 0 : 1]);
  renderer.render(scene, camera);
}

// The picture goes to the screen through three.js's own conversion, which in "as stored" does nothing.
const encode = THREE.ShaderChunk.colorspace_fragment ? "colorspace_fragment" : "encodings_fragment";
const copy = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), new THREE.ShaderMaterial({
  uniforms: { picture: { value: null } }, depthTest: false, depthWrite: false, toneMapped: false,
  vertexShader: "void main() { gl_Position = vec4(position.xy, 0.5, 1.0); }",
  fragmentShader: `uniform sampler2D picture;
    void main() { gl_FragColor = vec4(texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb, 1.0); #include <${encode}>
    }`.replace("#include", "\n#include"),
}));
copy.frustumCulled = false;
const copyScene = new THREE.Scene().add(copy);

function setColors(exact) {
  state.exact = exact;
  if ("outputColorSpace" in renderer) renderer.outputColorSpace = exact ? "srgb-linear" : "srgb";
  else renderer.outputEncoding = exact ? THREE.LinearEncoding : THREE.sRGBEncoding;
  copy.material.needsUpdate = true;
}

let queued = false;
function show() {
  if (queued) return;
  queued = true;
  requestAnimationFrame(() => { queued = false; showNow(); });
}

function showNow() {
  const view = state.view;
  if (!view) return;
  if (canvas.width !== view.width || canvas.height !== view.height) renderer.setSize(view.width, view.height, false);
  aim(view);
  const into = target(floats ? THREE.FloatType : THREE.UnsignedByteType, view.width, view.height);
  paint(into, state.background);
  copy.material.uniforms.picture.value = into.texture;
  renderer.setRenderTarget(null);
  renderer.render(copyScene, camera);
}

// ---- the mesh

async function open(buffer, name) {
  say(`Reading ${name} ...`);
  await new Promise((done) => setTimeout(done, 20));  // for the message to be seen
  const gltf = await new Promise((done, failed) => new THREE.GLTFLoader().parse(buffer, "", done, failed));
  if (world.mesh) {
    world.mesh.traverse((node) => { if (node.geometry) node.geometry.dispose(); });
    scene.remove(world.mesh);
  }
  let faces = 0;
  world.bytes = {};
  gltf.scene.traverse((node) => {
    if (!node.isMesh) return;
    const { geometry } = node, old = node.material, colored = geometry.attributes.color !== undefined;
    if (old.map) old.map.encoding = THREE.LinearEncoding;
    node.material = new THREE.MeshBasicMaterial({
      vertexColors: colored, color: old.color, map: old.map || null, side: THREE.DoubleSide, toneMapped: false,
      // At equal depths the first face stays.
      depthFunc: clip ? THREE.GreaterDepth : THREE.LessDepth,
    });
    node.frustumCulled = false;
    faces += (geometry.index || geometry.attributes.position).count / 3;
    const { position, color } = geometry.attributes;
    for (const [use, part] of [["positions", position], ["vertex colors", color], ["indices", geometry.index]]) {
      if (part) world.bytes[use] = (world.bytes[use] || 0) + part.array.byteLength;
    }
  });
  world.mesh = gltf.scene;
  canvas.hidden = false;
  scene.add(gltf.scene);
  scene.updateMatrixWorld(true);
  const sphere = new THREE.Box3().setFromObject(gltf.scene).getBoundingSphere(new THREE.Sphere());
  world.center.copy(sphere.center);
  world.radius = sphere.radius > 0 ? sphere.radius : 1;
  byId("name").textContent = byId("name").title = name;
  byId("facts").textContent = `${Math.round(faces).toLocaleString("en")} faces`;
  say("");
  return faces;
}

async function openFile(file) {
  try {
    await open(await file.arrayBuffer(), file.name);
    setCameras([]);
    fit();
  } catch (error) { say(`${file.name} cannot be shown: ${error.message || error}`); }
}

// ---- cameras

function upVector() {
  const [sign, axis] = byId("up").value;
  const up = new THREE.Vector3();
  up[axis] = sign === "-" ? -1 : 1;
  return up;
}

// Rows of world_to_camera are the camera's x, y (down) and z (forward) axes.
function placed(view, eye, right, down, forward) {
  const rows = [right, down, forward].map((axis) => [axis.x, axis.y, axis.z, -axis.dot(eye)]);
  return { ...view, world_to_camera: [...rows, [0, 0, 0, 1]] };
}
function axes(view) {
  const m = view.world_to_camera;
  const [right, down, forward] = [0, 1, 2].map((i) => new THREE.Vector3(m[i][0], m[i][1], m[i][2]));
  const eye = new THREE.Vector3();
  for (const [i, axis] of [right, down, forward].entries()) eye.addScaledVector(axis, -m[i][3]);
  return { eye, right, down, forward };
}

function windowView() {
  const ratio = window.devicePixelRatio || 1;
  const width = Math.max(1, Math.round(canvas.clientWidth * ratio));
  const height = Math.max(1, Math.round(canvas.clientHeight * ratio));
  const f = height / 2 / Math.tan(FOV_Y / 2);
  return { width, height, fx: f, fy: f, cx: width / 2, cy: height / 2 };
}

function fit() {
  state.fitted = true;
  byId("cameras").value = "";
  const view = windowView();
  const half = Math.min(FOV_Y / 2, Math.atan(Math.tan(FOV_Y / 2) * view.width / view.height));
  const up = upVector();
  const side = new THREE.Vector3(0.5, -1, 1);  // of the three, what is level
  side[byId("up").value[1]] = 0;
  const forward = side.normalize().addScaledVector(up, 0.4).normalize().negate();
  const right = new THREE.Vector3().crossVectors(forward, up).normalize();
  const down = new THREE.Vector3().crossVectors(forward, right);
  const eye = world.center.clone().addScaledVector(forward, -1.05 * world.radius / Math.sin(half));
  state.target.copy(world.center);
  state.view = placed(view, eye, right, down, forward);
  show();
}

function choose(index) {
  if (index === "") { fit(); return; }
  state.fitted = false;
  state.view = views[Number(index)];
  // Turn about the point on the camera's axis that is nearest to the middle of the mesh.
  const { eye, forward } = axes(state.view);
  const ahead = Math.max(world.center.clone().sub(eye).dot(forward), 0.1 * world.radius);
  state.target.copy(eye).addScaledVector(forward, ahead);
  show();
}

let views = [];
function setCameras(list) {
  views = list;
  const options = [["", "free: all of the mesh"], ...views.map((view, i) => [i, view.name || String(i)])];
  byId("cameras").parentElement.hidden = !views.length;
  byId("cameras").replaceChildren(...options.map(([value, text]) => new Option(text, value)));
}

// ---- hands

function turn(dx, dy) {
  const { eye, right, down, forward } = axes(state.view);
  const up = upVector();
  const about = new THREE.Quaternion().setFromAxisAngle(up, -dx);
  // Not over the poles.
  const angle = Math.acos(Math.max(-1, Math.min(1, -forward.dot(up))));
  const pitch = Math.max(0.02 - angle, Math.min(Math.PI - 0.02 - angle, -dy));
  about.multiply(new THREE.Quaternion().setFromAxisAngle(right, pitch));
  eye.sub(state.target).applyQuaternion(about).add(state.target);
  for (const axis of [right, down, forward]) axis.applyQuaternion(about);
  state.view = placed(state.view, eye, right, down, forward);
}

function move(dx, dy) {
  const { eye, right, down, forward } = axes(state.view);
  const distance = state.target.clone().sub(eye).dot(forward);
  const step = right.clone().multiplyScalar(-dx * distance / state.view.fx)
    .addScaledVector(down, -dy * distance / state.view.fy);
  state.target.add(step);
  state.view = placed(state.view, eye.add(step), right, down, forward);
}

function zoom(factor) {
  const { eye, right, down, forward } = axes(state.view);
  eye.sub(state.target).multiplyScalar(factor).add(state.target);
  state.view = placed(state.view, eye, right, down, forward);
}

let last = null;
canvas.addEventListener("pointerdown", (event) => {
  last = event;
  canvas.setPointerCapture(event.pointerId);
});
canvas.addEventListener("pointermove", (event) => {
  if (!last || !state.view || event.pointerId !== last.pointerId) return;
  const scale = state.view.height / Math.max(1, canvas.clientHeight);
  const dx = event.clientX - last.clientX, dy = event.clientY - last.clientY;
  state.fitted = false;
  if (event.shiftKey || event.buttons & 6) move(dx * scale, dy * scale);
  else turn(dx * Math.PI / canvas.clientHeight, dy * Math.PI / canvas.clientHeight);
  last = event;
  show();
});
for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => { last = null; });
canvas.addEventListener("contextmenu", (event) => event.preventDefault());
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  if (!state.view) return;
  state.fitted = false;
  zoom(Math.exp(Math.sign(event.deltaY) * Math.min(Math.abs(event.deltaY), 100) * 0.0015));
  show();
}, { passive: false });
window.addEventListener("keydown", (event) => {
  if (event.target.closest?.("input, select") || event.ctrlKey || event.metaKey || !state.view) return;
  if (event.key === "f") fit();
  if (event.key === "s") {
    showNow();
    const link = document.createElement("a");
    link.download = `${byId("name").textContent.replace(/\.[^.]*$/, "")}.png`;
    link.href = canvas.toDataURL("image/png");
    link.click();
  }
});
window.addEventListener("resize", () => { if (state.fitted && state.view) fit(); });
window.addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("over"); });
window.addEventListener("dragleave", () => document.body.classList.remove("over"));
window.addEventListener("drop", (event) => {
  event.preventDefault();
  document.body.classList.remove("over");
  if (event.dataTransfer.files.length) openFile(event.dataTransfer.files[0]);
});
byId("file").addEventListener("change", (event) => event.target.files.length && openFile(event.target.files[0]));
byId("cameras").addEventListener("change", (event) => choose(event.target.value));
byId("colors").addEventListener("change", (event) => { setColors(event.target.value === "stored"); show(); });
byId("up").addEventListener("change", fit);
byId("background").addEventListener("input", (event) => {
  state.background = [1, 3, 5].map((i) => parseInt(event.target.value.slice(i, i + 2), 16) / 255);
  show();
});

// ---- start

async function main() {
  const asked = new URLSearchParams(location.search);
  byId("panel").hidden = asked.has("bare");
  byId("panel").open = window.innerWidth > 600;
  setColors(asked.get("colors") !== "linear");
  byId("colors").value = state.exact ? "stored" : "linear";
  byId("up").value = start.up;
  byId("background").value = "#" + start.background
    .map((value) => Math.round(255 * Math.min(1, Math.max(0, value))).toString(16).padStart(2, "0")).join("");
  setCameras(start.cameras);
  const element = byId("glb"), url = asked.get("url");
  try {
    if (url) {
      const answer = await fetch(url);
      if (!answer.ok) throw new Error(`status ${answer.status}`);
      await open(await answer.arrayBuffer(), start.name || url.split("/").pop());
    } else if (element.textContent) {
      const text = element.textContent;
      element.remove();
      const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
      await open(bytes.buffer, start.name);
    } else {
      say("Drop a .glb here");
      return false;
    }
  } catch (error) {
    say(`${url || start.name} cannot be shown: ${error.message || error}`);
    return false;
  }
  const index = views.findIndex((view, i) => view.name === asked.get("camera") || String(i) === asked.get("camera"));
  if (index >= 0) byId("cameras").value = String(index);
  if (index >= 0) choose(index); else fit();
  return true;
}
const ready = main();
