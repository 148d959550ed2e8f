// Falloff of Triangle-Splatting and MeshSplatting, from projected triangles with incentre and edge distances.
// The kernel file of a method includes this file after its face structs.
// The including file defines the maximum alpha MAX_ALPHA, and SIGMA, the exponent of the falloff of face `f`.
// Sources: trianglesplatting/diff-triangle-rasterization at 6d61f4c: cuda_rasterizer/forward.cu, auxiliary.h;
// meshsplatting/diff-triangle-mesh-rasterization at b27f283 (the same lines).

#if ENGINE
#include "splat_engine.cl"
#define PHI(f, s) ((s)->phi)
#else
#define PHI(f, s) ((s)->nearest * (f)->inverse)
#endif

#define NEAREST 0.2f
#define GRAZING 0.001f
#define MIN_LENGTH 1e-4f
#define MIN_OPACITY 0.01f
#define MAX_RADIUS 1600.0f
#define MIN_DETERMINANT 1e-3f
#define CORNERS_MAY_BE_BEHIND 1

typedef struct {
    real depth;          // camera z of the centroid
    vec3 normal;         // unit normal in camera space, towards the camera; shorter for tiny faces
    vec2 corners[3];     // samples
    vec2 edge_normal[3]; // outwards
    real edge_offset[3];
    real inradius[3];    // negative
    vec2 incentre;
} Window;

vec2 window_sample(__constant View *view, vec3 p)
{
    __constant float *m = view->full;
    real inverse = 1.0f / (affine(m + 12, p) + 1e-7f);
    return (vec2){to_sample(affine(m, p) * inverse, view->width) + view->shift[0],
                  to_sample(affine(m + 4, p) * inverse, view->height) + view->shift[1]};
}

// Returns which triangles pass all tests; opacity and tiles are tested later.
// Nothing is clipped.
// As in the official code, the division mirrors a corner behind the camera.
mask project_window(__constant View *view, vec3 a, vec3 b, vec3 c, Window *w)
{
    vec3 center = center_of(a, b, c), camera = to_camera(view, center);
    w->depth = camera.z;
    mask dropped = camera.z <= NEAREST;
    vec3 normal = rotate_to_camera(view, cross3(sub3(b, a), sub3(c, a)));
    normal = div3(normal, greater((real)MIN_LENGTH, length3(normal)));
    real cosine = dot3(normal, div3(camera, greater((real)MIN_LENGTH, length3(camera))));
    w->normal = mul3(normal, cosine > 0.0f ? (real)-1.0f : (real)1.0f);
    dropped |= magnitude(cosine) < GRAZING;

    vec2 middle = window_sample(view, center);
    w->corners[0] = window_sample(view, a);
    w->corners[1] = window_sample(view, b);
    w->corners[2] = window_sample(view, c);
    real radius = (real)0.0f;
    for (int k = 0; k < 3; k++) {
        real far = length2(sub2(w->corners[k], middle));
        radius = far > radius ? far : radius;
    }

    vec2 p = w->corners[0], q = w->corners[1], r = w->corners[2];
    // Small triangles always fail the inradius test below, because the inradius is at most half the radius.
    // The shortcut is not applied to triangles with coincident corners, because their inradius is NaN. Most
    // triangles of a captured scene are small enough for the shortcut.
    mask tiny = (radius < 1.9f) & ((p.x != q.x) | (p.y != q.y)) & ((q.x != r.x) | (q.y != r.y)) &
                ((p.x != r.x) | (p.y != r.y));
    dropped |= (radius > MAX_RADIUS) | (radius < 1.0f) | tiny;
    if (!ANY(!dropped))
        return (mask)0;

    real to_p = length2(sub2(q, r)), to_q = length2(sub2(p, r)), to_r = length2(sub2(p, q));
    vec2 weighted = add2(add2(mul2(p, to_p), mul2(q, to_q)), mul2(r, to_r));
    real total = to_p + to_q + to_r;
    w->incentre = (vec2){weighted.x / total, weighted.y / total};
    for (int k = 0; k < 3; k++) {
        vec2 from = w->corners[k], to = w->corners[k == 2 ? 0 : k + 1];
        vec2 n = {to.y - from.y, -(to.x - from.x)};
        n = mul2(n, 1.0f / length2(n));
        real t = -dot2(n, from);
        real distance = dot2(n, w->incentre) + t;
        real outward = distance > 0.0f ? (real)-1.0f : (real)1.0f;
        w->edge_normal[k] = mul2(n, outward);
        w->edge_offset[k] = t * outward;
        w->inradius[k] = distance * outward;
    }
    // The comparison keeps a face if one of its values is NaN.
    return !(dropped | (w->inradius[2] > -1.0f));
}

// Samples with alpha of at least 1/255 lie in the triangle shrunk around its incentre until phi = `rim`.
// The shrunk triangle is empty if `rim` is above 1.
// The slack covers rounding errors of edges, which a sharp corner magnifies.
Box window_box(__constant View *view, const Window *w, real rim)
{
    vec2 p = w->corners[0], q = w->corners[1], r = w->corners[2], m = w->incentre;
    vec2 low = {lesser(lesser(p.x, q.x), r.x), lesser(lesser(p.y, q.y), r.y)};
    vec2 high = {greater(greater(p.x, q.x), r.x), greater(greater(p.y, q.y), r.y)};
    real far = greater(greater(magnitude(low.x), magnitude(low.y)),
                       greater(magnitude(high.x), magnitude(high.y)));
    real longest = greater(high.x - low.x, high.y - low.y);
    real slack = 0.01f + 1e-6f * far * (1.0f + longest / -w->inradius[2]);
    low = (vec2){low.x + (m.x - low.x) * rim - slack, low.y + (m.y - low.y) * rim - slack};
    high = (vec2){high.x + (m.x - high.x) * rim + slack, high.y + (m.y - high.y) * rim + slack};
    Box box = box_of(low, high, view);
    box.x1 = rim > 1.0f ? (mask)-1 : box.x1;
    return box;
}

// Find the tiles of the contour o phi^sigma = 0.01.
// Move each edge inwards, then intersect neighbouring edges.
// Beyond this contour, alpha falls to 1/255 at the rim.
// The rim is visible only in tiles that the contour touches.
Box contour_tiles(__constant View *view, const Window *w, real shrunk)
{
    real offset[3], distance = (real)0.0f;
    for (int k = 0; k < 3; k++) {
        // All three edges use the distance of the first edge, unless that distance underflowed to 0.
        distance = distance == 0.0f ? w->inradius[k] * shrunk : distance;
        offset[k] = w->edge_offset[k] / length2(w->edge_normal[k]) - distance;
    }
    Box box = {(mask)(int)view->columns, (mask)(int)view->rows, (mask)0, (mask)0};
    for (int pair = 0; pair < 3; pair++) {
        int current = pair == 2 ? 0 : pair + 1, previous = pair;
        vec2 n = w->edge_normal[current], m = w->edge_normal[previous];
        real t = offset[current], s = offset[previous];
        real determinant = cross2(n, m);
        // The official code inverts the test of the last pair of edges, so a NaN skips only this
        // intersection.
        mask use = magnitude(determinant) >= MIN_DETERMINANT;
        if (pair < 2)
            use = !(magnitude(determinant) < MIN_DETERMINANT);
        real x = -(t * m.y - s * n.y) / determinant;
        real y = -(s * n.x - t * m.x) / determinant;
        mask x0 = tile_number(x / TILE, view->columns), y0 = tile_number(y / TILE, view->rows);
        mask x1 = tile_number((x + TILE - 1) / TILE, view->columns);
        mask y1 = tile_number((y + TILE - 1) / TILE, view->rows);
        box.x0 = use ? lesser_of(box.x0, x0) : box.x0;
        box.y0 = use ? lesser_of(box.y0, y0) : box.y0;
        box.x1 = use ? greater_of(box.x1, x1) : box.x1;
        box.y1 = use ? greater_of(box.y1, y1) : box.y1;
    }
    return box;
}

#if !ENGINE
// Stores the values for blending in `f`. Samples with phi up to `rim` have an alpha of at least 1/255.
void keep_window(__constant View *view, const Window *w, real rim, Faces *f)
{
    for (int k = 0; k < 3; k++) {
        f->normal_x[k] = w->edge_normal[k].x;
        f->normal_y[k] = w->edge_normal[k].y;
        f->offset[k] = w->edge_offset[k];
    }
    f->inverse = 1.0f / w->inradius[2];
    f->normal[0] = w->normal.x;
    f->normal[1] = w->normal.y;
    f->normal[2] = w->normal.z;
    Box box = window_box(view, w, rim);
    f->x0 = box.x0;
    f->y0 = box.y0;
    f->x1 = box.x1;
    f->y1 = box.y1;
}

// ---- at the samples of a row

typedef struct {
    real edge[3]; // n.x x, the part of an edge distance that is constant along a column
#if VERTEX_COLORS
    real x; // from corner 0
#endif
} Columns;
typedef struct {
    real nearest, alpha;
} Sample;

Columns columns_of(FACE_POINTER f, real x, __constant View *view)
{
    Columns c;
    for (int k = 0; k < 3; k++)
        c.edge[k] = f->normal_x[k] * x;
#if VERTEX_COLORS
    c.x = x - f->origin[0];
#endif
    return c;
}

// Sets the largest of the three distances n.x x + n.y y + t, which is positive outside.
// The terms are added in this order, as in the official code.
mask inside(FACE_POINTER f, const Columns *c, float y, __constant View *view, Sample *s)
{
    real e0 = (c->edge[0] + f->normal_y[0] * y) + f->offset[0];
    real e1 = (c->edge[1] + f->normal_y[1] * y) + f->offset[1];
    real e2 = (c->edge[2] + f->normal_y[2] * y) + f->offset[2];
    s->nearest = greater(greater(e0, e1), e2);
    return s->nearest <= 0.0f;
}

#if LANES == 8
// Returns a mask of the row pairs y, y + 1 (one pair per lane) with samples.
// Only the eight columns from `left` on are tested.
// A pair contains samples if no edge has a positive distance at the innermost corner, allowing for rounding.
mask reaches(FACE_POINTER f, float left, real y)
{
    mask reached = (mask)-1;
    for (int k = 0; k < 3; k++) {
        float inwards = (f->normal_x[k] < 0.0f ? 7.0f * f->normal_x[k] : 0.0f) +
                        (f->normal_y[k] < 0.0f ? f->normal_y[k] : 0.0f);
        float slack = 0.01f + 1e-6f * (f->offset[k] < 0.0f ? -f->offset[k] : f->offset[k]);
        float start = f->normal_x[k] * left + f->offset[k] + inwards - slack;
        reached &= MAD((real)f->normal_y[k], y, (real)start) <= 0.0f;
    }
    return reached;
}
#endif
#endif

// phi^sigma is computed as exp2(sigma log2 phi), and is 0 for phi = 0.
// The clamp keeps exp2 in its valid range.
// Arguments below the range give an alpha under 1/255.
real window_power(real phi, float sigma)
{
    real value = exp2_fast(greater(sigma * log2_fast(greater(phi, (real)1e-30f)), (real)-100.0f));
    return phi > (real)1e-30f ? value : (real)0.0f;
}

mask cover(FACE_POINTER f, __constant View *view, mask within, Sample *s)
{
    s->alpha = lesser((real)MAX_ALPHA, f->opacity * window_power(PHI(f, s), SIGMA));
    return within & (s->alpha >= MIN_ALPHA);
}

float3 normal_of(FACE_POINTER f) { return vload3(0, f->normal); }
