// DiffSoup, GPU style: a work-group draws one triangle with atomics, a work-item shades one pixel.
// Defines also: GROUP, the size of the work-groups of `raster`.
#define WIDE 0
#include "lattice_math.cl"
#include "lattice_project.cl"
#pragma OPENCL EXTENSION cl_khr_int64_base_atomics : enable
#pragma OPENCL EXTENSION cl_khr_int64_extended_atomics : enable

#define NOTHING ULONG_MAX

static float opacity_at(__global const TEXEL *lattice, int side, float b0, float b1)
{
    Cell c = cell_at(b0, b1, side);
    float d0 = DECODED((float)lattice[c.node0]), d1 = DECODED((float)lattice[c.node0 + 1]);
    float d2 = DECODED((float)lattice[c.node2]);
    return c.w0 * d0 + c.w1 * d1 + c.w2 * d2;
}

// The key of a pixel is (bits of depth + 2) << 32 | face: the smallest is the nearest, and the lowest face on a
// tie, whatever order the fragments come in. keys must be filled with NOTHING, fragments with 0.
__kernel void raster(__global const float4 *corners, __global const ushort *first_rows,
                     __global const ushort *last_rows, __global const ushort2 *columns,
                     __global const TEXEL *opacity, __global const uchar *opaque,
                     __global const float *ndc_x, __global const float *ndc_y, __global ulong *keys,
                     __global uint *fragments, uint width, int side)
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
        ulong key = (ulong)as_uint(f.ndc + 2.0f) << 32 | (uint)face;
        __global ulong *at = keys + (size_t)row * width + column;
        // Keys only become smaller, so one read earlier that is smaller already says enough.
        if (!(f.ndc > -1.0f) || key >= *(volatile __global ulong *)at)
            continue;
        if (opaque[face] || !(opacity_at(opacity + face * SAMPLES(side), side, f.b0, f.b1) < 0.5f))
            atom_min(at, key);
    }
    if (count)
        atomic_add(fragments + face, count);
}

// One pixel; the rows of the picture may run the other way than the raster's, which `raw` keeps.
__kernel void shade(__global const ulong *keys, __global const float4 *corners,
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
    ulong key = keys[pixel];
    int face = key == NOTHING ? -1 : (int)(uint)key;
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
        visible[face] = 1; // every pixel writes the same value
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
