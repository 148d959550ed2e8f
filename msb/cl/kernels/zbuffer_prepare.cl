#include "zbuffer_math.cl"
#if COLORS == TEXTURES
#include "zbuffer_texture.cl"
#undef TEXTURE_ARGUMENTS
#define TEXTURE_ARGUMENTS , __global const float *tint, int is_tinted, __global const uint *face_textures, int several, __global uint *numbers
#else
#define TEXTURE_ARGUMENTS
#endif

// The kernels run once per asset. These kernels make the triangle records of the z-buffer (zbuffer_math.cl),
// and the boxes of clusters.

// Spread the low ten bits of x, with two zero bits before each bit.
uint spread(uint x)
{
    x = (x | x << 16) & 0x030000ff;
    x = (x | x << 8) & 0x0300f00f;
    x = (x | x << 4) & 0x030c30c3;
    return (x | x << 2) & 0x09249249;
}

// Write the position of each centroid along the Morton curve through 1024^3 cells, with 30 bits.
// `origin` and `scale` map positions to cells; points outside the grid are moved to border cells.
__kernel void place(__global const float *positions, __global const uint *indices, __global const uint *listed,
    int all, __global uint *keys, float4 origin, float scale, uint count)
{
    size_t i = get_global_id(0);
    if (i >= count)
        return;
    size_t face = all ? i : listed[i];
    float center[3] = {0.0f, 0.0f, 0.0f};
    for (int k = 0; k < 3; k++) {
        size_t vertex = indices[3 * face + k];
        for (int axis = 0; axis < 3; axis++)
            center[axis] += positions[3 * vertex + axis] * (1.0f / 3.0f);
    }
    uint cell[3];
    float low[3] = {origin.x, origin.y, origin.z};
    for (int axis = 0; axis < 3; axis++) {
        float place = (center[axis] - low[axis]) * scale;
        cell[axis] = place > 0.0f ? (place < 1023.0f ? (uint)place : 1023) : 0;
    }
    keys[i] = spread(cell[0]) | spread(cell[1]) << 1 | spread(cell[2]) << 2;
}

// Returns whether corner a precedes b in the order of x, then y, then z.
int before(const float *a, const float *b)
{
    for (int axis = 0; axis < 3; axis++)
        if (a[axis] != b[axis])
            return a[axis] < b[axis];
    return 0;
}

// Write the records.
// Corners are sorted by position.
// Faces in the same place then have bit-identical depths, for any order of the corners in the file.
// Slots from `count` to the end of the block get triangles of zero area.
// With textures, `colors` has the texture coordinates u, v of each corner.
// `tint` holds linear light and alpha, and is read only if `is_tinted` is set.
// `face_textures` has the texture of each face, and is read only if `several` is set.
__kernel void records(__global const float *positions, __global const uint *indices, __global const uint *listed,
    int all, __global const uint *order, int ordered, COLOR_TYPE colors, int domain, __global float *triangles,
    __global float *corner_colors, uint count, uint slots TEXTURE_ARGUMENTS)
{
    size_t slot = get_global_id(0);
    if (slot >= slots)
        return;
    size_t i = slot < count ? slot : count - 1;
    if (ordered)
        i = order[i];
    size_t face = all ? i : listed[i];
    __global float *record = triangles + slot * WORDS;
    float corner[3][3];
    uint row[3];
    for (int k = 0; k < 3; k++) {
        size_t vertex = indices[3 * face + k];
        for (int axis = 0; axis < 3; axis++)
            corner[k][axis] = positions[3 * vertex + axis];
        row[k] = domain == 0 ? vertex : 3 * face + k;
    }
    for (int pass = 0; pass < 3; pass++) { // three exchanges suffice to sort three corners
        int k = pass & 1;
        if (before(corner[k + 1], corner[k])) {
            for (int axis = 0; axis < 3; axis++) {
                float moved = corner[k][axis];
                corner[k][axis] = corner[k + 1][axis];
                corner[k + 1][axis] = moved;
            }
            uint moved = row[k];
            row[k] = row[k + 1];
            row[k + 1] = moved;
        }
    }
    for (int k = 0; k < 3; k++)
        for (int axis = 0; axis < 3; axis++)
            record[3 * k + axis] = corner[slot < count ? k : 0][axis];
    for (int k = 0; k < 3; k++) {
#if COLORS == BYTES_OF_CORNERS
        __global const uchar *c = colors + (size_t)row[k] * CHANNELS;
        INTEGERS(record)[9 + k] = (int)c[0] | (int)c[1] << 8 | (int)c[2] << 16;
#elif COLORS == FLOATS_OF_FACE
        record[9 + k] = colors[face * CHANNELS + k];
#elif COLORS == TEXTURES
        for (int axis = 0; axis < 2; axis++) {
            int word = 2 * k + axis;
            record[word < 3 ? UV_WORD + word : FACE_WORD - 2 + word] = colors[2 * (size_t)row[k] + axis];
        }
        for (int channel = 0; is_tinted && channel < 4; channel++)
            corner_colors[slot * TINT_WORDS + 4 * k + channel] = tint[4 * (size_t)row[k] + channel];
#else
        for (int channel = 0; channel < 3; channel++)
            corner_colors[slot * 9 + 3 * k + channel] = colors[(size_t)row[k] * CHANNELS + channel];
#endif
    }
    INTEGERS(record)[FACE_WORD] = (int)face;
#if COLORS == TEXTURES
    if (several)
        numbers[slot] = face_textures[face];
#else
    INTEGERS(record)[LONG_WORD] = is_long(record);
    for (int k = LONG_WORD + 1; k < WORDS; k++)
        record[k] = 0.0f;
#endif
}

// Copy the records.
// Faces that are not selected get zero area, so that they cover no pixels.
__kernel void copy_selected_records(__global const float *triangles, __global const uchar *selected, __global float *copies,
    uint slots)
{
    size_t slot = get_global_id(0);
    if (slot >= slots)
        return;
    __global int *from = INTEGERS(triangles + slot * WORDS), *to = INTEGERS(copies + slot * WORDS);
    int is_selected = selected[from[FACE_WORD]];
    for (int k = 0; k < WORDS; k++)
        to[k] = from[k < 9 && !is_selected ? k % 3 : k];
}

// Centre and half extent of clusters of `size` triangles, in six rows of `stride` values.
__kernel void bound(__global const float *triangles, __global float *boxes, int size, int slots, int count, int stride)
{
    int cluster = get_global_id(0);
    if (cluster >= count)
        return;
    for (int axis = 0; axis < 3; axis++) {
        float low = INFINITY, high = -INFINITY;
        for (int slot = cluster * size; slot < slots && slot < (cluster + 1) * size; slot++)
            for (int k = 0; k < 3; k++) {
                float at = triangles[(size_t)slot * WORDS + 3 * k + axis];
                low = at < low ? at : low;
                high = at > high ? at : high;
            }
        // The numbers are halved first, because the sum of two large numbers may overflow.
        // The extent grows by the rounding error of the centre.
        float center = 0.5f * low + 0.5f * high;
        float reach = high - center > center - low ? high - center : center - low;
        boxes[axis * stride + cluster] = center;
        boxes[(3 + axis) * stride + cluster] = reach * 1.000001f;
    }
}
