// DiffSoup: clip coordinates and pixel rectangle of every triangle, for both kernel styles.
// Included after diffsoup_math.cl.

#define NO_ROW 65535 // images have fewer rows, so a triangle that starts at this row has no pixels

static float4 to_clip(__global const float *m, __global const float *positions, uint vertex)
{
    __global const float *p = positions + 3 * (size_t)vertex;
    float x = p[0], y = p[1], z = p[2];
#define ROW(r) (m[4 * r] * x + m[4 * r + 1] * y + m[4 * r + 2] * z + m[4 * r + 3])
    return (float4)(ROW(0), ROW(1), ROW(2), ROW(3));
#undef ROW
}

static float in_range(float ndc)
{
    return isfinite(ndc) ? clamp(ndc, -1.0f, 1.0f) : ndc > 0.0f ? 1.0f : -1.0f;
}

// First and last pixel along an axis of `size` pixels.
// In an empty range, the first pixel is greater than the last.
static int2 pixel_range(float a, float b, float c, uint size)
{
    float low = min(min(a, b), c), high = max(max(a, b), c);
    int first = max((int)floor(0.5f * (low + 1.0f) * (float)size), 0);
    int last = min((int)floor(0.5f * (high + 1.0f) * (float)size), (int)size - 1);
    return (int2)(first, last);
}

// The kernel is launched with `padded` >= `faces` work-items.
// The arrays of rectangles end with empty rectangles.
__kernel void project(__global const float *positions, __global const uint *indices,
                      __global const float *frame, __global float4 *corners, __global ushort *first_rows,
                      __global ushort *last_rows, __global ushort2 *columns, uint faces, uint padded,
                      uint width, uint height)
{
    size_t face = get_global_id(0);
    if (face >= padded)
        return;
    first_rows[face] = NO_ROW;
    last_rows[face] = 0;
    columns[face] = (ushort2)(1, 0);
    if (face >= faces)
        return;
    float4 p0 = to_clip(frame + MVP, positions, indices[3 * face]);
    float4 p1 = to_clip(frame + MVP, positions, indices[3 * face + 1]);
    float4 p2 = to_clip(frame + MVP, positions, indices[3 * face + 2]);
    corners[3 * face] = p0;
    corners[3 * face + 1] = p1;
    corners[3 * face + 2] = p2;

    // The official code clips nothing: a triangle with a corner at or behind the camera plane is dropped.
    // A game engine keeps the part in front of the camera. The triangle's rectangle is then the whole image,
    // and the depth test discards the part behind the camera.
    bool crosses = !(p0.w > 0.0f && p1.w > 0.0f && p2.w > 0.0f);
    if (crosses && (!ENGINE || !(p0.w > 0.0f || p1.w > 0.0f || p2.w > 0.0f)))
        return;
    int4 below = (p0 < -p0.w) & (p1 < -p1.w) & (p2 < -p2.w);
    int4 above = (p0 > p0.w) & (p1 > p1.w) & (p2 > p2.w);
    if (any(below.xyz | above.xyz))
        return;
    float i0 = 1.0f / p0.w, i1 = 1.0f / p1.w, i2 = 1.0f / p2.w;
    int2 c = pixel_range(in_range(p0.x * i0), in_range(p1.x * i1), in_range(p2.x * i2), width);
    int2 r = pixel_range(in_range(p0.y * i0), in_range(p1.y * i1), in_range(p2.y * i2), height);
    if (crosses) {
        c = (int2)(0, (int)width - 1);
        r = (int2)(0, (int)height - 1);
    }
    if (c.x > c.y || r.x > r.y)
        return;
    first_rows[face] = (ushort)r.x;
    last_rows[face] = (ushort)r.y;
    columns[face] = (ushort2)((ushort)c.x, (ushort)c.y);
}
