// The result of a method's function `cover` for a face at a sample.
// Samples with an alpha below MIN_ALPHA are not drawn.
const MIN_ALPHA = 1.0 / 255.0;

struct Seen {
    color: vec3<f32>,
    alpha: f32,
    depth: f32, // z in camera space
}
