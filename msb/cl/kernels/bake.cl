// Sums over images of the standard tier (opaque rendering) for a bake.
// The sums give the best colours of each face, and the benefit of changes.
// Sums are equal in every run.
// The pixels of a face are added in a fixed order, and all other sums are sums of integers.
#define LANES 1
#include "zbuffer_math.cl"

#if WIDE
#pragma OPENCL EXTENSION cl_khr_int64_base_atomics : enable
typedef long whole;
#define ADD(place, value) atom_add(place, value)
#else
typedef int whole;
#define ADD(place, value) atomic_add(place, value)
#endif
#define SUMS 15
// A value of a training image, stored with 16 bits.
#define SHOWN(target, place) ((float)(target)[place] * (1.0f / 65535.0f))

// Write the face number of each pixel as a sort key; pixels without a face come last.
__kernel void owners(__global const int *faces, __global uint *keys, uint none, uint count)
{
    size_t i = get_global_id(0);
    if (i < count)
        keys[i] = faces[i] < 0 ? none : (uint)faces[i];
}

// For each face, add the products of corner weights, and the weights times the colours of the training image.
// With `moves`, also add the derivatives of the squared error with respect to x, y, z of each corner.
// The border between two neighbouring pixels with different faces is an edge of the nearer face.
// If this edge moves outward by a pixel, the outer pixel takes the colour of the nearer face.
// If this edge moves inward by a pixel, the inner pixel takes the colour of the farther face.
// The derivative is the average of both changes, times the weight of the corner at the border.
// All sums are multiplied by `weight`, the weight of the image.
// The array `positions` holds three corners per face.
// The array `sorted` has the pixels in the order of their faces. The work-item of a face's first pixel adds
// all pixels of the face; other work-items do nothing.
__kernel void sums(__global const float *positions, __constant float *view, __global const uint *sorted,
    __global const uint *pixels, __global const ushort *target, __global const float *image,
    __global const float *depth, __global const int *owners, int width, int height, __global float *sums,
    __global float *slopes, __global uint *most, float weight, int moves, uint faces, uint count)
{
    size_t start = get_global_id(0), end = start;
    if (start >= count || sorted[start] >= faces || (start > 0 && sorted[start - 1] == sorted[start]))
        return;
    size_t face = sorted[start];
    __global const float *c = positions + 9 * face;
    int reaches_far = is_long(c);
    float8 products = 0.0f;  // products of corner weights: aa, ab, ac, bb, bc, cc
    float3 color_sums[3] = {0.0f, 0.0f, 0.0f};
    float rise[9];
    for (int k = 0; k < 9; k++)
        rise[k] = 0.0f;
    for (; end < count && sorted[end] == face; end++) {
        int pixel = (int)pixels[end], y = pixel / width, x = pixel - y * width;
        float px = (float)x + 0.5f - view[OPTICAL], py = (float)y + 0.5f - view[OPTICAL + 1];
        // Weights of the corners at the pixel, and products of these weights with each other and with the
        // colour.
        WEIGHTS(float, view, c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], px, py, w0, w1, w2)
        float w[3] = {w0, w1, w2};
        if (reaches_far)
            wide_weights(c, view, px, py, w);
        float3 color = convert_float3(vload3((size_t)pixel, target)) * (1.0f / 65535.0f);
        float8 left = (float8)(w[0], w[0], w[0], w[1], w[1], w[2], 0.0f, 0.0f);
        products += left * (float8)(w[0], w[1], w[2], w[1], w[2], w[2], 0.0f, 0.0f);
        for (int k = 0; k < 3; k++)
            color_sums[k] += w[k] * color;

        if (!moves)
            continue;
        // Change of the error if the border to a neighbouring pixel moves by one pixel, for each of four
        // neighbours.
        float z = depth[pixel], along[2] = {0.0f, 0.0f};
        for (int side = 0; side < 4; side++) {
            int is_down = side >> 1, step = side & 1 ? 1 : -1, there = (is_down ? y : x) + step;
            if (there < 0 || there >= (is_down ? height : width))
                continue;
            int next = pixel + (is_down ? step * width : step);
            if (owners[next] == (int)face || (owners[next] >= 0 && depth[next] <= z))
                continue;
            float outward = 0.0f, inward = 0.0f;
            for (int channel = 0; channel < 3; channel++) {
                float mine = image[3 * (size_t)pixel + channel], other = image[3 * (size_t)next + channel];
                float here = SHOWN(target, 3 * (size_t)pixel + channel), beyond = SHOWN(target, 3 * (size_t)next + channel);
                outward += (mine - beyond) * (mine - beyond) - (other - beyond) * (other - beyond);
                inward += (other - here) * (other - here) - (mine - here) * (mine - here);
            }
            along[is_down] += 0.5f * (float)step * (outward - inward);
        }
        if (along[0] == 0.0f && along[1] == 0.0f)
            continue;
        for (int axis = 0; axis < 3; axis++) {
            // Chain rule: motion of the pixel when a corner moves along this coordinate axis.
            float right = view[ROTATION + axis] * (1.0f / UNIT) - px * view[ROTATION + 6 + axis];
            float down = view[ROTATION + 3 + axis] * (1.0f / UNIT) - py * view[ROTATION + 6 + axis];
            float slope = (along[0] * right + along[1] * down) / z;
            for (int k = 0; k < 3; k++)
                rise[3 * k + axis] += w[k] * slope;
        }
    }
    float all[8];
    vstore8(products, 0, all);
    for (int k = 0; k < 6; k++)
        sums[SUMS * face + k] += weight * all[k];
    for (int k = 0; k < 3; k++) {
        __global float *mine = sums + SUMS * face + 6 + 3 * k;
        vstore3(vload3(0, mine) + weight * color_sums[k], 0, mine);
    }
    for (int k = 0; k < 9 && moves; k++)
        slopes[9 * face + k] += weight * rise[k];
    most[face] = MAX(most[face], (uint)(end - start));
}

float error_of(__global const float *image, __global const ushort *target, size_t pixel)
{
    float sum = 0.0f;
    for (int channel = 0; channel < 3; channel++) {
        float seen = image[3 * pixel + channel], off = seen - SHOWN(target, 3 * pixel + channel);
        sum += off * off;
    }
    return sum;
}

// Store the face of each pixel of a view and the squared error of the pixel, from row `start` on.
__kernel void remember(__global const float *image, __global const int *faces, __global const ushort *target,
    __global int *old_faces, __global float *old_errors, uint start, uint count)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    old_faces[start + i] = faces[i];
    old_errors[start + i] = error_of(image, target, i);
}

// Each proposed change involves some faces.
// Add a pixel's change of the error to the proposal that involves the old or new face of the pixel.
// If two proposals involve the pixel, each proposal gets half of the change.
__kernel void judge(__global const float *image, __global const int *faces, __global const ushort *target,
    __global const int *old_faces, __global const float *old_errors, __global const int *owner,
    __global whole *totals, float unit, uint start, uint row, uint count)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    int was = old_faces[start + i], is = faces[i];
    int a = was < 0 ? -1 : owner[was], b = is < 0 ? -1 : owner[is];
    if (a < 0 && b < 0)
        return;
    float change = error_of(image, target, i) - old_errors[start + i];
    if (a >= 0 && b >= 0 && a != b) {
        whole part = (whole)rint(0.5f * unit * change);
        ADD(totals + row + a, part);
        ADD(totals + row + b, part);
    } else
        ADD(totals + row + (a >= 0 ? a : b), (whole)rint(unit * change));
}
