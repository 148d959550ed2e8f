// The compute stages before and after the sort.
// The file of the method (NAME.wgsl, beside its NAME.cl) is inserted before this file, and also before draw.wgsl.
// The file of the method includes files of this folder and defines
//
//   Face                                the record of a face for the fragment stage: vec4<f32> members, the first one
//                                       is `quad`
// and with COMPUTE
//   project_face(number, ptr to Face)   culling, projection, official tiles and extent; returns `Projected`
//   point_seen(rows of the corners)     triangle soups only: the point towards which the colour is evaluated
//   color_face(number, ptr to Face)     with RECORDING: stores the colours in the record
// and without COMPUTE
//   cover(Face, x, y)                   the colour, alpha and depth of a face at sample (x, y); returns `Seen`
//
// ENGINE is defined for the sampling "engine".
// The `defines` of the method's model are defined as well, and its `method_values` are members of `view`.
//
// Every face is projected twice: before the sort for its key, and after the sort for its record.
// Records are therefore written once, in drawing order, and only for faces that are drawn.
// Sorting the records would be slower than the second projection and would need twice the memory.

const DROPPED = 0xffffffffu; // key of a face that the official culling removes
const UNSEEN = 0xfffffffeu;  // key of a face that the culling keeps, but that lies in no tile

// Returns the samples of a face's quad.
// The official renderer draws a face only in its tiles.
fn quad_of(projected: Projected) -> vec4<i32> {
#if IN_TILES
    let tiles = projected.tiles * TILE - vec4<i32>(0, 0, 1, 1);
    return vec4<i32>(max(projected.samples.xy, tiles.xy), min(projected.samples.zw, tiles.zw));
#else
    return projected.samples;
#endif
}

#if COLORING
// ---- colours of faces or vertices
@group(0) @binding(5) var<storage, read> f_dc: array<f32>;
@group(0) @binding(6) var<storage, read> f_rest: array<f32>;
@group(0) @binding(8) var<storage, read_write> colors: array<f32>;
#include "color.wgsl"

fn color_row(row: u32, towards: vec3<f32>) {
    let first = vec3<f32>(f_dc[3u * row], f_dc[3u * row + 1u], f_dc[3u * row + 2u]);
    let color = color_of(first, row - part.first, towards);
    colors[3u * row] = color.x;
    colors[3u * row + 1u] = color.y;
    colors[3u * row + 2u] = color.z;
}
#endif

#if SHADING
@compute @workgroup_size(64)
fn shade_vertices(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x < part.count) {
        color_row(part.first + id.x, position(part.first + id.x));
    }
}
#endif

#if KEYING
// ---- the depth key of each face
@group(0) @binding(7) var<storage, read_write> keys: array<u32>;
#if DEBUG
@group(0) @binding(9) var<storage, read_write> rectangles: array<vec4<i32>>;
#endif

@compute @workgroup_size(64)
fn project(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= part.count) {
        return;
    }
    let number = part.first + id.x;
    var face: Face;
    let projected = project_face(number, &face);
    let quad = quad_of(projected);
    let seen = projected.kept && quad.z >= quad.x && quad.w >= quad.y;
    keys[number] = select(select(DROPPED, UNSEEN, projected.kept), bitcast<u32>(projected.depth), seen);
#if DEBUG
    rectangles[number] = select(vec4<i32>(0), projected.tiles, projected.kept);
#endif
#if !VERTEX_COLORS
    if (seen) {
        color_row(number, point_seen(corners_of(number)));
    }
#endif
}
#endif

#if RECORDING
// ---- records of the faces in drawing order
#if Z_BUFFER
@group(0) @binding(7) var<storage, read_write> keys: array<u32>;
#else
@group(0) @binding(8) var<storage, read> colors: array<f32>;
#endif
@group(0) @binding(10) var<storage, read> order: array<u32>;
@group(0) @binding(11) var<storage, read> arguments: array<u32>; // see `write_arguments` in sort.wgsl
@group(0) @binding(12) var<storage, read_write> records: array<Face>;

#if !Z_BUFFER
fn color_at(row: u32) -> vec3<f32> {
    return vec3<f32>(colors[3u * row], colors[3u * row + 1u], colors[3u * row + 2u]);
}
#endif

@compute @workgroup_size(64)
fn record(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= arguments[part.first + 5u]) {
        return;
    }
    let place = arguments[part.first + 3u] + id.x;
    let number = order[place];
    var face: Face;
    let projected = project_face(number, &face);
#if Z_BUFFER
    keys[number] = DROPPED; // this key is replaced if a pixel shows the face
#else
    color_face(number, &face);
#endif
    face.quad = vec4<f32>(quad_of(projected));
    records[id.x] = face;
}
#endif
