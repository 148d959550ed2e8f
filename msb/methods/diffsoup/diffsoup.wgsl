// DiffSoup: opaque triangles with lattices of features and opacity, and a small decoder.
// This file translates diffsoup_math.cl and diffsoup_project.cl for graphics hardware; the comments there explain more.
// Sources: kenji-tojo/diffsoup at c74e35d: src/cuda/rasterize.cu, multires.cu, encoding.cu.
//
// Before the decoder, products and sums must not be fused, because rounding decides which triangle covers a pixel.
#if COMPUTE
#include "source.wgsl"
#else
#include "exact.wgsl"
#endif

struct Face {
    quad: vec4<f32>,
    corner0: vec4<f32>, // clip coordinates
    corner1: vec4<f32>,
    corner2: vec4<f32>,
    number: vec4<f32>,  // lower 16 bits, upper 16 bits, 1 if no interpolated opacity is below the threshold
}

fn clip_of(p: vec3<f32>) -> vec4<f32> {
    return vec4<f32>(affine(view.full[0], p), affine(view.full[1], p), affine(view.full[2], p),
                     affine(view.full[3], p));
}

// Row 0 of the raster is NDC y = -1, which is the top of the image only in the "colmap" layout.
fn turned(row: i32) -> i32 { return select(row, i32(view.height) - 1 - row, view.flip == 1u); }

fn centre_of(pixel: i32, size: u32) -> f32 { return keep(div(f32(2 * pixel + 1), f32(size)) - 1.0); }

fn centre_at(x: i32, y: i32) -> vec2<f32> {
    return vec2<f32>(centre_of(x, view.width), centre_of(turned(y), view.height));
}

struct Meeting {
    b0: f32, // barycentric coordinates of corners 0 and 1, linear in world space
    b1: f32,
    ndc: f32,
    w: f32,  // the camera's z
    inside: bool,
}

// Returns the point where the ray of the pixel with NDC centre `c` meets a triangle.
fn meeting_at(c: vec2<f32>, p0: vec4<f32>, p1: vec4<f32>, p2: vec4<f32>) -> Meeting {
    let q0 = keep2(p0.xy - keep2(c * p0.w));
    let q1 = keep2(p1.xy - keep2(c * p1.w));
    let q2 = keep2(p2.xy - keep2(c * p2.w));
    let a0 = cross2(q1, q2);
    let a1 = cross2(q2, q0);
    let area = add(add(a0, a1), cross2(q0, q1));
    let k = div(1.0, area);
    var m: Meeting;
    m.b0 = mul(a0, k);
    m.b1 = mul(a1, k);
    let b = vec3<f32>(m.b0, m.b1, keep(keep(1.0 - m.b0) - m.b1));
    m.w = dot3(b, vec3<f32>(p0.w, p1.w, p2.w));
    m.ndc = div(dot3(b, vec3<f32>(p0.z, p1.z, p2.z)), m.w);
    m.inside = area != 0.0 && m.b0 >= 0.0 && m.b1 >= 0.0 && add(m.b0, m.b1) <= 1.0 && m.ndc >= -1.0
        && m.ndc <= 1.0;
    return m;
}

// ---- lattices

const SAMPLES = (SIDE + 1u) * (SIDE + 2u) / 2u;

// The three lattice nodes around a point, and their weights.
// The second lattice node follows the first in memory.
struct Cell {
    first: u32,
    last: u32,
    weight: vec3<f32>,
}

fn cell_at(b0: f32, b1: f32) -> Cell {
    let side = i32(SIDE);
    let scaled = vec2<f32>(b0, b1) * f32(SIDE); // the product is exact, because the factor is a power of two
    let x = min(i32(scaled.x), side - 1);
    let y = min(i32(scaled.y), side - 1 - x);
    let u = keep(scaled.x - f32(x));
    let v = keep(scaled.y - f32(y));
    let over = add(u, v) > 1.0;
    let w0 = select(u, keep(1.0 - v), over);
    let w1 = select(v, keep(1.0 - u), over);
    let s = x + y + 1;
    let first = s * (s + 1) / 2 + y;
    let y2 = min(y + 1, side - 1 - x);
    let s2 = x + 1 + y2;
    let last = select(first - s, s2 * (s2 + 1) / 2 + y2, over);
    return Cell(u32(first), u32(last), vec3<f32>(w0, w1, keep(keep(1.0 - w0) - w1)));
}

#if BYTES
fn texel_of(word: u32, number: u32) -> f32 {
    return div(f32(extractBits(word, 8u * (number & 3u), 8u)), 255.0);
}
#endif

#if COMPUTE
fn in_range(ndc: f32) -> f32 { return select(select(-1.0, ndc, ndc > -1.0), 1.0, ndc > 1.0); }

// First and last pixel along one axis.
fn pixel_range(a: f32, b: f32, c: f32, size: u32) -> vec2<i32> {
    let low = keep(0.5 * add(min(min(a, b), c), 1.0));
    let high = keep(0.5 * add(max(max(a, b), c), 1.0));
    let n = f32(size);
    return vec2<i32>(i32(floor(mul(low, n))), min(i32(floor(mul(high, n))), i32(size) - 1));
}

fn project_face(number: u32, face: ptr<function, Face>) -> Projected {
    var result: Projected;
    let p = positions_of(corners_of(number));
    let p0 = clip_of(p[0]);
    let p1 = clip_of(p[1]);
    let p2 = clip_of(p[2]);
    (*face).corner0 = p0;
    (*face).corner1 = p1;
    (*face).corner2 = p2;
    (*face).number = vec4<f32>(f32(number & 0xffffu), f32(number >> 16u), coverage[number], 0.0);
    let front = vec3<bool>(p0.w > 0.0, p1.w > 0.0, p2.w > 0.0);
    // The official code clips nothing: a triangle with a corner at or behind the camera plane is dropped.
    // A game engine keeps the part in front of the camera. The triangle's rectangle is then the whole image,
    // and the depth test discards the part behind the camera.
#if ENGINE
    let dropped = !any(front);
#else
    let dropped = !all(front);
#endif
    let below = (p0.xyz < vec3<f32>(-p0.w)) & (p1.xyz < vec3<f32>(-p1.w)) & (p2.xyz < vec3<f32>(-p2.w));
    let above = (p0.xyz > vec3<f32>(p0.w)) & (p1.xyz > vec3<f32>(p1.w)) & (p2.xyz > vec3<f32>(p2.w));
    if (dropped || any(below | above)) {
        return result;
    }
    let i0 = div(1.0, p0.w);
    let i1 = div(1.0, p1.w);
    let i2 = div(1.0, p2.w);
    var x = pixel_range(in_range(mul(p0.x, i0)), in_range(mul(p1.x, i1)), in_range(mul(p2.x, i2)), view.width);
    var y = pixel_range(in_range(mul(p0.y, i0)), in_range(mul(p1.y, i1)), in_range(mul(p2.y, i2)), view.height);
    if (!all(front)) {
        x = vec2<i32>(0, i32(view.width) - 1);
        y = vec2<i32>(0, i32(view.height) - 1);
    }
    result.kept = x.x <= x.y && y.x <= y.y;
    result.tiles = vec4<i32>(x.x, y.x, x.y + 1, y.y + 1);
    let rows = vec2<i32>(turned(y.x), turned(y.y));
    result.samples = vec4<i32>(x.x, min(rows.x, rows.y), x.y, max(rows.x, rows.y));
    return result;
}
#if DECODING
#include "fragment.wgsl"

// ---- the colour of a pixel

@group(0) @binding(7) var<storage, read> features: array<TEXEL>;

// The weights are stored as 4 x 4 matrices, ordered by output block, then by input block.
struct Decoder {
    weight: array<mat4x4<f32>, 36>,
    bias: array<vec4<f32>, 9>,
}
@group(0) @binding(8) var<uniform> decoder: Decoder;

fn feature(at: u32) -> f32 {
#if BYTES
    return texel_of(features[at / 4u], at);
#else
    return features[at];
#endif
}

// Feature vectors of a lattice node: `low` has features 0 to 3, `high` has features 4 to 6.
struct Node {
    low: vec4<f32>,
    high: vec3<f32>,
}
fn node_at(at: u32) -> Node {
    return Node(vec4<f32>(feature(at), feature(at + 1u), feature(at + 2u), feature(at + 3u)),
                vec3<f32>(feature(at + 4u), feature(at + 5u), feature(at + 6u)));
}

// The direction from the surface towards the camera is opposite to the pixel's ray.
// The direction is computed from the cofactors of the rotation, which may not be exactly orthogonal.
// The official code computes this direction from the near and far points by the inverse projection, with equal results.
fn towards_camera(c: vec2<f32>) -> vec3<f32> {
    let off = 2.0 * view.shift / vec2<f32>(f32(view.width), f32(view.height));
    // In the "colmap" layout the principal point has the official sign.
    let down = select(1.0, -1.0, view.flip == 1u);
    let slope = vec2<f32>(c.x - off.x, down * (c.y + off.y)) * view.tan_fov;
    let a = view.world_to_camera[0].xyz;
    let b = view.world_to_camera[1].xyz;
    let d = view.world_to_camera[2].xyz;
    return -normalize(slope.x * cross(b, d) + slope.y * cross(d, a) + cross(a, b));
}

fn four_of(x: mat4x4<f32>, weight: u32, bias: u32) -> vec4<f32> {
    return decoder.bias[bias] + decoder.weight[weight] * x[0] + decoder.weight[weight + 1u] * x[1]
        + decoder.weight[weight + 2u] * x[2] + decoder.weight[weight + 3u] * x[3];
}

fn hidden_layer(x: mat4x4<f32>, weight: u32, bias: u32) -> mat4x4<f32> {
    let zero = vec4<f32>(0.0);
    return mat4x4<f32>(max(four_of(x, weight, bias), zero), max(four_of(x, weight + 4u, bias + 1u), zero),
                       max(four_of(x, weight + 8u, bias + 2u), zero),
                       max(four_of(x, weight + 12u, bias + 3u), zero));
}

fn surface_at(number: u32, x: i32, y: i32) -> Seen {
    let c = centre_at(x, y);
    let p = positions_of(corners_of(number));
    let m = meeting_at(c, clip_of(p[0]), clip_of(p[1]), clip_of(p[2]));
    let cell = cell_at(m.b0, m.b1);
    let start = (number - part.first) * SAMPLES;
    let n0 = node_at(7u * (start + cell.first));
    let n1 = node_at(7u * (start + cell.first + 1u));
    let n2 = node_at(7u * (start + cell.last));
    let low = cell.weight.x * n0.low + cell.weight.y * n1.low + cell.weight.z * n2.low;
    let high = cell.weight.x * n0.high + cell.weight.y * n1.high + cell.weight.z * n2.high;
    let d = towards_camera(c);
    let harmonics = mat2x4<f32>(
        vec4<f32>(-0.4886025119029199 * d.y, 0.4886025119029199 * d.z, -0.4886025119029199 * d.x,
                  1.0925484305920792 * d.x * d.y),
        vec4<f32>(-1.0925484305920792 * d.y * d.z, 0.31539156525252005 * (2.0 * d.z * d.z - d.x * d.x - d.y * d.y),
                  -1.0925484305920792 * d.x * d.z, 0.5462742152960396 * (d.x * d.x - d.y * d.y)));
    let inputs = mat4x4<f32>(low, vec4<f32>(high, 0.28209479177387814), harmonics[0], harmonics[1]);
    let hidden = hidden_layer(hidden_layer(inputs, 0u, 0u), 16u, 4u);
    let decoded = 1.0 / (1.0 + exp(-four_of(hidden, 32u, 8u).xyz));
    return Seen((1.0 - low.w) * low.xyz + low.w * decoded, 1.0, m.w);
}
#endif
#else

// ---- the visible face of a pixel

struct Part {
    first: u32,
    count: u32,
}
@group(0) @binding(2) var<storage, read> opacity: array<TEXEL>;
@group(0) @binding(3) var<uniform> part: Part;

fn number_of(face: Face) -> u32 { return u32(face.number.x) | (u32(face.number.y) << 16u); }

fn opacity_of(at: u32) -> f32 {
#if BYTES
    return texel_of(opacity[at / 4u], at);
#else
    return opacity[at];
#endif
}

// ---- the outline that is drawn for a face

const MARGIN = 0.0625;   // in pixels; widens an outline, because hardware snaps corners to 1/256
const ROUNDING = 1.9073486328125e-6; // 2^-19: thirty-two rounding errors
const FARTHEST = 16384.0; // in pixels; corners farther away are rounded too much
const THINNEST = 0.1;    // in pixels; the minimum height of a triangle above its longest edge
const LONGEST = 16.0;    // in pixels; the largest distance by which a corner is moved

fn picture_of(p: vec4<f32>, half: vec2<f32>) -> vec2<f32> {
    let at = p.xy / p.w * half + half;
    return vec2<f32>(at.x, select(at.y, 2.0 * half.y - at.y, view.flip == 1u));
}

// Returns corner `index` of the drawn triangle strip.
// The edges of the triangle are moved outwards.
// The edges move by more than the rounding errors of the hardware and of the edge functions in `meeting_at`.
// Returns `corner`, a corner of the rectangle, if the moved triangle is unsuitable. Unsuitable triangles are
// hardly smaller than the rectangle, too thin, too far away or too pointed. The outline only reduces the
// number of fragments; it does not decide which pixels are covered.
fn outline(face: Face, index: u32, corner: vec2<f32>) -> vec2<f32> {
    let p = array<vec4<f32>, 3>(face.corner0, face.corner1, face.corner2);
    let half = 0.5 * vec2<f32>(f32(view.width), f32(view.height));
    let s = array<vec2<f32>, 3>(picture_of(p[0], half), picture_of(p[1], half), picture_of(p[2], half));
    let reach = max(max(abs(s[0]), abs(s[1])), abs(s[2]));
    let ab = s[1] - s[0];
    let ac = s[2] - s[0];
    let twice = ab.x * ac.y - ab.y * ac.x;
    let longest = max(max(length(ab), length(ac)), length(s[2] - s[1]));
    if (!(min(p[0].w, min(p[1].w, p[2].w)) > 0.0 && max(reach.x, reach.y) < FARTHEST
          && abs(twice) > THINNEST * longest)) {
        return corner;
    }
    var error = 0.0; // rounding error of an edge function
    for (var k = 0; k < 3; k++) {
        let a = abs(p[k]);
        let b = abs(p[(k + 1) % 3]);
        error += (a.x + a.w) * (b.y + b.w) + (a.y + a.w) * (b.x + b.w);
    }
    error *= ROUNDING;
    var normal: array<vec2<f32>, 3>; // outward normals of the edges from corner k to corner k + 1
    var moved: array<f32, 3>;
    for (var k = 0; k < 3; k++) {
        let e = s[(k + 1) % 3] - s[k];
        let long = length(e);
        normal[k] = sign(twice) * vec2<f32>(e.y, -e.x) / long;
        // Change of the edge function per pixel.
        moved[k] = MARGIN + error * half.x * half.y / (p[k].w * p[(k + 1) % 3].w * long);
    }
    var out: array<vec2<f32>, 3>; // intersections of the two moved edges of each corner
    var farthest = 0.0;
    for (var k = 0; k < 3; k++) {
        let n = normal[k];
        let m = normal[(k + 2) % 3];
        let far = moved[(k + 2) % 3];
        let step = vec2<f32>(far * n.y - moved[k] * m.y, m.x * moved[k] - n.x * far) / (m.x * n.y - m.y * n.x);
        farthest = max(farthest, length(step));
        out[k] = s[k] + step;
    }
    let u = out[1] - out[0];
    let v = out[2] - out[0];
    let whole = (face.quad.z - face.quad.x + 1.0) * (face.quad.w - face.quad.y + 1.0);
    if (!(0.5 * abs(u.x * v.y - u.y * v.x) < 0.8 * whole && farthest < LONGEST)) {
        return corner;
    }
    return out[min(index, 2u)];
}

fn place_of(face: Face, x: i32, y: i32) -> Place {
    let m = meeting_at(centre_at(x, y), face.corner0, face.corner1, face.corner2);
    // The official depth key is NDC depth + 2, between 1 and 3.
    // The value (key - 1) / 4 is exact in float32.
    var place = Place(m.inside && m.ndc > -1.0, keep(keep(m.ndc + 2.0) - 1.0) * 0.25);
    // The opacity array may be bound in several parts, and an outline may reach beyond the official rectangle.
    let at = vec2<f32>(f32(x), f32(y));
    place.inside = place.inside && number_of(face) - part.first < part.count
        && all(at >= face.quad.xy) && all(at <= face.quad.zw);
    if (place.inside && face.number.z == 0.0) {
        let cell = cell_at(m.b0, m.b1);
        let start = (number_of(face) - part.first) * SAMPLES;
        let first = start + cell.first;
        let value = dot3(cell.weight, vec3<f32>(opacity_of(first), opacity_of(first + 1u),
                                                opacity_of(start + cell.last)));
        place.inside = !(value < 0.5);
    }
    return place;
}
#endif
