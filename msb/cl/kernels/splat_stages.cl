// The stages of every splatting method, included at the end of the file of a method, which defines
//
//   FACE_MEMBERS(REAL, INT)             values of a face for blending, members of four bytes; among them
//                                       INT number, and INT x0, y0, x1, y1, the samples it can reach (see Box)
//   Face, Faces                         structs of them, for one face (BY_EIGHTS) and for LANES faces
//   corners_of                          corners of LANES faces
//   project_faces                       culling, projection, official tiles and reach of LANES faces
//   COLORS, color_faces                 number of colour values, and the colours; unless VERTEX_COLORS, they
//                                       replace values that project_faces stored there
//   prefetch_face, prefetch_colors      CPU style: fetch the input of project_faces and color_faces
//   Columns, columns_of                 values of a face that are shared by the samples of a column
//   reaches                             CPU style: which pairs of rows of eight columns it can reach
//   inside, cover                       where a face may be visible in a row; where alpha is 1/255 or more,
//                                       and alpha
//   Sample, shade, normal_of            values passed between them; colour and depth; normal
//   BLENDS_CROSSING                     1: the face that brings T to the threshold is blended (2DTS);
//                                       0: it is rejected
//   VERTEX_COLORS                       1: colours are evaluated at vertices first
//   CORNERS_MAY_BE_BEHIND               1: a face with a corner behind the camera may be kept
//   SMALL_IS_DROPPED                    1: a face with an inradius below one sample is never kept
//
// The host defines COVERAGE, the width of a row of `coverage`.
// A row begins with the activated opacity.
// The other values follow from opacity and falloff in any view (msb/render/splat/model.py).

// The tiles that list a primitive; low ends are inclusive, high ends exclusive.
typedef ushort4 Tiles;

typedef char face_has_the_size_the_host_allocates[sizeof(Face) == 4 * FACE_WORDS ? 1 : -1];

// The union is needed because a compiler may miss numbers that are read through pointers to words. A GPU
// moves words as integers, because integers are exact even if the GPU flushes subnormal floats.
#if LANES == 8
typedef real word;
#else
typedef uint word;
#endif
typedef union {
    Faces faces;
    word words[FACE_WORDS];
} FaceLanes;

#include "splat_bounds.cl"

#if VERTEX_COLORS
#define VERTICES_AHEAD 32 // vertices to prefetch

__kernel void shade_vertices(__constant View *view, __global const float *positions,
                             __global const float *f_dc, __global const float *f_rest,
                             __global float *colors, uint vertices)
{
    size_t first = get_global_id(0) * LANES;
    if (first >= vertices)
        return;
    size_t rows[LANES];
    consecutive(first, vertices, rows);
#if LANES == 8
    for (uint k = 0; k < LANES; k++)
        if (first + k + VERTICES_AHEAD < vertices)
            prefetch_row(f_rest, first + k + VERTICES_AHEAD, view->rest_stride);
#endif
    real color[3];
    color_of(view, f_dc, f_rest, rows, load3(positions, rows), color);
    for (uint k = 0; k < LANES; k++)
        for (uint c = 0; c < 3; c++)
            colors[3 * rows[k] + c] = ((const float *)&color[c])[k];
}
#endif

// Returns which faces are listed, and their tiles if at least one face is listed.
// `kept` marks faces that official culling keeps.
mask project_seen(const size_t *rows, const Source *source, __constant View *view, Faces *f, Box *t,
                  real *depth, mask *kept)
{
    Box official;
    *kept = project_faces(rows, source, view, f, &official, depth);
    if (!ANY(*kept)) // without a kept face, tiles and reach may be undefined
        return (mask)0;
    mask seen = *kept;
    *t = official;
    if (view->tile_rule != TILES_OFFICIAL) {
        seen &= (f->x1 >= f->x0) & (f->y1 >= f->y0);
        *t = (Box){f->x0 >> 4, f->y0 >> 4, (f->x1 >> 4) + 1, (f->y1 >> 4) + 1};
    }
    if (view->tile_rule == TILES_BOTH) {
        t->x0 = greater_of(t->x0, official.x0);
        t->y0 = greater_of(t->y0, official.y0);
        t->x1 = lesser_of(t->x1, official.x1);
        t->y1 = lesser_of(t->y1, official.y1);
    }
    return seen & (t->x1 > t->x0) & (t->y1 > t->y0);
}

// With SHARES, blending writes no pixels, but sums the contribution of each entry of the tile lists.
// Blending reads the planes that `spread` makes from an image (splat_resolve.cl).
// List entry e has four sums from sums[4 e] on.
// The sums are the red, green and blue of the image, each weighted by alpha T, and the sum of the weights.
// The host sets the sums to zero before the launch.
#if SHARES
#define BLEND share
#define SUMS , __global float *sums
#else
#define BLEND blend
#define SUMS
#endif

#include "splat_ties.cl"
#if LANES == 8
#include "splat_project_cpu.cl"
#include "splat_blend_cpu.cl"
#else
#include "splat_project_gpu.cl"
#include "splat_blend_gpu.cl"
#endif
