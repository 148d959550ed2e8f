// What a method's `cover` returns for a face at a sample: nothing is drawn where alpha is below MIN_ALPHA.
const MIN_ALPHA = 1.0 / 255.0;

struct Seen {
    color: vec3<f32>,
    alpha: f32,
    depth: f32, // camera z
}
