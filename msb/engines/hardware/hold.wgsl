// Runs before each chunk of faces.
// The pass copies the coverage 1 - T of the samples of a band from the alpha of `image` to `covered`.
// T is the transmittance.
// The copy is needed because fragments of the next chunk cannot read their own target.
#include "band.wgsl"
@group(0) @binding(1) var<uniform> band: Band;
@group(0) @binding(2) var image: texture_2d<f32>;
@group(0) @binding(3) var covered: texture_storage_2d<r32float, write>;

fn hold_pixel(id: vec3<u32>, first: bool) {
    if (id.x >= band.size.x || id.y >= band.size.y) {
        return;
    }
    for (var v = 0u; v < SCALE; v++) {
        for (var u = 0u; u < SCALE; u++) {
            let at = vec2<i32>(id.xy * SCALE + vec2<u32>(u, v));
            var here = vec4<f32>(0.0);
            if (!first) {
                here = vec4<f32>(textureLoad(image, at, 0).a);
            }
            textureStore(covered, at, here);
        }
    }
}

@compute @workgroup_size(64)
fn begin(@builtin(global_invocation_id) id: vec3<u32>) { hold_pixel(id, true); }

@compute @workgroup_size(64)
fn hold(@builtin(global_invocation_id) id: vec3<u32>) { hold_pixel(id, false); }
