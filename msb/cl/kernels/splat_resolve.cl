// From planes of raster samples to the pixels of a frame; the same for every method and style.
//
// Planes: 0..2 colour, 3 transmittance, 4 sum of weight times depth, 5..7 sum of weight times normal, 8
// median depth, 9 median face. A pixel is `scale` x `scale` samples; samples first..last of each axis count:
// all of them for a box mean, the middle one or two for bilinear interpolation at pixel centres.
#pragma OPENCL FP_CONTRACT OFF

typedef struct {
    uint width, rows;  // of this band, pixels
    uint scale, first, last;
    uint stride;       // samples a row of a plane
    uint plane_rows;
    uint first_row;    // of the band, pixels
} Band;

float mean_of(__global const float *plane, Band b, uint x, uint y)
{
    plane += (size_t)(y * b.scale + b.first) * b.stride + x * b.scale + b.first;
    uint side = b.last - b.first + 1;
    if (side == 1)
        return *plane;
    if (side == 2)
        return 0.25f * ((plane[0] + plane[1]) + (plane[b.stride] + plane[b.stride + 1]));
    if (side == 4) { // the usual one: a third of the time of the loop
        float4 sum = vload4(0, plane) + vload4(0, plane + b.stride);
        sum = sum + (vload4(0, plane + 2 * b.stride) + vload4(0, plane + 3 * b.stride));
        return 0.0625f * ((sum.x + sum.y) + (sum.z + sum.w));
    }
    float sum = 0.0f;
    for (uint v = 0; v < side; v++)
        for (uint u = 0; u < side; u++)
            sum += plane[v * b.stride + u];
    return sum / (float)(side * side);
}

__kernel void resolve(__global const float *planes, __global const uint *band, __global float *image,
                      __global float *alpha, __global float *depth, float red, float green, float blue)
{
    Band b = {band[0], band[1], band[2], band[3], band[4], band[5], band[6], band[7]};
    uint x = get_global_id(0), y = get_global_id(1);
    if (x >= b.width || y >= b.rows)
        return;
    size_t plane = (size_t)b.stride * b.plane_rows, out = (size_t)(b.first_row + y) * b.width + x;
    float t = mean_of(planes + 3 * plane, b, x, y);
    vstore3((float3)(mean_of(planes, b, x, y) + t * red, mean_of(planes + plane, b, x, y) + t * green,
                     mean_of(planes + 2 * plane, b, x, y) + t * blue),
            out, image);
    float covered = 1.0f - t;
    alpha[out] = covered;
    depth[out] = covered > 0.0f ? mean_of(planes + 4 * plane, b, x, y) / covered : 0.0f;
}

// The face is that of the sample in the middle.
__kernel void resolve_extras(__global const float *planes, __global const uint *band, __global float *normal,
                             __global float *median, __global int *face)
{
    Band b = {band[0], band[1], band[2], band[3], band[4], band[5], band[6], band[7]};
    uint x = get_global_id(0), y = get_global_id(1);
    if (x >= b.width || y >= b.rows)
        return;
    size_t plane = (size_t)b.stride * b.plane_rows, out = (size_t)(b.first_row + y) * b.width + x;
    vstore3((float3)(mean_of(planes + 5 * plane, b, x, y), mean_of(planes + 6 * plane, b, x, y),
                     mean_of(planes + 7 * plane, b, x, y)),
            out, normal);
    median[out] = mean_of(planes + 8 * plane, b, x, y);
    uint middle = b.scale / 2;
    __global const int *faces = (__global const int *)(planes + 9 * plane);
    face[out] = faces[(size_t)(y * b.scale + middle) * b.stride + x * b.scale + middle];
}
