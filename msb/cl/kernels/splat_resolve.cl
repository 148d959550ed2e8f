// Turns planes of raster samples into the pixels of a frame, for every method and style.
//
// Planes 0..2 are colour, and plane 3 is transmittance. Plane 4 is the sum of weight times depth. Planes 5..7
// are the sum of weight times normal. Plane 8 is the median depth, and plane 9 is the median face. A pixel
// has `scale` x `scale` samples, and uses the samples first..last along each axis. A box average uses all
// samples. Bilinear interpolation at pixel centres uses the middle one or two samples along each axis.
#pragma OPENCL FP_CONTRACT OFF

typedef struct {
    uint width, rows;  // pixels of this band of rows
    uint scale, first, last;
    uint stride;       // samples per row of a plane
    uint plane_rows;
    uint first_row;    // first row of the band in pixels
} Band;

Band band_of(__global const uint *b)
{
    return (Band){b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]};
}

float mean_of(__global const float *plane, Band b, uint x, uint y)
{
    plane += (size_t)(y * b.scale + b.first) * b.stride + x * b.scale + b.first;
    uint side = b.last - b.first + 1;
    if (side == 1)
        return *plane;
    if (side == 2)
        return 0.25f * ((plane[0] + plane[1]) + (plane[b.stride] + plane[b.stride + 1]));
    if (side == 4) { // the usual scale; this code is three times as fast as the loop below
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
    Band b = band_of(band);
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

// The face number is taken from the middle sample.
__kernel void resolve_extras(__global const float *planes, __global const uint *band, __global float *normal,
                             __global float *median, __global int *face)
{
    Band b = band_of(band);
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

// The transpose of `resolve`, from an image to the samples of the raster.
// Plane 3 is the share of the sample in its pixel.
// Planes 0..2 are the colour of the pixel times that share.
// All planes are 0 outside the image.
__kernel void spread(__global const float *picture, __global const uint *band, __global float *planes)
{
    Band b = band_of(band);
    uint column = get_global_id(0), row = get_global_id(1);
    if (column >= b.stride || row >= b.plane_rows)
        return;
    uint x = column / b.scale, y = row / b.scale, u = column % b.scale, v = row % b.scale;
    uint side = b.last - b.first + 1;
    bool counts = x < b.width && y < b.rows && u >= b.first && u <= b.last && v >= b.first && v <= b.last;
    float share = counts ? 1.0f / (float)(side * side) : 0.0f;
    float3 color = counts ? vload3((size_t)(b.first_row + y) * b.width + x, picture) * share : (float3)(0.0f);
    size_t plane = (size_t)b.stride * b.plane_rows;
    planes += (size_t)row * b.stride + column;
    planes[0] = color.x;
    planes[plane] = color.y;
    planes[2 * plane] = color.z;
    planes[3 * plane] = share;
}
