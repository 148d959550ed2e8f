// MeshSplatting: an indexed mesh with colours and opacities at its vertices.
// With PLUS: Triangle Splatting+. Sources: meshsplatting/diff-triangle-mesh-rasterization at b27f283,
// trianglesplatting2/diff-triangle2-rasterization at 42e62aa (PLUS): cuda_rasterizer/forward.cu.

#include "splat_common.cl"
#include "splat_color.cl"

#if PLUS
#define MAX_ALPHA 0.99f
#else
#define MAX_ALPHA 0.999f
#endif
#define SIGMA (view->own.sigma)
#define MARGIN 5.0f
#define BLENDS_CROSSING 0
#define VERTEX_COLORS 1
#define COLORS 9
#define SMALL_IS_DROPPED 0 // even if two corners coincide on the screen

// For each vertex, the array coverage has the opacity and the rim.
// The rim is the value of phi below which alpha is less than 1/255. With PLUS, coverage also has the phi with
// o phi^sigma = 0.01. f_dc contains the evaluated colours of the vertices.

#if ENGINE
#define LINES 12
// inverse_weight belongs to the barycentric coordinates 1 and 2.
#define SHAPE(REAL) REAL lines[LINES], inverse_weight[2], opacity;
#else
// inverse is 1 / inradius.
// origin is corner 0, e1 and e2 are the edges from corner 0, and area is 1 / (e1 x e2).
// depth has the depth of corner 0, and the depth differences of corners 1 and 2.
#define SHAPE(REAL)                                                                                          \
    REAL normal_x[3], normal_y[3], offset[3], inverse, opacity;                                              \
    REAL origin[2], e1[2], e2[2], area, depth[3];
#endif
// color has the colour of corner 0, and the colour differences of corners 1 and 2.
#define FACE_MEMBERS(REAL, INT)                                                                              \
    {                                                                                                        \
        SHAPE(REAL)                                                                                          \
        REAL color[9], normal[3];                                                                            \
        INT x0, y0, x1, y1, number;                                                                          \
    }
typedef struct BY_EIGHTS Face FACE_MEMBERS(float, int) Face;
typedef struct FACE_MEMBERS(real, mask) Faces;
#include "edge_window.cl"

// The official code computes an unsigned product of the extents, which is 0 for an empty box. The product in
// this file is never negative.
Box corner_tiles(__constant View *view, const Window *w)
{
    Box box = {(mask)(int)view->columns, (mask)(int)view->rows, (mask)0, (mask)0};
    for (int k = 0; k < 3; k++) {
        vec2 q = w->corners[k];
        box.x0 = lesser_of(box.x0, tile_number((q.x - MARGIN) / TILE, view->columns));
        box.y0 = lesser_of(box.y0, tile_number((q.y - MARGIN) / TILE, view->rows));
        box.x1 = greater_of(box.x1, tile_after((q.x + MARGIN) / TILE, view->columns));
        box.y1 = greater_of(box.y1, tile_after((q.y + MARGIN) / TILE, view->rows));
    }
    return box;
}

typedef struct {
    size_t rows[3][LANES];
} Vertices;

Vertices vertices_of(const size_t *rows, __global const uint *indices)
{
    Vertices v;
    for (uint k = 0; k < LANES; k++)
        for (int corner = 0; corner < 3; corner++)
            v.rows[corner][k] = indices[3 * rows[k] + corner];
    return v;
}

#if LANES == 8
void prefetch_face(size_t row, const Source *source) {}
void prefetch_colors(size_t row, const Source *source, __constant View *view) {}
#endif

void corners_of(const size_t *rows, __global const float *positions, __global const uint *indices,
                vec3 *corners)
{
    Vertices v = vertices_of(rows, indices);
    for (int k = 0; k < 3; k++)
        corners[k] = load3(positions, v.rows[k]);
}

mask project_faces(const size_t *rows, const Source *source, __constant View *view, Faces *f, Box *official,
                   real *depth)
{
    Vertices v = vertices_of(rows, source->indices);
    real opacity = load(source->coverage, v.rows[0], COVERAGE, 0);
    real rim = load(source->coverage, v.rows[0], COVERAGE, 1);
    for (int k = 1; k < 3; k++) {
        opacity = lesser(opacity, load(source->coverage, v.rows[k], COVERAGE, 0));
        // The rim grows as opacity falls, so the vertex with the least opacity has the largest rim.
        rim = greater(rim, load(source->coverage, v.rows[k], COVERAGE, 1));
    }
    vec3 p[3];
    corners_of(rows, source->positions, source->indices, p);
    f->opacity = opacity;
#if ENGINE
    real weight[3];
    mask back, kept = project_engine(view, p[0], p[1], p[2], true, f, official, depth, weight, &back);
    kept &= !(opacity < MIN_OPACITY);
    f->inverse_weight[0] = 1.0f / weight[1];
    f->inverse_weight[1] = 1.0f / weight[2];
#else
    Window w;
    mask kept = !(opacity < MIN_OPACITY) & project_window(view, p[0], p[1], p[2], &w);
    if (!ANY(kept))
        return kept;
    *depth = w.depth;
#if PLUS
    real shrunk = load(source->coverage, v.rows[0], COVERAGE, 2); // like the rim
    for (int k = 1; k < 3; k++)
        shrunk = greater(shrunk, load(source->coverage, v.rows[k], COVERAGE, 2));
    *official = contour_tiles(view, &w, shrunk);
#else
    *official = corner_tiles(view, &w);
#endif
    kept &= (official->x1 != official->x0) & (official->y1 != official->y0);
    keep_window(view, &w, rim, f);
    vec2 e1 = sub2(w.corners[1], w.corners[0]), e2 = sub2(w.corners[2], w.corners[0]);
    f->origin[0] = w.corners[0].x;
    f->origin[1] = w.corners[0].y;
    f->e1[0] = e1.x;
    f->e1[1] = e1.y;
    f->e2[0] = e2.x;
    f->e2[1] = e2.y;
    f->area = 1.0f / cross2(e1, e2);
    __constant float *z = view->world_to_camera + 8;
    f->depth[0] = affine(z, p[0]);
    f->depth[1] = affine(z, p[1]) - f->depth[0];
    f->depth[2] = affine(z, p[2]) - f->depth[0];
#if PLUS
    f->depth[0] = w.depth;
    f->depth[1] = f->depth[2] = (real)0.0f;
#endif
#endif
    return kept;
}

void color_faces(const size_t *rows, const Source *source, __constant View *view, real *color)
{
    Vertices v = vertices_of(rows, source->indices);
    vec3 first = load3(source->f_dc, v.rows[0]);
    for (int k = 0; k < 3; k++) {
        vec3 here = k ? sub3(load3(source->f_dc, v.rows[k]), first) : first;
        color[3 * k] = here.x;
        color[3 * k + 1] = here.y;
        color[3 * k + 2] = here.z;
    }
}

// The official kernel interpolates colours linearly on the screen, without perspective correction.
void shade(FACE_POINTER f, const Columns *c, float y, const Sample *s, real *rgb, real *z)
{
#if ENGINE
    real b1 = s->e1 * s->z * f->inverse_weight[0], b2 = s->e2 * s->z * f->inverse_weight[1];
    *z = s->z;
#else
    float dy = y - f->origin[1];
    real b1 = (c->x * f->e2[1] - f->e2[0] * dy) * f->area;
    real b2 = (f->e1[0] * dy - c->x * f->e1[1]) * f->area;
    *z = MAD(b2, (real)f->depth[2], MAD(b1, (real)f->depth[1], (real)f->depth[0]));
#endif
    for (int k = 0; k < 3; k++)
        rgb[k] = MAD(b2, (real)f->color[6 + k], MAD(b1, (real)f->color[3 + k], (real)f->color[k]));
}

#include "splat_stages.cl"
