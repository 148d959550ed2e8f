// Computes the pixels of opaque faces.
// The z-buffer pass has found the face of each pixel.
// The function `surface_at(number, x, y) -> Seen` computes the appearance of the face.
// The method's file, inserted before this file, defines the function.
#include "band.wgsl"
@group(0) @binding(5) var<uniform> band: Band;
@group(0) @binding(6) var faces: texture_2d<u32>; // face number + 1; 0 without a face
@group(0) @binding(9) var<storage, read_write> pixels: array<f32>;
@group(0) @binding(10) var<storage, read_write> keys: array<atomic<u32>>;

// Computes one pixel.
// `part` is the range of faces whose lattices are bound.
// The first part also writes pixels without a face.
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
        atomicStore(&keys[face - 1u], 0u); // the face is visible
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
