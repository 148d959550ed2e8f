// What the opaque z-buffer's kernels share, so that a CPU and a GPU draw the same picture: the camera, the
// records of triangles, snapping, the depth of a plane, clipping, and interpolation of colours. The rules are
// in docs/standard.md.
//
// No addition below has a product on both sides, so that whoever fuses multiplications and additions fuses the
// same ones.

#define SUBPIXEL_BITS 12
#define UNIT (1 << SUBPIXEL_BITS) // of screen coordinates: 1/4096 pixel
#define HALF (UNIT / 2)
#define NEAR 0.01f
#define GUARD (1 << 29)           // units; a triangle that reaches further is clipped
#define GUARD_PLANE 402653184.0f  // units; where it is clipped, inside GUARD with room for rounding

// A triangle is 16 words, one cache line:
//   0..8   its three corners
//   9..11  three RGBA8 colours, or one RGB colour in floats (COLORS)
//   12     its face
#define WORDS 16
#define FACE_WORD 12
#define BYTES_OF_CORNERS 0 // COLORS: RGBA8 for each corner, in the record
#define FLOATS_OF_FACE 1   // RGB for the face, in the record
#define FLOATS_OF_CORNERS 2 // RGB for each corner, nine floats in a buffer of their own
#define NO_FACE (-1)

// The camera, VIEW in msb/render/standard_view.py. Its rotation R has rows r0, r1, r2.
#define ROTATION 0   // 9: fx UNIT r0, fy UNIT r1, r2
#define CENTER 9     // 3: of the camera, rounded
#define SHIFT 12     // 3: what the rounding left, turned and scaled by the rows above, negated
#define PRINCIPAL 15 // 2: cx UNIT + 1/2, cy UNIT + 1/2, so that truncation rounds
#define SCALE 17     // 2: fx UNIT, fy UNIT
#define REST 19      // 3: what the rounding of the centre left
#define RAY 22       // 9: r0 / fx, r1 / fy, r2: direction = (u - cx) r0 / fx + (v - cy) r1 / fy + r2
#define OPTICAL 31   // 2: cx, cy

#if LANES == 8 // fused by default where the processor can: vectors and scalars alike
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

// Products that must not be fused stand in statements of their own.
#define CROSS(REAL, x, y, z, ax, ay, az, bx, by, bz)                                                            \
    REAL x##_minus = az * by, y##_minus = ax * bz, z##_minus = ay * bx;                                         \
    REAL x = MAD(ay, bz, -x##_minus), y = MAD(az, bx, -y##_minus), z = MAD(ax, by, -z##_minus);
#define DOT(REAL, to, ax, ay, az, bx, by, bz)                                                                   \
    REAL to##_last = az * bz;                                                                                   \
    REAL to = MAD(ax, bx, MAD(ay, by, to##_last));

// World to camera: (fx UNIT x, fy UNIT y, z). Differences with the centre first: they are nearly exact for
// what is near the camera, wherever in the world that is.
#define TO_CAMERA(view, a, b, c, X, Y, Z)                                                                       \
    {                                                                                                           \
        a -= view[CENTER];                                                                                      \
        b -= view[CENTER + 1];                                                                                  \
        c -= view[CENTER + 2];                                                                                  \
        X = MAD(a, view[0], MAD(b, view[1], MAD(c, view[2], view[SHIFT])));                                     \
        Y = MAD(a, view[3], MAD(b, view[4], MAD(c, view[5], view[SHIFT + 1])));                                 \
        Z = MAD(a, view[6], MAD(b, view[7], MAD(c, view[8], view[SHIFT + 2])));                                 \
    }

// 1 / z is affine on the screen: with n the normal of the plane and d = n . corner, 1 / z = (n . (u, v, 1)) / d
// for u, v in units from the principal point. A, B are its slopes per unit. The arms are those of the corner at
// the least depth: those of one a hundred times as far are nearly parallel, and rounding turns their plane.
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

// A triangle that the lanes do not draw: large, or to be clipped. Everything in scalars.
typedef struct {
    int n, u[8], v[8];         // its outline on the screen, units; n < 3: nothing is left
    float a, b, reference;     // 1 / z = a (u - u_reference) + (b (v - v_reference) + reference) ...
    int u_reference, v_reference;
    float low, high;           // ... but never beyond the corners'
} Outline;

float plane_distance(int plane, float x, float y, float z, __constant float *view)
{
    if (plane == 0)
        return z - NEAR;
    float side = plane & 1 ? 1.0f : -1.0f;
    float along = plane < 3 ? x : y, principal = view[PRINCIPAL + (plane < 3 ? 0 : 1)];
    return MAD(side, along, MAD(side, principal, GUARD_PLANE) * z);
}

// Clip to the near plane and to the guard band (Sutherland and Hodgman 1974). A crossing is computed from the
// end that is inside to the one that is not, so both faces of an edge find the same point: no cracks.
int clip(float *x, float *y, float *z, __constant float *view)
{
    int n = 3;
    for (int plane = 0; plane < 5 && n > 0; plane++) {
        float px[8], py[8], pz[8];
        int kept = 0;
        for (int i = 0; i < n; i++) {
            int j = i + 1 < n ? i + 1 : 0;
            float d = plane_distance(plane, x[i], y[i], z[i], view);
            float e = plane_distance(plane, x[j], y[j], z[j], view);
            // At most one corner more for each plane; rounding must not make it more.
            if (d >= 0.0f && kept < 8) {
                px[kept] = x[i];
                py[kept] = y[i];
                pz[kept++] = z[i];
            }
            if ((d >= 0.0f) != (e >= 0.0f) && kept < 8) {
                int in = d >= 0.0f ? i : j, out = d >= 0.0f ? j : i;
                float t = d >= 0.0f ? d / (d - e) : e / (e - d);
                px[kept] = MAD(t, x[out] - x[in], x[in]);
                py[kept] = MAD(t, y[out] - y[in], y[in]);
                float depth = MAD(t, z[out] - z[in], z[in]);
                pz[kept++] = MAX(depth, NEAR);
            }
        }
        n = kept;
        for (int i = 0; i < n; i++) {
            x[i] = px[i];
            y[i] = py[i];
            z[i] = pz[i];
        }
    }
    return n;
}

Outline make_outline(__global const float *record, __constant float *view)
{
    Outline o;
    float x[8], y[8], z[8];
    for (int k = 0; k < 3; k++) {
        float a = record[3 * k], b = record[3 * k + 1], c = record[3 * k + 2];
        TO_CAMERA(view, a, b, c, x[k], y[k], z[k])
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
    }
    o.u_reference = o.u[0];
    o.v_reference = o.v[0];
    o.reference = reference;
    if (!clipped)
        return o;
    // The corners may be behind the camera: the plane is known at the principal point.
    float cu = view[PRINCIPAL] - 0.5f, cv = view[PRINCIPAL + 1] - 0.5f;
    o.u_reference = (int)(cu > -(float)GUARD ? (cu < (float)GUARD ? cu : (float)GUARD) : -(float)GUARD);
    o.v_reference = (int)(cv > -(float)GUARD ? (cv < (float)GUARD ? cv : (float)GUARD) : -(float)GUARD);
    o.reference = MAD(A, (float)o.u_reference - cu, MAD(B, (float)o.v_reference - cv, C));
    o.n = z_max >= NEAR ? clip(x, y, z, view) : 0;
    for (i = 0; i < o.n; i++) {
        float q = 1.0f / z[i];
        o.u[i] = (int)MAD(x[i], q, view[PRINCIPAL]);
        o.v[i] = (int)MAD(y[i], q, view[PRINCIPAL + 1]);
    }
    return o;
}

// Edge functions of one triangle in exact integers: e(x, y) = (e + x dx ... ) below 0 outside. Each is positive
// inside; where it is zero the sample belongs to the triangle only if the edge is a left or a top one, so of
// two triangles that share an edge exactly one takes the sample. Divided by UNIT, which keeps the sign since
// steps of a pixel are multiples of it.
typedef struct {
    long e[3];        // at the centre of pixel (x, y)
    long dx[3], dy[3]; // e changes by -dy to the right, by +dx downwards
    int x0, y0, x1, y1; // pixels of the box, ends included; empty where x0 > x1 or y0 > y1
} Edges;

// The triangle of corners 0, k, k + 1 of an outline, within pixels [left, right) x [top, bottom).
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

// Weights of the corners where the ray meets the triangle's plane (Moeller and Trumbore 1997), from the stored
// corners, not the snapped ones; clamped to the triangle, since a sample may lie outside by the snapping.
// A triangle seen from its very edge has no weights: its first corner counts.
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
