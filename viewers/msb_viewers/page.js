// The web page of the topology viewer.
const canvas = byId("view");
const state = { coloring: meta.colored ? "own" : "grey", visible: new Set(meta.visible), active: meta.active,
  cursor: {}, chosen: null, legend: innerWidth > 640 };

// Decompress the arrays of the page. The result maps names to typed arrays.
async function unpack() {
  const element = byId("data");
  const text = element.textContent;
  element.remove();
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const buffer = await new Response(stream).arrayBuffer();
  const types = { float32: Float32Array, uint32: Uint32Array, uint8: Uint8Array };
  const arrays = {};
  for (const [name, a] of Object.entries(meta.arrays)) arrays[name] = new types[a.dtype](buffer, a.offset, a.length);
  return arrays;
}

// Vectors of three numbers, and 4 x 4 matrices in column-major order.
const sub = (a, b) => a.map((x, i) => x - b[i]);
const add = (a, b, s = 1) => a.map((x, i) => x + s * b[i]);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => { const n = Math.hypot(...a) || 1; return a.map((x) => x / n); };
const turn = (v, axis, angle) => {
  const c = Math.cos(angle), s = Math.sin(angle), k = cross(axis, v), d = dot(axis, v) * (1 - c);
  return v.map((x, i) => x * c + k[i] * s + axis[i] * d);
};
const times = (a, b) => {
  const m = new Float32Array(16);
  for (let c = 0; c < 4; c++) for (let r = 0; r < 4; r++) for (let k = 0; k < 4; k++) m[c * 4 + r] += a[k * 4 + r] * b[c * 4 + k];
  return m;
};

// The camera looks at `target` from `distance` in `direction`. The legend covers the left `window width -
// free()` pixels.
const camera = { direction: meta.direction, up: meta.up, target: [0, 0, 0], distance: 1, near: 0 };
const free = () => (state.legend && canvas.clientWidth > 640 ? byId("legend").offsetWidth + 12 : 0);
function home() {
  const aspect = Math.max((canvas.clientWidth - free()) / canvas.clientHeight, 0.1);
  const narrow = Math.min(meta.fov, 2 * Math.atan(Math.tan(meta.fov / 2) * aspect));
  Object.assign(camera, { direction: meta.direction, up: meta.up, target: [0, 0, 0], distance: 1.04 / Math.sin(narrow / 2), near: 0 });
}
function matrices() {
  const width = canvas.clientWidth, height = canvas.clientHeight;
  const back = unit(camera.direction), right = unit(cross(camera.up, back)), up = cross(back, right);
  const eye = add(camera.target, back, camera.distance);
  const view = new Float32Array([right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
    -dot(right, eye), -dot(up, eye), -dot(back, eye), 1]);
  const far = meta.extent + Math.hypot(...eye) + 0.01;
  const near = Math.max((Math.hypot(...eye) - meta.extent) * 0.99, camera.distance * Math.max(camera.near, 0.05), far * 1e-5);
  camera.depth = (far + near) / (far - near);
  const f = 1 / Math.tan(meta.fov / 2), shift = free() / width;
  const projection = new Float32Array([f * height / width, 0, 0, 0, 0, f, 0, 0, -shift, 0, (far + near) / (near - far), -1,
    0, 0, 2 * far * near / (near - far), 0]);
  return times(projection, view);
}

// Offset of lines and markers towards the camera, relative to their distance. Without the offset, the surface
// would hide them.
const NEARER = 0.0015;
const SURFACE = [`#version 300 es
  in vec3 position; in vec4 color; in vec2 uv; uniform mat4 matrix; out vec4 shade; out vec3 place; out vec2 at;
  void main() { gl_Position = matrix * vec4(position, 1.0); shade = color; place = position; at = uv; }`,
`#version 300 es
  precision highp float; in vec4 shade; in vec3 place; in vec2 at; uniform float dark; uniform vec3 eye, light; out vec4 result;
  uniform sampler2D image; uniform bool textured; uniform float cutoff;
  vec3 linear(vec3 c) { return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c)); }
  vec3 srgb(vec3 c) { return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)); }
  void main() {
    if (textured) {
      vec4 texel = texture(image, at);
      if (texel.a * shade.a < cutoff) discard;
      result = vec4(srgb(linear(shade.rgb) * texel.rgb), 1.0);
      return;
    }
    vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
    float facing = dark > 0.0 ? abs(dot(normal, light == vec3(0.0) ? normalize(eye - place) : light)) : 1.0;
    result = vec4(shade.rgb * (1.0 - dark * (1.0 - facing)), 1.0);
  }`];
// A line is drawn as a quad around its two ends. The width of the quad is in pixels.
const LINE = [`#version 300 es
  in vec3 first; in vec3 second; uniform mat4 matrix; uniform vec2 size; uniform float width; uniform float nearer; uniform float depth; out float along;
  void main() {
    vec4 a = matrix * vec4(first, 1.0), b = matrix * vec4(second, 1.0);
    float end = float(gl_VertexID & 1), side = float(gl_VertexID >> 1) * 2.0 - 1.0;
    if (a.w < 1e-6 && b.w < 1e-6) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
    if (a.w < 1e-6) a = mix(a, b, (1e-6 - a.w) / (b.w - a.w));
    if (b.w < 1e-6) b = mix(b, a, (1e-6 - b.w) / (a.w - b.w));
    vec2 way = (b.xy / b.w - a.xy / a.w) * size;
    vec2 across = length(way) > 0.0 ? normalize(vec2(-way.y, way.x)) : vec2(0.0);
    gl_Position = mix(a, b, end);
    gl_Position.xy += across * side * width / size * gl_Position.w;
    gl_Position.z -= nearer * (depth * gl_Position.w - gl_Position.z);
    along = end;
  }`,
`#version 300 es
  precision highp float; in float along; uniform vec3 color; uniform bool dashed; out vec4 result;
  void main() { if (dashed && fract(along * 2.5) > 0.5) discard; result = vec4(color, 1.0); }`];
const MARKER = [`#version 300 es
  in vec3 position; uniform mat4 matrix; uniform float width; uniform float nearer; uniform float depth;
  void main() { gl_Position = matrix * vec4(position, 1.0); gl_Position.z -= nearer * (depth * gl_Position.w - gl_Position.z); gl_PointSize = width; }`,
`#version 300 es
  precision highp float; uniform vec3 color; uniform int shape; uniform float width; out vec4 result;
  void main() {
    vec2 p = 2.0 * gl_PointCoord - 1.0; float reach = length(p);
    if (shape == 1) reach = abs(p.x) + abs(p.y);
    if (shape == 2) reach = max(abs(abs(p.x) - abs(p.y)) * 2.2, max(abs(p.x), abs(p.y)));
    if (shape == 3) reach = max(abs(p.x), abs(p.y)) * 1.05;
    if (reach > 1.0 || (shape == 4 && reach < 0.6)) discard;
    bool rim = shape != 4 && width > 9.0 && reach > 1.0 - max(2.6 / width, 0.16);
    result = vec4(rim ? vec3(0.0) : color, 1.0);
  }`];
const SHAPES = ["disc", "diamond", "cross", "square", "ring"];

let gl, programs, surface, layers = {}, mark = null, data, waiting = false;
function program([vertex, fragment]) {
  const p = gl.createProgram();
  for (const [type, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(p, shader);
  }
  gl.linkProgram(p);
  return { p, at: (name) => gl.getAttribLocation(p, name), to: (name) => gl.getUniformLocation(p, name) };
}
function upload(array) {
  const buffer = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
  return buffer;
}
// Positions of vertices, with three numbers each.
function gathered(indices) {
  const out = new Float32Array(indices.length * 3);
  for (let i = 0; i < indices.length; i++) for (let k = 0; k < 3; k++) out[3 * i + k] = data.points[3 * indices[i] + k];
  return out;
}
// Colours of the corners of all faces for the current colouring, as RGBA bytes.
function cornerColors() {
  const faces = data.faces, out = new Uint8Array(faces.length * 4).fill(255);
  const put = (i, from, at) => { for (let k = 0; k < 3; k++) out[4 * i + k] = from[3 * at + k]; };
  if (state.coloring === "components") {
    const table = meta.classes.flatMap((c) => c.color);
    for (let i = 0; i < faces.length; i++) put(i, table, data.size_class[Math.floor(i / 3)]);
  } else if (state.coloring === "own" && meta.skin) {
    if (meta.skin.tinted) return data.colors;
  } else if (state.coloring === "own") {
    const of = { vertex: (i) => faces[i], face: (i) => Math.floor(i / 3), corner: (i) => i }[meta.domain];
    for (let i = 0; i < faces.length; i++) put(i, data.colors, of(i));
  } else for (let i = 0; i < faces.length; i++) put(i, meta.grey, 0);
  return out;
}
// Upload the textures, scaled down to the maximum size of the GPU. The GPU filters sRGB textures in linear light.
async function textures() {
  const { filter, mipmaps, wrap_u, wrap_v } = meta.skin, largest = gl.getParameter(gl.MAX_TEXTURE_SIZE);
  const wrap = { repeat: gl.REPEAT, clamp: gl.CLAMP_TO_EDGE, mirror: gl.MIRRORED_REPEAT };
  const near = filter === "linear" ? gl.LINEAR : gl.NEAREST;
  const far = !mipmaps ? near : filter === "linear" ? gl.LINEAR_MIPMAP_LINEAR : gl.NEAREST_MIPMAP_NEAREST;
  const plain = { premultiplyAlpha: "none", colorSpaceConversion: "none" };
  for (const item of meta.skin.textures) {
    const file = new Blob([data[item.name]], { type: "image/png" });
    let image = await createImageBitmap(file, plain);
    const over = Math.max(image.width, image.height) / largest;
    if (over > 1) image = await createImageBitmap(file, { ...plain, resizeWidth: Math.floor(image.width / over) || 1, resizeHeight: Math.floor(image.height / over) || 1 });
    item.texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, item.texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, gl.RGBA, gl.UNSIGNED_BYTE, image);
    if (mipmaps) gl.generateMipmap(gl.TEXTURE_2D);
    for (const [name, value] of [["WRAP_S", wrap[wrap_u]], ["WRAP_T", wrap[wrap_v]], ["MAG_FILTER", near], ["MIN_FILTER", far]])
      gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}`], value);
  }
}
function drawTextured(to) {
  gl.uniform1i(to("textured"), 1);
  gl.uniform1f(to("cutoff"), meta.skin.cutoff);
  let first = 0;
  for (const { texture, faces } of meta.skin.textures) {
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.drawArrays(gl.TRIANGLES, 3 * first, 3 * faces);
    first += faces;
  }
}
// Line segments of elements: the edges themselves, or the outlines of faces.
function segmentsOf(vertices, corners) {
  if (corners !== 3) return vertices;
  const out = new Uint32Array(vertices.length * 2);
  for (let i = 0; i < vertices.length; i++) { out[2 * i] = vertices[i]; out[2 * i + 1] = vertices[i - (i % 3) + ((i + 1) % 3)]; }
  return out;
}
// Centroids of elements with `corners` vertices.
function middles(vertices, corners) {
  const out = new Float32Array(vertices.length / corners * 3);
  for (let i = 0; i < vertices.length; i++) for (let k = 0; k < 3; k++) out[3 * Math.floor(i / corners) + k] += data.points[3 * vertices[i] + k] / corners;
  return out;
}
function drawable(vertices, corners, style) {
  const item = { style, lines: null, points: null };
  if (style.width) { item.lines = upload(gathered(segmentsOf(vertices, corners))); item.count = corners === 3 ? vertices.length : vertices.length / 2; }
  if (style.marker) { item.points = upload(middles(vertices, corners)); item.marks = vertices.length / corners; }
  return item;
}
function drawLayer(item, matrix, scale, nearer) {
  const { style } = item, color = style.color.map((c) => c / 255), ratio = devicePixelRatio;
  if (item.lines) {
    const { p, at, to } = programs.line;
    gl.useProgram(p);
    gl.bindBuffer(gl.ARRAY_BUFFER, item.lines);
    [["first", 0], ["second", 12]].forEach(([name, offset]) => {
      gl.enableVertexAttribArray(at(name));
      gl.vertexAttribPointer(at(name), 3, gl.FLOAT, false, 24, offset);
      gl.vertexAttribDivisor(at(name), 1);
    });
    gl.uniformMatrix4fv(to("matrix"), false, matrix);
    gl.uniform2f(to("size"), canvas.width, canvas.height);
    gl.uniform1f(to("width"), Math.max(style.width * scale, 1) * ratio);
    gl.uniform1f(to("nearer"), nearer);
    gl.uniform1f(to("depth"), camera.depth);
    gl.uniform3fv(to("color"), color);
    gl.uniform1i(to("dashed"), style.line === "dashed" ? 1 : 0);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, item.count);
    ["first", "second"].forEach((name) => { gl.vertexAttribDivisor(at(name), 0); gl.disableVertexAttribArray(at(name)); });
  }
  if (item.points) {
    const { p, at, to } = programs.marker, width = Math.max(style.size * scale, 3) * ratio;
    gl.useProgram(p);
    gl.bindBuffer(gl.ARRAY_BUFFER, item.points);
    gl.enableVertexAttribArray(at("position"));
    gl.vertexAttribPointer(at("position"), 3, gl.FLOAT, false, 0, 0);
    gl.uniformMatrix4fv(to("matrix"), false, matrix);
    gl.uniform1f(to("width"), width);
    gl.uniform1f(to("nearer"), nearer * 2);
    gl.uniform1f(to("depth"), camera.depth);
    gl.uniform3fv(to("color"), color);
    gl.uniform1i(to("shape"), SHAPES.indexOf(style.marker));
    gl.drawArrays(gl.POINTS, 0, item.marks);
    gl.disableVertexAttribArray(at("position"));
  }
}
function draw() {
  waiting = false;
  canvas.width = Math.round(canvas.clientWidth * devicePixelRatio);
  canvas.height = Math.round(canvas.clientHeight * devicePixelRatio);
  gl.viewport(0, 0, canvas.width, canvas.height);
  gl.clearColor(...meta.background.map((c) => c / 255), 1);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.enable(gl.DEPTH_TEST);
  const matrix = matrices(), { p, at, to } = programs.surface;
  if (surface.coloring !== state.coloring) {
    surface.colors = upload(cornerColors());
    surface.coloring = state.coloring;
  }
  gl.useProgram(p);
  const attributes = [["position", surface.places, 3, gl.FLOAT], ["color", surface.colors, 4, gl.UNSIGNED_BYTE], ["uv", surface.uvs, 2, gl.FLOAT]].filter((attribute) => attribute[1]);
  attributes.forEach(([name, buffer, width, type]) => {
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.enableVertexAttribArray(at(name));
    gl.vertexAttribPointer(at(name), width, type, type !== gl.FLOAT, 0, 0);
  });
  gl.uniformMatrix4fv(to("matrix"), false, matrix);
  gl.uniform3fv(to("eye"), add(camera.target, unit(camera.direction), camera.distance));
  gl.uniform1f(to("dark"), { own: 0, grey: meta.daylight.dark, components: 0.25 }[state.coloring]);
  gl.uniform3fv(to("light"), state.coloring === "grey" ? meta.daylight.light : [0, 0, 0]);
  gl.uniform1i(to("textured"), 0);
  if (meta.skin && state.coloring === "own") drawTextured(to);
  else gl.drawArrays(gl.TRIANGLES, 0, data.faces.length);
  attributes.forEach(([name]) => gl.disableVertexAttribArray(at(name)));
  const pixels = meta.edge * canvas.clientHeight / (2 * camera.distance * Math.tan(meta.fov / 2));
  const scale = Math.min(Math.max(pixels / 40, 0.2), 1);
  for (const layer of meta.layers) if (state.visible.has(layer.kind)) {
    layers[layer.kind] ||= drawable(data[layer.kind], layer.each, layer);
    drawLayer(layers[layer.kind], matrix, scale, NEARER);
  }
  if (mark) {
    gl.clear(gl.DEPTH_BUFFER_BIT);
    mark.forEach((item) => drawLayer(item, matrix, 1, 0));
  }
}
const redraw = () => { if (!waiting) { waiting = true; requestAnimationFrame(draw); } };

function symbol(layer) {
  const css = `rgb(${layer.color})`, space = "http://www.w3.org/2000/svg", svg = document.createElementNS(space, "svg");
  const put = (tag, values) => { const node = document.createElementNS(space, tag); for (const k in values) node.setAttribute(k, values[k]); svg.append(node); };
  if (layer.width) put("line", { x1: 1, y1: 10, x2: 33, y2: 10, stroke: css, "stroke-width": layer.width, "stroke-dasharray": layer.line === "dashed" ? "7 6" : "none" });
  const r = Math.min(layer.size / 2, 6.5);
  const rim = { fill: css, stroke: "#000" };
  if (layer.marker === "disc") put("circle", { cx: 17, cy: 10, r, ...rim });
  if (layer.marker === "ring") put("circle", { cx: 17, cy: 10, r: r - 1, fill: "none", stroke: css, "stroke-width": 2 });
  if (layer.marker === "diamond") put("path", { d: `M${17 - r} 10L17 ${10 - r}L${17 + r} 10L17 ${10 + r}Z`, ...rim });
  if (layer.marker === "square") put("rect", { x: 17 - r, y: 10 - r, width: 2 * r, height: 2 * r, ...rim });
  if (layer.marker === "cross") for (const [stroke, width] of [["#000", 4.5], [css, 2.5]])
    put("path", { d: `M${17 - r} ${10 - r}L${17 + r} ${10 + r}M${17 - r} ${10 + r}L${17 + r} ${10 - r}`, stroke, "stroke-width": width });
  return svg;
}
function legend() {
  const box = byId("legend");
  const head = make("div", undefined, "head"), fold = make("button", state.legend ? "Hide (L)" : "Legend (L)");
  fold.setAttribute("aria-expanded", state.legend);
  fold.onclick = () => { state.legend = !state.legend; legend(); redraw(); };
  head.append(make("h1", meta.name), fold);
  box.classList.toggle("folded", !state.legend);
  box.replaceChildren(head);
  if (!state.legend) return;
  box.append(make("p", meta.subtitle, "faint"), make("p", meta.verdict), ...meta.notes.map((text) => make("p", text, "note")));
  for (const layer of meta.layers) {
    const row = make("label", undefined, "row" + (layer.kind === state.active && layer.count ? " active" : "") + (layer.count ? "" : " empty"));
    const check = make("input");
    Object.assign(check, { type: "checkbox", checked: state.visible.has(layer.kind), disabled: !layer.count });
    check.onchange = () => { toggle(layer.kind); };
    row.append(check, symbol(layer), make("span", layer.label), make("span", layer.count.toLocaleString("en")), make("span", layer.key, "key"));
    box.append(row);
  }
  const buttons = make("div", undefined, "buttons");
  const select = make("select");
  select.setAttribute("aria-label", "colours");
  for (const [value, text] of [["own", "mesh colours"], ["components", `components by size (${meta.components.toLocaleString("en")})`], ["grey", "grey"]])
    if (value !== "own" || meta.colored) select.append(new Option(text, value, false, value === state.coloring));
  select.onchange = () => { state.coloring = select.value; legend(); redraw(); };
  buttons.append(select);
  for (const [text, action] of [["Previous (P)", () => step(-1)], ["Next (N)", () => step(1)], ["First view", () => { home(); redraw(); }], ["Help (H)", help]]) {
    const button = make("button", text);
    button.onclick = action;
    buttons.append(button);
  }
  if (state.coloring === "components") for (const c of meta.classes) if (c.components) {
    const row = make("div", undefined, "sub"), swatch = make("i");
    swatch.style.background = `rgb(${c.color})`;
    row.append(swatch, make("span", c.label), make("span", c.components.toLocaleString("en")));
    box.append(row);
  }
  box.append(buttons);
}
const help = () => showKeys([["1 ... 9", "show or hide a layer"], ["0", "show or hide all layers"], ["Tab", "select the layer for N and P"], ["N / P", "go to its next / previous element"],
    ["C", "colours: mesh, components, grey"], ["L", "show or hide the legend"], ["Home", "first view"], ["arrows", "rotate"], ["+ / -", "zoom"],
    ["drag", "rotate; with Shift: move; wheel: zoom"], ["H", "this help"]]);
const layerOf = (kind) => meta.layers.find((layer) => layer.kind === kind);
function toggle(kind) {
  if (!layerOf(kind).count) { say(`${layerOf(kind).label}: 0`); return; }
  if (!state.visible.delete(kind)) { state.visible.add(kind); state.active = kind; }
  legend(); redraw();
}
function step(by) {
  const layer = layerOf(state.active), { kind, each: corners, count } = layer;
  if (!count) { say(`${layer.label}: 0`); return; }
  const last = state.cursor[kind];
  const at = last === undefined ? (by > 0 ? 0 : count - 1) : (last + by + count) % count;
  state.cursor[kind] = at;
  state.visible.add(kind);
  const vertices = data[kind].subarray(at * corners, at * corners + corners);
  const target = Array.from(middles(vertices, corners));
  const style = { color: meta.highlight, width: corners > 1 ? 4 : 0, line: "solid", size: 34, marker: null };
  mark = [drawable(vertices, corners, style), { style: { ...style, marker: "ring" }, points: upload(new Float32Array(target)), marks: 1 }];
  Object.assign(camera, { target, distance: 8 * meta.edge, near: 0.6 });
  const stored = target.map((x, i) => (meta.center[i] + meta.scale * x).toPrecision(6));
  say(`${layer.label}: ${(at + 1).toLocaleString("en")} of ${count.toLocaleString("en")} · ${corners === 1 ? "vertex" : "vertices"} ${Array.from(vertices, (v) => data.stored_rows ? data.stored_rows[v] : v).join(" ")} · at ${stored.join(", ")}`);
  legend(); redraw();
}
function orbit(dx, dy) {
  const right = unit(cross(camera.up, unit(camera.direction)));
  camera.direction = turn(turn(camera.direction, camera.up, -dx), right, -dy);
  camera.up = unit(turn(camera.up, right, -dy));
  redraw();
}
const zoom = (factor) => { camera.distance *= factor; redraw(); };
function controls() {
  canvas.onpointerdown = (event) => canvas.setPointerCapture(event.pointerId);
  canvas.onpointermove = (event) => {
    if (!event.buttons) return;
    const size = canvas.clientHeight;
    if (event.shiftKey || event.buttons & 6) {
      const back = unit(camera.direction), right = unit(cross(camera.up, back)), up = cross(back, right);
      const unitsPerPixel = 2 * camera.distance * Math.tan(meta.fov / 2) / size;
      camera.target = add(add(camera.target, right, -event.movementX * unitsPerPixel), up, event.movementY * unitsPerPixel);
      redraw();
    } else orbit(event.movementX / size * 4, event.movementY / size * 4);
  };
  canvas.oncontextmenu = (event) => event.preventDefault();
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(event.deltaY * 0.0012)); }, { passive: false });
  onkeydown = (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.target.tagName === "SELECT") return;
    const key = event.key.toLowerCase(), layer = meta.layers.find((l) => l.key === key);
    const all = meta.layers.filter((l) => l.count).map((l) => l.kind);
    const actions = {
      n: () => step(1), p: () => step(-1), h: help, home: () => { home(); redraw(); }, l: () => { state.legend = !state.legend; legend(); redraw(); },
      0: () => { state.visible = new Set(state.visible.size ? [] : all); legend(); redraw(); },
      tab: () => { if (all.length) { state.active = all[(all.indexOf(state.active) + 1) % all.length]; legend(); } },
      c: () => { const all = ["own", "components", "grey"].filter((c) => c !== "own" || meta.colored); state.coloring = all[(all.indexOf(state.coloring) + 1) % all.length]; legend(); redraw(); },
      escape: () => { mark = null; byId("help").hidden = true; say(""); redraw(); },
      arrowleft: () => orbit(-0.1, 0), arrowright: () => orbit(0.1, 0), arrowup: () => orbit(0, -0.1), arrowdown: () => orbit(0, 0.1),
      "+": () => zoom(0.85), "-": () => zoom(1.18),
    };
    const action = layer ? () => toggle(layer.kind) : actions[key];
    if (action) { event.preventDefault(); action(); }
  };
  onresize = redraw;
}
async function start() {
  document.title = `${meta.name} - msb view`;
  legend();
  gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });
  if (!gl) { say("This browser does not support WebGL 2, so the mesh cannot be drawn."); return; }
  data = await unpack();
  programs = { surface: program(SURFACE), line: program(LINE), marker: program(MARKER) };
  surface = { places: upload(gathered(data.faces)), uvs: meta.skin && upload(data.uvs) };
  if (meta.skin) await textures().catch(() => {
    Object.assign(meta, { colored: false, skin: null });
    state.coloring = "grey";
    legend();
    say("This browser cannot load the textures, so the mesh is grey.");
  });
  home(); controls(); redraw();
  // If the page address ends in #nonmanifold_edges:17, the page opens at this element.
  const [kind, number] = location.hash.slice(1).split(":");
  if (layerOf(kind)?.count && number > 0) { state.active = kind; state.cursor[kind] = number - 2; step(1); }
}
start();
