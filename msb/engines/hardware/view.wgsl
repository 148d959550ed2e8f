// The camera record: all that changes from frame to frame. The host computes nothing else
// (msb/engines/hardware/packing.py, `view_bytes`).
struct View {
    world_to_camera: array<vec4<f32>, 3>, // rows of W, for column vectors
    full: array<vec4<f32>, 4>,            // rows of P W
    center: vec3<f32>,                    // of the camera, world
    zero: u32,                            // 0, which no compiler knows: see exact.wgsl
    tan_fov: vec2<f32>,
    shift: vec2<f32>,                     // of the principal point from the middle of the raster, samples
    width: u32,                           // of the raster, samples
    height: u32,
    columns: u32,                         // of tiles
    rows: u32,
    background: vec3<f32>,
    degree: u32,                          // of the spherical harmonics to evaluate
OWN_MEMBERS
}
@group(0) @binding(0) var<uniform> view: View;

const TILE = 16;
