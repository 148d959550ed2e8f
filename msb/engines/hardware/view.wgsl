// The uniform buffer of the camera.
// The host computes only this buffer for each frame (`view_bytes` in msb/engines/hardware/packing.py).
struct View {
    world_to_camera: array<vec4<f32>, 3>, // rows of W, for column vectors
    full: array<vec4<f32>, 4>,            // rows of P W
    center: vec3<f32>,                    // camera centre in world space
    zero: u32,                            // 0, but the compiler does not know this: see exact.wgsl
    tan_fov: vec2<f32>,
    shift: vec2<f32>,                     // principal point minus centre of the raster, in samples
    width: u32,                           // size of the raster in samples
    height: u32,
    columns: u32,                         // number of tiles
    rows: u32,
    background: vec3<f32>,
    degree: u32,                          // degree of the evaluated spherical harmonics
OWN_MEMBERS
}
@group(0) @binding(0) var<uniform> view: View;

const TILE = 16;
