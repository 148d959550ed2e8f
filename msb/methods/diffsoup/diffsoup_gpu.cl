// DiffSoup in GPU style: a work-group draws one triangle with atomics, and a work-item shades one pixel.
// Further defines: GROUP is the work-group size of `raster`, and KEYS is 1 if the device has 64-bit atomics.
//
// The key of a pixel has 64 bits.
// The upper half is the bits of depth + 2 minus the bits of 1; the lower half is the face number.
// The smallest key is the nearest fragment, in any order of fragments.
// At equal depths, the smallest key has the lowest face number.
// Without 64-bit atomics (KEYS 0) the triangles are drawn twice.
// The first pass finds depths, and the second pass finds the faces at these depths.
#define WIDE 0
#include "diffsoup_math.cl"
#include "diffsoup_project.cl"
#if KEYS
#pragma OPENCL EXTENSION cl_khr_int64_base_atomics : enable
#pragma OPENCL EXTENSION cl_khr_int64_extended_atomics : enable
#endif

// The two 32-bit words of a pixel's little-endian key.
#define FACE_OF(key) (key)[0]
#define DEPTH_OF(key) (key)[1]
#define NOTHING 0xffffffffu

static float opacity_at(__global const TEXEL *lattice, int side, float b0, float b1)
{
    Cell c = cell_at(b0, b1, side);
    float d0 = DECODED((float)lattice[c.node0]), d1 = DECODED((float)lattice[c.node0 + 1]);
    float d2 = DECODED((float)lattice[c.node2]);
    return c.w0 * d0 + c.w1 * d1 + c.w2 * d2;
}

// Returns whether a fragment may change the pixel; `depth` is the upper half of the fragment's key.
// Keys only decrease, so an earlier read of a smaller key suffices to reject the fragment.
static bool may_win(__global uint *key, uint depth, uint face, int pass)
{
#if KEYS
    return ((ulong)depth << 32 | face) < *(volatile __global ulong *)key;
#else
    return pass == 0 ? depth < *(volatile __global uint *)&DEPTH_OF(key)
                     : depth == DEPTH_OF(key) && face < *(volatile __global uint *)&FACE_OF(key);
#endif
}

static void win(__global uint *key, uint depth, uint face, int pass)
{
#if KEYS
    atom_min((__global ulong *)key, (ulong)depth << 32 | face);
#else
    if (pass == 0)
        atomic_min(&DEPTH_OF(key), depth);
    else
        atomic_min(&FACE_OF(key), face);
#endif
}

// `keys` must be filled with NOTHING, and `fragments` with 0.
// Fragments are counted only in the first pass.
__kernel void raster(__global const float4 *corners, __global const ushort *first_rows,
                     __global const ushort *last_rows, __global const ushort2 *columns,
                     __global const TEXEL *opacity, __global const uchar *opaque,
                     __global const float *ndc_x, __global const float *ndc_y, __global uint *keys,
                     __global uint *fragments, uint width, int side, int pass)
{
    size_t face = get_group_id(0);
    uint first = first_rows[face], last = last_rows[face];
    if (first > last)
        return;
    float4 p0 = corners[3 * face], p1 = corners[3 * face + 1], p2 = corners[3 * face + 2];
    uint left = columns[face].x, wide = columns[face].y - left + 1, pixels = wide * (last - first + 1);
    uint count = 0;
    for (uint i = get_local_id(0); i < pixels; i += GROUP) {
        uint row = first + i / wide, column = left + i % wide;
        Fragment f = fragment_at(ndc_x[column], ndc_y[row], p0, p1, p2);
        if (!f.valid)
            continue;
        count++;
        // The bits of depth + 2 minus the bits of 1 are a non-negative integer, because depth + 2 is at least
        // 1. An integer is needed, because atomics of Mesa's llvmpipe (22.3) have no effect on the bits of a
        //    float.
        uint depth = as_uint(f.ndc + 2.0f) - as_uint(1.0f);
        __global uint *key = keys + 2 * ((size_t)row * width + column);
        if (!(f.ndc > -1.0f) || !may_win(key, depth, (uint)face, pass))
            continue;
        if (opaque[face] || !(opacity_at(opacity + face * SAMPLES(side), side, f.b0, f.b1) < 0.5f))
            win(key, depth, (uint)face, pass);
    }
    if (count && pass == 0)
        atomic_add(fragments + face, count);
}

// Shade one pixel.
// The rows of the image may run in the opposite order to the rows of the raster.
// The buffers of `raw` keep the raster's order.
__kernel void shade(__global const uint *keys, __global const float4 *corners,
                    __global const TEXEL *lattice, __constant float *net, __global const float *frame,
                    __global const float *ndc_x, __global const float *ndc_y, __global float *image,
                    __global float *depth, __global int *face_id, __global uchar *visible,
                    __global float *raw_bary, __global float *raw_ndc, __global float *raw_features,
                    __global float *raw_harmonics, uint width, uint height, uint flip, uint viewer, uint raw,
                    int side)
{
    size_t pixel = get_global_id(0);
    if (pixel >= (size_t)width * height)
        return;
    uint row = (uint)(pixel / width), column = (uint)(pixel % width);
    size_t to = (size_t)(flip ? height - 1 - row : row) * width + column;
    __global const uint *key = keys + 2 * pixel;
    int face = DEPTH_OF(key) == NOTHING ? -1 : (int)FACE_OF(key);
    float x[INPUTS], color[3], dx, dy, dz;
    Fragment f = {0.0f, 0.0f, 0.0f, 0.0f, 0};
    for (int c = 0; c < 3; c++)
        color[c] = frame[BACKGROUND + c];
    for (int i = 0; i < INPUTS; i++)
        x[i] = 0.0f;
    if (face >= 0) {
        __global const float4 *p = corners + 3 * (size_t)face;
        f = fragment_at(ndc_x[column], ndc_y[row], p[0], p[1], p[2]);
        Cell c = cell_at(f.b0, f.b1, side);
        __global const TEXEL *texels = lattice + face * (SAMPLES(side) * FEATURES);
        __global const TEXEL *first = texels + c.node0 * FEATURES, *last = texels + c.node2 * FEATURES;
        for (int i = 0; i < FEATURES; i++) {
            float d0 = DECODED((float)first[i]), d1 = DECODED((float)first[FEATURES + i]);
            x[i] = c.w0 * d0 + c.w1 * d1 + c.w2 * DECODED((float)last[i]);
            if (viewer)
                x[i] = as_target(x[i]);
        }
        towards_camera(ndc_x[column], ndc_y[row], frame + INVERSE, &dx, &dy, &dz);
        harmonics(dx, dy, dz, x + FEATURES);
        decode(x, net, color);
        visible[face] = 1; // all pixels write the same value
    }
    vstore3((float3)(color[0], color[1], color[2]), to, image);
    depth[to] = f.w;
    face_id[to] = face;
    if (raw) {
        raw_bary[2 * pixel] = f.b0;
        raw_bary[2 * pixel + 1] = f.b1;
        raw_ndc[pixel] = f.ndc;
        for (int i = 0; i < FEATURES; i++)
            raw_features[pixel * FEATURES + i] = x[i];
        for (int i = 0; i < HARMONICS; i++)
            raw_harmonics[pixel * HARMONICS + i] = x[FEATURES + i];
    }
}
