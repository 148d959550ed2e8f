// How a game engine samples triangles: by the rasterisation of graphics hardware (msb/reference/engine.py, whose
// order of operations this is). Included by a method's file where ENGINE is set.
//
// The quad stays a quad: a sample is a fragment of the triangle where all three barycentric coordinates over
// depth are positive. They are affine on the screen, as is 1 / depth, and behind the camera all three are
// negative where the triangle is. So nothing has to be clipped, and no hardware's way of clipping, snapping
// corners or breaking ties at edges enters.

const ENGINE_NEAR = 0.01;
const ENGINE_SLACK = 0.1; // samples by which a box is wider than the corners, so that rounding cuts nothing

#if COMPUTE
struct EngineTriangle {
    seen: bool,
    back: bool, // corners run clockwise on the screen
    depth: f32,
    samples: vec4<i32>,
    weight: vec3<f32>,
    // Three barycentric coordinates over depth, times `weight`, which makes the least of them 1 in the middle,
    // then 1 / depth: of each the factors of a sample's x and y, and a constant.
    along_x: vec4<f32>,
    along_y: vec4<f32>,
    constant: vec4<f32>,
}

// The ray's step from sample to sample, and the sample that the optical axis meets.
fn ray_step() -> vec2<f32> {
    let size = vec2<f32>(f32(view.width), f32(view.height));
    return vec2<f32>(div(2.0 * view.tan_fov.x, size.x), div(2.0 * view.tan_fov.y, size.y));
}
fn ray_middle() -> vec2<f32> {
    let size = vec2<f32>(f32(view.width), f32(view.height));
    return add2((size - 1.0) * 0.5, view.shift);
}

fn set_line(k: i32, n: vec3<f32>, scale: f32, t: ptr<function, EngineTriangle>) {
    let middle = ray_middle();
    let along = keep2(n.xy * ray_step());
    (*t).along_x[k] = mul(along.x, scale);
    (*t).along_y[k] = mul(along.y, scale);
    (*t).constant[k] = mul(keep(keep(n.z - mul(along.x, middle.x)) - mul(along.y, middle.y)), scale);
}

// The samples of what the near plane leaves of a triangle in camera space.
fn engine_box(p: array<vec3<f32>, 3>) -> vec4<i32> {
    let step = ray_step();
    let middle = ray_middle();
    var low = vec2<f32>(1e30);
    var high = vec2<f32>(-1e30);
    for (var k = 0; k < 3; k++) {
        let start = p[k];
        let end = p[(k + 1) % 3];
        let inside = start.z >= ENGINE_NEAR;
        if (inside) {
            let at = start.xy / start.z / step + middle;
            low = min(low, at);
            high = max(high, at);
        }
        if (inside != (end.z >= ENGINE_NEAR)) {
            let share = (ENGINE_NEAR - start.z) / (end.z - start.z);
            let at = (start.xy + share * (end.xy - start.xy)) / ENGINE_NEAR / step + middle;
            low = min(low, at);
            high = max(high, at);
        }
    }
    return box_of(low - ENGINE_SLACK, high + ENGINE_SLACK);
}

// The window is 1 at the incentre of the triangle itself, or at its centroid.
fn project_engine(corners: array<vec3<f32>, 3>, incentre: bool) -> EngineTriangle {
    var t: EngineTriangle;
    let p = array<vec3<f32>, 3>(to_camera(corners[0]), to_camera(corners[1]), to_camera(corners[2]));
    let normal = cross3(sub3(p[1], p[0]), sub3(p[2], p[0]));
    let volume = dot3(p[0], normal);
    t.back = volume > 0.0;
    let opposite = array<vec3<f32>, 3>(sub3(p[2], p[1]), sub3(p[0], p[2]), sub3(p[1], p[0]));
    let size = vec3<f32>(length3(opposite[0]), length3(opposite[1]), length3(opposite[2]));
    let perimeter = add(add(size.x, size.y), size.z);
    for (var k = 0; k < 3; k++) {
        t.weight[k] = select(3.0, div(perimeter, size[k]), incentre);
        set_line(k, cross3(p[(k + 1) % 3], opposite[k]), div(t.weight[k], volume), &t);
    }
    set_line(3, normal, div(1.0, volume), &t);
    let z = affine(view.world_to_camera[2], center_of(corners[0], corners[1], corners[2]));
    t.depth = select(0.0, z, z > 0.0); // keys are bits of numbers that are not negative
    t.samples = engine_box(p);
    // The smallest normal number: below it, 1 / volume overflows.
    t.seen = abs(volume) >= 1.17549435e-38 && t.samples.z >= t.samples.x && t.samples.w >= t.samples.y;
    return t;
}

// The tiles of a face in an engine: all that it reaches.
fn engine_tiles(samples: vec4<i32>) -> vec4<i32> {
    return vec4<i32>(samples.xy / 16, samples.zw / 16 + 1);
}
#else

struct Fragment {
    inside: bool,
    phi: f32,        // 0 on the edges, 1 in the middle
    depth: f32,
    over: vec3<f32>, // barycentric coordinates over depth, weighted
}

fn fragment_of(along_x: vec4<f32>, along_y: vec4<f32>, constant: vec4<f32>, x: f32, y: f32) -> Fragment {
    var f: Fragment;
    let e = keep4(keep4(along_x * x) + constant) + keep4(along_y * y);
    let nearest = min(min(e.x, e.y), e.z);
    f.over = e.xyz;
    f.depth = 1.0 / e.w;
    f.phi = nearest * f.depth;
    f.inside = nearest >= 0.0 && f.depth >= ENGINE_NEAR && f.depth < 1e30;
    return f;
}
#endif
