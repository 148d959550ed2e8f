// Draws a quad for each face.
// With blending, quads are drawn from front to back.
// With a z-buffer (Z_BUFFER), quads are drawn in the order of the asset.
// The file of the method precedes this file and defines `Face`.
// For blending, the file of the method also defines `cover`.
// For a z-buffer, the file of the method defines `place_of`, `number_of` and `outline`.
// The function `outline` moves the corners of the quad, for example to draw a triangle.
//
// The quad's corners lie on the borders between samples, half a sample from the nearest sample centre.
// Rounding in the hardware therefore does not change the set of samples.
// The members of `Face` are vertex attributes with one value per instance.
// The attributes reach the fragment stage unchanged (flat).
// This file reads no storage buffers, whose number is limited.
#include "band.wgsl"
@group(0) @binding(1) var<uniform> band: Band;

struct Between {
    @builtin(position) place: vec4<f32>,
BETWEEN_MEMBERS
}

@vertex
fn corner(@builtin(vertex_index) index: u32, face: Face) -> Between {
    let right = (index & 1u) == 1u;
    let low = (index & 2u) == 2u;
    var sample = vec2<f32>(select(face.quad.x, face.quad.z + 1.0, right),
                           select(face.quad.y, face.quad.w + 1.0, low));
#if Z_BUFFER
    sample = outline(face, index, sample);
#endif
    let inside = (sample - vec2<f32>(band.first * SCALE)) / vec2<f32>(band.size * SCALE);
    var between: Between;
    between.place = vec4<f32>(2.0 * inside.x - 1.0, 1.0 - 2.0 * inside.y, 0.5, 1.0);
BETWEEN_COPIES
    return between;
}

#if Z_BUFFER
// At equal depths, the z-buffer keeps the face with the lower index, because this face is drawn first.
struct Nearest {
    @builtin(frag_depth) depth: f32,
    @location(0) face: u32, // number + 1
}

struct Place {
    inside: bool,
    depth: f32, // at least 0, below 1
}

@fragment
fn nearest(between: Between) -> Nearest {
    let pixel = vec2<i32>(between.place.xy) + vec2<i32>(band.first);
    let face = Face(FACE_VALUES);
    let place = place_of(face, pixel.x, pixel.y);
    if (!place.inside) {
        discard;
    }
    return Nearest(place.depth, number_of(face) + 1u);
}
#else

// The colour is premultiplied.
// The target's alpha is 1 - T, where T is the transmittance.
// For the first faces of a sample 1 - T is near 0, where half floats are most precise.
struct Targets {
    @location(0) image: vec4<f32>,
#if DEPTH
    @location(1) depth: vec4<f32>, // depth * weight, weight, unused, coverage for stopping
#endif
}
#if STOPS

// Stopping of samples: if a face would reduce the transmittance T below STOP, the official renderer skips the face.
// The sample is then complete.
// Hardware cannot read T while it blends, so faces are drawn in chunks.
// A fragment only knows T at the start of its chunk.
// The T of the fragment is at least the current T. The official renderer therefore skips every face that the
// shader skips, and possibly further faces. Instead of a skipped face, the background is blended with alpha
// 1. The background fills the sample, so the hardware multiplies all later faces of the sample by 0.
@group(0) @binding(2) var covered: texture_2d<f32>; // 1 - T
#endif

@fragment
fn blend(between: Between) -> Targets {
    // The centre of sample (i, j) is (i, j) in our coordinates, and (i + 0.5, j + 0.5) in hardware
    // coordinates.
    let sample = floor(between.place.xy) + vec2<f32>(band.first * SCALE);
    let seen = cover(Face(FACE_VALUES), sample.x, sample.y);
    if (!(seen.alpha >= MIN_ALPHA)) {
        discard;
    }
    var targets: Targets;
#if STOPS
    let left = 1.0 - textureLoad(covered, vec2<i32>(between.place.xy), 0).x;
    if (left < STOP) {
        discard;
    }
    if (left * (1.0 - seen.alpha) < STOP) {
        targets.image = vec4<f32>(view.background, 1.0);
#if DEPTH
        targets.depth = vec4<f32>(0.0, 0.0, 0.0, 1.0);
#endif
        return targets;
    }
#endif
    targets.image = vec4<f32>(seen.color * seen.alpha, seen.alpha);
#if DEPTH
    targets.depth = vec4<f32>(seen.depth * seen.alpha, seen.alpha, 0.0, seen.alpha);
#endif
    return targets;
}
#endif
