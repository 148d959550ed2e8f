// 3DGS: Gaussians, projected by a local affine map.
// Sources: graphdeco-inria/diff-gaussian-rasterization at 59f5f77: cuda_rasterizer/forward.cu, auxiliary.h;
// with GSPLAT the rules of nerfstudio-project/gsplat at 90d7b4b.

#include "splat_common.cl"
#include "splat_color.cl"

#define VERTEX_COLORS 0
#define COLORS 3
#define BLENDS_CROSSING 0
#define CORNERS_MAY_BE_BEHIND 0
#define SMALL_IS_DROPPED 0
#define MAX_ALPHA 0.99f
#define DILATION 0.3f
#if GSPLAT
#define NEAREST 0.01f
#else
#define NEAREST 0.2f
#endif
#define LOG2E 1.4426950408889634f

// A row of `positions` has the mean, and the covariance entries xx, xy, xz, yy, yz, zz. The array coverage
// has the opacity. At a sample (dx, dy) from the mean, the Gaussian is 2^(a dx^2 + b dx dy + c dy^2). If the
// exponent is below `limit`, alpha is below 1/255. The density along the ray of a sample is largest at
// depth - rise . (dx, dy).
#define FACE_MEMBERS(REAL, INT)                                                                              \
    {                                                                                                        \
        REAL x, y, a, b, c, opacity, limit, depth, rise[2], color[3], unused[6];                             \
        INT x0, y0, x1, y1, number;                                                                          \
    }
typedef struct BY_EIGHTS Face FACE_MEMBERS(float, int) Face;
typedef struct FACE_MEMBERS(real, mask) Faces;

// Returns three points around the mean, at 3.4 standard deviations or more. splat_bounds.cl computes a sphere
// from the three points. Beyond 3.33 standard deviations, alpha is below 1/255.
void corners_of(const size_t *rows, __global const float *positions, __global const uint *indices,
                vec3 *corners)
{
    real v[9];
    load_members(positions, rows, 9, 9, v);
    real off = v[4] * v[4] + v[5] * v[5] + v[7] * v[7];
    real most = root(v[3] * v[3] + v[6] * v[6] + v[8] * v[8] + 2.0f * off); // at least the largest eigenvalue
    real reach = 3.4f * root(most);
    corners[0] = (vec3){v[0] + reach, v[1], v[2]};
    corners[1] = (vec3){v[0] - 0.5f * reach, v[1] + 0.8660254f * reach, v[2]};
    corners[2] = (vec3){v[0] - 0.5f * reach, v[1] - 0.8660254f * reach, v[2]};
}

#if LANES == 8
void prefetch_face(size_t row, const Source *source)
{
    prefetch_row(source->positions, row, 9);
    PREFETCH_FAR(source->coverage + row);
}

void prefetch_colors(size_t row, const Source *source, __constant View *view)
{
    prefetch_row(source->f_rest, row, view->rest_stride);
    PREFETCH_FAR(source->f_dc + 3 * row);
}
#endif

mask project_faces(const size_t *rows, const Source *source, __constant View *view, Faces *f, Box *official,
                   real *depth)
{
    real v[9];
    load_members(source->positions, rows, 9, 9, v);
    vec3 mean = {v[0], v[1], v[2]}, t = to_camera(view, mean);
    mask kept = t.z > NEAREST;
    if (!ANY(kept))
        return kept;
    *depth = t.z;
    f->depth = t.z;
    f->color[0] = mean.x;
    f->color[1] = mean.y;
    f->color[2] = mean.z;

    // The Jacobian of the projection; a mean far outside the image is moved towards the image first.
    __constant float *m = view->world_to_camera;
    float w = (float)view->width, h = (float)view->height;
    float focal_x = w / (2.0f * view->tan_fov[0]), focal_y = h / (2.0f * view->tan_fov[1]);
#if GSPLAT
    float cx = w / 2.0f + view->shift[0], cy = h / 2.0f + view->shift[1];
    float low_x = -(cx / focal_x + 0.3f * view->tan_fov[0]);
    float high_x = (w - cx) / focal_x + 0.3f * view->tan_fov[0];
    float low_y = -(cy / focal_y + 0.3f * view->tan_fov[1]);
    float high_y = (h - cy) / focal_y + 0.3f * view->tan_fov[1];
#else
    float high_x = 1.3f * view->tan_fov[0], high_y = 1.3f * view->tan_fov[1], low_x = -high_x, low_y = -high_y;
#endif
    real tx = lesser(greater(t.x / t.z, (real)low_x), (real)high_x) * t.z;
    real ty = lesser(greater(t.y / t.z, (real)low_y), (real)high_y) * t.z;
    real squared = t.z * t.z;
    real jx = focal_x / t.z, jy = focal_y / t.z, kx = -(focal_x * tx) / squared, ky = -(focal_y * ty) / squared;
    // Rows p, q (3) of J W, and the covariance on the screen with and without the dilation.
    vec3 p = {m[0] * jx + m[8] * kx, m[1] * jx + m[9] * kx, m[2] * jx + m[10] * kx};
    vec3 q = {m[4] * jy + m[8] * ky, m[5] * jy + m[9] * ky, m[6] * jy + m[10] * ky};
    vec3 rx = {v[3], v[4], v[5]}, ry = {v[4], v[6], v[7]}, rz = {v[5], v[7], v[8]};
    vec3 vp = {dot3(p, rx), dot3(p, ry), dot3(p, rz)}, vq = {dot3(q, rx), dot3(q, ry), dot3(q, rz)};
    real sharp_x = dot3(vp, p), xy = dot3(vp, q), sharp_y = dot3(vq, q);
    real xx = sharp_x + DILATION, yy = sharp_y + DILATION, determinant = xx * yy - xy * xy;
    kept &= determinant != 0.0f;

    real opacity = load(source->coverage, rows, COVERAGE, 0);
#if ANTIALIASED
    opacity = opacity * root(greater((sharp_x * sharp_y - xy * xy) / determinant, (real)0.000025f));
#endif
    f->opacity = opacity;
    real inverse = 1.0f / determinant;
    f->a = -0.5f * LOG2E * (yy * inverse);
    f->b = LOG2E * (xy * inverse);
    f->c = -0.5f * LOG2E * (xx * inverse);
    // The mean of z at a sample is z0 - cov(z, xy) cov(xy)^-1 (dx, dy).
    vec3 ahead = {(real)m[8], (real)m[9], (real)m[10]};
    real with_x = dot3(vp, ahead), with_y = dot3(vq, ahead);
    f->rise[0] = (yy * with_x - xy * with_y) * inverse;
    f->rise[1] = (xx * with_y - xy * with_x) * inverse;
    // the limit is negative if alpha is always below 1/255
    real level = log2_fast(greater(255.0f * opacity, (real)1e-30f));
    f->limit = -level - 1e-4f;

    __constant float *full = view->full;
    real shrink = 1.0f / (affine(full + 12, mean) + 1e-7f);
    f->x = to_sample(affine(full, mean) * shrink, view->width) + view->shift[0];
    f->y = to_sample(affine(full + 4, mean) * shrink, view->height) + view->shift[1];

    // The samples with an exponent of -level or more; the box is empty if the opacity is below 1/255.
    real reach = root(greater((2.0f / LOG2E) * (level + 2e-4f), (real)0.0f));
    real reach_x = reach * root(xx) + 0.01f, reach_y = reach * root(yy) + 0.01f;
    Box box = box_of((vec2){f->x - reach_x, f->y - reach_y}, (vec2){f->x + reach_x, f->y + reach_y}, view);
    // If rounding makes the covariance indefinite, the Gaussian may be visible anywhere.
    mask odd = !(determinant > 0.0f);
    f->x0 = odd ? (mask)0 : box.x0;
    f->y0 = odd ? (mask)0 : box.y0;
    f->x1 = level < -2e-4f ? (mask)-1 : (odd ? (mask)((int)view->width - 1) : box.x1);
    f->y1 = odd ? (mask)((int)view->height - 1) : box.y1;

#if GSPLAT
    // The box reaches 3.33 standard deviations along each axis, or less if alpha falls below 1/255 earlier.
    real extend = lesser(root(greater((2.0f / LOG2E) * level, (real)0.0f)), (real)3.33f);
    real ex = extend * root(xx), ey = extend * root(yy);
    real wx = floor_small(ex), wy = floor_small(ey);
    wx = wx < ex ? wx + 1.0f : wx;
    wy = wy < ey ? wy + 1.0f : wy;
    real px = f->x + 0.5f, py = f->y + 0.5f;
    kept &= (px + wx > 0.0f) & (px - wx < w) & (py + wy > 0.0f) & (py - wy < h) & (opacity >= MIN_ALPHA);
    *official = (Box){tile_number((px - wx) / TILE, view->columns), tile_number((py - wy) / TILE, view->rows),
                      tile_after((px + wx) / TILE, view->columns), tile_after((py + wy) / TILE, view->rows)};
#else
    real half_sum = 0.5f * (xx + yy);
    real exact = 3.0f * root(half_sum + root(greater(half_sum * half_sum - determinant, (real)0.1f)));
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
    real quadratic, linear; // the terms a dx^2 and b dx
    real dx;
} Columns;
typedef struct {
    real power, alpha;
} Sample;

Columns columns_of(FACE_POINTER f, real x, __constant View *view)
{
    real dx = f->x - x;
    return (Columns){f->a * dx * dx, f->b * dx, dx};
}

#if LANES == 8
// Returns a mask of the row pairs y, y + 1 (one pair per lane).
// A sample of each marked pair has an exponent of `limit` or more.
// Only the eight columns from `left` on are tested.
// The largest exponent of a row is at dx = -b dy / 2a, or at the nearer end of the row.
mask reaches(FACE_POINTER f, float left, real y)
{
    float far = f->x - left, near = far - 7.0f, turn = -0.5f * f->b / f->a;
    real first = f->y - y, second = first - 1.0f;
    real at_first = lesser(greater(turn * first, (real)near), (real)far);
    real at_second = lesser(greater(turn * second, (real)near), (real)far);
    real upper = MAD(at_first, MAD((real)f->a, at_first, f->b * first), f->c * first * first);
    real lower = MAD(at_second, MAD((real)f->a, at_second, f->b * second), f->c * second * second);
    float slack = f->limit * 1.001f - 1e-3f;
    return !((upper < slack) & (lower < slack));
}
#endif

mask inside(FACE_POINTER f, const Columns *c, float y, __constant View *view, Sample *s)
{
    float dy = f->y - y;
    s->power = (c->quadratic + f->c * dy * dy) + c->linear * dy;
    return (s->power <= 0.0f) & (s->power >= f->limit);
}

mask cover(FACE_POINTER f, __constant View *view, mask within, Sample *s)
{
    s->alpha = lesser((real)MAX_ALPHA, f->opacity * exp2_fast(greater(s->power, (real)-100.0f)));
    return within & (s->alpha >= MIN_ALPHA);
}

void shade(FACE_POINTER f, const Columns *c, float y, const Sample *s, real *rgb, real *z)
{
    rgb[0] = f->color[0];
    rgb[1] = f->color[1];
    rgb[2] = f->color[2];
    float dy = f->y - y;
    *z = greater(MAD((real)-f->rise[0], c->dx, (real)(f->depth - f->rise[1] * dy)), (real)(0.5f * NEAREST));
}

float3 normal_of(FACE_POINTER f) { return (float3)(0.0f); }

#include "splat_stages.cl"
