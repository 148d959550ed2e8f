// The part of the frame that is drawn.
struct Band {
    first: vec2<u32>, // pixel of the frame
    size: vec2<u32>,  // pixels
    output: u32,      // where its pixels begin, in floats
}
