// 3DGS: Gaussians, projected by a local affine map.
// This file translates three_dgs.cl for graphics hardware; the comments there explain more.
// Sources: graphdeco-inria/diff-gaussian-rasterization at 59f5f77: cuda_rasterizer/forward.cu, auxiliary.h;
// nerfstudio-project/gsplat at 90d7b4b.

const STOP = 1e-4; // a Gaussian that would lower the transmittance T below this value is not blended
const MAX_ALPHA = 0.99;
const DILATION = 0.3;
#if GSPLAT
const NEAREST = 0.01;
#else
const NEAREST = 0.2;
#endif
const LOG2E = 1.4426950408889634;

struct Face {
    quad: vec4<f32>,
    center: vec4<f32>, // mean in samples, then a and b of the base-2 exponent a dx^2 + b dx dy + c dy^2
    shape: vec4<f32>, // c, opacity, the exponent at which alpha is 1/255, depth of the mean
    color: vec4<f32>, // then the slope of the depth along x
    slope: vec4<f32>, // the slope of the depth along y
}

#if COMPUTE
#include "source.wgsl"

fn point_seen(rows: vec3<u32>) -> vec3<f32> { return position(rows.x); }

fn project_face(number: u32, face: ptr<function, Face>) -> Projected {
    var result: Projected;
    let row = 3u * number;
    let mean = position(row);
    let t = to_camera(mean);
    if (!(t.z > NEAREST)) {
        return result;
    }
    result.depth = t.z;

    // The Jacobian of the projection; a mean far outside the image is moved towards the image first.
    let size = vec2<f32>(f32(view.width), f32(view.height));
    let focal = vec2<f32>(div(size.x, 2.0 * view.tan_fov.x), div(size.y, 2.0 * view.tan_fov.y));
#if GSPLAT
    let middle = keep2(size / 2.0 + view.shift);
    let slack = keep2(0.3 * view.tan_fov);
    let rest = keep2(size - middle);
    let low = -vec2<f32>(add(div(middle.x, focal.x), slack.x), add(div(middle.y, focal.y), slack.y));
    let high = vec2<f32>(add(div(rest.x, focal.x), slack.x), add(div(rest.y, focal.y), slack.y));
#else
    let high = keep2(1.3 * view.tan_fov);
    let low = -high;
#endif
    let tx = mul(lesser(greater(div(t.x, t.z), low.x), high.x), t.z);
    let ty = mul(lesser(greater(div(t.y, t.z), low.y), high.y), t.z);
    let squared = mul(t.z, t.z);
    let jx = div(focal.x, t.z);
    let jy = div(focal.y, t.z);
    let kx = -div(mul(focal.x, tx), squared);
    let ky = -div(mul(focal.y, ty), squared);

    // Rows p, q of J W, and the covariance on the screen with and without the dilation.
    let ahead = view.world_to_camera[2].xyz;
    let p = add3(scale3(view.world_to_camera[0].xyz, jx), scale3(ahead, kx));
    let q = add3(scale3(view.world_to_camera[1].xyz, jy), scale3(ahead, ky));
    let first = position(row + 1u); // xx, xy, xz
    let second = position(row + 2u); // yy, yz, zz
    let rx = first;
    let ry = vec3<f32>(first.y, second.x, second.y);
    let rz = vec3<f32>(first.z, second.y, second.z);
    let vp = vec3<f32>(dot3(p, rx), dot3(p, ry), dot3(p, rz));
    let vq = vec3<f32>(dot3(q, rx), dot3(q, ry), dot3(q, rz));
    let sharp_x = dot3(vp, p);
    let xy = dot3(vp, q);
    let sharp_y = dot3(vq, q);
    let xx = add(sharp_x, DILATION);
    let yy = add(sharp_y, DILATION);
    let determinant = keep(mul(xx, yy) - mul(xy, xy));
    if (determinant == 0.0) {
        return result;
    }
    var opacity = coverage[number];
#if ANTIALIASED
    let sharp = keep(mul(sharp_x, sharp_y) - mul(xy, xy));
    opacity = mul(opacity, root(greater(div(sharp, determinant), 0.000025)));
#endif
    let inverse = div(1.0, determinant);

    // The mean of z at a sample, the mean on the screen, and the samples with an alpha of 1/255 or more.
    let with_x = dot3(vp, ahead);
    let with_y = dot3(vq, ahead);
    let rise = keep2(vec2<f32>(yy * with_x - xy * with_y, xx * with_y - xy * with_x) * inverse);
    let shrink = div(1.0, add(affine(view.full[3], mean), 1e-7));
    let x = add(to_sample(mul(affine(view.full[0], mean), shrink), view.width), view.shift.x);
    let y = add(to_sample(mul(affine(view.full[1], mean), shrink), view.height), view.shift.y);
    let level = log2(greater(mul(255.0, opacity), 1e-30)); // negative if alpha never reaches 1/255
    let reach = sqrt(greater((2.0 / LOG2E) * (level + 2e-4), 0.0));
    let extent = vec2<f32>(reach * sqrt(xx) + 0.01, reach * sqrt(yy) + 0.01);
    result.samples = box_of(vec2<f32>(x, y) - extent, vec2<f32>(x, y) + extent);
    if (!(determinant > 0.0)) { // if rounding made the covariance indefinite, any sample may be covered
        result.samples = vec4<i32>(0, 0, i32(view.width) - 1, i32(view.height) - 1);
    }
    if (level < -2e-4) {
        result.samples = vec4<i32>(0, 0, -1, -1);
    }

#if GSPLAT
    let most = lesser(root(greater(mul(2.0 / LOG2E, level), 0.0)), 3.33);
    let w = vec2<f32>(ceil(mul(most, root(xx))), ceil(mul(most, root(yy))));
    let pixel = vec2<f32>(add(x, 0.5), add(y, 0.5));
    let lower = keep2(pixel - w);
    let upper = keep2(pixel + w);
    if (!(all(upper > vec2<f32>(0.0)) && all(lower < size) && opacity >= 1.0 / 255.0)) {
        return result;
    }
    result.tiles = vec4<i32>(tile_number(lower.x / 16.0, view.columns), tile_number(lower.y / 16.0, view.rows),
                             tile_after(upper.x / 16.0, view.columns), tile_after(upper.y / 16.0, view.rows));
#else
    let half_sum = mul(0.5, add(xx, yy));
    let spread = root(greater(keep(mul(half_sum, half_sum) - determinant), 0.1));
    let radius = ceil(mul(3.0, root(add(half_sum, spread))));
    result.tiles = vec4<i32>(tile_number(keep(x - radius) / 16.0, view.columns),
                             tile_number(keep(y - radius) / 16.0, view.rows),
                             tile_number(keep(keep(x + radius) + 15.0) / 16.0, view.columns),
                             tile_number(keep(keep(y + radius) + 15.0) / 16.0, view.rows));
#endif
    result.kept = result.tiles.z > result.tiles.x && result.tiles.w > result.tiles.y;
    (*face).center = vec4<f32>(x, y, -0.5 * LOG2E * mul(yy, inverse), LOG2E * mul(xy, inverse));
    (*face).shape = vec4<f32>(-0.5 * LOG2E * mul(xx, inverse), opacity, -level - 1e-4, t.z);
    (*face).color.w = rise.x;
    (*face).slope.x = rise.y;
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
    let dx = face.center.x - x;
    let dy = face.center.y - y;
    let power = (face.center.z * dx * dx + face.shape.x * dy * dy) + face.center.w * dx * dy;
    let alpha = min(MAX_ALPHA, face.shape.y * exp2(max(power, -100.0)));
    let inside = power <= 0.0 && power >= face.shape.z;
    let depth = max(face.shape.w - face.color.w * dx - face.slope.x * dy, 0.5 * NEAREST);
    return Seen(face.color.xyz, select(0.0, alpha, inside), depth);
}
#endif
