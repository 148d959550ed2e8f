// The stages every splatting method goes through, included at the end of a method's file, which defines
//
//   FACE_MEMBERS(REAL, INT)             what blending needs of a face, members of four bytes; among them
//                                       INT number, and INT x0, y0, x1, y1, the samples it can reach (see
//                                       Box)
//   Face, Faces                         structs of them, of one face (BY_EIGHTS) and of LANES faces
//   corners_of                          corners of LANES faces
//   project_faces                       culling, projection, official tiles and reach of LANES faces
//   COLORS, color_faces                 their colours, so many values each; in their place is what
//                                       project_faces left there, but where VERTEX_COLORS
//   prefetch_face, prefetch_colors      CPU style: fetch what project_faces, color_faces will read
//   Columns, columns_of                 what of a face its samples in one column share
//   reaches                             CPU style: which pairs of rows of eight columns it can reach
//   inside, cover                       where a face may be seen in a row; where alpha is 1/255 or
//                                       more, and alpha
//   Sample, shade, normal_of            what they pass on, colour and depth, normal
//   BLENDS_CROSSING                     1: the face that takes T to the threshold is blended (2DTS);
//                                       0: it is refused
//   VERTEX_COLORS                       1: colours are evaluated at vertices first
//   CORNERS_MAY_BE_BEHIND               1: a face with a corner behind the camera may be kept
//   SMALL_IS_DROPPED                    1: a face with an inradius below one sample never is
//
// The host says how wide rows of `coverage` are, COVERAGE: activated opacity first, then what opacity and
// falloff decide whatever the view (msb/render/splat/model.py).

// Tiles a primitive is listed in: low inclusive, high exclusive.
typedef ushort4 Tiles;

typedef char face_has_the_size_the_host_allocates[sizeof(Face) == 4 * FACE_WORDS ? 1 : -1];

// Through mere pointers to words a compiler need not see what was written as numbers. A GPU moves them as
// integers, which arrive whatever it does with subnormal floats.
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
#define VERTICES_AHEAD 32 // whose coefficients are on their way

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

// Returns which faces are listed, and in which tiles, if any is; kept are those that the official culling keeps.
mask project_seen(const size_t *rows, const Source *source, __constant View *view, Faces *f, Box *t,
                  real *depth, mask *kept)
{
    Box official;
    *kept = project_faces(rows, source, view, f, &official, depth);
    if (!ANY(*kept)) // then neither tiles nor reach need have been set
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

// With SHARES, blending makes no pixels, but sums what each entry of the tile lists adds to them. It then reads
// the planes that `spread` makes of a picture (splat_resolve.cl), and of entry e sums[4 e .. 4 e + 3] are red,
// green and blue of that picture, each weighted by alpha T, and the weight alone. The host clears the sums.
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
