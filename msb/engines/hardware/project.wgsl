// Stages before and after the sort. A method's file NAME.wgsl, beside its NAME.cl, stands before this one and
// before draw.wgsl. It includes what it needs of the files here, and defines
//
//   Face                                what the fragments of a face read: members of vec4<f32>, the first of
//                                       which is `quad`
// and, where COMPUTE is set,
//   project_face(number, ptr to Face)   culling, projection, official tiles and reach: `Projected`
//   point_seen(rows of the corners)     of soups: towards which point the colour is evaluated
//   color_face(number, ptr to Face)     where RECORDING is set: puts colours into the record
// and otherwise
//   cover(Face, x, y)                   a face at the sample (x, y): `Seen`
//
// ENGINE is set where an engine's sampling is asked for. What the method's `look` says in `defines` is set, too,
// and what it says in `own` are members of `view`.
//
// A face is projected twice: before the sort for its key alone, and after it for the record that its
// fragments read. So records are written once, in the order in which they are drawn, and only of faces that
// are drawn: moving them about would cost more than this arithmetic, and twice the memory.

const DROPPED = 0xffffffffu; // by the official culling
const UNSEEN = 0xfffffffeu;  // kept, but no tile lists it

// The samples of a face's quad: officially a face is seen only in its tiles.
fn quad_of(found: Projected) -> vec4<i32> {
#if IN_TILES
    let tiles = found.tiles * TILE - vec4<i32>(0, 0, 1, 1);
    return vec4<i32>(max(found.samples.xy, tiles.xy), min(found.samples.zw, tiles.zw));
#else
    return found.samples;
#endif
}

#if COLORING
// ---- colours, and the keys of soups
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
    let found = project_face(number, &face);
    let quad = quad_of(found);
    let seen = found.kept && quad.z >= quad.x && quad.w >= quad.y;
    keys[number] = select(select(DROPPED, UNSEEN, found.kept), bitcast<u32>(found.depth), seen);
#if DEBUG
    rectangles[number] = select(vec4<i32>(0), found.tiles, found.kept);
#endif
#if !VERTEX_COLORS
    if (seen) {
        color_row(number, point_seen(corners_of(number)));
    }
#endif
}
#endif

#if RECORDING
// ---- records, in the order of drawing
#if Z_BUFFER
@group(0) @binding(7) var<storage, read_write> keys: array<u32>;
#else
@group(0) @binding(8) var<storage, read> colors: array<f32>;
#endif
@group(0) @binding(10) var<storage, read> order: array<u32>;
@group(0) @binding(11) var<storage, read> arguments: array<u32>; // sort.wgsl: `tell`; `part` says where
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
    let found = project_face(number, &face);
#if Z_BUFFER
    keys[number] = DROPPED; // until a pixel sees it
#else
    color_face(number, &face);
#endif
    face.quad = vec4<f32>(quad_of(found));
    records[id.x] = face;
}
#endif
