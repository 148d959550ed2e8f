// DiffSoup in CPU style: each work-item draws a band of pixel rows, eight pixels at a time, without atomics.
//
// Every work-item tests all triangles in their order.
// At equal depths, the lowest face number wins automatically, and no lists of unknown length are needed.
// Each plane has rows of `pitch` pixels, a multiple of eight.
#define WIDE 1
#include "diffsoup_math.cl"
#include "diffsoup_project.cl"

// Planes and tables are aligned and padded to eight elements; texel arrays are not.
#define EIGHT(type, pointer) (*(__global type##8 *)(pointer))
typedef struct __attribute__((packed)) {
    float4 four;
} Unaligned;

static int any_of(int8 mask)
{
    ulong4 m = as_ulong4(mask);
    return ((m.x | m.y) | (m.z | m.w)) != 0;
}

typedef struct {
    __global int *face;
    __global float *ndc, *b0, *b1, *w;
} Planes;

static float8 opacity_at(__global const TEXEL *lattice, int side, float8 b0, float8 b1)
{
    Cell c = cell_at(b0, b1, side);
    const int *first = (const int *)&c.node0, *last = (const int *)&c.node2;
    float8 d0, d1, d2;
    for (int lane = 0; lane < 8; lane++) {
        ((float *)&d0)[lane] = lattice[first[lane]];
        ((float *)&d1)[lane] = lattice[first[lane] + 1];
        ((float *)&d2)[lane] = lattice[last[lane]];
    }
    d0 = DECODED(d0);
    d1 = DECODED(d1);
    d2 = DECODED(d2);
    return c.w0 * d0 + c.w1 * d1 + c.w2 * d2;
}

// The columns of a row that can meet a triangle; the rest of the triangle's rectangle is skipped.
//
// A pixel is inside if the rounded A0, A1 and A2 (fragment_at) have the same sign.
// In exact arithmetic, A_i = a_i u + b_i v + c_i.
// For |u|, |v| <= 1, the rounded value differs by less than `error`.
// In a row, each edge limits u to a half-line.
// The intersection of the three half-lines contains every pixel that is inside.
typedef struct {
    float b[3], c[3], k[3]; // u = (b v + c) k is the end of edge i's half-line, its left end if k < 0
    int known;
} Span;

static Span span_of(float4 p0, float4 p1, float4 p2, int2 columns)
{
    Span s;
    s.known = 0;
    if (columns.y - columns.x <= 8)
        return s; // a narrow rectangle is drawn faster without the spans
    float4 q[3] = {p1, p2, p0}, r[3] = {p2, p0, p1};
    float a[3], size = 0.0f;
    for (int i = 0; i < 3; i++) {
        float4 j = q[i], k = r[i];
        a[i] = k.w * j.y - j.w * k.y;
        s.b[i] = j.w * k.x - k.w * j.x;
        s.c[i] = j.x * k.y - k.x * j.y;
        j = fabs(j);
        k = fabs(k);
        size += (j.x + j.w) * (k.y + k.w) + (k.x + k.w) * (j.y + j.w);
    }
    // At most ten rounding errors of 2^-24 add up, so the bound 2^-20 is safe.
    float error = size * 0x1p-20f, turn = s.c[0] * p0.w + s.c[1] * p1.w + s.c[2] * p2.w;
    // The span is unknown for triangles that are seen nearly edge-on, or are too large or too small for
    // float32.
    // Rounding errors may then change the signs of A0, A1 and A2.
    s.known = error > 1e-30f && fabs(turn) > 4.0f * error * (fabs(p0.w) + fabs(p1.w) + fabs(p2.w));
    float sign = turn > 0.0f ? 1.0f : -1.0f;
    for (int i = 0; i < 3; i++) {
        float slope = sign * a[i];
        int flat = fabs(slope) < 1e-30f;
        s.b[i] = flat ? 0.0f : sign * s.b[i];
        s.c[i] = flat ? 2.0f : sign * s.c[i] + 2.0f * error;
        s.k[i] = flat ? 1.0f : -1.0f / slope;
    }
    return s;
}

// First and last column that the triangle may cover in the row at v, widened by one pixel at both ends.
static int2 row_columns(const Span *s, float v, int2 columns, float width)
{
    float low = -1.0f, high = 1.0f;
    for (int i = 0; i < 3; i++) {
        float u = (s->b[i] * v + s->c[i]) * s->k[i];
        if (s->k[i] < 0.0f)
            low = HIGHER(u, low);
        else
            high = LOWER(u, high);
    }
    low = LOWER(low, 1.0f);
    high = HIGHER(high, -1.0f);
    int first = (int)((low + 1.0f) * 0.5f * width - 1.5f), last = (int)((high + 1.0f) * 0.5f * width + 0.5f);
    return (int2)(HIGHER(first, columns.x), LOWER(last, columns.y));
}

// Draw one triangle into the rows from..to of the planes; return the number of its fragments there.
static ulong draw(Planes planes, int face, float4 p0, float4 p1, float4 p2, __global const TEXEL *lattice,
                  int side, int opaque, int2 box, int from, int to, __global const float *ndc_x,
                  __global const float *ndc_y, uint width, uint pitch)
{
    const int8 lanes = (int8)(0, 1, 2, 3, 4, 5, 6, 7);
    const float8 zero = 0.0f;
    const Span span = span_of(p0, p1, p2, box);
    int8 count = 0;
    for (int row = from; row <= to; row++) {
        float v = ndc_y[row];
        size_t line = (size_t)row * pitch;
        int2 columns = span.known ? row_columns(&span, v, box, (float)width) : box;
        for (int left = columns.x & ~7; left <= columns.y; left += 8) {
            int8 column = left + lanes;
            Fragment f = fragment_at(EIGHT(const float, ndc_x + left), v, p0, p1, p2);
            f.valid &= (column >= columns.x) & (column <= columns.y);
            if (!any_of(f.valid))
                continue;
            count -= f.valid;
            // The key is depth + 2, which rounds the depth; a fragment exactly on the near plane is
            // discarded.
            size_t at = line + left;
            float8 old = EIGHT(float, planes.ndc + at);
            int8 wins = f.valid & (f.ndc > -1.0f) & (f.ndc + 2.0f < old + 2.0f);
            if (!any_of(wins))
                continue;
            if (!opaque) {
                float8 a = opacity_at(lattice, side, wins ? f.b0 : zero, wins ? f.b1 : zero);
                wins &= ~(a < 0.5f);
                if (!any_of(wins))
                    continue;
            }
            EIGHT(float, planes.ndc + at) = wins ? f.ndc : old;
            EIGHT(int, planes.face + at) = wins ? (int8)(face) : EIGHT(int, planes.face + at);
            EIGHT(float, planes.b0 + at) = wins ? f.b0 : EIGHT(float, planes.b0 + at);
            EIGHT(float, planes.b1 + at) = wins ? f.b1 : EIGHT(float, planes.b1 + at);
            EIGHT(float, planes.w + at) = wins ? f.w : EIGHT(float, planes.w + at);
        }
    }
    return (ulong)count.s0 + count.s1 + count.s2 + count.s3 + count.s4 + count.s5 + count.s6 + count.s7;
}

__kernel void raster(__global const float4 *corners, __global const ushort *first_rows,
                     __global const ushort *last_rows, __global const ushort2 *columns,
                     __global const TEXEL *opacity, __global const uchar *opaque,
                     __global const float *ndc_x, __global const float *ndc_y, __global int *plane_face,
                     __global float *plane_ndc, __global float *plane_b0, __global float *plane_b1,
                     __global float *plane_w, __global ulong *fragments, uint padded, uint width,
                     uint height, uint pitch, uint band_rows, int side)
{
    size_t band = get_global_id(0);
    int top = (int)(band * band_rows), bottom = (int)LOWER(top + band_rows, height) - 1;
    Planes planes = {plane_face, plane_ndc, plane_b0, plane_b1, plane_w};
    ulong count = 0;
    for (uint face8 = 0; face8 < padded; face8 += 8) {
        ushort8 first = EIGHT(const ushort, first_rows + face8), last = EIGHT(const ushort, last_rows + face8);
        ulong2 here = as_ulong2((first <= (ushort)bottom) & (last >= (ushort)top));
        if (!(here.x | here.y))
            continue;
        for (uint face = face8; face < face8 + 8; face++) {
            int from = first_rows[face], to = last_rows[face];
            from = HIGHER(from, top);
            to = LOWER(to, bottom);
            if (from > to)
                continue;
            __global const float4 *p = corners + 3 * (size_t)face;
            count += draw(planes, (int)face, p[0], p[1], p[2], opacity + face * SAMPLES(side), side,
                          opaque[face], convert_int2(columns[face]), from, to, ndc_x, ndc_y, width, pitch);
        }
    }
    fragments[band] = count;
}

// Two loads of four texels read the seven texels of a node. Both loads include the fourth texel, so that no
// load exceeds the lattice.
#if TEXEL_SCALE == 1
#define FOUR(p) (((__global const Unaligned *)(p))->four)
#else
#define FOUR(p) DECODED((float4)((p)[0], (p)[1], (p)[2], (p)[3]))
#endif
#define NODE(p) ((float8)(FOUR(p), FOUR((p) + 3)))

// Features of eight pixels from up to eight faces, one vector per feature.
static void features_at(__global const TEXEL *lattice, int side, int8 faces, float8 b0, float8 b1,
                        float8 *features)
{
    Cell c = cell_at(b0, b1, side);
    const size_t size = SAMPLES(side) * FEATURES;
    const int *face = (const int *)&faces, *node0 = (const int *)&c.node0, *node2 = (const int *)&c.node2;
    const float *w0 = (const float *)&c.w0, *w1 = (const float *)&c.w1, *w2 = (const float *)&c.w2;
    float8 r[8];
    for (int lane = 0; lane < 8; lane++) {
        __global const TEXEL *p = lattice + face[lane] * size;
        __global const TEXEL *first = p + node0[lane] * FEATURES, *last = p + node2[lane] * FEATURES;
        r[lane] = w0[lane] * NODE(first) + w1[lane] * NODE(first + FEATURES) + w2[lane] * NODE(last);
    }
    // Turn one vector per pixel into one vector per feature: a transposition in three rounds of shuffles.
    float8 s[8];
    for (int i = 0; i < 8; i += 2) {
        s[i] = (float8)(r[i].s0, r[i + 1].s0, r[i].s1, r[i + 1].s1, r[i].s4, r[i + 1].s4, r[i].s5, r[i + 1].s5);
        s[i + 1] =
            (float8)(r[i].s2, r[i + 1].s2, r[i].s3, r[i + 1].s3, r[i].s6, r[i + 1].s6, r[i].s7, r[i + 1].s7);
    }
    for (int i = 0; i < 8; i += 4)
        for (int j = 0; j < 2; j++) {
            float8 a = s[i + j], b = s[i + j + 2];
            r[i + 2 * j] = (float8)(a.s01, b.s01, a.s45, b.s45);
            r[i + 2 * j + 1] = (float8)(a.s23, b.s23, a.s67, b.s67);
        }
    for (int j = 0; j < 4; j++) {
        features[j] = (float8)(r[j].lo, r[j + 4].lo);
        if (j > 0)
            features[3 + j] = (float8)(r[j].hi, r[j + 4].hi);
    }
}

// Write one row of the image, in the row order of the image. The buffers of `raw` keep the row order of the
// raster.
__kernel void shade(__global const int *plane_face, __global const float *plane_ndc,
                    __global const float *plane_b0, __global const float *plane_b1,
                    __global const float *plane_w, __global const TEXEL *lattice, __constant float *net,
                    __global const float *frame, __global const float *ndc_x, __global const float *ndc_y,
                    __global float *image, __global float *depth, __global int *face_id,
                    __global uchar *visible, __global float *raw_bary, __global float *raw_ndc,
                    __global float *raw_features, __global float *raw_harmonics, uint width, uint height,
                    uint pitch, uint flip, uint viewer, uint raw, int side)
{
    uint row = (uint)get_global_id(0);
    size_t line = (size_t)row * pitch, kept = (size_t)row * width;
    size_t image_line = (size_t)(flip ? height - 1 - row : row) * width;
    const float8 zero = 0.0f;
    float v = ndc_y[row];
    for (uint left = 0; left < width; left += 8) {
        int8 faces = EIGHT(const int, plane_face + line + left), hit = faces >= 0;
        float8 x[INPUTS], color[3], b0 = zero, b1 = zero, ndc = zero, w = zero;
        for (int c = 0; c < 3; c++)
            color[c] = frame[BACKGROUND + c];
        for (int i = 0; i < INPUTS; i++)
            x[i] = zero;
        if (any_of(hit)) {
            float8 decoded[3], dx, dy, dz;
            b0 = hit ? EIGHT(const float, plane_b0 + line + left) : zero;
            b1 = hit ? EIGHT(const float, plane_b1 + line + left) : zero;
            ndc = hit ? EIGHT(const float, plane_ndc + line + left) : zero;
            w = hit ? EIGHT(const float, plane_w + line + left) : zero;
            features_at(lattice, side, hit ? faces : (int8)(0), b0, b1, x);
            if (viewer)
                for (int i = 0; i < FEATURES; i++)
                    x[i] = as_target(x[i]);
            towards_camera(EIGHT(const float, ndc_x + left), v, frame + INVERSE, &dx, &dy, &dz);
            harmonics(dx, dy, dz, x + FEATURES);
            decode(x, net, decoded);
            for (int c = 0; c < 3; c++)
                color[c] = hit ? decoded[c] : color[c];
        }
        const int *face = (const int *)&faces;
        uint here = LOWER(width - left, 8u);
        for (uint lane = 0; lane < here; lane++) {
            size_t to = image_line + left + lane;
            image[3 * to] = ((const float *)color)[lane];
            image[3 * to + 1] = ((const float *)color)[8 + lane];
            image[3 * to + 2] = ((const float *)color)[16 + lane];
            depth[to] = ((const float *)&w)[lane];
            face_id[to] = face[lane];
            if (face[lane] >= 0)
                visible[face[lane]] = 1;
        }
        for (uint lane = 0; lane < here && raw; lane++) {
            size_t to = kept + left + lane;
            raw_bary[2 * to] = ((const float *)&b0)[lane];
            raw_bary[2 * to + 1] = ((const float *)&b1)[lane];
            raw_ndc[to] = ((const float *)&ndc)[lane];
            const float *values = (const float *)x;
            for (int i = 0; i < FEATURES; i++)
                raw_features[to * FEATURES + i] = face[lane] >= 0 ? values[8 * i + lane] : 0.0f;
            for (int i = 0; i < HARMONICS; i++)
                raw_harmonics[to * HARMONICS + i] = face[lane] >= 0 ? values[8 * (FEATURES + i) + lane] : 0.0f;
        }
    }
}
