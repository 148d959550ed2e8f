// MeshSplatting: an indexed mesh with vertex colours and opacities.
// This file translates mesh_splatting.cl for graphics hardware; the comments there explain more.

const STOP = 1e-4; // a face that would lower the transmittance T below this value is not blended
#if PLUS
const MAX_ALPHA = 0.99;
const COVERAGE = 3u; // per vertex: opacity, rim, and the phi with o phi^sigma = 0.01
#else
const MAX_ALPHA = 0.999;
const COVERAGE = 2u; // per vertex: opacity, rim
#endif
const MARGIN = 5.0;

// color0 is the colour of corner 0; color1 and color2 are the colour differences of corners 1 and 2.
#if ENGINE
struct Face {
    quad: vec4<f32>,
    along_x: vec4<f32>,
    along_y: vec4<f32>,
    constant: vec4<f32>,
    weights: vec4<f32>, // 1 / weight of barycentric coordinates 1 and 2; opacity
    color: vec4<f32>,
    color1: vec4<f32>,
    color2: vec4<f32>,
}
#else
struct Face {
    quad: vec4<f32>,
    normal_x: vec4<f32>, // distances of the three edges; then 1 / inradius
    normal_y: vec4<f32>, // then opacity
    offset: vec4<f32>,
    origin: vec4<f32>,   // corner 0 in samples, 1 / twice the area, depth of corner 0
    edges: vec4<f32>,    // vectors from corner 0 to corners 1 and 2
    color: vec4<f32>,
    color1: vec4<f32>,   // then the depth difference of corner 1
    color2: vec4<f32>,   // then the depth difference of corner 2
}
#endif

#if COMPUTE
#include "source.wgsl"
#include "window.wgsl"
#if ENGINE
#include "engine.wgsl"
#endif

#if RECORDING
fn color_face(number: u32, face: ptr<function, Face>) {
    let rows = corners_of(number);
    let first = color_at(rows.x);
    (*face).color = vec4<f32>(first, 0.0);
    (*face).color1 = vec4<f32>(color_at(rows.y) - first, (*face).color1.w);
    (*face).color2 = vec4<f32>(color_at(rows.z) - first, (*face).color2.w);
}
#endif

// The official code computes an unsigned product of the extents, which is 0 for an empty box. The product in
// this file is never negative.
fn corner_tiles(w: ptr<function, Window>) -> vec4<i32> {
    var result = vec4<i32>(i32(view.columns), i32(view.rows), 0, 0);
    for (var k = 0; k < 3; k++) {
        let q = (*w).corners[k];
        let low = vec2<i32>(tile_number((q.x - MARGIN) / 16.0, view.columns),
                            tile_number((q.y - MARGIN) / 16.0, view.rows));
        let high = vec2<i32>(tile_after((q.x + MARGIN) / 16.0, view.columns),
                             tile_after((q.y + MARGIN) / 16.0, view.rows));
        result = vec4<i32>(min(result.xy, low), max(result.zw, high));
    }
    return result;
}

fn project_face(number: u32, face: ptr<function, Face>) -> Projected {
    var result: Projected;
    let rows = corners_of(number);
    let at = COVERAGE * rows;
    let opacity = min(min(coverage[at.x], coverage[at.y]), coverage[at.z]);
    // The rim grows as opacity falls, so the vertex with the least opacity has the largest rim.
    let rim = max(max(coverage[at.x + 1u], coverage[at.y + 1u]), coverage[at.z + 1u]);
    if (opacity < MIN_OPACITY) {
        return result;
    }
    let corners = positions_of(rows);
#if ENGINE
    let t = project_engine(corners, true);
    (*face).along_x = t.along_x;
    (*face).along_y = t.along_y;
    (*face).constant = t.constant;
    (*face).weights = vec4<f32>(1.0 / t.weight.yz, opacity, 0.0);
    return Projected(t.seen, t.depth, engine_tiles(t.samples), t.samples);
#else
    var w: Window;
    result.kept = project_window(corners, &w);
    if (!result.kept) {
        return result;
    }
    result.depth = w.depth;
#if PLUS
    let shrunk = max(max(coverage[at.x + 2u], coverage[at.y + 2u]), coverage[at.z + 2u]);
    result.tiles = contour_tiles(&w, shrunk);
#else
    result.tiles = corner_tiles(&w);
#endif
    result.kept = result.tiles.x != result.tiles.z && result.tiles.y != result.tiles.w;
    result.samples = window_box(&w, rim);
    let n = w.edge_normal;
    (*face).normal_x = vec4<f32>(n[0].x, n[1].x, n[2].x, div(1.0, w.inradius[2]));
    (*face).normal_y = vec4<f32>(n[0].y, n[1].y, n[2].y, opacity);
    (*face).offset = vec4<f32>(w.edge_offset[0], w.edge_offset[1], w.edge_offset[2], 0.0);
    let e1 = sub2(w.corners[1], w.corners[0]);
    let e2 = sub2(w.corners[2], w.corners[0]);
    let z = affine(view.world_to_camera[2], corners[0]);
    (*face).origin = vec4<f32>(w.corners[0], div(1.0, cross2(e1, e2)), z);
    (*face).edges = vec4<f32>(e1, e2);
    (*face).color1.w = affine(view.world_to_camera[2], corners[1]) - z;
    (*face).color2.w = affine(view.world_to_camera[2], corners[2]) - z;
#if PLUS
    (*face).origin.w = w.depth;
    (*face).color1.w = 0.0;
    (*face).color2.w = 0.0;
#endif
    return result;
#endif
}
#else
#include "exact.wgsl"
#include "window.wgsl"
#include "fragment.wgsl"
#if ENGINE
#include "engine.wgsl"

fn cover(face: Face, x: f32, y: f32) -> Seen {
    let f = fragment_of(face.along_x, face.along_y, face.constant, x, y);
    let alpha = min(MAX_ALPHA, face.weights.z * window_power(f.phi, view.sigma));
    let b = f.over.yz * f.depth * face.weights.xy;
    let color = face.color.xyz + b.x * face.color1.xyz + b.y * face.color2.xyz;
    return Seen(color, select(0.0, alpha, f.inside), f.depth);
}
#else

// The official kernel interpolates colours linearly on the screen, without perspective correction.
fn cover(face: Face, x: f32, y: f32) -> Seen {
    let nearest = nearest_edge(face.normal_x.xyz, face.normal_y.xyz, face.offset.xyz, x, y);
    let alpha = min(MAX_ALPHA, face.normal_y.w * window_power(nearest * face.normal_x.w, view.sigma));
    let d = vec2<f32>(x, y) - face.origin.xy;
    let b1 = (keep(d.x * face.edges.w) - keep(face.edges.z * d.y)) * face.origin.z;
    let b2 = (keep(face.edges.x * d.y) - keep(d.x * face.edges.y)) * face.origin.z;
    let color = face.color.xyz + b1 * face.color1.xyz + b2 * face.color2.xyz;
    let z = face.origin.w + b1 * face.color1.w + b2 * face.color2.w;
    return Seen(color, select(0.0, alpha, nearest <= 0.0), z);
}
#endif
#endif
