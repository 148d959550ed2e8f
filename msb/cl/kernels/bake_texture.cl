// Equations that image pixels impose on the texels of a square texture and its smaller levels.
// The formulas are in msb/bake/texture_equations.py.
// Sums are equal in every run, because the pixels of a texel are added in order.
#define LANES 1
#include "zbuffer_math.cl"
#include "zbuffer_texture.cl"

#define SHOWN(target, place) ((float)(target)[place] * (1.0f / 65535.0f))

// The part of a texture level that a pixel shows.
// The members are the pixel's offset from the first of four blended texels, and the share of the level.
typedef struct {
    float x, y, share, unused;
} Sample;

// Values of a face that are constant over all pixels of a view.
// A position in texels is a quotient of two linear functions of px and py.
// The array `rows` holds the factors of the denominator, then of the numerators of u and v.
// `low` and `high` are the bounds of the face in the texture.
typedef struct {
    float rows[3][3], low[2], high[2];
    int is_long;
    float unused[2];
} Ways;

// The arrays `corners` and `uvs` hold three corners per face.
// The volumes are defined as in the function weights_and_steps.
__kernel void faces(__global const float *corners, __global const float *uvs, __constant float *view, int side,
    __global Ways *ways, uint count)
{
    size_t face = get_global_id(0);
    if (face >= count)
        return;
    __global const float *c = corners + 9 * face, *uv = uvs + 6 * face;
    float a[3], b[3], t[3], u[3], v[3], n[3];
    for (int axis = 0; axis < 3; axis++) {
        a[axis] = c[3 + axis] - c[axis];
        b[axis] = c[6 + axis] - c[axis];
        t[axis] = view[REST + axis] - (c[axis] - view[CENTER + axis]);
    }
    CROSS(float, ux, uy, uz, b[0], b[1], b[2], t[0], t[1], t[2])
    CROSS(float, vx, vy, vz, t[0], t[1], t[2], a[0], a[1], a[2])
    CROSS(float, nx, ny, nz, b[0], b[1], b[2], a[0], a[1], a[2])
    Ways ways_of_face;
    for (int k = 0; k < 3; k++) {
        float rx = view[RAY + 3 * k], ry = view[RAY + 3 * k + 1], rz = view[RAY + 3 * k + 2];
        DOT(float, of_u, rx, ry, rz, ux, uy, uz)
        DOT(float, of_v, rx, ry, rz, vx, vy, vz)
        DOT(float, of_n, rx, ry, rz, nx, ny, nz)
        ways_of_face.rows[0][k] = of_n;
        for (int axis = 0; axis < 2; axis++) {
            float first = uv[axis], second = uv[2 + axis] - first, third = uv[4 + axis] - first;
            ways_of_face.rows[1 + axis][k] = (float)side * MAD(of_n, first, MAD(of_u, second, of_v * third));
            ways_of_face.low[axis] = (float)side * (first + MIN(0.0f, MIN(second, third)));
            ways_of_face.high[axis] = (float)side * (first + MAX(0.0f, MAX(second, third)));
        }
    }
    ways_of_face.is_long = is_long(c);
    ways[face] = ways_of_face;
}

// Each pixel has a sample in each of two neighbouring levels.
// The key of a sample is the first of its four texels, or `none`.
// `errors` is the difference to the training image.
// `starts` holds the number of the first texel of each level.
__kernel void samples(__global const float *corners, __global const float *uvs, __constant float *view,
    __global const Ways *ways, __global const int *faces, __global const float *image, __global const ushort *target,
    __global const int *starts, int side, int levels, int width, uint none, __global uint *keys,
    __global Sample *samples, __global float4 *errors, uint count)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    int face = faces[i];
    keys[2 * i] = keys[2 * i + 1] = none;
    if (face < 0)
        return;
    float error[3];
    for (int channel = 0; channel < 3; channel++)
        error[channel] = SHOWN(target, 3 * i + channel) - image[3 * i + channel];
    errors[i] = (float4)(error[0], error[1], error[2], 0.0f);

    // Texture position of the pixel, and the change of this position per pixel along x and y.
    float px = (float)((int)i % width) + 0.5f - view[OPTICAL], py = (float)((int)i / width) + 0.5f - view[OPTICAL + 1];
    Ways way = ways[face];
    float bottom = MAD(px, way.rows[0][0], MAD(py, way.rows[0][1], way.rows[0][2]));
    float inverse = bottom == 0.0f ? 0.0f : 1.0f / bottom, w[6];
    if (way.is_long) {
        float c[9];
        for (int k = 0; k < 9; k++)
            c[k] = corners[9 * (size_t)face + k];
        weights_and_steps(c, view, px, py, w);
        wide_weights_and_steps(corners + 9 * (size_t)face, view, px, py, w);
    }
    float place[2], along[2] = {0.0f, 0.0f};
    for (int axis = 0; axis < 2; axis++) {
        const float *row = way.rows[1 + axis];
        float at = inverse * MAD(px, row[0], MAD(py, row[1], row[2])), steps[2];
        for (int k = 0; k < 2; k++)
            steps[k] = inverse * (row[k] - at * way.rows[0][k]);
        if (way.is_long) {
            __global const float *uv = uvs + 6 * (size_t)face + axis;
            float first = (float)side * uv[0], a = (float)side * uv[2] - first, b = (float)side * uv[4] - first;
            at = MAD(w[0], a, MAD(w[1], b, first));
            for (int k = 0; k < 2; k++)
                steps[k] = MAD(w[2 + 2 * k], a, w[3 + 2 * k] * b);
        }
        place[axis] = MAX(way.low[axis], MIN(way.high[axis], at));
        for (int k = 0; k < 2; k++)
            along[k] = MAD(steps[k], steps[k], along[k]);
    }
    // The larger change determines the level; the two nearest levels share the pixel.
    float lod = 0.5f * log2_of(MAX(1.0f, MAX(along[0], along[1])));
    lod = MAX(0.0f, MIN(lod, (float)(levels - 1)));
    int level = (int)lod;
    float part = lod - (float)level;
    for (int k = 0; k < (part > 0.0f ? 2 : 1); k++, level++) {
        int wide = side >> level, whole[2];
        float beyond[2], smaller = 1.0f / (float)(1 << level);
        for (int axis = 0; axis < 2; axis++) {
            float at = place[axis] * smaller - 0.5f;
            at = MAX(0.0f, MIN(at, (float)(wide - 1)));
            whole[axis] = MIN((int)at, wide - 2);
            beyond[axis] = at - (float)whole[axis];
        }
        Sample sample = {beyond[0], beyond[1], k ? part : 1.0f - part, 0.0f};
        samples[2 * i + k] = sample;
        keys[2 * i + k] = (uint)(starts[level] + whole[1] * wide + whole[0]);
    }
}

// Return the position of the first sorted key that is not less than `key`.
uint first_of(__global const uint *keys, uint count, uint key)
{
    uint from = 0, to = count;
    while (from < to) {
        uint middle = (from + to) / 2;
        if (keys[middle] < key)
            from = middle + 1;
        else
            to = middle;
    }
    return from;
}

// Add samples to the equations of the four texels that each sample blends, in the layout of bake_solve.cl.
// A work-item takes the samples whose first texel lies in a certain row of a level.
// A sample changes two adjacent rows. Work-items with rows of equal parity therefore never write to the same
// texel.
__kernel void add(__global const uint *keys, __global const uint *places, __global const Sample *samples,
    __global const float4 *errors, __global const int *starts, int side, int levels, int parity, float weight,
    __global float8 *equations, uint count)
{
    int row = 2 * (int)get_global_id(0) + parity, level = 0;
    while (level < levels && row >= (side >> level))
        row -= side >> level++;
    if (level == levels)
        return;
    int wide = side >> level;
    uint begin = (uint)(starts[level] + row * wide), end = first_of(keys, count, begin + wide);
    for (uint i = first_of(keys, count, begin); i < end; i++) {
        Sample s = samples[places[i]];
        // factors of the first texel; swizzles rearrange the factors for other texels; s4 stays 0
        float8 w = 0.0f;
        w.lo = (float4)(1.0f - s.x, s.x, 1.0f - s.x, s.x) * (float4)(1.0f - s.y, 1.0f - s.y, s.y, s.y);
        w.s567 = errors[places[i] / 2].xyz;
        float4 mine = weight * s.share * w.lo;
        __global float8 *first = equations + keys[i], *below = first + wide;
        first[0] += mine.x * w;
        first[1] += mine.y * w.s14342567;
        below[0] += mine.z * w.s23444567;
        below[1] += mine.w * w.s34444567;
    }
}
