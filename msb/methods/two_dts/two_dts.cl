// 2DTS: a triangle soup with a Gaussian-like falloff of global sharpness, and two rasterizers.
// Sources: GaodeRender/triangle-splatting at 54c80f7: submodules/diff-triangle-rasterization-2D and -3D:
// src/forward.cu, src/auxiliary.h.

#include "splat_common.cl"
#include "splat_soup.cl"

#define EPS 1e-8f
#define DILATION 3.0f
#define MAX_ALPHA 0.99f
#define MAX_ECCENTRICITY 10.0f
#define BLENDS_CROSSING 1
#define CORNERS_MAY_BE_BEHIND 0
#define SMALL_IS_DROPPED 0

// The array coverage has the opacity and a limit of the eccentricity.
// Alpha is below 1/255 beyond this limit.
// The limit is negative if alpha is always below 1/255.

#if ENGINE
#define LINES 12
#define SHAPE(REAL) REAL lines[LINES];
#elif PLANAR
// corner is corner 1 in camera space, and distance is the product of corner and the normal.
// The vector from this corner to a point of the plane gives two barycentric coordinates.
// The product of this vector and dual2 is barycentric coordinate 2, and the product with dual3 is
// barycentric coordinate 3.
#define SHAPE(REAL) REAL corner[3], dual2[3], dual3[3], distance;
#else
// Corner positions in samples, the value 1 / (2 area), and the camera depths of the corners.
#define SHAPE(REAL) REAL x[3], y[3], inverse, z[3];
#endif
// The value limit is the eccentricity limit of `coverage`.
#define FACE_MEMBERS(REAL, INT)                                                                              \
    {                                                                                                        \
        SHAPE(REAL)                                                                                          \
        REAL normal[3], opacity, limit, color[3];                                                            \
        INT x0, y0, x1, y1, number;                                                                          \
    }
typedef struct BY_EIGHTS Face FACE_MEMBERS(float, int) Face;
typedef struct FACE_MEMBERS(real, mask) Faces;
#if ENGINE
#include "splat_engine.cl"
#define ECCENTRICITY(f, s) ((f)->limit * (1.0f - (s)->phi))
#else
#define ECCENTRICITY(f, s) ((s)->eccentricity)
#endif

// The divisor is |w| + eps instead of w.
// A point behind the camera then has a negative z and fails the near test.
vec3 to_ndc(__constant View *view, vec3 p)
{
    __constant float *m = view->full;
    real inverse = 1.0f / (magnitude(affine(m + 12, p)) + EPS);
    return (vec3){affine(m, p) * inverse, affine(m + 4, p) * inverse, affine(m + 8, p) * inverse};
}

// The tiles that the box of the dilated corners touches.
Box dilated_tiles(__constant View *view, vec2 a, vec2 b, vec2 c)
{
    vec2 low = {lesser(lesser(a.x, b.x), c.x), lesser(lesser(a.y, b.y), c.y)};
    vec2 high = {greater(greater(a.x, b.x), c.x), greater(greater(a.y, b.y), c.y)};
    return (Box){tile_number(low.x / TILE, view->columns), tile_number(low.y / TILE, view->rows),
                 tile_number((high.x + TILE - 1) / TILE, view->columns),
                 tile_number((high.y + TILE - 1) / TILE, view->rows)};
}

#if ENGINE
// Engine sampling is the same for both rasterizers.
// Graphics hardware draws nothing outside a triangle, but the falloff of this method extends further.
// Therefore each triangle is enlarged about its centroid until it contains the whole falloff.
mask project_shape(__constant View *view, vec3 a, vec3 b, vec3 c, Faces *f, Box *official, Box *box,
                   real *depth)
{
    vec3 center = center_of(a, b, c), corners[3] = {a, b, c};
    for (int k = 0; k < 3; k++)
        corners[k] = add3(center, mul3(sub3(corners[k], center), f->limit));
    real weight[3];
    mask back, kept = project_engine(view, corners[0], corners[1], corners[2], false, f, official, depth,
                                     weight, &back);
    *box = (Box){f->x0, f->y0, f->x1, f->y1};
    return kept & (f->limit > 0.0f) & !(view->own.back_culling ? back : (mask)0);
}
#elif PLANAR
// The "3D" rasterizer: every sample's ray is intersected with the triangle's plane; no low-pass filter.
mask project_shape(__constant View *view, vec3 a, vec3 b, vec3 c, Faces *f, Box *official, Box *box,
                   real *depth)
{
    vec3 p = to_camera(view, a), q = to_camera(view, b), r = to_camera(view, c);
    vec3 normal = cross3(sub3(q, p), sub3(r, p));
    mask dropped = length3(normal) < EPS;
    if (view->own.back_culling)
        dropped |= normal.z >= 0.0f;
    vec3 center = center_of(a, b, c), corners[3] = {a, b, c};
    vec2 dilated[3];
    for (int k = 0; k < 3; k++) {
        vec3 ndc = to_ndc(view, add3(center, mul3(sub3(corners[k], center), (real)DILATION)));
        dropped |= ndc.z <= 0.0f;
        dilated[k].x = (ndc.x + 1.0f) * (float)view->width * 0.5f - 0.5f + view->shift[0];
        dilated[k].y = (ndc.y + 1.0f) * (float)view->height * 0.5f - 0.5f + view->shift[1];
    }
    *official = dilated_tiles(view, dilated[0], dilated[1], dilated[2]);
    *depth = center_of(p, q, r).z;

    real scale = 1.0f / dot3(normal, normal);
    vec3 dual2 = mul3(cross3(sub3(r, p), normal), scale), dual3 = mul3(cross3(normal, sub3(q, p)), scale);
    f->corner[0] = p.x;
    f->corner[1] = p.y;
    f->corner[2] = p.z;
    f->dual2[0] = dual2.x;
    f->dual2[1] = dual2.y;
    f->dual2[2] = dual2.z;
    f->dual3[0] = dual3.x;
    f->dual3[1] = dual3.y;
    f->dual3[2] = dual3.z;
    f->distance = dot3(p, normal);
    f->normal[0] = normal.x;
    f->normal[1] = normal.y;
    f->normal[2] = normal.z;
    // The box is as large as the tiles, because covered samples are scattered if the plane is seen edge-on.
    *box = (Box){(mask)0, (mask)0, (mask)((int)view->width - 1), (mask)((int)view->height - 1)};
    return !dropped;
}
#else
// The "2D" rasterizer: perspective is linearised at the centroid.
// Corners are moved outwards by half a sample.
mask project_shape(__constant View *view, vec3 a, vec3 b, vec3 c, Faces *f, Box *official, Box *box,
                   real *depth)
{
    vec3 center = center_of(a, b, c), ndc = to_ndc(view, center);
    mask dropped = ndc.z <= 0.0f;
    vec3 camera = to_camera(view, center);
    *depth = camera.z;
    // The clamp affects only the Jacobian, not the projected centroid.
    real most_x = 1.3f * view->tan_fov[0] * camera.z, most_y = 1.3f * view->tan_fov[1] * camera.z;
    real clamped_x = lesser(greater(-most_x, camera.x), most_x);
    real clamped_y = lesser(greater(-most_y, camera.y), most_y);
    real wide = camera.z * view->tan_fov[0], tall = camera.z * view->tan_fov[1];
    vec3 arms[3] = {rotate_to_camera(view, sub3(a, center)), rotate_to_camera(view, sub3(b, center)),
                    rotate_to_camera(view, sub3(c, center))};
    vec3 normal = cross3(arms[0], arms[1]);
    real area_3d = length3(normal);
    dropped |= area_3d < EPS;
    vec2 middle = {to_sample(ndc.x, view->width) + view->shift[0],
                   to_sample(ndc.y, view->height) + view->shift[1]};
    float half_width = 0.5f * (float)view->width, half_height = 0.5f * (float)view->height;
    vec2 u[3], dilated[3];
    for (int k = 0; k < 3; k++) {
        vec2 flat = {(arms[k].x - arms[k].z * clamped_x / camera.z) / wide,
                     (arms[k].y - arms[k].z * clamped_y / camera.z) / tall};
        real far = length2(flat), push = 0.5f / far; // moved outwards by half a sample: a low-pass filter
        dropped |= far < EPS;
        flat.x = flat.x * (half_width + push);
        flat.y = flat.y * (half_height + push);
        u[k] = add2(middle, flat);
        dilated[k] = add2(middle, mul2(flat, (real)DILATION));
        f->x[k] = u[k].x;
        f->y[k] = u[k].y;
        f->z[k] = arms[k].z + camera.z;
    }
    real area = cross2(sub2(u[1], u[0]), sub2(u[2], u[0]));
    // The y axis points down, so a front face (counter-clockwise on the screen) has a negative area.
    dropped |= view->own.back_culling ? area >= -EPS : magnitude(area) < EPS;
    *official = dilated_tiles(view, dilated[0], dilated[1], dilated[2]);
    f->inverse = 1.0f / area;
    f->normal[0] = normal.x / area_3d;
    f->normal[1] = normal.y / area_3d;
    f->normal[2] = normal.z / area_3d;

    // The points of eccentricity E form the triangle enlarged E times about its centroid.
    // In thin triangles, rounding moves samples by up to `noise`.
    // Therefore samples outside any tight box can be covered.
    vec2 low = {lesser(lesser(u[0].x, u[1].x), u[2].x), lesser(lesser(u[0].y, u[1].y), u[2].y)};
    vec2 high = {greater(greater(u[0].x, u[1].x), u[2].x), greater(greater(u[0].y, u[1].y), u[2].y)};
    real longest = greater(high.x - low.x, high.y - low.y), across = f->limit * longest + TILE;
    real far = greater(greater(magnitude(low.x), magnitude(low.y)),
                       greater(magnitude(high.x), magnitude(high.y)));
    real noise = 4e-6f * across * (across + 0.1f * far) / magnitude(area);
    real grown = noise > 0.5f ? (real)INFINITY : f->limit * 1.0001f + noise;
    vec2 mean = {(u[0].x + u[1].x + u[2].x) / 3.0f, (u[0].y + u[1].y + u[2].y) / 3.0f};
    low = (vec2){mean.x + grown * (low.x - mean.x) - 0.01f, mean.y + grown * (low.y - mean.y) - 0.01f};
    high = (vec2){mean.x + grown * (high.x - mean.x) + 0.01f, mean.y + grown * (high.y - mean.y) + 0.01f};
    *box = box_of(low, high, view);
    return !dropped;
}
#endif

mask project_faces(const size_t *rows, const Source *source, __constant View *view, Faces *f, Box *official,
                   real *depth)
{
    f->opacity = load(source->coverage, rows, COVERAGE, 0);
    f->limit = load(source->coverage, rows, COVERAGE, 1);
    Box box;
    vec3 p[3];
    corners_of(rows, source->positions, source->indices, p);
    mask kept = project_shape(view, p[0], p[1], p[2], f, official, &box, depth);
    color_later(p, f->color);
    kept &= (official->x1 > official->x0) & (official->y1 > official->y0);
    f->x0 = box.x0;
    f->y0 = box.y0;
    // the official code keeps such faces, although they cover no sample
    f->x1 = f->limit < 0.0f ? (mask)-1 : box.x1;
    f->y1 = box.y1;
    return kept;
}

void color_faces(const size_t *rows, const Source *source, __constant View *view, real *color)
{
    color_of(view, source->f_dc, source->f_rest, rows, (vec3){color[0], color[1], color[2]}, color);
}

#if !ENGINE
#if PLANAR
typedef struct {
    real x;
} Columns;
#else
typedef struct {
    real x[3];
} Columns;
#endif
typedef struct {
    real eccentricity, alpha, a1, a2, z;
} Sample;

Columns columns_of(FACE_POINTER f, real x, __constant View *view)
{
    Columns c;
#if PLANAR
    float w = (float)view->width;
    c.x = view->tan_fov[0] * ((2.0f * (x - view->shift[0]) - w + 1.0f) / w);
#else
    for (int k = 0; k < 3; k++)
        c.x[k] = f->x[k] - x;
#endif
    return c;
}

#if LANES == 8
#define ABS(x) ((x) < 0.0f ? -(x) : (x))
// Returns a mask of the row pairs y, y + 1 (one pair per lane) that may contain a covered sample.
// Only the eight columns from `left` on are tested.
// At a covered sample, all three barycentric coordinates are above (1 - limit) / 3.
// Test each coordinate at the corner of the block where the coordinate is largest.
mask reaches(FACE_POINTER f, float left, real y)
{
#if PLANAR
    return (mask)-1;
#else
    mask reached = (mask)-1;
    float wide = ABS(f->x[0] - left) + ABS(f->x[1] - left) + ABS(f->x[2] - left) + 8.0f;
    float tall = ABS(f->y[0] - y.s0) + ABS(f->y[1] - y.s0) + ABS(f->y[2] - y.s0) + 16.0f;
    float least = (1.0f - f->limit) * (1.0f / 3.0f) - 1e-4f - 1e-6f * wide * tall * ABS(f->inverse);
    for (int k = 0; k < 3; k++) {
        int i = k == 2 ? 0 : k + 1, j = k == 0 ? 2 : k - 1; // the barycentric coordinate of corner k
        float along_x = (f->y[i] - f->y[j]) * f->inverse, along_y = (f->x[j] - f->x[i]) * f->inverse;
        float most = (along_x > 0.0f ? 7.0f * along_x : 0.0f) + (along_y > 0.0f ? along_y : 0.0f);
        real at = ((f->x[i] - left) * (f->y[j] - y) - (f->y[i] - y) * (f->x[j] - left)) * f->inverse;
        reached &= !(at + most < least);
    }
    return reached;
#endif
}
#endif

mask inside(FACE_POINTER f, const Columns *c, float y, __constant View *view, Sample *s)
{
#if PLANAR
    float h = (float)view->height;
    float ray_y = view->tan_fov[1] * ((2.0f * (y - view->shift[1]) - h + 1.0f) / h);
    real slope = (c->x * f->normal[0] + ray_y * f->normal[1]) + f->normal[2];
    s->z = f->distance / slope;
    real dx = s->z * c->x - f->corner[0], dy = s->z * ray_y - f->corner[1], dz = s->z - f->corner[2];
    s->a2 = MAD(dz, (real)f->dual2[2], MAD(dy, (real)f->dual2[1], dx * f->dual2[0]));
    real a3 = MAD(dz, (real)f->dual3[2], MAD(dy, (real)f->dual3[1], dx * f->dual3[0]));
    s->a1 = 1.0f - s->a2 - a3;
#else
    float y1 = f->y[0] - y, y2 = f->y[1] - y, y3 = f->y[2] - y;
    s->a1 = (c->x[1] * y3 - y2 * c->x[2]) * f->inverse;
    s->a2 = (c->x[2] * y1 - y3 * c->x[0]) * f->inverse;
    real a3 = 1.0f - s->a1 - s->a2;
#endif
    s->eccentricity = 1.0f - 3.0f * lesser(lesser(s->a1, s->a2), a3);
    mask within = (s->eccentricity >= 0.0f) & (s->eccentricity <= f->limit);
#if PLANAR
    within &= magnitude(slope) >= EPS;
#endif
    return within;
}
#endif

mask cover(FACE_POINTER f, __constant View *view, mask within, Sample *s)
{
    real e = ECCENTRICITY(f, s), grown;
    if (view->own.power == 2.0f)
        grown = e * e;
    else
        grown = exp2_fast(lesser(greater(view->own.power * log2_fast(greater(e, (real)1e-30f)), (real)-100.0f),
                                 (real)100.0f));
    // exp(-g / 2) is computed as exp2(-0.7213... g)
    s->alpha = lesser((real)MAX_ALPHA, f->opacity * exp2_fast(greater(-0.72134752f * grown, (real)-100.0f)));
    return within & (s->alpha >= MIN_ALPHA);
}

void shade(FACE_POINTER f, const Columns *c, float y, const Sample *s, real *rgb, real *z)
{
    for (int k = 0; k < 3; k++)
        rgb[k] = f->color[k];
#if ENGINE || PLANAR
    *z = s->z;
#else
    real a3 = 1.0f - s->a1 - s->a2;
    *z = MAD(a3, (real)f->z[2], MAD(s->a2, (real)f->z[1], s->a1 * f->z[0]));
#endif
}

float3 normal_of(FACE_POINTER f) { return vload3(0, f->normal); }

#include "splat_stages.cl"
