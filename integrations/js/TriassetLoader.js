// Reads packed `.triasset` files, versions 1.0 and 1.1, as three.js meshes that look as the standard tier of
// MeshSplatBench draws them: unlit, two-sided, the first of equally near faces.
import {
  BufferAttribute, BufferGeometry, ClampToEdgeWrapping, DataTexture, DoubleSide, FileLoader, LessDepth,
  LinearFilter, LinearMipmapLinearFilter, LinearSRGBColorSpace, Loader, Mesh, MeshBasicMaterial,
  MirroredRepeatWrapping, NearestFilter, NearestMipmapNearestFilter, RepeatWrapping, SRGBColorSpace,
} from "three";

const LOCAL = 0x04034b50, CENTRAL = 0x02014b50, END = 0x06054b50;  // signatures of ZIP
const NOT_STORED = 0x2049;  // flags of what is encrypted, or has its size behind its data
const SATURATED = 0xffffffff;
const MEMBERS = 65, BUFFERS = 64, MANIFEST_BYTES = 1 << 20, TEXELS = 16384;
const ALIGNMENT = 64;
const NAME = /^(manifest\.json|buffers\/[A-Za-z0-9_-][A-Za-z0-9_.-]{0,99}\.bin)$/;
const TYPES = { float32: Float32Array, uint32: Uint32Array, uint8: Uint8Array };
const PASSES = ["bake_dc", "opaque_unlit", "opaque_unlit_texture"];
const WRAPS = { repeat: RepeatWrapping, clamp: ClampToEdgeWrapping, mirror: MirroredRepeatWrapping };
const FILTERS = { linear: [LinearFilter, LinearMipmapLinearFilter], nearest: [NearestFilter, NearestMipmapNearestFilter] };
const SH_C0 = 0.28209479177387814;  // of the constant spherical harmonic
// The daylight on a mesh without colours: its grey, the ambient part, and where the rest comes from, along
// (right, up, front); then the axes that lie to the right and in front of each up.
const GREY = 0.8, AMBIENT = 0.35, LIGHT = [0.36, 0.8, 0.48];
const AROUND = { x: [2, 1], y: [0, 2], z: [1, 0] };
const ROUNDING = 1e-6;  // of alphas that are interpolated

function insist(condition, text) { if (!condition) throw new Error(text); }

const isObject = (value) => typeof value === "object" && value !== null && !Array.isArray(value);
const isCount = (value) => Number.isInteger(value) && value >= 1 && value <= SATURATED;

// ---- the file

// The members of a stored ZIP: name -> its bytes. They follow each other from byte 0.
function membersOf(data) {
  const view = new DataView(data), size = data.byteLength, members = new Map(), names = new Set();
  insist(size >= 30 && view.getUint32(0, true) === LOCAL, "is no packed .triasset, which starts with 50 4b 03 04");
  let at = 0;
  while (at + 30 <= size && view.getUint32(at, true) === LOCAL) {
    const nameLength = view.getUint16(at + 26, true), extraLength = view.getUint16(at + 28, true);
    const start = at + 30 + nameLength + extraLength;
    insist(start <= size, `is cut short: a member's header ends at byte ${start} of ${size}`);
    const name = String.fromCharCode(...new Uint8Array(data, at + 30, nameLength));
    insist(NAME.test(name) && !name.includes(".."), `holds a member that is neither manifest.json nor buffers/NAME.bin: ${JSON.stringify(name.slice(0, 80))}`);
    insist(view.getUint16(at + 8, true) === 0 && !(view.getUint16(at + 6, true) & NOT_STORED), `${name} is compressed or encrypted; members are stored`);
    const [packed, bytes] = sizesOf(view, at, at + 30 + nameLength, start);
    insist(packed === bytes, `${name} has two sizes: ${packed} and ${bytes}`);
    insist(start % ALIGNMENT === 0, `${name} starts at byte ${start}, which is no multiple of ${ALIGNMENT}`);
    insist(start + bytes <= size, `is cut short: ${name} ends at byte ${start + bytes} of ${size}`);
    insist(!names.has(name.toLowerCase()), `holds ${name} twice`);
    insist(members.size < MEMBERS, `has more than ${MEMBERS} members`);
    members.set(name, new Uint8Array(data, start, bytes));
    names.add(name.toLowerCase());
    at = start + bytes;
  }
  const last = size - 22;
  insist(last > at && view.getUint32(at, true) === CENTRAL && view.getUint32(last, true) === END, "is cut short: its directory does not end it");
  const counted = view.getUint16(last + 10, true), begun = view.getUint32(last + 16, true);
  insist([members.size, 0xffff].includes(counted) && [at, SATURATED].includes(begun), "has a directory that does not follow its members");
  return members;
}

// Packed size and size of a member; those of 4 GiB and more stand in a record of ZIP64.
function sizesOf(view, header, extra, end) {
  let packed = view.getUint32(header + 18, true), size = view.getUint32(header + 22, true);
  for (let at = extra; (packed === SATURATED || size === SATURATED) && at + 4 <= end;) {
    const length = view.getUint16(at + 2, true);
    if (view.getUint16(at, true) === 1 && length >= 16 && at + 20 <= end) {
      size = Number(view.getBigUint64(at + 4, true));
      packed = Number(view.getBigUint64(at + 12, true));
    }
    at += 4 + length;
  }
  return [packed, size];
}

function manifestOf(bytes) {
  insist(bytes, "has no manifest.json");
  insist(bytes.length <= MANIFEST_BYTES, "has a manifest.json of more than 1 MiB");
  let manifest;
  try { manifest = JSON.parse(new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes)); } catch (error) {
    throw new Error(`has a manifest.json that is no JSON: ${error.message}`);
  }
  insist(isObject(manifest) && manifest.format === "triasset", 'has a manifest.json whose format is not "triasset"');
  const [, major, minor] = /^(\d+)\.(\d+)$/.exec(manifest.version) || [];
  insist(major === "1", `has version ${JSON.stringify(manifest.version)}; this loader reads 1.0 and 1.1`);
  if (Number(minor) > 1) console.warn(`TriassetLoader: version ${manifest.version} is newer than 1.1`);
  insist(isCount(manifest.face_count) && isCount(manifest.vertex_count), "has no face_count and vertex_count from 1 to 2^32 - 1");
  insist(["srgb", "linear"].includes(manifest.color_space), "has a color_space that is neither srgb nor linear");
  for (const key of ["appearance", "buffers", "coordinate_frame", "required_passes", "settings"]) {
    insist(isObject(manifest[key]), `has a manifest.json without the object ${key}`);
  }
  return manifest;
}

// Name -> { values, shape, domain }: views into the file.
function buffersOf(manifest, members) {
  const counts = { vertex: manifest.vertex_count, face: manifest.face_count, corner: 3 * manifest.face_count };
  const found = new Map(), entries = Object.entries(manifest.buffers);
  insist(entries.length <= BUFFERS, `names more than ${BUFFERS} buffers`);
  for (const [name, spec] of entries) {
    const what = `buffer ${JSON.stringify(name.slice(0, 64))}`;
    insist(isObject(spec) && /^[a-z][a-z0-9_.]{0,63}$/.test(name), `${what} is not described as the format asks`);
    const { dtype, shape, offset, domain, byte_length: length } = spec;
    const member = members.get(spec.file), Type = Object.hasOwn(TYPES, dtype) ? TYPES[dtype] : null;
    insist(member, `${what} lies in a file that is not there`);
    insist(Type, `${what} has an unknown dtype`);
    insist(Array.isArray(shape) && shape.length >= 1 && shape.length <= 4 && shape.every(isCount), `${what} has no shape of 1 to 4 counts`);
    insist(domain === "global" || (Object.hasOwn(counts, domain) && shape[0] === counts[domain]), `${what} has not as many rows as its domain`);
    const count = shape.reduce((product, side) => product * side, 1);
    insist(length === count * Type.BYTES_PER_ELEMENT, `${what} has a byte_length that is not of its shape and dtype`);
    insist(Number.isInteger(offset) && offset >= 0 && offset % ALIGNMENT === 0 && offset + length <= member.length, `${what} does not lie within its file`);
    found.set(name, { values: new Type(member.buffer, member.byteOffset + offset, count), shape, domain });
  }
  return found;
}

// The buffer of a role, if it is there, as the format has it.
function roleOf(buffers, name, dtypes, widths, domains) {
  const buffer = buffers.get(name);
  if (!buffer) return null;
  const { values, shape, domain } = buffer, width = shape[1] ?? 1;
  const fits = dtypes.some((dtype) => values instanceof TYPES[dtype]) && shape.length <= 2 && widths.includes(width);
  insist(fits && domains.includes(domain), `buffer ${name} has not the dtype, shape and domain of its meaning`);
  insist(!(values instanceof Float32Array) || name === "opacity" || values.every(Number.isFinite), `buffer ${name} holds a value that is not finite`);
  return { values, width, domain };
}

function read(data) {
  const members = membersOf(data), manifest = manifestOf(members.get("manifest.json"));
  return { manifest, buffers: buffersOf(manifest, members) };
}

// ---- the look

// IEC 61966-2-1.
const decoded = (value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);

// Stored colours as what three.js computes with: linear light, alpha as it is.
function linearColors({ values, width }, harmonic, encoded) {
  const found = new Float32Array(values.length), full = values instanceof Uint8Array ? 255 : 1;
  for (let i = 0; i < values.length; i += 1) {
    const value = Math.min(1, Math.max(0, harmonic ? SH_C0 * values[i] + 0.5 : values[i] / full));
    found[i] = encoded && i % width < 3 ? decoded(value) : value;
  }
  return { values: found, width };
}

// The axis that points up: where it is unknown +y of a mesh file, and -y of a trained scene, as COLMAP has it.
function upOf({ coordinate_frame: { up }, method }) {
  const [sign, axis] = /^[+-][xyz]$/.test(up) ? up : method === "mesh" ? "+y" : "-y";
  return [Number(`${sign}1`), axis];
}

// The grey of each face in daylight; both of its sides are alike.
function daylight(positions, indices, [sign, axis], encoded) {
  const [right, front] = AROUND[axis], light = [0, 0, 0];
  [light[right], light["xyz".indexOf(axis)], light[front]] = [LIGHT[0], sign * LIGHT[1], sign * LIGHT[2]];
  const found = new Float32Array(indices.length), far = Math.hypot(...light);
  for (let i = 0; i < indices.length; i += 3) {
    const [a, b, c] = [0, 1, 2].map((k) => positions.subarray(3 * indices[i + k], 3 * indices[i + k] + 3));
    const u = [0, 1, 2].map((k) => b[k] - a[k]), v = [0, 1, 2].map((k) => c[k] - a[k]);
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    const facing = Math.abs(n[0] * light[0] + n[1] * light[1] + n[2] * light[2]) / (far * Math.hypot(...n)) || 0;
    const value = GREY * (AMBIENT + (1 - AMBIENT) * facing);
    found.fill(encoded ? decoded(value) : value, i, i + 3);
  }
  return { values: found, width: 3, domain: "face" };
}

function colorsOf(buffers, encoded) {
  const domains = ["vertex", "face", "corner"];
  const stored = roleOf(buffers, "color", ["uint8", "float32"], [3, 4], domains);
  const harmonic = stored ? null : roleOf(buffers, "f_dc", ["float32"], [3], domains);
  const found = stored || harmonic;
  return found && { ...found, ...linearColors(found, harmonic !== null, encoded) };
}

// The numbers of the faces that an STE threshold leaves, in float32 as torch rounds; then by their texture.
function drawnFaces(manifest, buffers, shown) {
  const threshold = manifest.settings.ste_threshold?.value ?? null, f = Math.fround;
  const opacity = threshold === null ? null : roleOf(buffers, "opacity", ["float32"], [1], ["face"]);
  const all = Uint32Array.from({ length: manifest.face_count }, (_, face) => face);
  const left = opacity ? all.filter((face) => f(1 / f(1 + f(Math.exp(-opacity.values[face])))) > f(threshold)) : all;
  return shown ? left.sort((a, b) => shown[a] - shown[b]) : left;
}

// Rows of a buffer for `corners`, which are numbered 3 face + k.
function taken({ values, width, domain }, corners, indices) {
  const found = new values.constructor(width * corners.length);
  for (let i = 0; i < corners.length; i += 1) {
    const row = domain === "vertex" ? indices[corners[i]] : domain === "face" ? Math.floor(corners[i] / 3) : corners[i];
    for (let k = 0; k < width; k += 1) found[width * i + k] = values[width * row + k];
  }
  return found;
}

function textureOf({ values, shape }, { filter, mipmaps, wrap_u: u, wrap_v: v }, encoded) {
  const [height, width, channels] = shape, rgba = new Uint8Array(4 * width * height).fill(255);
  for (let i = 0; i < width * height; i += 1) {
    for (let k = 0; k < channels; k += 1) rgba[4 * i + k] = values[channels * i + k];
  }
  const made = new DataTexture(rgba, width, height), [near, far] = FILTERS[filter];
  Object.assign(made, { wrapS: WRAPS[u], wrapT: WRAPS[v], magFilter: near, minFilter: mipmaps ? far : near });
  Object.assign(made, { generateMipmaps: mipmaps, colorSpace: encoded ? SRGBColorSpace : LinearSRGBColorSpace, needsUpdate: true });
  return made;
}

function texturesOf({ appearance, color_space: space }, buffers) {
  if (appearance.kind !== "texture") return [];
  const { filter, mipmaps, wrap_u: u, wrap_v: v, alpha_cutoff: cutoff } = appearance;
  const fits = Object.hasOwn(FILTERS, filter) && typeof mipmaps === "boolean" && [u, v].every((wrap) => Object.hasOwn(WRAPS, wrap));
  insist(fits && (cutoff === null || (cutoff >= 0 && cutoff <= 1)), "has an appearance that is no sampler: filter, mipmaps, wrap_u, wrap_v, alpha_cutoff");
  const found = [];
  for (let k = 0; buffers.has(`texture.${k}`); k += 1) {
    const one = buffers.get(`texture.${k}`), { shape, values } = one;
    const isImage = shape.length === 3 && [3, 4].includes(shape[2]) && Math.max(shape[0], shape[1]) <= TEXELS;
    insist(values instanceof Uint8Array && isImage, `buffer texture.${k} is no image of bytes, H x W x 3 or 4`);
    found.push(textureOf(one, appearance, space === "srgb"));
  }
  insist(found.length, "has textures by its appearance, but no buffer texture.0");
  return found;
}

// Colours that are stored as sRGB are interpolated so, as when they were trained; three.js interpolates linear
// light. A renderer without GLSL (WebGPURenderer) does that: right at corners, levels away between them.
function interpolateStored(shader) {
  shader.vertexShader = shader.vertexShader.replace("#include <color_vertex>", `#include <color_vertex>
    vColor.rgb = mix(1.055 * pow(vColor.rgb, vec3(1.0 / 2.4)) - 0.055, 12.92 * vColor.rgb, vec3(lessThanEqual(vColor.rgb, vec3(0.0031308))));`);
  shader.fragmentShader = shader.fragmentShader.replace("#include <color_fragment>", `
    vec3 stored = max(vColor.rgb, 0.0);
    diffuseColor.rgb *= mix(pow((stored + 0.055) / 1.055, vec3(2.4)), stored / 12.92, vec3(lessThanEqual(stored, vec3(0.04045))));`);
}

function meshOf({ manifest, buffers }) {
  const passes = manifest.required_passes.standard;
  insist(Array.isArray(passes), `is of the method ${JSON.stringify(manifest.method)}, which has no standard tier: no colours without its own renderer`);
  insist(passes.every((pass) => PASSES.includes(pass)), `needs passes that this loader does not know: ${passes.filter((pass) => !PASSES.includes(pass)).join(", ")}`);
  const position = roleOf(buffers, "positions", ["float32"], [3], ["vertex"]);
  const indices = roleOf(buffers, "indices", ["uint32"], [3], ["face"])?.values;
  insist(position && indices, "lacks its buffer positions or indices");
  insist(indices.every((index) => index < manifest.vertex_count), `has an index of a vertex that is not among its ${manifest.vertex_count}`);
  const textures = texturesOf(manifest, buffers), encoded = manifest.color_space === "srgb", up = upOf(manifest);
  let color = colorsOf(buffers, encoded);
  if (!color && !textures.length) color = daylight(position.values, indices, up, encoded);
  // Alpha is for the cut-off of textures.
  if (color && !textures.length && color.width === 4) {
    color = { ...color, width: 3, values: color.values.filter((_, i) => i % 4 < 3) };
  }
  const uv = textures.length ? roleOf(buffers, "uv", ["float32"], [2], ["vertex", "corner"]) : null;
  insist(uv || !textures.length, "has textures, but no buffer uv");
  const shown = textures.length > 1 ? roleOf(buffers, "face_texture", ["uint32"], [1], ["face"])?.values : null;
  insist(shown || textures.length <= 1, "has several textures, but no buffer face_texture");
  insist(!shown || shown.every((k) => k < textures.length), `shows a texture in buffer face_texture that is not among its ${textures.length}`);

  const faces = drawnFaces(manifest, buffers, shown), corners = new Uint32Array(3 * faces.length);
  for (let i = 0; i < corners.length; i += 1) corners[i] = 3 * faces[Math.floor(i / 3)] + i % 3;
  const geometry = new BufferGeometry(), parts = { position, color, uv };
  const shared = [color, uv].every((part) => !part || part.domain === "vertex");
  for (const [name, part] of Object.entries(parts).filter(([, part]) => part)) {
    geometry.setAttribute(name, new BufferAttribute(shared ? part.values.slice() : taken(part, corners, indices), part.width));
  }
  if (shared) geometry.setIndex(new BufferAttribute(taken({ values: indices, width: 1, domain: "corner" }, corners, indices), 1));
  const common = { vertexColors: color !== null, side: DoubleSide, depthFunc: LessDepth, toneMapped: false };
  const cutoff = manifest.appearance.alpha_cutoff ?? null;
  const alphaTest = textures.length && cutoff !== null ? Math.max(0, cutoff - ROUNDING) : 0;
  const materials = (textures.length ? textures : [null]).map((map) => new MeshBasicMaterial({ ...common, map, alphaTest }));
  if (encoded && !textures.length) materials[0].onBeforeCompile = interpolateStored;
  for (let start = 0; shown && start < faces.length;) {
    let end = start;
    while (end < faces.length && shown[faces[end]] === shown[faces[start]]) end += 1;
    geometry.addGroup(3 * start, 3 * (end - start), shown[faces[start]]);
    start = end;
  }
  const mesh = new Mesh(geometry, materials.length > 1 ? materials : materials[0]);
  mesh.up.set(0, 0, 0)[up[1]] = up[0];
  mesh.userData.triasset = manifest;
  return mesh;
}

// Puts the name of a file before what is wrong with it.
function named(name, make) {
  try { return make(); } catch (error) { throw new Error(`TriassetLoader: ${name} ${error.message}`, { cause: error }); }
}

export const readTriasset = (data, name = "the file") => named(name, () => read(data));

export class TriassetLoader extends Loader {
  load(url, onLoad, onProgress, onError) {
    const loader = new FileLoader(this.manager).setPath(this.path).setResponseType("arraybuffer");
    loader.setRequestHeader(this.requestHeader).setWithCredentials(this.withCredentials);
    loader.load(url, (data) => {
      try { onLoad(this.parse(data, url)); } catch (error) {
        if (onError) onError(error); else console.error(error);
        this.manager.itemError(url);
      }
    }, onProgress, onError);
  }

  parse(data, name = "the file") { return named(name, () => meshOf(read(data))); }
}
