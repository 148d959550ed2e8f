// Colours of faces or vertices from spherical harmonics.

// Returns max(0.5 + sum_k B_k(d) k_k, 0) with d = (p - c) / |p - c|, as in all methods (GaodeRender/triangle-splatting:
// submodules/diff-triangle-rasterization-2D/src/forward.cu, and copies of it).
// A row of f_rest has red, green, blue of coefficient 1, then of coefficient 2, and so on.
// `row` counts from the first row in the bound part of f_rest.
fn term(start: u32, number: u32, basis: f32) -> vec3<f32> {
    let at = start + 3u * number - 3u;
    return basis * vec3<f32>(f_rest[at], f_rest[at + 1u], f_rest[at + 2u]);
}

fn color_of(first: vec3<f32>, row: u32, towards: vec3<f32>) -> vec3<f32> {
    var sum = first * 0.28209479177387814;
    let away = towards - view.center;
    let d = away / sqrt(away.x * away.x + away.y * away.y + away.z * away.z);
    let start = row * REST_STRIDE;
    let xx = d.x * d.x;
    let yy = d.y * d.y;
    let zz = d.z * d.z;
    if (view.degree > 0u) {
        sum += term(start, 1u, -0.4886025119029199 * d.y);
        sum += term(start, 2u, 0.4886025119029199 * d.z);
        sum += term(start, 3u, -0.4886025119029199 * d.x);
    }
    if (view.degree > 1u) {
        sum += term(start, 4u, 1.0925484305920792 * d.x * d.y);
        sum += term(start, 5u, -1.0925484305920792 * d.y * d.z);
        sum += term(start, 6u, 0.31539156525252005 * (2.0 * zz - xx - yy));
        sum += term(start, 7u, -1.0925484305920792 * d.x * d.z);
        sum += term(start, 8u, 0.5462742152960396 * (xx - yy));
    }
    if (view.degree > 2u) {
        sum += term(start, 9u, -0.5900435899266435 * d.y * (3.0 * xx - yy));
        sum += term(start, 10u, 2.890611442640554 * d.x * d.y * d.z);
        sum += term(start, 11u, -0.4570457994644658 * d.y * (4.0 * zz - xx - yy));
        sum += term(start, 12u, 0.3731763325901154 * d.z * (2.0 * zz - 3.0 * xx - 3.0 * yy));
        sum += term(start, 13u, -0.4570457994644658 * d.x * (4.0 * zz - xx - yy));
        sum += term(start, 14u, 1.445305721320277 * d.z * (xx - yy));
        sum += term(start, 15u, -0.5900435899266435 * d.x * (xx - 3.0 * yy));
    }
    if (view.degree > 3u) {
        sum += term(start, 16u, 2.5033429417967046 * d.x * d.y * (xx - yy));
        sum += term(start, 17u, -1.7701307697799304 * d.y * d.z * (3.0 * xx - yy));
        sum += term(start, 18u, 0.9461746957575601 * d.x * d.y * (7.0 * zz - 1.0));
        sum += term(start, 19u, -0.6690465435572892 * d.y * d.z * (7.0 * zz - 3.0));
        sum += term(start, 20u, 0.10578554691520431 * (zz * (35.0 * zz - 30.0) + 3.0));
        sum += term(start, 21u, -0.6690465435572892 * d.x * d.z * (7.0 * zz - 3.0));
        sum += term(start, 22u, 0.47308734787878004 * (xx - yy) * (7.0 * zz - 1.0));
        sum += term(start, 23u, -1.7701307697799304 * d.x * d.z * (xx - 3.0 * yy));
        sum += term(start, 24u, 0.6258357354491761 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy)));
    }
    sum += 0.5;
    // The colour is 0 if the direction is NaN.
    return select(vec3<f32>(0.0), sum, sum > vec3<f32>(0.0));
}
