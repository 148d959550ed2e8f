// The pixels of a frame of opaque faces: the z-buffer says which face a pixel sees, and a method's file, which
// stands before this one, says by `surface_at(number, x, y) -> Seen` how that face looks there.
#include "band.wgsl"
@group(0) @binding(5) var<uniform> band: Band;
@group(0) @binding(6) var faces: texture_2d<u32>; // number + 1, 0 where nothing is
@group(0) @binding(9) var<storage, read_write> pixels: array<f32>;
@group(0) @binding(10) var<storage, read_write> keys: array<atomic<u32>>;

// One pixel; `part` says which faces' appearance is bound. Where nothing is, the first part writes.
@compute @workgroup_size(64)
fn surface(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= band.size.x || id.y >= band.size.y) {
        return;
    }
    let face = textureLoad(faces, vec2<i32>(id.xy), 0).x;
    let mine = face > part.first && face - part.first <= part.count;
    var seen = Seen(view.background, 0.0, 0.0);
    if (mine) {
        seen = surface_at(face - 1u, i32(band.first.x + id.x), i32(band.first.y + id.y));
        atomicStore(&keys[face - 1u], 0u); // seen
    } else if (face != 0u || part.first != 0u) {
        return;
    }
    let out = 5u * (id.y * band.size.x + id.x);
    pixels[out] = seen.color.x;
    pixels[out + 1u] = seen.color.y;
    pixels[out + 2u] = seen.color.z;
    pixels[out + 3u] = seen.alpha;
    pixels[out + 4u] = seen.depth;
}
