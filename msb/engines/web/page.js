"use strict";
// Shows a mesh with three.js as on the standard tier: unlit, two-sided, the nearest face of each pixel.
// A mesh without colours is shaded in grey.
const NEAR = 0.01;                 // near plane, in units of the view
const FOV_Y = 40 * Math.PI / 180;  // vertical field of view of the free camera
const canvas = byId("view");
const start = JSON.parse(byId("scene").textContent);

const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true });
if (!gl) {
  say("This browser does not support WebGL 2. Use a current Chrome, Edge, Firefox or Safari.");
  throw new Error("no WebGL 2");
}
const renderer = new THREE.WebGLRenderer({ canvas, context: gl });
renderer.autoClear = false;
renderer.setPixelRatio(1);
renderer.toneMapping = THREE.NoToneMapping;
// Disable the conversion of colours in three.js.
// The materials below convert the colours.
THREE.ColorManagement.enabled = false;
renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
// Enables extensions.
// With EXT_clip_control, the float32 depth is 1 at the near plane and 0 at infinity. This range is the most
// precise. Without EXT_clip_control, the depth has the usual range -1 .. 1. Neither depth range has a far
// plane.
function enableExtensions() {
  const clip = gl.getExtension("EXT_clip_control");
  if (clip) clip.clipControlEXT(clip.LOWER_LEFT_EXT, clip.ZERO_TO_ONE_EXT);
  return { floats: gl.getExtension("EXT_color_buffer_float") !== null, clip: clip !== null };
}
const { floats, clip } = enableExtensions();

// Called when the WebGL context is lost, and when the context is restored.
// After a restore, three.js recreates its objects.
let onWebGlChange = (lost) => say(lost ? "The WebGL context was lost, so nothing can be drawn. Reload the page." : "");
canvas.addEventListener("webglcontextlost", () => onWebGlChange(true));
canvas.addEventListener("webglcontextrestored", () => { enableExtensions(); onWebGlChange(false); show(); });

const scene = new THREE.Scene();
const camera = new THREE.PerspectiveCamera();
camera.matrixAutoUpdate = false;
const world = { mesh: null, center: new THREE.Vector3(), radius: 1, bytes: {} };
const state = { view: null, fitted: true, target: new THREE.Vector3(), background: start.background };

// ---- drawing

const targets = new Map();  // the render target for each pixel type
// Returns a render target of this pixel type (float or byte) and size.
// An earlier target of this type is reused or replaced.
function target(type, width, height) {
  let result = targets.get(type);
  if (result && (result.width !== width || result.height !== height)) {
    result.depthTexture.dispose();
    result.dispose();
    result = null;
  }
  if (!result) {
    result = new THREE.WebGLRenderTarget(width, height, {
      type, minFilter: THREE.NearestFilter, magFilter: THREE.NearestFilter, generateMipmaps: false,
      depthTexture: new THREE.DepthTexture(width, height, THREE.FloatType),
    });
    targets.set(type, result);
  }
  return result;
}

// Sets the three.js camera to a view.
function aim(view) {
  const { width: w, height: h, fx, fy, cx, cy } = view;
  const rows = matrixOf(view).flat();
  const flip = new THREE.Matrix4().set(1, 0, 0, 0, 0, -1, 0, 0, 0, 0, -1, 0, 0, 0, 0, 1);
  camera.matrix.copy(flip.multiply(new THREE.Matrix4().set(...rows))).invert();
  camera.updateMatrixWorld(true);
  const a = clip ? 0 : -1, b = clip ? NEAR : -2 * NEAR;
  camera.projectionMatrix.set(
    2 * fx / w, 0, 1 - 2 * cx / w, 0, 0, 2 * fy / h, 2 * cy / h - 1, 0, 0, 0, a, b, 0, 0, -1, 0);
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
}

// Draws the scene into a render target, over a background colour.
function paint(destination, color) {
  renderer.setRenderTarget(destination);
  renderer.state.buffers.color.setMask(true);
  renderer.state.buffers.depth.setMask(true);
  gl.clearBufferfv(gl.COLOR, 0, [...color, 0]);
  gl.clearBufferfv(gl.DEPTH, 0, [clip ? 0 : 1]);
  renderer.render(scene, camera);
}

// Copies a render target to the canvas.
const copy = new THREE.Mesh(new THREE.PlaneGeometry(2, 2), new THREE.ShaderMaterial({
  uniforms: { picture: { value: null } }, depthTest: false, depthWrite: false, toneMapped: false,
  vertexShader: "void main() { gl_Position = vec4(position.xy, 0.5, 1.0); }",
  fragmentShader: `uniform sampler2D picture;
    void main() { gl_FragColor = vec4(texelFetch(picture, ivec2(gl_FragCoord.xy), 0).rgb, 1.0); }`,
}));
copy.frustumCulled = false;
const copyScene = new THREE.Scene().add(copy);

// True if vertex colours are linear light, as glTF specifies; false if they are sRGB values to display unchanged.
const linear = { value: true };
function setColors(rule) {
  linear.value = rule !== "stored";
  byId("colors").value = linear.value ? "linear" : "stored";
}

let queued = false;
function show() {
  if (queued) return;
  queued = true;
  requestAnimationFrame(() => { queued = false; showNow(); });
}

// Functions that draw a view; other scripts replace or add entries.
const layers = [showMesh];
function showNow() { if (state.view) for (const layer of layers) layer(state.view); }

function showMesh(view) {
  if (canvas.width !== view.width || canvas.height !== view.height) renderer.setSize(view.width, view.height, false);
  aim(view);
  const destination = target(floats ? THREE.FloatType : THREE.UnsignedByteType, view.width, view.height);
  paint(destination, state.background);
  copy.material.uniforms.picture.value = destination.texture;
  renderer.setRenderTarget(null);
  renderer.render(copyScene, camera);
}

// ---- the mesh

// Returns the material of meshes without colours: grey, shaded by the angle to the light on both sides.
const greyMaterial = () => new THREE.ShaderMaterial({
  side: THREE.DoubleSide, depthFunc: clip ? THREE.GreaterDepth : THREE.LessDepth,
  uniforms: { grey: { value: start.daylight.grey }, ambient: { value: start.daylight.ambient },
    light: { value: new THREE.Vector3(...start.daylight.light) } },
  vertexShader: `varying vec3 place;
    void main() { place = (modelMatrix * vec4(position, 1.0)).xyz; gl_Position = projectionMatrix * viewMatrix * vec4(place, 1.0); }`,
  fragmentShader: `varying vec3 place; uniform float grey, ambient; uniform vec3 light;
    void main() {
      vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
      gl_FragColor = vec4(vec3(grey * (ambient + (1.0 - ambient) * abs(dot(normal, light)))), 1.0);
    }`,
});

// Returns an unlit material with the colours and the texture of a glTF material.
// If the colours are linear light, the shader finally encodes them as sRGB.
// The colours of textures are always linear light.
function materialOf(geometry, old) {
  const colored = geometry.attributes.color !== undefined, map = old?.map || null;
  if (!colored && !map && (!old || old.color.getHex() === 0xffffff)) return greyMaterial();
  const material = new THREE.MeshBasicMaterial({
    vertexColors: colored, color: old ? old.color : 0xffffff, map, alphaTest: old?.alphaTest || 0, side: THREE.DoubleSide,
    // At equal depths the first face is kept.
    toneMapped: false, depthFunc: clip ? THREE.GreaterDepth : THREE.LessDepth,
  });
  material.onBeforeCompile = (shader) => {
    shader.uniforms.linear = map || !colored ? { value: true } : linear;
    shader.fragmentShader = `uniform bool linear;\n${shader.fragmentShader}`.replace("#include <colorspace_fragment>",
      "if (linear) gl_FragColor = sRGBTransferOETF(gl_FragColor);");
  };
  return material;
}

const query = new URLSearchParams(location.search);

const parseGlb = (buffer) => new THREE.GLTFLoader().setMeshoptDecoder(THREE.MeshoptDecoder).parseAsync(buffer, "");

const decodeBase64 = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;

// Returns the bytes of the mesh file in the page, or null if the page contains no mesh.
function embeddedFile() {
  const element = byId("glb"), text = element.textContent;
  element.remove();
  return text ? decodeBase64(text) : null;
}

// Shows a mesh file; `framed` is the sphere that the free camera shows, by default the whole mesh.
async function open(buffer, name, framed = null) {
  say(`Reading ${name} ...`);
  await new Promise((done) => setTimeout(done, 20));  // this pause lets the browser show the message
  const gltf = await parseGlb(buffer);
  setColors(query.get("colors") || (gltf.asset.extras?.color_space === "srgb" ? "stored" : "linear"));
  const faces = setMesh(gltf.scene);
  const sphere = framed ? new THREE.Sphere(new THREE.Vector3(...framed.center), framed.radius)
    : new THREE.Box3().setFromObject(gltf.scene).getBoundingSphere(new THREE.Sphere());
  setName(name, faces, sphere.center, sphere.radius);
  say("");
}

// Shows the meshes of a group in place of the current mesh, and returns their number of faces.
function setMesh(group) {
  if (world.mesh) {
    world.mesh.traverse((node) => { node.geometry?.dispose(); node.material?.map?.dispose(); });
    scene.remove(world.mesh);
  }
  let faces = 0;
  world.bytes = {};
  group.traverse((node) => {
    if (!node.isMesh) return;
    const { geometry } = node;
    node.material = materialOf(geometry, node.material);
    node.frustumCulled = false;
    faces += (geometry.index || geometry.attributes.position).count / 3;
    const { position, color, uv } = geometry.attributes;
    const parts = { positions: position, "vertex colors": color, "texture coordinates": uv, indices: geometry.index };
    for (const [use, part] of Object.entries(parts)) {
      if (part) world.bytes[use] = (world.bytes[use] || 0) + part.array.byteLength;
    }
    const image = node.material.map?.image;
    if (image) world.bytes.textures = (world.bytes.textures || 0) + Math.round(image.width * image.height * 4 * 4 / 3);
  });
  world.mesh = group;
  canvas.hidden = false;
  scene.add(group);
  scene.updateMatrixWorld(true);
  return faces;
}

function setName(name, faces, center, radius) {
  world.center.copy(center);
  world.radius = radius > 0 ? radius : 1;
  byId("name").textContent = byId("name").title = name;
  byId("facts").textContent = `${Math.round(faces).toLocaleString("en")} faces`;
}

async function openFile(file) {
  try {
    await open(await file.arrayBuffer(), file.name);
    setCameras([]);
    fit();
  } catch (error) { say(`${file.name} cannot be shown: ${error.message || error}`); }
}
