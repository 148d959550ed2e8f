// Averages samples to pixels.
// The five values of a pixel are red, green and blue over the background, alpha, depth.
#include "view.wgsl"
#include "band.wgsl"
@group(0) @binding(1) var<uniform> band: Band;
@group(0) @binding(2) var image: texture_2d<f32>;
#if DEPTH
@group(0) @binding(3) var depth: texture_2d<f32>;
#endif
@group(0) @binding(4) var<storage, read_write> pixels: array<f32>;

// A pixel is the average of its samples FIRST_SAMPLE..LAST_SAMPLE along each axis.
// A box filter uses all samples.
// Bilinear interpolation at pixel centres uses only the middle one or two samples.
@compute @workgroup_size(64)
fn resolve(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= band.size.x || id.y >= band.size.y) {
        return;
    }
    var color = vec4<f32>(0.0);
#if DEPTH
    var far = vec2<f32>(0.0); // sum of depth * weight, sum of weights
#endif
    for (var v = FIRST_SAMPLE; v <= LAST_SAMPLE; v++) {
        for (var u = FIRST_SAMPLE; u <= LAST_SAMPLE; u++) {
            let at = vec2<i32>(id.xy * SCALE + vec2<u32>(u, v));
            color += textureLoad(image, at, 0);
#if DEPTH
            far += textureLoad(depth, at, 0).xy;
#endif
        }
    }
    let samples = f32((LAST_SAMPLE - FIRST_SAMPLE + 1u) * (LAST_SAMPLE - FIRST_SAMPLE + 1u));
    color /= samples;
    let out = 5u * (id.y * band.size.x + id.x);
    let rgb = color.rgb + (1.0 - color.a) * view.background;
    pixels[out] = rgb.x;
    pixels[out + 1u] = rgb.y;
    pixels[out + 2u] = rgb.z;
#if DEPTH
    pixels[out + 3u] = far.y / samples;
    pixels[out + 4u] = select(0.0, far.x / far.y, far.y > 0.0);
#else
    pixels[out + 3u] = color.a;
    pixels[out + 4u] = 0.0;
#endif
}
