// 2DGS: Gaussian discs that are intersected with the ray of each sample.
// Sources: hbb1/diff-surfel-rasterization at e0ed020: cuda_rasterizer/forward.cu, auxiliary.h; with GSPLAT
// the rules of nerfstudio-project/gsplat at 90d7b4b.

#include "splat_common.cl"
#include "splat_color.cl"

#define VERTEX_COLORS 0
#define COLORS 3
#define BLENDS_CROSSING 0
#define CORNERS_MAY_BE_BEHIND 1
#define SMALL_IS_DROPPED 0
#define MAX_ALPHA 0.99f
#if GSPLAT
#define NEAREST 0.01f
#define CUTOFF 1.0f
#else
#define NEAREST 0.2f
#define CUTOFF 3.0f
#endif
#define FILTER 0.707106f
#define LEAST 1e-4f
#define LOG2E 1.4426950408889634f

// A row of `positions` has the mean, and both axes times their standard deviations.
// coverage has opacity and normal.
// The point d = (u, v, 1) of a disc, in standard deviations, is at the sample (p . d / r . d, q . d / r . d).
// The depth of the point is r . d.
// Alpha is below 1/255 if u^2 + v^2 is above `limit`.
#define FACE_MEMBERS(REAL, INT)                                                                              \
    {                                                                                                        \
        REAL p[3], q[3], r[3], x, y, opacity, limit, normal[3], color[3];                                    \
        INT x0, y0, x1, y1, number;                                                                          \
    }
typedef struct BY_EIGHTS Face FACE_MEMBERS(float, int) Face;
typedef struct FACE_MEMBERS(real, mask) Faces;

// Returns three points around the mean, at 3.4 standard deviations or more. splat_bounds.cl computes a sphere
// from the three points.
void corners_of(const size_t *rows, __global const float *positions, __global const uint *indices,
                vec3 *corners)
{
    real v[9];
    load_members(positions, rows, 9, 9, v);
    vec3 a = {v[3], v[4], v[5]}, b = {v[6], v[7], v[8]};
    real reach = 3.4f * root(greater(dot3(a, a), dot3(b, b)));
    corners[0] = (vec3){v[0] + reach, v[1], v[2]};
    corners[1] = (vec3){v[0] - 0.5f * reach, v[1] + 0.8660254f * reach, v[2]};
    corners[2] = (vec3){v[0] - 0.5f * reach, v[1] - 0.8660254f * reach, v[2]};
}

#if LANES == 8
void prefetch_face(size_t row, const Source *source)
{
    prefetch_row(source->positions, row, 9);
    prefetch_row(source->coverage, row, COVERAGE);
}

void prefetch_colors(size_t row, const Source *source, __constant View *view)
{
    prefetch_row(source->f_rest, row, view->rest_stride);
    PREFETCH_FAR(source->f_dc + 3 * row);
}
#endif

// Computes the middle and the squared half sides of the box around a disc with the given squared radius.
// Returns false if the camera's plane touches the disc, because the box then does not exist.
mask disc_box(const Faces *f, real square, vec2 *middle, vec2 *squares, real *d)
{
    *d = square * (f->r[0] * f->r[0]) + square * (f->r[1] * f->r[1]) - f->r[2] * f->r[2];
    real inverse = 1.0f / *d, s = inverse * square, last = -inverse;
    middle->x = s * (f->p[0] * f->r[0]) + s * (f->p[1] * f->r[1]) + last * (f->p[2] * f->r[2]);
    middle->y = s * (f->q[0] * f->r[0]) + s * (f->q[1] * f->r[1]) + last * (f->q[2] * f->r[2]);
    squares->x = middle->x * middle->x - (s * (f->p[0] * f->p[0]) + s * (f->p[1] * f->p[1]) + last * (f->p[2] * f->p[2]));
    squares->y = middle->y * middle->y - (s * (f->q[0] * f->q[0]) + s * (f->q[1] * f->q[1]) + last * (f->q[2] * f->q[2]));
    return *d != 0.0f;
}

mask project_faces(const size_t *rows, const Source *source, __constant View *view, Faces *f, Box *official,
                   real *depth)
{
    real v[9], coverage[4];
    load_members(source->positions, rows, 9, 9, v);
    vec3 mean = {v[0], v[1], v[2]}, t = to_camera(view, mean);
    mask kept = t.z > NEAREST;
    if (!ANY(kept))
        return kept;
    *depth = t.z;
    f->color[0] = mean.x;
    f->color[1] = mean.y;
    f->color[2] = mean.z;
    load_members(source->coverage, rows, COVERAGE, 4, coverage);
    f->opacity = coverage[0];
    vec3 normal = rotate_to_camera(view, (vec3){coverage[1], coverage[2], coverage[3]});
    real facing = -dot3(t, normal);
    kept &= facing != 0.0f;
    normal = mul3(normal, facing > 0.0f ? (real)1.0f : (real)-1.0f);
    f->normal[0] = normal.x;
    f->normal[1] = normal.y;
    f->normal[2] = normal.z;

    // For both axes and the mean, p and q hold the screen position times depth, and r holds the depth.
    __constant float *full = view->full;
    float w = (float)view->width, h = (float)view->height;
    float middle_x = (w - 1.0f) / 2.0f + view->shift[0], middle_y = (h - 1.0f) / 2.0f + view->shift[1];
    for (int k = 0; k < 3; k++) {
        vec3 axis = k == 0 ? (vec3){v[3], v[4], v[5]} : k == 1 ? (vec3){v[6], v[7], v[8]} : mean;
        real x = linear(full, axis), y = linear(full + 4, axis), z = linear(full + 12, axis);
        if (k == 2) {
            x = x + full[3];
            y = y + full[7];
            z = z + full[15];
        }
        f->p[k] = x * (w / 2.0f) + z * middle_x;
        f->q[k] = y * (h / 2.0f) + z * middle_y;
        f->r[k] = z;
    }
    vec2 middle, squares;
    real d;
    kept &= disc_box(f, (real)(CUTOFF * CUTOFF), &middle, &squares, &d);
    f->x = middle.x;
    f->y = middle.y;
    real ex = root(greater(squares.x, (real)LEAST)), ey = root(greater(squares.y, (real)LEAST));

    // The samples with an alpha of 1/255 or more.
    // The samples belong to the disc, or to the filter around the middle of the official box.
    real level = 2.0f / LOG2E * log2_fast(greater(255.0f * f->opacity, (real)1e-30f));
    f->limit = level + 1e-3f;
    vec2 here;
    disc_box(f, greater(f->limit, (real)0.0f), &here, &squares, &d);
    mask amid = !(d < 0.0f); // the camera's plane cuts the disc
    real far = here.x * here.x + here.y * here.y;
    real rx = root(greater(squares.x, (real)0.0f) + 2e-6f * far) + 0.02f;
    real ry = root(greater(squares.y, (real)0.0f) + 2e-6f * far) + 0.02f;
    real filter = FILTER * root(greater(f->limit, (real)0.0f)) + 0.02f;
    vec2 low = {lesser(here.x - rx, middle.x - filter), lesser(here.y - ry, middle.y - filter)};
    vec2 high = {greater(here.x + rx, middle.x + filter), greater(here.y + ry, middle.y + filter)};
    Box box = box_of(low, high, view);
    f->x0 = amid ? (mask)0 : box.x0;
    f->y0 = amid ? (mask)0 : box.y0;
    f->x1 = f->limit < 0.0f ? (mask)-1 : (amid ? (mask)((int)view->width - 1) : box.x1);
    f->y1 = amid ? (mask)((int)view->height - 1) : box.y1;

#if GSPLAT
    real wide = 3.33f * ex, tall = 3.33f * ey;
    real wx = floor_small(lesser(wide, (real)1e6f)), wy = floor_small(lesser(tall, (real)1e6f));
    wx = wx < wide ? wx + 1.0f : wx;
    wy = wy < tall ? wy + 1.0f : wy;
    real px = f->x + 0.5f, py = f->y + 0.5f;
    kept &= (px + wx > 0.0f) & (px - wx < w) & (py + wy > 0.0f) & (py - wy < h);
    *official = (Box){tile_number((px - wx) / TILE, view->columns), tile_number((py - wy) / TILE, view->rows),
                      tile_after((px + wx) / TILE, view->columns), tile_after((py + wy) / TILE, view->rows)};
#else
    real exact = greater(greater(ex, ey), (real)(CUTOFF * FILTER));
    real radius = floor_small(lesser(exact, (real)1e6f));
    radius = radius < exact ? radius + 1.0f : radius;
    *official = (Box){tile_number((f->x - radius) / TILE, view->columns),
                      tile_number((f->y - radius) / TILE, view->rows),
                      tile_number((f->x + radius + (TILE - 1)) / TILE, view->columns),
                      tile_number((f->y + radius + (TILE - 1)) / TILE, view->rows)};
#endif
    return kept & (official->x1 > official->x0) & (official->y1 > official->y0);
}

void color_faces(const size_t *rows, const Source *source, __constant View *view, real *color)
{
    color_of(view, source->f_dc, source->f_rest, rows, (vec3){color[0], color[1], color[2]}, color);
}

// ---- at the samples of a row

typedef struct {
    real k[3], dx;
} Columns;
typedef struct {
    real square, z, alpha;
} Sample;

Columns columns_of(FACE_POINTER f, real x, __constant View *view)
{
    Columns c;
    for (int i = 0; i < 3; i++)
        c.k[i] = x * f->r[i] - f->p[i];
    c.dx = f->x - x;
    return c;
}

#if LANES == 8
mask reaches(FACE_POINTER f, float left, real y) { return (mask)-1; }
#endif

mask inside(FACE_POINTER f, const Columns *c, float y, __constant View *view, Sample *s)
{
    float l0 = y * f->r[0] - f->q[0], l1 = y * f->r[1] - f->q[1], l2 = y * f->r[2] - f->q[2];
    real inverse = 1.0f / (c->k[0] * l1 - c->k[1] * l0);
    real u = (c->k[1] * l2 - c->k[2] * l1) * inverse, v = (c->k[2] * l0 - c->k[0] * l2) * inverse;
    s->z = (u * f->r[0] + v * f->r[1]) + f->r[2];
    float dy = f->y - y;
    real square = u * u + v * v, filtered = 2.0f * (c->dx * c->dx + dy * dy);
    s->square = filtered < square ? filtered : square;
    mask within = s->square <= f->limit; // false for NaN
#if !GSPLAT
    within &= s->z >= NEAREST;
#endif
    return within;
}

mask cover(FACE_POINTER f, __constant View *view, mask within, Sample *s)
{
    real power = greater(-0.5f * LOG2E * s->square, (real)-100.0f);
    s->alpha = lesser((real)MAX_ALPHA, f->opacity * exp2_fast(power));
    return within & (s->alpha >= MIN_ALPHA);
}

void shade(FACE_POINTER f, const Columns *c, float y, const Sample *s, real *rgb, real *z)
{
    rgb[0] = f->color[0];
    rgb[1] = f->color[1];
    rgb[2] = f->color[2];
    *z = s->z;
}

float3 normal_of(FACE_POINTER f) { return vload3(0, f->normal); }

#include "splat_stages.cl"
