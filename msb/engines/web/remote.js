"use strict";
// In pages of the renderer `threejs`, this script draws the tasks that the server (browser.py) sends.
const depthMaterial = new THREE.ShaderMaterial({
  side: THREE.DoubleSide, depthFunc: clip ? THREE.GreaterDepth : THREE.LessDepth,
  vertexShader: `varying float distance_;
    void main() {
      vec4 place = modelViewMatrix * vec4(position, 1.0);
      distance_ = -place.z;
      gl_Position = projectionMatrix * place;
    }`,
  fragmentShader: "varying float distance_; void main() { gl_FragColor = vec4(distance_, 0.0, 0.0, 1.0); }",
});
const clock = gl.getExtension("EXT_disjoint_timer_query_webgl2");

// Draws a frame and returns its time in milliseconds: `wall`, and `device` if the browser has timer queries.
async function drawTimed(view, background) {
  const into = target(THREE.FloatType, view.width, view.height);
  aim(view);
  const query = clock ? gl.createQuery() : null;
  const begin = performance.now();
  if (query) gl.beginQuery(clock.TIME_ELAPSED_EXT, query);
  paint(into, background);
  if (query) gl.endQuery(clock.TIME_ELAPSED_EXT);
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.FLOAT, new Float32Array(4));  // this waits for the frame
  const wall = performance.now() - begin;
  if (!query) return { wall };
  for (let tries = 0; tries < 200 && !gl.getQueryParameter(query, gl.QUERY_RESULT_AVAILABLE); tries += 1) {
    await new Promise((done) => setTimeout(done, 1));
  }
  const done = gl.getQueryParameter(query, gl.QUERY_RESULT_AVAILABLE) && !gl.getParameter(clock.GPU_DISJOINT_EXT);
  const device = done ? gl.getQueryParameter(query, gl.QUERY_RESULT) / 1e6 : null;
  gl.deleteQuery(query);
  return device ? { wall, device } : { wall };
}

function readPixels(view) {
  const values = new Float32Array(4 * view.width * view.height);
  gl.readPixels(0, 0, view.width, view.height, gl.RGBA, gl.FLOAT, values);
  return values;
}

// Returns a material that writes the depth.
// For a material with an alpha cutoff, the function returns a copy with a changed output.
function depthOf(material) {
  if (!material.alphaTest) return depthMaterial;
  const depth = material.clone();
  depth.onBeforeCompile = (shader) => {
    shader.fragmentShader = shader.fragmentShader.replace("#include <colorspace_fragment>",
      "gl_FragColor = vec4(1.0 / gl_FragCoord.w, 0.0, 0.0, 1.0);");
  };
  return depth;
}

// Draws the depths with special materials, and returns them as float32 values, the lowest row first.
function readDepths(view) {
  const materials = new Map();
  world.mesh.traverse((node) => { if (node.isMesh) materials.set(node, node.material); });
  for (const [node, material] of materials) node.material = depthOf(material);
  paint(target(THREE.FloatType, view.width, view.height), [0, 0, 0]);
  for (const [node, material] of materials) node.material = material;
  const values = readPixels(view), depth = new Float32Array(view.width * view.height);
  for (let i = 0; i < depth.length; i += 1) depth[i] = values[4 * i];
  return depth;
}

// Draws onto the canvas, with the page's colour conversion, and returns its bytes.
function canvasBytes(view, background) {
  Object.assign(state, { view, background });
  showNow();
  renderer.setRenderTarget(null);
  const values = new Uint8Array(4 * view.width * view.height);
  gl.readPixels(0, 0, view.width, view.height, gl.RGBA, gl.UNSIGNED_BYTE, values);
  return values;
}

function countBytes() {
  const bytes = { ...world.bytes };
  for (const { width, height } of targets.values()) {
    bytes.image = width * height * 16;
    bytes.depth = width * height * 4;
  }
  return bytes;
}

async function runTasks() {
  const answer = async (head, ...parts) =>
    fetch("answer", { method: "POST", body: new Blob([JSON.stringify(head), "\n", ...parts]) });
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  if (!await ready) { await answer({ error: byId("message").textContent }); return; }
  if (!floats) { await answer({ error: "the browser lacks float32 render targets (EXT_color_buffer_float)" }); return; }
  await answer({
    three: THREE.REVISION, browser: navigator.userAgent, side: gl.getParameter(gl.MAX_RENDERBUFFER_SIZE),
    device: gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER),
  });
  for (;;) {
    let task;
    // Without a server the page closes its window, which ends the browser.
    try { task = await (await fetch("next")).json(); } catch { window.close(); return; }
    try {
      const { view, background } = task;
      const ms = await drawTimed(view, background);
      const parts = task.read ? [readPixels(view), readDepths(view)] : [];
      if (task.canvas) parts.push(canvasBytes(view, background));
      await answer({ ms, memory: countBytes() }, ...parts);
    } catch (error) { await answer({ error: String(error.message || error) }); }
  }
}
runTasks();
