// Triangle-Splatting: a triangle soup with a window that falls off from the incentre to the edges.
// Sources: trianglesplatting/diff-triangle-rasterization at 6d61f4c: cuda_rasterizer/forward.cu.

#include "splat_common.cl"
#include "splat_soup.cl"

#define MAX_ALPHA 0.99f
#define SIGMA (f->sigma)
#define BLENDS_CROSSING 0
#define SMALL_IS_DROPPED 1

// The array coverage has opacity, sigma, the phi with o phi^sigma = 0.01, and the rim.
// The rim is the value of phi below which alpha is less than 1/255.

#if ENGINE
#define LINES 12
#define SHAPE(REAL) REAL lines[LINES];
#else
// The value inverse is 1 / inradius.
#define SHAPE(REAL) REAL normal_x[3], normal_y[3], offset[3], inverse, depth;
#endif
#define FACE_MEMBERS(REAL, INT)                                                                              \
    {                                                                                                        \
        SHAPE(REAL)                                                                                          \
        REAL sigma, opacity, color[3], normal[3];                                                            \
        INT x0, y0, x1, y1, number;                                                                          \
    }
typedef struct BY_EIGHTS Face FACE_MEMBERS(float, int) Face;
typedef struct FACE_MEMBERS(real, mask) Faces;
#include "edge_window.cl"

mask project_faces(const size_t *rows, const Source *source, __constant View *view, Faces *f, Box *official,
                   real *depth)
{
    real coverage[COVERAGE];
    vec3 p[3];
    load_members(source->coverage, rows, COVERAGE, COVERAGE, coverage);
    corners_of(rows, source->positions, source->indices, p);
    color_later(p, f->color);
    f->opacity = coverage[0];
    f->sigma = coverage[1];
#if ENGINE
    real weight[3];
    mask back, kept = project_engine(view, p[0], p[1], p[2], true, f, official, depth, weight, &back);
    kept &= !(f->opacity < MIN_OPACITY);
#else
    Window w;
    mask kept = !(f->opacity < MIN_OPACITY) & project_window(view, p[0], p[1], p[2], &w);
    if (!ANY(kept))
        return kept;
    *depth = w.depth;
    *official = contour_tiles(view, &w, coverage[2]);
    // Like the official test, this test keeps a face whose corners were all skipped.
    kept &= (official->x1 != official->x0) & (official->y1 != official->y0);
    keep_window(view, &w, coverage[3], f);
    f->depth = w.depth;
#endif
    return kept;
}

void color_faces(const size_t *rows, const Source *source, __constant View *view, real *color)
{
    vec3 seen = {color[0], color[1], color[2]};
    // The official kernel was meant to use the centroid.
    // Because of an error in an expression, the kernel uses the centroid's z for x, y and z.
    // Models are trained with this error, so their coefficients need the same direction.
    if (view->own.broadcast_z)
        seen = (vec3){seen.z, seen.z, seen.z};
    color_of(view, source->f_dc, source->f_rest, rows, seen, color);
}

void shade(FACE_POINTER f, const Columns *c, float y, const Sample *s, real *rgb, real *z)
{
    rgb[0] = f->color[0];
    rgb[1] = f->color[1];
    rgb[2] = f->color[2];
#if ENGINE
    *z = s->z;
#else
    *z = f->depth;
#endif
}

#include "splat_stages.cl"
