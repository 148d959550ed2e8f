// The stages every splatting method goes through, included at the end of a method's file, which defines
//
//   FACE_MEMBERS(REAL, INT)             what blending needs of a face, members of four bytes; among them
//                                       INT x0, y0, x1, y1, the samples it can reach (see Box)
//   Face, Faces                         structs of them, of one face and of LANES faces
//   project_faces                       culling, projection, official tiles and reach of LANES faces
//   color_face                          the colour of one of them, for those that are listed
//   Columns, columns_of                 what of a face its samples in one column share
//   reaches                             CPU style: which pairs of rows of eight columns it can reach
//   inside, cover                       where a face may be seen in a row; where alpha is 1/255 or
//                                       more, and alpha
//   Sample, shade, normal_of            what they pass on, colour and depth, normal
//   BLENDS_CROSSING                     1: the face that takes T to the threshold is blended (2DTS);
//                                       0: it is refused
//   VERTEX_COLORS                       1: colours are evaluated at vertices first
//
// `falloff` holds what opacity and falloff decide whatever the view (msb/render/splat_methods.py).

// Tiles a primitive is listed in: low inclusive, high exclusive.
typedef ushort4 Tiles;

typedef char face_has_the_size_the_host_allocates[sizeof(Face) == 4 * FACE_WORDS ? 1 : -1];

#if VERTEX_COLORS
__kernel void shade_vertices(__constant View *view, __global const float *positions,
                             __global const float *f_dc, __global const float *f_rest,
                             __global float *colors, uint vertices)
{
    size_t i = get_global_id(0);
    if (i < vertices)
        vstore3(color_of(view, f_dc, f_rest, i, vload3(i, positions)), i, colors);
}
#endif

#if LANES == 8
#define LANE(vector, k) (((const int *)&(vector))[k])
#else
#define LANE(vector, k) (vector)
#endif

// visible: kept by the official culling. listed: reaches a sample of one of its tiles. One work-item takes
// LANES consecutive faces.
__kernel void project(__constant View *view, __global const float *positions, __global const uint *indices,
                      __global const float *opacity, __global const float *falloff,
                      __global const float *f_dc, __global const float *f_rest,
                      __global Face *faces, __global uint *keys, __global Tiles *tiles, __global uint *listed,
                      __global uint *tile_counts, __global uchar *visible, uint count)
{
    size_t first = get_global_id(0) * LANES;
    if (first >= count)
        return;
    Source source = {positions, indices, opacity, falloff, f_dc, f_rest};
    size_t rows[LANES];
    for (uint k = 0; k < LANES; k++)
        rows[k] = min(first + k, (size_t)count - 1);
    Faces f;
    real depth;
    Box official;
    mask kept = project_faces(rows, &source, view, &f, &official, &depth);
    Box t = {f.x0 >> 4, f.y0 >> 4, (f.x1 >> 4) + 1, (f.y1 >> 4) + 1};
    if (view->tile_rule) {
        t.x0 = greater_of(t.x0, official.x0);
        t.y0 = greater_of(t.y0, official.y0);
        t.x1 = lesser_of(t.x1, official.x1);
        t.y1 = lesser_of(t.y1, official.y1);
    }
    mask seen = kept & (f.x1 >= f.x0) & (f.y1 >= f.y0) & (t.x1 > t.x0) & (t.y1 > t.y0);
    mask many = seen ? (t.x1 - t.x0) * (t.y1 - t.y0) : (mask)0;
    uint here = (uint)min((size_t)LANES, count - first);
    for (uint k = 0; k < here; k++) {
        size_t i = first + k;
        visible[i] = LANE(kept, k) != 0;
        uint n = LANE(many, k);
        listed[i] = n > 0;
        tile_counts[i] = n;
        if (n == 0)
            continue;
        tiles[i] = (Tiles)(LANE(t.x0, k), LANE(t.y0, k), LANE(t.x1, k), LANE(t.y1, k));
        keys[i] = as_uint(((const float *)&depth)[k]);
        __global uint *words = (__global uint *)(faces + i);
        for (uint w = 0; w < FACE_WORDS; w++)
            words[w] = ((const uint *)&f)[w * LANES + k];
        color_face(i, &source, view, faces + i);
    }
}

#if LANES == 8
#include "splat_blend_cpu.cl"
#else
#include "splat_blend_gpu.cl"
#endif
