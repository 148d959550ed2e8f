// The sampling of triangles in game engines, by the rasterisation rules of graphics hardware.
// The order of operations is that of msb/reference/engine.py.
// The file of a method includes this file if ENGINE is defined.
//
// Each triangle is drawn as a quad. A sample belongs to the triangle if all three values (barycentric
// coordinate / depth) are positive. These values and 1 / depth are affine on the screen, and all three are
// negative for points behind the camera. The triangle therefore needs no clipping. The result does not depend
// on how hardware clips, snaps corners or breaks ties at edges.

const ENGINE_NEAR = 0.01;
const ENGINE_SLACK = 0.1; // margin of the box around the corners in samples, larger than rounding errors

#if COMPUTE
struct EngineTriangle {
    seen: bool,
    back: bool, // corners run clockwise on the screen
    depth: f32,
    samples: vec4<i32>,
    weight: vec3<f32>,
    // Coefficients of four affine functions of a sample's x and y.
    // Three functions are the barycentric coordinates, divided by depth and multiplied by `weight`. At the
    // centre, the smallest of the three values is 1 / depth. The fourth function is 1 / depth.
    along_x: vec4<f32>,
    along_y: vec4<f32>,
    constant: vec4<f32>,
}

// The change of a ray's direction between neighbouring samples, and the sample on the optical axis.
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

// Returns the box of the samples that a triangle covers after clipping at the near plane. The corners are in
// camera space.
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

// Projects a triangle.
// The window function is 1 at the incentre if `incentre` is true, else at the centroid.
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
    t.depth = select(0.0, z, z > 0.0); // sort keys are the bits of non-negative numbers
    t.samples = engine_box(p);
    // The smallest normal float32; 1 / volume would overflow for smaller values.
    t.seen = abs(volume) >= 1.17549435e-38 && t.samples.z >= t.samples.x && t.samples.w >= t.samples.y;
    return t;
}

// Returns the tiles that contain a sample of the face.
fn engine_tiles(samples: vec4<i32>) -> vec4<i32> {
    return vec4<i32>(samples.xy / 16, samples.zw / 16 + 1);
}
#else

struct Fragment {
    inside: bool,
    phi: f32,        // window function: 0 on the edges, 1 at the centre
    depth: f32,
    over: vec3<f32>, // barycentric coordinates / depth, weighted
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
