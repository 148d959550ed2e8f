// MeshSplatting: an indexed mesh with colours and opacities at its vertices.
// Source: meshsplatting/diff-triangle-mesh-rasterization at b27f283: cuda_rasterizer/forward.cu.

#include "splat_common.cl"
#include "splat_window.cl"

#define MAX_ALPHA 0.999f
#define MARGIN 5.0f
#define BLENDS_CROSSING 0
#define VERTEX_COLORS 1

// opacity and falloff, which is the rim, are those of vertices; f_dc holds the vertices' colours.

// inverse is 1 / inradius; origin is corner 0, e1 and e2 the edges from it, area 1 / (e1 x e2). color and
// depth are those of corner 0, and what corners 1 and 2 have more.
#define FACE_MEMBERS(REAL, INT)                                                                              \
    {                                                                                                        \
        REAL normal_x[3], normal_y[3], offset[3];                                                            \
        REAL inverse, opacity;                                                                               \
        REAL origin[2], e1[2], e2[2], area;                                                                  \
        REAL color[9], depth[3], normal[3];                                                                  \
        INT x0, y0, x1, y1;                                                                                  \
    }
typedef struct Face FACE_MEMBERS(float, int) Face;
typedef struct FACE_MEMBERS(real, mask) Faces;

// The product of unsigned extents is 0 upstream for an empty box; it never is negative here.
Box corner_tiles(__constant View *view, const Window *w)
{
    Box found = {(mask)(int)view->columns, (mask)(int)view->rows, (mask)0, (mask)0};
    for (int k = 0; k < 3; k++) {
        vec2 q = w->corners[k];
        found.x0 = lesser_of(found.x0, tile_number((q.x - MARGIN) / TILE, view->columns));
        found.y0 = lesser_of(found.y0, tile_number((q.y - MARGIN) / TILE, view->rows));
        found.x1 = greater_of(found.x1, tile_after((q.x + MARGIN) / TILE, view->columns));
        found.y1 = greater_of(found.y1, tile_after((q.y + MARGIN) / TILE, view->rows));
    }
    return found;
}

mask project_faces(const size_t *rows, const Source *source, __constant View *view, Faces *f, Box *official,
                   real *depth)
{
    size_t first[LANES], second[LANES], third[LANES];
    for (uint k = 0; k < LANES; k++) {
        first[k] = source->indices[3 * rows[k]];
        second[k] = source->indices[3 * rows[k] + 1];
        third[k] = source->indices[3 * rows[k] + 2];
    }
    real opacity = lesser(lesser(load(source->opacity, first, 1, 0), load(source->opacity, second, 1, 0)),
                       load(source->opacity, third, 1, 0));
    vec3 a = load3(source->positions, first, 3, 0), b = load3(source->positions, second, 3, 0);
    vec3 c = load3(source->positions, third, 3, 0);
    Window w;
    mask kept = !(opacity < MIN_OPACITY) & project_window(view, a, b, c, &w);
    if (!ANY(kept))
        return kept;
    *depth = w.depth;
    *official = corner_tiles(view, &w);
    kept &= (official->x1 != official->x0) & (official->y1 != official->y0);
    for (int k = 0; k < 3; k++) {
        f->normal_x[k] = w.edge_normal[k].x;
        f->normal_y[k] = w.edge_normal[k].y;
        f->offset[k] = w.edge_offset[k];
    }
    f->inverse = 1.0f / w.inradius[2];
    f->opacity = opacity;
    vec2 e1 = sub2(w.corners[1], w.corners[0]), e2 = sub2(w.corners[2], w.corners[0]);
    f->origin[0] = w.corners[0].x;
    f->origin[1] = w.corners[0].y;
    f->e1[0] = e1.x;
    f->e1[1] = e1.y;
    f->e2[0] = e2.x;
    f->e2[1] = e2.y;
    f->area = 1.0f / cross2(e1, e2);
    __constant float *z = view->world_to_camera + 8;
    f->depth[0] = affine(z, a);
    f->depth[1] = affine(z, b) - f->depth[0];
    f->depth[2] = affine(z, c) - f->depth[0];
    f->normal[0] = w.normal.x;
    f->normal[1] = w.normal.y;
    f->normal[2] = w.normal.z;
    // The rim grows as opacity falls: that of the least opacity is the largest.
    real rim = greater(greater(load(source->falloff, first, 1, 0), load(source->falloff, second, 1, 0)),
                   load(source->falloff, third, 1, 0));
    Box box = window_box(view, &w, rim);
    f->x0 = box.x0;
    f->y0 = box.y0;
    f->x1 = box.x1;
    f->y1 = box.y1;
    return kept;
}

void color_face(size_t i, const Source *source, __constant View *view, __global Face *face)
{
    uint3 corner = vload3(i, source->indices);
    float3 first = vload3(corner.x, source->f_dc);
    vstore3(first, 0, face->color);
    vstore3(vload3(corner.y, source->f_dc) - first, 1, face->color);
    vstore3(vload3(corner.z, source->f_dc) - first, 2, face->color);
}

typedef struct {
    EdgeColumns edges;
    real x;
} Columns;
typedef struct {
    real nearest, alpha;
} Sample;

Columns columns_of(FACE_POINTER f, real x, __constant View *view)
{
    Columns c;
    for (int k = 0; k < 3; k++)
        c.edges.edge[k] = f->normal_x[k] * x;
    c.x = x - f->origin[0];
    return c;
}

#if LANES == 8
mask reaches(FACE_POINTER f, float left, real y)
{
    return window_reaches(f->normal_x, f->normal_y, f->offset, left, y);
}
#endif

mask inside(FACE_POINTER f, const Columns *c, float y, __constant View *view, Sample *s)
{
    s->nearest = nearest_edge(f->normal_y, f->offset, &c->edges, y);
    return s->nearest <= 0.0f;
}

mask cover(FACE_POINTER f, __constant View *view, mask within, Sample *s)
{
    s->alpha = lesser((real)MAX_ALPHA, f->opacity * window_power(s->nearest * f->inverse, view->sigma));
    return within & (s->alpha >= MIN_ALPHA);
}

// Colours are interpolated linearly on the screen, not perspective-correctly.
void shade(FACE_POINTER f, const Columns *c, float y, const Sample *s, real *rgb, real *z)
{
    float dy = y - f->origin[1];
    real b1 = (c->x * f->e2[1] - f->e2[0] * dy) * f->area;
    real b2 = (f->e1[0] * dy - c->x * f->e1[1]) * f->area;
    for (int k = 0; k < 3; k++)
        rgb[k] = MAD(b2, (real)f->color[6 + k], MAD(b1, (real)f->color[3 + k], (real)f->color[k]));
    *z = MAD(b2, (real)f->depth[2], MAD(b1, (real)f->depth[1], (real)f->depth[0]));
}

float3 normal_of(FACE_POINTER f) { return vload3(0, f->normal); }

#include "splat_stages.cl"
