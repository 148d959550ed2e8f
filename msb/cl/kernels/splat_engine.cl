// Sampling of triangles as in a game engine, by the rasterisation rules of graphics hardware.
// msb/reference/engine.py defines this sampling, and explains why no polygon is clipped.
// Both files use the same order of operations.
//
// If ENGINE is 1, a method's kernel file includes this file after its struct Face, and calls project_engine.
// The first member of Face is `float lines[LINES]`.
// This file has the sample functions listed in splat_stages.cl, except cover and shade.

// The array `lines` holds linear functions of a sample.
// The functions are the three barycentric coordinates over depth, times `weight`, and then 1 / depth.
// The factor `weight` makes the smallest coordinate 1 in the middle.
// Each linear function has a factor for x, a factor for y, and a constant.
// msb/render/splat/pipeline.py defines ENGINE_NEAR, the depth of the near plane in scene units.
#define ENGINE_SLACK 0.1f // margin of a box in samples, for rounding errors

// Step of the ray from one sample to the next, and the sample on the optical axis.
typedef struct {
    float step_x, step_y, middle_x, middle_y;
} Raster;

Raster raster_of(__constant View *view)
{
    float width = (float)view->width, height = (float)view->height;
    return (Raster){2.0f * view->tan_fov[0] / width, 2.0f * view->tan_fov[1] / height,
                    (width - 1.0f) * 0.5f + view->shift[0], (height - 1.0f) * 0.5f + view->shift[1]};
}

// Sets the linear function n . ray of a sample, multiplied by `scale`.
void set_line(Raster r, vec3 n, real scale, real *line)
{
    real p = n.x * r.step_x, q = n.y * r.step_y;
    line[0] = p * scale;
    line[1] = q * scale;
    line[2] = ((n.z - p * r.middle_x) - q * r.middle_y) * scale;
}

// If `seen` is set, extends the bounds, in samples, by a camera-space point at depth z.
void hold_point(Raster r, real x, real y, real z, mask seen, vec2 *low, vec2 *high)
{
    real u = x / z / r.step_x + r.middle_x, v = y / z / r.step_y + r.middle_y;
    low->x = (seen & (u < low->x)) ? u : low->x;
    low->y = (seen & (v < low->y)) ? v : low->y;
    high->x = (seen & (u > high->x)) ? u : high->x;
    high->y = (seen & (v > high->y)) ? v : high->y;
}

// The samples that the part of a triangle beyond the near plane covers.
Box engine_box(__constant View *view, const vec3 *p)
{
    Raster r = raster_of(view);
    vec2 low = {(real)INFINITY, (real)INFINITY}, high = {(real)-INFINITY, (real)-INFINITY};
    for (int k = 0; k < 3; k++) {
        vec3 from = p[k], to = p[k == 2 ? 0 : k + 1];
        mask inside = from.z >= ENGINE_NEAR;
        hold_point(r, from.x, from.y, from.z, inside, &low, &high);
        real share = (ENGINE_NEAR - from.z) / (to.z - from.z);
        real x = from.x + share * (to.x - from.x), y = from.y + share * (to.y - from.y);
        hold_point(r, x, y, (real)ENGINE_NEAR, inside != (to.z >= ENGINE_NEAR), &low, &high);
    }
    vec2 slack = {(real)ENGINE_SLACK, (real)ENGINE_SLACK};
    return box_of(sub2(low, slack), add2(high, slack), view);
}

// Sets lines, normal, depth, reach and tiles of a face.
// The window is 1 at the incentre of the triangle, or at its centroid.
// Methods with an incentre turn the normal towards the camera.
// Returns which of the triangles may be visible.
// `back` marks triangles whose corners are clockwise on the screen.
mask project_engine(__constant View *view, vec3 a, vec3 b, vec3 c, bool incentre, Faces *f, Box *official,
                    real *depth, real *weight, mask *back)
{
    vec3 p[3] = {to_camera(view, a), to_camera(view, b), to_camera(view, c)};
    vec3 normal = cross3(sub3(p[1], p[0]), sub3(p[2], p[0]));
    real volume = dot3(p[0], normal);
    *back = volume > 0.0f;

    vec3 opposite[3] = {sub3(p[2], p[1]), sub3(p[0], p[2]), sub3(p[1], p[0])};
    real length[3] = {length3(opposite[0]), length3(opposite[1]), length3(opposite[2])};
    Raster r = raster_of(view);
    real perimeter = length[0] + length[1] + length[2];
    for (int k = 0; k < 3; k++) {
        weight[k] = incentre ? perimeter / length[k] : (real)3.0f;
        set_line(r, cross3(p[k == 2 ? 0 : k + 1], opposite[k]), weight[k] / volume, f->lines + 3 * k);
    }
    set_line(r, normal, 1.0f / volume, f->lines + 9);
    normal = div3(normal, length3(normal));
    if (incentre)
        normal = mul3(normal, *back ? (real)-1.0f : (real)1.0f);
    f->normal[0] = normal.x;
    f->normal[1] = normal.y;
    f->normal[2] = normal.z;

    real z = affine(view->world_to_camera + 8, center_of(a, b, c));
    *depth = z > 0.0f ? z : (real)0.0f; // sort keys are the bits of non-negative numbers
    Box box = engine_box(view, p);
    f->x0 = box.x0;
    f->y0 = box.y0;
    f->x1 = box.x1;
    f->y1 = box.y1;
    *official = (Box){box.x0 >> 4, box.y0 >> 4, (box.x1 >> 4) + 1, (box.y1 >> 4) + 1};
    return (magnitude(volume) >= FLT_MIN) & (box.x1 >= box.x0) & (box.y1 >= box.y0);
}

// ---- at the samples of a row

typedef struct {
    real line[4]; // the part of a linear function that is constant along a column
} Columns;

typedef struct {
    real phi;    // 0 on the edges, 1 in the middle
    real z;      // camera depth
    real e1, e2; // weighted barycentric coordinates 1 and 2 over depth
    real alpha;
} Sample;

Columns columns_of(FACE_POINTER f, real x, __constant View *view)
{
    Columns c;
    for (int k = 0; k < 4; k++)
        c.line[k] = f->lines[3 * k] * x + f->lines[3 * k + 2];
    return c;
}

// Behind the camera, all three coordinates are negative inside the triangle, so nothing needs clipping.
mask inside(FACE_POINTER f, const Columns *c, float y, __constant View *view, Sample *s)
{
    real e0 = c->line[0] + f->lines[1] * y;
    s->e1 = c->line[1] + f->lines[4] * y;
    s->e2 = c->line[2] + f->lines[7] * y;
    real nearest = lesser(lesser(e0, s->e1), s->e2);
    s->z = 1.0f / (c->line[3] + f->lines[10] * y);
    s->phi = nearest * s->z;
    return (nearest >= 0.0f) & (s->z >= ENGINE_NEAR) & (s->z < INFINITY);
}

#if LANES == 8
// Returns a mask of the row pairs y, y + 1 (one pair per lane) with samples.
// Only the eight columns from `left` on are tested.
// The test uses the innermost corner of these samples, and allows for rounding.
mask reaches(FACE_POINTER f, float left, real y)
{
    mask reached = (mask)-1;
    for (int k = 0; k < 3; k++) {
        float along_x = f->lines[3 * k], along_y = f->lines[3 * k + 1], start = f->lines[3 * k + 2];
        float most = (along_x > 0.0f ? 7.0f * along_x : 0.0f) + (along_y > 0.0f ? along_y : 0.0f);
        float size = fabs(along_x) * (left + 8.0f) + fabs(along_y) * (y.s7 + 2.0f) + fabs(start);
        reached &= !(MAD((real)along_y, y, (real)(along_x * left + start + most + 4e-6f * size)) < 0.0f);
    }
    return reached;
}
#endif
