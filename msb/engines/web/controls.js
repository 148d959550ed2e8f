"use strict";
// The cameras of the page, and the control of cameras by mouse, touch and keyboard.
const MOVING_KEYS = { w: [0, 0, 1], s: [0, 0, -1], a: [-1, 0, 0], d: [1, 0, 0], e: [0, -1, 0], q: [0, 1, 0] };
const PACE = 0.4;               // speed of flying, in radii of the model per second
const REST_MILLISECONDS = 200;  // pause after a movement before a frame is drawn at full resolution

// ---- cameras

function upVector() {
  const [sign, axis] = byId("up").value;
  const up = new THREE.Vector3();
  up[axis] = sign === "-" ? -1 : 1;
  return up;
}

// Returns `view` with another position and other axes, which are the rows of world_to_camera.
function withPose(view, eye, right, down, forward) {
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

// Returns the size and the intrinsics of a view that fills the window.
function windowView() {
  const ratio = window.devicePixelRatio || 1;
  const width = Math.max(1, Math.round(document.body.clientWidth * ratio));
  const height = Math.max(1, Math.round(document.body.clientHeight * ratio));
  const f = height / 2 / Math.tan(FOV_Y / 2);
  return { width, height, fx: f, fy: f, cx: width / 2, cy: height / 2 };
}

// Shows the whole model from the front, slightly above.
function fit() {
  state.fitted = true;
  byId("cameras").value = "";
  const view = windowView();
  const half = Math.min(FOV_Y / 2, Math.atan(Math.tan(FOV_Y / 2) * view.width / view.height));
  const up = upVector();
  const side = new THREE.Vector3(0.5, -1, 1);  // direction to the camera; its component along the up axis is removed
  side[byId("up").value[1]] = 0;
  const forward = side.normalize().addScaledVector(up, 0.4).normalize().negate();
  const right = new THREE.Vector3().crossVectors(forward, up).normalize();
  const down = new THREE.Vector3().crossVectors(forward, right);
  const distance = 1.05 * world.radius / Math.sin(half);
  const eye = world.center.clone().addScaledVector(forward, -distance);
  // The camera position follows the same rule as in msb/scenes/paths.py.
  view.unit = distance >= 0.5 && distance <= 64 ? 1 : 2 ** (Math.round(Math.log2(distance)) - 1);
  state.target.copy(world.center);
  state.view = withPose(view, eye, right, down, forward);
  show();
}

// Shows the camera of this number; "" selects the free camera.
function choose(index) {
  if (index === "") { fit(); return; }
  state.fitted = false;
  state.view = views[Number(index)];
  // Orbit the point on the camera's axis that is nearest to the centre of the model.
  const { eye, forward } = axes(state.view);
  const ahead = Math.max(world.center.clone().sub(eye).dot(forward), 0.1 * world.radius);
  state.target.copy(eye).addScaledVector(forward, ahead);
  show();
}

let views = [];
function setCameras(list) {
  views = list;
  const options = [["", "free camera"], ...views.map((view, i) => [i, view.name || String(i)])];
  byId("cameras").parentElement.hidden = !views.length;
  byId("cameras").replaceChildren(...options.map(([value, text]) => new Option(text, value)));
}

// ---- movements; call `redrawMoving` after each of them

// Draws the view while the camera moves (`state.moving` is true), and again at full resolution when the
// camera rests.
let rest = 0;
function redrawMoving() {
  state.fitted = false;
  byId("cameras").value = "";
  state.moving = true;
  clearTimeout(rest);
  rest = setTimeout(() => { state.moving = false; show(); }, REST_MILLISECONDS);
  show();
}

// Rotates the view by angles in radians: about the target, or about the eye in the mode "look around".
function turn(dx, dy) {
  const { eye, right, down, forward } = axes(state.view);
  const up = upVector(), looks = byId("drag").value === "looks";
  const sign = looks ? 1 : -1;
  const about = new THREE.Quaternion().setFromAxisAngle(up, sign * dx);
  // Stop before the poles, so that the model is never upside down.
  const angle = Math.acos(Math.max(-1, Math.min(1, -forward.dot(up))));
  const pitch = Math.max(0.02 - angle, Math.min(Math.PI - 0.02 - angle, sign * dy));
  about.multiply(new THREE.Quaternion().setFromAxisAngle(right, pitch));
  const middle = (looks ? eye : state.target).clone();
  for (const point of [eye, state.target]) point.sub(middle).applyQuaternion(about).add(middle);
  for (const axis of [right, down, forward]) axis.applyQuaternion(about);
  state.view = withPose(state.view, eye, right, down, forward);
}

// Moves the view sideways by a distance in pixels, so that the target follows the pointer.
function move(dx, dy) {
  const { eye, right, down, forward } = axes(state.view);
  const distance = state.target.clone().sub(eye).dot(forward);
  const step = right.clone().multiplyScalar(-dx * distance / state.view.fx)
    .addScaledVector(down, -dy * distance / state.view.fy);
  state.target.add(step);
  state.view = withPose(state.view, eye.add(step), right, down, forward);
}

// Multiplies the distance of the camera from the target by a factor.
function zoom(factor) {
  const { eye, right, down, forward } = axes(state.view);
  eye.sub(state.target).multiplyScalar(factor).add(state.target);
  state.view = withPose(state.view, eye, right, down, forward);
}

// ---- mouse and touch: one pointer rotates, two pan and zoom

const fingers = new Map();  // position [x, y] of each pointer, by pointer id
const middleOf = (points) => [0, 1].map((k) => points.reduce((sum, point) => sum + point[k], 0) / points.length);
const distanceOf = (points) => Math.max(1, Math.hypot(points[0][0] - points[1][0], points[0][1] - points[1][1]));
canvas.parentElement.addEventListener("pointerdown", (event) => {
  if (!event.target.closest("canvas")) return;
  fingers.set(event.pointerId, [event.clientX, event.clientY]);
  event.target.setPointerCapture(event.pointerId);
});
canvas.parentElement.addEventListener("pointermove", (event) => {
  const last = fingers.get(event.pointerId);
  if (!last || !state.view) return;
  const scale = state.view.height / Math.max(1, document.body.clientHeight);
  const before = [...fingers.values()].slice(0, 2);
  fingers.set(event.pointerId, [event.clientX, event.clientY]);
  const after = [...fingers.values()].slice(0, 2);
  const from = middleOf(before), to = middleOf(after);
  const dx = to[0] - from[0], dy = to[1] - from[1];
  if (before.length === 2) zoom(distanceOf(before) / distanceOf(after));
  if (before.length === 2 || event.shiftKey || event.buttons & 6) move(dx * scale, dy * scale);
  else turn(dx * Math.PI / document.body.clientHeight, dy * Math.PI / document.body.clientHeight);
  redrawMoving();
});
for (const name of ["pointerup", "pointercancel"]) {
  canvas.parentElement.addEventListener(name, (event) => fingers.delete(event.pointerId));
}
canvas.parentElement.addEventListener("contextmenu", (event) => event.target.closest("canvas") && event.preventDefault());
canvas.parentElement.addEventListener("wheel", (event) => {
  if (!event.target.closest("canvas")) return;
  event.preventDefault();
  if (!state.view) return;
  zoom(Math.exp(Math.sign(event.deltaY) * Math.min(Math.abs(event.deltaY), 100) * 0.0015));
  redrawMoving();
}, { passive: false });

// ---- keyboard

const pressed = new Set();
let flown = 0;  // time of the last step
// Moves the camera in the direction of the pressed keys; runs once per animation frame.
function fly(now) {
  if (!pressed.size || !state.view) { flown = 0; return; }
  const seconds = flown ? Math.min(0.1, (now - flown) / 1000) : 1 / 60;
  flown = now;
  const { eye, right, down, forward } = axes(state.view);
  const step = new THREE.Vector3();
  for (const key of pressed) {
    const [x, y, z] = MOVING_KEYS[key];
    step.addScaledVector(right, x).addScaledVector(down, y).addScaledVector(forward, z);
  }
  step.multiplyScalar(seconds * PACE * world.radius * (state.fast ? 4 : 1));
  state.target.add(step);
  state.view = withPose(state.view, eye.add(step), right, down, forward);
  redrawMoving();
  requestAnimationFrame(fly);
}

window.addEventListener("keydown", (event) => {
  if (event.target.closest?.("input, select, button") || event.ctrlKey || event.metaKey || !state.view) return;
  const key = event.key.toLowerCase();
  state.fast = event.shiftKey;
  if (key in MOVING_KEYS && !event.altKey) {
    const still = !pressed.size;
    pressed.add(key);
    if (still) requestAnimationFrame(fly);
  }
  if (key === "f") fit();
  if (key === "p") saveImage();
});
window.addEventListener("keyup", (event) => { pressed.delete(event.key.toLowerCase()); state.fast = event.shiftKey; });
window.addEventListener("blur", () => pressed.clear());

let saveImage = () => {
  showMesh(state.view);
  download(canvas);
};
function download(from) {
  const link = document.createElement("a");
  link.download = `${byId("name").textContent.replace(/\.[^.]*$/, "")}.png`;
  link.href = from.toDataURL("image/png");
  link.click();
}

window.addEventListener("resize", () => {
  if (!state.view) return;
  if (state.fitted) fit();
  else if (byId("cameras").value === "") { state.view = { ...state.view, ...windowView() }; show(); }
});
byId("cameras").addEventListener("change", (event) => choose(event.target.value));
byId("up").addEventListener("change", fit);
byId("background").addEventListener("input", (event) => {
  state.background = [1, 3, 5].map((i) => parseInt(event.target.value.slice(i, i + 2), 16) / 255);
  show();
});
