// A rectangle of the frame.
struct Band {
    first: vec2<u32>, // first pixel in the frame
    size: vec2<u32>,  // size in pixels
    output: u32,      // offset of the band's pixels in the output, in floats
}
