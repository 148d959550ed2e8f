// Loads packed `.triasset` files, versions 1.0 and 1.1, as three.js meshes that look like the standard tier of
// MeshSplatBench: unlit, two-sided, and at equal depths the first face is visible.
import {
  BufferAttribute, BufferGeometry, ClampToEdgeWrapping, DataTexture, DoubleSide, FileLoader, LessDepth,
  LinearFilter, LinearMipmapLinearFilter, LinearSRGBColorSpace, Loader, Mesh, MeshBasicMaterial,
  MirroredRepeatWrapping, NearestFilter, NearestMipmapNearestFilter, RepeatWrapping, SRGBColorSpace,
} from "three";

const LOCAL = 0x04034b50, CENTRAL = 0x02014b50, END = 0x06054b50;  // signatures of ZIP
const NOT_STORED = 0x2049;  // flags of encrypted members, and of members with their size after their data
const SATURATED = 0xffffffff;  // a 32-bit field whose value is in a ZIP64 record
const MEMBERS = 65, BUFFERS = 64, MANIFEST_BYTES = 1 << 20, TEXELS = 16384;
const ALIGNMENT = 64;
const NAME = /^(manifest\.json|buffers\/[A-Za-z0-9_-][A-Za-z0-9_.-]{0,99}\.bin)$/;
const TYPES = { float32: Float32Array, uint32: Uint32Array, uint8: Uint8Array };
const PASSES = ["bake_dc", "opaque_unlit", "opaque_unlit_texture"];
const WRAPS = { repeat: RepeatWrapping, clamp: ClampToEdgeWrapping, mirror: MirroredRepeatWrapping };
const FILTERS = { linear: [LinearFilter, LinearMipmapLinearFilter], nearest: [NearestFilter, NearestMipmapNearestFilter] };
const SH_C0 = 0.28209479177387814;  // the constant spherical harmonic
// A mesh without colours is grey and lit: GREY is its brightness, AMBIENT the share of ambient light, LIGHT the direction
// to the light as (right, up, front). AROUND maps the up axis to the numbers of the right and the front axis.
const GREY = 0.8, AMBIENT = 0.35, LIGHT = [0.36, 0.8, 0.48];
const AROUND = { x: [2, 1], y: [0, 2], z: [1, 0] };
const ROUNDING = 1e-6;  // rounding error of interpolated alphas

function insist(condition, text) { if (!condition) throw new Error(text); }

const isObject = (value) => typeof value === "object" && value !== null && !Array.isArray(value);
const isCount = (value) => Number.isInteger(value) && value >= 1 && value <= SATURATED;

// ---- the file

// Returns the bytes of each member of an uncompressed ZIP by name. The members are contiguous from byte 0 on.
function membersOf(data) {
  const view = new DataView(data), size = data.byteLength, members = new Map(), names = new Set();
  insist(size >= 30 && view.getUint32(0, true) === LOCAL, "is not a packed .triasset, which starts with the bytes 50 4b 03 04");
  let at = 0;
  while (at + 30 <= size && view.getUint32(at, true) === LOCAL) {
    const nameLength = view.getUint16(at + 26, true), extraLength = view.getUint16(at + 28, true);
    const start = at + 30 + nameLength + extraLength;
    insist(start <= size, `is truncated: the header of a member ends at byte ${start} of ${size}`);
    const name = String.fromCharCode(...new Uint8Array(data, at + 30, nameLength));
    insist(NAME.test(name) && !name.includes(".."), `contains a member that is neither manifest.json nor buffers/NAME.bin: ${JSON.stringify(name.slice(0, 80))}`);
    insist(view.getUint16(at + 8, true) === 0 && !(view.getUint16(at + 6, true) & NOT_STORED), `has the member ${name}, which is compressed or encrypted; members must be uncompressed`);
    const [packed, bytes] = sizesOf(view, at, at + 30 + nameLength, start);
    insist(packed === bytes, `has the member ${name} with two different sizes: ${packed} and ${bytes}`);
    insist(start % ALIGNMENT === 0, `has the member ${name} at byte ${start}, which is not a multiple of ${ALIGNMENT}`);
    insist(start + bytes <= size, `is truncated: ${name} ends at byte ${start + bytes} of ${size}`);
    insist(!names.has(name.toLowerCase()), `contains ${name} twice`);
    insist(members.size < MEMBERS, `has more than ${MEMBERS} members`);
    members.set(name, new Uint8Array(data, start, bytes));
    names.add(name.toLowerCase());
    at = start + bytes;
  }
  const last = size - 22;
  insist(last > at && view.getUint32(at, true) === CENTRAL && view.getUint32(last, true) === END, "is truncated: it does not end with a ZIP directory");
  const count = view.getUint16(last + 10, true), start = view.getUint32(last + 16, true);
  insist([members.size, 0xffff].includes(count) && [at, SATURATED].includes(start), "has a ZIP directory that does not match its members");
  return members;
}

// Returns the compressed and the uncompressed size of a member; sizes of 4 GiB and more are in a ZIP64 record.
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

// Parses and checks the manifest.
function manifestOf(bytes) {
  insist(bytes, "has no manifest.json");
  insist(bytes.length <= MANIFEST_BYTES, "has a manifest.json of more than 1 MiB");
  let manifest;
  try { manifest = JSON.parse(new TextDecoder("utf-8", { fatal: true, ignoreBOM: true }).decode(bytes)); } catch (error) {
    throw new Error(`has a manifest.json that is not valid JSON: ${error.message}`);
  }
  insist(isObject(manifest) && manifest.format === "triasset", 'has a manifest.json whose format is not "triasset"');
  const [, major, minor] = /^(\d+)\.(\d+)$/.exec(manifest.version) || [];
  insist(major === "1", `has version ${JSON.stringify(manifest.version)}; this loader reads 1.0 and 1.1`);
  if (Number(minor) > 1) console.warn(`TriassetLoader: version ${manifest.version} is newer than 1.1`);
  insist(isCount(manifest.face_count) && isCount(manifest.vertex_count), "lacks a face_count or vertex_count from 1 to 2^32 - 1");
  insist(["srgb", "linear"].includes(manifest.color_space), "has a color_space that is neither srgb nor linear");
  for (const key of ["appearance", "buffers", "coordinate_frame", "required_passes", "settings"]) {
    insist(isObject(manifest[key]), `has a manifest.json without the object ${key}`);
  }
  return manifest;
}

// Returns { values, shape, domain } of each buffer by name; the values are views into the file.
function buffersOf(manifest, members) {
  const counts = { vertex: manifest.vertex_count, face: manifest.face_count, corner: 3 * manifest.face_count };
  const buffers = new Map(), entries = Object.entries(manifest.buffers);
  insist(entries.length <= BUFFERS, `has more than ${BUFFERS} buffers`);
  for (const [name, spec] of entries) {
    const what = `buffer ${JSON.stringify(name.slice(0, 64))}`;
    insist(isObject(spec) && /^[a-z][a-z0-9_.]{0,63}$/.test(name), `has an invalid description of ${what}`);
    const { dtype, shape, offset, domain, byte_length: length } = spec;
    const member = members.get(spec.file), Type = Object.hasOwn(TYPES, dtype) ? TYPES[dtype] : null;
    insist(member, `has ${what} in a file that does not exist`);
    insist(Type, `has ${what} with an unknown dtype`);
    insist(Array.isArray(shape) && shape.length >= 1 && shape.length <= 4 && shape.every(isCount), `has ${what} with an invalid shape; 1 to 4 positive integers are required`);
    insist(domain === "global" || (Object.hasOwn(counts, domain) && shape[0] === counts[domain]), `has ${what}, whose number of rows does not match its domain`);
    const count = shape.reduce((product, side) => product * side, 1);
    insist(length === count * Type.BYTES_PER_ELEMENT, `has ${what} with a byte_length that does not match its shape and dtype`);
    insist(Number.isInteger(offset) && offset >= 0 && offset % ALIGNMENT === 0 && offset + length <= member.length, `has ${what} outside its file or at an unaligned offset`);
    buffers.set(name, { values: new Type(member.buffer, member.byteOffset + offset, count), shape, domain });
  }
  return buffers;
}

// Returns the buffer with a standard name, or null if it is missing. Throws if its dtype, width or domain is invalid.
function roleOf(buffers, name, dtypes, widths, domains) {
  const buffer = buffers.get(name);
  if (!buffer) return null;
  const { values, shape, domain } = buffer, width = shape[1] ?? 1;
  const fits = dtypes.some((dtype) => values instanceof TYPES[dtype]) && shape.length <= 2 && widths.includes(width);
  insist(fits && domains.includes(domain), `has the buffer ${name} with an invalid dtype, shape or domain`);
  insist(!(values instanceof Float32Array) || name === "opacity" || values.every(Number.isFinite), `has the buffer ${name} with a value that is not finite`);
  return { values, width, domain };
}

function read(data) {
  const members = membersOf(data), manifest = manifestOf(members.get("manifest.json"));
  return { manifest, buffers: buffersOf(manifest, members) };
}

// ---- colours and textures

// The sRGB curve (IEC 61966-2-1).
const decode = (value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);

// Returns stored colours as linear light, as three.js requires; alpha is unchanged. If `harmonic` is true, the colours are
// coefficients of spherical harmonics; if `encoded` is true, they are sRGB.
function linearColors({ values, width }, harmonic, encoded) {
  const linear = new Float32Array(values.length), full = values instanceof Uint8Array ? 255 : 1;
  for (let i = 0; i < values.length; i += 1) {
    const value = Math.min(1, Math.max(0, harmonic ? SH_C0 * values[i] + 0.5 : values[i] / full));
    linear[i] = encoded && i % width < 3 ? decode(value) : value;
  }
  return { values: linear, width };
}

// Returns the up axis. If it is unknown, it is +y for mesh files, and -y (as in COLMAP) for trained models.
function upOf({ coordinate_frame: { up }, method }) {
  const [sign, axis] = /^[+-][xyz]$/.test(up) ? up : method === "mesh" ? "+y" : "-y";
  return [Number(`${sign}1`), axis];
}

// Returns a grey for each corner, shaded by the angle between its face and the light, equally on both sides.
function daylight(positions, indices, [sign, axis], encoded) {
  const [right, front] = AROUND[axis], light = [0, 0, 0];
  [light[right], light["xyz".indexOf(axis)], light[front]] = [LIGHT[0], sign * LIGHT[1], sign * LIGHT[2]];
  const greys = new Float32Array(indices.length), length = Math.hypot(...light);
  for (let i = 0; i < indices.length; i += 3) {
    const [a, b, c] = [0, 1, 2].map((k) => positions.subarray(3 * indices[i + k], 3 * indices[i + k] + 3));
    const u = [0, 1, 2].map((k) => b[k] - a[k]), v = [0, 1, 2].map((k) => c[k] - a[k]);
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    const facing = Math.abs(n[0] * light[0] + n[1] * light[1] + n[2] * light[2]) / (length * Math.hypot(...n)) || 0;
    const value = GREY * (AMBIENT + (1 - AMBIENT) * facing);
    greys.fill(encoded ? decode(value) : value, i, i + 3);
  }
  return { values: greys, width: 3, domain: "face" };
}

// Returns the static colours of an asset as linear light, or null.
function colorsOf(buffers, encoded) {
  const domains = ["vertex", "face", "corner"];
  const stored = roleOf(buffers, "color", ["uint8", "float32"], [3, 4], domains);
  const harmonic = stored ? null : roleOf(buffers, "f_dc", ["float32"], [3], domains);
  const colors = stored || harmonic;
  return colors && { ...colors, ...linearColors(colors, harmonic !== null, encoded) };
}

// Returns the numbers of the faces above the STE threshold (with the float32 roundings of torch), sorted by texture.
function drawnFaces(manifest, buffers, textureNumbers) {
  const threshold = manifest.settings.ste_threshold?.value ?? null, f = Math.fround;
  const opacity = threshold === null ? null : roleOf(buffers, "opacity", ["float32"], [1], ["face"]);
  const all = Uint32Array.from({ length: manifest.face_count }, (_, face) => face);
  const selected = opacity ? all.filter((face) => f(1 / f(1 + f(Math.exp(-opacity.values[face])))) > f(threshold)) : all;
  return textureNumbers ? selected.sort((a, b) => textureNumbers[a] - textureNumbers[b]) : selected;
}

// Returns the rows of a buffer for `corners`, whose numbers are 3 face + k.
function expand({ values, width, domain }, corners, indices) {
  const rows = new values.constructor(width * corners.length);
  for (let i = 0; i < corners.length; i += 1) {
    const row = domain === "vertex" ? indices[corners[i]] : domain === "face" ? Math.floor(corners[i] / 3) : corners[i];
    for (let k = 0; k < width; k += 1) rows[width * i + k] = values[width * row + k];
  }
  return rows;
}

function textureOf({ values, shape }, { filter, mipmaps, wrap_u: u, wrap_v: v }, encoded) {
  const [height, width, channels] = shape, rgba = new Uint8Array(4 * width * height).fill(255);
  for (let i = 0; i < width * height; i += 1) {
    for (let k = 0; k < channels; k += 1) rgba[4 * i + k] = values[channels * i + k];
  }
  const texture = new DataTexture(rgba, width, height), [near, far] = FILTERS[filter];
  Object.assign(texture, { wrapS: WRAPS[u], wrapT: WRAPS[v], magFilter: near, minFilter: mipmaps ? far : near });
  Object.assign(texture, { generateMipmaps: mipmaps, colorSpace: encoded ? SRGBColorSpace : LinearSRGBColorSpace, needsUpdate: true });
  return texture;
}

// Returns the textures of an asset, or an empty array if it has no textures.
function texturesOf({ appearance, color_space: space }, buffers) {
  if (appearance.kind !== "texture") return [];
  const { filter, mipmaps, wrap_u: u, wrap_v: v, alpha_cutoff: cutoff } = appearance;
  const fits = Object.hasOwn(FILTERS, filter) && typeof mipmaps === "boolean" && [u, v].every((wrap) => Object.hasOwn(WRAPS, wrap));
  insist(fits && (cutoff === null || (cutoff >= 0 && cutoff <= 1)), "has an invalid appearance: filter, mipmaps, wrap_u, wrap_v or alpha_cutoff");
  const textures = [];
  for (let k = 0; buffers.has(`texture.${k}`); k += 1) {
    const buffer = buffers.get(`texture.${k}`), { shape, values } = buffer;
    const isImage = shape.length === 3 && [3, 4].includes(shape[2]) && Math.max(shape[0], shape[1]) <= TEXELS;
    insist(values instanceof Uint8Array && isImage, `has the buffer texture.${k}, which is not an image of bytes with shape H x W x 3 or 4`);
    textures.push(textureOf(buffer, appearance, space === "srgb"));
  }
  insist(textures.length, "has an appearance with textures, but no buffer texture.0");
  return textures;
}

// Changes a shader to interpolate colours as sRGB, as in training, because three.js interpolates linear light. Renderers
// without GLSL (WebGPURenderer) ignore this change; their colours are exact at corners and differ by some levels of 255
// elsewhere.
function interpolateStored(shader) {
  shader.vertexShader = shader.vertexShader.replace("#include <color_vertex>", `#include <color_vertex>
    vColor.rgb = mix(1.055 * pow(vColor.rgb, vec3(1.0 / 2.4)) - 0.055, 12.92 * vColor.rgb, vec3(lessThanEqual(vColor.rgb, vec3(0.0031308))));`);
  shader.fragmentShader = shader.fragmentShader.replace("#include <color_fragment>", `
    vec3 stored = max(vColor.rgb, 0.0);
    diffuseColor.rgb *= mix(pow((stored + 0.055) / 1.055, vec3(2.4)), stored / 12.92, vec3(lessThanEqual(stored, vec3(0.04045))));`);
}

// Returns the three.js mesh of an asset.
function meshOf({ manifest, buffers }) {
  const passes = manifest.required_passes.standard;
  insist(Array.isArray(passes), `is a model of ${JSON.stringify(manifest.method)}, which has colours only in its native rendering`);
  insist(passes.every((pass) => PASSES.includes(pass)), `needs render passes that this loader does not support: ${passes.filter((pass) => !PASSES.includes(pass)).join(", ")}`);
  const position = roleOf(buffers, "positions", ["float32"], [3], ["vertex"]);
  const indices = roleOf(buffers, "indices", ["uint32"], [3], ["face"])?.values;
  insist(position && indices, "lacks its buffer positions or indices");
  insist(indices.every((index) => index < manifest.vertex_count), `has an index outside its ${manifest.vertex_count} vertices`);
  const textures = texturesOf(manifest, buffers), encoded = manifest.color_space === "srgb", up = upOf(manifest);
  let color = colorsOf(buffers, encoded);
  if (!color && !textures.length) color = daylight(position.values, indices, up, encoded);
  // Alpha is used only for the cutoff of textures.
  if (color && !textures.length && color.width === 4) {
    color = { ...color, width: 3, values: color.values.filter((_, i) => i % 4 < 3) };
  }
  const uv = textures.length ? roleOf(buffers, "uv", ["float32"], [2], ["vertex", "corner"]) : null;
  insist(uv || !textures.length, "has textures, but no buffer uv");
  const numbers = textures.length > 1 ? roleOf(buffers, "face_texture", ["uint32"], [1], ["face"])?.values : null;
  insist(numbers || textures.length <= 1, "has several textures, but no buffer face_texture");
  insist(!numbers || numbers.every((k) => k < textures.length), `has a number in buffer face_texture outside its ${textures.length} textures`);

  const faces = drawnFaces(manifest, buffers, numbers), corners = new Uint32Array(3 * faces.length);
  for (let i = 0; i < corners.length; i += 1) corners[i] = 3 * faces[Math.floor(i / 3)] + i % 3;
  // Without vertex sharing (colours or UVs of faces or corners) every corner becomes a vertex.
  const geometry = new BufferGeometry(), parts = { position, color, uv };
  const shared = [color, uv].every((part) => !part || part.domain === "vertex");
  for (const [name, part] of Object.entries(parts).filter(([, part]) => part)) {
    geometry.setAttribute(name, new BufferAttribute(shared ? part.values.slice() : expand(part, corners, indices), part.width));
  }
  if (shared) geometry.setIndex(new BufferAttribute(expand({ values: indices, width: 1, domain: "corner" }, corners, indices), 1));
  const common = { vertexColors: color !== null, side: DoubleSide, depthFunc: LessDepth, toneMapped: false };
  const cutoff = manifest.appearance.alpha_cutoff ?? null;
  const alphaTest = textures.length && cutoff !== null ? Math.max(0, cutoff - ROUNDING) : 0;
  const materials = (textures.length ? textures : [null]).map((map) => new MeshBasicMaterial({ ...common, map, alphaTest }));
  if (encoded && !textures.length) materials[0].onBeforeCompile = interpolateStored;
  // A group of faces for each texture.
  for (let start = 0; numbers && start < faces.length;) {
    let end = start;
    while (end < faces.length && numbers[faces[end]] === numbers[faces[start]]) end += 1;
    geometry.addGroup(3 * start, 3 * (end - start), numbers[faces[start]]);
    start = end;
  }
  const mesh = new Mesh(geometry, materials.length > 1 ? materials : materials[0]);
  mesh.up.set(0, 0, 0)[up[1]] = up[0];
  mesh.userData.triasset = manifest;
  if (manifest.origin !== undefined) {
    const { origin } = manifest;
    insist(Array.isArray(origin) && origin.length === 3 && origin.every(Number.isFinite), "has an origin that is not three finite numbers");
    mesh.position.set(...origin);
  }
  return mesh;
}

// Calls `make` and puts the name of the file at the start of error messages.
function withFileName(name, make) {
  try { return make(); } catch (error) { throw new Error(`TriassetLoader: ${name} ${error.message}`, { cause: error }); }
}

export const readTriasset = (data, name = "the file") => withFileName(name, () => read(data));

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

  parse(data, name = "the file") { return withFileName(name, () => meshOf(read(data))); }
}
