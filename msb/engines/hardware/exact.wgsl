// Arithmetic with the roundings of the official kernels, protected from compiler optimisations.
//
// WGSL allows a compiler to fuse products into sums, and some compilers also reorder sums.
// A depth key, an edge distance or a tile rectangle then differs in its last bit.
// As a result, a face is blended in another order, or is missing in a whole tile.
// The function `keep` prevents these rounding differences. The function computes the exclusive or of a value
// and a 0 from the uniform buffer. The compiler cannot know the 0, so it must compute and round the value at
// this point.
#include "view.wgsl"

fn keep(x: f32) -> f32 { return bitcast<f32>(bitcast<u32>(x) ^ view.zero); }
fn keep2(x: vec2<f32>) -> vec2<f32> { return bitcast<vec2<f32>>(bitcast<vec2<u32>>(x) ^ vec2<u32>(view.zero)); }
fn keep3(x: vec3<f32>) -> vec3<f32> { return bitcast<vec3<f32>>(bitcast<vec3<u32>>(x) ^ vec3<u32>(view.zero)); }

fn keep4(x: vec4<f32>) -> vec4<f32> { return bitcast<vec4<f32>>(bitcast<vec4<u32>>(x) ^ vec4<u32>(view.zero)); }

fn mul(a: f32, b: f32) -> f32 { return keep(a * b); }
fn add(a: f32, b: f32) -> f32 { return keep(a + b); }

// Returns the rounding error of the product p of a and b.
// Each factor is split into its upper and lower twelve bits, whose products are exact (Dekker).
// The fma of WGSL cannot be used because it may round twice.
fn product_error(a: f32, b: f32, p: f32) -> f32 {
    let ah = bitcast<f32>(bitcast<u32>(a) & 0xfffff000u);
    let bh = bitcast<f32>(bitcast<u32>(b) & 0xfffff000u);
    let al = keep(a - ah);
    let bl = keep(b - bh);
    return add(add(add(keep(mul(ah, bh) - p), mul(ah, bl)), mul(al, bh)), mul(al, bl));
}

// In WGSL a division may have an error of 2.5 units in the last place, a square root even more.
// The remainder is computed exactly and divided again.
// The quotient is then correctly rounded, except for overflow or underflow.
fn div(a: f32, b: f32) -> f32 {
    let q = keep(a / b);
    let p = mul(q, b);
    let size = abs(q);
    let whole = abs(p);
    let better = keep(q + keep(keep(keep(a - p) - product_error(q, b, p)) / b));
    return select(q, better, size > 1e-25 && size < 1e25 && whole > 1e-25 && whole < 1e25 && abs(b) < 1e25);
}
fn root(a: f32) -> f32 {
    let s = keep(sqrt(a));
    let p = mul(s, s);
    let better = keep(s + keep(keep(keep(a - p) - product_error(s, s, p)) / (2.0 * s)));
    return select(s, better, a > 1e-25 && a < 1e25);
}

// The two functions below return b if a or b is NaN.
// (The functions min and max of WGSL are undefined for NaN.)
fn lesser(a: f32, b: f32) -> f32 { return select(b, a, a < b); }
fn greater(a: f32, b: f32) -> f32 { return select(b, a, a > b); }

// ---- vectors; sums add the components from the first to the last

fn dot2(a: vec2<f32>, b: vec2<f32>) -> f32 { return add(mul(a.x, b.x), mul(a.y, b.y)); }
fn cross2(a: vec2<f32>, b: vec2<f32>) -> f32 { return keep(mul(a.x, b.y) - mul(a.y, b.x)); }
fn length2(a: vec2<f32>) -> f32 { return root(dot2(a, a)); }
fn sub2(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> { return keep2(a - b); }
fn add2(a: vec2<f32>, b: vec2<f32>) -> vec2<f32> { return keep2(a + b); }
fn scale2(a: vec2<f32>, s: f32) -> vec2<f32> { return keep2(a * s); }

fn dot3(a: vec3<f32>, b: vec3<f32>) -> f32 { return add(add(mul(a.x, b.x), mul(a.y, b.y)), mul(a.z, b.z)); }
fn length3(a: vec3<f32>) -> f32 { return root(dot3(a, a)); }
fn sub3(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> { return keep3(a - b); }
fn add3(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> { return keep3(a + b); }
fn scale3(a: vec3<f32>, s: f32) -> vec3<f32> { return keep3(a * s); }
fn div3(a: vec3<f32>, s: f32) -> vec3<f32> { return vec3<f32>(div(a.x, s), div(a.y, s), div(a.z, s)); }
fn cross3(a: vec3<f32>, b: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(cross2(a.yz, b.yz), cross2(a.zx, b.zx), cross2(a.xy, b.xy));
}
fn center_of(a: vec3<f32>, b: vec3<f32>, c: vec3<f32>) -> vec3<f32> { return div3(add3(add3(a, b), c), 3.0); }

fn affine(row: vec4<f32>, p: vec3<f32>) -> f32 { return add(dot3(row.xyz, p), row.w); }
fn to_camera(p: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(affine(view.world_to_camera[0], p), affine(view.world_to_camera[1], p),
                     affine(view.world_to_camera[2], p));
}
fn rotate_to_camera(v: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot3(view.world_to_camera[0].xyz, v), dot3(view.world_to_camera[1].xyz, v),
                     dot3(view.world_to_camera[2].xyz, v));
}

// Returns ((ndc + 1) size - 1) / 2: the centre of pixel i is the integer i.
// The official code computes this in double precision and rounds once.
// In this file, the result is the sum of two floats: a rounded value, and the rounding errors of product and
// sum.
fn to_sample(ndc: f32, size: u32) -> f32 {
    let n = f32(size);
    let m = n - 1.0;
    let product = mul(ndc, n);
    let sum = add(product, m);
    let part = keep(sum - product);
    let sum_error = add(keep(product - keep(sum - part)), keep(m - part));
    let whole = add(sum, add(product_error(ndc, n, product), sum_error));
    return select(sum, whole, abs(sum) < 1e25) * 0.5;
}

// ---- tiles and boxes of samples: (x0, y0, x1, y1)

// Converts to an integer as CUDA does: rounds towards zero, saturates, and maps NaN to 0. The result is at
// most `limit`.
fn tile_number(value: f32, limit: u32) -> i32 {
    let low = select(0.0, value, value > 0.0);
    return i32(floor(select(f32(limit), low, low < f32(limit))));
}

// Like `tile_number`, but rounds up to an integer.
fn tile_after(value: f32, limit: u32) -> i32 {
    let low = select(0.0, value, value > 0.0);
    return i32(ceil(select(f32(limit), low, low < f32(limit))));
}

// Returns the box of the samples in [low, high], clamped to the raster; both ends are inclusive.
// If a bound is NaN, the box contains all samples.
fn box_of(low: vec2<f32>, high: vec2<f32>) -> vec4<i32> {
    let w = f32(view.width) - 1.0;
    let h = f32(view.height) - 1.0;
    // If the lower bound lies beyond the raster, the box is empty.
    let x0 = select(0.0, select(w + 1.0, low.x, low.x < w), low.x > 0.0);
    let y0 = select(0.0, select(h + 1.0, low.y, low.y < h), low.y > 0.0);
    let x1 = select(w, select(-1.0, high.x, high.x >= 0.0), high.x < w);
    let y1 = select(h, select(-1.0, high.y, high.y >= 0.0), high.y < h);
    return vec4<i32>(vec4<f32>(floor(x0 + 0.999), floor(y0 + 0.999), floor(x1), floor(y1)));
}
