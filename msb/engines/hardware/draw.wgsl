// One quad for each drawn face: from front to back, blended by fixed hardware, or in the order of the asset, the
// nearest kept by the z-buffer (Z_BUFFER). A method's file stands before this one: it defines `Face`, and
// `cover`, or `place_of`, `number_of` and `outline`, which may draw less than the quad.
//
// The quad's corners are edges of samples, half a sample from any centre, so no rounding of the hardware's
// changes which samples it has. `Face` comes as instance-stepped vertex attributes and goes on unchanged
// (flat): no storage buffer is read here, so no limit of one holds.
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
// Of equal depths the face that is drawn first stays, which has the lower number.
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

// The colour is premultiplied. The target's alpha holds 1 - T, not T: what is left is computed from one minus
// it, and in half floats the steps near 0 are finer than those near 1, where most of a sample's faces are.
struct Targets {
    @location(0) image: vec4<f32>,
#if DEPTH
    @location(1) depth: vec4<f32>, // then the sum of weights, where samples stop
#endif
}
#if STOPS

// The rule that stops a sample: a face that would take T below STOP is refused, and the sample sees no more.
// Hardware cannot read T before it blends, so faces are drawn in chunks, and a fragment knows T at the start
// of its chunk, which is at least the T that it meets: what it refuses is refused officially, too. What is
// blended in its place is the background with alpha 1, which fills the sample: from then on all that hardware
// blends there is multiplied by 0.
@group(0) @binding(2) var covered: texture_2d<f32>; // 1 - T
#endif

@fragment
fn blend(between: Between) -> Targets {
    // Sample (i, j) has its centre at (i, j); hardware has it at (i + 0.5, j + 0.5) of this band.
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
