// Code shared by the kernels of the opaque z-buffer, so that CPUs and GPUs draw the same image.
// The code covers the camera, triangle records, snapping, the depth of a plane, clipping, and colour
// interpolation.
// docs/standard.md has the rules.
//
// In the additions below, at most one operand is a product.
// Therefore all compilers that fuse multiplications and additions fuse the same operations.

// msb/render/standard/triangles.py defines SUBPIXEL_BITS, WORDS (floats per record) and the values of COLORS.
// Colours of the kinds BYTES_OF_CORNERS and FLOATS_OF_FACE are stored in the record.
// FLOATS_OF_CORNERS has nine floats per face in a separate buffer.
// zbuffer_texture.cl explains the kind TEXTURES. With TEXTURES, CUTOFF is 1 if alpha decides visibility.
#define UNIT (1 << SUBPIXEL_BITS) // unit of screen coordinates, 1/4096 pixel
#define HALF (UNIT / 2)
#define SMALL_EXTENT (64 * UNIT) // maximum extent of triangles that a CPU draws eight at once
#define DEEP(low, high) ((high) > 1024.0f * (low)) // whether 1 / z varies too much for float32
#define NEAR 0.01f
#define GUARD (1 << 29)           // in units; a triangle that extends further is clipped
#define GUARD_PLANE 402653184.0f  // in units; the clipping planes, inside GUARD with room for rounding

// Very distant geometry is computed in double precision if the device supports it.
// A million units away, float32 resolves a corner only to 0.06.
// Planes and edges of triangles with distant corners would be wrong near the camera.
#define FAR 1024.0f       // scene units from the camera, along any axis
#define UNCERTAIN 1024.0f // maximum ratio between the terms of a determinant and its value, for float32
#ifdef cl_khr_fp64
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
typedef double real;
#else
typedef float real;
#endif

// A triangle is 16 words, one cache line:
//   0..8   its three corners
//   9..11  three RGBA8 colours, or one RGB colour in floats, or with textures u0, v0, u1 (COLORS)
//   12     its face
//   13     without textures: 1 if it is longer than FAR / 2, else 0
//   13..15 with textures: v1, u2, v2
#define UV_WORD 9
#define FACE_WORD 12
#define LONG_WORD 13
// Words that are not floats are accessed as integers.
// Read as floats, such words could be subnormal or NaN, and a device may change their values.
#define INTEGERS(record) ((__global int *)(record))
#define NO_FACE (-1)

// The camera has the layout of VIEW in msb/render/standard/view.py.
// The rotation R of the camera has rows r0, r1, r2.
#define ROTATION 0   // 9: fx UNIT r0, fy UNIT r1, r2
#define CENTER 9     // centre of the camera, rounded
#define SHIFT 12     // rounding error of the centre, rotated and scaled by the rows above, with negative sign
#define PRINCIPAL 15 // 2 floats: cx UNIT + 1/2, cy UNIT + 1/2, so that truncation rounds
#define SCALE 17     // 2 floats: fx UNIT, fy UNIT
#define REST 19      // rounding error of the centre
#define RAY 22       // 9 floats: r0 / fx, r1 / fy, r2; direction = (u - cx) r0 / fx + (v - cy) r1 / fy + r2
#define OPTICAL 31   // 2: cx, cy
#define ROTATION_LOW 33 // rounding error of the member ROTATION
#define RAY_LOW 42      // 9 floats: rounding error of RAY
#define EXACT_RAY(view, i) ((real)view[RAY + (i)] + (real)view[RAY_LOW + (i)])

#if LANES == 8 // by default fused if the processor supports it, for vectors and scalars alike
#pragma OPENCL FP_CONTRACT ON
#define MAD(a, b, c) ((a) * (b) + (c))
#elif defined(FP_FAST_FMAF) || defined(__FMA__)
#define MAD(a, b, c) fma(a, b, c)
#else
#pragma OPENCL FP_CONTRACT OFF
#define MAD(a, b, c) ((a) * (b) + (c))
#endif

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))
#define LENGTH(a) ((a) < 0.0f ? -(a) : (a))

// Products that must not be fused are separate statements.
#define CROSS(REAL, x, y, z, ax, ay, az, bx, by, bz)                                                            \
    REAL x##_minus = az * by, y##_minus = ax * bz, z##_minus = ay * bx;                                         \
    REAL x = MAD(ay, bz, -x##_minus), y = MAD(az, bx, -y##_minus), z = MAD(ax, by, -z##_minus);
#define DOT(REAL, to, ax, ay, az, bx, by, bz)                                                                   \
    REAL to##_last = az * bz;                                                                                   \
    REAL to = MAD(ax, bx, MAD(ay, by, to##_last));

// Transform from world to camera: (fx UNIT x, fy UNIT y, z).
// The centre is subtracted first.
// Near the camera, the differences to the centre are nearly exact, at any distance from the origin.
#define TO_CAMERA(view, a, b, c, X, Y, Z)                                                                       \
    {                                                                                                           \
        a -= view[CENTER];                                                                                      \
        b -= view[CENTER + 1];                                                                                  \
        c -= view[CENTER + 2];                                                                                  \
        X = MAD(a, view[0], MAD(b, view[1], MAD(c, view[2], view[SHIFT])));                                     \
        Y = MAD(a, view[3], MAD(b, view[4], MAD(c, view[5], view[SHIFT + 1])));                                 \
        Z = MAD(a, view[6], MAD(b, view[7], MAD(c, view[8], view[SHIFT + 2])));                                 \
    }

// 1 / z is affine on the screen.
// With the plane's normal n and d = n . corner, 1 / z is (n . (u, v, 1)) / d.
// The coordinates u and v are distances from the principal point, in steps of 1/4096 pixel. A and B are the
// slopes of 1 / z per unit. The edge vectors start at the corner with the least depth. Edge vectors from a
// corner far away are nearly parallel, and rounding would tilt their plane.
#define NEARER(za, zb, a, b) (fabs(za) < fabs(zb) ? (a) : (b))
#define DEPTH_PLANE(REAL, X0, Y0, Z0, X1, Y1, Z1, X2, Y2, Z2, A, B, C)                                          \
    REAL A, B, C;                                                                                               \
    {                                                                                                           \
        REAL px = NEARER(Z1, Z0, X1, X0), py = NEARER(Z1, Z0, Y1, Y0), pz = NEARER(Z1, Z0, Z1, Z0);             \
        REAL qx = NEARER(Z1, Z0, X0, X1), qy = NEARER(Z1, Z0, Y0, Y1), qz = NEARER(Z1, Z0, Z0, Z1);             \
        REAL rx = NEARER(Z2, pz, px, X2), ry = NEARER(Z2, pz, py, Y2), rz = NEARER(Z2, pz, pz, Z2);             \
        REAL ox = NEARER(Z2, pz, X2, px), oy = NEARER(Z2, pz, Y2, py), oz = NEARER(Z2, pz, Z2, pz);             \
        REAL ax = qx - ox, ay = qy - oy, az = qz - oz, bx = rx - ox, by = ry - oy, bz = rz - oz;                \
        CROSS(REAL, nx, ny, nz, ax, ay, az, bx, by, bz)                                                         \
        DOT(REAL, determinant, nx, ny, nz, ox, oy, oz)                                                          \
        REAL scale = 1.0f / determinant;                                                                        \
        A = nx * scale;                                                                                         \
        B = ny * scale;                                                                                         \
        C = nz * scale;                                                                                         \
    }

// A corner in double precision, relative to the camera, in world axes.
void from_center(__global const float *corner, __constant float *view, real *p)
{
    for (int axis = 0; axis < 3; axis++)
        p[axis] = (real)corner[axis] - (real)view[CENTER + axis] - (real)view[REST + axis];
}

// Transform from world to camera in double precision.
void to_camera(__global const float *corner, __constant float *view, real *to)
{
    real p[3];
    from_center(corner, view, p);
    for (int row = 0; row < 3; row++) {
        real turned[3];
        for (int axis = 0; axis < 3; axis++)
            turned[axis] = (real)view[3 * row + axis] + (real)view[ROTATION_LOW + 3 * row + axis];
        real last = p[2] * turned[2];
        to[row] = MAD(p[0], turned[0], MAD(p[1], turned[1], last));
    }
}

// Return the corner nearest to the camera, with the edge vectors to the next and the last corner.
// From any other corner, the edge vectors may be nearly parallel. Differences of floats are exact in double
// precision.
int from_nearest(__global const float *record, __constant float *view, real *origin, real *next, real *last)
{
    int nearest = 0;
    float least = 3e38f;
    for (int k = 0; k < 3; k++) {
        float away = 0.0f;
        for (int axis = 0; axis < 3; axis++) {
            float along = record[3 * k + axis] - view[CENTER + axis];
            away = MAX(away, LENGTH(along));
        }
        nearest = away < least ? k : nearest;
        least = MIN(least, away);
    }
    __global const float *o = record + 3 * nearest;
    __global const float *a = record + (nearest < 2 ? 3 * nearest + 3 : 0);
    __global const float *b = record + (nearest > 0 ? 3 * nearest - 3 : 6);
    from_center(o, view, origin);
    for (int axis = 0; axis < 3; axis++) {
        next[axis] = (real)a[axis] - (real)o[axis];
        last[axis] = (real)b[axis] - (real)o[axis];
    }
    return nearest;
}

// A triangle that is not drawn in lanes, because it is large or must be clipped.
// Everything is scalar.
typedef struct {
    int n, u[8], v[8];         // outline on the screen in units; empty if n < 3
    float a, b, reference;     // 1 / z = a (u - u_reference) + (b (v - v_reference) + reference) ...
    int u_reference, v_reference;
    float low, high;           // ... clamped to the range of 1 / z at the corners
    int wide;                  // whether 1 / z is plane . (u, v, 1) relative to the principal point instead
    real plane[3];
} Outline;

float plane_distance(int plane, float x, float y, float z, __constant float *view)
{
    if (plane == 0)
        return z - NEAR;
    float side = plane & 1 ? 1.0f : -1.0f;
    float along = plane < 3 ? x : y, principal = view[PRINCIPAL + (plane < 3 ? 0 : 1)];
    return MAD(side, along, MAD(side, principal, GUARD_PLANE) * z);
}

real wide_distance(int plane, const real *p, __constant float *view)
{
    if (plane == 0)
        return p[2] - NEAR;
    real side = plane & 1 ? 1.0f : -1.0f, along = p[plane < 3 ? 0 : 1];
    real principal = view[PRINCIPAL + (plane < 3 ? 0 : 1)], band = MAD(side, principal, (real)GUARD_PLANE);
    return MAD(side, along, band * p[2]);
}

// Returns whether a point is so far away that it needs double precision.
int is_far(float x, float y, float z, __constant float *view)
{
    return LENGTH(z) > FAR || LENGTH(x) > FAR * view[SCALE] || LENGTH(y) > FAR * view[SCALE + 1];
}

// Clip to the near plane and to the guard band (Sutherland and Hodgman 1974).
// An intersection is computed from the inner end of the edge to the outer end.
// Both faces of an edge get the same point, so there are no cracks.
// If one end is far away, the intersection is computed in double precision.
// The choice of precision depends only on the two ends.
// `wide` holds the corners in double precision.
int clip(float *x, float *y, float *z, real (*wide)[3], __constant float *view)
{
    int n = 3;
    for (int plane = 0; plane < 5 && n > 0; plane++) {
        float px[8], py[8], pz[8];
        real exact[8][3];
        int kept = 0;
        for (int i = 0; i < n; i++) {
            int j = i + 1 < n ? i + 1 : 0;
            int far = is_far(x[i], y[i], z[i], view), far_next = is_far(x[j], y[j], z[j], view);
            real exact_d = wide_distance(plane, wide[i], view), exact_e = wide_distance(plane, wide[j], view);
            float d = far ? (float)exact_d : plane_distance(plane, x[i], y[i], z[i], view);
            float e = far_next ? (float)exact_e : plane_distance(plane, x[j], y[j], z[j], view);
            // Each clipping plane adds at most one corner; rounding must not add more.
            if (d >= 0.0f && kept < 8) {
                px[kept] = x[i];
                py[kept] = y[i];
                pz[kept] = z[i];
                for (int axis = 0; axis < 3; axis++)
                    exact[kept][axis] = wide[i][axis];
                kept++;
            }
            if ((d >= 0.0f) != (e >= 0.0f) && kept < 8) {
                int in = d >= 0.0f ? i : j, out = d >= 0.0f ? j : i;
                if (far || far_next) {
                    real inner = d >= 0.0f ? exact_d : exact_e, outer = d >= 0.0f ? exact_e : exact_d;
                    real t = inner > 0.0f && outer < 0.0f ? inner / (inner - outer) : (real)0.0f;
                    for (int axis = 0; axis < 3; axis++)
                        exact[kept][axis] = MAD(t, wide[out][axis] - wide[in][axis], wide[in][axis]);
                    exact[kept][2] = MAX(exact[kept][2], (real)NEAR);
                    px[kept] = (float)exact[kept][0];
                    py[kept] = (float)exact[kept][1];
                    pz[kept] = (float)exact[kept][2];
                    kept++;
                    continue;
                }
                float t = d >= 0.0f ? d / (d - e) : e / (e - d);
                px[kept] = MAD(t, x[out] - x[in], x[in]);
                py[kept] = MAD(t, y[out] - y[in], y[in]);
                float depth = MAD(t, z[out] - z[in], z[in]);
                pz[kept] = MAX(depth, NEAR);
                exact[kept][0] = px[kept];
                exact[kept][1] = py[kept];
                exact[kept][2] = pz[kept];
                kept++;
            }
        }
        n = kept;
        for (int i = 0; i < n; i++) {
            x[i] = px[i];
            y[i] = py[i];
            z[i] = pz[i];
            for (int axis = 0; axis < 3; axis++)
                wide[i][axis] = exact[i][axis];
        }
    }
    return n;
}

// Returns whether float32 is too inaccurate for the plane of a triangle with a corner `far` away.
// If float32 is too inaccurate, `plane` gets the plane in double precision. The plane is computed in world
// axes, in which differences of corners are exact.
int is_wide(__global const float *record, float far, __constant float *view, real *plane)
{
    real o[3], a[3], b[3], size = 0.0f;
    from_nearest(record, view, o, a, b);
    for (int axis = 0; axis < 3; axis++)
        size = MAX(size, MAX(LENGTH(a[axis]), LENGTH(b[axis])));
    CROSS(real, nx, ny, nz, a[0], a[1], a[2], b[0], b[1], b[2])
    DOT(real, determinant, nx, ny, nz, o[0], o[1], o[2])
    for (int row = 0; row < 3; row++) { // slopes per unit along u and v, and the value at the principal point
        real dx = EXACT_RAY(view, 3 * row), dy = EXACT_RAY(view, 3 * row + 1), dz = EXACT_RAY(view, 3 * row + 2);
        DOT(real, along, nx, ny, nz, dx, dy, dz)
        plane[row] = along / determinant * (row < 2 ? 1.0f / UNIT : 1.0f);
    }
    return !((real)far * (real)far * size <= UNCERTAIN * LENGTH(determinant));
}

// Returns 1 / z of an outline in double precision.
float wide_depth(const Outline *o, int x, int y, __constant float *view)
{
    real u = (real)((x << SUBPIXEL_BITS) + HALF) - ((real)view[PRINCIPAL] - 0.5f);
    real v = (real)((y << SUBPIXEL_BITS) + HALF) - ((real)view[PRINCIPAL + 1] - 0.5f);
    return (float)MAD(o->plane[0], u, MAD(o->plane[1], v, o->plane[2]));
}

Outline make_outline(__global const float *record, __constant float *view)
{
    Outline o;
    float x[8], y[8], z[8], far = 0.0f;
    for (int k = 0; k < 3; k++) {
        float a = record[3 * k], b = record[3 * k + 1], c = record[3 * k + 2];
        TO_CAMERA(view, a, b, c, x[k], y[k], z[k])
        far = MAX(far, MAX(MAX(LENGTH(a), LENGTH(b)), LENGTH(c)));
    }
    DEPTH_PLANE(float, x[0], y[0], z[0], x[1], y[1], z[1], x[2], y[2], z[2], A, B, C)
    o.a = A;
    o.b = B;
    float z_min = MIN(MIN(z[0], z[1]), z[2]), z_max = MAX(MAX(z[0], z[1]), z[2]);
    int clipped = !(z_min >= NEAR);
    int i, first_u = 0, first_v = 0;
    o.low = 1.0f / z_max;
    o.high = 1.0f / (clipped ? NEAR : z_min);
    float reference = 1.0f / z[0];
    int u_low = GUARD, u_high = -GUARD, v_low = GUARD, v_high = -GUARD;
    o.n = 3;
    for (i = 0; i < 3 && !clipped; i++) {
        float q = 1.0f / z[i];
        float u = MAD(x[i], q, view[PRINCIPAL]), v = MAD(y[i], q, view[PRINCIPAL + 1]);
        if (!(u > -(float)GUARD && u < (float)GUARD && v > -(float)GUARD && v < (float)GUARD)) {
            clipped = 1;
            break;
        }
        o.u[i] = (int)u;
        o.v[i] = (int)v;
        u_low = MIN(u_low, o.u[i]);
        u_high = MAX(u_high, o.u[i]);
        v_low = MIN(v_low, o.v[i]);
        v_high = MAX(v_high, o.v[i]);
    }
    // This test makes the same decision as zbuffer_block.cl, which uses float32 only.
    int small = !clipped && u_high - u_low < SMALL_EXTENT && v_high - v_low < SMALL_EXTENT && !DEEP(o.low, o.high);
    o.wide = !small && far > FAR && is_wide(record, far, view, o.plane);
    o.u_reference = o.u[0];
    o.v_reference = o.v[0];
    o.reference = reference;
    if (!clipped)
        return o;
    // Corners may be behind the camera, so the plane is evaluated at the principal point.
    float cu = view[PRINCIPAL] - 0.5f, cv = view[PRINCIPAL + 1] - 0.5f;
    o.u_reference = (int)(cu > -(float)GUARD ? (cu < (float)GUARD ? cu : (float)GUARD) : -(float)GUARD);
    o.v_reference = (int)(cv > -(float)GUARD ? (cv < (float)GUARD ? cv : (float)GUARD) : -(float)GUARD);
    o.reference = MAD(A, (float)o.u_reference - cu, MAD(B, (float)o.v_reference - cv, C));
    o.n = 0;
    if (z_max >= NEAR) {
        real wide[8][3];
        for (int k = 0; k < 3; k++)
            to_camera(record + 3 * k, view, wide[k]);
        o.n = clip(x, y, z, wide, view);
    }
    for (i = 0; i < o.n; i++) {
        float q = 1.0f / z[i];
        o.u[i] = (int)MAD(x[i], q, view[PRINCIPAL]);
        o.v[i] = (int)MAD(y[i], q, view[PRINCIPAL + 1]);
    }
    return o;
}

// Edge functions of one triangle in exact integers, which are negative outside.
// On an edge the function is 0.
// A sample on an edge belongs to the triangle only if the edge is a left or top edge. Therefore exactly one
// of two triangles that share an edge takes the sample. The values are divided by UNIT. Division keeps the
// sign, because steps of a pixel are multiples of UNIT.
typedef struct {
    long e[3];        // value at the centre of pixel (x, y)
    long dx[3], dy[3]; // e changes by -dy per pixel to the right, by +dx per pixel downwards
    int x0, y0, x1, y1; // range of pixels of the box, ends included; empty where x0 > x1 or y0 > y1
} Edges;

// Draws the triangle with corners 0, k, k + 1 of an outline, within pixels [left, right) x [top, bottom).
Edges make_edges(const Outline *o, int k, int left, int top, int right, int bottom)
{
    Edges s;
    long u[3] = {o->u[0], o->u[k], o->u[k + 1]}, v[3] = {o->v[0], o->v[k], o->v[k + 1]};
    int x_low = (int)MIN(MIN(u[0], u[1]), u[2]), x_high = (int)MAX(MAX(u[0], u[1]), u[2]);
    int y_low = (int)MIN(MIN(v[0], v[1]), v[2]), y_high = (int)MAX(MAX(v[0], v[1]), v[2]);
    int first_x = (x_low + (HALF - 1)) >> SUBPIXEL_BITS, last_x = (x_high - HALF) >> SUBPIXEL_BITS;
    int first_y = (y_low + (HALF - 1)) >> SUBPIXEL_BITS, last_y = (y_high - HALF) >> SUBPIXEL_BITS;
    s.x0 = MAX(first_x, left);
    s.x1 = MIN(last_x, right - 1);
    s.y0 = MAX(first_y, top);
    s.y1 = MIN(last_y, bottom - 1);
    long area = (u[1] - u[0]) * (v[2] - v[0]) - (v[1] - v[0]) * (u[2] - u[0]);
    if (area == 0)
        s.x1 = s.x0 - 1;
    long px = ((long)s.x0 << SUBPIXEL_BITS) + HALF, py = ((long)s.y0 << SUBPIXEL_BITS) + HALF;
    for (int i = 0; i < 3; i++) {
        int j = i < 2 ? i + 1 : 0;
        long dx = u[j] - u[i], dy = v[j] - v[i];
        if (area < 0) {
            dx = -dx;
            dy = -dy;
        }
        int owns = dy < 0 || (dy == 0 && dx > 0);
        s.dx[i] = dx;
        s.dy[i] = dy;
        s.e[i] = (dx * (py - v[i]) - dy * (px - u[i]) - (owns ? 0 : 1)) >> SUBPIXEL_BITS;
    }
    return s;
}

// ---- colours

// Weights of the corners where the ray meets the plane of the triangle (Moeller and Trumbore 1997).
// The weights refer to the stored corners, which are not snapped. Snapping may leave a sample outside the
// stored triangle, so the weights are clamped to the triangle. A triangle seen edge-on has no weights, so its
// first corner gets weight 1.
#define WEIGHTS(REAL, view, c0, c1, c2, c3, c4, c5, c6, c7, c8, px, py, w, u, v)                                \
    REAL w, u, v;                                                                                               \
    {                                                                                                           \
        REAL ax = c3 - c0, ay = c4 - c1, az = c5 - c2, bx = c6 - c0, by = c7 - c1, bz = c8 - c2;                \
        REAL tx = view[REST] - (c0 - view[CENTER]);                                                             \
        REAL ty = view[REST + 1] - (c1 - view[CENTER + 1]);                                                     \
        REAL tz = view[REST + 2] - (c2 - view[CENTER + 2]);                                                     \
        REAL dx = MAD(px, view[RAY], MAD(py, view[RAY + 3], view[RAY + 6]));                                    \
        REAL dy = MAD(px, view[RAY + 1], MAD(py, view[RAY + 4], view[RAY + 7]));                                \
        REAL dz = MAD(px, view[RAY + 2], MAD(py, view[RAY + 5], view[RAY + 8]));                                \
        CROSS(REAL, qx, qy, qz, dx, dy, dz, bx, by, bz)                                                         \
        CROSS(REAL, rx, ry, rz, tx, ty, tz, ax, ay, az)                                                         \
        DOT(REAL, det, ax, ay, az, qx, qy, qz)                                                                  \
        DOT(REAL, along_u, tx, ty, tz, qx, qy, qz)                                                              \
        DOT(REAL, along_v, dx, dy, dz, rx, ry, rz)                                                              \
        REAL sign = det < 0.0f ? (REAL)(-1.0f) : (REAL)(1.0f);                                                  \
        u = sign * along_u;                                                                                     \
        v = sign * along_v;                                                                                     \
        w = sign * det;                                                                                         \
        w = w - u - v;                                                                                          \
        u = u > 0.0f ? u : (REAL)(0.0f);                                                                        \
        v = v > 0.0f ? v : (REAL)(0.0f);                                                                        \
        w = w > 0.0f ? w : (REAL)(0.0f);                                                                        \
        REAL sum = u + v + w;                                                                                   \
        w = sum > 0.0f ? w : (REAL)(1.0f);                                                                      \
        REAL inverse = 1.0f / (sum > 0.0f ? sum : (REAL)(1.0f));                                                \
        w *= inverse;                                                                                           \
        u *= inverse;                                                                                           \
        v *= inverse;                                                                                           \
    }
#define MIX(REAL, to, w, a, u, b, v, c)                                                                         \
    {                                                                                                           \
        REAL last = (v) * (c);                                                                                  \
        to = MAD(w, a, MAD(u, b, last));                                                                        \
    }

// Computes the weights in double precision, from the corner nearest to the camera.
// Double precision is used for long triangles that float32 handles inaccurately.
// Float32 is inaccurate if a triangle is nearly parallel to the ray, or if two edges are nearly parallel.
// Return whether the triangle requires double precision.
int wide_weights(__global const float *record, __constant float *view, real px, real py, float *weights)
{
    real o[3], a[3], b[3], away = 0.0f, size = 0.0f;
    int nearest = from_nearest(record, view, o, a, b);
    for (int axis = 0; axis < 3; axis++) {
        float first = record[axis] - view[CENTER + axis];
        away = MAX(away, LENGTH(first));
        size = MAX(size, MAX(LENGTH(a[axis]), LENGTH(b[axis])));
    }
    real d[3];
    for (int axis = 0; axis < 3; axis++) {
        real down = MAD(py, EXACT_RAY(view, 3 + axis), EXACT_RAY(view, 6 + axis));
        d[axis] = MAD(px, EXACT_RAY(view, axis), down);
    }
    CROSS(real, qx, qy, qz, d[0], d[1], d[2], b[0], b[1], b[2])
    CROSS(real, rx, ry, rz, a[0], a[1], a[2], o[0], o[1], o[2])
    DOT(real, det, a[0], a[1], a[2], qx, qy, qz)
    if (size * (away + size) <= UNCERTAIN * LENGTH(det))
        return 0;
    DOT(real, along_u, o[0], o[1], o[2], qx, qy, qz)
    DOT(real, along_v, d[0], d[1], d[2], rx, ry, rz)
    real u = det > 0.0f ? -along_u : along_u, v = det > 0.0f ? along_v : -along_v, w = LENGTH(det) - u - v;
    u = MAX(u, 0.0f);
    v = MAX(v, 0.0f);
    w = MAX(w, 0.0f);
    real sum = u + v + w;
    weights[nearest] = sum > 0.0f ? (float)(w / sum) : 1.0f;
    weights[nearest < 2 ? nearest + 1 : 0] = sum > 0.0f ? (float)(u / sum) : 0.0f;
    weights[nearest > 0 ? nearest - 1 : 2] = sum > 0.0f ? (float)(v / sum) : 0.0f;
    return 1;
}

// Returns whether a triangle is so long that the weights of its corners may need double precision.
int is_long(__global const float *corners)
{
    float size = 0.0f;
    for (int axis = 0; axis < 3; axis++) {
        float a = corners[3 + axis] - corners[axis], b = corners[6 + axis] - corners[axis];
        size = MAX(size, MAX(LENGTH(a), LENGTH(b)));
    }
    return size > FAR / 2;
}
