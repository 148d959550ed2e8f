// 2DGS: Gaussian discs that are intersected with the ray of each sample.
// This file translates two_dgs.cl for graphics hardware; the comments there explain more.
// Sources: hbb1/diff-surfel-rasterization at e0ed020: cuda_rasterizer/forward.cu, auxiliary.h;
// nerfstudio-project/gsplat at 90d7b4b.

const STOP = 1e-4; // a disc that would lower the transmittance T below this value is not blended
const MAX_ALPHA = 0.99;
#if GSPLAT
const NEAREST = 0.01;
const SQUARE = 1.0; // squared radius, in standard deviations, of the disc inside the official box
#else
const NEAREST = 0.2;
const SQUARE = 9.0;
#endif
const FILTER = 0.707106; // standard deviation of the low-pass filter, in samples
const LEAST = 1e-4;
const LOG2E = 1.4426950408889634;
const COVERAGE = 4u; // opacity, then the normal

struct Face {
    quad: vec4<f32>,
    p: vec4<f32>, // the point d = (u, v, 1) is at sample (p . d / r . d, q . d / r . d); then x of the middle
    q: vec4<f32>, // then y of the middle
    r: vec4<f32>, // then opacity
    color: vec4<f32>, // then the largest u^2 + v^2 with an alpha of 1/255 or more
}

#if COMPUTE
#include "source.wgsl"

fn point_seen(rows: vec3<u32>) -> vec3<f32> { return position(rows.x); }

fn linear(row: vec4<f32>, v: vec3<f32>) -> f32 { return dot3(row.xyz, v); }

// Computes the box around a disc with the given squared radius. The box does not exist if `divisor` is 0; if
// `divisor` is not negative, the camera's plane cuts the disc.
struct DiscBox {
    middle: vec2<f32>,
    squares: vec2<f32>, // squares of half the sides
    divisor: f32,
}

fn half_square(a: vec3<f32>, middle: f32, s: f32, last: f32) -> f32 {
    let sum = add(add(mul(s, mul(a.x, a.x)), mul(s, mul(a.y, a.y))), mul(last, mul(a.z, a.z)));
    return keep(mul(middle, middle) - sum);
}

fn disc_middle(a: vec3<f32>, r: vec3<f32>, s: f32, last: f32) -> f32 {
    return add(add(mul(s, mul(a.x, r.x)), mul(s, mul(a.y, r.y))), mul(last, mul(a.z, r.z)));
}

fn disc_box(p: vec3<f32>, q: vec3<f32>, r: vec3<f32>, square: f32) -> DiscBox {
    let d = keep(add(mul(square, mul(r.x, r.x)), mul(square, mul(r.y, r.y))) - mul(r.z, r.z));
    let inverse = div(1.0, d);
    let s = mul(inverse, square);
    let x = disc_middle(p, r, s, -inverse);
    let y = disc_middle(q, r, s, -inverse);
    let squares = vec2<f32>(half_square(p, x, s, -inverse), half_square(q, y, s, -inverse));
    return DiscBox(vec2<f32>(x, y), squares, d);
}

fn project_face(number: u32, face: ptr<function, Face>) -> Projected {
    var result: Projected;
    let mean = position(3u * number);
    let t = to_camera(mean);
    let start = COVERAGE * number;
    let normal = vec3<f32>(coverage[start + 1u], coverage[start + 2u], coverage[start + 3u]);
    if (!(t.z > NEAREST) || dot3(t, rotate_to_camera(normal)) == 0.0) {
        return result;
    }
    result.depth = t.z;
    let opacity = coverage[start];

    // For both axes and the mean, p and q hold the screen position times depth, and r holds the depth.
    let size = vec2<f32>(f32(view.width), f32(view.height));
    let middle = keep2((size - 1.0) / 2.0 + view.shift);
    var p: vec3<f32>;
    var q: vec3<f32>;
    var r: vec3<f32>;
    for (var k = 0; k < 3; k++) {
        let axis = position(3u * number + u32((k + 1) % 3));
        var x = linear(view.full[0], axis);
        var y = linear(view.full[1], axis);
        var z = linear(view.full[3], axis);
        if (k == 2) {
            x = add(x, view.full[0].w);
            y = add(y, view.full[1].w);
            z = add(z, view.full[3].w);
        }
        p[k] = add(mul(x, size.x / 2.0), mul(z, middle.x));
        q[k] = add(mul(y, size.y / 2.0), mul(z, middle.y));
        r[k] = z;
    }
    let box = disc_box(p, q, r, SQUARE);
    if (box.divisor == 0.0) {
        return result;
    }
    let extent = vec2<f32>(root(greater(box.squares.x, LEAST)), root(greater(box.squares.y, LEAST)));

    // The samples with an alpha of 1/255 or more. The samples belong to the disc, or to the filter around the
    // middle of the official box.
    let limit = 2.0 / LOG2E * log2(greater(mul(255.0, opacity), 1e-30)) + 1e-3;
    let reach = disc_box(p, q, r, greater(limit, 0.0));
    let far = dot2(reach.middle, reach.middle);
    let sides = vec2<f32>(sqrt(greater(reach.squares.x, 0.0) + 2e-6 * far), sqrt(greater(reach.squares.y, 0.0) + 2e-6 * far));
    let blur = FILTER * sqrt(greater(limit, 0.0));
    let low = min(reach.middle - sides, box.middle - blur) - 0.02;
    let high = max(reach.middle + sides, box.middle + blur) + 0.02;
    result.samples = box_of(low, high);
    if (!(reach.divisor < 0.0)) {
        result.samples = vec4<i32>(0, 0, i32(view.width) - 1, i32(view.height) - 1);
    }
    if (limit < 0.0) {
        result.samples = vec4<i32>(0, 0, -1, -1);
    }

#if GSPLAT
    let w = vec2<f32>(ceil(mul(3.33, extent.x)), ceil(mul(3.33, extent.y)));
    let pixel = vec2<f32>(add(box.middle.x, 0.5), add(box.middle.y, 0.5));
    let lower = keep2(pixel - w);
    let upper = keep2(pixel + w);
    if (!(all(upper > vec2<f32>(0.0)) && all(lower < size))) {
        return result;
    }
    result.tiles = vec4<i32>(tile_number(lower.x / 16.0, view.columns), tile_number(lower.y / 16.0, view.rows),
                             tile_after(upper.x / 16.0, view.columns), tile_after(upper.y / 16.0, view.rows));
#else
    let radius = ceil(greater(greater(extent.x, extent.y), 3.0 * FILTER));
    let x = box.middle.x;
    let y = box.middle.y;
    result.tiles = vec4<i32>(tile_number(keep(x - radius) / 16.0, view.columns),
                             tile_number(keep(y - radius) / 16.0, view.rows),
                             tile_number(keep(keep(x + radius) + 15.0) / 16.0, view.columns),
                             tile_number(keep(keep(y + radius) + 15.0) / 16.0, view.rows));
#endif
    result.kept = result.tiles.z > result.tiles.x && result.tiles.w > result.tiles.y;
    (*face).p = vec4<f32>(p, box.middle.x);
    (*face).q = vec4<f32>(q, box.middle.y);
    (*face).r = vec4<f32>(r, opacity);
    (*face).color.w = limit;
    return result;
}

#if RECORDING
fn color_face(number: u32, face: ptr<function, Face>) {
    (*face).color = vec4<f32>(color_at(number), (*face).color.w);
}
#endif
#else
#include "exact.wgsl"
#include "fragment.wgsl"

fn cover(face: Face, x: f32, y: f32) -> Seen {
    let k = keep3(keep3(x * face.r.xyz) - face.p.xyz);
    let l = keep3(keep3(y * face.r.xyz) - face.q.xyz);
    let inverse = 1.0 / keep(keep(k.x * l.y) - keep(k.y * l.x));
    let u = keep(keep(k.y * l.z) - keep(k.z * l.y)) * inverse;
    let v = keep(keep(k.z * l.x) - keep(k.x * l.z)) * inverse;
    let depth = (u * face.r.x + v * face.r.y) + face.r.z;
    let dx = face.p.w - x;
    let dy = face.q.w - y;
    let disc = u * u + v * v;
    let filtered = 2.0 * (dx * dx + dy * dy);
    let square = select(disc, filtered, filtered < disc);
#if GSPLAT
    let inside = square <= face.color.w;
#else
    let inside = square <= face.color.w && depth >= NEAREST;
#endif
    let alpha = min(MAX_ALPHA, face.r.w * exp2(max(-0.5 * LOG2E * square, -100.0)));
    return Seen(face.color.xyz, select(0.0, alpha, inside), depth);
}
#endif
