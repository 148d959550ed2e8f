// Triangle-Splatting: a triangle soup with a window that falls off from the incentre to the edges.
// This file translates triangle_splatting.cl for graphics hardware; the comments there explain more.
// Sources: trianglesplatting/diff-triangle-rasterization at 6d61f4c: cuda_rasterizer/forward.cu.

const STOP = 1e-4; // a face that would lower the transmittance T below this value is not blended
const MAX_ALPHA = 0.99;
const COVERAGE = 4u; // opacity, sigma, the phi with o phi^sigma = 0.01, and the rim

#if ENGINE
struct Face {
    quad: vec4<f32>,
    along_x: vec4<f32>,
    along_y: vec4<f32>,
    constant: vec4<f32>,
    color: vec4<f32>, // then opacity
    window: vec4<f32>, // sigma
}
#else
struct Face {
    quad: vec4<f32>,
    normal_x: vec4<f32>, // distances of the three edges; then 1 / inradius
    normal_y: vec4<f32>, // then sigma
    offset: vec4<f32>,   // then opacity
    color: vec4<f32>,    // then depth
}
#endif

#if COMPUTE
#include "source.wgsl"
#include "window.wgsl"
#if ENGINE
#include "engine.wgsl"
#endif

fn point_seen(rows: vec3<u32>) -> vec3<f32> {
    let center = center_of(position(rows.x), position(rows.y), position(rows.z));
    // The official kernel was meant to use the centroid.
    // Because of an error in an expression, the kernel uses the centroid's z for x, y and z.
    // Models are trained with this error, so their coefficients need the same direction.
    return select(center, center.zzz, view.broadcast_z == 1u);
}

fn project_face(number: u32, face: ptr<function, Face>) -> Projected {
    var result: Projected;
    let opacity = coverage[COVERAGE * number];
    if (opacity < MIN_OPACITY) {
        return result;
    }
    let corners = positions_of(corners_of(number));
#if ENGINE
    let t = project_engine(corners, true);
    (*face).along_x = t.along_x;
    (*face).along_y = t.along_y;
    (*face).constant = t.constant;
    (*face).color.w = opacity;
    (*face).window.x = coverage[COVERAGE * number + 1u];
    return Projected(t.seen, t.depth, engine_tiles(t.samples), t.samples);
#else
    var w: Window;
    result.kept = project_window(corners, &w);
    if (!result.kept) {
        return result;
    }
    result.depth = w.depth;
    result.tiles = contour_tiles(&w, coverage[COVERAGE * number + 2u]);
    // Like the official test, this test keeps a face whose corners were all skipped.
    result.kept = result.tiles.x != result.tiles.z && result.tiles.y != result.tiles.w;
    result.samples = window_box(&w, coverage[COVERAGE * number + 3u]);
    let n = w.edge_normal;
    (*face).normal_x = vec4<f32>(n[0].x, n[1].x, n[2].x, div(1.0, w.inradius[2]));
    (*face).normal_y = vec4<f32>(n[0].y, n[1].y, n[2].y, coverage[COVERAGE * number + 1u]);
    (*face).offset = vec4<f32>(w.edge_offset[0], w.edge_offset[1], w.edge_offset[2], opacity);
    (*face).color.w = w.depth;
    return result;
#endif
}

#if RECORDING
fn color_face(number: u32, face: ptr<function, Face>) {
    (*face).color = vec4<f32>(color_at(number), (*face).color.w);
}
#endif
#else
#include "exact.wgsl"
#include "window.wgsl"
#include "fragment.wgsl"
#if ENGINE
#include "engine.wgsl"

fn cover(face: Face, x: f32, y: f32) -> Seen {
    let f = fragment_of(face.along_x, face.along_y, face.constant, x, y);
    let alpha = min(MAX_ALPHA, face.color.w * window_power(f.phi, face.window.x));
    return Seen(face.color.xyz, select(0.0, alpha, f.inside), f.depth);
}
#else

fn cover(face: Face, x: f32, y: f32) -> Seen {
    let nearest = nearest_edge(face.normal_x.xyz, face.normal_y.xyz, face.offset.xyz, x, y);
    let alpha = min(MAX_ALPHA, face.offset.w * window_power(nearest * face.normal_x.w, face.normal_y.w));
    return Seen(face.color.xyz, select(0.0, alpha, nearest <= 0.0), face.color.w);
}
#endif
#endif
