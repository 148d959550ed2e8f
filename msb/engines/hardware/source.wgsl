// The buffers of the model, and the result of a face's projection.
// Every compute stage over faces starts with the file of the method, which starts with this file.
#include "exact.wgsl"

// Long buffers are bound in parts; `part` holds the row range of the bound part.
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

// Returns the vertices of a face; in a triangle soup they are three consecutive rows.
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

// The result of a method's function `project_face`, besides the record for the fragment stage (`Face`).
struct Projected {
    kept: bool,         // true if the official culling keeps the face
    depth: f32,         // depth, whose bit pattern is the official sort key
    tiles: vec4<i32>,   // the official tile rectangle; upper ends are exclusive
    samples: vec4<i32>, // box that contains all samples with an alpha of 1/255 or more; inclusive
}
