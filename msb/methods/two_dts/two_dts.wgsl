// 2DTS: a triangle soup with a Gaussian-like falloff of global sharpness, and two rasterizers. This file
// translates two_dts.cl for graphics hardware; the comments there explain more.
// Sources: GaodeRender/triangle-splatting at 54c80f7: submodules/diff-triangle-rasterization-2D and -3D:
// src/forward.cu, src/auxiliary.h.

const EPS = 1e-8;
const DILATION = 3.0;
const MAX_ALPHA = 0.99;
const COVERAGE = 2u; // opacity, and the eccentricity at which alpha is 1/255 (negative if always below)

#if ENGINE
struct Face {
    quad: vec4<f32>,
    along_x: vec4<f32>,
    along_y: vec4<f32>,
    constant: vec4<f32>,
    color: vec4<f32>, // then opacity
    falloff: vec4<f32>, // the eccentricity of `coverage`
}
#else
#if PLANAR
// The vector from corner 1 in camera space to a point of the plane gives two barycentric coordinates.
// The product of this vector and dual2 is barycentric coordinate 2, and the product with dual3 is
// barycentric coordinate 3.
struct Face {
    quad: vec4<f32>,
    corner: vec4<f32>, // then the product of corner 1 and the normal
    dual2: vec4<f32>,  // then opacity
    dual3: vec4<f32>,  // then the eccentricity of `coverage`
    normal: vec4<f32>,
    color: vec4<f32>,
}
#else
struct Face {
    quad: vec4<f32>,
    x: vec4<f32>,     // corners in samples; then 1 / twice the area
    y: vec4<f32>,     // then opacity
    z: vec4<f32>,     // camera depth of the corners; then the eccentricity of `coverage`
    color: vec4<f32>,
}
#endif
#endif

#if COMPUTE
#include "source.wgsl"
#if ENGINE
#include "engine.wgsl"
#endif

fn point_seen(rows: vec3<u32>) -> vec3<f32> {
    return center_of(position(rows.x), position(rows.y), position(rows.z));
}

#if RECORDING
fn color_face(number: u32, face: ptr<function, Face>) {
    (*face).color = vec4<f32>(color_at(number), (*face).color.w);
}
#endif

#if ENGINE
// Graphics hardware draws nothing outside a triangle, but the falloff of this method extends beyond the edges.
// Therefore each triangle is enlarged about its centroid until it contains the whole falloff.
fn project_face(number: u32, face: ptr<function, Face>) -> Projected {
    let limit = coverage[COVERAGE * number + 1u];
    var corners = positions_of(corners_of(number));
    let center = center_of(corners[0], corners[1], corners[2]);
    for (var k = 0; k < 3; k++) {
        corners[k] = add3(center, scale3(sub3(corners[k], center), limit));
    }
    let t = project_engine(corners, false);
    (*face).along_x = t.along_x;
    (*face).along_y = t.along_y;
    (*face).constant = t.constant;
    (*face).color.w = coverage[COVERAGE * number];
    (*face).falloff.x = limit;
    let kept = t.seen && limit > 0.0 && !(view.back_culling == 1u && t.back);
    return Projected(kept, t.depth, engine_tiles(t.samples), t.samples);
}
#else

// The divisor is |w| + eps instead of w, so a point behind the camera has a negative z and fails the near test.
fn to_ndc(p: vec3<f32>) -> vec3<f32> {
    let inverse = div(1.0, add(abs(affine(view.full[3], p)), EPS));
    return vec3<f32>(mul(affine(view.full[0], p), inverse), mul(affine(view.full[1], p), inverse),
                     mul(affine(view.full[2], p), inverse));
}

// The tiles that the box of the dilated corners touches.
fn dilated_tiles(p: array<vec2<f32>, 3>) -> vec4<i32> {
    let low = vec2<f32>(lesser(lesser(p[0].x, p[1].x), p[2].x), lesser(lesser(p[0].y, p[1].y), p[2].y));
    let high = vec2<f32>(greater(greater(p[0].x, p[1].x), p[2].x), greater(greater(p[0].y, p[1].y), p[2].y));
    return vec4<i32>(tile_number(low.x / 16.0, view.columns), tile_number(low.y / 16.0, view.rows),
                     tile_number(keep(keep(high.x + 16.0) - 1.0) / 16.0, view.columns),
                     tile_number(keep(keep(high.y + 16.0) - 1.0) / 16.0, view.rows));
}

#if PLANAR
// The "3D" rasterizer: every sample's ray is intersected with the triangle's plane; no low-pass filter.
fn project_shape(corners: array<vec3<f32>, 3>, limit: f32, face: ptr<function, Face>) -> Projected {
    var result: Projected;
    let p = to_camera(corners[0]);
    let q = to_camera(corners[1]);
    let r = to_camera(corners[2]);
    let normal = cross3(sub3(q, p), sub3(r, p));
    if (length3(normal) < EPS || (view.back_culling == 1u && normal.z >= 0.0)) {
        return result;
    }
    let center = center_of(corners[0], corners[1], corners[2]);
    var dilated: array<vec2<f32>, 3>;
    for (var k = 0; k < 3; k++) {
        let ndc = to_ndc(add3(center, scale3(sub3(corners[k], center), DILATION)));
        if (ndc.z <= 0.0) {
            return result;
        }
        dilated[k] = vec2<f32>(
            add(keep(mul(mul(keep(ndc.x + 1.0), f32(view.width)), 0.5) - 0.5), view.shift.x),
            add(keep(mul(mul(keep(ndc.y + 1.0), f32(view.height)), 0.5) - 0.5), view.shift.y));
    }
    result.kept = true;
    result.tiles = dilated_tiles(dilated);
    result.depth = center_of(p, q, r).z;
    let scale = div(1.0, dot3(normal, normal));
    (*face).corner = vec4<f32>(p, dot3(p, normal));
    (*face).dual2 = vec4<f32>(scale3(cross3(sub3(r, p), normal), scale), 0.0);
    (*face).dual3 = vec4<f32>(scale3(cross3(normal, sub3(q, p)), scale), limit);
    (*face).normal = vec4<f32>(normal, 0.0);
    // The box is as large as the tiles, because covered samples are scattered if the plane is seen edge-on.
    result.samples = vec4<i32>(0, 0, i32(view.width) - 1, i32(view.height) - 1);
    return result;
}
#else
// The "2D" rasterizer: perspective is linearised at the centroid, and corners are moved outwards by half a sample.
fn project_shape(corners: array<vec3<f32>, 3>, limit: f32, face: ptr<function, Face>) -> Projected {
    var result: Projected;
    let center = center_of(corners[0], corners[1], corners[2]);
    let ndc = to_ndc(center);
    if (ndc.z <= 0.0) {
        return result;
    }
    let camera = to_camera(center);
    result.depth = camera.z;
    // The clamp affects only the Jacobian, not the projected centroid.
    let wide = mul(camera.z, view.tan_fov.x);
    let tall = mul(camera.z, view.tan_fov.y);
    let most = vec2<f32>(mul(mul(1.3, view.tan_fov.x), camera.z), mul(mul(1.3, view.tan_fov.y), camera.z));
    let clamped = vec2<f32>(lesser(greater(-most.x, camera.x), most.x), lesser(greater(-most.y, camera.y), most.y));
    let arms = array<vec3<f32>, 3>(rotate_to_camera(sub3(corners[0], center)),
                                   rotate_to_camera(sub3(corners[1], center)),
                                   rotate_to_camera(sub3(corners[2], center)));
    if (length3(cross3(arms[0], arms[1])) < EPS) {
        return result;
    }
    let middle = vec2<f32>(add(to_sample(ndc.x, view.width), view.shift.x),
                           add(to_sample(ndc.y, view.height), view.shift.y));
    var u: array<vec2<f32>, 3>;
    var dilated: array<vec2<f32>, 3>;
    for (var k = 0; k < 3; k++) {
        let arm = arms[k];
        var flat_arm = vec2<f32>(div(keep(arm.x - div(mul(arm.z, clamped.x), camera.z)), wide),
                                 div(keep(arm.y - div(mul(arm.z, clamped.y), camera.z)), tall));
        let far = length2(flat_arm);
        if (far < EPS) {
            return result;
        }
        let push = div(0.5, far); // moved outwards by half a sample: a low-pass filter
        flat_arm = vec2<f32>(mul(flat_arm.x, add(0.5 * f32(view.width), push)),
                             mul(flat_arm.y, add(0.5 * f32(view.height), push)));
        u[k] = add2(middle, flat_arm);
        dilated[k] = add2(middle, scale2(flat_arm, DILATION));
        (*face).x[k] = u[k].x;
        (*face).y[k] = u[k].y;
        (*face).z[k] = arm.z + camera.z;
    }
    let area = cross2(sub2(u[1], u[0]), sub2(u[2], u[0]));
    // The y axis points down, so a front face (counter-clockwise on the screen) has a negative area.
    result.kept = !select(abs(area) < EPS, area >= -EPS, view.back_culling == 1u);
    result.tiles = dilated_tiles(dilated);
    (*face).x.w = div(1.0, area);
    (*face).z.w = limit;

    // The points of eccentricity E form the triangle enlarged E times about its centroid.
    // In thin triangles, rounding moves samples by up to `noise`, so samples outside any tight box can be covered.
    let low = min(min(u[0], u[1]), u[2]);
    let high = max(max(u[0], u[1]), u[2]);
    let across = limit * max(high.x - low.x, high.y - low.y) + 16.0;
    let far = max(max(abs(low.x), abs(low.y)), max(abs(high.x), abs(high.y)));
    let noise = 4e-6 * across * (across + 0.1 * far) / abs(area);
    let grown = select(limit * 1.0001 + noise, 1e30, noise > 0.5);
    let mean = (u[0] + u[1] + u[2]) / 3.0;
    result.samples = box_of(mean + grown * (low - mean) - 0.01, mean + grown * (high - mean) + 0.01);
    return result;
}
#endif

fn project_face(number: u32, face: ptr<function, Face>) -> Projected {
    let limit = coverage[COVERAGE * number + 1u];
    var result = project_shape(positions_of(corners_of(number)), limit, face);
    result.kept = result.kept && result.tiles.z > result.tiles.x && result.tiles.w > result.tiles.y;
    if (limit < 0.0) {
        result.samples.z = -1; // the official code keeps such faces, but they are visible nowhere
    }
#if PLANAR
    (*face).dual2.w = coverage[COVERAGE * number];
#else
    (*face).y.w = coverage[COVERAGE * number];
#endif
    return result;
}
#endif
#else
#include "exact.wgsl"
#include "fragment.wgsl"

// Alpha is o exp(-e^(2 gamma) / 2), where view.power is 2 gamma.
fn falloff(opacity: f32, e: f32) -> f32 {
    var grown = e * e;
    if (view.power != 2.0) {
        grown = exp2(clamp(view.power * log2(max(e, 1e-30)), -100.0, 100.0));
    }
    // exp(-g / 2) is computed as exp2(-0.7213... g)
    return min(MAX_ALPHA, opacity * exp2(max(-0.72134752 * grown, -100.0)));
}

#if ENGINE
#include "engine.wgsl"

fn cover(face: Face, x: f32, y: f32) -> Seen {
    let f = fragment_of(face.along_x, face.along_y, face.constant, x, y);
    let alpha = falloff(face.color.w, face.falloff.x * (1.0 - f.phi));
    return Seen(face.color.xyz, select(0.0, alpha, f.inside), f.depth);
}
#else
#if PLANAR
fn cover(face: Face, x: f32, y: f32) -> Seen {
    let w = f32(view.width);
    let h = f32(view.height);
    let ray = vec2<f32>(view.tan_fov.x * ((2.0 * (x - view.shift.x) - w + 1.0) / w),
                        view.tan_fov.y * ((2.0 * (y - view.shift.y) - h + 1.0) / h));
    // If the plane is nearly edge-on, the terms of this sum cancel, and z is only as precise as their rounding.
    let slope = keep(keep(ray.x * face.normal.x) + keep(ray.y * face.normal.y)) + face.normal.z;
    let z = face.corner.w / slope;
    let d = vec3<f32>(z * ray, z) - face.corner.xyz;
    let a2 = dot(d, face.dual2.xyz);
    let a3 = dot(d, face.dual3.xyz);
    let a1 = 1.0 - a2 - a3;
    let e = 1.0 - 3.0 * min(min(a1, a2), a3);
    let inside = e >= 0.0 && e <= face.dual3.w && abs(slope) >= EPS;
    return Seen(face.color.xyz, select(0.0, falloff(face.dual2.w, e), inside), z);
}
#else
fn cover(face: Face, x: f32, y: f32) -> Seen {
    let dx = face.x.xyz - x;
    let dy = face.y.xyz - y;
    let a1 = (keep(dx.y * dy.z) - keep(dy.y * dx.z)) * face.x.w;
    let a2 = (keep(dx.z * dy.x) - keep(dy.z * dx.x)) * face.x.w;
    let a3 = 1.0 - a1 - a2;
    let e = 1.0 - 3.0 * min(min(a1, a2), a3);
    let inside = e >= 0.0 && e <= face.z.w;
    let z = a1 * face.z.x + a2 * face.z.y + a3 * face.z.z;
    return Seen(face.color.xyz, select(0.0, falloff(face.y.w, e), inside), z);
}
#endif
#endif
#endif
