// Functions shared by Triangle-Splatting and MeshSplatting: projected triangles, their incentres and edge distances.
// Sources: trianglesplatting/diff-triangle-rasterization at 6d61f4c: cuda_rasterizer/forward.cu, auxiliary.h;
// meshsplatting/diff-triangle-mesh-rasterization at b27f283 (the same lines).

const NEAREST = 0.2;
const GRAZING = 0.001;
const MIN_LENGTH = 1e-4;
const MIN_OPACITY = 0.01;
const MAX_RADIUS = 1600.0;
const MIN_DETERMINANT = 1e-3;

struct Window {
    depth: f32,                          // z of the centroid in camera space
    corners: array<vec2<f32>, 3>,        // samples
    edge_normal: array<vec2<f32>, 3>,    // outwards
    edge_offset: array<f32, 3>,
    inradius: array<f32, 3>,             // negative
    incentre: vec2<f32>,
}

fn window_sample(p: vec3<f32>) -> vec2<f32> {
    let inverse = div(1.0, add(affine(view.full[3], p), 1e-7));
    return vec2<f32>(add(to_sample(mul(affine(view.full[0], p), inverse), view.width), view.shift.x),
                     add(to_sample(mul(affine(view.full[1], p), inverse), view.height), view.shift.y));
}

// Returns whether the triangle is kept by the culling rules that do not depend on opacity or tiles.
// As in the official code nothing is clipped, so the perspective division mirrors corners behind the camera.
fn project_window(p: array<vec3<f32>, 3>, w: ptr<function, Window>) -> bool {
    let center = center_of(p[0], p[1], p[2]);
    let camera = to_camera(center);
    (*w).depth = camera.z;
    if (camera.z <= NEAREST) {
        return false;
    }
    var normal = rotate_to_camera(cross3(sub3(p[1], p[0]), sub3(p[2], p[0])));
    normal = div3(normal, greater(length3(normal), MIN_LENGTH));
    let cosine = dot3(normal, div3(camera, greater(length3(camera), MIN_LENGTH)));
    if (abs(cosine) < GRAZING) {
        return false;
    }
    let middle = window_sample(center);
    var radius = 0.0;
    var c: array<vec2<f32>, 3>;
    for (var k = 0; k < 3; k++) {
        c[k] = window_sample(p[k]);
        radius = greater(length2(sub2(c[k], middle)), radius);
    }
    (*w).corners = c;
    if (radius > MAX_RADIUS || radius < 1.0) {
        return false;
    }
    let to_p = length2(sub2(c[1], c[2]));
    let to_q = length2(sub2(c[0], c[2]));
    let to_r = length2(sub2(c[0], c[1]));
    let weighted = add2(add2(scale2(c[0], to_p), scale2(c[1], to_q)), scale2(c[2], to_r));
    let total = add(add(to_p, to_q), to_r);
    let incentre = vec2<f32>(div(weighted.x, total), div(weighted.y, total));
    (*w).incentre = incentre;
    for (var k = 0; k < 3; k++) {
        let start = c[k];
        let end = c[(k + 1) % 3];
        var n = vec2<f32>(keep(end.y - start.y), -keep(end.x - start.x));
        n = scale2(n, div(1.0, length2(n)));
        let t = -dot2(n, start);
        let distance = add(dot2(n, incentre), t);
        let outward = select(1.0, -1.0, distance > 0.0);
        (*w).edge_normal[k] = n * outward;
        (*w).edge_offset[k] = t * outward;
        (*w).inradius[k] = distance * outward;
    }
    // The inradius is NaN if two corners coincide. The official code keeps a face with coincident corners,
    // but no sample is inside the face.
    return !((*w).inradius[2] > -1.0);
}

// Returns the box of samples with an alpha of 1/255 or more.
// The triangle is first shrunk about its incentre to the contour phi = `rim`.
// The box is empty if `rim` exceeds 1.
// The box is enlarged by the rounding error of the edges, which is larger at sharp corners.
fn window_box(w: ptr<function, Window>, rim: f32) -> vec4<i32> {
    let p = (*w).corners[0];
    let q = (*w).corners[1];
    let r = (*w).corners[2];
    let m = (*w).incentre;
    let low = min(min(p, q), r);
    let high = max(max(p, q), r);
    let far = max(max(abs(low.x), abs(low.y)), max(abs(high.x), abs(high.y)));
    let longest = max(high.x - low.x, high.y - low.y);
    let slack = 0.01 + 1e-6 * far * (1.0 + longest / -(*w).inradius[2]);
    var samples = box_of(low + (m - low) * rim - slack, high + (m - high) * rim + slack);
    if (rim > 1.0) {
        samples.z = -1;
    }
    return samples;
}

// Returns the tiles of the contour opacity * phi^sigma = 0.01, from the intersections of the edges moved inwards.
fn contour_tiles(w: ptr<function, Window>, shrunk: f32) -> vec4<i32> {
    var offset: array<f32, 3>;
    var distance = 0.0;
    for (var k = 0; k < 3; k++) {
        // As in the official code, the distance of the first edge is used for all edges, unless it underflows to 0.
        if (distance == 0.0) {
            distance = mul((*w).inradius[k], shrunk);
        }
        offset[k] = keep(div((*w).edge_offset[k], length2((*w).edge_normal[k])) - distance);
    }
    var tiles = vec4<i32>(i32(view.columns), i32(view.rows), 0, 0);
    for (var pair = 0; pair < 3; pair++) {
        let current = (pair + 1) % 3;
        let n = (*w).edge_normal[current];
        let m = (*w).edge_normal[pair];
        let t = offset[current];
        let s = offset[pair];
        let determinant = cross2(n, m);
        if (abs(determinant) < MIN_DETERMINANT) {
            continue;
        }
        let x = div(-keep(mul(t, m.y) - mul(s, n.y)), determinant);
        let y = div(-keep(mul(s, n.x) - mul(t, m.x)), determinant);
        let low = vec2<i32>(tile_number(x / 16.0, view.columns), tile_number(y / 16.0, view.rows));
        let high = vec2<i32>(tile_number(keep(keep(x + 16.0) - 1.0) / 16.0, view.columns),
                             tile_number(keep(keep(y + 16.0) - 1.0) / 16.0, view.rows));
        tiles = vec4<i32>(min(tiles.xy, low), max(tiles.zw, high));
    }
    return tiles;
}

// Returns the largest of the three signed distances n.x x + n.y y + t from the edges. This distance is
// positive outside the triangle. The terms are added in the official order: a sample exactly on an edge then
// has distance 0 and alpha 0. With a fused sum the distance could be -1e-5, which a sharp window (phi^0.01)
// would turn into an alpha of 0.8.
fn nearest_edge(normal_x: vec3<f32>, normal_y: vec3<f32>, offset: vec3<f32>, x: f32, y: f32) -> f32 {
    let e = keep3(keep3(normal_x * x) + keep3(normal_y * y)) + offset;
    return max(max(e.x, e.y), e.z);
}

// Returns phi^sigma, computed like the official fast power function. The result is 0 if phi is 0.
fn window_power(phi: f32, sigma: f32) -> f32 {
    return select(0.0, exp2(max(sigma * log2(max(phi, 1e-30)), -100.0)), phi > 1e-30);
}
