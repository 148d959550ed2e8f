// The model on the device, and what the stages of projection pass on. Every text of a compute stage that
// touches faces begins with a method's file, and that with this one.
#include "exact.wgsl"

// Buffers longer than a binding may be are bound part by part; `part` says which rows those are.
struct Part {
    first: u32,
    count: u32,
}
@group(0) @binding(1) var<uniform> part: Part;
@group(0) @binding(2) var<storage, read> positions: array<f32>;
#if VERTEX_COLORS
@group(0) @binding(3) var<storage, read> indices: array<u32>;
#endif
@group(0) @binding(4) var<storage, read> coverage: array<f32>;

fn position(row: u32) -> vec3<f32> {
    return vec3<f32>(positions[3u * row], positions[3u * row + 1u], positions[3u * row + 2u]);
}

// The rows of a face's corners: a soup has three of its own.
fn corners_of(number: u32) -> vec3<u32> {
#if VERTEX_COLORS
    return vec3<u32>(indices[3u * number], indices[3u * number + 1u], indices[3u * number + 2u]);
#else
    return 3u * number + vec3<u32>(0u, 1u, 2u);
#endif
}

fn positions_of(rows: vec3<u32>) -> array<vec3<f32>, 3> {
    return array<vec3<f32>, 3>(position(rows.x), position(rows.y), position(rows.z));
}

// What a method's `project_face` says of a face, besides its record for the fragments (`Face`).
struct Projected {
    kept: bool,         // by the official culling
    depth: f32,         // its bits are the official sort key
    tiles: vec4<i32>,   // the official tile rectangle; high ends excluded
    samples: vec4<i32>, // a box of all samples where alpha can be 1/255 or more; both ends included
}
